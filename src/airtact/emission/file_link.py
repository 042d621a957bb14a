"""A link that writes frames to a file, for inspection or for boards without a link."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from airtact.drives.drive import Drive
from airtact.drives.drive_file import ENDINGS as DRIVE_ENDINGS
from airtact.drives.drive_file import (
    DriveFile,
    checked_ending,
    read_drive_file,
    write_drive_file,
)
from airtact.drives.frame import Frame
from airtact.drives.sequence import Sequence as Drives
from airtact.emission.link import Link
from airtact.errors import InvalidInput, about, of_kind
from airtact.files.atomic import written

# File name extensions: those of drives, and the one for the bytes of the boards.
ENDINGS = (*DRIVE_ENDINGS, ".bin")


def load_drive(path: str | Path, *, rate: float | None = None) -> Drive | Drives:
    """Read a drive or a sequence from a file.

    It reads the files of ``Drive.save``, ``Sequence.save`` and ``FileLink``, except for ``.bin``.
    The saved amplitudes and phases are the computed ones, to 1e-15 (in a table to nine digits);
    those of a ``FileLink`` are rounded to the levels of the boards.

    Parameters
    ----------
    path : file that ends in .h5 or .csv.
    rate : frames per second, if the file does not contain the rate.

    Returns
    -------
    A ``Sequence`` if there is a rate, else a ``Drive``.

    Raises
    ------
    InvalidInput
        If the file cannot be read, has a later format, contains numbers that are not valid in a
        drive, or contains several frames but no rate.
    """
    path = Path(of_kind(path, str | Path, "the file of a drive", "its path"))
    contents = read_drive_file(path)
    # Errors in the contents name the file.
    with about(path.name):
        rate = contents.frame_rate(rate)
    return Drive(contents.drives[0]) if rate is None else Drives(contents.drives, rate)


class FileLink(Link):
    """Link that writes its frames to a file when it is closed.

    A complete sequence is written with its rate, as fast as possible, without a ramp and without
    silence at the end. ``load_drive`` reads all formats but ``.bin``.

    Parameters
    ----------
    path : file that ends in .h5, .csv or .bin.
    board : name of the kind of board.
    boards : number of boards.
    """

    name = "file"
    plays_itself = True
    real_time = False

    def __init__(self, path: str | Path, board: str = "autd3", boards: int = 1) -> None:
        super().__init__(board, boards)
        self.path: Path = Path(of_kind(path, str | Path, "the file of frames", "its path"))
        checked_ending(self.path, ENDINGS, "frame")
        self._frames: list[Frame] = []
        self._rate: float | None = None

    def stop(self) -> None:
        """Do nothing: a file emits nothing."""

    def _begin(self) -> None:
        if not self.path.parent.is_dir():
            raise InvalidInput(
                f"there is no folder {self.path.parent} for {self.path.name}: create it first.",
                code="not_writable",
            )
        self._frames = []
        self._rate = None

    def _transmit(self, frame: Frame) -> None:
        self._frames.append(frame)

    def _upload(self, frames: Sequence[Frame], rate: float) -> None:
        if self._frames and rate != self._rate:
            raise InvalidInput(
                f"{self.path.name} already has {len(self._frames)} frames at another rate than "
                f"{rate:g} frames/s: write each sequence to a separate file.",
                code="sizes_differ",
            )
        self._frames.extend(frames)
        self._rate = rate

    def _end(self) -> None:
        frames = self._frames
        if not frames:
            return
        if self.path.suffix.lower() == ".bin":
            with written(self.path) as partial:
                partial.write_bytes(b"".join(self.codec.encode(frame) for frame in frames))
            return
        drives = np.stack([frame.drive().amplitudes for frame in frames])
        name = self.codec.board.name
        write_drive_file(self.path, DriveFile(drives, self._rate, self.levels, board=name))
