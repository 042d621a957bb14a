"""From a drive file to the frames of a board, in a file. Prints nothing."""

from pathlib import Path

from airtact.workflows import emit
from airtact.workflows.emit import Plan


def export(path: Path, board: str, file: Path, cap: float = 100.0) -> tuple[Plan, str]:
    """Read a drive or a sequence and write it as the frames of a kind of board.

    Returns
    -------
    What the frames were made from, and in words how many were written.

    Raises
    ------
    InvalidInput
        As ``plan``, or the file cannot be written.
    """
    plan = emit.plan(path, board, cap)
    return plan, emit.export(plan, file)
