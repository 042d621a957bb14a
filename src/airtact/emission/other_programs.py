"""Drives written by other programs: tables of phases, AcousTools, Ultraino, and board messages.

All of these use the same phasor as airtact, e^{ikr}/r with e^{−iωt}, except tables of unknown
origin. The formats are defined in ``Export/CSV.py`` and ``Export/Holo.py`` of AcousTools 1.2, and
in Ultraino's Java beans ``Simulation`` and ``Transducer``; ``CalcField.java`` defines the unit of
phases.
"""

import gzip
import io
import re
import warnings
import xml.etree.ElementTree as ElementTree
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Complex128, Float64

from airtact.drives.drive_file import DriveFile
from airtact.emission.codecs import codec_of
from airtact.errors import InvalidInput, check_finite, of_kind
from airtact.files.bounded import bytes_of, text_of
from airtact.transducers.boards import boards_needed

Drives = Complex128[np.ndarray, "frames elements"]
Phases = Float64[np.ndarray, "frames elements"]

# Largest size of an unpacked file [bytes]; small files can unpack to gigabytes.
MAX_UNPACKED = 2**28

ENDINGS = (".csv", ".txt", ".holo", ".xml", ".xml.gz", ".npy", ".bin")


def read_other(path: Path, board: str | None = None, elements: int | None = None) -> DriveFile:
    """Read the drives from a file written by another program.

    Parameters
    ----------
    path : file whose name ends in one of ``ENDINGS``.
    board : name of the board whose messages a .bin file contains.
    elements : number of elements of all boards; by default, that of one board.

    Raises
    ------
    InvalidInput
        If the file is missing, unreadable, too large or in an unknown format, or if its values are
        invalid.
    """
    name = path.name.lower()
    ending = next((ending for ending in ENDINGS[::-1] if name.endswith(ending)), None)
    if ending is None:
        raise InvalidInput(
            f"the format of {path.name} is unknown: use .h5 or one of {', '.join(ENDINGS)}.",
            code="unknown_format",
        )
    if ending == ".xml":
        return _ultraino(path, bytes_of(path))
    if ending == ".xml.gz":
        packed = gzip.GzipFile(fileobj=io.BytesIO(bytes_of(path)))
        return _ultraino(path, _unpacked(path, packed.read))
    if ending == ".holo":
        return DriveFile(_holograms(path))
    if ending == ".npy":
        return DriveFile(_numpy(path))
    if ending == ".bin":
        return DriveFile(_messages(path, board, elements), board=board)
    return DriveFile(_table(path))


def _unreadable(path: Path, why: str) -> InvalidInput:
    return InvalidInput(f"{path.name} {why}.", code="file_unreadable")


def _unpacked(path: Path, read: Callable[[int], bytes]) -> bytes:
    """Return all unpacked data, given a function that unpacks up to a number of bytes."""
    try:
        data = read(MAX_UNPACKED + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise _unreadable(path, f"cannot be unpacked: {error}") from None
    if len(data) > MAX_UNPACKED:
        raise InvalidInput(
            f"{path.name} unpacks to more than {MAX_UNPACKED:,} bytes; save fewer frames.",
            code="file_too_large",
        )
    return data


# --- Tables -----------------------------------------------------------------------------------


def _table(path: Path) -> Drives:
    """Read a table of phases that has named columns or only numbers.

    A table with names has one element per line and a column ``phase``, ``phase_degrees`` or
    ``phase_radians``; ``amplitude`` is optional. Without names, a single column or line is one
    drive; otherwise each line is a frame. AcousTools writes the numbers of frames and elements in
    the first line, and phases in radians in the order of OpenMPD's boards.
    """
    lines = [line.strip() for line in text_of(path).splitlines()]
    cells = [
        re.split(r"[,;\s]+", line.strip(",;"))
        for line in lines
        if line and not line.startswith(("#", "%"))
    ]
    if not cells:
        raise _unreadable(path, "is empty")
    names: list[str] = []
    if any(re.match("[a-z]", cell, re.IGNORECASE) for cell in cells[0] if cell.lower() != "nan"):
        names = [cell.strip('"').lower() for cell in cells.pop(0)]
    counts = cells[0] if len(cells) > 1 and len(cells[0]) == 2 else []
    acoustools = counts == [str(len(cells) - 1), str(len(cells[-1]))]
    if acoustools:
        cells.pop(0)
    widths = {len(row) for row in cells}
    if len(widths) != 1 or (names and {len(names)} != widths):
        raise InvalidInput(
            f"the lines of {path.name} have different numbers of cells; write one line per "
            "element, or one line per frame.",
            code="wrong_shape",
        )
    try:
        numbers = np.array(cells, dtype=np.float64)
    except ValueError as error:
        raise _unreadable(path, f"has a cell that is not a number: {error}") from None
    check_finite(numbers, path.name)
    if acoustools:
        return np.exp(1j * numbers)
    if not names:
        if numbers.shape[1] == 2:
            raise InvalidInput(
                f"{path.name} has two columns; name them in its first line, for example "
                "amplitude,phase_degrees.",
                code="data_missing",
            )
        return np.exp(1j * _radians(path, numbers.T if numbers.shape[1] == 1 else numbers, ""))
    column = next((name for name in names if name.startswith(("phase", "angle"))), None)
    if column is None:
        raise InvalidInput(
            f"{path.name} has no column phase; its columns are {', '.join(names)}.",
            code="data_missing",
        )
    if "frame" in names or "time" in names:
        raise InvalidInput(
            f"{path.name} contains several frames, one line per element and frame; save each frame "
            "separately, or write one line per frame.",
            code="not_supported",
        )
    for numbered in {"index", "element"} & set(names):
        places = numbers[:, names.index(numbered)]
        numbers = numbers[np.argsort(places)]
        if not np.array_equal(np.sort(places) - places.min(), np.arange(len(places))):
            raise InvalidInput(
                f"the column {numbered} of {path.name} must number every element exactly once.",
                code="out_of_range",
            )
    phases = _radians(path, numbers[None, :, names.index(column)], column)
    amplitudes = np.ones(phases.shape)
    if "amplitude" in names:
        amplitudes = numbers[None, :, names.index("amplitude")]
    return _checked(path, amplitudes) * np.exp(1j * phases)


def _radians(path: Path, phases: Phases, name: str) -> Phases:
    """Convert phases to radians; without a named unit, a range above 2π means degrees."""
    if "rad" in name or "deg" in name:
        return np.radians(phases) if "deg" in name else phases
    if "level" in name:
        return 2.0 * np.pi / 256.0 * phases
    largest = float(np.abs(phases).max())
    if largest <= 2.0 * np.pi + 1e-3:
        return phases
    if largest > 360.0 + 1e-3:
        raise InvalidInput(
            f"phases in {path.name} reach {largest:g}, which is more than a full turn both in "
            "radians and in degrees; name the column phase_radians, phase_degrees or phase_level "
            "(of 256).",
            code="out_of_range",
        )
    if largest <= 255.0 and np.array_equal(phases, np.round(phases)) and phases.min() >= 0.0:
        warnings.warn(
            f"phases in {path.name} are whole numbers up to {largest:.0f} and are read as degrees. "
            "If they are levels from 0 to 255, name the column phase_level.",
            stacklevel=2,
        )
    return np.radians(phases)


def _checked(
    path: Path, amplitudes: Float64[np.ndarray, "frames elements"]
) -> Float64[np.ndarray, "frames elements"]:
    if amplitudes.min() < 0.0 or amplitudes.max() > 1.0:
        raise InvalidInput(
            f"amplitudes in {path.name} run from {amplitudes.min():g} to {amplitudes.max():g}; "
            "use fractions of full scale, from 0 to 1.",
            code="out_of_range",
        )
    return amplitudes


# --- AcousTools -------------------------------------------------------------------------------


def _holograms(path: Path) -> Drives:
    """Read a .holo file of 5-byte numbers, with phases and amplitudes in 32 levels.

    The number 63 separates the frames. AcousTools orders the elements of a board by x, then y. The
    result is in the order of OpenMPD's boards, as in the .csv files from AcousTools: the first 256
    elements are the upper board.
    """
    packed = bytes_of(path)
    data = _unpacked(path, lambda size: zlib.decompressobj().decompress(packed, size))
    if len(data) % 5 or not data:
        raise _unreadable(path, "is not a file of holograms written by AcousTools")
    rows = np.frombuffer(data, dtype=np.uint8).reshape(-1, 5)
    numbers = np.where(rows[:, :4].any(axis=1), 64, rows[:, 4]).astype(np.int64)
    parts = np.split(numbers, np.flatnonzero(numbers == 63))
    # Each part except the first begins with its mark, and the last part is only a mark.
    parts = [parts[0], *(part[1:] for part in parts[1:])]
    lengths = {len(part) for part in parts[:-1]}
    if len(parts) % 2 == 0 or len(parts[-1]) or len(lengths) != 1 or numbers.max() > 63:
        raise _unreadable(path, "is not a file of holograms written by AcousTools")
    levels = np.array(parts[:-1]).reshape(-1, 2, lengths.pop())
    if levels.max() > 32:
        raise _unreadable(path, "has levels above 32")
    drives = levels[:, 1] / 32.0 * np.exp(2j * np.pi / 32.0 * (levels[:, 0] - 16.0))
    count = drives.shape[1]
    if count not in (256, 512):
        return drives
    # The upper board hangs upside down. It is turned about y, so its x axis is reversed.
    grid = np.arange(256).reshape(16, 16)
    order = np.concatenate([grid[::-1, ::-1].ravel(), 256 + grid[:, ::-1].ravel()])
    return drives[:, order[:count]]


# --- Ultraino ---------------------------------------------------------------------------------


def _ultraino(path: Path, data: bytes) -> DriveFile:
    """Read the transducers of a simulation from Java beans, which omit default values.

    Phases are in half turns. An element radiates along the y axis of its transform. The result is
    in the order of the channels.
    """
    if b"<!ENTITY" in data or b"<!DOCTYPE" in data:
        raise _unreadable(path, "declares entities; save it again with Ultraino")
    try:
        root = ElementTree.fromstring(data)
    except ElementTree.ParseError as error:
        raise _unreadable(path, f"is not XML: {error}") from None
    values = _fields(root)
    transducers = [
        node
        for node in root.iter()
        if node.get("class", "").endswith(".Transducer") and node.get("id")
    ]
    if not transducers:
        raise _unreadable(path, "contains no Ultraino transducers")
    transducers.sort(key=lambda node: _property(node, "orderNumber", 0.0))
    drives = []
    positions = []
    normals = []
    for node in transducers:
        name = node.get("id", "")
        phase = np.pi * values.get((name, "phase"), 0.0)
        drives.append(values.get((name, "amplitude"), 1.0) * np.exp(1j * phase))
        place = node.find(".//void[@property='translation']")
        name = "" if place is None else place.get("id", "")
        positions.append([values.get((name, axis), 0.0) for axis in "xyz"])
        rotation = node.find(".//void[@property='rot']")
        w = _property(rotation, "w", 1.0)
        x, y, z = (_property(rotation, axis, 0.0) for axis in "xyz")
        # Second column of the rotation matrix of the quaternion.
        normals.append([2 * (x * y - w * z), w * w - x * x + y * y - z * z, 2 * (y * z + w * x)])
    directions = np.array(normals)
    lengths = np.linalg.norm(directions, axis=1, keepdims=True)
    found = np.array(drives)[None]
    _checked(path, np.abs(found))
    return DriveFile(found, positions=np.array(positions), normals=directions / lengths)


def _fields(root: ElementTree.Element) -> dict[tuple[str, str], float]:
    """Return the numbers set in Java beans, keyed by the names of the object and its field."""
    fields = {}
    for entry in root.iter("void"):
        setting = entry.find("void[@method='set']")
        if entry.get("method") != "getField" or setting is None or len(setting) < 2:
            continue
        # Other objects may be defined before the one whose field is set. The number comes last.
        target, number = setting[-2], setting[-1]
        name = target.get("idref") or target.get("id") or ""
        if number.tag in ("float", "int"):
            fields[name, entry.findtext("string") or ""] = float(number.text or "nan")
    return fields


def _property(node: "ElementTree.Element | None", name: str, default: float) -> float:
    entry = None if node is None else node.find(f".//void[@property='{name}']")
    if entry is None:
        return default
    return float(entry.findtext("float") or entry.findtext("int") or default)


# --- Arrays and messages ----------------------------------------------------------------------


def _numpy(path: Path) -> Drives:
    try:
        values = np.load(io.BytesIO(bytes_of(path)), allow_pickle=False)
    except (ValueError, EOFError, OSError) as error:
        raise _unreadable(path, f"is not an array of numbers: {error}") from None
    of_kind(values, np.ndarray, path.name, "one array")
    values = np.squeeze(values)
    if values.dtype == np.uint8 and values.ndim >= 2 and values.shape[-1] == 2:
        intensity = values[..., 1] / 255.0
        return np.atleast_2d(intensity * np.exp(2j * np.pi * values[..., 0] / 256.0))
    if values.ndim not in (1, 2) or not np.issubdtype(values.dtype, np.inexact):
        raise InvalidInput(
            f"{path.name} contains an array of shape {values.shape} and type {values.dtype}; save "
            "complex amplitudes or phases of shape (elements,) or (frames, elements).",
            code="wrong_shape",
        )
    values = np.atleast_2d(values)
    check_finite(values, path.name)
    if np.iscomplexobj(values):
        return values.astype(np.complex128)
    return np.exp(1j * _radians(path, values.astype(np.float64), ""))


def _messages(path: Path, board: str | None, elements: int | None) -> Drives:
    if board is None:
        raise InvalidInput(
            f"{path.name} contains messages to boards; name the kind of board, such as "
            "sonicsurface.",
            code="key_missing",
        )
    codec = codec_of(board)
    frames = codec.decode(bytes_of(path), boards_needed(codec.board, elements or len(codec.board)))
    if not frames:
        raise _unreadable(path, f"does not contain whole frames of {codec.board.title} boards")
    return np.stack([frame.drive().amplitudes for frame in frames])
