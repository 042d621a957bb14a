"""A link that ends in a file, for boards that have no link here and to look at what would be sent."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Complex128

from airtact.conventions import InvalidInput
from airtact.file_access.atomic import whole_file
from airtact.hardware.codecs import codec_of
from airtact.hardware.link import Link
from airtact.synthesis.quantise import Frame
from airtact.transducers.drive_file import DriveFile, write_drive_file
from airtact.validation import of_kind

SUFFIXES = (".npz", ".csv", ".h5", ".bin")
"""Kinds of files: arrays of NumPy, a table, HDF5, and the very bytes that the boards are sent."""


@dataclass(frozen=True, eq=False)
class Frames:
    """Frames for one kind of board.

    Attributes
    ----------
    board : name of the kind of board.
    frames : in their order.
    rate : frames a second; None for a single drive and for frames at no fixed rate.
    """

    board: str
    frames: tuple[Frame, ...]
    rate: float | None = None


def check_suffix(path: Path) -> Path:
    """Return the path of a file of a kind that frames can be written to."""
    if path.suffix.lower() not in SUFFIXES:
        raise InvalidInput(
            f"{path.name} is none of the {len(SUFFIXES)} kinds of frame files: {', '.join(SUFFIXES)}.",
            code="unknown_ending",
        )
    return path


def write_frames(path: Path, written: Frames) -> None:
    """Write frames to a file of the kind that its name ends in, see ``SUFFIXES``; it appears once it is whole.

    Raises
    ------
    InvalidInput
        If the name ends in something else, there is no frame, they are for different numbers of elements, or the file
        cannot be written.
    """
    frames = written.frames
    if not frames:
        raise InvalidInput(f"{path.name} needs at least 1 frame, not 0.", code="empty")
    if len({len(frame) for frame in frames}) > 1:
        raise InvalidInput(
            f"the {len(frames)} frames for {path.name} differ in their number of elements.", code="sizes_differ"
        )
    if check_suffix(path).suffix.lower() != ".bin":
        drives = np.stack([frame.drive().amplitudes for frame in frames])
        levels = (np.stack([frame.amplitude for frame in frames]), np.stack([frame.phase for frame in frames]))
        write_drive_file(path, DriveFile(drives, written.rate, *levels, frames[0].levels, board=written.board))
        return
    codec = codec_of(written.board)
    try:
        with whole_file(path) as partial:
            partial.write_bytes(b"".join(codec.encode(frame) for frame in frames))
    except OSError as error:
        reason = f"{error.strerror} (error {error.errno})"
        raise InvalidInput(f"cannot write {path}: {reason}.", code="file_not_writable") from None


def read_messages(path: Path, board: str | None, boards: int = 1) -> Complex128[np.ndarray, "frames elements"]:
    """Read the drives in a .bin file, which does not hold its kind of board and the number of boards.

    Raises
    ------
    InvalidInput
        If the file cannot be read, the board is not given, or the bytes are not made of its messages.
    """
    if board is None:
        raise InvalidInput(
            f"{path.name} does not hold the name of its board: give 1, such as autd3.", code="board_missing"
        )
    codec = codec_of(board)
    try:
        message = path.read_bytes()
    except OSError as error:
        raise InvalidInput(f"cannot read {path}: {error.strerror}.", code="file_missing") from None
    nothing = np.zeros(boards * len(codec.board), dtype=np.uint8)
    size = len(codec.encode(Frame(nothing, nothing, codec.levels)))
    if not message or len(message) % size:
        raise InvalidInput(
            f"{len(message)} bytes are not made of messages of {size} bytes for {boards} {board} boards.",
            code="message_damaged",
        )
    starts = range(0, len(message), size)
    return np.stack([codec.decode(message[start : start + size]).drive().amplitudes for start in starts])


class FileLink(Link):
    """Writes every frame that it is sent to a file when it is closed, see ``write_frames``.

    It keeps no clock: a sequence is written whole with its rate, as fast as the disk takes it, and neither a ramp nor
    the silence at the end are added. ``load_drive`` reads the file.

    Parameters
    ----------
    path : the file, .npz, .csv, .h5 or .bin.
    board : name of the kind of board.
    boards : how many.
    """

    path: Path

    def __init__(self, path: str | Path, board: str = "autd3", boards: int = 1) -> None:
        super().__init__(board, boards)
        self.path = check_suffix(Path(of_kind(path, str | Path, "the file of frames", "its path")))
        self._frames: list[Frame] = []
        self._rate: float | None = None

    @property
    def name(self) -> str:
        """What commands call it."""
        return "file"

    @property
    def plays_itself(self) -> bool:
        """A file takes whole sequences."""
        return True

    @property
    def real_time(self) -> bool:
        """A file takes frames at once."""
        return False

    def stop(self) -> None:
        """Do nothing: a file emits nothing."""

    def _begin(self) -> None:
        if not self.path.parent.is_dir():
            raise InvalidInput(
                f"there is no folder {self.path.parent} for {self.path.name}: make it first (0 written).",
                code="file_not_writable",
            )
        self._frames, self._rate = [], None

    def _transmit(self, frame: Frame) -> None:
        self._frames.append(frame)

    def _upload(self, frames: Sequence[Frame], rate: float) -> None:
        if self._frames and rate != self._rate:
            raise InvalidInput(
                f"{len(self._frames)} frames at another rate than {rate:g} frames/s are in {self.path.name} already: "
                "write each sequence to a file of its own.",
                code="rates_differ",
            )
        self._frames.extend(frames)
        self._rate = rate

    def _end(self) -> None:
        if self._frames:
            write_frames(self.path, Frames(self.codec.board.name, tuple(self._frames), self._rate))
