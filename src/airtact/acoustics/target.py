"""What a person is to feel: foci in the obstacles' frame, the pressures wanted there, and points to suppress."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128, Float64, Num, Real

from airtact.acoustics.sources import Monopoles
from airtact.checks import (
    check_finite,
    complex_numbers,
    counted,
    fixed,
    in_mm,
    points_of,
    real_numbers,
)
from airtact.errors import InvalidInput
from airtact.printing import html_table, one_line, span

MAX_FOCUS_DISTANCE = 2.0
"""Largest distance of a focus from the origin of the obstacles' frame [m], the largest extent of a body."""

SAME_POSITION = 1e-6
"""A suppression point nearer than this to a focus is at its position [m]."""

Wanted = Num[np.ndarray, "foci"] | complex | float | int
"""The value wanted at each focus: (F,) numbers, or one for all."""


@dataclass(frozen=True, eq=False)
class Beacons(Monopoles):
    """The virtual sources of a target: the first ``foci`` at foci, the others, unrefined, at suppression points."""

    foci: int = 0

    def __repr__(self) -> str:
        suppressed = len(self.positions) - self.foci
        return one_line(
            self,
            counted(self.foci, "focus", "foci"),
            f"{suppressed} suppression points" * bool(suppressed),
        )

    @property
    def refined_positions(self) -> Real[np.ndarray, "fine 3"]:
        """Positions of the foci."""
        return self.positions[: self.foci]


@dataclass(frozen=True, eq=False)
class Target:
    """Foci and suppression points, fixed in the obstacles' frame so that they move with the hand.

    Attributes
    ----------
    points : (F, 3) foci in the obstacles' frame [m].
    pressures : (F,) peak pressures asked for [Pa], or None to make the foci as strong as possible.
    shares : (F,) relative pressures asked for, as strong as the array allows, or None. Without
        pressures and shares all foci count equally.
    phases : (F,) phases asked for [rad] if complex numbers are given, or None if the method chooses
        them.
    suppression_points : (Q, 3) points where the pressure is suppressed [m], none by default.

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
        return one_line(self, *self._facts())

    def _repr_html_(self) -> str:
        weights = [f"{weight:.4g}" for weight in self.weights]
        rows = [
            [str(index), *_mm(point), weights[index]] for index, point in enumerate(self.points)
        ]
        asked = "relative" if self.pressures is None else "asked [Pa]"
        return html_table(
            f"Target: {', '.join(filter(None, self._facts()))}",
            ["focus", "x [mm]", "y [mm]", "z [mm]", asked],
            rows,
        )

    def _facts(self) -> list[str]:
        """Return what is asked, in words."""
        shares = (
            "as strong as possible"
            if self.shares is None
            else f"shares {span(self.shares, '').rstrip()}"
        )
        suppressed = counted(
            len(self.suppression_points), "suppression point", "suppression points"
        )
        return [
            counted(len(self.points), "focus", "foci"),
            shares if self.pressures is None else f"{span(self.pressures, 'Pa')} asked",
            "phases fixed" * (self.phases is not None),
            suppressed * bool(len(self.suppression_points)),
        ]

    def __init__(
        self,
        points: Real[np.ndarray, "foci 3"],
        pressures: Wanted | None = None,
        *,
        shares: Wanted | None = None,
        suppression_points: Real[np.ndarray, "suppressed 3"] | None = None,
    ) -> None:
        """Check the points, and expand what is wanted to one number per focus.

        Parameters
        ----------
        points : (F, 3) [m].
        pressures : (F,) peak pressures [Pa], one number for all foci, or None. Complex numbers fix
            the phases too, real ones leave them to the method.
        shares : the same in proportion only; give one of the two, or none for equal foci.
        suppression_points : (Q, 3) where the pressure is suppressed [m].

        Raises
        ------
        InvalidInput
            No points, NaN or infinity, a point over 2 m from the origin, a negative number, none above zero, not one
            per focus, pressures together with shares, or a suppression point nearer than 1 µm to a focus; or the points
            are a position and a normal, as ``hand.place`` gives them.
        """
        _check_no_normal(points)
        object.__setattr__(
            self, "points", _near_enough(points_of(points, "target points"), "focus")
        )
        none = np.empty((0, 3)) if suppression_points is None else suppression_points
        suppressed = _near_enough(
            points_of(none, "suppression points", least=0), "suppression point"
        )
        object.__setattr__(self, "suppression_points", suppressed)
        self._check_suppressed_foci()
        if pressures is not None and shares is not None:
            raise InvalidInput(
                "a target has both pressures and shares; give 1 of the 2: pressures in pascal, or shares.",
                code="options_clash",
            )
        wanted = None if pressures is None else self._wanted(pressures, "target pressure", " Pa")
        parts = None if shares is None else self._wanted(shares, "target share", "")
        given = wanted if parts is None else parts
        phases = None if given is None or not np.iscomplexobj(given) else fixed(np.angle(given))
        object.__setattr__(self, "pressures", None if wanted is None else fixed(np.abs(wanted)))
        object.__setattr__(self, "shares", None if parts is None else fixed(np.abs(parts)))
        object.__setattr__(self, "phases", phases)

    def _wanted(self, asked: Wanted, what: str, unit: str) -> Num[np.ndarray, "foci"]:
        whole = np.iscomplexobj(asked)
        given = (
            complex_numbers(np.asarray(asked), f"{what}s")
            if whole
            else real_numbers(np.asarray(asked), f"{what}s")
        )
        check_finite(given, f"{what}s")
        if given.ndim != 0 and given.shape != (len(self.points),):
            raise InvalidInput(
                f"{what}s have shape {given.shape}, but the target has "
                f"{counted(len(self.points), 'focus', 'foci')}; give one number or ({len(self.points)},).",
                code="wrong_shape",
            )
        if not whole and given.min() < 0.0:
            raise InvalidInput(
                f"a {what} is {given.min():g}{unit}, but it must not be negative; a complex number gives a phase.",
                code="out_of_range",
            )
        if np.abs(given).max() == 0.0:
            raise InvalidInput(
                f"every {what} is 0{unit}; ask at least one focus for more.", code="empty"
            )
        return np.broadcast_to(given, (len(self.points),))

    def _check_suppressed_foci(self) -> None:
        for index, point in enumerate(self.points):
            apart = np.linalg.norm(self.suppression_points - point, axis=1)
            if len(apart) and apart.min() < SAME_POSITION:
                raise InvalidInput(
                    f"suppression point {int(apart.argmin())} is {1e3 * apart.min():.2g} mm from focus {index} at "
                    f"{in_mm(point)}, so both cannot hold; leave it out of the suppression zone.",
                    point,
                    code="misplaced",
                )

    @property
    def weights(self) -> Float64[np.ndarray, "foci"]:
        """(F,) weight of each focus: pressures wanted [Pa], or shares, or 1 for all."""
        if self.pressures is not None:
            return self.pressures
        return np.ones(len(self.points)) if self.shares is None else self.shares

    @property
    def wanted(self) -> Complex128[np.ndarray, "foci"]:
        """(F,) weights with the phases wanted, or with phase 0 where they are left to the method."""
        return self.weights * np.exp(
            1j * (np.zeros(len(self.points)) if self.phases is None else self.phases)
        )

    def beacons(self, suppression: bool = False) -> Monopoles:
        """One virtual source of 1 Pa·m at every focus, each its own excitation: strengths are the identity (F, F).

        Parameters
        ----------
        suppression : whether the suppression points follow as further beacons, (F + Q, F + Q).
        """
        points = (
            np.concatenate([self.points, self.suppression_points]) if suppression else self.points
        )
        return Beacons(points, np.eye(len(points), dtype=np.complex128), foci=len(self.points))


def _check_no_normal(points: Real[np.ndarray, "foci 3"]) -> None:
    """Raise where a pair of a position and its unit normal was given as two foci."""
    if not (
        isinstance(points, tuple)
        and len(points) == 2
        and np.shape(points[0]) == np.shape(points[1]) == (3,)
    ):
        return
    length = np.linalg.norm(points[1])
    if abs(length - 1.0) < 1e-6:
        raise InvalidInput(
            f"the second of 2 target points is {length:.3g} m from the origin: a position and its unit normal, as "
            "hand.place gives them. Give the position, or a focus before it: point + 0.5e-3 * normal.",
            code="misplaced",
        )


def _mm(point: Float64[np.ndarray, "3"]) -> list[str]:
    return [f"{coordinate:.2f}" for coordinate in 1e3 * point]


def _near_enough(
    points: Float64[np.ndarray, "points 3"], what: str
) -> Float64[np.ndarray, "points 3"]:
    """Return points; raise where one is so far away that it is probably in millimetres."""
    away = np.linalg.norm(points, axis=1)
    if len(away) and away.max() > MAX_FOCUS_DISTANCE:
        worst = int(away.argmax())
        raise InvalidInput(
            f"{what} {worst} at {in_mm(points[worst])} is {away[worst]:.4g} m from the origin of "
            f"the obstacles' frame, more than {MAX_FOCUS_DISTANCE:g} m: is this in millimetres? Give metres.",
            points[worst],
            code="out_of_range",
        )
    return points
