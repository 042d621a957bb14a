"""From the name of a paper to its experiment, computed again. Prints nothing."""

from importlib import import_module
from pathlib import Path

from airtact.experiments.inoue2014 import Reproduced
from airtact.timing import Progress, no_progress


def reproduce(
    paper: str, folder: Path, quick: bool = False, report_step: Progress = no_progress
) -> Reproduced:
    """Compute the experiment of one of ``airtact.experiments.PAPERS`` again and write a page about it into a folder.

    Raises
    ------
    InvalidInput, NotConverged
        As the paper's own ``reproduce``.
    """
    return import_module(f"airtact.experiments.{paper}").reproduce(folder, quick, report_step)
