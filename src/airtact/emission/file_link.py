"""A link that writes a file: for boards without a link here, and to inspect the frames."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Complex128

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
from airtact.emission.codecs import codec_of
from airtact.emission.link import Link
from airtact.errors import InvalidInput, about, of_kind
from airtact.files.atomic import written
from airtact.files.bounded import bytes_of

ENDINGS = (*DRIVE_ENDINGS, ".bin")
"""Kinds of files: those of drives, and the bytes that the boards are sent."""


def write_frames(
    path: Path, board: str, frames: Sequence[Frame], rate: float | None = None
) -> None:
    """Write frames for a kind of board to a file, which appears only once it is complete.

    The rate [frames/s] is None for a single drive and for frames without a fixed rate.

    Raises
    ------
    InvalidInput
        "unknown_format" if not one of ``ENDINGS``, "empty", "sizes_differ", or "not_writable".
    """
    if not frames:
        raise InvalidInput(f"{path.name} needs at least one frame.", code="empty")
    if len({len(frame) for frame in frames}) > 1:
        raise InvalidInput(
            f"the {len(frames)} frames for {path.name} differ in their number of elements.",
            code="sizes_differ",
        )
    if checked_ending(path, ENDINGS, "frame") == ".bin":
        codec = codec_of(board)
        with written(path) as partial:
            partial.write_bytes(b"".join(codec.encode(frame) for frame in frames))
        return
    drives = np.stack([frame.drive().amplitudes for frame in frames])
    amplitudes = np.stack([frame.amplitude for frame in frames])
    phases = np.stack([frame.phase for frame in frames])
    levels = frames[0].levels
    write_drive_file(path, DriveFile(drives, rate, amplitudes, phases, levels, board=board))


def read_messages(
    path: Path, board: str | None, boards: int = 1
) -> Complex128[np.ndarray, "frames elements"]:
    """Read the drives in a .bin file, which does not hold the kind and number of boards.

    Raises
    ------
    InvalidInput
        "data_missing", "file_missing", or "message_damaged".
    """
    if board is None:
        raise InvalidInput(
            f"{path.name} does not hold the name of its board: give one, such as autd3.",
            code="data_missing",
        )
    codec = codec_of(board)
    message = bytes_of(path)
    zeros = np.zeros(boards * len(codec.board), dtype=np.uint8)
    size = len(codec.encode(Frame(zeros, zeros, codec.levels)))
    if not message or len(message) % size:
        raise InvalidInput(
            f"{len(message)} bytes are not made of messages of {size} bytes for {boards} {board} "
            "boards.",
            code="message_damaged",
        )
    parts = [message[start : start + size] for start in range(0, len(message), size)]
    return np.stack([codec.decode(part).drive().amplitudes for part in parts])


def load_drive(
    path: str | Path, *, rate: float | None = None, board: str | None = None, boards: int = 1
) -> Drive | Drives:
    """Read a drive or a sequence from a file.

    It reads the files of ``Drive.save``, ``Sequence.save`` and ``FileLink``. Amplitudes and phases
    are the computed ones, to 1e-15 (in a table to nine digits), not the rounded levels; a
    ``FileLink`` writes rounded frames.

    Parameters
    ----------
    path : ends in .h5, .npz, .csv or .bin.
    rate : frames a second, where the file does not hold the rate.
    board, boards : name of the kind of board and number of boards, for .bin only.

    Returns
    -------
    A ``Sequence`` where there is a rate, else a ``Drive``.

    Raises
    ------
    InvalidInput
        If the file cannot be read, has a later format, holds numbers that no drive has, or holds
        several frames and no rate.
    """
    path = Path(of_kind(path, str | Path, "the file of a drive", "its path"))
    if path.suffix.lower() == ".bin":
        contents = DriveFile(read_messages(path, board, boards))
    else:
        contents = read_drive_file(path)
    # Faults of the contents name the file.
    with about(path.name):
        rate = contents.frame_rate(rate)
    return Drive(contents.drives[0]) if rate is None else Drives(contents.drives, rate)


class FileLink(Link):
    """Writes all frames that it is sent to a file when it is closed.

    It has no clock: a sequence is written completely with its rate, as fast as the disk takes it,
    without a ramp and without the silence at the end. ``load_drive`` reads the file.

    Parameters
    ----------
    path : file, .npz, .csv, .h5 or .bin.
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
                f"there is no folder {self.path.parent} for {self.path.name}: make it first.",
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
                f"{rate:g} frames/s: write each sequence to a file of its own.",
                code="sizes_differ",
            )
        self._frames.extend(frames)
        self._rate = rate

    def _end(self) -> None:
        if self._frames:
            write_frames(self.path, self.codec.board.name, self._frames, self._rate)
