"""The gain of each transducer relative to a nominal one, and how far off its position it stands, from a table."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Complex128
from scipy.spatial.transform import Rotation

from airtact.checks import counted, of_kind
from airtact.errors import InvalidInput, about
from airtact.files.atomic import whole_file
from airtact.files.text_table import TextTable, read_text_table
from airtact.geometry.pose import Pose
from airtact.transducers.layout import PhasedArray

COLUMNS = ("element", "gain", "phase")
"""Columns of the table: index from 0, amplitude over the wanted one, phase by which it lags [rad]."""

MOTION = ("x", "y", "z", "turn_x", "turn_y", "turn_z")
"""Further columns, all or none: how far the element stands off its position [m], and the turn of its face [rad]."""

LARGEST_GAIN = 10.0
"""Gains over this are probably in per cent."""

FARTHEST = 0.1
"""Elements that stand farther off their position were given in millimetres [m]."""


def load_calibration(path: str | Path, elements: int) -> Complex128[np.ndarray, "elements"]:
    """Read the gains of an array's elements from a .csv file.

    Its columns are ``element``, ``gain`` and ``phase``: the index of an element from 0, its
    pressure over that of a nominal one, and the phase by which it lags behind a nominal one [rad].
    Gain 0 is a dead element. Elements that are not listed are nominal.

    Parameters
    ----------
    path : the file.
    elements : how many elements the array has.

    Returns
    -------
    (E,) gain · e^{i phase}, for ``PhasedArray.calibrated``.

    Raises
    ------
    InvalidInput
        If the file cannot be read, a column is missing, or a line holds a cell that is not a number, an element that
        does not exist or appeared before, or a gain that is negative or over 10; the sentence holds the line.
    """
    path = Path(of_kind(path, str | Path, "the calibration", "the path of a .csv file"))
    table = read_text_table(path)
    table.require(*COLUMNS)
    indices, levels, phases = (table.numbers(name) for name in COLUMNS)
    gains = np.ones(elements, dtype=np.complex128)
    seen: dict[int, int] = {}
    for line, index, gain, phase in zip(table.lines, indices, levels, phases, strict=True):
        with about(f"line {line} of {path.name}"):
            element = _element(index, elements)
            if element in seen:
                raise InvalidInput(
                    f"element {element} was given in line {seen[element]} already.",
                    code="given_twice",
                )
            if not 0.0 <= gain <= LARGEST_GAIN:
                raise InvalidInput(
                    f"gain {gain:g} of element {element} must be 0 to {LARGEST_GAIN:g}.",
                    code="out_of_range",
                )
            seen[element], gains[element] = line, gain * np.exp(1j * phase)
    return gains


def calibrated_by(path: str | Path, array: PhasedArray) -> PhasedArray:
    """Give an array the gains of a calibration, and the positions and angles of its elements where it has these.

    Parameters
    ----------
    path : file as of ``load_calibration``. Its further columns x, y, z [m] say how far an element
        stands off its position, and turn_x, turn_y, turn_z [rad], the vector of a turn, how its
        face is turned there, in the array's frame; 0 for elements that are not listed.
    array : as it was drawn.

    Raises
    ------
    InvalidInput
        As ``load_calibration``; "out_of_range": an element is 0.1 m off or turned by half a turn, or more.
    """
    gains = load_calibration(path, len(array))
    table = read_text_table(Path(path))
    if not any(name in table.names for name in MOTION):
        return array.calibrated(gains)
    motions = np.zeros((len(array), 6))
    motions[table.numbers(COLUMNS[0]).astype(np.int64)] = np.stack(
        [table.numbers(name) for name in MOTION], axis=1
    )
    _check_motions(table, Path(path).name)
    turns = Rotation.from_rotvec(motions[:, 3:])
    return PhasedArray(
        array.positions + motions[:, :3],
        turns.apply(array.normals.copy()),
        array.element,
        turns.apply(array.tangents.copy()),
        gains,
    )


def _check_motions(table: TextTable, name: str) -> None:
    """Raise "out_of_range" for positions in millimetres and turns in degrees."""
    for names, most, unit in ((MOTION[:3], FARTHEST, "m"), (MOTION[3:], np.pi, "rad")):
        for column in names:
            values = np.abs(table.numbers(column))
            if values.max(initial=0.0) >= most:
                row = int(values.argmax())
                raise InvalidInput(
                    f"line {table.lines[row]} of {name} has {values[row]:g} {unit} for {column}, and {most:.3g} is too "
                    "far: give metres and radians.",
                    code="out_of_range",
                )


def save_calibration(
    path: str | Path,
    gains: Complex128[np.ndarray, "elements"],
    off: Sequence[Pose],
    array: PhasedArray,
) -> None:
    """Write gains (E,) and a rigid motion of each element of an array as a table that ``calibrated_by`` reads.

    Raises
    ------
    InvalidInput
        "unknown_format" for another one than .csv, "not_writable".
    """
    path = Path(of_kind(path, str | Path, "the calibration", "the path of a .csv file"))
    if path.suffix.lower() != ".csv":
        raise InvalidInput(
            f"{path.name} is no calibration: its ending must be .csv.", code="unknown_format"
        )
    places = np.stack(
        [pose.apply(point) - point for pose, point in zip(off, array.positions, strict=True)]
    )
    turns = Rotation.from_matrix(np.stack([pose.rotation for pose in off])).as_rotvec()
    numbers = np.column_stack([np.abs(gains), np.angle(gains), places, turns])
    rows = [
        f"{index}," + ",".join(f"{value:.9g}" for value in row) for index, row in enumerate(numbers)
    ]
    try:
        with whole_file(path) as partial:
            partial.write_text(
                "\n".join([",".join((*COLUMNS, *MOTION)), *rows]) + "\n", encoding="utf-8"
            )
    except OSError as error:
        raise InvalidInput(
            f"cannot write {path}: {error.strerror} (error {error.errno}).",
            code="not_writable",
        ) from None


def _element(index: float, elements: int) -> int:
    if index != int(index):
        raise InvalidInput(f"element {index:g} is not a whole number.", code="not_a_number")
    if not 0 <= index < elements:
        raise InvalidInput(
            f"there is no element {index:g} among {counted(elements, 'element', 'elements')}.",
            code="unknown_name",
        )
    return int(index)
