"""A measured scan of a field, compared with a prediction after one complex scale."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Complex128, Float64

from airtact.checks import check_finite, complex_numbers, counted, in_mm, points_of
from airtact.errors import InvalidInput, about
from airtact.files.text_table import read_text_table
from airtact.printing import in_short

POSITION, PRESSURE, PHASE = ("x", "y", "z"), "pressure", "phase"
"""Columns of a scan: metres, the pressure in any unit, and, where it was measured, its phase [rad]."""

FARTHEST = 2.0
"""Positions farther than this from the origin are taken for millimetres [m]."""

PLAIN = 0.2
"""Error up to which a scan agrees with its prediction, whatever else does."""

FEWEST = 3
"""Fewer positions than this fit anything."""


@dataclass(frozen=True, eq=False)
class Scan:
    """The readings of a microphone at many positions.

    Attributes
    ----------
    points : (N, 3) positions [m].
    pressures : (N,) readings, in any unit; real where no phase was measured.
    phased : whether the phase was measured.
    """

    points: Float64[np.ndarray, "points 3"]
    pressures: Complex128[np.ndarray, "points"]
    phased: bool

    __repr__ = in_short

    def __post_init__(self) -> None:
        points = points_of(self.points, "positions of a scan", least=0)
        if len(points) < FEWEST:
            raise InvalidInput(
                f"the scan has {counted(len(points), 'position', 'positions')}; give {FEWEST} or more.",
                code="too_few",
            )
        pressures = complex_numbers(self.pressures, "pressures of a scan")
        if pressures.shape != (len(points),):
            raise InvalidInput(
                f"a scan of {len(points)} positions has pressures of shape {pressures.shape}.",
                code="wrong_shape",
            )
        check_finite(pressures, "pressures of a scan")
        away = np.linalg.norm(points, axis=1)
        if away.max() > FARTHEST:
            worst = int(away.argmax())
            raise InvalidInput(
                f"position {worst} of the scan is {away[worst]:.4g} m from the origin: is this in millimetres? "
                "Give metres.",
                points[worst],
                code="out_of_range",
            )
        if not pressures.any():
            raise InvalidInput(
                f"all {len(pressures)} pressures of the scan are 0; nothing was measured.",
                code="all_zero",
            )
        repeated = np.setdiff1d(
            np.arange(len(points)), np.unique(points, axis=0, return_index=True)[1]
        )
        if len(repeated):
            where = points[repeated[0]]
            raise InvalidInput(
                f"{counted(len(repeated), 'position of the scan is', 'positions of the scan are')} repeated, the first "
                f"at {in_mm(where)}; average them first.",
                where,
                code="given_twice",
            )
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "pressures", pressures)


def load_scan(path: str | Path) -> Scan:
    """Read a scan from a .csv file with the columns x, y, z [m], pressure and, if it was measured, phase [rad].

    Parameters
    ----------
    path : the file; its first line names the columns, in any order, and others are ignored.

    Returns
    -------
    The scan; phases are those of Re[p e^{−iωt}].

    Raises
    ------
    InvalidInput
        If the file cannot be read, a column is missing, a value is no number, or the scan is at fault.
    """
    table = read_text_table(Path(path))
    table.require(*POSITION, PRESSURE)
    points, phased = (
        np.stack([table.numbers(name) for name in POSITION], axis=1),
        PHASE in table.names,
    )
    phases = table.numbers(PHASE) if phased else np.zeros(len(points))
    with about(Path(path).name):
        return Scan(points, table.numbers(PRESSURE) * np.exp(1j * phases), phased)


@dataclass(frozen=True, eq=False)
class Overlay:
    """A scan beside its prediction.

    Attributes
    ----------
    scan : what was measured.
    predicted : (N,) pressures [Pa], NaN where the prediction is not defined.
    used : (N,) whether the prediction is defined at a position.
    scale : measured over predicted, the best single number; real and positive where no phase was
        measured.
    error : root mean square of measured minus scale times predicted, over that of measured.
    """

    scan: Scan
    predicted: Complex128[np.ndarray, "points"]
    used: Bool[np.ndarray, "points"]
    scale: complex
    error: float

    __repr__ = in_short

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences that a reader of the overlay must see."""
        left, count = int(np.sum(~self.used)), len(self.used)
        sentence = f"{left} of {count} positions are left out: a body is in the way of the microphone there."
        return (sentence,) if left else ()


def overlay_scan(scan: Scan, predicted: Complex128[np.ndarray, "points"]) -> Overlay:
    """Compare a scan with a prediction after one complex scale, that of least squares.

    Where no phase was measured, magnitudes are compared, and the scale is real.

    Parameters
    ----------
    scan : what was measured.
    predicted : (N,) complex pressures at its points [Pa], NaN where there is none.

    Returns
    -------
    Both, with the scale and the relative error.

    Raises
    ------
    InvalidInput
        If the shapes differ, fewer than 3 positions can be compared, the prediction is 0 at all of them, or the phases
        fit far better when they are negated.

    Examples
    --------
    >>> points = np.array([[0.0, 0, 0], [0, 0, 0.01], [0, 0, 0.02]])
    >>> found = overlay_scan(Scan(points, np.array([2.0, 4.0, 6.0 + 0j]), True), np.array([1j, 2j, 3j]))
    >>> complex(round(found.scale.real, 9), round(found.scale.imag, 9)), round(found.error, 9)
    (-2j, 0.0)
    """
    if predicted.shape != scan.pressures.shape:
        raise InvalidInput(
            f"{len(predicted)} predictions do not fit a scan of {len(scan.points)} positions.",
            code="sizes_differ",
        )
    used = np.isfinite(predicted)
    if used.sum() < FEWEST:
        raise InvalidInput(
            f"only {int(used.sum())} of {len(used)} positions of the scan can be predicted, fewer than {FEWEST}: a "
            "body is in the way of the microphone at the others; is the scan in the scene's frame?",
            code="signal_unusable",
        )
    model = predicted[used] if scan.phased else np.abs(predicted[used]).astype(np.complex128)
    measured = (
        scan.pressures[used] if scan.phased else np.abs(scan.pressures[used]).astype(np.complex128)
    )
    if not model.any():
        raise InvalidInput(
            f"the prediction is 0 Pa at all {int(used.sum())} positions of the scan.",
            code="all_zero",
        )
    scale, error = _fitted(measured, model)
    mirrored = _fitted(measured, model.conj())[1] if scan.phased else error
    if mirrored < 0.5 * error and error > PLAIN:
        raise InvalidInput(
            f"the scan's phases are {error:.1%} off the prediction, and {mirrored:.1%} when they are negated: they "
            "seem to be those of e^(+iωt); negate the column phase.",
            code="does_not_match",
        )
    return Overlay(scan, predicted, used, scale, error)


def _fitted(
    measured: Complex128[np.ndarray, "points"], model: Complex128[np.ndarray, "points"]
) -> tuple[complex, float]:
    scale = complex(np.vdot(model, measured) / np.vdot(model, model).real)
    return scale, float(np.linalg.norm(measured - scale * model) / np.linalg.norm(measured))
