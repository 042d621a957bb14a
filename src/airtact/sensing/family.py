"""Scattering matrices of bodies that change with one number, such as the gap of two fingers.

The bodies are solved for a few values of the number, all about one centre and to one order, and
each entry of the matrix is the polynomial through its values there (at the zeros of a Chebyshev
polynomial, where interpolation of smooth functions is near the best: L. N. Trefethen, Approximation
Theory and Approximation Practice, 2013, chapters 3 and 4). The derivative by the number is that of
the polynomial, so that a fit is exact for its own model.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Complex128, Float64
from numpy.polynomial import chebyshev

from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.problem import Solver
from airtact.acoustics.solvers.spherical.multipole_field import ball_of
from airtact.checks import number, of_kind
from airtact.errors import InvalidInput
from airtact.printing import one_line
from airtact.sensing.scattering import ScatteringMatrix, scattering_matrix
from airtact.sensing.waves import along_motions

FEWEST, MOST = 3, 12
"""Numbers of values that a family may be solved for."""

INTERPOLATED = 0.02
"""Largest relative error of the interpolation that is taken."""


@dataclass(frozen=True, eq=False)
class ScatteringFamily:
    """What bodies scatter that change with one number; ``scattering_family`` makes it.

    Attributes
    ----------
    scene_of : makes the bodies for a value of the number.
    low, high : least and largest value.
    start : value from which ``locate`` starts.
    matrices : of the N values at which the bodies were solved, all about one centre.
    """

    scene_of: Callable[[float], Scene]
    low: float
    high: float
    start: float
    matrices: tuple[ScatteringMatrix, ...]

    def __repr__(self) -> str:
        first = self.matrices[0]
        return one_line(
            self,
            f"{len(self.matrices)} values from {self.low:.4g} to {self.high:.4g}",
            f"{len(first.matrix)} waves, order {first.order}",
            f"ball of {1e3 * first.radius:.3g} mm",
            f"interpolated to {100 * self.error:.2g} %",
        )

    @property
    def scene(self) -> Scene:
        """The bodies at one of the values that were solved; medium and frequency are the same for all."""
        return self.matrices[0].scene

    def at(self, value: float) -> ScatteringMatrix:
        """Return the scattering matrix for a value, which has no report or scene of its own."""
        return self._sum(chebyshev.chebvander(self._scaled(value), len(self.matrices) - 1)[0])

    def derivative(self, value: float) -> ScatteringMatrix:
        """Return the derivative of the scattering matrix by the number."""
        terms = np.eye(len(self.matrices))
        by_scaled = np.asarray(
            chebyshev.chebval(self._scaled(value), chebyshev.chebder(terms, axis=0))
        )
        return self._sum(2.0 / (self.high - self.low) * by_scaled)

    @cached_property
    def error(self) -> float:
        """Relative error of the interpolation, from how fast the coefficients of Chebyshev polynomials fall."""
        sizes = np.linalg.norm(self._coefficients, axis=1)
        return float(sizes[-1] ** 2 / max(sizes[-2] * sizes[0], 1e-300))

    @cached_property
    def effect(self) -> float:
        """How much a change of the number changes the matrix, over what a translation of 1 m changes."""
        middle = 0.5 * (self.low + self.high)
        here, change = self.at(middle).matrix, self.derivative(middle).matrix
        wavenumber = self.scene.wavenumber.real
        moved = [one + one.T for one in along_motions(np.ascontiguousarray(here), wavenumber)[:3]]
        return float(
            np.linalg.norm(change) / np.sqrt(np.mean([np.linalg.norm(one) ** 2 for one in moved]))
        )

    def _scaled(self, value: float) -> float:
        return (2.0 * value - self.low - self.high) / (self.high - self.low)

    @cached_property
    def _coefficients(self) -> Complex128[np.ndarray, "values entries"]:
        """Coefficients of Chebyshev polynomials of each entry of the matrix."""
        count = len(self.matrices)
        terms = chebyshev.chebvander(chebyshev.chebpts1(count), count - 1) * (2.0 / count)
        terms[:, 0] *= 0.5
        return terms.T @ np.stack([one.matrix.reshape(-1) for one in self.matrices])

    def _sum(self, weights: Float64[np.ndarray, "values"]) -> ScatteringMatrix:
        first = self.matrices[0]
        return replace(first, matrix=(weights @ self._coefficients).reshape(first.matrix.shape))


def scattering_family(
    solver: Solver,
    scene_of: Callable[[float], Scene],
    low: float,
    high: float,
    *,
    start: float | None = None,
    values: int = 5,
    accuracy: float = 0.005,
) -> ScatteringFamily:
    """Solve bodies that change with one number, such as the gap of two fingers, for a few values of it.

    ``locate`` finds the number together with the pose. Each value takes a scattering matrix, which
    ``Stored(solver, folder)`` keeps. Between the values the matrix is interpolated: five values
    reach to 2 mm on both sides at 40 kHz.

    Parameters
    ----------
    solver : solves the bodies, as for ``scattering_matrix``.
    scene_of : makes the bodies for a value of the number, always as many, in the same frame, medium
        and frequency.
    low, high : least and largest value of the number.
    start : value from which ``locate`` starts; the middle unless given.
    values : number of values that are solved, 3 to 12.
    accuracy : as for ``scattering_matrix``.

    Raises
    ------
    InvalidInput
        "out_of_range": of the values; "does_not_match": the scenes do not belong together; "all_zero": the bodies do
        not change with the number; "too_few": interpolation between them is more than 2 % off; or as
        ``scattering_matrix``.

    Examples
    --------
    >>> import airtact as at
    >>> def balls(gap):
    ...     two = [at.sphere(3e-3, 2e-3, (side * (3e-3 + gap / 2), 0, 0)) for side in (-1, 1)]
    ...     return at.Scene(at.air(celsius=20.0), [at.sound_hard(one) for one in two], frequency=40e3)
    >>> family = scattering_family(at.BoundaryElement(accuracy=0.05, estimate=False), balls, 4e-3, 6e-3, values=4)
    >>> family.error < 0.01
    True
    """
    of_kind(solver, Solver, "the solver", "one such as BoundaryElement()")
    low, high, start = _checked_range(low, high, start, values)
    chosen = 0.5 * (low + high) + 0.5 * (high - low) * chebyshev.chebpts1(int(values))
    scenes = [
        of_kind(scene_of(float(value)), Scene, "what scene_of makes", "Scene(medium, bodies)")
        for value in chosen
    ]
    _check_together(scenes)
    balls = [ball_of(scene) for scene in scenes]
    centre = np.mean([middle for middle, _ in balls], axis=0)
    radius = max(float(np.linalg.norm(middle - centre)) + size for middle, size in balls)
    matrices = tuple(
        scattering_matrix(solver, scene, accuracy, (centre, radius)) for scene in scenes
    )
    return _checked(ScatteringFamily(scene_of, low, high, start, matrices))


def _checked_range(
    low: float, high: float, start: float | None, values: int
) -> tuple[float, float, float]:
    """Return both ends and the start, or raise "out_of_range"."""
    low, high = (number(value, "an end of the range", "the number's unit") for value in (low, high))
    start = 0.5 * (low + high) if start is None else number(start, "the start", "the number's unit")
    if not -np.inf < low < high < np.inf or not low <= start <= high:
        raise InvalidInput(
            f"the range {low:g} to {high:g} with a start at {start:g} is none: give low < high and a start between.",
            code="out_of_range",
        )
    if not isinstance(values, int | np.integer) or not FEWEST <= values <= MOST:
        raise InvalidInput(
            f"a family is solved for a whole number of values from {FEWEST} to {MOST}, not {values!r}.",
            code="out_of_range",
        )
    return low, high, start


def _check_together(scenes: list[Scene]) -> None:
    """Raise "does_not_match" where scenes have other media, frequencies or numbers of bodies, or "empty"."""
    first = scenes[0]
    for scene in scenes:
        if not scene.obstacles:
            raise InvalidInput("a scene of the family has 0 obstacles; give bodies.", code="empty")
        if scene.wavenumber != first.wavenumber or len(scene.obstacles) != len(first.obstacles):
            raise InvalidInput(
                f"scenes of one family have {len(first.obstacles)} and {len(scene.obstacles)} bodies at "
                f"{first.frequency:g} and {scene.frequency:g} Hz, in {first.medium} and {scene.medium}: only the shape "
                "of the bodies may change.",
                code="does_not_match",
            )


def _checked(family: ScatteringFamily) -> ScatteringFamily:
    """Return the family, or raise "all_zero" or "too_few"."""
    reach = 0.5 * (family.high - family.low) * family.effect
    if reach < 1e-7:
        raise InvalidInput(
            f"from {family.low:g} to {family.high:g} the bodies change by no more than if they moved by "
            f"{1e3 * reach:.1g} mm: scene_of must use the number.",
            code="all_zero",
        )
    if family.error > INTERPOLATED:
        raise InvalidInput(
            f"{len(family.matrices)} values from {family.low:g} to {family.high:g} are too few: between them the "
            f"scattering matrix is {100 * family.error:.2g} % off, and at most {100 * INTERPOLATED:g} % are taken: "
            "give more values, or a smaller range.",
            code="too_few",
        )
    return family
