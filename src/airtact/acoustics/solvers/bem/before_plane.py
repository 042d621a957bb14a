"""Fields of bodies that move in front of a rigid plane, from one discretisation of the bodies.

Let v be the field radiated by the sources and bodies themselves, without that of their images in
the plane. The pressure at x is v(x) + v(x*), where x* is the image of x. The largest part of v
is the field in open air (without the plane), which does not depend on the plane. Only the rest,
which is scattered from the images of the sources and the bodies, is solved for each position of
the plane. With the transposed matrix A of the bodies and B of their images, its density of
monopoles w satisfies

    (A + B) w = b − B s,

where s is the density in open air and b the right-hand side of the images of the sources. A and the
panels remain the same.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from airtact import _kernels
from airtact.acoustics.scene import Scene, check_sources
from airtact.acoustics.solvers.arrays import NodeValues
from airtact.acoustics.solvers.bem.block_matrix import BlockMatrix
from airtact.acoustics.solvers.bem.operator import DualSurface, assemble, transposed_right_side
from airtact.acoustics.solvers.bem.solutions import TransposedSolution
from airtact.acoustics.solvers.bem.solver import (
    LOW_RANK_ERROR,
    BoundaryElement,
    _in_block_order,
    _place_nodes,
)
from airtact.acoustics.sources import Monopoles
from airtact.errors import in_short


@dataclass(frozen=True, eq=False)
class BodiesBeforePlane:
    """A fixed arrangement of bodies and sources in front of a moving plane.

    The sound that the plane reflects onto the bodies is weaker than the sound of the sources, so
    twice the relative error is allowed for it.

    Attributes
    ----------
    solver : solver for the reflected sound.
    sources : the monopoles that emit the sound.
    surface, matrix, density : panels of the bodies, their matrix, and the solution in open air.
    factors : factor by which each source's strength is multiplied: 2 on a body and 1 elsewhere.
    """

    solver: BoundaryElement
    sources: Monopoles
    surface: DualSurface
    matrix: BlockMatrix
    density: NodeValues
    factors: Float64[np.ndarray, "sources"]

    __repr__ = in_short

    @classmethod
    def of(cls, solver: BoundaryElement, scene: Scene, sources: Monopoles) -> "BodiesBeforePlane":
        """Solve the bodies without the plane, with smaller panels where a body faces its image."""
        accuracy = min(2.0 * solver.accuracy, 0.3)
        solver = replace(solver, accuracy=accuracy, precision="float32", estimate=False)
        panels = _in_block_order(solver._panels(scene, sources.refined_positions))
        surface = solver._surface(_place_nodes(panels, scene), scene, scene.obstacles)
        matrix = assemble(surface, "bfloat16", LOW_RANK_ERROR * accuracy)
        right, factors = transposed_right_side(surface, sources.positions, sources.strengths)
        solved = solver._iterate(scene, [matrix], right, True, solver._tolerance(scene))
        return cls(solver, sources, surface, matrix, solved.solution.T, factors)

    def reflected(self, scene: Scene) -> Monopoles:
        """Return monopoles that radiate the additional field caused by the plane of a scene.

        Monopoles with neighbouring indices are close together.

        Raises
        ------
        InvalidInput
            If a source is behind the plane.
        """
        check_sources(scene, self.sources, planes=True)
        (plane,) = scene.planes
        image = assemble(self.surface, "bfloat16", LOW_RANK_ERROR * self.solver.accuracy, plane)
        right, _ = transposed_right_side(
            self.surface,
            plane.image(self.sources.positions),
            self.factors[:, None] * self.sources.strengths,
        )
        right -= image.times(self.density.T, transposed=True).T
        # This is looser than the tolerance of a whole solve, because w is the smaller part of v.
        tolerance = 3.0 * self.solver.accuracy
        matrices = [self.matrix, image]
        solved = self.solver._iterate(scene, matrices, right, True, tolerance)
        monopoles = TransposedSolution(
            self.sources, self.surface, solved.solution.T, self.factors
        ).scattering
        # Put each second collocation point after the nodes that share it.
        nodes = np.arange(len(self.surface.nodes.points)).reshape(-1, _kernels.sharing)
        order = np.column_stack([nodes, nodes.size + np.arange(len(nodes))]).ravel()
        return Monopoles(monopoles.positions[order], monopoles.strengths[order])
