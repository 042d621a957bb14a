"""The field of elements in reflecting boards: what all surfaces of the boards radiate, around the other bodies.

Elements in a face have a pressure beside them that no panel resolves, so the direct solution is of
no use there. The transposed one is: its monopoles on the boards radiate what these reflect, and
together with the elements they are the sources of a second, small solve around the other bodies,
which is right on and near their surfaces too.
"""

from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from jaxtyping import Bool, Float64

from airtact import _kernels
from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.arrays import Gradients, Mask, Points, Pressures
from airtact.acoustics.solvers.bem.field import BoundaryField
from airtact.acoustics.solvers.problem import RadiatedField, SolveReport, SurfaceField, receivers
from airtact.acoustics.sources import Monopoles
from airtact.checks import points_of

IN_FACE = 1e-6
"""Farthest that a source stands off the face of a board that it is in [m]."""

NOT_ESTIMATED = (
    "the estimated error is that around the bodies, without what the boards' reflections may be off"
)
"""How the sentence goes that the report of such a field has."""


@dataclass(frozen=True, eq=False)
class Emitting(Monopoles):
    """Monopoles beside which no panel is made smaller, except beside some points."""

    refined: Float64[np.ndarray, "fine 3"] = field(default_factory=partial(np.empty, (0, 3)))

    @property
    def refined_positions(self) -> Float64[np.ndarray, "fine 3"]:
        """Positions near which a solver refines its panels [m]."""
        return self.refined


@dataclass(frozen=True, eq=False)
class BoardField(RadiatedField):
    """The field of elements in reflecting boards, around the other bodies of a scene.

    ``scene`` is that of the other bodies; ``boards`` has the boards alone, and ``around`` is the
    field of elements and boards as sources. Nearer to a board than ``reach`` [m] nothing is known.
    """

    scene: Scene
    sources: Monopoles
    boards: Scene
    around: RadiatedField
    reach: float
    report: SolveReport

    __repr__ = RadiatedField.__repr__

    @property
    def on_surface(self) -> SurfaceField:
        """Total pressure on the surfaces of the bodies other than the boards."""
        return self.around.on_surface

    def valid(self, points: Points) -> Mask:
        """Whether points (P, 3) [m] are outside the bodies and at least ``reach`` off the boards."""
        points = points_of(points, "points", least=0)
        return self.around.valid(points) & (self.boards.depth(points) < -self.reach)

    def at(self, points: Points) -> Pressures:
        """Total pressure [Pa] at points (P, 3) for each of the S excitations; NaN where ``valid`` is False."""
        points = receivers(points, self.sources)
        pressure = self.around.at(points)
        pressure[self.boards.depth(points) >= -self.reach] = np.nan
        return pressure

    def velocity(self, points: Points) -> Gradients:
        """Particle velocity [m/s] at points (P, 3), as ``at``."""
        points = receivers(points, self.sources)
        velocity = self.around.velocity(points)
        velocity[self.boards.depth(points) >= -self.reach] = np.nan
        return velocity

    def report_at(self, points: Points) -> SolveReport:
        """Return the report with the error around the bodies estimated at points (P, 3) [m], where it is larger."""
        found = self.around.report_at(points)
        warnings = (
            *self.report.warnings,
            *(one for one in found.warnings if one not in self.report.warnings),
        )
        return replace(self.report, estimated_error=found.estimated_error, warnings=warnings)


def in_boards(scene: Scene, sources: Monopoles) -> Bool[np.ndarray, "sources"]:
    """Which sources are in the faces of reflecting boards."""
    inside = np.zeros(len(sources.positions), dtype=bool)
    for index in scene.boards:
        inside |= np.abs(scene.obstacles[index].surface.depth(sources.positions)) < IN_FACE
    return inside


def without_boards(scene: Scene) -> Scene:
    """Return a scene without its reflecting boards."""
    return replace(scene, obstacles=[one for one in scene.obstacles if not one.board])


def elements_and_boards(solved: BoundaryField, refined: Float64[np.ndarray, "fine 3"]) -> Emitting:
    """Return the sources of a field and the monopoles by which its boards scatter, as sources around what is left."""
    transposed = solved.without_images.transposed
    nodes = np.isin(transposed.surface.nodes.body, solved.scene.boards)
    both = np.concatenate([nodes, nodes[:: _kernels.sharing]])
    emitted, scattering = transposed.emitted, transposed.scattering
    positions = np.concatenate([emitted.positions, scattering.positions[both]])
    return Emitting(
        positions, np.concatenate([emitted.strengths, scattering.strengths[both]]), refined
    )


def reach_of(solved: BoundaryField) -> float:
    """Largest radius of a panel of a board [m]: nearer than this its monopoles are seen one by one."""
    nodes = solved.without_images.surface.nodes
    return float(nodes.radii[np.isin(nodes.body[::6], solved.scene.boards)].max())
