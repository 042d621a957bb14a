"""The field of elements in reflecting boards, around the other bodies.

The pressure near elements in a face varies faster than panels resolve, so the direct solution fails
there. The monopoles of the transposed solution on the boards radiate the reflections of the boards.
Together with the elements, these monopoles are the sources of a second, smaller solve around the
other bodies. The second solve is also accurate on and near the surfaces of these bodies.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool

from airtact import _kernels
from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.arrays import Mask, Points, Pressures, Vectors
from airtact.acoustics.solvers.bem.field import BoundaryField
from airtact.acoustics.solvers.problem import RadiatedField, SolveReport, SurfaceField
from airtact.acoustics.sources import Monopoles

NOT_ESTIMATED = (
    "the estimated error applies around the bodies and excludes the errors of the boards' "
    "reflections"
)


@dataclass(frozen=True, eq=False, repr=False)
class BoardField(RadiatedField):
    """The field of elements in reflecting boards, around the other bodies of a scene.

    Attributes
    ----------
    scene : scene with the other bodies.
    boards : scene with only the boards.
    around : field whose sources are the elements and the boards.
    reach : distance from a board within which the field is unknown [m].
    """

    boards: Scene
    around: RadiatedField
    reach: float

    @property
    def on_surface(self) -> SurfaceField:
        """Total pressure on the surfaces of the bodies other than the boards."""
        return self.around.on_surface

    def _valid(self, points: Vectors) -> Mask:
        return self.around.valid(points) & (self.boards.depth(points) < -self.reach)

    def _at(self, points: Vectors) -> Pressures:
        pressure = self.around.at(points)
        pressure[self.boards.depth(points) >= -self.reach] = np.nan
        return pressure

    def report_at(self, points: Points) -> SolveReport:
        """Return the report; its error is at least the error estimated around the bodies."""
        report = self.around.report_at(points)
        warnings = dict.fromkeys((*self.report.warnings, *report.warnings))  # without duplicates
        return replace(
            self.report, estimated_error=report.estimated_error, warnings=tuple(warnings)
        )


def in_boards(scene: Scene, sources: Monopoles) -> Bool[np.ndarray, "sources"]:
    """Return which sources lie in the faces of reflecting boards, to within a micrometre."""
    inside = np.zeros(len(sources.positions), dtype=bool)
    for index in scene.boards:
        inside |= np.abs(scene.obstacles[index].surface.depth(sources.positions)) < 1e-6
    return inside


def elements_and_boards(solved: BoundaryField) -> Monopoles:
    """Return a field's sources, and monopoles that radiate the sound scattered by its boards."""
    transposed = solved.without_images.transposed
    nodes = np.isin(transposed.surface.nodes.body, solved.scene.boards)
    of_boards = np.concatenate([nodes, nodes[:: _kernels.sharing]])
    emitted = transposed.emitted
    scattering = transposed.scattering
    return Monopoles(
        np.concatenate([emitted.positions, scattering.positions[of_boards]]),
        np.concatenate([emitted.strengths, scattering.strengths[of_boards]]),
    )
