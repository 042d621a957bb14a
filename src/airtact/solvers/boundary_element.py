"""BoundaryElement: the sound of monopoles around rigid bodies, from the pressure on the bodies' skin alone."""

import time
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Real

from airtact.conventions import InvalidInput
from airtact.scene.panels import scene_panels
from airtact.scene.scene import Scene, check_outside
from airtact.scene.sources import Monopoles
from airtact.solvers.boundary_operator import (
    ROWS_AT_ONCE,
    DualSystem,
    build_system,
    incident,
    monopole_pressure,
    refuse_too_large,
    skin_rows,
    winding,
)
from airtact.solvers.boundary_quadrature import find_near, place_nodes
from airtact.solvers.gmres import gmres
from airtact.solvers.problem import Skin, SolveReport

CITATIONS = (
    "A. Mohsen, R. Piscoya, M. Ochmann, Acta Acustica united with Acustica 97 (2011) 699: dual-surface equation",
    "P. R. Johnston, D. Elliott, Int. J. Numer. Meth. Engng 62 (2005) 564: sinh transformation of near integrals",
    "Y. Saad, M. H. Schultz, SIAM J. Sci. Stat. Comput. 7 (1986) 856: GMRES",
)


@dataclass(frozen=True)
class BoundaryElement:
    """Boundary elements for sound-hard bodies, safe at interior resonances.

    Discontinuous quadratic Nyström on curved six-node panels, the dual-surface equation, GMRES. Each solve is done
    twice, directly and transposed: the transposed one hears beacons on or near the skin accurately from afar, the
    direct one gives the pressure on and near the skin, and their difference estimates the error.

    Attributes
    ----------
    accuracy : relative error wanted away from the skin; the panels follow from it. 0.03 is a preview.
    precision : "float32" or "float64", of the matrix and the iteration.

    Raises
    ------
    InvalidInput
        An accuracy outside 0.0001 to 0.3, or an unknown precision.

    Examples
    --------
    >>> import airtact as at
    >>> ball = at.sphere(radius=5e-3, edge=2e-3)
    >>> scene = at.Scene(at.Medium(343.1, 1.293), [at.sound_hard(ball)], frequency=40e3)
    >>> field = at.BoundaryElement(accuracy=0.03).radiate(scene, at.Monopoles(np.array([[0, 0, 0.01]]), np.ones(1)))
    >>> field.at(np.array([[0, 0, 0.1]])).shape
    (1, 1)
    """

    accuracy: float = 0.01
    precision: Literal["float32", "float64"] = "float32"

    def __post_init__(self) -> None:
        """Check both settings."""
        if not 1e-4 <= self.accuracy <= 0.3:
            raise InvalidInput(f"accuracy is {self.accuracy:g}, but it must lie between 0.0001 and 0.3 (0.01 is 1 %).")
        if self.precision not in ("float32", "float64"):
            raise InvalidInput(f"precision is {self.precision!r}, but it must be 'float32' or 'float64'.")

    @property
    def nodes_per_square_wavelength(self) -> float:
        """Nodes that a square wavelength of skin gets: the error falls as the third power of the panel edge."""
        return 45.0 * (0.01 / self.accuracy) ** (2 / 3)

    def radiate(self, scene: Scene, sources: Monopoles) -> "BoundaryField":
        """Solve the scene for the monopoles.

        Parameters
        ----------
        scene : sound-hard bodies.
        sources : monopoles outside the bodies or on their skin.

        Raises
        ------
        InvalidInput
            No bodies, a boundary other than sound-hard, a source inside a body, or too little memory.
        NotConverged
            GMRES did not reach its tolerance.
        """
        _refuse_unfit(scene, sources)
        clock = _Clock()
        nodes = place_nodes(self._panels(scene, sources))
        refuse_too_large(len(nodes.points), self.precision)
        clock.lap("panels")
        system = build_system(nodes, scene.wavenumber, self.precision, **self._quadrature())
        clock.lap("matrix")
        work = system.matrix.dtype
        rows, factors = _hearing_rows(system, sources)
        right = incident(system, sources.positions, sources.strengths)
        clock.lap("right-hand sides")
        direct = gmres(lambda v: system.matrix @ v, right.astype(work), self._tolerance())
        transposed = gmres(lambda v: system.matrix.T @ v, rows.astype(work), self._tolerance())
        clock.lap("gmres")
        field = BoundaryField(
            scene=scene,
            sources=sources,
            system=system,
            pressure=direct.solution.astype(np.complex128),
            density=transposed.solution.astype(np.complex128),
            factors=factors,
            report=SolveReport("BoundaryElement", 0, 0, 0, 0, 0),
        )
        estimate = float(field.error_at(_surrounding_points(scene, nodes.points)).max())
        clock.lap("estimate")
        report = SolveReport(
            solver="BoundaryElement",
            residual=float(max(direct.residuals.max(), transposed.residuals.max())),
            iterations=max(direct.iterations, transposed.iterations),
            nodes=len(nodes.points),
            nodes_per_square_wavelength=len(nodes.points) * scene.wavelength**2 / float(nodes.weights.sum()),
            estimated_error=estimate,
            seconds=clock.laps,
            settings={"accuracy": self.accuracy, "precision": self.precision, "gmres_tolerance": self._tolerance()},
            citations=CITATIONS,
        )
        object.__setattr__(field, "report", report)
        return field

    def _panels(self, scene: Scene, sources: Monopoles):
        wavelength = scene.wavelength
        edge = wavelength * np.sqrt(6 / self.nodes_per_square_wavelength * 4 / np.sqrt(3)) * 1.1
        surfaces = [obstacle.surface for obstacle in scene.obstacles]
        smallest, growth = 0.25 * edge, 1.0
        reach = edge / growth
        close = sources.positions[scene.depth(sources.positions) > -reach]
        return scene_panels(surfaces, edge, close, smallest, growth)

    def _quadrature(self) -> dict:
        return {"reach": 2.5, "gauss_points": (5, 5)}

    def _tolerance(self) -> float:
        return max(0.1 * self.accuracy, 2e-6) if self.precision == "float32" else min(0.1 * self.accuracy, 1e-8)


class _Clock:
    """Wall time by step."""

    def __init__(self) -> None:
        self.laps: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        now = time.perf_counter()
        self.laps[name] = now - self._last
        self._last = now


def _refuse_unfit(scene: Scene, sources: Monopoles) -> None:
    if not scene.obstacles:
        raise InvalidInput("the scene has 0 obstacles; use FreeField for open air.")
    for index, obstacle in enumerate(scene.obstacles):
        if obstacle.boundary != "sound_hard":
            raise InvalidInput(
                f"obstacle {index} is {obstacle.boundary}, but BoundaryElement solves sound-hard bodies only; use "
                "SphereSeries for a single sphere."
            )
    check_outside(scene, sources.positions, "source")


def _hearing_rows(
    system: DualSystem, sources: Monopoles
) -> tuple[Complex128[np.ndarray, "nodes sounds"], Float64[np.ndarray, "sources"]]:
    """Right-hand sides of the transposed equation: how the skin's pressure is heard where the sources stand."""
    total = np.zeros((len(system.nodes.points), sources.strengths.shape[1]), dtype=np.complex128)
    factors = np.empty(len(sources.positions))
    for start in range(0, len(factors), ROWS_AT_ONCE):
        part = slice(start, start + ROWS_AT_ONCE)
        found = skin_rows(system, sources.positions[part])
        factors[part] = found.factor
        total += found.rows.T @ sources.strengths[part]
    return total, factors


def _surrounding_points(scene: Scene, points: Float64[np.ndarray, "nodes 3"]) -> Float64[np.ndarray, "around 3"]:
    """128 points spread over a sphere 8 λ outside the bodies, where the array would be."""
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    radius = np.linalg.norm(points - centre, axis=1).max() + 8 * scene.wavelength
    index = np.arange(128) + 0.5
    polar, turn = np.arccos(1 - index / 64), np.pi * (1 + np.sqrt(5)) * index
    directions = np.stack([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)], axis=1)
    return centre + radius * directions


@dataclass(frozen=True, eq=False)
class BoundaryField:
    """The field of some monopoles around rigid bodies, as ``BoundaryElement`` solved it.

    Attributes
    ----------
    scene, sources : what was solved.
    system : the discrete equation.
    pressure : (M, S) direct solution: the pressure at the nodes [Pa].
    density : (M, S) transposed solution: the monopoles at the nodes that stand for the bodies' scattering.
    factors : (N,) 1 for sources off the skin, 2 for those on it, which speak with their image.
    report : how it was made.
    """

    scene: Scene
    sources: Monopoles
    system: DualSystem
    pressure: Complex128[np.ndarray, "nodes sounds"]
    density: Complex128[np.ndarray, "nodes sounds"]
    factors: Float64[np.ndarray, "sources"]
    report: SolveReport = field(repr=False)

    @property
    def skin(self) -> Skin:
        """Pressure at the nodes of the skin, from the direct solution."""
        nodes = self.system.nodes
        return Skin(nodes.points, nodes.normals, nodes.weights, self.pressure)

    def valid(self, points: Real[np.ndarray, "points 3"]) -> Bool[np.ndarray, "points"]:
        """Whether points (P, 3) lie outside the bodies or on their skin."""
        return winding(self.system, points, self._near_skin(points)) < 0.75

    def at(self, points: Real[np.ndarray, "points 3"]) -> Complex128[np.ndarray, "points sounds"]:
        """Total pressure [Pa] at points (P, 3) for each of the S sounds; NaN inside the bodies."""
        points = np.ascontiguousarray(points, dtype=np.float64)
        near = self._near_skin(points)
        outside = winding(self.system, points, near) < 0.75
        out = np.full((len(points), self.density.shape[1]), np.nan, dtype=np.complex128)
        out[outside & near] = self.heard_from_skin(points[outside & near])
        out[outside & ~near] = self.heard_from_density(points[outside & ~near])
        return out

    def heard_from_skin(self, points: Real[np.ndarray, "points 3"]) -> Complex128[np.ndarray, "points sounds"]:
        """Total pressure by the direct solution: right on and near the skin too."""
        out = np.empty((len(points), self.pressure.shape[1]), dtype=np.complex128)
        for start in range(0, len(points), ROWS_AT_ONCE):
            part = slice(start, start + ROWS_AT_ONCE)
            found = skin_rows(self.system, points[part])
            free = self._free(points[part], self.sources.strengths)
            out[part] = found.factor[:, None] * free + found.rows @ self.pressure
        return out

    def heard_from_density(self, points: Real[np.ndarray, "points 3"]) -> Complex128[np.ndarray, "points sounds"]:
        """Total pressure by the transposed solution: right for beacons near the skin, heard away from it."""
        system = self.system
        places = np.concatenate([system.nodes.points, system.shifted])
        strengths = np.concatenate([self.density, -1j * self.density])
        scattered = monopole_pressure(points, places, strengths, system.wavenumber, system.precision)
        return self._free(points, self.factors[:, None] * self.sources.strengths) + scattered

    def error_at(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "sounds"]:
        """Relative difference of the direct and the transposed solution over points (P, 3) away from the skin."""
        transposed = self.heard_from_density(points)
        difference = self.heard_from_skin(points) - transposed
        return np.linalg.norm(difference, axis=0) / np.linalg.norm(transposed, axis=0)

    def _free(
        self, points: Real[np.ndarray, "points 3"], strengths: Complex128[np.ndarray, "sources sounds"]
    ) -> Complex128[np.ndarray, "points sounds"]:
        return monopole_pressure(points, self.sources.positions, strengths, self.system.wavenumber, "float64")

    def _near_skin(self, points: Real[np.ndarray, "points 3"]) -> Bool[np.ndarray, "points"]:
        near = np.zeros(len(points), dtype=bool)
        near[find_near(self.system.nodes, points, self.system.reach + 1)[0]] = True
        return near
