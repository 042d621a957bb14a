"""From a drive file to the frames of a board, in a file. Prints nothing."""

from pathlib import Path

from airtact.hardware.amplitudes import faded, share_under_cap
from airtact.hardware.codecs import codec_of
from airtact.hardware.file_link import write_frames
from airtact.transfer import Drive
from airtact.validation import counted
from airtact.workflows.emit import Plan, plan


def export(path: Path, board: str, file: Path, cap: float = 100.0) -> tuple[Plan, str]:
    """Write a drive or a sequence as the frames of a kind of board, without ramp and silence.

    Returns
    -------
    What the frames were made from, and in words how many were written.

    Raises
    ------
    InvalidInput
        As ``plan``, or the file cannot be written.
    """
    made = plan(path, board, cap)
    levels = codec_of(made.board).levels
    share = share_under_cap(made.stored.drives, levels, made.cap)
    frames = tuple(faded(Drive(row), levels, share) for row in made.stored.drives)
    write_frames(file, board, frames, made.stored.rate)
    return made, f"{counted(len(frames), 'frame', 'frames')} for {counted(len(made.poses), 'board', 'boards')}"
