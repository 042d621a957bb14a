"""Reading drives and sequences back: from the files that they save themselves to, and from frames of boards."""

from pathlib import Path

from airtact.checks import of_kind
from airtact.drives.sequence import Sequence
from airtact.drives.transfer import Drive
from airtact.emission.file_link import read_messages
from airtact.errors import about
from airtact.transducers.drive_file import DriveFile, read_drive_file


def load_drive(
    path: str | Path, *, rate: float | None = None, board: str | None = None, boards: int = 1
) -> Drive | Sequence:
    """Read a drive or a sequence from a file.

    It reads what ``Drive.save`` and ``Sequence.save`` write, such as the drive.h5 of a run, also of
    older versions, and the frames that a ``FileLink`` or ``airtact export`` writes. Amplitudes and
    phases are those that were computed, to 1e-15 (in a table to nine digits), not the levels that
    they were rounded to; frames of boards are rounded already.

    Parameters
    ----------
    path : ends in .h5, .npz, .csv or .bin.
    rate : frames a second, where the file does not hold it.
    board, boards : name of the kind of board and number of boards, for .bin only.

    Returns
    -------
    A ``Sequence`` where the file holds a rate or one is given, else a ``Drive``.

    Raises
    ------
    InvalidInput
        If the file cannot be read, is of a later version of airtact, holds numbers that no drive has, or holds several
        frames and no rate.
    """
    path = Path(of_kind(path, str | Path, "the file of a drive", "its path"))
    binary = path.suffix.lower() == ".bin"
    stored = DriveFile(read_messages(path, board, boards)) if binary else read_drive_file(path)
    with about(path.name):
        rate = stored.frame_rate(rate)
    return Drive(stored.drives[0]) if rate is None else Sequence(stored.drives, rate)
