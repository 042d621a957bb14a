"""BoundaryElement: the sound of monopoles around rigid bodies, from the pressure on the bodies' skin alone."""

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Complex128, Float64, Int64, Real

from airtact.conventions import InvalidInput
from airtact.mesh.quadratic_triangles import QuadraticTriangles
from airtact.scene.scene import Scene, check_near, check_outside, check_sources
from airtact.scene.sources import Monopoles
from airtact.solvers.bem.blocks import blocks_of, in_blocks
from airtact.solvers.bem.factorised_bodies import FactorisedBodies
from airtact.solvers.bem.field import BoundaryField
from airtact.solvers.bem.layer_potentials import NearRule
from airtact.solvers.bem.operator import (
    DualMatrix,
    Store,
    assemble,
    check_memory,
    dual_surface,
    give_back,
    heard,
    incident,
)
from airtact.solvers.bem.quadrature import place_nodes
from airtact.solvers.bem.reduced_body import ReducedBody, reduced_body
from airtact.solvers.gmres import GmresResult, gmres
from airtact.solvers.probes import surrounding_points
from airtact.solvers.problem import Solver, SolveReport
from airtact.surfaces.panels import Panels, panels_of
from airtact.surfaces.shape import BEND
from airtact.validation import number, points_of

CITATIONS = (
    "A. Mohsen, R. Piscoya, M. Ochmann, Acta Acustica united with Acustica 97 (2011) 699: dual-surface equation",
    "P. R. Johnston, D. Elliott, Int. J. Numer. Meth. Engng 62 (2005) 564: sinh transformation of near integrals",
    "Y. Saad, M. H. Schultz, SIAM J. Sci. Stat. Comput. 7 (1986) 856: GMRES",
)

CROSSES_SOURCE = (
    "M. Bebendorf, S. Rjasanow, Computing 70 (2003) 1: adaptive cross approximation of collocation matrices"
)

KEPT_SOURCE = "P. G. Martinsson, V. Rokhlin, Journal of Computational Physics 205 (2005) 1: skeletons of kept bodies"

REACH = 0.7
"""Wavelengths beyond which a factorised body is heard through its skeleton."""

KEPT = 0.5
"""Share of the accuracy that the skeletons may lose nearby; far from the bodies they lose less."""


CROSSED = 0.2
"""Share of the accuracy that the matrix may be off where tiles of it are far from each other."""

PREVIEWS = 0.02
"""Accuracy from which on panels are integrated coarsely."""

ROUNDED = 0.003
"""Accuracy from which on the matrix may be rounded: that takes a thousandth from the field."""

DRIVES = 0.06
"""Accuracy from which on a solution serves for drives only, which bear a residual twice as large."""


@dataclass(frozen=True)
class BoundaryElement(Solver):
    """Boundary elements for sound-hard bodies, safe at interior resonances.

    Discontinuous quadratic Nyström on curved six-node panels, the dual-surface equation, GMRES. Each solve is done
    twice, directly and transposed: the transposed one hears beacons on or near the skin accurately from afar, the
    direct one gives the pressure on and near the skin, and their difference estimates the error.

    Attributes
    ----------
    accuracy : relative error wanted away from the skin; the panels follow from it. 0.03 is a preview.
    precision : "float32" or "float64", of the matrix and the iteration.
    estimate : solve the direct equation as well. Without it a solve takes about half the time, and its field is
        heard away from the skin only: enough for a transfer matrix.

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
    estimate: bool = True

    def __post_init__(self) -> None:
        """Check both settings."""
        number(self.accuracy, "accuracy", "parts of 1")
        if not 1e-4 <= self.accuracy <= 0.3:
            raise InvalidInput(f"accuracy is {self.accuracy:g}, but it must lie between 0.0001 and 0.3 (0.01 is 1 %).")
        if self.precision not in ("float32", "float64"):
            raise InvalidInput(f"precision is {self.precision!r}, but it must be 'float32' or 'float64'.")

    @property
    def nodes_per_square_wavelength(self) -> float:
        """Nodes that a square wavelength of skin gets: the error falls as the third power of the panel edge."""
        return 34.0 * (0.01 / self.accuracy) ** (2 / 3)

    def unknowns(self, scene: Scene, sources: Monopoles) -> int:
        """Count the nodes that a solve would have."""
        return 6 * len(self._panels(scene, sources.refined_positions).quadratic_triangles)

    def radiate(self, scene: Scene, sources: Monopoles) -> BoundaryField:
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
        _check_unfit(scene, sources)
        clock = _Clock()
        panels = self._panels(scene, sources.refined_positions)
        nodes = place_nodes(*_in_tiles(panels))
        clock.lap("panels")
        thinnest = np.array([obstacle.surface.shape.thinnest for obstacle in scene.obstacles])
        surface = dual_surface(nodes, scene.wavenumber, self._near_rule(), self.precision, thinnest)
        matrix = assemble(surface, self._store(), self._cross_error())
        clock.lap("matrix")
        rows, factors = heard(surface, sources.positions, sources.strengths)
        transposed = self._solved(matrix, rows, transposed=True)
        solved = [transposed]
        if self.estimate:
            right = incident(surface, sources.positions, sources.strengths)
            solved.append(self._solved(matrix, right, transposed=False))
        give_back(matrix)
        clock.lap("gmres")
        report = SolveReport(
            solver="BoundaryElement",
            residual=float(max(result.residuals.max() for result in solved)),
            iterations=max(result.iterations for result in solved),
            nodes=len(nodes.points),
            nodes_per_square_wavelength=len(nodes.points) * scene.wavelength**2 / float(nodes.weights.sum()),
            estimated_error=float("nan"),
            seconds=clock.laps,
            settings={"accuracy": self.accuracy, "precision": self.precision, "gmres_tolerance": self._tolerance()},
            citations=CITATIONS + ((CROSSES_SOURCE,) if matrix.far.column.size else ()),
            warnings=tuple(_off_triangles(panels, scene.wavelength)),
            farthest_off_triangles=float(panels.farthest.max()),
            mean_off_triangles=float(panels.mean_distance.max()),
        )
        density, *pressure = (result.solution.astype(np.complex128).T for result in solved)
        field = BoundaryField(
            scene, sources, surface, pressure[0] if pressure else None, density, factors, self.accuracy, report
        )
        if not self.estimate:
            return field
        estimate = float(field.error_at(surrounding_points(scene, nodes.points)).max())
        clock.lap("estimate")
        warnings = (*_warnings(estimate, self.accuracy), *report.warnings)
        return replace(field, report=replace(report, estimated_error=estimate, warnings=warnings))

    def factorised(self, scene: Scene, beside: Real[np.ndarray, "points 3"] | None = None) -> FactorisedBodies:
        """Solve each body by itself once, to hear it for many foci and wherever it is moved.

        What is kept hears a new pose of two fingers, or other foci, in a small part of the time of ``radiate``; the
        field is heard away from the bodies only, as without an estimate. Making it takes as long as some tens of
        solves, 2 s for two fingers of 1,100 unknowns each, and grows as the cube of a body's unknowns: minutes for a
        hand of 8,000.

        Parameters
        ----------
        scene : sound-hard bodies.
        beside : (P, 3) points beside which foci will stand; the skin is panelled finer there [m].

        Raises
        ------
        InvalidInput
            No bodies, a boundary other than sound-hard, or too little memory.
        """
        fine = np.empty((0, 3)) if beside is None else points_of(beside, "points beside the skin", least=0)
        _check_bodies(scene)
        if len(fine):
            check_outside(scene, fine, "beside")
            check_near(scene, fine, "beside")
        clock = _Clock()
        panels = self._panels(scene, fine)
        parts = tuple(self._part(panels, body, scene) for body in range(len(scene.obstacles)))
        clock.lap("bodies")
        nodes = [part.surface.nodes for part in parts]
        count = sum(len(one.points) for one in nodes)
        report = SolveReport(
            solver="BoundaryElement, factorised",
            residual=0.0,
            iterations=0,
            nodes=count,
            nodes_per_square_wavelength=count * scene.wavelength**2 / float(sum(one.weights.sum() for one in nodes)),
            estimated_error=float("nan"),
            seconds=clock.laps,
            settings={
                "accuracy": self.accuracy,
                "precision": self.precision,
                "gmres_tolerance": 0.1 * self.accuracy,
                "kept_error": max(part.error for part in parts),
            },
            citations=(*CITATIONS, KEPT_SOURCE),
            warnings=(*_lost_by_keeping(parts, KEPT * self.accuracy), *_off_triangles(panels, scene.wavelength)),
            farthest_off_triangles=float(panels.farthest.max()),
            mean_off_triangles=float(panels.mean_distance.max()),
        )
        return FactorisedBodies(scene, parts, self, report, self._smallest(scene))

    def _part(self, panels: Panels, body: int, scene: Scene) -> ReducedBody:
        """Factorise one body."""
        own = np.flatnonzero(panels.body == body)
        nodes = place_nodes(panels.quadratic_triangles[own], np.zeros(len(own), dtype=np.int64), panels.deviation[own])
        whole = blocks_of(len(nodes.points)) ** 2
        copies = 4  # itself, its factors, what they are solved for
        check_memory(len(nodes.points), self.precision, copies * whole, rows=0)
        thinnest = np.array([scene.obstacles[body].surface.shape.thinnest])
        surface = dual_surface(nodes, scene.wavenumber, self._near_rule(), self.precision, thinnest)
        return reduced_body(surface, REACH * scene.wavelength, KEPT * self.accuracy)

    def _solved(
        self, matrix: DualMatrix, right: Complex128[np.ndarray, "nodes sounds"], transposed: bool
    ) -> GmresResult:
        sides = np.ascontiguousarray(right.T, dtype=matrix.precision)
        return gmres(lambda vectors: matrix.times(vectors, transposed), sides, self._tolerance())

    def _panels(self, scene: Scene, fine: Real[np.ndarray, "points 3"]) -> Panels:
        smallest = self._smallest(scene)
        near = fine[scene.depth(fine) > -2 * smallest]
        shapes = [obstacle.surface.shape for obstacle in scene.obstacles]
        return panels_of(shapes, 2 * smallest, near, smallest, bend=self._bend())

    def _smallest(self, scene: Scene) -> float:
        """Edge below which no panel is cut for a source's sake, half of what others have [m]."""
        return 0.5 * scene.wavelength * float(np.sqrt(6 / self.nodes_per_square_wavelength * 4 / np.sqrt(3)))

    def _bend(self) -> float:
        """Angle that a panel of a round skin may turn by [rad]: 10, 8 or 6 of them go round."""
        if self.accuracy < PREVIEWS:
            return BEND
        return np.pi / 4 if self.accuracy < DRIVES or self.estimate else np.pi / 3  # too coarse to hear the skin on

    def _near_rule(self) -> NearRule:
        if self.precision == "float64":
            return NearRule(2.5, (6, 6))
        return NearRule(1.1, (3, 3)) if self.accuracy >= PREVIEWS else NearRule(1.6, (4, 4))

    def _store(self) -> Store:
        """Keep the matrix to 0.2 % where sums of it are far better than wanted: half the memory, half the traffic."""
        return "bfloat16" if self.precision == "float32" and self.accuracy >= ROUNDED else self.precision

    def _cross_error(self) -> float | None:
        """Share that the matrix may be off where its tiles are far from each other; None in double precision."""
        return None if self.precision == "float64" else CROSSED * self.accuracy

    def _tolerance(self) -> float:
        if self.precision == "float64":
            return min(0.1 * self.accuracy, 1e-8)
        if not self.estimate:  # heard from afar only
            return self.accuracy * (0.4 if self.accuracy < DRIVES else 0.8)
        return min(0.3 * self.accuracy, 0.01) if self.accuracy >= PREVIEWS else max(0.1 * self.accuracy, 2e-6)


def _in_tiles(
    panels: Panels,
) -> tuple[QuadraticTriangles, Int64[np.ndarray, "panels"], Float64[np.ndarray, "panels"]]:
    """Sort panels, their bodies and deviations so that those of a tile of the matrix lie together."""
    order = in_blocks(panels.quadratic_triangles[:, :3].mean(axis=1))
    return panels.quadratic_triangles[order], panels.body[order], panels.deviation[order]


class _Clock:
    """Wall time by step."""

    def __init__(self) -> None:
        self.laps: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        now = time.perf_counter()
        self.laps[name] = now - self._last
        self._last = now


def _check_unfit(scene: Scene, sources: Monopoles) -> None:
    check_sources(scene, sources)
    _check_bodies(scene)


def _check_bodies(scene: Scene) -> None:
    if not scene.obstacles:
        raise InvalidInput("the scene has 0 obstacles; use FreeField for open air.")
    for index, obstacle in enumerate(scene.obstacles):
        if obstacle.boundary != "sound_hard":
            raise InvalidInput(
                f"obstacle {index} is {obstacle.boundary}, but BoundaryElement solves sound-hard bodies only; use "
                "SphereSeries for a single sphere."
            )


def _warnings(estimate: float, accuracy: float) -> Iterator[str]:
    if estimate > 1.5 * accuracy:
        yield (
            f"the direct solution is estimated to be {100 * estimate:.1f} % off, and {100 * accuracy:.1f} % was asked: "
            "uneven triangles, a narrow gap, or a source on the skin (which the transposed solution bears better)"
        )


def _lost_by_keeping(parts: tuple[ReducedBody, ...], wanted: float) -> Iterator[str]:
    for body, part in enumerate(parts):
        if part.error > 1.5 * wanted:
            yield (
                f"what is kept of body {body} is {100 * part.error:.1f} % off, and {100 * wanted:.1f} % was to be: "
                "a narrow cavity, or precision 'float32' for so fine an accuracy"
            )


def _off_triangles(panels: Panels, wavelength: float) -> Iterator[str]:
    for body, (farthest, mean) in enumerate(zip(panels.farthest, panels.mean_distance, strict=True)):
        if farthest > wavelength / 20:
            yield (
                f"the panels of body {body} lie up to {1e3 * farthest:.2g} mm ({1e3 * mean:.2g} mm in the mean) off "
                "the triangles that it was given as, more than 1/20 of the wavelength: these are coarse for a curved "
                "skin; give a finer mesh, or sharp_degrees = 0 if it shall be faceted"
            )
