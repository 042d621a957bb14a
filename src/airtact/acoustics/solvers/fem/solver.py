"""FiniteElement: the paper's equation (8) in a box round the bodies, on NGSolve."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from jaxtyping import Float64

from airtact.acoustics.scene import Scene, check_no_planes, check_sources
from airtact.acoustics.solvers.arrays import Points
from airtact.acoustics.solvers.fem.factorisation import check_memory, chosen_method
from airtact.acoustics.solvers.fem.field import FiniteField, solved_from_afar, touching_warnings
from airtact.acoustics.solvers.fem.mesh import Box, meshed
from airtact.acoustics.solvers.fem.symmetry import AXES, Mirror, mirrors_of
from airtact.acoustics.solvers.fem.system import System, assembled
from airtact.acoustics.solvers.fem.weak_form import LAYER_THICKNESS
from airtact.acoustics.solvers.problem import Solver, SolveReport, surrounding_points
from airtact.acoustics.sources import Monopoles
from airtact.errors import InvalidInput, Vector, between, check_choice, in_mm, of_kind, points_of
from airtact.timing import Clock, Progress

CITATIONS = (
    "S. Inoue, Y. Makino, H. Shinoda, SICE 2014, equation (8): finite elements with time reversal",
    "J. Schöberl, C++11 implementation of finite elements in NGSolve, TU Wien (2014)",
    "F. Collino, P. Monk, SIAM J. Sci. Comput. 19 (1998) 2061: perfectly matched layer in "
    "curvilinear coordinates",
)

# Air between the bodies and the perfectly matched layer [λ]
MARGIN = 0.3

# Air at least between the bodies and the faces of a workspace that is meshed [λ]
MIN_WORKSPACE_MARGIN = 0.1

# The paper's workspace, 14 x 14 x 18 cm [m]
PAPER_BOX = ((-0.07, -0.07, -0.09), (0.07, 0.07, 0.09))

# Unknowns from which the progress callback recommends the package mkl where it is not installed
RECOMMEND_MKL_FROM = 100_000


@dataclass(frozen=True)
class FiniteElement(Solver):
    """Finite elements for sound-hard, impedance and filled bodies, with absorption.

    Curved tetrahedra of high order fill a tight box round the bodies, a perfectly matched layer
    (PML) round it absorbs what leaves, and the pressure outside follows from that on the bodies by
    the surface integral of Kirchhoff and Helmholtz. The paper's pinch without symmetry has 170,000
    unknowns; a solve takes 7 s with the package ``mkl`` (``pip install 'airtact[mkl]'``,
    recommended) and 27 s without it, on two cores.

    Attributes
    ----------
    order : polynomial order of tetrahedra as large as asked for, 1 to 10.
    elements_per_wavelength : wavelength over the edge of the tetrahedra.
    symmetry : axes across which the scene is mirror symmetric, such as ``("x", "y")``, through the
        middle of the bodies; "found" takes all that there are. Sources need not be symmetric.
    domain : "tight", or "box" for the paper's way: the workspace is meshed and the pressure read
        off the mesh.
    box : lower and upper corner of the workspace [m], for ``domain="box"``.
    factorisation : "pardiso", MKL's, in single precision and refined in double; "sparsecholesky",
        NGSolve's own; "found" takes "pardiso" where the package ``mkl`` is installed, else
        "sparsecholesky".
    estimate : solve at the next order too, and report how far apart the two are. Costs about four
        times as much.
    graded : whether tetrahedra that came out larger or smaller than asked for get higher and lower
        orders, which costs half as much for the same accuracy; else ``order`` everywhere, as below
        order 4 and 1.5 elements per wavelength, where nothing can be spared.
    progress : callback that gets the name of each step as it begins.

    Raises
    ------
    InvalidInput
        A setting outside its range.

    Examples
    --------
    >>> import airtact as at
    >>> ball = at.sphere(radius=2e-3, edge=1e-3)
    >>> scene = at.Scene(at.Medium(343.1, 1.293), [at.sound_hard(ball)], frequency=40e3)
    >>> solver = at.FiniteElement(order=3)
    >>> field = solver.radiate(scene, at.Monopoles(np.array([[0, 0, 0.01]]), np.ones(1)))
    >>> field.at(np.array([[0, 0, 0.1]])).shape
    (1, 1)
    """

    order: int = 5
    elements_per_wavelength: float = 1.7
    symmetry: Sequence[str] | Literal["found"] = "found"
    domain: Literal["tight", "box"] = "tight"
    box: tuple[Vector, Vector] = PAPER_BOX
    factorisation: Literal["found", "sparsecholesky", "pardiso"] = "found"
    estimate: bool = False
    graded: bool = True
    progress: Progress | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        if not isinstance(self.order, int) or not 1 <= self.order <= 10:
            raise InvalidInput(
                f"order is {self.order!r}, but it must be a whole number from 1 to 10.",
                code="out_of_range",
            )
        between(self.elements_per_wavelength, 0.5, 20, "elements_per_wavelength", "", "2 is usual.")
        if self.symmetry != "found" and (
            isinstance(self.symmetry, str) or set(self.symmetry) - set(AXES)
        ):
            raise InvalidInput(
                f"symmetry is {self.symmetry!r}, but it must be 'found' or axes such as ('x', "
                "'y').",
                code="unknown_name",
            )
        check_choice(self.domain, "domain", ("tight", "box"))
        check_choice(self.factorisation, "factorisation", ("found", "sparsecholesky", "pardiso"))
        low, high = np.array(self.box, dtype=np.float64)
        if not (np.isfinite([low, high]).all() and (high > low).all()):
            raise InvalidInput(
                f"the workspace goes from {in_mm(low)} to {in_mm(high)}, but its second corner "
                "must lie above the first along x, y and z.",
                code="out_of_range",
            )

    @classmethod
    def reaching(cls, accuracy: float) -> "FiniteElement":
        """Choose the order that reaches an accuracy: 4 for 3 % or more, 5 down to 0.5 %, else 6.

        ``accuracy`` is the relative error wanted away from the surface, 0.001 to 0.3; others raise
        ``InvalidInput``.
        """
        between(accuracy, 1e-3, 0.3, "accuracy", "", "0.01 is 1 %.")
        return cls(order=4 if accuracy >= 0.03 else 5 if accuracy >= 0.005 else 6)

    def radiate(self, scene: Scene, sources: Monopoles) -> FiniteField:
        """Solve the scene for monopoles outside the bodies or on their surface.

        Raises
        ------
        InvalidInput
            No bodies, a source inside a body (or outside the workspace for ``domain="box"``),
            symmetry that is not there, a body that cannot be meshed, or too little memory.
        """
        check_sources(scene, sources)
        return self.factorised(scene).radiate(scene, sources)

    def factorised(self, scene: Scene, refined: Points | None = None) -> "FactorisedScene":
        """Mesh and assemble a scene once, to be solved for many sources.

        The result is a solver for this scene alone.

        ``refined`` are points (P, 3) [m] near which sources will stand; the surface triangles are
        smaller there.

        Raises
        ------
        InvalidInput
            As ``radiate``, or a point that is NaN or infinite.
        """
        of_kind(scene, Scene, "the scene", "Scene(medium, obstacles, frequency)")
        check_no_planes(scene, "FiniteElement")
        if not scene.obstacles:
            raise InvalidInput(
                "the scene has no obstacles; use FreeField for open air.", code="empty"
            )
        if refined is None:
            refined = np.empty((0, 3))
        refined = points_of(refined, "points to refine", least=0)
        method = chosen_method(self.factorisation)
        clock = Clock(self.progress)
        # Each mirror halves the unknowns; sources that are not symmetric take a factor for each
        # parity.
        mirrors = mirrors_of(scene, None if self.symmetry == "found" else tuple(self.symmetry))
        box = self._box(scene, mirrors)
        check_memory(box, scene.wavelength, self.order, self.elements_per_wavelength, method)
        with clock.step("meshing"):
            mesh, surface, tetrahedra = meshed(scene, box, self.elements_per_wavelength, refined)
        # On coarser meshes and at lower orders no order can be spared.
        grades = self.graded and self.order >= 4 and self.elements_per_wavelength >= 1.5
        with clock.step("assembling"):
            systems = tuple(
                assembled(
                    scene,
                    box,
                    surface,
                    tetrahedra,
                    mesh,
                    order,
                    method,
                    graded=1 / self.elements_per_wavelength if grades else None,
                    workspace=self.domain == "box",
                )
                for order in range(self.order, self.order + 1 + self.estimate)
            )
        nodes = systems[0].surface
        on_surface = np.count_nonzero(nodes.weighted.sum(axis=1))
        report = SolveReport(
            solver="FiniteElement",
            nodes=systems[0].unknowns,
            nodes_per_square_wavelength=float(on_surface / nodes.areas.sum()),
            estimated_error=float("nan"),
            settings={
                "order": self.order,
                "graded": grades,
                "elements_per_wavelength": self.elements_per_wavelength,
                "domain": self.domain,
                "mirrors": "".join(AXES[mirror.axis] for mirror in mirrors) or "none",
                "tetrahedra": len(tetrahedra.corners),
                "factorisation": method,
            },
            citations=CITATIONS,
        )
        return FactorisedScene(scene, self, systems, report, clock)

    def _box(self, scene: Scene, mirrors: tuple[Mirror, ...]) -> Box:
        whole_workspace = self.domain == "box"
        if whole_workspace:
            low, high = np.array(self.box, dtype=np.float64)
            _check_beyond(scene, low, high)
        else:
            shapes = [obstacle.surface.shape for obstacle in scene.obstacles]
            points = np.concatenate([shape.extreme_points() for shape in shapes])
            low = points.min(axis=0) - MARGIN * scene.wavelength
            high = points.max(axis=0) + MARGIN * scene.wavelength
        for mirror in mirrors:
            off = abs(low[mirror.axis] + high[mirror.axis] - 2 * mirror.position)
            if whole_workspace and off > 1e-6:
                raise InvalidInput(
                    f"the workspace is not symmetric about the plane {AXES[mirror.axis]} = "
                    f"{1e3 * mirror.position:.4g} mm as the bodies are; shift the box, or leave "
                    "that axis out of symmetry.",
                    code="does_not_match",
                )
            low[mirror.axis] = mirror.position
        return Box(low, high, LAYER_THICKNESS * scene.wavelength, mirrors)


@dataclass(frozen=True, eq=False, repr=False)
class FactorisedScene(Solver):
    """A scene that is meshed and assembled, and factorised as far as was needed.

    It solves for any sources.

    Attributes
    ----------
    settings : of the solver that made it.
    systems : the assembled system, and the one of the next order where an estimate was asked for.
    report : how it was made, before any excitation was solved.
    clock : time taken by step.
    """

    scene: Scene
    settings: FiniteElement
    systems: tuple[System, ...]
    report: SolveReport
    clock: Clock

    def radiate(self, scene: Scene, sources: Monopoles) -> FiniteField:
        """Solve the same scene for the monopoles, reusing the mesh and the factorisation.

        Raises
        ------
        InvalidInput
            Another scene, or as ``FiniteElement.radiate``.
        """
        if scene is not self.scene:
            raise InvalidInput(
                "this was factorised for another scene; factorise the given one too.",
                code="not_supported",
            )
        check_sources(scene, sources)
        first = self.systems[0]
        workspace = self.settings.domain == "box"
        if workspace:
            _check_in_layer(first.box, sources)
        words = "factorising and solving"
        if (
            self.settings.factorisation == "found"
            and first.method == "sparsecholesky"
            and first.unknowns > RECOMMEND_MKL_FROM
        ):
            words += f" {first.unknowns:,} unknowns"
            words += " (a sixth of the time with pip install 'airtact[mkl]')"
        with self.clock.step("factorising and solving", words):
            solutions = [
                solved_from_afar(system, scene, sources, workspace) for system in self.systems
            ]
        report = replace(
            self.report,
            seconds=dict(self.clock.seconds),
            warnings=touching_warnings(scene, sources),
        )
        fields = [
            FiniteField(scene, sources, report, solution, workspace) for solution in solutions
        ]
        if len(fields) == 1:
            return fields[0]
        # Compared where an array would be: beside the bodies either order is rougher.
        points = surrounding_points(scene, first.surface.points * scene.wavelength)
        coarse, fine = (field.at(points) for field in fields)
        size = np.linalg.norm(fine, axis=0)
        difference = np.linalg.norm(coarse - fine, axis=0) / np.where(size > 0, size, 1)
        report = replace(report, estimated_error=float(difference.max()))
        return replace(fields[0], report=report)


def _check_beyond(
    scene: Scene, low: Float64[np.ndarray, "3"], high: Float64[np.ndarray, "3"]
) -> None:
    """Check that no body reaches beyond the workspace, or nearly so."""
    for body, obstacle in enumerate(scene.obstacles):
        points = obstacle.surface.shape.extreme_points()
        beyond = (
            np.maximum(low - points, points - high).max(axis=1)
            + MIN_WORKSPACE_MARGIN * scene.wavelength
        )
        worst = int(beyond.argmax())
        if beyond[worst] > 0:
            raise InvalidInput(
                f"body {body} reaches {1e3 * beyond[worst]:.3g} mm too far at "
                f"{in_mm(points[worst])} for the workspace from {in_mm(low)} to {in_mm(high)}, "
                "which must hold all bodies with "
                f"{1e3 * MIN_WORKSPACE_MARGIN * scene.wavelength:.2g} mm to spare; take a larger "
                "box.",
                points[worst],
                code="misplaced",
            )


def _check_in_layer(box: Box, sources: Monopoles) -> None:
    """Check that a meshed workspace holds the sources.

    The layer round it would absorb what they emit.
    """
    low = np.array(box.low)
    high = box.high
    for mirror in box.mirrors:
        low[mirror.axis] = 2 * mirror.position - high[mirror.axis]
    beyond = np.maximum(low - sources.positions, sources.positions - high).max(axis=1)
    worst = int(beyond.argmax())
    if beyond[worst] > 0:
        raise InvalidInput(
            f"source {worst} at {in_mm(sources.positions[worst])} stands {1e3 * beyond[worst]:.3g} "
            "mm outside the workspace, in the perfectly matched layer that absorbs sound; take a "
            "larger box, or domain 'tight'.",
            sources.positions[worst],
            code="misplaced",
        )
