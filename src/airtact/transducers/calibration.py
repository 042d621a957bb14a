"""The gain of each transducer relative to a nominal one, from a table."""

from pathlib import Path

import numpy as np
from jaxtyping import Complex128

from airtact.conventions import InvalidInput, about
from airtact.file_access.text_table import read_text_table
from airtact.validation import counted, of_kind

COLUMNS = ("element", "gain", "phase")
"""Columns of the table: index from 0, amplitude over the wanted one, phase by which it lags [rad]."""

LARGEST_GAIN = 10.0
"""Gains over this are probably in per cent."""


def load_calibration(path: str | Path, elements: int) -> Complex128[np.ndarray, "elements"]:
    """Read the gains of an array's elements from a .csv file.

    Its columns are ``element``, ``gain`` and ``phase``: the index of an element from 0, its pressure over that of a
    nominal one, and the phase by which it lags behind a nominal one [rad]. Gain 0 is a dead element. Elements that are
    not listed are nominal.

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
                    f"element {element} was given in line {seen[element]} already.", code="element_twice"
                )
            if not 0.0 <= gain <= LARGEST_GAIN:
                raise InvalidInput(
                    f"gain {gain:g} of element {element} must be 0 to {LARGEST_GAIN:g}.", code="out_of_range"
                )
            seen[element], gains[element] = line, gain * np.exp(1j * phase)
    return gains


def _element(index: float, elements: int) -> int:
    if index != int(index):
        raise InvalidInput(f"element {index:g} is not a whole number.", code="not_integers")
    if not 0 <= index < elements:
        raise InvalidInput(
            f"there is no element {index:g} among {counted(elements, 'element', 'elements')}.", code="unknown_element"
        )
    return int(index)
