"""From a drive file to the frames of a board, in a file. Prints nothing."""

from pathlib import Path

from airtact.checks import counted
from airtact.drives.drive import Drive
from airtact.drives.frame import share_under_cap
from airtact.emission.amplitudes import faded, modulated
from airtact.emission.file_link import FileLink, write_frames
from airtact.transducers.modulation import AmplitudeModulation
from airtact.workflows.emit import FULL, Plan, plan


def export(
    path: Path,
    board: str,
    file: Path,
    cap: float = FULL,
    modulation: AmplitudeModulation | None = None,
    constant: bool = False,
) -> tuple[Plan, str]:
    """Write a drive or a sequence as the frames of a kind of board, without ramp and silence.

    A modulated drive is one period of frames at a rate of the boards. Parameters are those of
    ``plan``.

    Returns
    -------
    What the frames were made from, and in words how many were written.

    Raises
    ------
    InvalidInput
        As ``plan``, the modulation is too fast for the boards, or the file cannot be written.
    """
    made = plan(path, board, cap, modulation, constant)
    link = FileLink(file, board, len(made.poses))
    drives, rate = made.stored.drives, made.stored.rate
    share = share_under_cap(drives, link.levels, made.cap)
    if made.modulation is None:
        frames = [faded(Drive(row), link.levels, share) for row in drives]
    else:
        frames, rate = modulated(
            Drive(drives[0]), made.modulation, link.levels, link.fastest_frames, share
        )
    write_frames(file, board, frames, rate)
    words = f"{counted(len(frames), 'frame', 'frames')} for {counted(len(made.poses), 'board', 'boards')}"
    return made, words if rate is None else f"{words} at {rate:g} frames/s"
