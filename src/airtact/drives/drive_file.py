"""Files of drives and sequences, with all data that emission needs: .h5, or a .csv table.

Version 1 has these datasets; those in brackets are optional:

- ``format_version``; ``modulation``: "none" if the frames are emitted as they are, "am" for a
  drive whose amplitude varies with ``modulation_frequency`` [Hz] and ``modulation_depth``, as in
  ``AmplitudeModulation``.
- ``amplitude`` [share of full scale] and ``phase`` [rad, of Re[d e^{−iωt}]]: (E,) for a drive, (N,
  E) for a sequence. ``amplitude_level`` and ``phase_level`` are the same in levels:
  ``shares_of_levels`` (A,) lists the amplitudes, ``levels_of_a_turn`` is the number of phases. A
  sequence has its ``rate`` [frames/s].
- (``frequency`` [Hz], ``sound_speed`` [m/s], ``density`` [kg/m³], ``absorption`` [Np/m])
- (``positions`` and ``normals`` (E, 3) in the obstacles' frame [m], ``sensitivity`` [Pa m],
  ``element_radius`` [m])
- (``board``, the name of the kind of board; ``board_positions`` (B, 3) [m] and ``board_rotations``
  (B, 3, 3) from the frame of each board to the obstacles')
- (``foci`` (F, 3) [m], ``wanted_pressures`` (F,) [Pa], ``transfer_matrix`` (F, E) [Pa per unit
  drive])
- further texts, such as ``scene`` and ``report``.
"""

import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Complex128, Float64

from airtact.acoustics.medium import Medium
from airtact.acoustics.scene import Scene
from airtact.acoustics.target import Target
from airtact.drives.transfer import TransferMatrix
from airtact.errors import (
    LARGEST_DATA,
    InvalidInput,
    about,
    check_finite,
    of_kind,
    points_of,
    positive,
    real_numbers,
)
from airtact.files.atomic import written
from airtact.files.bounded import datasets_of, text_of
from airtact.geometry.pose import Pose
from airtact.transducers.boards import kind_of_array
from airtact.transducers.layout import PhasedArray
from airtact.transducers.levels import FULL_SCALE, Levels
from airtact.transducers.modulation import AmplitudeModulation

VERSION = 1
"""Version of the format."""

ENDINGS = (".h5", ".csv")

SEQUENCE_FILE = "sequence.h5"
"""Name of the file that a run with moving foci writes beside its drive."""

COLUMNS = (
    *("index", "x", "y", "z", "nx", "ny", "nz"),
    *("amplitude", "phase", "amplitude_level", "phase_level"),
)
"""Columns of a drive's table. Positions are in metres, the rest in the units of the datasets."""

FRAME_COLUMNS = (
    *("frame", "seconds", "element"),
    *("amplitude_level", "phase_level", "amplitude", "phase"),
)
"""Columns of a sequence's table, which has one line per element and frame."""

UNITS = {
    "positions": "m",
    "amplitude": "share of full scale",
    "phase": "rad, of Re[u exp(-i omega t)]",
    "rate": "frames/s",
    "transfer_matrix": "Pa per unit drive; first axis foci, second elements",
    "foci": "m",
    "wanted_pressures": "Pa, peak",
    "modulation_frequency": "Hz",
    "modulation_depth": "share of the force",
    "sensitivity": "Pa m, uncalibrated",
    "element_radius": "m",
    "frequency": "Hz",
    "sound_speed": "m/s",
    "density": "kg/m3",
    "absorption": "Np/m",
    "board_positions": "m",
    "amplitude_level": "index into shares_of_levels",
    "phase_level": "levels_of_a_turn is a turn",
    "shares_of_levels": "share of full scale",
}


@dataclass(frozen=True, eq=False)
class DriveFile:
    """The contents of a drive or sequence file; attributes that the file lacks are None.

    Attributes
    ----------
    drives : (N, E) amplitude of each element in each frame; one frame for a drive.
    rate : frames per second of a sequence; None for a drive.
    levels : amplitudes and phases; the file also contains the drives rounded to them.
    sensitivity : peak pressure of a transducer at full scale, 1 m away on its axis [Pa·m].
    modulation : how the amplitude of a drive varies when it is emitted.
    """

    drives: Complex128[np.ndarray, "frames elements"]
    rate: float | None = None
    levels: Levels | None = None
    frequency: float | None = None
    medium: Medium | None = None
    positions: Float64[np.ndarray, "elements 3"] | None = None
    normals: Float64[np.ndarray, "elements 3"] | None = None
    sensitivity: float | None = None
    element_radius: float | None = None
    board: str | None = None
    poses: tuple[Pose, ...] | None = None
    foci: Float64[np.ndarray, "foci 3"] | None = None
    wanted_pressures: Float64[np.ndarray, "foci"] | None = None
    matrix: Complex128[np.ndarray, "foci elements"] | None = None
    texts: Mapping[str, str] = field(default_factory=dict)
    modulation: AmplitudeModulation | None = None

    def frame_rate(self, rate: float | None = None) -> float | None:
        """Return the rate if given, else the file's; None for a drive.

        Raise "data_missing" for several frames without a rate.
        """
        rate = self.rate if rate is None else rate
        if rate is None and len(self.drives) > 1:
            raise InvalidInput(
                f"{len(self.drives)} frames need a rate, in frames/s.", code="data_missing"
            )
        return rate


def save_drives(
    path: str | Path,
    drives: Complex128[np.ndarray, "frames elements"],
    rate: float | None = None,
    *,
    array: PhasedArray | None,
    scene: Scene | None,
    transfer: TransferMatrix | None,
    target: Target | None,
    levels: Levels,
    texts: Mapping[str, str] | None,
    modulation: AmplitudeModulation | None = None,
) -> None:
    """Write a sequence, or a drive, which has one frame and no rate."""
    of_kind(path, str | Path, "the file of a drive", 'its path, such as "drive.h5"')
    of_kind(levels, Levels, "the levels of a drive", "Levels.even(256, 256)")
    of_kind(modulation, AmplitudeModulation | None, "the modulation", "AmplitudeModulation(200.0)")
    contents: dict[str, Any] = {"levels": levels, "modulation": modulation, "texts": texts or {}}
    if array is not None:
        of_kind(array, PhasedArray, "the array", "one such as surrounding_box()")
        _check_count(len(array), drives.shape[1], "the array")
        contents |= {
            "positions": array.positions,
            "normals": array.normals,
            "sensitivity": array.element.sensitivity,
            "element_radius": array.element.radius,
        }
        if boards := kind_of_array(array.positions, array.normals):
            contents |= {"board": boards[0].name, "poses": tuple(boards[1])}
    if scene is not None:
        of_kind(scene, Scene, "the scene", "Scene(medium, obstacles)")
        contents |= {"frequency": scene.frequency, "medium": scene.medium}
    if transfer is not None:
        _check_count(transfer.matrix.shape[1], drives.shape[1], "the transfer matrix")
        contents["matrix"] = transfer.matrix
    if target is not None:
        of_kind(target, Target, "the target", "Target(points, pressures)")
        contents |= {"foci": target.points, "wanted_pressures": target.pressures}
    write_drive_file(Path(path), DriveFile(drives, rate, **contents))


def _check_count(count: int, elements: int, name: str) -> None:
    if count != elements:
        raise InvalidInput(
            f"{name} has {count} elements, but the drive has {elements}. Give the one that the "
            "drive was made for.",
            code="sizes_differ",
        )


def write_drive_file(path: Path, contents: DriveFile) -> None:
    """Write a file in the format of its ending.

    Raise "unknown_format", "data_missing" or "not_writable".
    """
    ending = checked_ending(path, ENDINGS, "drive")
    with written(path) as partial:
        if ending == ".csv":
            with partial.open("w", newline="", encoding="utf-8") as file:
                csv.writer(file).writerows(_table(contents))
        else:
            import h5py

            with h5py.File(partial, "w") as file:
                for name, values in _datasets(contents).items():
                    file[name] = values
                    if name in UNITS:
                        file[name].attrs["unit"] = UNITS[name]


def checked_ending(path: Path, endings: Sequence[str], kind: str) -> str:
    """Return the ending of a file in lower case; raise "unknown_format" unless it is allowed."""
    ending = path.suffix.lower()
    if ending not in endings:
        raise InvalidInput(
            f"{path.name} is not a {kind} file, which ends in {', '.join(endings)}. Bytes for a "
            "board (.bin) are written by emission.write_frames.",
            code="unknown_format",
        )
    return ending


def _datasets(contents: DriveFile) -> dict[str, Any]:
    """Return the datasets of a file by name, leaving out missing ones."""
    drives = contents.drives
    # A drive is one frame without a rate, and has no axis of frames in the file.
    if contents.rate is None and len(drives) == 1:
        drives = drives[0]
    datasets = {
        "format_version": VERSION,
        "modulation": "none",
        "amplitude": np.abs(drives),
        "phase": np.angle(drives),
        "rate": contents.rate,
        "frequency": contents.frequency,
        "positions": contents.positions,
        "normals": contents.normals,
        "sensitivity": contents.sensitivity,
        "element_radius": contents.element_radius,
        "board": contents.board,
        "foci": contents.foci,
        "wanted_pressures": contents.wanted_pressures,
        "transfer_matrix": contents.matrix,
    }
    if (modulation := contents.modulation) is not None:
        datasets |= {
            "modulation": "am",
            "modulation_frequency": modulation.frequency,
            "modulation_depth": modulation.depth,
        }
    if (levels := contents.levels) is not None:
        datasets["amplitude_level"], datasets["phase_level"] = levels.rounded(drives)
        datasets |= {"shares_of_levels": levels.amplitudes, "levels_of_a_turn": levels.phases}
    if (medium := contents.medium) is not None:
        datasets |= {
            "sound_speed": medium.sound_speed,
            "density": medium.density,
            "absorption": medium.absorption,
        }
    if (poses := contents.poses) is not None:
        datasets["board_positions"] = np.stack([pose.translation for pose in poses])
        datasets["board_rotations"] = np.stack([pose.rotation for pose in poses])
    datasets |= contents.texts
    return {name: values for name, values in datasets.items() if values is not None}


def _table(contents: DriveFile) -> Iterator[tuple[Any, ...]]:
    """Yield the lines of a table, one per element of a drive or of each frame of a sequence."""
    if contents.levels is None:
        raise InvalidInput("a table needs levels. Give them.", code="data_missing")
    amplitude_levels, phase_levels = contents.levels.rounded(contents.drives)
    positions = contents.positions
    normals = contents.normals
    of_elements = contents.rate is None and len(contents.drives) == 1
    if of_elements and positions is not None and normals is not None:
        yield COLUMNS
        for index, drive in enumerate(contents.drives[0]):
            place = [f"{number:.9g}" for number in (*positions[index], *normals[index])]
            levels = amplitude_levels[0, index], phase_levels[0, index]
            yield index, *place, f"{np.abs(drive):.9g}", f"{np.angle(drive):.9g}", *levels
        return
    yield FRAME_COLUMNS
    for frame, drives in enumerate(contents.drives):
        seconds = "" if contents.rate is None else repr(frame / contents.rate)
        for element, drive in enumerate(drives):
            levels = amplitude_levels[frame, element], phase_levels[frame, element]
            exact = f"{np.abs(drive):.9g}", f"{np.angle(drive):.9g}"
            yield frame, seconds, element, *levels, *exact


def read_drive_file(path: Path) -> DriveFile:
    """Read a drive or a sequence; only ``amplitude`` and ``phase`` must be in the file.

    Raises
    ------
    InvalidInput
        "file_missing", "file_unreadable", "unsupported_version", "data_missing", "wrong_shape",
        "not_finite", "out_of_range", or as the parts of it.
    """
    ending = checked_ending(path, ENDINGS, "drive")
    if not path.is_file():
        raise InvalidInput(f"cannot read {path}: there is no such file.", code="file_missing")
    if ending == ".h5":
        raw = datasets_of(path)
    else:
        lines = text_of(path, LARGEST_DATA).splitlines()
        with about(path.name):
            raw = _read_table(lines)
    with about(path.name):
        version = raw.get("format_version", VERSION)
        if version != VERSION:
            raise InvalidInput(
                f"the file has format version {version}, and this airtact reads version "
                f"{VERSION}: update airtact.",
                code="unsupported_version",
            )
        missing = [name for name in ("amplitude", "phase") if name not in raw]
        if missing:
            raise InvalidInput(f"the file lacks {' and '.join(missing)}.", code="data_missing")
        try:
            return _parsed(raw)
        except InvalidInput:
            raise
        # Faults that the single checks miss, such as arrays of different lengths.
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
            raise InvalidInput(
                f"its datasets do not match ({error}).", code="wrong_shape"
            ) from None


def _parsed(raw: Mapping[str, Any]) -> DriveFile:
    """Build the contents from datasets, checked one by one and against each other."""
    points: dict[str, Any] = {
        name: points_of(raw[name], name) for name in ("positions", "normals", "foci") if name in raw
    }
    count = len(points.get("positions", ()))
    if count != len(points.get("normals", ())):
        raise InvalidInput("positions and normals differ in number.", code="sizes_differ")
    drives = _drives(raw, count)
    numbers: dict[str, Any] = {
        name: positive(raw[name], words, unit)
        for name, words, unit in (
            ("rate", "the rate", "frames/s"),
            ("frequency", "the frequency", "Hz"),
            ("sensitivity", "the sensitivity of an element", "Pa·m"),
        )
        if name in raw
    }
    # In the order of the fields of ``Medium``; absorption may be missing.
    medium = [float(raw[name]) for name in ("sound_speed", "density", "absorption") if name in raw]
    levels = None
    if "shares_of_levels" in raw:
        levels = Levels(raw["shares_of_levels"], int(raw["levels_of_a_turn"]))
    poses = None
    if "board_positions" in raw:
        pairs = zip(raw["board_rotations"], raw["board_positions"], strict=True)
        poses = tuple(Pose(rotation, translation) for rotation, translation in pairs)
    modulation = None
    if (kind := raw.get("modulation", "none")) == "am":
        modulation = AmplitudeModulation(
            float(raw["modulation_frequency"]), float(raw["modulation_depth"])
        )
    elif kind != "none":
        raise InvalidInput(f"the modulation {kind!r} is neither none nor am.", code="unknown_name")
    matrix = raw.get("transfer_matrix")
    return DriveFile(
        drives,
        levels=levels,
        medium=Medium(*medium) if len(medium) > 1 else None,
        element_radius=float(raw["element_radius"]) if "element_radius" in raw else None,
        board=raw.get("board"),
        poses=poses,
        wanted_pressures=raw.get("wanted_pressures"),
        matrix=None if matrix is None else np.asarray(matrix, dtype=np.complex128),
        texts={name: raw[name] for name in ("scene", "report") if name in raw},
        modulation=modulation,
        **points,
        **numbers,
    )


def _drives(raw: Mapping[str, Any], elements: int) -> Complex128[np.ndarray, "frames elements"]:
    """Return the drives, one row per frame; ``elements`` is 0 if the file has no positions."""
    amplitude = real_numbers(np.asarray(raw["amplitude"]), "amplitude")
    phase = real_numbers(np.asarray(raw["phase"]), "phase")
    if (
        amplitude.shape != phase.shape
        or amplitude.ndim not in (1, 2)
        or amplitude.shape[-1] != (elements or amplitude.shape[-1])
    ):
        raise InvalidInput(
            f"amplitude of shape {amplitude.shape} and phase of shape {phase.shape} do not fit "
            f"{f'{elements} elements' if elements else 'each other'}.",
            code="wrong_shape",
        )
    if amplitude.size == 0:
        raise InvalidInput("the sequence has no frame.", code="empty")
    amplitude = np.atleast_2d(amplitude)
    check_finite(amplitude, "amplitude")
    check_finite(phase, "phase")
    wrong = np.argwhere((amplitude < 0.0) | (amplitude > FULL_SCALE))
    if len(wrong):
        frame, element = wrong[0].tolist()
        raise InvalidInput(
            f"amplitudes must be 0 to 1, but {len(wrong)} are not, the first "
            f"{amplitude[frame, element]:g} of element {element} in frame {frame}.",
            code="out_of_range",
        )
    return amplitude * np.exp(1j * np.atleast_2d(phase))


def _read_table(lines: list[str]) -> dict[str, Any]:
    """Return the datasets in the lines of a table; the first line names the columns."""
    columns = tuple(lines[0].split(",")) if lines else ()
    if columns not in (COLUMNS, FRAME_COLUMNS):
        raise InvalidInput(
            f"line 1 must be {','.join(COLUMNS)} or {','.join(FRAME_COLUMNS)}.",
            code="file_unreadable",
        )
    if not any(lines[1:]):
        raise InvalidInput("the table has no lines of numbers.", code="wrong_shape")
    try:
        # Without a rate frames have no time, and the second cell is empty.
        rows = np.loadtxt(
            lines[1:],
            delimiter=",",
            comments=None,
            converters={1: lambda cell: float(cell or "nan")},
            ndmin=2,
        )
    except ValueError as error:
        raise InvalidInput(f"the lines are not numbers: {error}.", code="file_unreadable") from None
    if rows.shape[1] != len(columns):
        raise InvalidInput(
            f"a line has {rows.shape[1]} cells instead of {len(columns)}.", code="wrong_shape"
        )
    by_name = dict(zip(columns, rows.T, strict=True))
    datasets = {name: by_name[name] for name in ("amplitude", "phase")}
    if columns == COLUMNS:
        return datasets | {"positions": rows[:, 1:4], "normals": rows[:, 4:7]}
    last = float(by_name["frame"].max())
    count = int(last) + 1 if 0.0 <= last < len(rows) else 0
    if count == 0 or len(rows) % count:
        raise InvalidInput(
            f"{len(rows)} lines cannot be divided evenly into the frames 0 to {last:g} that the "
            "file names.",
            code="wrong_shape",
        )
    if count == 1:
        return datasets
    datasets = {name: values.reshape(count, -1) for name, values in datasets.items()}
    end = by_name["seconds"].reshape(count, -1)[-1, 0]
    if end > 0.0:
        # The table holds times instead of the rate; twelve digits undo the rounding.
        datasets["rate"] = float(f"{(count - 1) / end:.12g}")
    return datasets
