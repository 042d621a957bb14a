"""HDF5 files of drives and sequences with all data needed to emit them, and .csv tables of drives.

Version 1 of the HDF5 files has these datasets; those in parentheses are optional:

- ``format_version``; ``modulation``: "none" if the frames are emitted unchanged, "am" for a
  drive whose amplitude varies with ``modulation_frequency`` [Hz] and ``modulation_depth``, as
  in ``AmplitudeModulation``.
- ``amplitude`` [fraction of full scale] and ``phase`` [rad, of Re[d e^{−iωt}]], not rounded:
  (E,) for a drive, (N, E) for a sequence. ``amplitude_level`` and ``phase_level`` are the same
  values rounded to levels: ``shares_of_levels`` (A,) lists the amplitudes, ``levels_of_a_turn``
  is the number of phases. A sequence also has a ``rate`` [frames/s].
- (``frequency`` [Hz], ``sound_speed`` [m/s], ``density`` [kg/m³], ``absorption`` [Np/m])
- (``positions`` and ``normals`` (E, 3) in the obstacles' frame [m], ``sensitivity`` [Pa m],
  ``element_radius`` [m])
- (``board``, the name of the kind of board; ``board_positions`` (B, 3) [m] and ``board_rotations``
  (B, 3, 3) from the frame of each board to the obstacles' frame)
- (``foci`` (F, 3) [m], ``wanted_pressures`` (F,) [Pa], ``transfer_matrix`` (F, E) [Pa per unit
  drive])
- further texts, such as ``scene`` and ``report``.
"""

import csv
from collections.abc import Mapping, Sequence
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
    InvalidInput,
    about,
    check_finite,
    of_kind,
    points_of,
    positive,
)
from airtact.files.atomic import whole_file, whole_hdf5
from airtact.files.bounded import datasets_of
from airtact.files.text_table import read_text_table
from airtact.geometry.pose import Pose
from airtact.transducers.boards import kind_of_array
from airtact.transducers.layout import PhasedArray
from airtact.transducers.levels import FULL_SCALE, AmplitudeModulation, Levels

# Version of the format.
VERSION = 1

# Name of the file that a run with moving foci writes next to its drive.
SEQUENCE_FILE = "sequence.h5"

# Columns of a drive's table. Positions are in metres; other units are those of the datasets.
COLUMNS = (
    *("index", "x", "y", "z", "nx", "ny", "nz"),
    *("amplitude", "phase", "amplitude_level", "phase_level"),
)

# Datasets that are attributes of ``DriveFile``; a file omits those that are None.
PLAIN = (
    *("rate", "frequency", "positions", "normals", "sensitivity", "element_radius", "board"),
    *("foci", "wanted_pressures", "transfer_matrix"),
)

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
    """Contents of a drive or sequence file. Attributes that the file does not contain are None.

    ``Drive.save``, ``Sequence.save`` and ``write_frames`` write such files, and ``load_drive``
    returns only their drives. ``drive_at_rest`` returns a ``DriveFile`` without writing a file.

    Attributes
    ----------
    drives : (N, E) complex amplitude of each of E elements in each of N frames; 1 is full scale. A
        single drive has one frame. The amplitudes are exact if ``save`` wrote the file, and rounded
        to levels if ``write_frames`` wrote it.
    rate : frames per second of a sequence; None for a drive.
    levels : the ``Levels`` of the boards; .h5 files also contain the drives rounded to these
        levels.
    frequency, medium : frequency of the sound [Hz], and the ``Medium`` in which it travels.
    positions, normals : (E, 3) positions [m] and (E, 3) unit normals of the elements, in the frame
        of the obstacles.
    sensitivity : peak pressure of a transducer at full scale, 1 m away on its axis [Pa·m].
    element_radius : radius of a transducer's face [m].
    board, poses : name of the kind of board, and for each board the ``Pose`` that maps its frame to
        that of ``positions``.
    foci, wanted_pressures : (F, 3) foci in the same frame [m], and (F,) requested peak pressures
        [Pa].
    transfer_matrix : (F, E) complex pressure at each focus per unit drive of each element [Pa].
        Rows of suppression points, if any, follow those of the foci.
    texts : texts by name, such as "scene" for the text of the scene file; empty if there are none.
    modulation : the ``AmplitudeModulation`` applied to a drive during emission; None for a constant
        drive or a sequence.
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
    transfer_matrix: Complex128[np.ndarray, "foci elements"] | None = None
    texts: Mapping[str, str] = field(default_factory=dict)
    modulation: AmplitudeModulation | None = None

    def frame_rate(self, rate: float | None = None) -> float | None:
        """Return ``rate`` if it is not None, and otherwise the rate in the file.

        The result can be None for a single drive. If there are several frames but no rate, the
        method raises ``InvalidInput`` with the code "data_missing".
        """
        rate = self.rate if rate is None else rate
        if rate is None and len(self.drives) > 1:
            raise InvalidInput(
                f"a sequence of {len(self.drives)} frames requires a rate. Pass rate in frames per "
                "second.",
                code="data_missing",
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
    """Write drives (N, E) to a file as a sequence, or as a single drive if ``rate`` is None."""
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
        contents["transfer_matrix"] = transfer.matrix
    if target is not None:
        of_kind(target, Target, "the target", "Target(points, pressures)")
        contents |= {"foci": target.points, "wanted_pressures": target.pressures}
    write_drive_file(Path(path), DriveFile(drives, rate, **contents))


def _check_count(count: int, elements: int, name: str) -> None:
    if count != elements:
        raise InvalidInput(
            f"{name} has {count} elements, but the drive has {elements}. Pass the array and the "
            "transfer matrix for which the drive was computed.",
            code="sizes_differ",
        )


def write_drive_file(path: Path, contents: DriveFile) -> None:
    """Write a drive or a sequence (.h5), or a table of the elements of a drive (.csv).

    The function raises ``InvalidInput`` if the ending of the file name is unknown, if data is
    missing, or if the file cannot be written.
    """
    if checked_ending(path, (".h5", ".csv"), "drive") == ".csv":
        with whole_file(path) as partial:
            _write_table(partial, contents)
        return
    with whole_hdf5(path) as file:
        for name, values in _datasets(contents).items():
            file[name] = values
            if name in UNITS:
                file[name].attrs["unit"] = UNITS[name]


def checked_ending(path: Path, endings: Sequence[str], kind: str) -> str:
    """Return the lower-case ending of a file name after checking that it is an allowed ending."""
    ending = path.suffix.lower()
    if ending not in endings:
        raise InvalidInput(
            f"{path.name} is not the name of a {kind} file: it must end in {' or '.join(endings)}. "
            "To write bytes for a board (.bin), use emission.write_frames.",
            code="unknown_format",
        )
    return ending


def _write_table(path: Path, contents: DriveFile) -> None:
    positions = contents.positions
    normals = contents.normals
    levels = contents.levels
    if positions is None or normals is None or levels is None or contents.rate is not None:
        raise InvalidInput(
            "a .csv file lists a drive together with the positions of its elements. Pass the "
            "array, or save a .h5 file.",
            code="data_missing",
        )
    (drive,) = contents.drives
    places = np.column_stack([positions, normals, np.abs(drive), np.angle(drive)])
    rounded = zip(*levels.rounded(drive), strict=True)
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(COLUMNS)
        for index, (numbers, pair) in enumerate(zip(places, rounded, strict=True)):
            table.writerow([index, *(f"{number:.9g}" for number in numbers), *pair])


def _datasets(contents: DriveFile) -> dict[str, Any]:
    drives = contents.drives
    # A drive is stored as one frame without a rate, so its arrays have no frame axis.
    if contents.rate is None and len(drives) == 1:
        drives = drives[0]
    datasets = {
        "format_version": VERSION,
        "modulation": "none",
        "amplitude": np.abs(drives),
        "phase": np.angle(drives),
        **{name: getattr(contents, name) for name in PLAIN},
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


# Datasets that are read, with their types and shapes: "elements" stands for the number of elements.
LAYOUT = {
    "format_version": "optional whole",
    "modulation": "optional text",
    "modulation_frequency": "optional real",
    "modulation_depth": "optional real",
    "amplitude": "real (frames) elements",
    "phase": "real (frames) elements",
    "shares_of_levels": "optional real levels",
    "levels_of_a_turn": "optional whole",
    "rate": "optional real",
    "frequency": "optional real",
    "sound_speed": "optional real",
    "density": "optional real",
    "absorption": "optional real",
    "positions": "optional real elements 3",
    "normals": "optional real elements 3",
    "sensitivity": "optional real",
    "element_radius": "optional real",
    "board": "optional text",
    "board_positions": "optional real boards 3",
    "board_rotations": "optional real boards 3 3",
    "foci": "optional real foci 3",
    "wanted_pressures": "optional real foci",
    "transfer_matrix": "optional complex foci elements",
    "scene": "optional text",
    "report": "optional text",
}


def read_drive_file(path: Path) -> DriveFile:
    """Read a drive or a sequence (.h5), or the table of a drive (.csv).

    A file must contain ``amplitude`` and ``phase``; a table must also contain ``index``.

    Raises
    ------
    InvalidInput
        If the file is missing or unreadable, was written by a newer version of airtact, lacks a
        dataset, or contains invalid values.
    """
    if checked_ending(path, (".h5", ".csv"), "drive") == ".csv":
        table = read_text_table(path)
        table.require("index", "amplitude", "phase")
        order = table.order("index")
        raw = {name: table.numbers(name)[order] for name in ("amplitude", "phase")}
        for name, columns in (("positions", ("x", "y", "z")), ("normals", ("nx", "ny", "nz"))):
            if set(columns) <= set(table.names):
                raw[name] = np.stack([table.numbers(column)[order] for column in columns], axis=1)
    else:
        raw = datasets_of(path, LAYOUT, VERSION)
    with about(path.name):
        try:
            return _parsed(raw)
        except KeyError as missing:
            raise InvalidInput(
                f"the file lacks the dataset {missing}, which its other datasets require.",
                code="data_missing",
            ) from None


def _parsed(raw: Mapping[str, Any]) -> DriveFile:
    """Build the contents from datasets, after checking each of them and their consistency."""
    points = {
        name: points_of(raw[name], name) for name in ("positions", "normals", "foci") if name in raw
    }
    if ("positions" in raw) != ("normals" in raw):
        raise InvalidInput("pass both positions and normals, or neither.", code="data_missing")
    numbers: dict[str, Any] = {
        name: positive(raw[name], words, unit)
        for name, words, unit in (
            ("rate", "the rate", "frames/s"),
            ("frequency", "the frequency", "Hz"),
            ("sensitivity", "the sensitivity of an element", "Pa·m"),
        )
        if name in raw
    }
    medium = (
        Medium(raw["sound_speed"], raw["density"], raw.get("absorption", 0.0))
        if "sound_speed" in raw and "density" in raw
        else None
    )
    levels = (
        Levels(raw["shares_of_levels"], raw["levels_of_a_turn"])
        if "shares_of_levels" in raw
        else None
    )
    poses = (
        tuple(map(Pose, raw["board_rotations"], raw["board_positions"]))
        if "board_positions" in raw
        else None
    )
    modulation = None
    if (kind := raw.get("modulation", "none")) == "am":
        modulation = AmplitudeModulation(raw["modulation_frequency"], raw["modulation_depth"])
    elif kind != "none":
        raise InvalidInput(
            f"the modulation is {kind!r}, but it must be 'none' or 'am'.", code="unknown_name"
        )
    for name in ("wanted_pressures", "transfer_matrix"):
        if name in raw:
            check_finite(raw[name], name)
    return DriveFile(
        _drives(raw["amplitude"], raw["phase"]),
        levels=levels,
        medium=medium,
        element_radius=raw.get("element_radius"),
        board=raw.get("board"),
        poses=poses,
        wanted_pressures=raw.get("wanted_pressures"),
        transfer_matrix=raw.get("transfer_matrix"),
        texts={name: raw[name] for name in ("scene", "report") if name in raw},
        modulation=modulation,
        **points,
        **numbers,
    )


def _drives(
    amplitude: Float64[np.ndarray, "*frames elements"],
    phase: Float64[np.ndarray, "*frames elements"],
) -> Complex128[np.ndarray, "frames elements"]:
    if amplitude.shape != phase.shape:
        raise InvalidInput(
            f"amplitude has shape {amplitude.shape}, but phase has shape {phase.shape}. Give one "
            "phase for each amplitude.",
            code="wrong_shape",
        )
    if amplitude.size == 0:
        raise InvalidInput(
            "amplitude is empty, but a drive needs at least one frame and one element.",
            code="empty",
        )
    amplitude = np.atleast_2d(amplitude)
    check_finite(amplitude, "amplitude")
    check_finite(phase, "phase")
    wrong = np.argwhere((amplitude < 0.0) | (amplitude > FULL_SCALE))
    if len(wrong):
        frame, element = wrong[0].tolist()
        raise InvalidInput(
            f"amplitudes must be between 0 and 1, but {len(wrong)} are not. The first is "
            f"{amplitude[frame, element]:g}, for element {element} in frame {frame}.",
            code="out_of_range",
        )
    return amplitude * np.exp(1j * np.atleast_2d(phase))
