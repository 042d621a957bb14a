"""Tables of the gain and position error of each transducer."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Complex128
from scipy.spatial.transform import Rotation

from airtact.errors import InvalidInput, about, of_kind
from airtact.files.atomic import whole_file
from airtact.files.text_table import read_text_table
from airtact.geometry.pose import Pose
from airtact.transducers.layout import PhasedArray

# Columns of the table: index from 0, amplitude relative to a nominal element, phase lag [rad].
COLUMNS = ("element", "gain", "phase")

# Optional columns, all or none: displacement of the element [m], and rotation of its face [rad].
MOTION = ("x", "y", "z", "turn_x", "turn_y", "turn_z")


def load_calibration(path: str | Path, elements: int) -> Complex128[np.ndarray, "elements"]:
    """Read the gains of an array's elements from a .csv file.

    The columns are ``element``, ``gain`` and ``phase``: the index of an element from 0, its
    pressure relative to that of a nominal element (0 to 10), and its phase lag behind a nominal
    element [rad]. A gain of 0 marks a dead element. Elements that are not listed are nominal, with
    a gain of 1 and no lag. The array's ``Element`` describes a nominal element.

    Parameters
    ----------
    path : .csv file whose first line names these columns, in any order. Other columns are ignored.
    elements : number E of elements of the array.

    Returns
    -------
    (E,) complex gains gain · e^{+i phase}, for use with ``PhasedArray.calibrated``. The sign is
    positive because pressures are phasors p in Re[p e^{−iωt}]: for this time factor, a lag φ is the
    factor e^{+iφ}.

    Raises
    ------
    InvalidInput
        If the file cannot be read, if a column is missing, or if a line contains a cell that is not
        a number, an element that does not exist or is repeated, or a gain that is not between 0 and
        10. The message states the line.
    """
    path = Path(of_kind(path, str | Path, "the calibration", "the path of a .csv file"))
    table = read_text_table(path)
    table.require(*COLUMNS)
    indices, levels, phases = (table.numbers(name) for name in COLUMNS)
    gains = np.ones(elements, dtype=np.complex128)
    lines: dict[int, int] = {}
    for line, index, gain, phase in zip(table.lines, indices, levels, phases, strict=True):
        with about(f"line {line} of {path.name}"):
            element = int(index)
            if element != index:
                raise InvalidInput(
                    f"the element {index:g} is not a whole number. Use an index from 0.",
                    code="not_a_number",
                )
            if not 0 <= element < elements:
                raise InvalidInput(
                    f"there is no element {element}: the array has elements 0 to {elements - 1}.",
                    code="unknown_name",
                )
            if element in lines:
                raise InvalidInput(
                    f"element {element} is already in line {lines[element]}. Remove one of the "
                    "lines.",
                    code="given_twice",
                )
            if not 0.0 <= gain <= 10.0:  # a larger gain is probably in per cent
                raise InvalidInput(
                    f"the gain of element {element} is {gain:g}, but it must lie between 0 and 10.",
                    code="out_of_range",
                )
            lines[element] = line
            # A lag is a positive phase in Re[p e^{−iωt}].
            gains[element] = gain * np.exp(1j * phase)
    return gains


def calibrated_by(path: str | Path, array: PhasedArray) -> PhasedArray:
    """Return an array with the gains and deviations that a calibration file contains.

    Parameters
    ----------
    path : .csv file with the columns element, gain and phase, as for ``load_calibration``. It may
        also contain the columns x, y, z (displacement of an element [m]) and turn_x, turn_y, turn_z
        (rotation vector of its face [rad]), both in the array's frame. Elements that are not listed
        have no deviation.
    array : the nominal array.

    Raises
    ------
    InvalidInput
        If the file cannot be read, if a column is missing, if a cell is not a number, if an element
        does not exist or is repeated, if a gain is not between 0 and 10, if a displacement is 0.1 m
        or more, or if a rotation is half a turn or more.
    """
    gains = load_calibration(path, len(array))
    table = read_text_table(Path(path))
    if not any(name in table.names for name in MOTION):
        return array.calibrated(gains)
    for column in MOTION:
        # Larger values are probably in other units.
        limit, unit = (np.pi, "rad") if column.startswith("turn") else (0.1, "m")
        values = np.abs(table.numbers(column))
        if values.max(initial=0.0) >= limit:
            row = int(values.argmax())
            raise InvalidInput(
                f"{column} is {values[row]:g} {unit} in line {table.lines[row]} of "
                f"{Path(path).name}, but it must be below {limit:.3g}: use metres and radians.",
                code="out_of_range",
            )
    # Elements that are not listed stay in place.
    motions = np.zeros((len(array), 6))
    elements = table.numbers(COLUMNS[0]).astype(np.int64)
    motions[elements] = np.stack([table.numbers(name) for name in MOTION], axis=1)
    # SciPy requires writable arrays, but those of a ``PhasedArray`` are read-only.
    turns = Rotation.from_rotvec(motions[:, 3:])
    return PhasedArray(
        array.positions + motions[:, :3],
        turns.apply(array.normals.copy()),
        array.element,
        turns.apply(array.tangents.copy()),
        gains,
    )


def save_calibration(
    path: str | Path,
    gains: Complex128[np.ndarray, "elements"],
    deviations: Sequence[Pose],
    array: PhasedArray,
) -> None:
    """Write the gain (E,) and the deviation of each element to a file for ``calibrated_by``.

    Raises
    ------
    InvalidInput
        If the file name does not end in .csv, or if the file cannot be written.
    """
    path = Path(of_kind(path, str | Path, "the calibration", "the path of a .csv file"))
    if path.suffix.lower() != ".csv":
        raise InvalidInput(
            f"a calibration must be a .csv file, not {path.name}.", code="unknown_format"
        )
    shifts = np.stack(
        [pose.apply(point) - point for pose, point in zip(deviations, array.positions, strict=True)]
    )
    turns = Rotation.from_matrix(np.stack([pose.rotation for pose in deviations])).as_rotvec()
    numbers = np.column_stack([np.abs(gains), np.angle(gains), shifts, turns])
    # Nine digits resolve a micrometre in a kilometre, which is far below any measurement error.
    lines = [",".join((*COLUMNS, *MOTION))] + [
        ",".join([str(index), *(f"{value:.9g}" for value in row)])
        for index, row in enumerate(numbers)
    ]
    with whole_file(path) as partial:
        partial.write_text("\n".join(lines) + "\n", encoding="utf-8")
