"""Drives and sequences in files that hold all that emitting them needs: HDF5, NumPy's .npz, or a table to read.

Version 1 holds these datasets, those in brackets only where they are known:

- ``format_version``; ``modulation``: "none" where the frames are emitted as they are, "am" for a
  drive whose amplitude varies with ``modulation_frequency`` [Hz] and ``modulation_depth``, as
  ``AmplitudeModulation`` has it.
- ``amplitude`` [share of full scale] and ``phase`` [rad, of Re[d e^{−iωt}]]: (E,) for a drive, (N,
  E) for a sequence, and the same in levels as ``amplitude_level`` and ``phase_level``;
  ``shares_of_levels`` (A,) and ``levels_of_a_turn`` are what these numbers stand for. A sequence
  has its ``rate`` [frames/s].
- (``frequency`` [Hz], ``sound_speed`` [m/s], ``density`` [kg/m³], ``absorption`` [Np/m])
- (``positions`` and ``normals`` (E, 3) in the obstacles' frame [m], ``sensitivity`` [Pa m],
    ``element_radius`` [m])
- (``board``, the name of the kind of board; ``board_positions`` (B, 3) [m] and ``board_rotations``
  (B, 3, 3) from the frame of each board to the obstacles')
- (``foci`` (F, 3) [m], ``wanted_pressures`` (F,) [Pa], ``transfer_matrix`` (F, E) [Pa per unit
    drive])
- further texts, such as ``scene`` and ``report``, which nothing is read from.

Files of version 0 have no ``format_version``; their frequency and medium stand in the text of the
scene file alone.
"""

import csv
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Complex128, Float64, Real, UInt8

from airtact.acoustics.medium import Medium, air
from airtact.acoustics.scene import Scene
from airtact.acoustics.target import Target
from airtact.checks import check_finite, of_kind, points_of, positive, real_numbers
from airtact.errors import LARGEST_DATA, InvalidInput, about
from airtact.files.atomic import whole_file
from airtact.files.bounded import arrays_of, datasets_of, text_of
from airtact.geometry.pose import Pose
from airtact.transducers.boards import kind_of_array
from airtact.transducers.layout import PhasedArray
from airtact.transducers.levels import FULL_SCALE, Levels
from airtact.transducers.modulation import AmplitudeModulation

VERSION = 1
"""Version of the format that is written; those up to it are read."""

ENDINGS = (".h5", ".npz", ".csv")

SEQUENCE_FILE = "sequence.h5"
"""What a run writes beside its drive where the foci move."""

COLUMNS = (
    "index",
    "x",
    "y",
    "z",
    "nx",
    "ny",
    "nz",
    "amplitude",
    "phase",
    "amplitude_level",
    "phase_level",
)
"""Columns of a drive's table: metres, a share of full scale, radians of Re[d e^{−iωt}], and levels."""

FRAME_COLUMNS = (
    "frame",
    "seconds",
    "element",
    "amplitude_level",
    "phase_level",
    "amplitude",
    "phase",
)
"""Columns of a sequence's table, one line for each element in each frame; ``seconds`` is empty without a rate."""

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
    """What a file holds of a drive or a sequence, as the datasets above; what it does not hold is None.

    Attributes
    ----------
    drives : (N, E) what each element emits in each frame; one frame for a drive.
    rate : frames a second of a sequence; None for a drive.
    sensitivity : peak pressure of a transducer at full scale, 1 m away on its axis [Pa·m].
    modulation : how the amplitude of a drive varies when it is emitted.
    """

    drives: Complex128[np.ndarray, "frames elements"]
    rate: float | None = None
    amplitude_level: UInt8[np.ndarray, "frames elements"] | None = None
    phase_level: UInt8[np.ndarray, "frames elements"] | None = None
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

    def frame_rate(self, given: float | None = None) -> float | None:
        """Return the given rate, or the file's; None for a drive. Raise "data_missing" for several frames without."""
        rate = self.rate if given is None else given
        if rate is None and len(self.drives) > 1:
            raise InvalidInput(
                f"{len(self.drives)} frames need a rate, in frames/s.", code="data_missing"
            )
        return rate


def save_drives(
    path: str | Path,
    drives: Complex128[np.ndarray, "frames elements"],
    rate: float | None,
    array: PhasedArray | None,
    scene: Scene | None,
    matrix: Complex128[np.ndarray, "foci columns"] | None,
    target: Target | None,
    levels: Levels,
    texts: Mapping[str, str] | None,
    modulation: AmplitudeModulation | None = None,
) -> None:
    """Write what ``Drive.save`` and ``Sequence.save`` are given; a drive is one frame without a rate."""
    of_kind(path, str | Path, "the file of a drive", 'its path, such as "drive.h5"')
    of_kind(levels, Levels, "the levels of a drive", "Levels.even(256, 256)")
    known: dict[str, Any] = {}
    if modulation is not None:
        of_kind(
            modulation,
            AmplitudeModulation,
            "the modulation",
            "AmplitudeModulation(frequency, depth)",
        )
        known["modulation"] = modulation
    elements = drives.shape[1]
    if array is not None:
        of_kind(array, PhasedArray, "the array", "one such as surrounding_box()")
        _check_count(len(array), elements, "the array")
        known |= {"positions": array.positions, "normals": array.normals}
        if found := kind_of_array(array.positions, array.normals):
            known |= {"board": found[0].name, "poses": tuple(found[1])}
        known |= {"sensitivity": array.element.sensitivity, "element_radius": array.element.radius}
    if scene is not None:
        of_kind(scene, Scene, "the scene", "Scene(medium, obstacles)")
        known |= {"frequency": scene.frequency, "medium": scene.medium}
    if matrix is not None:
        _check_count(matrix.shape[1], elements, "the transfer matrix")
        known["matrix"] = matrix
    if target is not None:
        of_kind(target, Target, "the target", "Target(points, pressures)")
        known |= {"foci": target.points, "wanted_pressures": target.pressures}
    amplitude, phase = levels.rounded(drives)
    write_drive_file(
        Path(path), DriveFile(drives, rate, amplitude, phase, levels, texts=texts or {}, **known)
    )


def _check_count(there: int, elements: int, what: str) -> None:
    if there != elements:
        raise InvalidInput(
            f"{what} has {there} elements, and the drive {elements}: give the one that it was made for.",
            code="sizes_differ",
        )


def write_drive_file(path: Path, what: DriveFile) -> None:
    """Write a file in the format of its ending; raise "unknown_format", "data_missing" or "not_writable"."""
    kind = checked_ending(path, ENDINGS, "drive")
    with written(path) as partial:
        if kind == ".csv":
            with partial.open("w", newline="", encoding="utf-8") as file:
                csv.writer(file).writerows(_table(what))
        elif kind == ".npz":
            with partial.open("wb") as file:
                np.savez_compressed(file, allow_pickle=False, **dict(_columns(what)))
        else:
            _write_h5(partial, what)


@contextmanager
def written(path: Path) -> Iterator[Path]:
    """Write a file as ``whole_file`` does; raise "not_writable" where that is impossible."""
    if not path.parent.is_dir():
        raise InvalidInput(
            f"{path.name} cannot be written: there is no folder {path.parent}; make it first.",
            code="not_writable",
        )
    try:
        with whole_file(path) as partial:
            yield partial
    except OSError as error:
        reason = error.strerror or str(error)
        raise InvalidInput(
            f"cannot write {path}: {reason} (error {error.errno}).", code="not_writable"
        ) from None


def checked_ending(path: Path, endings: Sequence[str], kind: str) -> str:
    """Return the ending of a file of drives or frames in small letters; raise "unknown_format" for another one."""
    ending = path.suffix.lower()
    if ending not in endings:
        raise InvalidInput(
            f"{path.name} is none of the {len(endings)} kinds of {kind} files: {', '.join(endings)}; bytes for a board "
            "(.bin) are written by airtact export and emission.FileLink.",
            code="unknown_format",
        )
    return ending


def _write_h5(path: Path, what: DriveFile) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        for name, values in _columns(what):
            file[name] = values
            if name in UNITS:
                file[name].attrs["unit"] = UNITS[name]


def _columns(what: DriveFile) -> Iterator[tuple[str, Any]]:
    """Yield each dataset that is known, by its name."""
    drives = what.drives[0] if what.rate is None and len(what.drives) == 1 else what.drives
    levels, medium, modulation = what.levels, what.medium, what.modulation
    columns = {
        "format_version": VERSION,
        "modulation": "none" if modulation is None else "am",
        "modulation_frequency": None if modulation is None else modulation.frequency,
        "modulation_depth": None if modulation is None else modulation.depth,
        "amplitude": np.abs(drives),
        "phase": np.angle(drives),
        "amplitude_level": None
        if what.amplitude_level is None
        else what.amplitude_level.reshape(drives.shape),
        "phase_level": None if what.phase_level is None else what.phase_level.reshape(drives.shape),
        "shares_of_levels": None if levels is None else levels.amplitudes,
        "levels_of_a_turn": None if levels is None else levels.phases,
        "rate": what.rate,
        "frequency": what.frequency,
        "sound_speed": None if medium is None else medium.sound_speed,
        "density": None if medium is None else medium.density,
        "absorption": None if medium is None else medium.absorption,
        "positions": what.positions,
        "normals": what.normals,
        "sensitivity": what.sensitivity,
        "element_radius": what.element_radius,
        "board": what.board,
        "board_positions": None
        if what.poses is None
        else np.stack([pose.translation for pose in what.poses]),
        "board_rotations": None
        if what.poses is None
        else np.stack([pose.rotation for pose in what.poses]),
        "foci": what.foci,
        "wanted_pressures": what.wanted_pressures,
        "transfer_matrix": what.matrix,
        **what.texts,
    }
    yield from ((name, values) for name, values in columns.items() if values is not None)


def _table(what: DriveFile) -> Iterator[tuple[Any, ...]]:
    if what.amplitude_level is None or what.phase_level is None:
        raise InvalidInput(
            "a table of 0 levels cannot be written: give levels.", code="data_missing"
        )
    levels = zip(what.amplitude_level, what.phase_level, strict=True)
    if (
        what.rate is None
        and len(what.drives) == 1
        and what.positions is not None
        and what.normals is not None
    ):
        yield COLUMNS
        ((amplitude_level, phase_level),) = levels
        for index, drive in enumerate(what.drives[0]):
            place = [f"{number:.9g}" for number in (*what.positions[index], *what.normals[index])]
            exact = f"{np.abs(drive):.9g}", f"{np.angle(drive):.9g}"
            yield index, *place, *exact, int(amplitude_level[index]), int(phase_level[index])
        return
    yield FRAME_COLUMNS
    for frame, (drives, (amplitude_level, phase_level)) in enumerate(
        zip(what.drives, levels, strict=True)
    ):
        seconds = "" if what.rate is None else repr(frame / what.rate)
        for element, drive in enumerate(drives):
            exact = f"{np.abs(drive):.9g}", f"{np.angle(drive):.9g}"
            yield (
                frame,
                seconds,
                element,
                int(amplitude_level[element]),
                int(phase_level[element]),
                *exact,
            )


def read_drive_file(path: Path) -> DriveFile:
    """Read a drive or a sequence from a file of version 0 or 1; only ``amplitude`` and ``phase`` must be there.

    Raises
    ------
    InvalidInput
        "file_missing", "file_unreadable", "unsupported_version", "data_missing", "wrong_shape", "not_finite",
        "out_of_range", or as the parts of it.
    """
    kind = checked_ending(path, ENDINGS, "drive")
    if not path.is_file():
        raise InvalidInput(f"cannot read {path}: there is no such file.", code="file_missing")
    raw = {".h5": datasets_of, ".npz": _npz, ".csv": _read_table}[kind](path)
    with about(path.name):
        version = raw.get("format_version", 0)
        if not isinstance(version, int | np.integer) or version not in range(VERSION + 1):
            raise InvalidInput(
                f"the file is of version {version}, and versions 0 to {VERSION} are read: update airtact.",
                code="unsupported_version",
            )
        missing = [name for name in ("amplitude", "phase") if name not in raw]
        if missing:
            raise InvalidInput(
                f"{len(missing)} of the 2 datasets of a drive are missing: {', '.join(missing)}.",
                code="data_missing",
            )
        try:
            return _checked(raw, int(version))
        except InvalidInput:
            raise
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
            raise InvalidInput(
                f"its datasets do not fit each other ({error}).", code="wrong_shape"
            ) from None


def _checked(raw: Mapping[str, Any], version: int) -> DriveFile:
    amplitude, phase = (
        real_numbers(np.asarray(raw[name]), name) for name in ("amplitude", "phase")
    )
    positions, normals, foci = (
        points_of(raw[name], name) if name in raw else None
        for name in ("positions", "normals", "foci")
    )
    drives = _drives(amplitude, phase, None if positions is None else len(positions))
    count = [0 if points is None else len(points) for points in (positions, normals)]
    if count[0] != count[1]:
        raise InvalidInput(f"{count[0]} positions have {count[1]} normals.", code="sizes_differ")
    frequency, medium = _medium_0(raw.get("scene")) if version == 0 else _medium(raw)
    poses = None
    if "board_positions" in raw:
        poses = tuple(
            Pose(*pair) for pair in zip(raw["board_rotations"], raw["board_positions"], strict=True)
        )
    levels = (
        Levels(raw["shares_of_levels"], int(raw["levels_of_a_turn"]))
        if "shares_of_levels" in raw
        else None
    )
    rounded = [_levels_in(raw, name, drives.shape) for name in ("amplitude_level", "phase_level")]
    return DriveFile(
        drives,
        _positive_in(raw, "rate", "the rate", "frames/s"),
        *rounded,
        levels=levels,
        frequency=frequency,
        medium=medium,
        positions=positions,
        normals=normals,
        sensitivity=_positive_in(raw, "sensitivity", "the sensitivity of an element", "Pa·m"),
        element_radius=float(raw["element_radius"]) if "element_radius" in raw else None,
        board=raw.get("board"),
        poses=poses,
        foci=foci,
        wanted_pressures=raw.get("wanted_pressures"),
        matrix=np.asarray(raw["transfer_matrix"], dtype=np.complex128)
        if "transfer_matrix" in raw
        else None,
        texts={name: raw[name] for name in ("scene", "report") if name in raw},
        modulation=_modulation(raw),
    )


def _levels_in(
    raw: Mapping[str, Any], name: str, shape: tuple[int, ...]
) -> UInt8[np.ndarray, "frames elements"] | None:
    """Return levels from 0 to 255, one for each element in each frame; None where there are none."""
    if name not in raw:
        return None
    given = real_numbers(np.asarray(raw[name]), name).reshape(shape)
    wrong = ~((given >= 0.0) & (given <= 255.0) & (given == np.trunc(given)))
    if wrong.any():
        sentence = f"{name} holds {given[wrong][0]:g}, but levels are whole numbers from 0 to 255."
        raise InvalidInput(sentence, code="out_of_range")
    return given.astype(np.uint8)


def _modulation(raw: Mapping[str, Any]) -> AmplitudeModulation | None:
    kind = raw.get("modulation", "none")
    if kind == "none":
        return None
    if kind != "am":
        raise InvalidInput(f"the modulation {kind!r} is none of 2: none, am.", code="unknown_name")
    return AmplitudeModulation(float(raw["modulation_frequency"]), float(raw["modulation_depth"]))


def _positive_in(raw: Mapping[str, Any], name: str, what: str, unit: str) -> float | None:
    return positive(raw[name], what, unit) if name in raw else None


def _drives(
    amplitude: Real[np.ndarray, "*amplitudes"],
    phase: Real[np.ndarray, "*phases"],
    elements: int | None,
) -> Complex128[np.ndarray, "frames elements"]:
    """Return complex drives, one row a frame, of numbers that a drive can have."""
    if (
        amplitude.shape != phase.shape
        or amplitude.ndim not in (1, 2)
        or amplitude.shape[-1] != (elements or amplitude.shape[-1])
    ):
        raise InvalidInput(
            f"amplitude of shape {amplitude.shape} and phase of shape {phase.shape} do not fit "
            f"{'each other' if elements is None else f'{elements} elements'}.",
            code="wrong_shape",
        )
    if amplitude.size == 0:
        raise InvalidInput("the sequence has 0 frames.", code="empty")
    amplitude, phase = np.atleast_2d(amplitude), np.atleast_2d(phase)
    check_finite(amplitude, "amplitude")
    check_finite(phase, "phase")
    bad = np.argwhere((amplitude < 0.0) | (amplitude > FULL_SCALE))
    if len(bad):
        frame, element = (int(index) for index in bad[0])
        raise InvalidInput(
            f"an amplitude must be 0 to 1, but {len(bad)} are not, the first {amplitude[frame, element]:g} of element "
            f"{element} in frame {frame}.",
            code="out_of_range",
        )
    return amplitude * np.exp(1j * phase)


def _medium(raw: Mapping[str, Any]) -> tuple[float | None, Medium | None]:
    numbers = [float(raw[name]) for name in ("sound_speed", "density", "absorption") if name in raw]
    return _positive_in(raw, "frequency", "the frequency", "Hz"), Medium(*numbers) if len(
        numbers
    ) > 1 else None


def _medium_0(scene: str | None) -> tuple[float | None, Medium | None]:
    """Take frequency and medium from the scene's text as version 0 had it; later keys of scenes play no part."""
    if scene is None:
        return None, None
    try:
        tables = tomllib.loads(scene)
        frequency = positive(tables.get("frequency", 40e3), "the frequency", "Hz")
        medium = tables.get("medium", {})
        if "sound_speed" in medium:
            return frequency, Medium(
                medium["sound_speed"], medium["density"], medium.get("absorption", 0.0)
            )
        weather = {name: medium[name] for name in ("celsius", "humidity") if name in medium}
    except InvalidInput:
        raise
    except (AttributeError, LookupError, RecursionError, TypeError, ValueError) as error:
        raise InvalidInput(
            f"this is version 0, whose frequency stands in the scene's text alone, and that cannot be read: {error}.",
            code="file_unreadable",
        ) from None
    return frequency, air(**weather, frequency=frequency)


def _npz(path: Path) -> dict[str, Any]:
    return {name: one.item() if one.ndim == 0 else one for name, one in arrays_of(path).items()}


def _read_table(path: Path) -> dict[str, Any]:
    lines = text_of(path, LARGEST_DATA).splitlines() or [""]
    with about(path.name):
        columns = tuple(lines[0].split(","))
        if columns not in (COLUMNS, FRAME_COLUMNS):
            sentence = f"line 1 must be {','.join(COLUMNS)} or {','.join(FRAME_COLUMNS)}."
            raise InvalidInput(sentence, code="file_unreadable")
        return _columns_of(columns, _rows(lines, len(columns)))


def _rows(lines: Sequence[str], columns: int) -> Float64[np.ndarray, "rows columns"]:
    """Read the numbers in all lines but the first; empty cells are NaN, levels and frames small whole numbers."""

    def cells() -> Iterator[float]:
        for number, line in enumerate(lines[1:], start=2):
            if line and line.count(",") != columns - 1:
                sentence = f"line {number} has {line.count(',') + 1} cells, and each needs {columns} cells."
                raise InvalidInput(sentence, code="wrong_shape")
            for cell in line.split(",") if line else ():
                try:
                    yield float(cell or "nan")
                except ValueError:
                    sentence = (
                        f"line {number} has the cell {cell!r}, which cannot be read as a number."
                    )
                    raise InvalidInput(sentence, code="file_unreadable") from None

    rows = np.fromiter(cells(), dtype=np.float64).reshape(-1, columns)
    if not len(rows):
        raise InvalidInput("the table has 0 lines of numbers.", code="wrong_shape")
    return rows


def _columns_of(
    columns: tuple[str, ...], rows: Float64[np.ndarray, "rows columns"]
) -> dict[str, Any]:
    named = dict(zip(columns, rows.T, strict=True))
    last = 0.0 if columns == COLUMNS else float(named["frame"].max())
    if not 0.0 <= last < len(rows):
        raise InvalidInput(
            f"frame {last:g} is there, but {len(rows)} lines hold fewer.", code="wrong_shape"
        )
    count = int(last) + 1
    if len(rows) % count:
        raise InvalidInput(
            f"{len(rows)} lines are not {count} frames of one length.", code="wrong_shape"
        )
    shape = (len(rows),) if columns == COLUMNS else (count, -1)
    numbers = ("amplitude", "phase", "amplitude_level", "phase_level")
    raw: dict[str, Any] = {name: named[name].reshape(shape) for name in numbers}
    if columns == COLUMNS:
        return raw | {"positions": rows[:, 1:4], "normals": rows[:, 4:7]}
    seconds = named["seconds"].reshape(shape)[:, 0]
    if count > 1 and seconds[-1] > 0.0:
        raw["rate"] = float(f"{(count - 1) / seconds[-1]:.12g}")
    elif count == 1:
        raw |= {name: raw[name][0] for name in tuple(raw)}
    return raw
