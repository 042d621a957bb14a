"""The interface of every solver: a scene and monopoles in, a radiated field out."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Complex128, Float64

from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.arrays import Gradients, Mask, Points, Pressures, Vectors
from airtact.acoustics.solvers.monopoles import monopole_pressure
from airtact.acoustics.solvers.velocity import differences, velocity_of
from airtact.acoustics.sources import Monopoles, check_off_sources
from airtact.checks import counted, points_of
from airtact.printing import html_table, in_short, one_line
from airtact.timing import Progress

PLANES = "rigid_planes"
"""Name of the setting of a report that counts the planes of the scene; there is none without planes."""

BOARDS = "reflecting_boards"
"""Name of the setting of a report that counts the bodies that are reflecting boards; there is none without them."""

DIFFERENCE = 1.0 / 40.0
"""Step of the differences of a field without a closed form, in wavelengths."""


@dataclass(frozen=True)
class SolveReport:
    """How a field was solved, so that a reader can trust or repeat it.

    Attributes
    ----------
    solver : name of the method.
    residual : worst relative residual of the linear systems (0 for closed forms).
    iterations : iterations that the slowest right-hand side took.
    nodes : number of unknowns.
    nodes_per_square_wavelength : unknowns per λ² of the bodies' surfaces (infinite for closed
        forms).
    estimated_error : the solver's own estimate of the relative error of the field away from the
        surfaces.
    seconds : wall time by step [s].
    settings : the solver's settings.
    warnings : sentences that a reader of the result must see.
    citations : sources of the method.
    farthest_off_triangles, mean_off_triangles : largest and mean distance of the panels from the
        triangles of the given surface, of the worst body [m]; 0 for primitives.
    """

    solver: str
    residual: float = 0.0
    iterations: int = 0
    nodes: int = 0
    nodes_per_square_wavelength: float = float("inf")
    estimated_error: float = 0.0
    seconds: Mapping[str, float] = field(default_factory=dict)
    settings: Mapping[str, str | float | int] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    citations: tuple[str, ...] = ()
    farthest_off_triangles: float = 0.0
    mean_off_triangles: float = 0.0

    def __repr__(self) -> str:
        return one_line(
            self,
            self.solver,
            f"{self.nodes} unknowns" * bool(self.nodes),
            f"estimated error {100 * self.estimated_error:.2g} %"
            * bool(np.isfinite(self.estimated_error)),
            f"{sum(self.seconds.values()):.2g} s" * bool(self.seconds),
            counted(len(self.warnings), "warning", "warnings") * bool(self.warnings),
        )


@dataclass(frozen=True, eq=False)
class SurfaceField:
    """Pressure on the surfaces of the bodies, at the points where the solver computes it.

    Attributes
    ----------
    points : (Q, 3) points on the surfaces [m].
    normals : (Q, 3) outward unit normals.
    areas : (Q,) area that each point represents [m²].
    pressure : (Q, S) total pressure of each of the S excitations there [Pa].
    """

    points: Float64[np.ndarray, "nodes 3"]
    normals: Float64[np.ndarray, "nodes 3"]
    areas: Float64[np.ndarray, "nodes"]
    pressure: Complex128[np.ndarray, "nodes excitations"]

    __repr__ = in_short

    @classmethod
    def empty(cls, sources: Monopoles) -> "SurfaceField":
        """No points, for a field without a known surface."""
        pressure = np.zeros((0, sources.strengths.shape[1]), dtype=np.complex128)
        return cls(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), pressure)


class RadiatedField(ABC):
    """The sound field of some monopoles in a scene, evaluated at any points outside the bodies.

    Attributes
    ----------
    scene : the scene that was solved.
    sources : the monopoles.
    report : how the field was solved.
    """

    scene: Scene
    sources: Monopoles
    report: SolveReport

    def __repr__(self) -> str:
        return one_line(self, *self._facts().values())

    def _repr_html_(self) -> str:
        seconds = [(f"{step} [s]", f"{took:.2f}") for step, took in self.report.seconds.items()]
        facts = [(fact,) for fact in self._facts().values() if fact]
        return html_table(type(self).__name__, [], [*facts, *seconds], self.report.warnings)

    def _facts(self) -> dict[str, str]:
        """Return what was solved, in words."""
        count, error = self.sources.strengths.shape[1], self.report.estimated_error
        return {
            "excitations": f"{counted(count, 'excitation', 'excitations')} of {len(self.sources.positions)} sources",
            "bodies": f"around {counted(len(self.scene.obstacles), 'body', 'bodies')}"
            * bool(self.scene.obstacles),
            "solver": f"by {self.report.solver}",
            "unknowns": f"{self.report.nodes} unknowns" * bool(self.report.nodes),
            "estimated error": f"estimated error {100 * error:.2g} %" * bool(np.isfinite(error)),
        }

    @property
    @abstractmethod
    def on_surface(self) -> SurfaceField:
        """Total pressure on the surfaces of the bodies; arrays of length 0 where there are none."""

    @property
    def scattering_sources(self) -> Monopoles | None:
        """Monopoles that radiate the scattered pressure away from the bodies; None where the solver has none."""
        return None

    @property
    def without_images(self) -> "RadiatedField | None":
        """What sources and bodies radiate, as they do here, without their images in a plane; None if not known.

        It is the field itself where the scene has no plane.
        """
        return None if self.scene.planes else self

    @abstractmethod
    def at(self, points: Points) -> Pressures:
        """Total pressure [Pa] at points (P, 3) [m] for each of the S excitations; NaN where ``valid`` is False.

        Raises
        ------
        InvalidInput
            A point is NaN or infinite, the shape is another, or a point stands on a source.
        """

    def scattered_at(self, points: Points) -> Pressures:
        """Scattered pressure [Pa]: the total pressure less that of the sources alone in open air.

        It is (P, S) at points (P, 3) [m]; finite at the sources' own positions, where ``at`` is
        infinite; NaN where ``valid`` is False, and at a source that touches a body. By default the
        open-air pressure is subtracted from ``at``, which needs points off the sources.

        Raises
        ------
        InvalidInput
            A point is NaN or infinite.
        """
        points = points_of(points, "points", least=0)
        return self.at(points) - self._incident(points)

    def _incident(self, points: Points) -> Pressures:
        """Pressure [Pa] of the sources alone in open air at points (P, 3) [m] off the sources."""
        sources, wavenumber = self.sources, self.scene.wavenumber
        return monopole_pressure(
            points, sources.positions, sources.strengths, wavenumber, "float64"
        )

    @abstractmethod
    def valid(self, points: Points) -> Mask:
        """Whether the field exists at points (P, 3): False inside bodies, except filled ones."""

    def velocity(self, points: Points) -> Gradients:
        """Particle velocity v = ∇p/(iωρ) [m/s] at points (P, 3) [m], along x, y and z, for each of the S excitations.

        On a sound-hard surface it is tangential; NaN where ``valid`` is False. By default ``at`` is
        differenced over 1/40 of a wavelength, which gives NaN where the difference reaches into a
        body. Errors as of ``at``.
        """
        points = points_of(points, "points", least=0)
        step = np.full(len(points), DIFFERENCE * self.scene.wavelength)
        return velocity_of(
            differences(self.at, points, step), self.scene.frequency, self.scene.medium.density
        )

    def error_at(self, points: Points) -> Float64[np.ndarray, "excitations"]:
        """Estimated relative error over points (P, 3) away from the surfaces, for each of the S excitations."""
        return np.full(self.sources.strengths.shape[1], self.report.estimated_error)

    def report_at(self, points: Points) -> SolveReport:
        """Return the report with the error estimated at points (P, 3) [m], where it is the larger one.

        Where it exceeds what was asked, a warning names the worst point and what to do.
        """
        points_of(points, "points", least=0)
        return self.report


def receivers(points: Points, sources: Monopoles) -> Vectors:
    """Return points (P, 3) [m] at which a total pressure is evaluated, as float64; raise as ``RadiatedField.at``."""
    points = points_of(points, "points", least=0)
    check_off_sources(points, sources)
    return points


class Solver(ABC):
    """A method that computes the sound field of a scene."""

    @abstractmethod
    def radiate(self, scene: Scene, sources: Monopoles) -> RadiatedField:
        """Solve the scene for the monopoles, for all their excitations at once."""

    def reporting(self, progress: Progress | None) -> "Solver":
        """Return the solver with a callback that gets the words of each step as it begins, such as ``print``.

        Solvers in closed form have no steps and return themselves, as does every solver for None.
        """
        return self
