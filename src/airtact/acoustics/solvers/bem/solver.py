"""``BoundaryElement``, which computes the field of monopoles around bodies."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Complex128, Float64

import airtact as at
from airtact.acoustics.scene import (
    Obstacle,
    Scene,
    admittances,
    check_no_planes,
    check_outside,
    check_sources,
    with_images,
)
from airtact.acoustics.solvers.bem.block_matrix import (
    BlockMatrix,
    Store,
    block_order,
    blocks_of,
    check_memory,
    eliminate,
    iterate,
    worth_eliminating,
)
from airtact.acoustics.solvers.bem.field import (
    NOT_ESTIMATED,
    BoardField,
    BoundaryField,
    elements_and_boards,
    in_boards,
)
from airtact.acoustics.solvers.bem.layer_potentials import NearRule, near_surface
from airtact.acoustics.solvers.bem.quadrature import Nodes, place_nodes
from airtact.acoustics.solvers.bem.solutions import (
    THICK_FROM,
    DualSurface,
    assemble,
    direct_right_side,
    dual_surface,
    transposed_right_side,
)
from airtact.acoustics.solvers.problem import (
    BOARDS,
    PLANES,
    FreeField,
    Solver,
    SolveReport,
    surrounding_points,
)
from airtact.acoustics.solvers.shared import GmresResult, Points
from airtact.acoustics.sources import Monopoles
from airtact.errors import InvalidInput, counted, number, of_kind, points_of, positive
from airtact.geometry.panels import Panels, covers, panels_of
from airtact.timing import Clock, Progress

CITATIONS = (
    "A. Mohsen, R. Piscoya, M. Ochmann, Acta Acustica united with Acustica 97 (2011) 699: "
    "dual-surface equation",
    "P. R. Johnston, D. Elliott, Int. J. Numer. Meth. Engng 62 (2005) 564: sinh transformation of "
    "near integrals",
    "Y. Saad, M. H. Schultz, SIAM J. Sci. Stat. Comput. 7 (1986) 856: GMRES",
    "M. Bebendorf, S. Rjasanow, Computing 70 (2003) 1: adaptive cross approximation of collocation "
    "matrices",
)

# Beginning of the warning about the direct solution, which drives do not depend on.
OF_THE_DIRECT = "the pressure at points (direct solution)"


# Smallest accuracy at which the matrix is stored in bfloat16. This changes the field by 0.1 %.
BFLOAT16_ACCURACY = 0.003

# Smallest accuracy of a preview, whose panels are integrated coarsely.
PREVIEW_ACCURACY = 0.02

# Ratio of the error of the low-rank blocks to the accuracy.
LOW_RANK_ERROR = 0.2

# The two equations of a solve.
Equation = Literal["transposed", "direct"]


@dataclass(frozen=True)
class BoundaryElement(Solver):
    """Boundary element method without interior resonances, for sound-hard and impedance bodies.

    The dual-surface equation is discretised by a discontinuous quadratic Nyström method on curved
    six-node panels. GMRES solves it in two forms. The transposed form is accurate away from the
    bodies, even for sources on or near their surfaces. The direct form provides the pressure on and
    near the surfaces. The error is estimated from the difference between the two solutions. With
    hundreds of excitations, Gaussian elimination replaces GMRES.

    Attributes
    ----------
    accuracy : target for the relative error away from the surfaces, 0.0001 to 0.3 (0.01 is 1 %). It
        determines the size of the panels; 0.03 is suitable for a preview.
    precision : precision of the iteration and the matrix, "float32" or "float64". With "float32"
        and an accuracy of 0.003 or more, the matrix is stored in bfloat16.
    estimate : whether to solve both the direct and the transposed equation. If False, only the
        transposed equation is solved, which is enough for a transfer matrix. A solve then takes
        about half the time, the estimated error is NaN, and evaluating the field on or near the
        surfaces raises ``InvalidInput``. If the scene contains reflecting boards, the direct
        equation is solved instead. At an accuracy of 0.06 or coarser, use the solution for drives
        only: their correlation with the exact drives was 0.995, while pressures had errors of up to
        8 %.
    enough : relative error above which the report contains a warning; by default equal to
        ``accuracy``.
    progress : callback, such as ``print``, that receives the name of each step as it begins.

    Raises
    ------
    InvalidInput
        If ``accuracy`` or ``enough`` is not between 0.0001 and 0.3, or if the precision is unknown.

    Examples
    --------
    >>> import airtact as at
    >>> ball = at.sphere(radius=5e-3, edge=2e-3)
    >>> scene = at.Scene(at.Medium(343.1, 1.293), [at.sound_hard(ball)], frequency=40e3)
    >>> source = at.Monopoles(np.array([[0, 0, 0.01]]), np.ones(1))
    >>> field = at.BoundaryElement(accuracy=0.03).radiate(scene, source)
    >>> field.at(np.array([[0, 0, 0.1]])).shape
    (1, 1)
    """

    accuracy: float = 0.01
    precision: Literal["float32", "float64"] = "float32"
    estimate: bool = True
    enough: float | None = None
    progress: Progress | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        for name, share in (("accuracy", self.accuracy), ("enough", self.max_error)):
            number(share, name, "")
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
    def max_error(self) -> float:
        """Relative error above which the report contains a warning."""
        return self.accuracy if self.enough is None else self.enough

    @property
    def nodes_per_square_wavelength(self) -> float:
        """Number of nodes per λ² of surface.

        The error decreases as the third power of the edge length.
        """
        return 34.0 * (0.01 / self.accuracy) ** (2 / 3)

    def unknowns(self, scene: Scene, sources: Monopoles) -> int:
        """Mesh the bodies, and return the number of unknowns (nodes) that a solve would have."""
        of_kind(sources, Monopoles, "the sources", "target.beacons()")
        return 6 * sum(map(len, covers(**self._covering(scene, sources.refined_positions))))

    def radiate(self, scene: Scene, sources: Monopoles) -> BoundaryField | BoardField:
        """Solve the scene for the monopoles.

        Parameters
        ----------
        scene : scene with sound-hard or impedance bodies. Their images in a plane add no unknowns.
        sources : monopoles outside the bodies or on their surfaces. If there is a plane, they must
            be in front of it or on it. If sources lie in the faces of reflecting boards, the
            returned field is known only around the other bodies, and the panels near these sources
            are not refined.

        Returns
        -------
        The field of the monopoles, with one excitation per column of their strengths.

        Raises
        ------
        InvalidInput
            If there are no bodies, if a body is filled, if a source is inside a body or behind a
            plane, or if there is not enough memory.
        NotConverged
            If GMRES does not reach its tolerance.
        """
        check_sources(scene, sources, planes=True)
        _check_bodies(scene)
        inside = in_boards(scene, sources)
        if inside.any():
            return self._from_boards(scene, sources, inside)
        return self._radiate(scene, sources, sources.refined_positions)

    def _from_boards(
        self, scene: Scene, sources: Monopoles, inside: Bool[np.ndarray, "sources"]
    ) -> BoardField:
        """Solve for sources, some of which are in the faces of reflecting boards.

        The transposed solution around all obstacles provides monopoles that radiate the boards'
        reflections. A second solve around the other bodies uses these monopoles and the sources.
        """
        refined = sources.positions[~inside]
        # A tenth of the usual tolerance, because the error of this solve is not estimated.
        with_boards = self._radiate(scene, sources, refined, 0.1 * self.accuracy, ("transposed",))
        rest = replace(
            scene, obstacles=[obstacle for obstacle in scene.obstacles if not obstacle.board]
        )
        from_all = elements_and_boards(with_boards)
        if rest.obstacles:
            around = self._radiate(rest, from_all, refined)
        else:
            around = FreeField().radiate(rest, from_all)
        boards = replace(
            scene, obstacles=[scene.obstacles[index] for index in scene.boards], planes=()
        )
        report = replace(
            with_boards.report,
            estimated_error=around.report.estimated_error,
            warnings=(*with_boards.report.warnings, NOT_ESTIMATED, *around.report.warnings),
        )
        nodes = with_boards.surface.nodes
        # Points closer to a board than its largest panel radius are too close to its sparse
        # monopoles.
        reach = float(nodes.radii[np.isin(nodes.body[::6], scene.boards)].max())
        return BoardField(rest, sources, report, boards, around, reach)

    def _radiate(
        self,
        scene: Scene,
        sources: Monopoles,
        refined: Points,
        tolerance: float | None = None,
        equations: Sequence[Equation] = (),
    ) -> BoundaryField:
        """Solve for sources, none of which is in a board's face.

        Parameters
        ----------
        refined : points near which the panels are smaller [m].
        tolerance : residual at which the iteration stops; by default it follows from the accuracy.
        equations : equations to solve. By default both are solved if the error is estimated;
            otherwise the direct one if the scene has boards, or the transposed one.
        """
        clock = Clock(self.progress)
        excitations = sources.strengths.shape[1]
        prepared = self._prepared(scene, refined, clock, excitations)
        return self._solved(scene, sources, prepared, clock, tolerance, equations)

    def _prepared(
        self, scene: Scene, refined: Points, clock: Clock, excitations: int = 1
    ) -> "_Prepared":
        """Cover the bodies with panels, and fill the matrix for a number of excitations."""
        with clock.step("panels", "covering the bodies with panels"):
            panels, surface = self._discretised(scene, refined)
        count = len(surface.nodes.points)
        by_elimination = worth_eliminating(count, excitations)
        with clock.step("matrix", f"filling the matrix of {count} unknowns"):
            store: Store = self.precision
            error = None
            if by_elimination:
                check_memory(count, store, 2 * blocks_of(count) ** 2)  # including its factors
            elif self.precision == "float32":
                if self.accuracy >= BFLOAT16_ACCURACY:
                    store = "bfloat16"
                # The sound is stronger in the gap between a body and its image.
                error = LOW_RANK_ERROR * self.accuracy * (0.2 if scene.planes else 1.0)
            matrices = [assemble(surface, store, error, plane) for plane in (None, *scene.planes)]
        return _Prepared(scene, panels, surface, matrices, by_elimination)

    def _solved(
        self,
        scene: Scene,
        sources: Monopoles,
        prepared: "_Prepared",
        clock: Clock,
        tolerance: float | None = None,
        equations: Sequence[Equation] = (),
    ) -> BoundaryField:
        """Solve for sources; the parameters are those of ``_radiate``."""
        if not equations:
            alone: Equation = "direct" if scene.boards else "transposed"
            equations = ("transposed", "direct") if self.estimate else (alone,)
        if tolerance is None:
            tolerance = self._tolerance(scene)
        surface = prepared.surface
        nodes = surface.nodes
        matrices = prepared.matrices
        excitations = sources.strengths.shape[1]
        solved: dict[Equation, GmresResult] = {}
        factors = np.ones(len(sources.positions))
        with clock.step(
            "gmres", f"solving for {counted(excitations, 'excitation', 'excitations')}"
        ):
            for equation in equations:
                transposed = equation == "transposed"
                if transposed:
                    right, factors = transposed_right_side(
                        surface, sources.positions, sources.strengths, scene.planes
                    )
                else:
                    emitting = with_images(scene.planes, sources)
                    right = direct_right_side(surface, emitting.positions, emitting.strengths)
                if prepared.by_elimination:
                    solved[equation] = eliminate(matrices, right, transposed)
                else:
                    solved[equation] = self._iterate(scene, matrices, right, transposed, tolerance)

        report = replace(
            self._report(scene, prepared.panels, [nodes], tolerance, clock),
            residual=float(max(result.residuals.max() for result in solved.values())),
            iterations=max(result.iterations for result in solved.values()),
            citations=CITATIONS,
        )
        values = {
            equation: result.solution.astype(np.complex128).T for equation, result in solved.items()
        }
        solved_field = BoundaryField(
            scene,
            sources,
            report,
            surface,
            pressure=values.get("direct"),
            density=values.get("transposed"),
            factors=factors,
            accuracy=self.accuracy,
            max_error=self.max_error,
        )
        if len(equations) == 1:
            return solved_field
        with clock.step("estimate", "estimating the error"):
            probes = _probes(scene, nodes, surface.near_rule.reach)
            estimate = float(solved_field.error_at(probes).max())
        report = replace(report, estimated_error=estimate)
        if estimate > 1.5 * self.max_error:
            warning = (
                f"{OF_THE_DIRECT} has an estimated error of {100 * estimate:.1f} %, above "
                f"the limit of {100 * self.max_error:.1f} %. Possible causes are uneven "
                "triangles, a narrow gap, or a source on the surface. A transfer matrix is more "
                "accurate."
            )
            report = replace(report, warnings=(warning, *report.warnings))
        return replace(solved_field, report=report)

    def factorised(
        self, scene: Scene, refined: Points | None = None
    ) -> "at.acoustics.FactorisedBodies":
        """Factorise each body once, for any sources and rigid motions of the bodies.

        For a new pose of two fingers, or for other foci, the returned solver
        needs a fraction of the time that ``radiate`` takes. Its field is known
        only away from the bodies, as with ``estimate=False``. The factorisation
        takes as long as dozens of solves: 2 s for two fingers with 1,100 unknowns
        each. The time grows as the cube of the number of unknowns per body,
        to minutes for a hand with 8,000. In a cavity, such as a deep groove, the error can
        be twice ``accuracy``.

        Parameters
        ----------
        scene : scene with sound-hard or impedance bodies.
        refined : (P, 3) points [m], such as later foci, near which the panels are smaller.

        Returns
        -------
        A solver for these bodies in any poses, in the same medium and at the same frequency.

        Raises
        ------
        InvalidInput
            If there are no bodies, if a body is filled, or if there is not enough memory.
        """
        from airtact.acoustics.solvers.bem.reduced_body import reduced_body

        points = np.empty((0, 3))
        if refined is not None:
            points = points_of(refined, "refined points", least=0)
        check_no_planes(scene, "a factorisation of bodies")
        _check_bodies(scene)
        if len(points):
            check_outside(scene, points, "refined")
        clock = Clock(self.progress)
        goal = 0.5 * self.accuracy  # for the error of the skeletons, which decreases with distance
        with clock.step("panels", "covering the bodies with panels"):
            panels = panels_of(**self._covering(scene, points))
        bodies = []
        for body, obstacle in enumerate(scene.obstacles):
            with clock.step("bodies", f"factorising body {body}"):
                # Each body has its own matrix, without low-rank blocks.
                of_body = panels.body == body
                nodes = place_nodes(
                    panels.quadratic_triangles[of_body],
                    body=np.zeros(np.count_nonzero(of_body), dtype=np.int64),
                    deviation=panels.deviation[of_body],
                    admittance=admittances(scene)[panels.body[of_body]],
                )
                count = len(nodes.points)
                # There are four copies: the matrix, its factors, right-hand sides and solutions.
                check_memory(count, self.precision, 4 * blocks_of(count) ** 2)
                surface = self._surface(nodes, scene, [obstacle])
                bodies.append(reduced_body(surface, 0.7 * scene.wavelength, goal))
        tolerance = 0.1 * self.accuracy
        report = self._report(
            scene, panels, [body.surface.nodes for body in bodies], tolerance, clock
        )
        inaccurate = [
            f"the reduced model of body {index} has an error of {100 * body.error:.1f} %, above "
            f"the goal of {100 * goal:.1f} %: the body has a narrow cavity, or precision "
            "'float32' is not enough for the accuracy"
            for index, body in enumerate(bodies)
            if body.error > 1.5 * goal
        ]
        report = replace(
            report,
            solver="BoundaryElement, factorised",
            settings={**report.settings, "skeleton_error": max(body.error for body in bodies)},
            citations=(
                *CITATIONS,
                "P. G. Martinsson, V. Rokhlin, Journal of Computational Physics 205 (2005) 1: "
                "skeletons of bodies",
            ),
            warnings=(*inaccurate, *report.warnings),
        )
        return at.acoustics.FactorisedBodies(
            scene, tuple(bodies), self, tolerance, self._smallest_edge(scene), report
        )

    def moving_panels(self, scene: Scene, refined: Points) -> "at.acoustics.MovingPanels":
        """Cover one body with panels that can be moved, for use in single-precision solves.

        Parameters
        ----------
        scene : scene that contains only the body.
        refined : (P, 3) points [m], such as foci, near which the panels are smaller.

        Returns
        -------
        The panels before any motion, with their collocation points.
        """
        _check_bodies(scene)
        panels, surface = self._discretised(scene, refined)
        return at.acoustics.MovingPanels(
            corners=panels.quadratic_triangles,
            inside=surface.shifted,
            deviation=panels.deviation,
            admittance=surface.nodes.admittance,
            wavenumber=surface.wavenumber,
            near_rule=surface.near_rule,
            low_rank_error=LOW_RANK_ERROR * self.accuracy,
        )

    def _report(
        self, scene: Scene, panels: Panels, nodes: Sequence[Nodes], tolerance: float, clock: Clock
    ) -> SolveReport:
        settings = {
            "accuracy": self.accuracy,
            "precision": self.precision,
            "gmres_tolerance": tolerance,
        }
        if scene.planes:
            settings[PLANES] = len(scene.planes)
        if scene.boards:
            settings[BOARDS] = len(scene.boards)
        count = sum(len(part.points) for part in nodes)
        area = float(sum(part.weights.sum() for part in nodes))
        coarse = [
            f"the panels of body {body} deviate from its triangles by up to "
            f"{1e3 * farthest:.2g} mm ({1e3 * mean:.2g} mm on average), which is more than 1/20 of "
            "the wavelength. The triangles are too coarse for a curved surface: use a mesh with "
            "shorter edges, or sharp_degrees = 0 for a faceted body."
            for body, (farthest, mean) in enumerate(
                zip(panels.farthest, panels.mean_distance, strict=True)
            )
            if farthest > scene.wavelength / 20
        ]
        return SolveReport(
            solver="BoundaryElement",
            nodes=count,
            nodes_per_square_wavelength=count * scene.wavelength**2 / area,
            estimated_error=float("nan"),
            seconds=clock.seconds,
            settings=settings,
            warnings=tuple(coarse),
            farthest_off_triangles=float(panels.farthest.max()),
            mean_off_triangles=float(panels.mean_distance.max()),
        )

    def _iterate(
        self,
        scene: Scene,
        matrices: Sequence[BlockMatrix],
        right: Complex128[np.ndarray, "nodes excitations"],
        transposed: bool,
        tolerance: float,
    ) -> GmresResult:
        # The right-hand side is scaled because squares would leave the range of single precision.
        size = np.abs(right).max(axis=0, initial=0.0)
        size[size == 0.0] = 1.0
        right_sides = np.ascontiguousarray((right / size).T, dtype=matrices[0].precision)

        # Each right-hand side has its own basis of 16 vectors or more, so hundreds of right-hand
        # sides are solved in groups that need at most about 0.2 GB each.
        group = max(32, int(1.5e6 / right_sides.shape[1]))
        results = [
            # A cavity makes the equations ill-conditioned, so the error of the solution counts too.
            # Sound decays slowly between boards that face each other.
            iterate(
                matrices,
                right_sides[first : first + group],
                transposed,
                tolerance,
                # One solve at a loose tolerance saves less than the inverse blocks cost.
                preconditioned=self.estimate,
                error=0.5 * self.accuracy,
                most_iterations=600 if scene.boards else 120,
            )
            for first in range(0, len(right_sides), group)
        ]
        result = GmresResult(
            np.concatenate([part.solution for part in results]),
            np.concatenate([part.residuals for part in results]),
            max(part.iterations for part in results),
        )
        return replace(result, solution=result.solution.astype(np.complex128) * size[:, None])

    def _surface(self, nodes: Nodes, scene: Scene, obstacles: Sequence[Obstacle]) -> DualSurface:
        # The thickness of exact shapes is known, so it is measured only on other shapes.
        thickness = np.empty(len(nodes.points))
        for index, obstacle in enumerate(obstacles):
            of_body = nodes.body == index
            thickness[of_body] = obstacle.surface.shape.thickness_at(
                nodes.points[of_body], nodes.normals[of_body], THICK_FROM * scene.wavelength
            )
        if self.precision == "float64":
            near_rule = NearRule(2.5, (6, 6))
        elif self.accuracy >= PREVIEW_ACCURACY:
            near_rule = NearRule(1.1, (3, 3))
        else:
            near_rule = NearRule(1.6, (4, 4))
        error = 0.02 * self.accuracy
        return dual_surface(
            nodes, scene.wavenumber, near_rule, self.precision, thickness, error=error
        )

    def _discretised(self, scene: Scene, refined: Points) -> tuple[Panels, DualSurface]:
        """Cover the bodies with panels, in the order of the blocks, and place their nodes."""
        panels = panels_of(**self._covering(scene, refined))
        centres = np.einsum("tsd->td", panels.quadratic_triangles[:, :3]) / 3  # faster than np.mean
        order = block_order(centres)
        panels = replace(
            panels,
            quadratic_triangles=panels.quadratic_triangles[order],
            body=panels.body[order],
            deviation=panels.deviation[order],
        )
        admittance = admittances(scene)[panels.body]
        nodes = place_nodes(panels.quadratic_triangles, panels.body, panels.deviation, admittance)
        return panels, self._surface(nodes, scene, scene.obstacles)

    def _covering(self, scene: Scene, refined: Points) -> dict[str, Any]:
        """Arguments that ``panels_of`` and ``covers`` share."""
        smallest = self._smallest_edge(scene)
        # Panels around the circumference of a round body.
        table = ((0.025, 7), (0.02, 8), (0.0125, 9), (0.0, 11))
        around = next(panels for least, panels in table if self.accuracy >= least)
        if not self.estimate and self.accuracy >= 0.06:
            around = 6  # enough for drives
        return {
            "shapes": [obstacle.surface.shape for obstacle in scene.obstacles],
            "edge": 2 * smallest,
            "near": refined[scene.depth(refined, within=2 * smallest) > -2 * smallest],
            "smallest": smallest,
            "bend": 2 * np.pi / around,
            # Moving a surface by d changes the phase of the reflected sound by 2 k d.
            "away": self.accuracy / (2 * scene.wavenumber.real),
            "image": scene.planes[0].image if scene.planes else None,
            "walls": scene.boards,
            # Needed between the bodies; the sound far from them is accurate without it.
            "close": scene.wavelength if self.estimate else 0.0,
        }

    def panel_edge(self, wavelength: float) -> float:
        """Return the edge length [m] of equilateral panels on hard bodies away from sources."""
        return positive(wavelength, "wavelength", "m") * float(
            np.sqrt(6 / self.nodes_per_square_wavelength * 4 / np.sqrt(3))
        )

    def _smallest_edge(self, scene: Scene) -> float:
        """Edge length [m] below which panels are not refined near a source."""
        # The pressure varies faster on a yielding surface, which needs 1.28 times as many nodes.
        yielding = np.abs(admittances(scene)).max(initial=0.0) > 0.1
        return 0.5 * self.panel_edge(scene.wavelength) / math.sqrt(1.28 if yielding else 1.0)

    def _tolerance(self, scene: Scene) -> float:
        if self.precision == "float64":
            tolerance = min(0.1 * self.accuracy, 1e-8)
        elif not self.estimate:  # only for receivers far away
            tolerance = self.accuracy * (
                0.8 if self.accuracy >= 0.06 else 0.5 if self.accuracy >= 0.04 else 0.4
            )
        else:
            # In narrow gaps the error is up to nine times the residual.
            tolerance = max(0.1 * self.max_error, 2e-6)
        # Reflecting boards reflect the remaining sound back and forth.
        return tolerance * (0.1 if scene.boards else 1.0)


@dataclass(frozen=True, eq=False)
class _Prepared:
    """The bodies of a scene with panels, and the matrices of the bodies and of their images."""

    scene: Scene
    panels: Panels
    surface: DualSurface
    matrices: Sequence[BlockMatrix]
    by_elimination: bool


@dataclass(frozen=True, eq=False)
class SharedPanels(Solver):
    """``BoundaryElement`` that uses the same panels for different sources around the same bodies.

    The panels and the matrix of the last scene are kept. Another solve of the same ``Scene`` object
    therefore takes about half the time. Sources in the faces of reflecting boards are not
    supported. ``verification_solver`` returns this solver for large bodies.

    Attributes
    ----------
    solver : settings of the solves.
    refined : (P, 3) points near which the panels are smaller [m], such as the foci. The panels are
        not refined near the sources.
    drive_only : whether only the transposed equation is solved, with a tolerance that is sufficient
        for drives, as with ``estimate=False``.
    """

    solver: BoundaryElement
    refined: Float64[np.ndarray, "points 3"]
    drive_only: bool = False
    kept: "list[_Prepared]" = field(default_factory=list, compare=False, repr=False)

    def reporting(self, progress: Progress | None) -> "SharedPanels":
        """Return a copy, with the same panels, that passes the name of each step to a callback."""
        return replace(self, solver=self.solver.reporting(progress))

    def radiate(self, scene: Scene, sources: Monopoles) -> BoundaryField:
        """Solve the scene for the monopoles; see ``BoundaryElement.radiate``."""
        check_sources(scene, sources, planes=True)
        _check_bodies(scene)
        clock = Clock(self.solver.progress)
        if not self.kept or self.kept[0].scene is not scene:
            self.kept[:] = [self.solver._prepared(scene, self.refined, clock)]
        if not self.drive_only:
            return self.solver._solved(scene, sources, self.kept[0], clock)
        tolerance = replace(self.solver, estimate=False)._tolerance(scene)
        return self.solver._solved(scene, sources, self.kept[0], clock, tolerance, ("transposed",))


def _check_bodies(scene: Scene) -> None:
    if not of_kind(scene, Scene, "the scene", "Scene(medium, obstacles, frequency)").obstacles:
        raise InvalidInput("the scene has no obstacles; use FreeField for open air.", code="empty")
    for index, obstacle in enumerate(scene.obstacles):
        if obstacle.boundary == "filled":
            raise InvalidInput(
                f"obstacle {index} is filled, but BoundaryElement supports only sound-hard and "
                "impedance bodies. Use FiniteElement, or SphereSeries for a single sphere.",
                code="not_supported",
            )


def _probes(scene: Scene, nodes: Nodes, reach: float) -> Float64[np.ndarray, "probes 3"]:
    """Return points for the error estimate, around the bodies or close in front of boards."""
    if not scene.boards:
        return surrounding_points(scene, nodes.points)
    panels = np.flatnonzero(np.isin(nodes.body[::6], scene.boards))
    panels = panels[:: math.ceil(len(panels) / 512)]
    # The points are two radii away, because the transposed solution's monopoles are too sparse for
    # nearer ones.
    before = nodes.centres[panels] + 2.0 * nodes.radii[panels, None] * nodes.normals[6 * panels]
    return before[(scene.depth(before) < 0.0) & ~near_surface(nodes, before, reach)]
