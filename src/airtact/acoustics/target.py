"""Targets: foci with requested pressures, and points where the pressure is suppressed."""

from collections.abc import Sized
from dataclasses import dataclass
from typing import cast

import numpy as np
from jaxtyping import Complex128, Float64, Num, Real

from airtact.acoustics.sources import Monopoles
from airtact.errors import (
    InvalidInput,
    Vector,
    check_finite,
    complex_numbers,
    counted,
    fixed,
    in_mm,
    millimetres,
    one_line,
    points_of,
    real_numbers,
    shaped,
    span,
)
from airtact.geometry.distances import nearest

# Requested values at the foci: (F,) numbers, or one number for all.
PerFocus = Num[np.ndarray, "foci"] | complex | float | int


@dataclass(frozen=True, eq=False)
class Beacons(Monopoles):
    """Virtual sources at the points of a target.

    The first ``foci`` sources are at the foci, the others at the suppression points. The boundary
    element method uses smaller panels near the foci, but not near the suppression points.
    """

    foci: int = 0

    def __repr__(self) -> str:
        suppressed = _counted_suppression(len(self.positions) - self.foci)
        return one_line(self, counted(self.foci, "focus", "foci"), suppressed)

    @property
    def refined_positions(self) -> Real[np.ndarray, "fine 3"]:
        """Positions of the foci."""
        return self.positions[: self.foci]


@dataclass(frozen=True, eq=False)
class Target:
    """Foci and suppression points, in the frame of the scene's bodies (the obstacles' frame).

    Drive methods such as ``best`` take a target. For one focus, pass a point (3,). Pass pressures
    or shares as an array (F,) or as one number for all foci; complex numbers also request phases.

    Attributes
    ----------
    points : (F, 3) foci [m], at most 2 m from the origin of the obstacles' frame.
    pressures : (F,) requested peak pressures (magnitudes) [Pa], 0 or more; None, the default, makes
        the foci as strong as possible.
    shares : (F,) relative pressures (magnitudes), 0 or more, or None. The pressures at the foci
        have these ratios, at the highest level that the array allows. If neither pressures nor
        shares are given, all foci have equal weight.
    phases : (F,) requested phases of Re[p e^{−iωt}] [rad], from complex pressures or shares; None
        if these are real, so that the drive method chooses the phases.
    suppression_points : (Q, 3) points where the pressure is suppressed [m], at most 2 m from the
        origin of the obstacles' frame; none by default.

    Raises
    ------
    InvalidInput
        If there are no points; if a number is NaN or infinite; if a real pressure or share is
        negative, or none is above zero; if a point is too far from the origin; if the number of
        pressures or shares differs from the number of foci; if both pressures and shares are
        passed; if a suppression point is within 1 µm of a focus; or if the points are a position
        and a normal, as returned by ``hand.place``.

    Examples
    --------
    >>> Target(np.array([[0.0, 0, 0], [0, 0, 0.02]]), pressures=1500.0).pressures.tolist()
    [1500.0, 1500.0]
    >>> opposed = Target(np.array([[0.0, 0, 0], [0, 0, 0.02]]), shares=np.array([1.0, -0.5 + 0j]))
    >>> opposed.shares.tolist(), np.round(opposed.phases, 3).tolist()
    ([1.0, 0.5], [0.0, 3.142])
    """

    points: Float64[np.ndarray, "foci 3"]
    pressures: Float64[np.ndarray, "foci"] | None
    shares: Float64[np.ndarray, "foci"] | None
    phases: Float64[np.ndarray, "foci"] | None
    suppression_points: Float64[np.ndarray, "suppressed 3"]

    def __repr__(self) -> str:
        strength = "as strong as possible"
        if self.pressures is not None:
            strength = f"{span(self.pressures, 'Pa')} requested"
        elif self.shares is not None:
            strength = f"shares {span(self.shares, '').rstrip()}"
        return one_line(
            self,
            counted(len(self.points), "focus", "foci"),
            strength,
            "" if self.phases is None else "phases fixed",
            _counted_suppression(len(self.suppression_points)),
        )

    def __init__(
        self,
        points: Real[np.ndarray, "foci 3"] | Vector,
        pressures: PerFocus | None = None,
        *,
        shares: PerFocus | None = None,
        suppression_points: Real[np.ndarray, "suppressed 3"] | None = None,
    ) -> None:
        """Check the points, and expand pressures or shares to one number per focus.

        Parameters
        ----------
        points : (F, 3) foci [m], or (3,) for one focus.
        pressures : (F,) peak pressures [Pa], one number for all foci, or None. Complex numbers also
            fix the phases; with real numbers, the drive method chooses them.
        shares : relative pressures, in the same forms as ``pressures``. Pass one of the two,
            not both.
        suppression_points : (Q, 3) points where the pressure is suppressed [m].
        """
        _check_no_normal(points)
        if (
            np.iterable(points)
            and isinstance(points, Sized)
            and len(points) == 3
            and all(np.ndim(coordinate) == 0 for coordinate in points)
        ):
            points = np.asarray(points)[None]
        foci = points_of(cast("np.ndarray", points), "target points")
        _check_near_origin(foci, "focus")
        if suppression_points is None:
            suppression_points = np.empty((0, 3))
        suppressed = points_of(suppression_points, "suppression points", least=0)
        _check_near_origin(suppressed, "suppression point")
        _check_suppressed_foci(foci, suppressed)
        if pressures is not None and shares is not None:
            raise InvalidInput(
                "a target has both pressures and shares; pass only one of them.",
                code="options_clash",
            )
        values = None
        if pressures is not None:
            values = _per_focus(pressures, len(foci), "target pressure", " Pa")
        elif shares is not None:
            values = _per_focus(shares, len(foci), "target share", "")
        magnitudes = None if values is None else fixed(np.abs(values))
        attributes = {
            "points": foci,
            "suppression_points": suppressed,
            "pressures": None if pressures is None else magnitudes,
            "shares": None if shares is None else magnitudes,
            # Real numbers leave the choice of phases to the drive method.
            "phases": None if values is None or np.isrealobj(values) else fixed(np.angle(values)),
        }
        for name, value in attributes.items():
            object.__setattr__(self, name, value)

    @property
    def weights(self) -> Float64[np.ndarray, "foci"]:
        """(F,) weight of each focus: its requested pressure [Pa], its share, or 1."""
        if self.pressures is not None:
            return self.pressures
        return np.ones(len(self.points)) if self.shares is None else self.shares

    @property
    def wanted(self) -> Complex128[np.ndarray, "foci"]:
        """(F,) complex weights with the requested phases, or with phase 0 if none is requested."""
        phases = 0.0 if self.phases is None else self.phases
        return self.weights * np.exp(1j * np.asarray(phases))

    def weakest(self, pressures: Float64[np.ndarray, "foci"]) -> int:
        """Return the index of the focus with the lowest pressure relative to its weight.

        Foci with weight 0 are ignored. Most drive methods make the ratio of pressure to weight
        nearly equal at all foci. If the ratios of several foci are within 1 % of the smallest, the
        focus with the lowest pressure is returned.

        Parameters
        ----------
        pressures : (F,) peak pressure at each focus [Pa].

        Examples
        --------
        >>> target = Target(np.array([[0.0, 0, 0], [0, 0, 0.02]]), shares=np.array([1.0, 0.25]))
        >>> target.weakest(np.array([900.0, 300.0]))
        0
        """
        pressures = shaped(pressures, self.weights.shape, "pressures")
        ratios = np.full(len(pressures), np.inf)
        np.divide(pressures, self.weights, out=ratios, where=self.weights > 0.0)
        return int(np.where(ratios <= 1.01 * ratios.min(), pressures, np.inf).argmin())

    def beacons(self, suppression: bool = False) -> Monopoles:
        """Return virtual sources of 1 Pa·m at the foci, with one excitation for each focus.

        The strengths are therefore the identity matrix (F, F).

        Parameters
        ----------
        suppression : whether to append the Q suppression points; the strengths then have the shape
            (F + Q, F + Q).

        Returns
        -------
        Monopoles with one excitation per point, for ``solver.radiate``.
        """
        # Each beacon is a separate excitation, whose field is one row of the transfer matrix.
        points = self.points
        if suppression:
            points = np.concatenate([points, self.suppression_points])
        return Beacons(points, np.eye(len(points), dtype=np.complex128), foci=len(self.points))


def _counted_suppression(count: int) -> str:
    return counted(count, "suppression point", "suppression points") if count else ""


def _per_focus(values: PerFocus, foci: int, name: str, unit: str) -> Num[np.ndarray, "foci"]:
    if np.iscomplexobj(values):
        numbers = complex_numbers(np.asarray(values), f"{name}s")
    else:
        numbers = real_numbers(np.asarray(values), f"{name}s")
    check_finite(numbers, f"{name}s")
    if numbers.ndim != 0 and numbers.shape != (foci,):
        raise InvalidInput(
            f"{name}s have shape {numbers.shape}, but the target has "
            f"{counted(foci, 'focus', 'foci')}; use one number, or an array of shape ({foci},).",
            code="wrong_shape",
        )
    if not np.iscomplexobj(numbers) and numbers.min() < 0.0:
        raise InvalidInput(
            f"a {name} is {numbers.min():g}{unit}, but it must not be negative; use a complex "
            "number to set a phase.",
            code="out_of_range",
        )
    if np.abs(numbers).max() == 0.0:
        raise InvalidInput(
            f"every {name} is 0{unit}; set a larger value for at least one focus.", code="empty"
        )
    return np.broadcast_to(numbers, (foci,))


def _check_suppressed_foci(
    foci: Float64[np.ndarray, "foci 3"], suppressed: Float64[np.ndarray, "suppressed 3"]
) -> None:
    # One pressure cannot be both strong and zero.
    distance, focus = nearest(suppressed, foci)
    if distance.min(initial=np.inf) < 1e-6:
        point = int(distance.argmin())
        index = int(focus[point])
        raise InvalidInput(
            f"suppression point {point} is {millimetres(distance[point])} from focus {index} at "
            f"{in_mm(foci[index])}; the pressure there cannot be both strong and zero. Remove the "
            "suppression point.",
            foci[index],
            code="misplaced",
        )


def _check_no_normal(points: Real[np.ndarray, "foci 3"] | Vector) -> None:
    if (
        isinstance(points, tuple)
        and len(points) == 2
        and np.shape(points[0]) == np.shape(points[1]) == (3,)
        and abs(np.linalg.norm(points[1]) - 1.0) < 1e-6
    ):
        raise InvalidInput(
            "the target points are a position and its unit normal, as hand.place returns them. "
            "Pass only the position, or a focus above the skin: hand.focus(place).",
            code="misplaced",
        )


def _check_near_origin(points: Float64[np.ndarray, "points 3"], name: str) -> None:
    distance = np.linalg.norm(points, axis=1)
    if distance.max(initial=0.0) > 2.0:
        worst = int(distance.argmax())
        raise InvalidInput(
            f"{name} {worst} at {in_mm(points[worst])} is {distance[worst]:.4g} m from the origin "
            "of the obstacles' frame, but at most 2 m is allowed: is it in millimetres? Use "
            "metres.",
            points[worst],
            code="not_in_metres",
        )
