"""``FiniteElement``, which solves the Helmholtz equation in a box with NGSolve."""

from dataclasses import dataclass, field, replace

import numpy as np

from airtact.acoustics.scene import Scene, check_no_planes, check_sources
from airtact.acoustics.solvers.fem.factorisation import check_memory, pardiso_library
from airtact.acoustics.solvers.fem.field import FiniteField, solved_from_afar, touching_warnings
from airtact.acoustics.solvers.fem.mesh import Box, meshed
from airtact.acoustics.solvers.fem.system import LAYER_THICKNESS, System, assembled
from airtact.acoustics.solvers.problem import Solver, SolveReport
from airtact.acoustics.sources import Monopoles
from airtact.errors import InvalidInput, between, of_kind
from airtact.timing import Clock, Progress

CITATIONS = (
    "S. Inoue, Y. Makino, H. Shinoda, SICE 2014, equation (8): finite elements with time reversal",
    "J. Schöberl, C++11 implementation of finite elements in NGSolve, TU Wien (2014)",
    "F. Collino, P. Monk, SIAM J. Sci. Comput. 19 (1998) 2061: perfectly matched layer in "
    "curvilinear coordinates",
)


@dataclass(frozen=True)
class FiniteElement(Solver):
    """Finite element method for sound-hard, impedance and filled bodies in absorbing media.

    Use it for bodies filled with a fluid, or to verify ``BoundaryElement`` by another method. It
    does not support planes, reflecting boards or scenes without bodies. ``reaching`` returns the
    solver for a given accuracy; the defaults are those for an error of 0.5 %. Pass an instance to
    ``Setup`` or ``field_map``, or call ``radiate``. Solving requires NGSolve
    (``pip install 'airtact[fem]'``), and raises ``NotConverged`` if the matrix is nearly singular.

    Curved tetrahedra of high order fill a tight box around the bodies. A perfectly matched layer
    (PML) around the box absorbs outgoing sound. Outside the box, the pressure is computed from the
    pressure on the bodies by the Kirchhoff-Helmholtz integral. The model of a pinching hand by
    Inoue, Makino and Shinoda (2014) has 170,000 unknowns. On two cores, a solve takes 7 s with the
    package ``mkl`` (``pip install 'airtact[mkl]'``, recommended) and 27 s without it.

    Attributes
    ----------
    order : polynomial order of tetrahedra with the nominal edge length, an integer from 1 to 10; 5
        by default. Larger tetrahedra use higher orders and smaller ones lower orders, which halves
        the cost at equal accuracy. Below order 4 or 1.5 elements per wavelength, all tetrahedra use
        the same order.
    elements_per_wavelength : wavelength divided by the nominal edge length of the tetrahedra, 0.5
        to 20; 1.7 by default.
    progress : callback, such as ``print``, that receives the name of each step as it begins.

    Raises
    ------
    InvalidInput
        If a setting is outside its range.

    Examples
    --------
    >>> import airtact as at
    >>> ball = at.sphere(radius=4e-3, edge=2e-3)
    >>> scene = at.Scene(at.Medium(343.1, 1.293), [at.sound_hard(ball)], frequency=40e3)
    >>> solver = at.FiniteElement(order=3)
    >>> field = solver.radiate(scene, at.Monopoles(np.array([[0, 0, 0.01]]), np.ones(1)))
    >>> field.at(np.array([[0, 0, 0.1]])).shape
    (1, 1)
    """

    order: int = 5
    elements_per_wavelength: float = 1.7
    progress: Progress | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        if not isinstance(self.order, int) or not 1 <= self.order <= 10:
            raise InvalidInput(
                f"order is {self.order!r}, but it must be a whole number from 1 to 10.",
                code="out_of_range",
            )
        between(self.elements_per_wavelength, 0.5, 20, "elements_per_wavelength", "", "2 is usual.")

    @classmethod
    def reaching(cls, accuracy: float) -> "FiniteElement":
        """Return a solver with the polynomial order that ``accuracy`` requires.

        ``accuracy`` is the target relative error away from the surface. The order is 4 for 0.03 or
        more, 5 for 0.005 or more, and 6 otherwise. Values outside the range 0.001 to 0.3 raise
        ``InvalidInput``.
        """
        between(accuracy, 1e-3, 0.3, "accuracy", "", "0.01 is 1 %.")
        return cls(order=4 if accuracy >= 0.03 else 5 if accuracy >= 0.005 else 6)

    def radiate(self, scene: Scene, sources: Monopoles) -> FiniteField:
        """Solve the scene for monopoles outside the bodies or on their surface.

        Returns
        -------
        The field of the monopoles, with one excitation per column of their strengths.

        Raises
        ------
        InvalidInput
            If there are no bodies, if the scene has a plane or reflecting boards, if a source is
            inside a body, if a body cannot be meshed, or if there is not enough memory.
        """
        check_sources(scene, sources)
        return self.factorised(scene).radiate(scene, sources)

    def factorised(self, scene: Scene) -> "FactorisedScene":
        """Mesh and factorise a scene once, and return a solver for any sources in this scene.

        Returns
        -------
        A solver whose ``radiate`` reuses the mesh and the factorisation.

        Raises
        ------
        InvalidInput
            If there are no bodies, if the scene has a plane or reflecting boards, if a body cannot
            be meshed, or if there is not enough memory.
        """
        of_kind(scene, Scene, "the scene", "Scene(medium, obstacles, frequency)")
        check_no_planes(scene, "FiniteElement")
        if not scene.obstacles:
            raise InvalidInput(
                "the scene has no obstacles; use FreeField for open air.", code="empty"
            )
        # Either MKL's Pardiso in single precision, refined in double, or NGSolve's factorisation.
        method = "pardiso" if pardiso_library() else "sparsecholesky"
        clock = Clock(self.progress)
        points = np.concatenate(
            [obstacle.surface.shape.extreme_points() for obstacle in scene.obstacles]
        )
        # There are 0.3 wavelengths of air between the bodies and the perfectly matched layer.
        margin = 0.3 * scene.wavelength
        box = Box(
            points.min(axis=0) - margin,
            points.max(axis=0) + margin,
            LAYER_THICKNESS * scene.wavelength,
        )
        check_memory(box, scene.wavelength, self.order, self.elements_per_wavelength, method)
        with clock.step("meshing"):
            mesh, surface, tetrahedra = meshed(scene, box, self.elements_per_wavelength)
        # On coarser meshes and at lower nominal orders, the order cannot be reduced further.
        grades = self.order >= 4 and self.elements_per_wavelength >= 1.5
        with clock.step("assembling"):
            system = assembled(
                scene,
                box,
                surface,
                tetrahedra,
                mesh,
                self.order,
                method,
                graded=1 / self.elements_per_wavelength if grades else None,
            )
        nodes = system.surface
        on_surface = np.count_nonzero(nodes.weighted.sum(axis=1))
        report = SolveReport(
            solver="FiniteElement",
            nodes=system.unknowns,
            nodes_per_square_wavelength=float(on_surface / nodes.areas.sum()),
            estimated_error=float("nan"),
            settings={
                "order": self.order,
                "elements_per_wavelength": self.elements_per_wavelength,
                "tetrahedra": len(tetrahedra.corners),
                "factorisation": method,
            },
            citations=CITATIONS,
        )
        return FactorisedScene(scene, self, system, report, clock)


@dataclass(frozen=True, eq=False, repr=False)
class FactorisedScene(Solver):
    """A solver for any sources in one scene, whose mesh and factorised matrix are computed once.

    Attributes
    ----------
    settings : the ``FiniteElement`` solver that created this solver.
    system : the assembled equation of the scene.
    report : report of the meshing, to which each solve adds its results.
    clock : clock that measures the duration of each step.
    """

    scene: Scene
    settings: FiniteElement
    system: System
    report: SolveReport
    clock: Clock

    def radiate(self, scene: Scene, sources: Monopoles) -> FiniteField:
        """Solve the same scene for the monopoles, reusing the mesh and the factorisation.

        Raises
        ------
        InvalidInput
            If ``scene`` is not the scene that was factorised, or if a source is inside a body.
        """
        if scene is not self.scene:
            raise InvalidInput(
                "this solver was factorised for another scene; factorise this scene.",
                code="not_supported",
            )
        check_sources(scene, sources)
        words = "factorising and solving"
        if self.system.method == "sparsecholesky":
            words += " (six times faster after pip install 'airtact[mkl]')"
        with self.clock.step("factorising and solving", words):
            solution = solved_from_afar(self.system, scene, sources)
        report = replace(
            self.report,
            seconds=dict(self.clock.seconds),
            warnings=touching_warnings(scene, sources),
        )
        return FiniteField(scene, sources, report, solution)
