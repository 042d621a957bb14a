"""Panels of a body that bends: they are made once and moved by who uses them, who also says where its inside is.

Covering a body with panels takes as long as filling its matrix. A body that bends smoothly, as a
hand does, can keep its panels.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128, Float64, Real

from airtact.acoustics.solvers.bem.layer_potentials import NearRule
from airtact.acoustics.solvers.bem.operator import (
    DualSurface,
    assemble,
    direct_right_side,
    release,
    transposed_right_side,
)
from airtact.acoustics.solvers.bem.quadrature import Nodes, place_nodes
from airtact.acoustics.solvers.bem.solutions import DirectSolution, TransposedSolution
from airtact.acoustics.solvers.gmres import gmres
from airtact.acoustics.sources import Monopoles
from airtact.geometry.mesh.quadratic_triangles import QuadraticTriangles
from airtact.printing import in_short


@dataclass(frozen=True, eq=False)
class MovingPanels:
    """Panels of a body, some of which may have been left out.

    Attributes
    ----------
    corners : (P, 6, 3) corners and middles of edges of the panels, as they were made [m].
    inside : (2 P, 3) second collocation points, in the body, as they were made; two for each panel
        [m].
    deviation : (P,) of the panels from the true surface [m].
    admittance : (P,) ρc/Z of the panels, 0 for sound-hard ones.
    wavenumber : of the sound [rad/m].
    near_rule : how near panels are integrated.
    low_rank_error : of the matrix.
    """

    corners: QuadraticTriangles
    inside: Float64[np.ndarray, "groups 3"]
    deviation: Float64[np.ndarray, "panels"]
    admittance: Complex128[np.ndarray, "panels"]
    wavenumber: complex
    near_rule: NearRule
    low_rank_error: float

    __repr__ = in_short

    def facing(self, points: Real[np.ndarray, "points 3"], share: float) -> "MovingPanels":
        """Keep the panels that face at least a share of some points (P, 3) [m].

        What sources before the body send to such points hardly depends on panels that face away
        from most of them.
        """
        nodes = self._placed(self.corners)
        normals = nodes.normals.reshape(-1, 6, 3).mean(axis=1)
        seen = (
            np.einsum("pd,qd->pq", normals, points)
            > np.einsum("pd,pd->p", normals, nodes.centres)[:, None]
        )
        kept = seen.mean(axis=1) >= share
        groups = np.repeat(kept, len(self.inside) // len(kept))
        parts = self.corners[kept], self.inside[groups], self.deviation[kept], self.admittance[kept]
        return MovingPanels(*parts, self.wavenumber, self.near_rule, self.low_rank_error)

    def _placed(self, corners: QuadraticTriangles) -> Nodes:
        return place_nodes(
            corners, np.zeros(len(corners), dtype=np.int64), self.deviation, self.admittance
        )

    def radiated(
        self,
        corners: QuadraticTriangles,
        inside: Float64[np.ndarray, "groups 3"],
        sources: Monopoles,
        tolerance: float,
    ) -> TransposedSolution:
        """Solve the transposed equation for the panels where they are now: right away from the body only.

        Parameters
        ----------
        corners : (P, 6, 3) of the panels now [m].
        inside : (2 P, 3) second collocation points now [m].
        sources : monopoles outside the body.
        tolerance : relative residual of the iteration.

        Raises
        ------
        InvalidInput
            If the matrix does not fit into memory.
        NotConverged
            The iteration did not settle.
        """
        surface = self._bent(corners, inside)
        right, factors = transposed_right_side(surface, sources.positions, sources.strengths)
        density = self._found(surface, right, tolerance, transposed=True)
        return TransposedSolution(sources, surface, density, factors)

    def received(
        self,
        corners: QuadraticTriangles,
        inside: Float64[np.ndarray, "groups 3"],
        sources: Monopoles,
        tolerance: float,
    ) -> DirectSolution:
        """Solve the direct equation for the panels where they are now, all of which are needed: right on the body, too.

        Parameters and errors are those of ``radiated``; the sources are away from the body.
        """
        surface = self._bent(corners, inside)
        right = direct_right_side(surface, sources.positions, sources.strengths)
        return DirectSolution(
            sources, surface, self._found(surface, right, tolerance, transposed=False)
        )

    def _bent(
        self, corners: QuadraticTriangles, inside: Float64[np.ndarray, "groups 3"]
    ) -> DualSurface:
        return DualSurface(
            self._placed(corners), inside, self.wavenumber, self.near_rule, "float32"
        )

    def _found(
        self,
        surface: DualSurface,
        right: Complex128[np.ndarray, "nodes sounds"],
        tolerance: float,
        transposed: bool,
    ) -> Complex128[np.ndarray, "nodes sounds"]:
        matrix = assemble(surface, "bfloat16", self.low_rank_error)
        sides = np.ascontiguousarray(right.T, dtype=matrix.precision)
        found = gmres(lambda vectors: matrix.times(vectors, transposed), sides, tolerance)
        release(matrix)
        return found.solution.T.astype(np.complex128)
