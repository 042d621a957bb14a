"""Bodies that are factorised one by one, for foci that change and for bodies that move rigidly against each other."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Complex, Float64

from airtact.conventions import InvalidInput
from airtact.mesh.quadratic_triangles import longest_edges
from airtact.pose import Pose
from airtact.printing import in_short
from airtact.scene.scene import Obstacle, Scene, check_sources
from airtact.scene.sources import Monopoles
from airtact.solvers.bem.layer_potentials import project_contacts
from airtact.solvers.bem.placed_body import Coupling, PartsField, PlacedBody
from airtact.solvers.bem.quadrature import OFF_SURFACE
from airtact.solvers.bem.reduced_body import ReducedBody
from airtact.solvers.gmres import GmresResult, gmres
from airtact.solvers.problem import RadiatedField, Solver, SolveReport
from airtact.surfaces.panels import LARGEST_TO_POINT, LONGEST_TO_EQUILATERAL
from airtact.surfaces.surface import rigid_motion
from airtact.validation import counted

MOVED = 1e-3
"""Wavelengths that a vertex may be off and its body still counts as rigidly moved."""


@dataclass(frozen=True, eq=False)
class FactorisedBodies(Solver):
    """Bodies whose own scattering is kept: a solver for them alone, wherever each of them is moved.

    Attributes
    ----------
    scene : the bodies as they were factorised.
    parts : what each of them does to sound, in its own frame.
    whole : the solver that takes over where two bodies come too near for it.
    report : how it was made, before any sound was solved.
    smallest : edge below which no panel was cut for the sake of points beside it [m].
    """

    scene: Scene
    parts: tuple[ReducedBody, ...]
    whole: Solver
    report: SolveReport
    smallest: float

    __repr__ = in_short

    def radiate(self, scene: Scene, sources: Monopoles) -> RadiatedField:
        """Solve for the monopoles, with each body where the scene has it.

        Where two bodies stand nearer than the kept scattering reaches, the scene is solved as a whole.

        Parameters
        ----------
        scene : the same bodies, each of them moved rigidly or not, in the same medium at the same frequency.
        sources : monopoles outside the bodies or on their skin.

        Raises
        ------
        InvalidInput
            Other bodies, another medium or frequency, or a source inside a body.
        NotConverged
            The iteration over the bodies did not settle.
        """
        check_sources(scene, sources)
        began = time.perf_counter()
        coupling = self._coupling(scene)
        if coupling is None:
            return self.whole.radiate(scene, sources)
        placed = coupling.placed
        sources, factors = _on_skins(scene, placed, sources)
        spoken = factors[:, None] * sources.strengths
        alone = np.ascontiguousarray(
            np.concatenate([body.alone(sources.positions, spoken, factors > 1) for body in placed]).T
        )
        result = self._together(coupling, alone)
        report = replace(
            self.report,
            residual=float(result.residuals.max()),
            iterations=result.iterations,
            seconds={"bodies": time.perf_counter() - began},
            warnings=(*self.report.warnings, *self._coarse(placed, sources)),
        )
        return PartsField(scene, sources, placed, result.solution.T.astype(np.complex128), factors, report)

    def _coarse(self, placed: Sequence[PlacedBody], sources: Monopoles) -> Iterator[str]:
        """Warn of sources so near a skin that its panels should be finer than they are."""
        for body, one in enumerate(placed):
            distance, node = one.part.tree.query(one.local.apply(sources.positions))
            panels = one.part.surface.nodes.quadratic_triangles[np.asarray(node) // 6]
            for source, edge in enumerate(longest_edges(panels)):
                if edge > 1.001 * max(LONGEST_TO_EQUILATERAL * self.smallest, LARGEST_TO_POINT * distance[source]):
                    yield (
                        f"source {source} stands {1e3 * distance[source]:.2g} mm from a node of body {body}, where "
                        f"panels are {1e3 * edge:.2g} mm long: it may be farther off than the accuracy asked; "
                        "factorise the bodies with that place in beside"
                    )

    def _together(self, coupling: Coupling, alone: Complex[np.ndarray, "sounds hearing"]) -> GmresResult:
        """Strengths of all bodies from those that each would have alone: at once where they stand as they did."""
        if coupling is self._at_rest:
            inverse, residual = self._inverse
            return GmresResult(alone @ inverse, np.full(len(alone), residual), 0)
        return gmres(coupling.times, alone, float(self.report.settings["gmres_tolerance"]))

    @cached_property
    def _inverse(self) -> tuple[Complex[np.ndarray, "hearing heard"], float]:
        """Inverse of the coupling of the bodies as they were factorised, and the largest residual that it leaves."""
        assert self._at_rest is not None
        count = sum(len(part.hears) for part in self.parts)
        matrix = self._at_rest.times(np.eye(count, dtype=self.parts[0].solved.dtype))
        inverse = np.linalg.inv(matrix)
        return inverse, float(np.linalg.norm(inverse @ matrix - np.eye(count), axis=1).max())

    @cached_property
    def _at_rest(self) -> Coupling | None:
        """The bodies as they were factorised."""
        return _coupled([PlacedBody(part, Pose.identity()) for part in self.parts])

    def _coupling(self, scene: Scene) -> Coupling | None:
        """Put the bodies where the scene has them; None where they are too near each other."""
        self._check_others(scene)
        pairs = list(zip(self.scene.obstacles, scene.obstacles, self.parts, strict=True))
        if all(before.surface is after.surface and before.boundary == after.boundary for before, after, _ in pairs):
            return self._at_rest
        return _coupled([self._where(index, *pair) for index, pair in enumerate(pairs)])

    def _check_others(self, scene: Scene) -> None:
        if scene.medium != self.scene.medium or scene.frequency != self.scene.frequency:
            raise InvalidInput(
                f"the bodies were factorised for {self.scene.frequency:g} Hz in {self.scene.medium}, but the scene has "
                f"{scene.frequency:g} Hz in {scene.medium}; factorise them for it."
            )
        if len(scene.obstacles) != len(self.parts):
            raise InvalidInput(
                f"{counted(len(self.parts), 'body was', 'bodies were')} factorised, but the scene has "
                f"{len(scene.obstacles)}; factorise those."
            )

    def _where(self, index: int, before: Obstacle, after: Obstacle, part: ReducedBody) -> PlacedBody:
        pose, off = rigid_motion(before.surface, after.surface)
        if off > MOVED * self.scene.wavelength or after.boundary != before.boundary:
            why = (
                f"its vertices are up to {1e3 * off:.3g} mm off"
                if np.isfinite(off)
                else "it has other triangles, or is curved otherwise"
            )
            why = why if after.boundary == before.boundary else f"it is {after.boundary}"
            raise InvalidInput(
                f"body {index} is not the one that was factorised, moved rigidly: {why}; factorise the scene again, or "
                "solve it with BoundaryElement."
            )
        return PlacedBody(part, pose)


def _coupled(placed: Sequence[PlacedBody]) -> Coupling | None:
    """How bodies hear each other; None where two of them stand too near for what is kept."""
    if any(first.meets(second) for index, first in enumerate(placed) for second in placed[:index]):
        return None
    return Coupling.of(placed)


def _on_skins(
    scene: Scene, placed: Sequence[PlacedBody], sources: Monopoles
) -> tuple[Monopoles, Float64[np.ndarray, "sources"]]:
    """Put sources that touch a skin exactly on its panel, and count them twice: they speak with their image."""
    positions, factors = np.array(sources.positions), np.ones(len(sources.positions))
    close = np.abs(scene.depth(positions)) < OFF_SURFACE * max(body.part.surface.nodes.contact.max() for body in placed)
    for body in placed if close.any() else ():
        local, contact = project_contacts(body.part.surface.nodes, body.local.apply(positions))
        positions[contact] = body.pose.apply(local[contact])
        factors[contact] = 2.0
    return replace(sources, positions=positions) if (factors > 1).any() else sources, factors
