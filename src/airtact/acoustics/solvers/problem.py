"""The interface of all solvers, which compute the field that monopoles radiate in a scene.

``FreeField`` is the closed-form solution for open air: p(x) = Σ_j s_j e^{ik|x - x_j|} / |x - x_j|.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float64

from airtact.acoustics.scene import Obstacle, Scene, before_planes, check_sources
from airtact.acoustics.solvers.shared import (
    Gradients,
    Mask,
    NodePoints,
    NodeValues,
    Points,
    Pressures,
    Vectors,
    differences,
    monopole_pressure,
)
from airtact.acoustics.sources import STANDS_ON, Monopoles, check_off_sources, nearest_source
from airtact.acoustics.target_points import even_directions, outward
from airtact.errors import InvalidInput, counted, in_short, one_line, points_of
from airtact.timing import Progress

# Setting of a report: number of planes of the scene, if there are any.
PLANES = "rigid_planes"

# Setting of a report: number of reflecting boards, if there are any.
BOARDS = "reflecting_boards"


@dataclass(frozen=True)
class SolveReport:
    """Report of a solve: its method, errors, times and settings.

    It is the attribute ``report`` of a field. Relative errors are fractions: 0.01 is 1 %.

    Attributes
    ----------
    solver : name of the method, such as "BoundaryElement".
    residual : largest residual of the linear systems, relative to the right-hand side; 0 for
        closed-form solvers.
    iterations : number of iterations until the slowest right-hand side converged; 0 if
        nothing was iterated.
    nodes : number of unknowns; 0 for closed-form solvers.
    nodes_per_square_wavelength : unknowns per λ² of the bodies' surfaces; infinite for closed-form
        solvers.
    estimated_error : the solver's own estimate of the relative error of the field away from the
        surfaces; NaN if it was not estimated.
    seconds : wall time of each step by its name [s].
    settings : the solver's settings by name.
    warnings : warnings, one sentence each.
    citations : references for the method.
    farthest_off_triangles, mean_off_triangles : largest and mean distance between the solver's
        panels and the triangles of the original mesh [m]. They are reported for the body with the
        largest distance, and are 0 for primitives such as spheres.
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
        parts = [self.solver]
        if self.nodes:
            parts.append(f"{self.nodes} unknowns")
        if np.isfinite(self.estimated_error):
            parts.append(f"estimated error {100 * self.estimated_error:.2g} %")
        if self.seconds:
            parts.append(f"{sum(self.seconds.values()):.2g} s")
        if self.warnings:
            parts.append(counted(len(self.warnings), "warning", "warnings"))
        return one_line(self, *parts)


@dataclass(frozen=True, eq=False)
class SurfaceField:
    """Pressure on the surfaces of all bodies, at the N points where the solver computes it.

    ``RadiatedField.on_surface`` returns it. There are no points if the scene has no bodies or the
    solver does not compute the pressure on surfaces. The solver chooses the points.

    Attributes
    ----------
    points, normals : (N, 3) points on the surfaces in the frame of the scene [m], and (N, 3) unit
        normals that point out of the bodies.
    areas : (N,) area that each point represents [m²], for integrals over the surfaces.
    pressure : (N, S) complex peak value of the total pressure of each of the S excitations at each
        point [Pa].
    """

    points: NodePoints
    normals: NodePoints
    areas: Float64[np.ndarray, "nodes"]
    pressure: NodeValues

    __repr__ = in_short

    @classmethod
    def empty(cls, sources: Monopoles) -> "SurfaceField":
        """Return a surface field without points, for fields whose surface pressure is unknown."""
        pressure = np.zeros((0, sources.strengths.shape[1]), dtype=np.complex128)
        return cls(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), pressure)


@dataclass(frozen=True, eq=False, repr=False)
class RadiatedField(ABC):
    """The sound field of monopoles in a scene, evaluated at any points outside the bodies.

    This is the base class of the fields that ``Solver.radiate`` returns. For (P, 3) points in the
    frame of the scene [m] and each of the S excitations of the sources, ``at`` returns the total
    pressure (P, S) [Pa], ``scattered_at`` the total minus the open-air pressure (P, S) [Pa], and
    ``velocity`` the particle velocity (P, 3, S) [m/s]. They are NaN where ``valid`` is False, as
    inside bodies that are not filled. The ``SurfaceField`` ``on_surface`` contains the total
    pressure on the bodies. All are complex peak values for the time factor e^{-iωt}.

    Attributes
    ----------
    scene : the ``Scene`` that was solved.
    sources : the ``Monopoles`` that emit the sound, with S excitations.
    report : ``SolveReport`` with the method, errors and warnings of the solve.
    """

    scene: Scene
    sources: Monopoles
    report: SolveReport

    def __repr__(self) -> str:
        sources = len(self.sources.positions)
        facts = [f"{counted(self.excitations, 'excitation', 'excitations')} of {sources} sources"]
        if self.scene.obstacles:
            facts.append(f"around {counted(len(self.scene.obstacles), 'body', 'bodies')}")
        facts.append(f"by {self.report.solver}")
        if self.report.nodes:
            facts.append(f"{self.report.nodes} unknowns")
        if np.isfinite(self.report.estimated_error):
            facts.append(f"estimated error {100 * self.report.estimated_error:.2g} %")
        return one_line(self, *facts)

    @property
    def excitations(self) -> int:
        """Number of excitations of the sources."""
        return self.sources.strengths.shape[1]

    @property
    @abstractmethod
    def on_surface(self) -> SurfaceField:
        """Total pressure at points on the surfaces, or no points if there are no bodies."""

    @property
    def scattering_sources(self) -> Monopoles | None:
        """Monopoles whose pressure is the scattered pressure away from bodies; None if unknown."""
        return None

    @property
    def without_images(self) -> "RadiatedField | None":
        """The field without the images of sources and bodies in a plane, or None if unknown."""
        return None if self.scene.planes else self

    # Public methods check their points once; solvers implement the methods with underscores.
    def at(self, points: Points) -> Pressures:
        """Return the total pressure (P, S) of all S excitations at points (P, 3) [Pa].

        The pressure is NaN where the field is not ``valid``.

        Raises
        ------
        InvalidInput
            If a point is NaN, infinite or at a source, or if ``points`` has the wrong shape.
        """
        return self._at(self._receivers(points))

    @property
    def for_pictures(self) -> "RadiatedField":
        """Return the same field, evaluated faster with an added error of less than 1 %."""
        return self

    def scattered_at(self, points: Points) -> Pressures:
        """Return the scattered pressure (P, S): the total minus the open-air pressure [Pa].

        The scattered pressure is finite at the sources, where the total pressure is infinite.
        It is NaN where the field is not ``valid``, and at a source that touches a body. Some
        solvers compute it as the difference of two pressures that are both infinite at a
        source; they raise an error there.

        Raises
        ------
        InvalidInput
            If a point is NaN or infinite.
        """
        return self._scattered_at(points_of(points, "points", least=0))

    def valid(self, points: Points) -> Mask:
        """Return a mask of the points (P, 3) at which the field is defined.

        The field exists outside the bodies and inside filled bodies.
        """
        return self._valid(points_of(points, "points", least=0))

    def velocity(self, points: Points) -> Gradients:
        """Return the particle velocity v = ∇p/(iωρ) (P, 3, S) at points (P, 3) [m/s].

        The velocity is computed by central differences of ``at`` over 1/40 of a wavelength, or less
        near a surface. Points within 1/200 of a wavelength of a surface are treated as lying on it;
        the result there is the tangential velocity and, on an impedance surface, the normal
        velocity. The velocity is NaN where the field is not ``valid``, and on the surface of a
        filled body. The method raises ``InvalidInput`` if a point is NaN, infinite or at a source,
        or if the shape is wrong.
        """
        points = self._receivers(points)
        scene = self.scene
        density = np.full(len(points), scene.medium.density)
        height = np.full(len(points), np.inf)
        nearest = np.zeros(len(points), dtype=np.int64)
        for index, obstacle in enumerate(scene.obstacles):
            depth = obstacle.surface.depth(points)
            nearest[np.abs(depth) < height] = index
            height = np.minimum(height, np.abs(depth))
            if obstacle.medium is not None:
                density[depth > 0.0] = obstacle.medium.density
        on_surface = height < scene.wavelength / 200.0
        step = np.minimum(scene.wavelength / 40.0, 0.4 * height)
        gradient = differences(self._mirrored_at, points, np.where(on_surface, 1.0, step))
        gradient[on_surface] = np.nan
        for index, obstacle in enumerate(scene.obstacles):
            touching = on_surface & (nearest == index)
            if obstacle.medium is None and touching.any():
                gradient[touching] = self._surface_gradient(obstacle, points[touching])
        gradient[~self._valid(points)] = np.nan
        # This follows from ρ ∂v/∂t = −∇p with the time factor e^{−iωt}.
        return gradient / (2j * np.pi * scene.frequency * density[:, None, None])

    def _mirrored_at(self, points: Vectors) -> Pressures:
        """Return the pressure at points; points behind a rigid plane are mirrored to the front."""
        for plane in self.scene.planes:
            behind = plane.height(points) < 0.0
            points = np.where(behind[:, None], plane.image(points), points)
        return self._at(points)

    def _surface_gradient(self, obstacle: Obstacle, points: Vectors) -> Gradients:
        """Return ∇p on a body's surface [Pa/m], with the normal component from its impedance."""
        project = obstacle.surface.shape.project
        # The pressure at the projected point does not vary along the normal.
        step = np.full(len(points), self.scene.wavelength / 40.0)
        gradient = differences(lambda shifted: self._at(project(shifted)), project(points), step)
        if obstacle.ratio is not None:
            slope = -1j * self.scene.wavenumber / obstacle.ratio * self._at(project(points))
            gradient += outward(obstacle.surface.depth, points)[:, :, None] * slope[:, None]
        return gradient

    @abstractmethod
    def _at(self, points: Vectors) -> Pressures:
        """Return the total pressure as ``at`` does, for points that have already been checked."""

    def _scattered_at(self, points: Vectors) -> Pressures:
        return self.at(points) - self._incident(points)

    @abstractmethod
    def _valid(self, points: Vectors) -> Mask:
        """Return where the field exists, for points that have already been checked."""

    def _receivers(self, points: Points) -> Vectors:
        points = points_of(points, "points", least=0)
        check_off_sources(points, self.sources)
        return points

    def _incident(self, points: Points) -> Pressures:
        """Return the pressure [Pa] of the sources alone in open air, at points away from them."""
        return monopole_pressure(
            points,
            self.sources.positions,
            self.sources.strengths,
            self.scene.wavenumber,
            "float64",
        )

    def nowhere(self, points: Points) -> Pressures:
        """Return an array (P, S) of NaN: one pressure for each point and excitation."""
        return np.full((len(points), self.excitations), np.nan, dtype=np.complex128)

    def error_at(self, points: Points) -> Float64[np.ndarray, "excitations"]:
        """Return the solver's estimate (S,) of the field's relative error for each excitation.

        The points (P, 3) [m] should be away from the surfaces.
        """
        return np.full(self.excitations, self.report.estimated_error)

    def report_at(self, points: Points) -> SolveReport:
        """Return the report, updated with the error and the warnings for points (P, 3)."""
        return self.report


def surrounding_points(scene: Scene, points: Vectors) -> Float64[np.ndarray, "around 3"]:
    """Return 128 points on a sphere 8 λ outside the bodies, where an array would typically be.

    The points lie on a Fibonacci spiral. To estimate the error of a field, a solver compares two
    solutions at these points.
    """
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    radius = np.linalg.norm(points - centre, axis=1).max() + 8 * scene.wavelength
    return centre + radius * even_directions(128)


class Solver(ABC):
    """Abstract base class of the solvers, which compute the sound field around bodies.

    Solvers are ``BoundaryElement`` (sound-hard and impedance bodies), ``FiniteElement`` (also
    bodies filled with a fluid), ``SphereSeries`` (a single sphere) and ``FreeField`` (no bodies).
    Create one with its settings, and pass it as the argument ``solver`` of a function such as
    ``evaluate``, or call ``radiate(scene, sources)`` with a ``Scene`` and ``Monopoles``, which
    returns a ``RadiatedField``. A subclass of your own only implements ``radiate``,
    which can return a ``SampledField``.

    ``radiate`` raises ``InvalidInput`` if the solver does not support the scene, and
    ``NotConverged`` if an iterative solver stops before it converges.
    """

    @abstractmethod
    def radiate(self, scene: Scene, sources: Monopoles) -> RadiatedField:
        """Solve the scene for all excitations of the monopoles, and return their field."""

    def reporting(self, progress: Progress | None) -> "Solver":
        """Return the solver with a callback, such as ``print``, that receives each step's name.

        Closed-form solvers have no steps and are returned unchanged.
        """
        if progress is None or not hasattr(self, "progress"):
            return self
        return replace(self, progress=progress)  # type: ignore[type-var]


@dataclass(frozen=True, eq=False, repr=False)
class OpenAirField(RadiatedField):
    """The field of monopoles, and of their images in a plane, in a scene without obstacles."""

    @property
    def on_surface(self) -> SurfaceField:
        """A surface field without points, because there is no surface."""
        return SurfaceField.empty(self.sources)

    def _at(self, points: Vectors) -> Pressures:
        pressure = self._incident(points)
        for plane in self.scene.planes:
            pressure += self._incident(plane.image(points))
        pressure[~self._valid(points)] = np.nan
        return pressure

    def _scattered_at(self, points: Vectors) -> Pressures:
        # Only the images in a plane count as scattered.
        scattered = np.zeros((len(points), self.excitations), dtype=np.complex128)
        for plane in self.scene.planes:
            images = Monopoles(plane.image(self.sources.positions), self.sources.strengths)
            on = nearest_source(points, images, STANDS_ON)[0] < STANDS_ON
            scattered[~on] += self._incident(plane.image(points[~on]))
            scattered[on] = np.nan
        scattered[~self._valid(points)] = np.nan
        return scattered

    def _valid(self, points: Vectors) -> Mask:
        return before_planes(self.scene.planes, points)


@dataclass(frozen=True)
class FreeField(Solver):
    """Closed-form solver for scenes without bodies: spherical waves, and their images in a plane.

    Pass an instance to ``Setup`` or ``field_map``, or call ``radiate``. There are no settings. The
    rigid plane, if any, is taken from ``Scene.planes``. For a scene with bodies, ``radiate`` raises
    ``InvalidInput``; use ``BoundaryElement`` instead.

    Examples
    --------
    >>> import airtact as at
    >>> source = Monopoles(np.zeros((1, 3)), np.ones(1))
    >>> air = at.Medium(sound_speed=343.0, density=1.2)  # without absorption
    >>> field = FreeField().radiate(Scene(air), source)
    >>> abs(field.at(np.array([[0.0, 0.0, 0.1]]))[0, 0]).round(1)  # Pa
    np.float64(10.0)
    """

    def radiate(self, scene: Scene, sources: Monopoles) -> OpenAirField:
        """Return the field of the monopoles in a scene without obstacles.

        Raises
        ------
        InvalidInput
            If the scene has obstacles, or an argument has the wrong type.
        """
        check_sources(scene, sources, planes=True)
        if len(scene.obstacles) > 0:
            bodies = counted(len(scene.obstacles), "obstacle", "obstacles")
            raise InvalidInput(
                f"FreeField supports only open air, but the scene has {bodies}; use a solver "
                "for bodies, such as BoundaryElement.",
                code="not_supported",
            )
        settings = {PLANES: len(scene.planes)} if scene.planes else {}
        return OpenAirField(scene, sources, SolveReport(solver="FreeField", settings=settings))
