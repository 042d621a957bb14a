"""Received pressures of coded transmissions, and their file format.

Version 2 of the file is HDF5 with these datasets; those in parentheses are optional:

- ``format_version``: 2, or 1 without ``valid``.
- ``frequency`` [Hz].
- ``codes_real``, ``codes_imaginary``: (E, M) emission of each of E elements in each of M
  transmissions, as a fraction of full scale; an element emits Re[c e^{−iωt}].
- ``pressures_real``, ``pressures_imaginary``: (R, M) peak pressure at each of R receivers in each
  transmission [Pa], with the same phasor.
- (``receivers``: (R,) indices of the receiving elements, from 0; by default all in order.)
- (``noise``: rms magnitude of the complex noise of each pressure [Pa], as measured without
  a transmission.)
- (``valid``: (R, M) 1 for received pressures, 0 for others; by default all are valid.)
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Complex128, Int64, Integer, Num

from airtact.errors import (
    InvalidInput,
    about,
    check_finite,
    check_frequency,
    complex_numbers,
    counted,
    of_kind,
    one_line,
    positive,
)
from airtact.files.atomic import whole_hdf5
from airtact.files.bounded import datasets_of
from airtact.transducers.layout import PhasedArray
from airtact.transducers.levels import FULL_SCALE

Codes = Complex128[np.ndarray, "elements transmissions"]
Receivers = Int64[np.ndarray, "receivers"]


@dataclass(frozen=True, eq=False)
class Echoes:
    """Coded transmissions of an array and the received pressures, at one frequency.

    ``locate`` expects only the echoes: the received pressures minus the pressures without bodies.
    ``calibrate`` expects the pressures received without a body.

    Attributes
    ----------
    codes : (E, M) complex amplitude of each of E elements in each of M transmissions, in which the
        elements emit together; a magnitude of 1 is full scale. Gains of the elements are not
        included.
    pressures : (R, M) mean pressure over the face of each of R receivers in each transmission,
        times the receiver's gain [Pa]; a phasor p is the pressure Re[p e^{−iωt}].
    receivers : (R,) indices of the receiving elements, in the order of the rows of ``pressures``.
        None selects all E in order; the attribute then contains their indices.
    frequency : frequency of the sound [Hz], 1 kHz to 1 MHz.
    noise : positive rms magnitude of the complex noise in each pressure [Pa], as measured
        without a transmission; None if unknown.
    valid : (R, M) whether each pressure was received; None if all were received. An element cannot
        receive while it still rings after its own emission. Invalid pressures are stored as 0.

    Raises
    ------
    InvalidInput
        If the shapes do not match, an array is empty, or a value is NaN or infinite (omit dead
        receivers from ``receivers``). If a code exceeds full scale, or a transmission is silent. If
        a receiver does not exist or is listed twice, or no pressure is valid. If the frequency or
        the noise is outside its range.

    Examples
    --------
    >>> Echoes(codes=np.eye(4), pressures=np.ones((2, 4)), receivers=np.array([0, 3]))
    Echoes(4 elements, 4 transmissions, 2 receivers, 40000 Hz)
    """

    codes: Num[np.ndarray, "elements transmissions"]
    pressures: Num[np.ndarray, "receivers transmissions"]
    receivers: Integer[np.ndarray, "receivers"] | None = None
    frequency: float = 40e3
    noise: float | None = None
    valid: Bool[np.ndarray, "receivers transmissions"] | None = None

    def __repr__(self) -> str:
        elements, transmissions = self.codes.shape
        return one_line(
            self,
            counted(elements, "element", "elements"),
            counted(transmissions, "transmission", "transmissions"),
            counted(len(self.pressures), "receiver", "receivers"),
            f"{self.frequency:g} Hz",
        )

    def __post_init__(self) -> None:
        codes = _table(self.codes, "codes")
        pressures = _table(self.pressures, "pressures")
        if codes.shape[1] != pressures.shape[1]:
            raise InvalidInput(
                f"there are {codes.shape[1]} codes but {pressures.shape[1]} columns of pressures; "
                "use one column for each code.",
                code="sizes_differ",
            )
        magnitude = np.abs(codes)
        if magnitude.max() > FULL_SCALE:
            element, column = np.unravel_index(magnitude.argmax(), codes.shape)
            raise InvalidInput(
                f"the code of element {element} in transmission {column} has the magnitude "
                f"{magnitude.max():.4g}, but at most 1 (full scale) is allowed. Divide all codes "
                "by this magnitude.",
                code="over_full_scale",
            )
        silent = np.flatnonzero(~codes.any(axis=0))
        if len(silent):
            raise InvalidInput(
                f"no element emits in transmission {silent[0]}; omit it.", code="all_zero"
            )
        checked = {
            "codes": codes,
            "receivers": _checked_receivers(self.receivers, len(codes), len(pressures)),
            "frequency": check_frequency(self.frequency),
        }
        if self.valid is not None:
            valid = np.array(self.valid)
            if valid.dtype != np.bool_ or valid.shape != pressures.shape:
                raise InvalidInput(
                    f"valid is {valid.dtype} of shape {valid.shape}; pass True or False for each "
                    f"pressure, with shape {pressures.shape}.",
                    code="sizes_differ",
                )
            if not valid.any():
                raise InvalidInput(
                    "no pressure is valid; let some elements emit while the others receive.",
                    code="link_failed",
                )
            checked["valid"] = valid
            pressures = np.where(valid, pressures, 0.0)
        if self.noise is not None:
            checked["noise"] = positive(self.noise, "the noise of echoes", "Pa")
        for name, value in {**checked, "pressures": pressures}.items():
            if isinstance(value, np.ndarray):
                # The arrays are read-only because several fits share them.
                value.flags.writeable = False
            object.__setattr__(self, name, value)

    @property
    def receiving(self) -> Receivers:
        """(R,) indices of the receiving elements."""
        assert self.receivers is not None  # the constructor stores them
        return np.asarray(self.receivers, dtype=np.int64)

    def save(self, path: str | Path) -> None:
        """Write the echoes to an HDF5 file for ``load_echoes``, replacing an existing file.

        Raises
        ------
        InvalidInput
            If the file name does not end in .h5 or the file cannot be written.

        Examples
        --------
        >>> import tempfile
        >>> echoes = Echoes(np.eye(2), 1j * np.ones((2, 2)))
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     echoes.save(f"{folder}/echoes.h5")
        ...     back = load_echoes(f"{folder}/echoes.h5")
        >>> bool(np.array_equal(back.pressures, echoes.pressures))
        True
        """
        path = _checked_path(path)
        datasets = {
            "format_version": 1 if self.valid is None else 2,
            "frequency": self.frequency,
            "codes_real": np.real(self.codes),
            "codes_imaginary": np.imag(self.codes),
            "pressures_real": np.real(self.pressures),
            "pressures_imaginary": np.imag(self.pressures),
            "receivers": self.receiving,
        }
        if self.noise is not None:
            datasets["noise"] = self.noise
        if self.valid is not None:
            datasets["valid"] = np.asarray(self.valid, dtype=np.uint8)
        with whole_hdf5(path) as file:
            for name, values in datasets.items():
                file[name] = values


LAYOUT = {
    "format_version": "whole",
    "frequency": "real",
    "codes_real": "real elements transmissions",
    "codes_imaginary": "real elements transmissions",
    "pressures_real": "real receivers transmissions",
    "pressures_imaginary": "real receivers transmissions",
    "receivers": "optional whole receivers",
    "noise": "optional real",
    "valid": "optional real receivers transmissions",
}


def load_echoes(path: str | Path) -> Echoes:
    """Read echoes from an HDF5 file written by ``Echoes.save`` or by another program.

    Pass the result to ``locate`` or ``calibrate``. The documentation of the module
    ``airtact.sensing.echoes`` lists the datasets of the file.

    Parameters
    ----------
    path : file name that ends in ``.h5``.

    Returns
    -------
    The ``Echoes``, with one row of pressures for each receiver.

    Raises
    ------
    InvalidInput
        If the file is missing or unreadable, does not end in .h5, is not an echo file, or has a
        newer version. If a dataset is missing, or contains values that ``Echoes`` rejects, such as
        NaN or codes above full scale.
    """
    path = _checked_path(path)
    raw = datasets_of(path, LAYOUT, newest=2)
    valid = raw.get("valid")
    with about(path.name):
        return Echoes(
            raw["codes_real"] + 1j * raw["codes_imaginary"],
            raw["pressures_real"] + 1j * raw["pressures_imaginary"],
            raw.get("receivers"),
            raw["frequency"],
            raw.get("noise"),
            None if valid is None else valid != 0,
        )


def check_elements(echoes: Echoes, array: PhasedArray, name: str) -> None:
    """Raise an error if the array and the echoes have different numbers of elements.

    ``name`` describes the echoes in the error message.
    """
    of_kind(echoes, Echoes, f"the {name}", "Echoes(codes, pressures)")
    of_kind(array, PhasedArray, "the array", "one such as surrounding_box()")
    if len(echoes.codes) != len(array):
        raise InvalidInput(
            f"the {name} come from an array of {len(echoes.codes)} elements, but this array has "
            f"{len(array)}. Pass the array with which they were measured.",
            code="sizes_differ",
        )


def check_not_clipped(values: Num[np.ndarray, "pressures"]) -> None:
    """Raise an error if more than 5 % of the values equal the largest, which indicates clipping."""
    # With noise, no two values are equal unless an amplifier or converter saturates.
    equal = int(np.sum(values > (1.0 - 1e-6) * values.max())) if len(values) else 0
    if equal > max(0.05 * len(values), 8):
        raise InvalidInput(
            f"{equal} of {len(values)} pressures have the same largest value of "
            f"{values.max():.4g} Pa: they were clipped. Measure again with less gain.",
            code="signal_unusable",
        )


def _checked_path(path: str | Path) -> Path:
    path = Path(of_kind(path, str | Path, "the file of echoes", 'its path, such as "echoes.h5"'))
    if path.suffix.lower() != ".h5":
        raise InvalidInput(
            f"{path.name} is not an echo file name: it must end in .h5.", code="unknown_format"
        )
    return path


def _table(
    values: Num[np.ndarray, "rows columns"], name: str
) -> Complex128[np.ndarray, "rows columns"]:
    table = complex_numbers(values, name)
    if table.ndim != 2:
        raise InvalidInput(
            f"{name} have shape {table.shape}, but they must be a table with a column for each "
            "transmission.",
            code="wrong_shape",
        )
    if table.size == 0:
        raise InvalidInput(f"{name} are empty: their shape is {table.shape}.", code="empty")
    check_finite(table, name)
    return table


def _checked_receivers(
    receivers: Integer[np.ndarray, "receivers"] | None, elements: int, rows: int
) -> Receivers:
    numbers = np.arange(elements) if receivers is None else np.asarray(receivers)
    if numbers.ndim != 1 or numbers.dtype.kind not in "iu":
        raise InvalidInput(
            f"receivers have type {numbers.dtype} and shape {numbers.shape}, but they must be "
            "integers of shape (R,).",
            code="wrong_shape" if numbers.ndim != 1 else "not_a_number",
        )
    if len(numbers) != rows:
        raise InvalidInput(
            f"{counted(len(numbers), 'receiver has', 'receivers have')} {rows} rows of pressures; "
            "pass one row for each.",
            code="sizes_differ",
        )
    wrong = numbers[(numbers < 0) | (numbers >= elements)]
    if len(wrong):
        raise InvalidInput(
            f"receiver {wrong[0]} does not exist; elements are numbered 0 to {elements - 1}.",
            code="out_of_range",
        )
    values, counts = np.unique(numbers, return_counts=True)
    if counts.max() > 1:
        raise InvalidInput(
            f"element {values[counts.argmax()]} occurs {counts.max()} times among the receivers; "
            "list it once.",
            code="given_twice",
        )
    return numbers.astype(np.int64)
