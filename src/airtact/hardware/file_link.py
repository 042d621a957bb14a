"""A link that ends in a file, for boards that have no link here and for looking at what would be sent."""

import csv
import io
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from airtact.conventions import InvalidInput
from airtact.hardware.codecs import codec_of
from airtact.hardware.link import Link
from airtact.synthesis.quantise import Frame
from airtact.validation import of_kind

SUFFIXES = (".npz", ".csv", ".h5", ".bin")
"""Kinds of files: arrays of NumPy, a table, HDF5, and the very bytes that the boards are sent."""

COLUMNS = ("frame", "seconds", "element", "amplitude_level", "phase_level", "amplitude", "phase")
"""Columns of a .csv file: the last two are a share of full scale and radians of Re[d e^{−iωt}]."""


@dataclass(frozen=True, eq=False)
class Frames:
    """Frames for one kind of board, and when each was sent.

    Attributes
    ----------
    board : name of the kind of board.
    frames : what was sent.
    seconds : (N,) when; NaN where the file does not say.
    """

    board: str
    frames: tuple[Frame, ...]
    seconds: Float64[np.ndarray, "frames"]


def check_suffix(path: Path) -> Path:
    """Refuse a file of a kind that frames cannot be written to.

    Raises
    ------
    InvalidInput
        Listing the kinds that there are.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise InvalidInput(f"{path.name} is none of the {len(SUFFIXES)} kinds of frame files: {', '.join(SUFFIXES)}.")
    return path


def write_frames(path: Path, written: Frames) -> None:
    """Write frames to a file of the kind that its name ends in, see ``SUFFIXES``; it appears once it is whole.

    Parameters
    ----------
    path : the file.
    written : the frames.

    Raises
    ------
    InvalidInput
        If the name ends in something else, there is no frame, or they are for different numbers of elements.
    """
    kind = check_suffix(path).suffix.lower()
    if not written.frames:
        raise InvalidInput(f"{path.name} needs at least 1 frame, not 0.")
    if len({len(frame) for frame in written.frames}) > 1:
        raise InvalidInput(f"the {len(written.frames)} frames for {path.name} differ in their number of elements.")
    if kind == ".bin":
        codec = codec_of(written.board)
        _whole(path, b"".join(codec.encode(frame) for frame in written.frames))
    elif kind == ".csv":
        _whole(path, _table(written).encode())
    elif kind == ".npz":
        packed = io.BytesIO()
        np.savez_compressed(packed, allow_pickle=False, **_columns(written))
        _whole(path, packed.getvalue())
    else:
        import h5py

        packed = io.BytesIO()
        with h5py.File(packed, "w") as file:
            for name, values in _columns(written).items():
                file.create_dataset(name, data=values if values.dtype.kind != "U" else str(values))
        _whole(path, packed.getvalue())


def read_frames(path: Path, board: str | None = None, boards: int = 1) -> Frames:
    """Read what ``write_frames`` wrote.

    Parameters
    ----------
    path : the file.
    board : name of the kind of board; files but .npz and .h5 do not know it.
    boards : how many boards a message of a .bin file is for.

    Raises
    ------
    InvalidInput
        If the file cannot be read, or the board is not given where the file does not say it.
    """
    kind = check_suffix(path).suffix.lower()
    try:
        if kind in (".bin", ".csv") and board is None:
            raise InvalidInput(f"{path.name} does not say of which board its frames are: give one name, such as autd3.")
        if kind == ".bin":
            return _split(path.read_bytes(), str(board), boards)
        columns = _read_csv(path, str(board)) if kind == ".csv" else _read_columns(path, kind)
    except OSError as error:
        raise InvalidInput(f"cannot read {path.name}: {error.strerror or error}.") from None
    name, levels = str(columns["board"]), codec_of(str(columns["board"])).levels
    pairs = zip(columns["amplitude_level"], columns["phase_level"], strict=True)
    return Frames(name, tuple(Frame(amplitude, phase, levels) for amplitude, phase in pairs), columns["seconds"])


def _columns(written: Frames) -> dict[str, np.ndarray]:
    drives = np.stack([frame.drive().amplitudes for frame in written.frames])
    return {
        "board": np.array(written.board),
        "seconds": written.seconds,
        "amplitude_level": np.stack([frame.amplitude for frame in written.frames]),
        "phase_level": np.stack([frame.phase for frame in written.frames]),
        "amplitude": np.abs(drives),
        "phase": np.angle(drives),
    }


def _table(written: Frames) -> str:
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    writer.writerow(COLUMNS)
    for index, (frame, seconds) in enumerate(zip(written.frames, written.seconds, strict=True)):
        drive = frame.drive().amplitudes
        for element in range(len(frame)):
            levels = int(frame.amplitude[element]), int(frame.phase[element])
            exact = f"{abs(drive[element]):.9g}", f"{np.angle(drive[element]):.9g}"
            writer.writerow([index, f"{seconds:.6f}", element, *levels, *exact])
    return text.getvalue()


def _read_csv(path: Path, board: str) -> dict[str, np.ndarray]:
    lines = path.read_text(encoding="utf-8").splitlines()
    if not lines or tuple(lines[0].split(",")) != COLUMNS:
        raise InvalidInput(f"line 1 of {path.name} must be {','.join(COLUMNS)}.")
    rows = np.array([[float(word) for word in line.split(",")[:5]] for line in lines[1:]])
    frames = int(rows[-1, 0]) + 1
    levels = rows[:, 3:].astype(np.uint8).reshape(frames, -1, 2)
    seconds = rows[:: levels.shape[1], 1].copy()
    return {
        "board": np.array(board),
        "seconds": seconds,
        "amplitude_level": levels[..., 0].copy(),
        "phase_level": levels[..., 1].copy(),
    }


def _read_columns(path: Path, kind: str) -> dict[str, np.ndarray]:
    if kind == ".npz":
        with np.load(path) as file:
            return {name: file[name] for name in file.files}
    import h5py

    file: Any
    with h5py.File(path) as file:
        board = np.array(file["board"].asstr()[()])
        return {"board": board} | {name: file[name][()] for name in file if name != "board"}


def _split(message: bytes, board: str, boards: int) -> Frames:
    """Cut the content of a .bin file into messages."""
    codec = codec_of(board)
    nothing = np.zeros(boards * len(codec.board), dtype=np.uint8)
    size = len(codec.encode(Frame(nothing, nothing, codec.levels)))
    if not message or len(message) % size:
        raise InvalidInput(
            f"{len(message)} bytes are not made of messages of {size} bytes for {boards} {board} boards."
        )
    frames = tuple(codec.decode(message[start : start + size]) for start in range(0, len(message), size))
    return Frames(board, frames, np.full(len(frames), np.nan))


def _whole(path: Path, content: bytes) -> None:
    # Written beside and renamed, so that a run broken off leaves no half file; report/ cannot be asked from here.
    partial = path.with_name(f".{path.name}.partial")
    try:
        partial.write_bytes(content)
        partial.replace(path)
    except OSError as error:
        raise InvalidInput(f"cannot write {path}: {error.strerror} (error {error.errno}).") from None
    finally:
        partial.unlink(missing_ok=True)


class FileLink(Link):
    """Writes all frames that it was sent to a file when it is closed, see ``write_frames``.

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
        self._seconds: list[float] = []

    @property
    def name(self) -> str:
        """What commands call it."""
        return "file"

    def _begin(self) -> None:
        if not self.path.parent.is_dir():
            raise InvalidInput(
                f"there is no folder {self.path.parent} for {self.path.name}: make it first (0 written)."
            )
        self._frames, self._seconds, self._begun = [], [], time.monotonic()

    def _transmit(self, frame: Frame) -> None:
        self._frames.append(frame)
        self._seconds.append(time.monotonic() - self._begun)

    def _end(self) -> None:
        if self._frames:
            write_frames(self.path, Frames(self.codec.board.name, tuple(self._frames), np.array(self._seconds)))
