"""What each transducer really gives of what it is asked, from a table."""

from pathlib import Path

import numpy as np
from jaxtyping import Complex128

from airtact.conventions import InvalidInput, about
from airtact.scene.guards import counted, of_kind

COLUMNS = ("element", "gain", "phase")
"""Columns of the table: index from 0, amplitude over the wanted one, phase by which it lags [rad]."""

LARGEST_GAIN = 10.0
"""Gains over this are taken for a slip, such as per cent."""


def load_calibration(path: str | Path, elements: int) -> Complex128[np.ndarray, "elements"]:
    """Read the gains of an array's elements from a .csv file.

    Its first line is ``element,gain,phase``: the index of an element from 0, its pressure over that of a nominal one,
    and the phase by which it lags behind a nominal one [rad]. Gain 0 is a dead element. Elements that are not listed
    are nominal.

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
        If the file cannot be read or a line is not three numbers, names an element that is not there or was there
        before, or has a gain that is negative, over 10 or not finite; the sentence holds the line.
    """
    path = Path(of_kind(path, str | Path, "the calibration", "the path of a .csv file"))
    try:
        lines = path.read_text(encoding="utf-8").rstrip().splitlines()
    except OSError as error:
        raise InvalidInput(f"cannot read {path.name}: {error.strerror}.") from None
    except UnicodeDecodeError as error:
        raise InvalidInput(f"{path.name} is not a text file: byte {error.start} is not UTF-8.") from None
    if not lines or tuple(word.strip() for word in lines[0].split(",")) != COLUMNS:
        raise InvalidInput(f"line 1 of {path.name} must be {','.join(COLUMNS)}.")
    gains = np.ones(elements, dtype=np.complex128)
    seen: dict[int, int] = {}
    for number, line in enumerate(lines[1:], start=2):
        with about(f"line {number} of {path.name}"):
            index, gain = _row(line, elements)
            if index in seen:
                raise InvalidInput(f"element {index} was given in line {seen[index]} already.")
            seen[index], gains[index] = number, gain
    return gains


def _row(line: str, elements: int) -> tuple[int, complex]:
    words = line.split(",")
    try:
        index, (gain, phase) = int(words[0]), (float(word) for word in words[1:])
    except ValueError:
        raise InvalidInput(f"{line!r} is not a whole number and two numbers.") from None
    if not 0 <= index < elements:
        raise InvalidInput(f"there is no element {index} among {counted(elements, 'element', 'elements')}.")
    if not (0.0 <= gain <= LARGEST_GAIN and np.isfinite(phase)):
        raise InvalidInput(
            f"gain {gain:g} and phase {phase:g} rad of element {index} must be 0 to {LARGEST_GAIN:g} and finite."
        )
    return index, complex(gain * np.exp(1j * phase))
