"""The scattering matrix (T-matrix) of the bodies of a scene: what they make of regular spherical waves.

The bodies are solved for all regular waves at once. A layer of monopoles of density Z_nm on a
sphere around them makes the regular wave j_n(kr) Z_nm inside it, exactly but for orders that its
quadrature mistakes for one another, and these vanish inside as fast as the waves do. The monopoles
that radiate the scattered pressure are projected onto outgoing waves, or, where the solver has
none, the scattered pressure on the same sphere. (The matrix: P. C. Waterman, J. Acoust. Soc. Am.
45, 1417, 1969; P. A. Martin, Multiple Scattering, 2006, chapter 7.)
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg
from jaxtyping import Complex64, Complex128, Float32, Float64

from airtact.acoustics.scene import Scene, check_no_planes
from airtact.acoustics.solvers.problem import Solver, SolveReport
from airtact.acoustics.solvers.spherical.multipole_field import ball_of
from airtact.acoustics.sources import Monopoles
from airtact.checks import counted, of_kind, within
from airtact.errors import InvalidInput
from airtact.geometry.mesh.quadratic_triangles import panel_areas, points_at, unit
from airtact.printing import one_line
from airtact.sensing.waves import (
    Waves,
    harmonics,
    mixed,
    of_waves,
    order_of,
    outgoing_radial,
    projected,
    regular_waves,
    wave_count,
)

GAP = 1.0
"""Gap between the ball around the bodies and the sphere of sources, in wavelengths."""

SPARE = 3
"""Orders beyond those of the matrix that the quadrature on the sphere tells apart."""

LEAST_REACHING = 1.0
"""Least pressure on and under the surfaces of the patterns that the bodies are solved for, relative to the strongest,
over the accuracy of the matrix. Two fingers' matrix is 0.0002 off at 0.005."""

PATTERNS_LEFT_OUT = 3e-4
"""Part of the matrix (Frobenius) that may be left out of products with it in single precision."""

LOSSES = 1e-3
"""Part of the matrix among the patterns (Frobenius) off its diagonal up to which that is taken for a solver's error."""

SHARE = 0.618
"""Part of the imaginary part that is added to the real one, so that different eigenvalues make different sums."""

LARGEST_ORDER = 80
"""Highest order of a matrix: 6,561 waves."""

DENSITY = 30
"""Points on the surfaces, per square wavelength."""

UNDER = 0.2
"""Depth of the points under the surfaces, in wavelengths."""

AT_ONCE = 4096
"""Points at which waves are computed at once."""

WORTHWHILE = 0.8
"""Patterns over waves from which on they save no work."""


@dataclass(frozen=True, eq=False)
class ScatteringMatrix:
    """What the bodies of a scene scatter, in spherical waves about one centre; ``scattering_matrix`` makes it.

    A field Σ a_nm j_n(kr) Z_nm around the bodies makes them scatter Σ b_nm h_n(kr) Z_nm with b = T
    a. Z_nm are the real, orthonormal spherical harmonics (m > 0: cos mφ, m < 0: sin |m|φ, without
    the sign of Condon and Shortley), and wave (n, m) has the index n² + n + m.

    Attributes
    ----------
    matrix : (W, W) T of W = (order + 1)² waves; symmetric, by reciprocity.
    centre : (3,) of the waves, in the frame of the bodies [m].
    radius : of a ball about the centre that holds the bodies [m]; transducers must stand outside
        it.
    scene : the bodies, their medium and the frequency.
    asymmetry : relative difference of the matrix from its transpose before both were averaged.
    report : of the solve.
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

    def scatter(self, regular: Waves) -> Waves:
        """Return the waves (W, S) that the bodies radiate for regular ones (W, S), in single precision.

        Few patterns of the waves reach the bodies where these fill little of their ball, which
        halves the work.
        """
        patterns = self.__dict__.get("patterns")  # not worth finding for a matrix that serves once
        if patterns is None:
            return self.single @ regular
        some, among = patterns
        inside = mixed(some.T, regular)
        return mixed(some, among @ inside if among.shape[1] > 1 else among * inside)

    @cached_property
    def patterns(
        self,
    ) -> (
        tuple[Float32[np.ndarray, "waves patterns"], Complex64[np.ndarray, "patterns others"]]
        | None
    ):
        """Orthonormal real patterns of waves, and the matrix among them; None where they save no work.

        Bodies and air that absorb nothing make each of their patterns into itself, times a number:
        the matrix has real orthogonal eigenvectors (R. J. Garbacz, R. H. Turpin, IEEE Trans.
        Antennas Propag. 19 (1971) 348), most of them with an eigenvalue of about 0. The others
        (patterns, 1) are given then. ``locate`` asks for them, which takes some tenths of a second.
        ``scatter`` uses them once they are found.
        """
        parts = np.concatenate([np.real(self.single), np.imag(self.single)])
        squares, patterns = scipy.linalg.eigh(parts.T @ parts, overwrite_a=True, check_finite=False)
        left_out = np.cumsum(np.maximum(squares, 0.0), dtype=np.float64)
        count = len(squares)
        kept = count - int(np.searchsorted(left_out, PATTERNS_LEFT_OUT**2 * left_out[-1]))
        if kept * (count + kept) > count**2:
            return None
        some = np.ascontiguousarray(patterns[:, -kept:])
        among = mixed(some.T, mixed(some.T, self.single).T)
        own = _eigenvectors(among.astype(np.complex128)).astype(np.float32)
        alone = mixed(own.T, mixed(own.T, among).T)
        eigenvalues = np.diag(alone)[:, None]
        if np.linalg.norm(alone - np.diag(eigenvalues[:, 0])) > LOSSES * np.linalg.norm(alone):
            return some, among
        return some @ own, eigenvalues.copy()

    @cached_property
    def single(self) -> Complex64[np.ndarray, "waves waves"]:
        """(W, W) the matrix in single precision."""
        return self.matrix.astype(np.complex64)

    @property
    def order(self) -> int:
        """Highest order n of the waves."""
        return order_of(self.matrix)

    @property
    def lost_power(self) -> float:
        """Relative deviation of I + 2T from a unitary matrix, which it is for bodies and air that absorb nothing.

        The waves are weighted alike, so that waves that hardly reach the bodies count little.
        """
        off = self.matrix.conj().T @ self.matrix + 0.5 * (self.matrix + self.matrix.conj().T)
        return float(np.linalg.norm(off) / np.linalg.norm(self.matrix))


def _eigenvectors(
    among: Complex128[np.ndarray, "patterns patterns"],
) -> Float64[np.ndarray, "patterns patterns"]:
    """Real eigenvectors of the matrix nearest to one that absorbs nothing.

    1 + 2T is unitary then. One step of Newton and Schulz makes it that much more, which squares
    what a solver's error is off (N. J. Higham, Functions of Matrices, 2008, section 8.3); real and
    imaginary part have the same eigenvectors.
    """
    one = np.eye(len(among))
    unitary = one + 2.0 * among
    unitary = unitary @ (1.5 * one - 0.5 * unitary.conj().T @ unitary)
    both = unitary.real + SHARE * unitary.imag
    return scipy.linalg.eigh(0.5 * (both + both.T), overwrite_a=True, check_finite=False)[1]


def scattering_matrix(
    solver: Solver,
    scene: Scene,
    accuracy: float = 0.005,
    ball: tuple[Float64[np.ndarray, "3"], float] | None = None,
) -> ScatteringMatrix:
    """Solve the bodies of a scene for all regular spherical waves about the middle of them.

    It takes one block solve of some hundreds of excitations; ``Stored(solver, folder)`` keeps it.
    Echoes for any rigid pose then take milliseconds, see ``simulate_echoes`` and ``locate``.

    Parameters
    ----------
    solver : solves the bodies, such as ``BoundaryElement(accuracy=0.01, estimate=False)``; its
        accuracy is its own.
    scene : the bodies, in their own frame.
    accuracy : relative error by waves that are left out, 0.0001 to 0.1; it sets the order.
    ball : centre (3,) of the waves and radius of a ball that holds the bodies [m]; hardly larger
        than the smallest unless given.

    Raises
    ------
    InvalidInput
        "empty", "out_of_range", "too_many": bodies that need more than order 80, "data_missing": the solver
        gives no field around them; or as the solver.

    Examples
    --------
    >>> import airtact as at
    >>> scene = at.Scene(at.air(celsius=20.0), [at.sound_hard(at.sphere(radius=5e-3, edge=2e-3))])
    >>> scattering_matrix(at.SphereSeries(), scene).matrix.shape
    (49, 49)
    """
    of_kind(solver, Solver, "the solver", "one such as BoundaryElement()")
    of_kind(scene, Scene, "the scene", "Scene(medium, obstacles)")
    accuracy = within(accuracy, 1e-4, 0.1, "accuracy", "parts of 1", "1 per cent is 0.01.")
    if not scene.obstacles:
        raise InvalidInput(
            "the scene has 0 obstacles, so nothing is scattered; give bodies.", code="empty"
        )
    check_no_planes(scene, "a scattering matrix")
    return _about(solver, scene, *(ball_of(scene) if ball is None else ball), accuracy)


def _about(
    solver: Solver, scene: Scene, centre: Float64[np.ndarray, "3"], radius: float, accuracy: float
) -> ScatteringMatrix:
    """Solve the bodies of a scene for the regular waves about the middle of a ball that holds them."""
    order = _order(scene.wavenumber.real * radius, accuracy)
    outer = radius + GAP * scene.wavelength
    directions, weights = _quadrature(order + SPARE)
    waves = harmonics(order, directions)
    radial = of_waves(order, outgoing_radial(order, np.array([outer]), scene.wavenumber))
    patterns = reaching_patterns(scene, centre, order, LEAST_REACHING * accuracy)
    amplitudes = 1.0 / (4j * np.pi * scene.wavenumber * radial)
    amplitudes = np.diag(amplitudes[:, 0]) if patterns is None else amplitudes * patterns
    layer = mixed((weights * waves).T, amplitudes)
    field = solver.radiate(scene, Monopoles(centre + outer * directions, layer))
    if (sources := field.scattering_sources) is not None:
        scattered = projected(
            order, sources.positions - centre, sources.strengths, scene.wavenumber
        )
    else:
        known = _known(field.scattered_at(centre + outer * directions), outer)
        scattered = (weights * waves) @ known / radial
    among = scattered if patterns is None else mixed(patterns.T, scattered)
    asymmetry = float(np.linalg.norm(among - among.T) / np.linalg.norm(among))
    matrix = _symmetric(scattered, patterns)
    matrix.flags.writeable = False
    return ScatteringMatrix(matrix, centre, radius, scene, asymmetry, field.report)


def _symmetric(
    scattered: Complex128[np.ndarray, "waves patterns"],
    patterns: Float64[np.ndarray, "waves patterns"] | None,
) -> Complex128[np.ndarray, "waves waves"]:
    """Return the symmetric matrix from what it makes of patterns.

    By reciprocity it also follows what all other waves make of these. Only what the others make of
    each other is left out, which is as little as they reach the bodies, squared.
    """
    if patterns is None:
        return 0.5 * (scattered + scattered.T)
    among = mixed(patterns.T, scattered)
    half = scattered - mixed(patterns, among - 0.25 * (among + among.T))
    whole = mixed(patterns, half.T)
    return whole + whole.T


def check_own(scattering: ScatteringMatrix, scene: Scene) -> None:
    """Raise "does_not_match" where the matrix is not of this very scene."""
    if scattering.scene is not scene:
        count = counted(len(scattering.scene.obstacles), "body", "bodies")
        raise InvalidInput(
            f"the scattering matrix is of another scene of {count}: give its own, scattering.scene.",
            code="does_not_match",
        )


def _known(
    scattered: Complex128[np.ndarray, "points waves"], outer: float
) -> Complex128[np.ndarray, "points waves"]:
    """Raise "data_missing" where a pressure on the sphere is unknown."""
    if not np.isfinite(scattered).all():
        unknown = int((~np.isfinite(scattered)).any(axis=1).sum())
        raise InvalidInput(
            f"the field is not known at {unknown} of {len(scattered)} points {1e3 * outer:.3g} mm from the middle of "
            "the bodies; give a solver that knows it all around them.",
            code="data_missing",
        )
    return scattered


def _order(reach: float, accuracy: float) -> int:
    """Order from which on waves count less than an accuracy, by k times the radius of the bodies.

    The excess over kR grows as d^(2/3) (kR)^(1/3) for d digits (W. C. Chew and others, Fast and
    Efficient Algorithms in Computational Electromagnetics, 2001, section 3.4); the factor is
    measured on pairs of capsules.
    """
    order = int(np.ceil(reach + 0.8 * (-np.log10(accuracy)) ** (2 / 3) * np.cbrt(reach)))
    if order > LARGEST_ORDER:
        raise InvalidInput(
            f"the bodies need waves up to order {order}, more than {LARGEST_ORDER}: give smaller bodies, such as the "
            "fingers without the hand, or a lower accuracy.",
            code="too_many",
        )
    return order


def _quadrature(
    order: int,
) -> tuple[Float64[np.ndarray, "points 3"], Float64[np.ndarray, "points"]]:
    """Directions and weights on the unit sphere that integrate products of two waves up to an order exactly."""
    cosines, weights = np.polynomial.legendre.leggauss(order + 1)
    azimuth = 2 * np.pi * np.arange(2 * order + 1) / (2 * order + 1)
    sines = np.sqrt(1.0 - cosines**2)
    parts = (
        np.outer(sines, np.cos(azimuth)),
        np.outer(sines, np.sin(azimuth)),
        np.outer(cosines, np.ones_like(azimuth)),
    )
    return np.stack(parts, axis=-1).reshape(-1, 3), np.repeat(
        weights, len(azimuth)
    ) * 2 * np.pi / len(azimuth)


def reaching_patterns(
    scene: Scene, centre: Float64[np.ndarray, "3"], order: int, least: float
) -> Float64[np.ndarray, "waves patterns"] | None:
    """Orthonormal patterns of regular waves about a centre that reach the bodies; None where nearly all of them do.

    Waves of high order fill a ball, and bodies are a part of it: most patterns of waves hardly
    reach them. The patterns that do are the eigenvectors of the mean square pressure of waves on
    the surfaces and under them. Points under them see what vanishes on the surface alone, as at an
    interior resonance.

    All others make less than ``least`` of the rms pressure of the strongest on and under the
    surfaces.
    """
    points = _points_of(scene) - centre
    squares = np.zeros((wave_count(order), wave_count(order)), dtype=np.float32)
    for first in range(0, len(points), AT_ONCE):
        waves = regular_waves(order, points[first : first + AT_ONCE], scene.wavenumber.real).astype(
            np.float32
        )
        squares += waves @ waves.T
    values, patterns = scipy.linalg.eigh(
        squares, overwrite_a=True, check_finite=False, driver="evd"
    )
    kept = int(np.count_nonzero(values > least**2 * values[-1]))
    return patterns[:, -kept:].astype(np.float64) if kept < WORTHWHILE * len(values) else None


def _points_of(scene: Scene) -> Float64[np.ndarray, "points 3"]:
    """Points at random, evenly on the surfaces, and as many under them [m]."""
    random = np.random.default_rng(0)
    surfaces = [one.surface for one in scene.obstacles]
    curved = np.concatenate(
        [
            np.concatenate([one.corners, one.shape.edge_middles(one.corners)], axis=1)
            for one in surfaces
        ]
    )
    areas = np.cumsum(panel_areas(curved))
    count = int(np.ceil(DENSITY * areas[-1] / scene.wavelength**2))
    chosen = np.searchsorted(
        areas, (np.arange(count) + random.random(count)) / count * areas[-1], side="right"
    )
    places = random.random((count, 2))
    places = np.where(places.sum(axis=1, keepdims=True) > 1.0, 1.0 - places, places)
    points, normals = points_at(curved[np.minimum(chosen, len(areas) - 1)], places)
    return np.concatenate([points, points - UNDER * scene.wavelength * unit(normals)])
