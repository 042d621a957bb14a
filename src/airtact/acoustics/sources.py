"""Monopoles: the point sources of a scene."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64, Num, Real

from airtact.errors import InvalidInput, check_finite, complex_numbers, in_short, points_of
from airtact.geometry.distances import nearest_within

# Points closer to a source than this count as lying at the source [m].
STANDS_ON = 1e-9


@dataclass(frozen=True, eq=False)
class Monopoles:
    """N point sources with S independent excitations, each of which is solved separately.

    Pass them to ``Solver.radiate``, which returns a field with the pressure of each excitation. A
    monopole of strength s in open air produces the pressure p = s e^{ikr}/r at the distance r, with
    wavenumber k.

    Attributes
    ----------
    positions : (N, 3) positions in the frame of the scene [m], stored as float64.
    strengths : (N, S) complex strengths [Pa·m]: the peak pressure at 1 m, and its phase. In each
        excitation, all N points emit at once. An array of shape (N,) is a single excitation and is
        stored as (N, 1).

    Raises
    ------
    InvalidInput
        If there are no points or excitations, if a number is NaN or infinite, or if shapes do not
        match.

    Examples
    --------
    >>> pair = Monopoles(np.array([[0.0, 0, 0.1], [0, 0, 0.2]]), np.array([1.0, 1j]))
    >>> pair.strengths.shape
    (2, 1)
    """

    positions: Real[np.ndarray, "points 3"]
    strengths: Num[np.ndarray, "points excitations"] | Num[np.ndarray, "points"]

    __repr__ = in_short

    @property
    def refined_positions(self) -> Real[np.ndarray, "fine 3"]:
        """(R, 3) positions [m] near which a solver uses smaller panels.

        By default, these are the positions of all monopoles.
        """
        return self.positions

    def __post_init__(self) -> None:
        positions = points_of(self.positions, "monopole positions")
        strengths = complex_numbers(self.strengths, "monopole strengths")
        if strengths.ndim == 1:
            strengths = strengths[:, None]
        if strengths.ndim != 2 or len(strengths) != len(positions):
            raise InvalidInput(
                f"monopole strengths have shape {strengths.shape}, but there are {len(positions)} "
                f"positions; use ({len(positions)},) for one excitation or ({len(positions)}, "
                "number of excitations).",
                code="wrong_shape",
            )
        if strengths.shape[1] == 0:
            raise InvalidInput(
                "monopole strengths contain no excitations; pass at least one.", code="empty"
            )
        check_finite(strengths, "monopole strengths")
        strengths.flags.writeable = False
        object.__setattr__(self, "positions", positions)
        object.__setattr__(self, "strengths", strengths)


def check_off_sources(points: Real[np.ndarray, "points 3"], sources: Monopoles) -> None:
    """Raise an error if a receiver is closer than ``STANDS_ON`` [m] to a source.

    The pressure is infinite at a source.
    """
    distance, source = nearest_source(points, sources, STANDS_ON)
    near = np.flatnonzero(distance < STANDS_ON)
    if len(near):
        first = int(near[0])
        raise InvalidInput(
            f"point {first} is {1e3 * distance[first]:g} mm from source {int(source[first])}, "
            "where the pressure is infinite; move the point away.",
            code="misplaced",
        )


def nearest_source(
    points: Real[np.ndarray, "points 3"], sources: Monopoles, within: float
) -> tuple[Float64[np.ndarray, "points"], Int64[np.ndarray, "points"]]:
    """Return the distance [m] and the index of the source nearest to each point.

    If no source is closer than ``within`` [m] to a point, the distance is infinite and the index is
    0.
    """
    return nearest_within(np.asarray(points, dtype=np.float64), sources.positions, within)
