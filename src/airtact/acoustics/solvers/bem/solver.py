"""BoundaryElement: the field of monopoles around bodies, from the pressure on their surfaces alone."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Literal

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Int64, Real

from airtact.acoustics.planes import with_images
from airtact.acoustics.scene import (
    Obstacle,
    Scene,
    admittances,
    check_near,
    check_no_planes,
    check_outside,
    check_sources,
)
from airtact.acoustics.solvers.bem.blocks import block_order, blocks_of
from airtact.acoustics.solvers.bem.board_field import (
    NOT_ESTIMATED,
    BoardField,
    Emitting,
    elements_and_boards,
    in_boards,
    reach_of,
    without_boards,
)
from airtact.acoustics.solvers.bem.elimination import (
    check_elimination,
    eliminate,
    worth_eliminating,
)
from airtact.acoustics.solvers.bem.factorised.factorised_bodies import FactorisedBodies
from airtact.acoustics.solvers.bem.factorised.reduced_body import ReducedBody, reduced_body
from airtact.acoustics.solvers.bem.field import BoundaryField
from airtact.acoustics.solvers.bem.images import surface_with_images, values_with_images
from airtact.acoustics.solvers.bem.layer_potentials import NearRule, near_surface
from airtact.acoustics.solvers.bem.moving_panels import MovingPanels
from airtact.acoustics.solvers.bem.operator import (
    THICK,
    DualMatrix,
    DualSurface,
    Store,
    assemble,
    check_memory,
    direct_right_side,
    dual_surface,
    release,
    transposed_right_side,
)
from airtact.acoustics.solvers.bem.quadrature import Nodes, place_nodes
from airtact.acoustics.solvers.bem.solutions import DirectSolution
from airtact.acoustics.solvers.free_field import FreeField
from airtact.acoustics.solvers.gmres import GmresResult, gmres
from airtact.acoustics.solvers.probes import surrounding_points
from airtact.acoustics.solvers.problem import BOARDS, PLANES, Solver, SolveReport
from airtact.acoustics.sources import Monopoles
from airtact.checks import counted, number, points_of
from airtact.errors import InvalidInput
from airtact.geometry.mesh.quadratic_triangles import QuadraticTriangles
from airtact.geometry.panels import Panels, panels_of
from airtact.timing import Clock, Progress

CITATIONS = (
    "A. Mohsen, R. Piscoya, M. Ochmann, Acta Acustica united with Acustica 97 (2011) 699: dual-surface equation",
    "P. R. Johnston, D. Elliott, Int. J. Numer. Meth. Engng 62 (2005) 564: sinh transformation of near integrals",
    "Y. Saad, M. H. Schultz, SIAM J. Sci. Stat. Comput. 7 (1986) 856: GMRES",
)

LOW_RANK_SOURCE = "M. Bebendorf, S. Rjasanow, Computing 70 (2003) 1: adaptive cross approximation of collocation matrices"

SKELETON_SOURCE = "P. G. Martinsson, V. Rokhlin, Journal of Computational Physics 205 (2005) 1: skeletons of bodies"

REACH = 0.7
"""Wavelengths from a factorised body from which on its skeletons serve."""

OF_THE_DIRECT = "the pressure at points (direct solution)"
"""How the sentence begins that warns of the direct solution, which no drive is made from."""

SKELETON_ERROR = 0.5
"""Error of the skeletons over the accuracy; far from the bodies it is less."""

LOW_RANK_ERROR = 0.2
"""Error of the low-rank blocks of the matrix over the accuracy."""

BEFORE_A_PLANE = 0.2
"""That error before a plane, over that elsewhere: in a gap between a body and its image the sound is the larger."""

SOLUTION_ERROR = 0.5
"""Error of the solution of the equations over the accuracy, where a cavity makes them ill-conditioned."""

YIELDING = 1.28
"""Nodes of a scene with an impedance over those without: the pressure on it bends more."""

LEAST_ADMITTANCE = 0.1
"""|ρc/Z| below which a surface takes no more nodes than a sound-hard one."""

PREVIEWS = 0.02
"""Accuracy from which on panels are integrated coarsely."""

ROUNDED = 0.003
"""Accuracy from which on the matrix may be rounded to bfloat16: that changes the field by a thousandth."""

AMONG_BOARDS = 0.1
"""Residual to stop at among reflecting boards, over that elsewhere."""

MOST_ITERATIONS, MOST_AMONG_BOARDS = 120, 600
"""Iterations after which a solve is given up: between boards that face each other sound stays for long."""

PROBES_BEFORE_BOARDS = 512
"""Panels of reflecting boards before which the error is estimated, at most."""

AROUND = {0.025: 7, PREVIEWS: 8, 0.0125: 9, 0.0: 11}
"""Panels that go around a round body at least, by the accuracies from which on they suffice."""

AROUND_FOR_DRIVES = 6
"""Panels around for a solution that serves drives only, without an estimate of its error."""

DRIVES = 0.06
"""Accuracy from which on a solution serves drives only, for which twice the residual is enough."""

RESIDUALS = {DRIVES: 0.8, 0.04: 0.5, 0.0: 0.4}
"""Residual to stop at over the accuracy, without an estimate, by the accuracies from which on it suffices."""


Equation = Literal["transposed", "direct"]
"""One of the two equations that a solve is made of."""


@dataclass(frozen=True)
class BoundaryElement(Solver):
    """Boundary elements for sound-hard and impedance bodies, without spurious interior resonances.

    A discontinuous quadratic Nyström method on curved six-node panels solves the dual-surface
    equation by GMRES, twice: the transposed solution is accurate away from the bodies for sources
    on or near their surfaces, the direct solution is the pressure on and near the surfaces, and the
    difference of both estimates the error. Hundreds of excitations are solved by Gaussian
    elimination.

    Attributes
    ----------
    accuracy : relative error to aim at away from the surfaces (0.01 is 1 %). It sets the size of
        the panels; 0.03 suits a preview.
    precision : "float32" or "float64", of the iteration and the matrix; with "float32" and an
        accuracy of 0.003 or more the matrix is stored in bfloat16.
    estimate : whether to solve both equations. Without it a solve takes about half the time and the
        estimated error is NaN; the transposed equation alone is solved, enough for a transfer
        matrix, and the field raises ``InvalidInput`` on and near the surfaces; or, for elements in
        reflecting boards, the direct one. From an accuracy of 0.06 on it serves drives then, which
        correlate to 0.995 with the exact ones; pressures were up to 8 % off.
    enough : relative error that is wanted in the end, against which is warned; the accuracy unless
        given.
    progress : callback that gets the words of each step as it begins, such as ``print``.

    Raises
    ------
    InvalidInput
        If the accuracy, or what is enough, is not between 0.0001 and 0.3, or the precision is unknown.

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
    enough: float | None = None
    progress: Progress | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        """Check the settings."""
        for name, share in (("accuracy", self.accuracy), ("enough", self.wanted)):
            number(share, name, "parts of 1")
            if not 1e-4 <= share <= 0.3:
                raise InvalidInput(
                    f"{name} is {share:g}, but it must lie between 0.0001 and 0.3 (0.01 is 1 %).",
                    code="out_of_range",
                )
        if self.precision not in ("float32", "float64"):
            raise InvalidInput(
                f"precision is {self.precision!r}, but it must be 'float32' or 'float64'.",
                code="unknown_name",
            )

    @property
    def wanted(self) -> float:
        """Relative error against which is warned."""
        return self.accuracy if self.enough is None else self.enough

    @property
    def nodes_per_square_wavelength(self) -> float:
        """Nodes per square wavelength of surface: the error falls as the third power of the panel edge."""
        return 34.0 * (0.01 / self.accuracy) ** (2 / 3)

    def reporting(self, progress: Progress | None) -> "BoundaryElement":
        """Return the solver with a callback that gets the words of each step as it begins."""
        return self if progress is None else replace(self, progress=progress)

    def unknowns(self, scene: Scene, sources: Monopoles) -> int:
        """Count the nodes (unknowns) of a solve, from its panels alone."""
        return 6 * len(self._panels(scene, sources.refined_positions).quadratic_triangles)

    def radiate(self, scene: Scene, sources: Monopoles) -> BoundaryField | BoardField:
        """Solve the scene for the monopoles.

        Parameters
        ----------
        scene : bodies, sound-hard or of an impedance; their images in a plane take no unknowns of
            their own.
        sources : monopoles outside the bodies or on their surfaces, before a plane or on it. For
            those in the faces of reflecting boards the field around the other bodies is returned,
            and no refined panels are beside them.

        Raises
        ------
        InvalidInput
            No bodies, a filled body, a source inside a body or behind a plane, or too little memory.
        NotConverged
            GMRES did not reach its tolerance.
        """
        check_sources(scene, sources, planes=True)
        _check_bodies(scene)
        inside = in_boards(scene, sources)
        return (
            self._from_boards(scene, sources, inside)
            if inside.any()
            else self._radiate(scene, sources)
        )

    def _from_boards(
        self, scene: Scene, sources: Monopoles, inside: Bool[np.ndarray, "sources"]
    ) -> BoardField:
        """Solve for sources of which some are in reflecting boards: for what these reflect, then around the others."""
        refined, rest = sources.positions[~inside], without_boards(scene)
        emitting = Emitting(sources.positions, sources.strengths, refined)
        whole = self._radiate(scene, emitting, 0.1 * self.accuracy, ("transposed",))
        from_all = elements_and_boards(whole, refined)
        around = (
            self._radiate(rest, from_all) if rest.obstacles else FreeField().radiate(rest, from_all)
        )
        boards = replace(
            scene, obstacles=[scene.obstacles[index] for index in scene.boards], planes=()
        )
        report = replace(
            whole.report,
            estimated_error=around.report.estimated_error,
            warnings=(*whole.report.warnings, NOT_ESTIMATED, *around.report.warnings),
        )
        return BoardField(rest, sources, boards, around, reach_of(whole), report)

    def _radiate(
        self,
        scene: Scene,
        sources: Monopoles,
        tolerance: float | None = None,
        equations: Sequence[Equation] = (),
    ) -> BoundaryField:
        """Solve for sources of which none is in a board's face, to a tolerance that the accuracy gives by default.

        Both equations are solved for an estimate; else the direct one for elements in boards, or
        the transposed one.
        """
        if not equations:
            alone: Equation = "direct" if scene.boards else "transposed"
            equations = ("transposed", "direct") if self.estimate else (alone,)
        clock, count = Clock(self.progress), sources.strengths.shape[1]
        tolerance = self._tolerance(scene) if tolerance is None else tolerance
        panels, surface, matrices, solved_by = self._equations(scene, sources, tolerance, clock)
        nodes, solved, factors = surface.nodes, {}, np.ones(len(sources.positions))
        with clock.step("gmres", f"solving for {counted(count, 'excitation', 'excitations')}"):
            if "transposed" in equations:
                right, factors = transposed_right_side(
                    surface, sources.positions, sources.strengths, scene.planes
                )
                solved["transposed"] = solved_by(matrices, right, transposed=True)
            if "direct" in equations:
                emitting = with_images(scene.planes, sources)
                right = direct_right_side(surface, emitting.positions, emitting.strengths)
                solved["direct"] = solved_by(matrices, right, transposed=False)
            release(matrices[0])
        report = replace(
            self._report(scene, panels, [nodes], tolerance, clock),
            residual=float(max(result.residuals.max() for result in solved.values())),
            iterations=max(result.iterations for result in solved.values()),
            citations=CITATIONS + ((LOW_RANK_SOURCE,) if matrices[0].far.column.size else ()),
        )
        values = {
            name: values_with_images(result.solution.astype(np.complex128).T, scene.planes)
            for name, result in solved.items()
        }
        solutions = values.get("direct"), values.get("transposed"), factors
        surface = surface_with_images(surface, scene.planes)
        solved_field = BoundaryField(
            scene, sources, surface, *solutions, self.accuracy, self.wanted, report
        )
        if len(equations) == 1:
            return solved_field
        with clock.step("estimate", "estimating the error"):
            estimate = float(
                solved_field.error_at(_probes(scene, nodes, surface.near_rule.reach)).max()
            )
        warnings = (*_warnings(estimate, self.wanted), *report.warnings)
        return replace(
            solved_field, report=replace(report, estimated_error=estimate, warnings=warnings)
        )

    def direct_solution(self, scene: Scene, sources: Monopoles) -> DirectSolution:
        """Solve for the pressure on the surfaces alone, in half the time of ``radiate`` with its estimate.

        Raises as ``radiate``, and "not_supported" for a scene with planes or boards that
        reflect.
        """
        check_sources(scene, sources)
        _check_bodies(scene)
        tolerance, clock = replace(self, estimate=True)._tolerance(scene), Clock(self.progress)
        _, surface, matrices, solved_by = self._equations(scene, sources, tolerance, clock)
        with clock.step(
            "gmres",
            f"solving for {counted(sources.strengths.shape[1], 'excitation', 'excitations')}",
        ):
            right = direct_right_side(surface, sources.positions, sources.strengths)
            solved = solved_by(matrices, right, transposed=False)
            release(matrices[0])
        return DirectSolution(sources, surface, solved.solution.astype(np.complex128).T)

    def _equations(
        self, scene: Scene, sources: Monopoles, tolerance: float, clock: Clock
    ) -> tuple[Panels, DualSurface, list[DualMatrix], Callable[..., GmresResult]]:
        """Cover the bodies with panels, fill the matrices of them and of their images, and say how to solve."""
        with clock.step("panels", "covering the bodies with panels"):
            panels = self._panels(scene, sources.refined_positions)
            nodes = place_nodes(*_in_block_order(panels, scene))
        by_elimination = worth_eliminating(len(nodes.points), sources.strengths.shape[1])
        with clock.step("matrix", f"filling the matrix of {len(nodes.points)} unknowns"):
            surface = self._surface(nodes, scene, scene.obstacles)
            how = self._store(), self._low_rank_error(scene)
            if by_elimination:
                check_elimination(len(nodes.points), self.precision)
                how = self.precision, None
            matrices = [assemble(surface, *how, part) for part in (None, *scene.planes)]
        most = MOST_AMONG_BOARDS if scene.boards else MOST_ITERATIONS
        iterate = partial(self._solved, tolerance=tolerance, most_iterations=most)
        return panels, surface, matrices, eliminate if by_elimination else iterate

    def factorised(
        self, scene: Scene, refined: Real[np.ndarray, "points 3"] | None = None
    ) -> FactorisedBodies:
        """Factorise each body by itself once: a solver for these bodies, for any sources and wherever they are moved.

        It solves for a new pose of two fingers, or other foci, in a small part of the time of
        ``radiate``; the field is known away from the bodies only, as without an estimate. The
        factorisation takes as long as some tens of solves, 2 s for two fingers of 1,100 unknowns
        each, and grows as the cube of a body's unknowns: minutes for a hand of 8,000.

        Parameters
        ----------
        scene : bodies, sound-hard or of an impedance.
        refined : (P, 3) points [m], such as the foci to come, beside which the panels are smaller.

        Raises
        ------
        InvalidInput
            No bodies, a filled body, or too little memory.
        """
        points = (
            np.empty((0, 3)) if refined is None else points_of(refined, "refined points", least=0)
        )
        check_no_planes(scene, "a factorisation of bodies")
        _check_bodies(scene)
        if len(points):
            check_outside(scene, points, "refined")
            check_near(scene, points, "refined")
        clock, made = Clock(self.progress), []
        with clock.step("panels", "covering the bodies with panels"):
            panels = self._panels(scene, points)
        for body in range(len(scene.obstacles)):
            with clock.step("bodies", f"factorising body {body}"):
                made.append(self._reduced(panels, body, scene))
        bodies = tuple(made)
        tolerance = 0.1 * self.accuracy
        report = self._report(
            scene, panels, [body.surface.nodes for body in bodies], tolerance, clock
        )
        report = replace(
            report,
            solver="BoundaryElement, factorised",
            settings={**report.settings, "skeleton_error": max(body.error for body in bodies)},
            citations=(*CITATIONS, SKELETON_SOURCE),
            warnings=(
                *_lost_by_skeletons(bodies, SKELETON_ERROR * self.accuracy),
                *report.warnings,
            ),
        )
        return FactorisedBodies(scene, bodies, self, tolerance, self._smallest(scene), report)

    def moving_panels(self, scene: Scene, refined: Real[np.ndarray, "points 3"]) -> MovingPanels:
        """Cover one body with panels that whoever gets them may move, in single precision.

        Parameters
        ----------
        scene : with the body.
        refined : (P, 3) points [m], such as foci, beside which the panels are smaller.
        """
        _check_bodies(scene)
        corners, body, deviation, admittance = _in_block_order(self._panels(scene, refined), scene)
        surface = self._surface(
            place_nodes(corners, body, deviation, admittance), scene, scene.obstacles
        )
        rules = surface.near_rule, LOW_RANK_ERROR * self.accuracy
        return MovingPanels(
            corners, surface.shifted, deviation, admittance, surface.wavenumber, *rules
        )

    def _report(
        self, scene: Scene, panels: Panels, nodes: Sequence[Nodes], tolerance: float, clock: Clock
    ) -> SolveReport:
        """Report what a solve and a factorisation have in common."""
        around = {PLANES: len(scene.planes)} if scene.planes else {}
        around |= {BOARDS: len(scene.boards)} if scene.boards else {}
        count, area = (
            sum(len(one.points) for one in nodes),
            float(sum(one.weights.sum() for one in nodes)),
        )
        return SolveReport(
            solver="BoundaryElement",
            nodes=count,
            nodes_per_square_wavelength=count * scene.wavelength**2 / area,
            estimated_error=float("nan"),
            seconds=clock.seconds,
            settings={
                "accuracy": self.accuracy,
                "precision": self.precision,
                "gmres_tolerance": tolerance,
                **around,
            },
            warnings=tuple(_off_triangles(panels, scene.wavelength)),
            farthest_off_triangles=float(panels.farthest.max()),
            mean_off_triangles=float(panels.mean_distance.max()),
        )

    def _reduced(self, panels: Panels, body: int, scene: Scene) -> ReducedBody:
        """Factorise one body."""
        own = np.flatnonzero(panels.body == body)
        given = (
            panels.quadratic_triangles[own],
            np.zeros(len(own), dtype=np.int64),
            panels.deviation[own],
        )
        nodes = place_nodes(*given, admittances(scene)[panels.body[own]])
        whole = blocks_of(len(nodes.points)) ** 2
        copies = 4  # the matrix, its factors, right-hand sides and solutions
        check_memory(len(nodes.points), self.precision, copies * whole, factors=0)
        surface = self._surface(nodes, scene, scene.obstacles[body : body + 1])
        return reduced_body(surface, REACH * scene.wavelength, SKELETON_ERROR * self.accuracy)

    def _solved(
        self,
        matrices: Sequence[DualMatrix],
        right: Complex128[np.ndarray, "nodes sounds"],
        transposed: bool,
        tolerance: float,
        most_iterations: int,
    ) -> GmresResult:
        """Solve with the sum of some matrices: those of the bodies themselves and of their images."""
        size = np.abs(right).max(
            axis=0, initial=0.0
        )  # or its squares would leave the range of single precision
        size[size == 0.0] = 1.0
        sides = np.ascontiguousarray((right / size).T, dtype=matrices[0].precision)

        def product(vectors: np.ndarray) -> np.ndarray:
            first, *others = (matrix.times(vectors, transposed) for matrix in matrices)
            for one in others:
                first += one
            return first

        found = gmres(
            product,
            sides,
            tolerance,
            SOLUTION_ERROR * self.accuracy,
            most_iterations=most_iterations,
        )
        return replace(found, solution=found.solution.astype(np.complex128) * size[:, None])

    def _surface(self, nodes: Nodes, scene: Scene, obstacles: Sequence[Obstacle]) -> DualSurface:
        least = np.empty(len(nodes.points))
        for index, obstacle in enumerate(obstacles):
            own = nodes.body == index
            placed = nodes.points[own], nodes.normals[own]
            least[own] = obstacle.surface.shape.thickness_at(*placed, THICK * scene.wavelength)
        return dual_surface(nodes, scene.wavenumber, self._near_rule(), self.precision, least)

    def _panels(self, scene: Scene, refined: Real[np.ndarray, "points 3"]) -> Panels:
        smallest = self._smallest(scene)
        near = refined[scene.depth(refined) > -2 * smallest]
        shapes = [obstacle.surface.shape for obstacle in scene.obstacles]
        away = self.accuracy / (
            2 * scene.wavenumber.real
        )  # what a surface reflects changes its phase by 2 k away
        image = scene.planes[0].image if scene.planes else None
        return panels_of(
            shapes, 2 * smallest, near, smallest, self._bend(), away, image, scene.boards
        )

    def panel_edge(self, wavelength: float) -> float:
        """Edge of equilateral triangles as large as sound-hard bodies' panels off the sources, at a wavelength [m]."""
        return wavelength * float(np.sqrt(6 / self.nodes_per_square_wavelength * 4 / np.sqrt(3)))

    def _smallest(self, scene: Scene) -> float:
        """Edge below which no panel is refined for a source, half of that of the others [m]."""
        yielding = np.abs(admittances(scene)).max(initial=0.0) > LEAST_ADMITTANCE
        return 0.5 * self.panel_edge(scene.wavelength) / math.sqrt(YIELDING if yielding else 1.0)

    def _bend(self) -> float:
        """Angle that a panel of a round surface may bend by [rad]."""
        if not self.estimate and self.accuracy >= DRIVES:
            return 2 * np.pi / AROUND_FOR_DRIVES
        return (
            2 * np.pi / next(around for least, around in AROUND.items() if self.accuracy >= least)
        )

    def _near_rule(self) -> NearRule:
        if self.precision == "float64":
            return NearRule(2.5, (6, 6))
        return NearRule(1.1, (3, 3)) if self.accuracy >= PREVIEWS else NearRule(1.6, (4, 4))

    def _store(self) -> Store:
        """Store the matrix to 0.2 % where its sums are far better than wanted: half the memory, half the traffic."""
        return (
            "bfloat16"
            if self.precision == "float32" and self.accuracy >= ROUNDED
            else self.precision
        )

    def _low_rank_error(self, scene: Scene) -> float | None:
        """Relative error of the low-rank blocks of the matrix; None, for no such blocks, in double precision."""
        if self.precision == "float64":
            return None
        return LOW_RANK_ERROR * self.accuracy * (BEFORE_A_PLANE if scene.planes else 1.0)

    def _tolerance(self, scene: Scene) -> float:
        """Residual to stop at: smaller among boards, between which what is left of it goes to and fro."""
        return self._open_tolerance() * (AMONG_BOARDS if scene.boards else 1.0)

    def _open_tolerance(self) -> float:
        if self.precision == "float64":
            return min(0.1 * self.accuracy, 1e-8)
        if not self.estimate:  # for receivers far away only
            return self.accuracy * next(
                share for least, share in RESIDUALS.items() if self.accuracy >= least
            )
        return (
            min(0.3 * self.accuracy, 0.01)
            if self.accuracy >= PREVIEWS
            else max(0.1 * self.accuracy, 2e-6)
        )


def _in_block_order(
    panels: Panels, scene: Scene
) -> tuple[
    QuadraticTriangles,
    Int64[np.ndarray, "panels"],
    Float64[np.ndarray, "panels"],
    Complex128[np.ndarray, "panels"],
]:
    """Sort panels, their bodies, deviations and admittances so that those of a block of the matrix lie together."""
    centres = (
        np.einsum("tsd->td", panels.quadratic_triangles[:, :3]) / 3
    )  # NumPy's mean takes ten times as long
    order = block_order(centres)
    body = panels.body[order]
    return (
        panels.quadratic_triangles[order],
        body,
        panels.deviation[order],
        admittances(scene)[body],
    )


def _check_bodies(scene: Scene) -> None:
    if not scene.obstacles:
        raise InvalidInput("the scene has 0 obstacles; use FreeField for open air.", code="empty")
    for index, obstacle in enumerate(scene.obstacles):
        if obstacle.boundary == "filled":
            raise InvalidInput(
                f"obstacle {index} is filled, but BoundaryElement solves sound-hard and impedance bodies only; use "
                "FiniteElement, or SphereSeries for a single sphere.",
                code="not_supported",
            )


def _probes(scene: Scene, nodes: Nodes, reach: float) -> Float64[np.ndarray, "probes 3"]:
    """Points where the error is estimated: around the bodies, or right before the boards that the elements are in."""
    if not scene.boards:
        return surrounding_points(scene, nodes.points)
    chosen = np.flatnonzero(np.isin(nodes.body[::6], scene.boards))
    chosen = chosen[:: math.ceil(len(chosen) / PROBES_BEFORE_BOARDS)]
    before = nodes.centres[chosen] + 2.0 * nodes.radii[chosen, None] * nodes.normals[6 * chosen]
    return before[(scene.depth(before) < 0.0) & ~near_surface(nodes, before, reach)]


def _warnings(estimate: float, accuracy: float) -> Iterator[str]:
    if estimate > 1.5 * accuracy:
        yield (
            f"{OF_THE_DIRECT} is estimated to be {100 * estimate:.1f} % off, and {100 * accuracy:.1f} % was asked: "
            "uneven triangles, a narrow gap, or a source on the surface; a transfer matrix is more accurate then"
        )


def _lost_by_skeletons(bodies: tuple[ReducedBody, ...], wanted: float) -> Iterator[str]:
    for index, body in enumerate(bodies):
        if body.error > 1.5 * wanted:
            yield (
                f"the skeletons of body {index} are {100 * body.error:.1f} % off, and {100 * wanted:.1f} % was wanted: "
                "a narrow cavity, or precision 'float32' for so fine an accuracy"
            )


def _off_triangles(panels: Panels, wavelength: float) -> Iterator[str]:
    for body, (farthest, mean) in enumerate(
        zip(panels.farthest, panels.mean_distance, strict=True)
    ):
        if farthest > wavelength / 20:
            yield (
                f"the panels of body {body} lie up to {1e3 * farthest:.2g} mm ({1e3 * mean:.2g} mm in the mean) off "
                "the triangles that it was given as, more than 1/20 of the wavelength: these are coarse for a curved "
                "surface; give a mesh with shorter edges, or sharp_degrees = 0 for a faceted body"
            )
