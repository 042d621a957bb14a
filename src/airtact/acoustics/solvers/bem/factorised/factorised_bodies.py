"""Bodies factorised one by one, for foci that change and bodies that move rigidly."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float64

from airtact.acoustics.scene import Obstacle, Scene, check_sources
from airtact.acoustics.solvers.bem.factorised.placed_body import (
    Coupling,
    FactorisedField,
    PlacedBody,
)
from airtact.acoustics.solvers.bem.factorised.products import Matrix, product, rounded
from airtact.acoustics.solvers.bem.factorised.reduced_body import ReducedBody
from airtact.acoustics.solvers.bem.layer_potentials import project_contacts
from airtact.acoustics.solvers.bem.quadrature import CONTACT_REACH
from airtact.acoustics.solvers.gmres import GmresResult, gmres
from airtact.acoustics.solvers.problem import RadiatedField, Solver, SolveReport
from airtact.acoustics.sources import Monopoles
from airtact.checks import counted
from airtact.errors import InvalidInput
from airtact.geometry.panels import LARGEST_TO_POINT, LONGEST_TO_EQUILATERAL
from airtact.geometry.pose import Pose
from airtact.geometry.surface import rigid_motion
from airtact.printing import one_line
from airtact.timing import Clock


@dataclass(frozen=True, eq=False)
class FactorisedBodies(Solver):
    """A solver for bodies that were factorised one by one, wherever each of them is moved.

    Attributes
    ----------
    scene : the bodies as they were factorised.
    bodies : their reductions.
    whole : solver that takes over where two bodies come too near.
    tolerance : relative residual of the iteration over the bodies.
    smallest : edge below which no panel was refined [m].
    report : how the bodies were factorised.
    """

    scene: Scene
    bodies: tuple[ReducedBody, ...]
    whole: Solver
    tolerance: float
    smallest: float
    report: SolveReport

    def __repr__(self) -> str:
        return one_line(
            self, counted(len(self.bodies), "body", "bodies"), f"{self.report.nodes} unknowns"
        )

    def radiate(self, scene: Scene, sources: Monopoles) -> RadiatedField:
        """Solve for the monopoles, with each body where the scene has it.

        The scene has the same bodies, each of them moved rigidly or not, in the same medium at the
        same frequency. The monopoles are outside the bodies or on their surfaces. Where two bodies
        are nearer to each other than the skeletons' reach, ``whole`` solves the scene.

        Raises
        ------
        InvalidInput
            Other bodies, another medium or frequency, or a source inside a body.
        NotConverged
            The iteration over the bodies did not reach the tolerance.
        """
        check_sources(scene, sources)
        clock = Clock()
        with clock.step("bodies"):
            coupling = self._coupling(scene)
            if coupling is None:
                return self.whole.radiate(scene, sources)
            placed = coupling.placed
            sources, factors = _projected(scene, placed, sources)
            strengths = factors[:, None] * sources.strengths
            sides = [
                body.right_side(sources.positions, strengths, factors > 1).T for body in placed
            ]
            # the products one after another: between them the threads would fall asleep
            alone = [
                product(body.reduced.solved, side) for body, side in zip(placed, sides, strict=True)
            ]
            densities = np.concatenate(alone, axis=1)
            if coupling is self._at_rest:
                inverse, residual = self._inverse
                solution = product(inverse, densities, transposed=True)
                result = GmresResult(solution, np.full(len(densities), residual), 0)
            else:
                result = gmres(coupling.times, densities, self.tolerance)
        report = replace(
            self.report,
            residual=float(result.residuals.max()),
            iterations=result.iterations,
            seconds=clock.seconds,
            warnings=(*self.report.warnings, *self._coarse(placed, sources)),
        )
        return FactorisedField(
            scene, sources, placed, result.solution.T.astype(np.complex128), factors, report
        )

    def _coarse(self, placed: Sequence[PlacedBody], sources: Monopoles) -> Iterator[str]:
        """Warn of sources so near a surface that its panels should be smaller."""
        for index, body in enumerate(placed):
            distance, node = body.reduced.tree.query(body.local.apply(sources.positions))
            edges = body.reduced.panel_edges[np.asarray(node) // 6]
            allowed = np.maximum(
                LONGEST_TO_EQUILATERAL * self.smallest, LARGEST_TO_POINT * np.asarray(distance)
            )
            for source in np.flatnonzero(edges > 1.001 * allowed):
                yield (
                    f"source {source} is {1e3 * distance[source]:.2g} mm from a node of body "
                    f"{index}, where panels are {1e3 * edges[source]:.2g} mm long: its error may "
                    "exceed the accuracy asked for; factorise the bodies with that point in refined"
                )

    @cached_property
    def _inverse(self) -> tuple[Matrix, float]:
        """Inverse of the coupling of the bodies as factorised, and its largest residual."""
        assert self._at_rest is not None
        count = sum(len(body.rows) for body in self.bodies)
        matrix = self._at_rest.times(np.eye(count, dtype=self.bodies[0].solved.dtype))
        inverse = rounded(np.linalg.inv(matrix), self.tolerance)
        residual = product(inverse, matrix.T).T - np.eye(count)
        return inverse, float(np.linalg.norm(residual, axis=1).max())

    @cached_property
    def _at_rest(self) -> Coupling | None:
        """The bodies as they were factorised."""
        return Coupling.of([PlacedBody(body, Pose.identity()) for body in self.bodies])

    def _coupling(self, scene: Scene) -> Coupling | None:
        """Place the bodies where the scene has them; None where they are too near each other."""
        if scene.medium != self.scene.medium or scene.frequency != self.scene.frequency:
            raise InvalidInput(
                f"the bodies were factorised for {self.scene.frequency:g} Hz in "
                f"{self.scene.medium}, but the scene has {scene.frequency:g} Hz in {scene.medium}; "
                "factorise them for it.",
                code="not_supported",
            )
        if len(scene.obstacles) != len(self.bodies):
            raise InvalidInput(
                f"{counted(len(self.bodies), 'body was', 'bodies were')} factorised, but the scene "
                f"has {len(scene.obstacles)}; factorise those.",
                code="not_supported",
            )
        pairs = list(zip(self.scene.obstacles, scene.obstacles, strict=True))
        if all(
            before.surface is after.surface and _same_boundary(before, after)
            for before, after in pairs
        ):
            return self._at_rest
        placed = []
        for index, (before, after) in enumerate(pairs):
            pose, off = rigid_motion(before.surface, after.surface)
            if not _same_boundary(before, after):
                why = f"it is {after.kind}, ratio {after.ratio}"
            elif not np.isfinite(off):
                why = "it has other triangles, or is curved otherwise"
            else:
                why = f"its vertices are up to {1e3 * off:.3g} mm off"
            # vertices may be off by a thousandth of the wavelength
            if off > 1e-3 * self.scene.wavelength or not _same_boundary(before, after):
                raise InvalidInput(
                    f"body {index} is not the one that was factorised, moved rigidly: {why}; "
                    "factorise the scene again, or solve it with BoundaryElement.",
                    code="not_supported",
                )
            placed.append(PlacedBody(self.bodies[index], pose))
        return Coupling.of(placed)


def _same_boundary(before: Obstacle, after: Obstacle) -> bool:
    return (before.boundary, before.ratio) == (after.boundary, after.ratio)


def _projected(
    scene: Scene, placed: Sequence[PlacedBody], sources: Monopoles
) -> tuple[Monopoles, Float64[np.ndarray, "sources"]]:
    """Project sources that touch a surface onto its panel, with factor 2 for their image."""
    positions = np.array(sources.positions)
    factors = np.ones(len(positions))
    limit = CONTACT_REACH * max(body.reduced.surface.nodes.contact.max() for body in placed)
    if (np.abs(scene.depth(positions)) >= limit).all():
        return sources, factors
    for body in placed:
        local, contact = project_contacts(body.reduced.surface.nodes, body.local.apply(positions))
        positions[contact] = body.pose.apply(local[contact])
        factors[contact] = 2.0
    return replace(sources, positions=positions) if (factors > 1).any() else sources, factors
