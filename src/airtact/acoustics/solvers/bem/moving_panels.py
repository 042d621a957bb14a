"""Panels of a deforming body. They are meshed once, and the caller supplies the moved corners.

Meshing a body takes as long as filling its matrix. If the body bends smoothly, as a hand does, its
panels remain well shaped.
"""

from dataclasses import dataclass, replace

import numpy as np

from airtact.acoustics.solvers.arrays import (
    Admittances,
    GroupPoints,
    NodeValues,
    PanelLengths,
    Points,
)
from airtact.acoustics.solvers.bem.layer_potentials import NearRule
from airtact.acoustics.solvers.bem.operator import (
    DualSurface,
    assemble,
    direct_right_side,
    transposed_right_side,
)
from airtact.acoustics.solvers.bem.quadrature import place_nodes
from airtact.acoustics.solvers.bem.solutions import DirectSolution, TransposedSolution
from airtact.acoustics.solvers.gmres import gmres
from airtact.acoustics.sources import Monopoles
from airtact.errors import in_short
from airtact.geometry.mesh.arrays import QuadraticTriangles


@dataclass(frozen=True, eq=False)
class MovingPanels:
    """Panels of one body before it moves; ``facing`` returns a part of them.

    Attributes
    ----------
    corners : corners and edge midpoints of the panels [m].
    inside : second collocation points, which are inside the body, two for each panel [m].
    deviation : distance of the panels from the true surface [m].
    admittance : ρc/Z of the panels; 0 for sound-hard panels.
    wavenumber : wavenumber of the sound [rad/m].
    near_rule : integration rule for near panels.
    low_rank_error : error of the matrix's low-rank blocks (see ``assemble``).
    """

    corners: QuadraticTriangles
    inside: GroupPoints
    deviation: PanelLengths
    admittance: Admittances
    wavenumber: complex
    near_rule: NearRule
    low_rank_error: float

    __repr__ = in_short

    def facing(self, points: Points, share: float) -> "MovingPanels":
        """Return the panels that face at least a fraction ``share`` of the points (P, 3) [m].

        The sound that reaches the points from sources in front of the body hardly depends on panels
        that face away from most of the points.
        """
        nodes = self._surface(self.corners, self.inside).nodes
        normals = nodes.panel_normals
        # A panel faces a point that is in front of its plane.
        height = np.einsum("pd,pd->p", normals, nodes.centres)
        seen = np.einsum("pd,qd->pq", normals, points) > height[:, None]
        facing = seen.mean(axis=1) >= share
        return replace(
            self,
            corners=self.corners[facing],
            inside=self.inside[np.repeat(facing, 2)],
            deviation=self.deviation[facing],
            admittance=self.admittance[facing],
        )

    def radiated(
        self,
        corners: QuadraticTriangles,
        inside: GroupPoints,
        sources: Monopoles,
        tolerance: float,
    ) -> TransposedSolution:
        """Solve the transposed boundary integral equation on moved panels.

        The resulting field is accurate only away from the body.

        Parameters
        ----------
        corners : moved corners and edge midpoints of the panels [m].
        inside : moved second collocation points [m].
        sources : monopoles outside the body.
        tolerance : relative residual of the iteration.

        Raises
        ------
        InvalidInput
            If the matrix does not fit into memory.
        NotConverged
            If the iteration does not reach the tolerance.
        """
        surface = self._surface(corners, inside)
        right, factors = transposed_right_side(surface, sources.positions, sources.strengths)
        density = self._solve(surface, right, tolerance, transposed=True)
        return TransposedSolution(sources, surface, density, factors)

    def received(
        self,
        corners: QuadraticTriangles,
        inside: GroupPoints,
        sources: Monopoles,
        tolerance: float,
    ) -> DirectSolution:
        """Solve the direct boundary integral equation on moved panels.

        The resulting field is accurate away from the body and on it.

        The method needs all panels, and the sources must be away from the body. It takes the
        same parameters and raises the same errors as ``radiated``.
        """
        surface = self._surface(corners, inside)
        right = direct_right_side(surface, sources.positions, sources.strengths)
        pressure = self._solve(surface, right, tolerance, transposed=False)
        return DirectSolution(sources, surface, pressure)

    def _surface(self, corners: QuadraticTriangles, inside: GroupPoints) -> DualSurface:
        body = np.zeros(len(corners), dtype=np.int64)
        nodes = place_nodes(corners, body, self.deviation, self.admittance)
        return DualSurface(nodes, inside, self.wavenumber, self.near_rule, "float32")

    def _solve(
        self, surface: DualSurface, right: NodeValues, tolerance: float, transposed: bool
    ) -> NodeValues:
        matrix = assemble(surface, "bfloat16", self.low_rank_error)
        right_sides = np.ascontiguousarray(right.T, dtype=matrix.precision)
        result = gmres(lambda vectors: matrix.times(vectors, transposed), right_sides, tolerance)
        return result.solution.T.astype(np.complex128)
