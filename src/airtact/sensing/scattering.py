"""The scattering matrix (T-matrix) of the bodies of a scene: what they make of regular spherical waves.

The bodies are solved for all regular waves at once. A layer of monopoles of density Z_nm on a sphere around them makes
the regular wave j_n(kr) Z_nm inside it, exactly but for orders that its quadrature mistakes for one another, and these
vanish inside as fast as the waves do. The monopoles that radiate the scattered pressure are projected onto outgoing
waves, or, where the solver has none, the scattered pressure on the same sphere. (The matrix: P. C. Waterman, J. Acoust.
Soc. Am. 45, 1417, 1969; P. A. Martin, Multiple Scattering, 2006, chapter 7.)
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128, Float64

from airtact.conventions import InvalidInput
from airtact.printing import one_line
from airtact.scene.scene import Scene, check_no_planes
from airtact.scene.sources import Monopoles
from airtact.sensing.waves import harmonics, order_of, outgoing_radial, projected
from airtact.solvers.problem import Solver, SolveReport
from airtact.solvers.spherical.multipole_field import ball_of
from airtact.validation import counted, of_kind, within

GAP = 1.0
"""Gap between the ball around the bodies and the sphere of sources, in wavelengths."""

SPARE = 6
"""Orders beyond those of the matrix that the quadrature on the sphere tells apart."""

LARGEST_ORDER = 80
"""Highest order of a matrix: 6,561 waves."""


@dataclass(frozen=True, eq=False)
class ScatteringMatrix:
    """What the bodies of a scene scatter, in spherical waves about one centre; ``scattering_matrix`` makes it.

    A field Σ a_nm j_n(kr) Z_nm around the bodies makes them scatter Σ b_nm h_n(kr) Z_nm with b = T a. Z_nm are the
    real, orthonormal spherical harmonics (m > 0: cos mφ, m < 0: sin |m|φ, without the sign of Condon and Shortley), and
    wave (n, m) has the index n² + n + m.

    Attributes
    ----------
    matrix : (W, W) T of W = (order + 1)² waves; symmetric, by reciprocity.
    centre : (3,) of the waves, in the frame of the bodies [m].
    radius : of a ball about the centre that holds the bodies [m]; transducers must stand outside it.
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


def scattering_matrix(solver: Solver, scene: Scene, accuracy: float = 0.005) -> ScatteringMatrix:
    """Solve the bodies of a scene for all regular spherical waves about the middle of them.

    It takes one block solve of some hundreds of excitations; ``Stored(solver, folder)`` keeps it. Echoes for any rigid
    pose then take milliseconds, see ``simulate_echoes`` and ``locate``.

    Parameters
    ----------
    solver : solves the bodies, such as ``BoundaryElement(accuracy=0.01, estimate=False)``; its accuracy is its own.
    scene : the bodies, in their own frame.
    accuracy : relative error by waves that are left out, 0.0001 to 0.1; it sets the order.

    Raises
    ------
    InvalidInput
        "no_bodies", "out_of_range", "too_large": bodies that need more than order 80, "field_unknown": the solver
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
        raise InvalidInput("the scene has 0 obstacles, so nothing is scattered; give bodies.", code="no_bodies")
    check_no_planes(scene, "a scattering matrix")
    centre, radius = ball_of(scene)
    order = _order(scene.wavenumber.real * radius, accuracy)
    outer = radius + GAP * scene.wavelength
    directions, weights = _quadrature(order + SPARE)
    waves = harmonics(order, directions)
    radial = outgoing_radial(order, np.array([outer]), scene.wavenumber)
    layer = (weights * waves).T / (4j * np.pi * scene.wavenumber * radial[:, 0])
    field = solver.radiate(scene, Monopoles(centre + outer * directions, layer))
    if (sources := field.scattering_sources) is not None:
        matrix = projected(order, sources.positions - centre, sources.strengths, scene.wavenumber)
    else:
        scattered = _known(field.scattered_at(centre + outer * directions), outer)
        matrix = (weights * waves) @ scattered / radial
    asymmetry = float(np.linalg.norm(matrix - matrix.T) / np.linalg.norm(matrix))
    matrix = 0.5 * (matrix + matrix.T)
    matrix.flags.writeable = False
    return ScatteringMatrix(matrix, centre, radius, scene, asymmetry, field.report)


def check_own(scattering: ScatteringMatrix, scene: Scene) -> None:
    """Raise "other_scene" where the matrix is not of this very scene."""
    if scattering.scene is not scene:
        count = counted(len(scattering.scene.obstacles), "body", "bodies")
        raise InvalidInput(
            f"the scattering matrix is of another scene of {count}: give its own, scattering.scene.", code="other_scene"
        )


def _known(scattered: Complex128[np.ndarray, "points waves"], outer: float) -> Complex128[np.ndarray, "points waves"]:
    """Raise "field_unknown" where a pressure on the sphere is unknown."""
    if not np.isfinite(scattered).all():
        unknown = int((~np.isfinite(scattered)).any(axis=1).sum())
        raise InvalidInput(
            f"the field is not known at {unknown} of {len(scattered)} points {1e3 * outer:.3g} mm from the middle of "
            "the bodies; give a solver that knows it all around them.",
            code="field_unknown",
        )
    return scattered


def _order(reach: float, accuracy: float) -> int:
    """Order from which on waves count less than an accuracy, by k times the radius of the bodies.

    The excess over kR grows as d^(2/3) (kR)^(1/3) for d digits (W. C. Chew and others, Fast and Efficient Algorithms in
    Computational Electromagnetics, 2001, section 3.4); the factor is measured on pairs of capsules.
    """
    order = int(np.ceil(reach + 0.8 * (-np.log10(accuracy)) ** (2 / 3) * np.cbrt(reach)))
    if order > LARGEST_ORDER:
        raise InvalidInput(
            f"the bodies need waves up to order {order}, more than {LARGEST_ORDER}: give smaller bodies, such as the "
            "fingers without the hand, or a lower accuracy.",
            code="too_large",
        )
    return order


def _quadrature(order: int) -> tuple[Float64[np.ndarray, "points 3"], Float64[np.ndarray, "points"]]:
    """Directions and weights on the unit sphere that integrate products of two waves up to an order exactly."""
    cosines, weights = np.polynomial.legendre.leggauss(order + 1)
    azimuth = 2 * np.pi * np.arange(2 * order + 1) / (2 * order + 1)
    sines = np.sqrt(1.0 - cosines**2)
    parts = np.outer(sines, np.cos(azimuth)), np.outer(sines, np.sin(azimuth)), np.outer(cosines, np.ones_like(azimuth))
    return np.stack(parts, axis=-1).reshape(-1, 3), np.repeat(weights, len(azimuth)) * 2 * np.pi / len(azimuth)
