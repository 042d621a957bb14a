"""The scattering matrix (T-matrix) of the bodies of a scene, in spherical waves.

A single solve covers all regular waves. A layer of monopoles of density Z_nm on a sphere around the
bodies generates the regular wave j_n(kr) Z_nm inside. Its quadrature also generates waves of
aliased orders, which decay inwards. The solver's monopoles that radiate the scattered pressure are
projected onto outgoing waves. If a solver has no such monopoles, the scattered pressure on the same
sphere is projected instead. See P. C. Waterman, J. Acoust. Soc. Am. 45, 1417 (1969), and
P. A. Martin, Multiple Scattering (2006), chapter 7.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.linalg
from jaxtyping import Complex64, Complex128, Float64
from numpy.polynomial import chebyshev
from scipy.interpolate import BarycentricInterpolator

from airtact.acoustics.scene import Scene, check_no_planes
from airtact.acoustics.solvers.problem import Solver, SolveReport
from airtact.acoustics.solvers.shared import sphere_rule
from airtact.acoustics.solvers.spherical.multipole_field import ball_of
from airtact.acoustics.sources import Monopoles
from airtact.errors import InvalidInput, number, of_kind, one_line, within
from airtact.sensing.waves import (
    along_motions,
    harmonics,
    mixed,
    of_waves,
    order_of,
    outgoing_radial,
    projected,
    regular_waves,
    wave_count,
)


@dataclass(frozen=True, eq=False)
class ScatteringMatrix:
    """Scattering matrix (T-matrix) of a scene's bodies, as returned by ``scattering_matrix``.

    For an incident field Σ a_nm j_n(kr) Z_nm, the scattered field is Σ b_nm h_n(kr) Z_nm with
    b = T a. h_n is the spherical Hankel function of the first kind, for the time factor e^{-iωt}.
    Z_nm are the real, orthonormal spherical harmonics (m > 0: cos mφ, m < 0: sin |m|φ) without the
    Condon-Shortley sign, with the polar axis z of the bodies' frame. Wave (n, m) has the index
    n² + n + m. ``locate`` and ``simulate_echoes`` use the matrix.

    Attributes
    ----------
    matrix : (W, W) complex matrix T for W = (order + 1)² waves; symmetric, by reciprocity.
    centre : (3,) centre of the waves, in the frame of the bodies [m].
    radius : radius of a ball about the centre that contains the bodies [m]; transducers must be
        outside the ball.
    scene : the bodies, their medium and the frequency.
    asymmetry : norm of the difference between the matrix and its transpose before symmetrisation,
        relative to the norm of the matrix; a measure of the solver's error.
    report : ``SolveReport`` that the solver returned.
    """

    matrix: Complex128[np.ndarray, "waves waves"]
    centre: Float64[np.ndarray, "3"]
    radius: float
    scene: Scene
    asymmetry: float
    report: SolveReport

    def __repr__(self) -> str:
        return one_line(
            self,
            f"{len(self.matrix)} waves, order {self.order}",
            f"ball of {1e3 * self.radius:.3g} mm",
            f"asymmetry {100 * self.asymmetry:.2g} %",
        )

    @cached_property
    def single(self) -> Complex64[np.ndarray, "waves waves"]:
        """(W, W) scattering matrix in single precision."""
        return self.matrix.astype(np.complex64)

    @property
    def order(self) -> int:
        """Highest order n of the waves."""
        return order_of(self.matrix)


def scattering_matrix(
    solver: Solver,
    scene: Scene,
    accuracy: float = 0.005,
    ball: tuple[Float64[np.ndarray, "3"], float] | None = None,
) -> ScatteringMatrix:
    """Solve for the response of the bodies of a scene to all regular spherical waves.

    The matrix relates the outgoing spherical waves that the bodies scatter to the regular waves
    that reach them, about one centre. One solve covers all waves, which are several hundred
    excitations. If the solver is ``Stored(solver, folder)``, the result is stored in the folder.
    With the matrix, ``simulate_echoes`` and ``locate`` compute the echoes of any rigid pose in
    milliseconds.

    Parameters
    ----------
    solver : solver for the bodies, such as ``BoundaryElement(accuracy=0.01, estimate=False)``.
    scene : the bodies, in their own frame.
    accuracy : relative error due to the finite number of waves, 0.0001 to 0.1; it determines the
        highest order. It does not include the error of ``solver``.
    ball : (3,) centre of the waves in the bodies' frame, and radius of a ball around it that
        contains the bodies [m]; by default nearly the smallest such ball.

    Returns
    -------
    A ``ScatteringMatrix`` for all waves up to the order that the accuracy requires.

    Raises
    ------
    InvalidInput
        If the scene has no bodies, or has planes or reflecting boards. If ``accuracy`` is outside
        its range, or the bodies require waves of an order above 80. If the solver does not support
        the bodies or cannot compute the field around them.
    NotConverged
        If the solver stops before it converges.

    Examples
    --------
    >>> import airtact as at
    >>> scene = at.Scene(at.air(celsius=20.0), [at.sound_hard(at.sphere(radius=5e-3, edge=2e-3))])
    >>> scattering_matrix(at.SphereSeries(), scene).matrix.shape
    (49, 49)
    """
    of_kind(solver, Solver, "the solver", "one such as BoundaryElement()")
    of_kind(scene, Scene, "the scene", "Scene(medium, obstacles)")
    accuracy = within(accuracy, 1e-4, 0.1, "accuracy", "", "1 per cent is 0.01.")
    if not scene.obstacles:
        raise InvalidInput(
            "the scene has no obstacles and scatters nothing; add bodies.", code="empty"
        )
    check_no_planes(scene, "a scattering matrix")
    centre, radius = ball_of(scene) if ball is None else ball
    # The order exceeds kR by an amount that grows as d^(2/3) (kR)^(1/3) for d digits of accuracy
    # (W. C. Chew and others, Fast and Efficient Algorithms in Computational Electromagnetics, 2001,
    # section 3.4). The factor was determined on pairs of capsules.
    reach = scene.wavenumber.real * radius
    order = int(np.ceil(reach + 0.8 * (-np.log10(accuracy)) ** (2 / 3) * np.cbrt(reach)))
    if order > 80:  # 6,561 waves need 0.7 GB
        raise InvalidInput(
            f"the bodies require waves up to order {order}, but at most 80 is allowed. Use smaller "
            "bodies, such as the fingers without the hand, or a larger value of accuracy.",
            code="too_many",
        )
    outer = radius + scene.wavelength  # radius of the layer of sources
    # Three additional orders avoid aliasing.
    directions, weights = sphere_rule(order + 3)
    weights = np.repeat(weights, directions.shape[1])
    directions = directions.reshape(-1, 3)
    waves = harmonics(order, directions)
    radial = of_waves(order, outgoing_radial(order, np.array([outer]), scene.wavenumber))
    patterns = reaching_patterns(scene, centre, order, accuracy)
    amplitudes = 1.0 / (4j * np.pi * scene.wavenumber * radial)
    amplitudes = np.diag(amplitudes[:, 0]) if patterns is None else amplitudes * patterns
    # The amplitudes follow from the field inside a layer of density Z_nm, 4πik h_n(kR) j_n(kr)
    # Z_nm.
    layer = mixed((weights * waves).T, amplitudes)
    field = solver.radiate(scene, Monopoles(centre + outer * directions, layer))
    # Projecting monopoles requires neither a quadrature nor the field close to the bodies.
    sources = field.scattering_sources
    if sources is not None:
        offsets = sources.positions - centre
        scattered = projected(order, offsets, sources.strengths, scene.wavenumber)
    else:
        pressures = field.scattered_at(centre + outer * directions)
        if not np.isfinite(pressures).all():
            raise InvalidInput(
                f"the solver returns no field {1e3 * outer:.3g} mm from the centre of the bodies; "
                "use a solver that computes the field all around the bodies.",
                code="data_missing",
            )
        scattered = (weights * waves) @ pressures / radial
    among = scattered if patterns is None else mixed(patterns.T, scattered)
    asymmetry = float(np.linalg.norm(among - among.T) / np.linalg.norm(among))
    matrix = _symmetric(scattered, patterns)
    matrix.flags.writeable = False
    return ScatteringMatrix(matrix, centre, radius, scene, asymmetry, field.report)


def _symmetric(
    scattered: Complex128[np.ndarray, "waves patterns"],
    patterns: Float64[np.ndarray, "waves patterns"] | None,
) -> Complex128[np.ndarray, "waves waves"]:
    """Return the symmetric matrix from its product with patterns.

    By reciprocity, this product also determines the product with all other waves, projected onto
    the patterns. The remaining block is neglected; it is of second order in the waves that are
    small at the bodies.
    """
    if patterns is None:
        return 0.5 * (scattered + scattered.T)
    among = mixed(patterns.T, scattered)
    half = scattered - mixed(patterns, among - 0.25 * (among + among.T))
    halves = mixed(patterns, half.T)
    return halves + halves.T


def check_own(scattering: ScatteringMatrix, scene: Scene) -> None:
    """Raise an error if the matrix belongs to another scene."""
    if scattering.scene is not scene:
        raise InvalidInput(
            "the scattering matrix belongs to another scene; use scattering.scene.",
            code="does_not_match",
        )


def reaching_patterns(
    scene: Scene, centre: Float64[np.ndarray, "3"], order: int, smallest: float
) -> Float64[np.ndarray, "waves patterns"] | None:
    """Return the orthonormal patterns (waves, N) of regular waves that reach the bodies.

    Each column contains the weights of the waves in one pattern. None is returned if most patterns
    reach the bodies.

    The bodies fill only a part of the ball around them, so most patterns hardly reach the bodies.
    The patterns are eigenvectors of the matrix that determines the mean square pressure of a
    pattern on and below the surfaces. Points below the surfaces are included because, at an
    interior resonance, a wave vanishes on the surfaces. Patterns with an rms pressure below
    ``smallest`` times the largest are omitted.
    """
    # Choose random points on the triangles of the surfaces, and the same number below them [m].
    random = np.random.default_rng(0)
    corners = np.concatenate([body.surface.corners for body in scene.obstacles])
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(normals, axis=1) / 2.0
    count = int(np.ceil(30 * areas.sum() / scene.wavelength**2))  # 30 per square wavelength
    # Stratified sampling: one point in each equal part of the area.
    levels = (np.arange(count) + random.random(count)) / count * areas.sum()
    chosen = np.minimum(np.searchsorted(np.cumsum(areas), levels), len(areas) - 1)
    on_skin = np.einsum("pc,pci->pi", random.dirichlet(np.ones(3), count), corners[chosen])
    inwards = -normals[chosen] / (2.0 * areas[chosen, None])
    points = np.concatenate([on_skin, on_skin + 0.2 * scene.wavelength * inwards]) - centre
    squares = np.zeros((wave_count(order), wave_count(order)), dtype=np.float32)
    for block in np.split(points, range(4096, len(points), 4096)):
        waves = regular_waves(order, block, scene.wavenumber.real).astype(np.float32)
        squares += waves @ waves.T
    values, patterns = scipy.linalg.eigh(
        squares, overwrite_a=True, check_finite=False, driver="evd"
    )
    count = int(np.count_nonzero(values > smallest**2 * values[-1]))
    # If most patterns are needed, selecting them saves no work.
    return patterns[:, -count:].astype(np.float64) if count < 0.8 * len(values) else None


@dataclass(frozen=True, eq=False)
class ScatteringFamily:
    """Scattering matrices for one shape parameter, as returned by ``scattering_family``.

    Pass a family to ``locate`` to find the parameter, such as the gap between two fingers, together
    with the pose of the bodies. ``at`` returns the matrix for any value of the parameter. Each
    entry of the matrix is interpolated by the polynomial through Chebyshev points, which is
    nearly optimal for smooth functions (L. N. Trefethen, Approximation Theory and Approximation
    Practice (2013), chapters 3 and 4). The polynomial also yields the derivative.

    Attributes
    ----------
    low, high : smallest and largest value of the parameter, which is the argument of the function
        ``scene_of`` that was passed to ``scattering_family``. The matrix is not accurate outside
        this range.
    start : value of the parameter at which ``locate`` begins its search.
    matrices : the N matrices at the solved values in increasing order, all with waves about the
        same point. The values are Chebyshev points, so they lie inside the range.
    """

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
        """Scene for the first solved value; all values have the same medium and frequency."""
        return self.matrices[0].scene

    def at(self, value: float) -> ScatteringMatrix:
        """Return the matrix interpolated at a value of the parameter.

        The attributes ``scene`` and ``report`` of the result are those of the first solved value.
        """
        return replace(self.matrices[0], matrix=self._polynomial(value))

    def derivative(self, value: float) -> ScatteringMatrix:
        """Return the derivative of the matrix with respect to the parameter, at a given value."""
        return replace(self.matrices[0], matrix=self._polynomial.derivative(value))

    @cached_property
    def _polynomial(self) -> BarycentricInterpolator:
        matrices = np.stack([solved.matrix for solved in self.matrices])
        return BarycentricInterpolator(_nodes(self.low, self.high, len(matrices)), matrices)

    @cached_property
    def error(self) -> float:
        """Relative interpolation error, estimated from the decay of the Chebyshev coefficients."""
        matrices = np.stack([solved.matrix.ravel() for solved in self.matrices])
        count = len(matrices)
        coefficients = chebyshev.chebfit(chebyshev.chebpts1(count), matrices, count - 1)
        sizes = np.linalg.norm(coefficients, axis=1)
        # The first omitted coefficient continues the geometric decay of the last two.
        return float(sizes[-1] ** 2 / max(sizes[-2] * sizes[0], 1e-300))

    @cached_property
    def effect(self) -> float:
        """Effect of the parameter on the matrix, compared with that of a translation [m per unit].

        The effect is the change of the matrix per unit of the parameter, divided by its change per
        metre of translation.
        """
        middle = 0.5 * (self.low + self.high)
        here = self.at(middle).matrix
        change = self.derivative(middle).matrix
        wavenumber = self.scene.wavenumber.real
        # A translation changes T by V T − T V, with V antisymmetric and T symmetric.
        products = along_motions(np.ascontiguousarray(here), wavenumber)[:3]
        squares = [np.linalg.norm(product + product.T) ** 2 for product in products]
        return float(np.linalg.norm(change) / np.sqrt(np.mean(squares)))


def _nodes(low: float, high: float, count: int) -> Float64[np.ndarray, "values"]:
    return 0.5 * (low + high) + 0.5 * (high - low) * chebyshev.chebpts1(count)


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
    """Solve for the scattering matrices at a few values of one shape parameter, such as a gap.

    ``locate`` finds the parameter together with the pose. A scattering matrix is computed for each
    value. If the solver is ``Stored(solver, folder)``, the matrices are stored in the folder.
    Between the values, the matrix is interpolated. At 40 kHz, five values suffice for a gap that
    varies by ±2 mm.

    Parameters
    ----------
    solver : solver for the bodies, as in ``scattering_matrix``.
    scene_of : function that returns the scene for a value of the parameter. The number of bodies,
        the frame, the medium and the frequency must not depend on the value.
    low, high : smallest and largest value of the parameter, in any unit; ``low`` is below ``high``.
    start : value of the parameter at which ``locate`` begins, from ``low`` to ``high``; by default
        the middle of the range.
    values : number of solved values, 3 to 12; 5 by default. They are Chebyshev points of the range.
    accuracy : relative error due to the finite number of waves, 0.0001 to 0.1; 0.005 by default.

    Returns
    -------
    A ``ScatteringFamily`` with the matrices at the solved values, which interpolates between them.

    Raises
    ------
    InvalidInput
        If ``low``, ``high``, ``start``, ``values`` or ``accuracy`` is outside its range. If the
        scenes have different media, frequencies or numbers of bodies, or hardly depend on the
        parameter. If the interpolation error exceeds 2 %. If a scene has no bodies, or the solver
        does not support the scene.
    NotConverged
        If the solver stops before it converges.

    Examples
    --------
    >>> import airtact as at
    >>> def balls(gap):
    ...     places = [(side * (3e-3 + gap / 2), 0, 0) for side in (-1, 1)]
    ...     bodies = [at.sound_hard(at.sphere(3e-3, 2e-3, place)) for place in places]
    ...     return at.Scene(at.air(celsius=20.0), bodies, frequency=40e3)
    >>> solver = at.BoundaryElement(accuracy=0.05, estimate=False)
    >>> family = scattering_family(solver, balls, 4e-3, 6e-3, values=4)
    >>> family.error < 0.01
    True
    """
    of_kind(solver, Solver, "the solver", "one such as BoundaryElement()")
    middle = 0.5 * (number(low, "low", "") + number(high, "high", ""))
    start = middle if start is None else start
    if not -np.inf < low <= start <= high < np.inf or low == high or values not in range(3, 13):
        raise InvalidInput(
            f"{values!r} values in the range {low:g} to {high:g} with the start {start:g} are not "
            "valid; use low < high, a start between them, and 3 to 12 values.",
            code="out_of_range",
        )
    scenes = [scene_of(float(value)) for value in _nodes(low, high, values)]
    first = scenes[0]
    for scene in scenes:
        if scene.wavenumber != first.wavenumber or len(scene.obstacles) != len(first.obstacles):
            raise InvalidInput(
                f"scenes of the family have {len(first.obstacles)} and {len(scene.obstacles)} "
                f"bodies at {first.frequency:g} and {scene.frequency:g} Hz, in {first.medium} and "
                f"{scene.medium}; only the shape of the bodies may change.",
                code="does_not_match",
            )
    balls = [ball_of(scene) for scene in scenes]
    centre = np.mean([middle for middle, _ in balls], axis=0)
    # One ball is used for all values, so that all matrices have the same waves.
    radius = max(float(np.linalg.norm(middle - centre)) + size for middle, size in balls)
    matrices = tuple(
        scattering_matrix(solver, scene, accuracy, (centre, radius)) for scene in scenes
    )
    family = ScatteringFamily(low, high, start, matrices)
    # This translation changes the matrix as much as half the range does.
    shift = 0.5 * (high - low) * family.effect
    if shift < 1e-7:
        raise InvalidInput(
            f"from {low:g} to {high:g}, the scattering matrix hardly changes (as if the bodies "
            f"moved by {1e3 * shift:.1g} mm). The bodies that scene_of returns must depend on its "
            "argument.",
            code="all_zero",
        )
    if family.error > 0.02:  # above this the interpolation limits the fit, not the solver
        raise InvalidInput(
            f"{len(matrices)} values from {low:g} to {high:g} are too few: the interpolation error "
            f"of the scattering matrix is {100 * family.error:.2g} %, more than 2 %. Use more "
            "values or a smaller range.",
            code="too_few",
        )
    return family
