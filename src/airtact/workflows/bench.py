"""From this machine to a page of times and errors. Prints nothing."""

from pathlib import Path

from airtact.benching import bench as benching
from airtact.timing import Progress, no_progress


def bench(
    folder: Path,
    acoustools: str | None = None,
    bempp: str | None = None,
    hand: Path | None = None,
    quick: bool = False,
    report_step: Progress = no_progress,
) -> tuple[Path, tuple[str, ...]]:
    """Measure times and errors, beside other packages where their interpreters are given, and write a page.

    Returns
    -------
    The page, and what was left out and why.

    Raises
    ------
    InvalidInput
        The folder or the pose is at fault.
    """
    found = benching.bench(folder, acoustools, bempp, hand, quick, report_step)
    return folder / benching.FILES[2], tuple(found.notes)
