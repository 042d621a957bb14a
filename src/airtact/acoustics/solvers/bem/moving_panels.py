"""Panels that are meshed once for bodies that deform, or that move in front of a rigid plane.

Meshing a body takes as long as filling its matrix. If the body bends smoothly, as a hand does, its
panels remain well shaped, and the caller supplies the moved corners.

For a plane, let v be the field radiated by the sources and bodies themselves, without that of their
images in the plane. The pressure at x is v(x) + v(x*), where x* is the image of x. The largest part
of v is the field in open air (without the plane), which does not depend on the plane. Only the
rest, which is scattered from the images of the sources and the bodies, is solved for each position
of the plane. With the transposed matrix A of the bodies and B of their images, its density of
monopoles w satisfies

    (A + B) w = b − B s,

where s is the density in open air and b the right-hand side of the images of the sources. A and the
panels remain the same. For planes in similar positions, the solutions hardly differ from
combinations of a few of them, so most need no iteration (``EarlierSolutions``).
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Complex64, Float64

from airtact import _kernels
from airtact.acoustics.scene import Scene, check_sources
from airtact.acoustics.solvers.bem.block_matrix import BlockMatrix
from airtact.acoustics.solvers.bem.layer_potentials import NearRule
from airtact.acoustics.solvers.bem.quadrature import place_nodes
from airtact.acoustics.solvers.bem.solutions import (
    DirectSolution,
    DualSurface,
    TransposedSolution,
    assemble,
    direct_right_side,
    transposed_right_side,
)
from airtact.acoustics.solvers.bem.solver import (
    LOW_RANK_ERROR,
    BoundaryElement,
)
from airtact.acoustics.solvers.shared import (
    Admittances,
    GroupPoints,
    NodeValues,
    PanelLengths,
    Points,
    gmres,
)
from airtact.acoustics.sources import Monopoles
from airtact.errors import in_short
from airtact.geometry.mesh.triangles import QuadraticTriangles

SideRows = Complex64[np.ndarray, "sides nodes"]


@dataclass(frozen=True, eq=False)
class MovingPanels:
    """T boundary element panels of one body, which can be moved before each solve.

    ``BoundaryElement.moving_panels`` creates them; the live loop uses them for a bending hand.
    ``radiated`` and ``received`` solve for moved positions of the panels, which they take as arrays
    shaped like ``corners`` and ``inside``; they do not change the object. The attributes describe
    the panels before any motion, in the frame of the scene.

    Attributes
    ----------
    corners : (T, 6, 3) corners (the first three) and edge midpoints of each panel [m].
    inside : (2 T, 3) second collocation points of the dual-surface equation [m]. Points 2 t and
        2 t + 1 lie inside the body, near panel t.
    deviation : (T,) largest distance of each panel from the true surface [m].
    admittance : (T,) complex ρc/Z of each panel, with surface impedance Z; 0 if it is sound-hard.
    wavenumber : complex wavenumber of the sound [1/m]; its imaginary part is the absorption.
    near_rule : integration rule for panels near a point.
    low_rank_error : allowed error of the matrix's low-rank blocks relative to its identity term
        (see ``assemble``).
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
        return self.chosen(seen.mean(axis=1) >= share)

    def chosen(self, mask: Bool[np.ndarray, "panels"]) -> "MovingPanels":
        """Return the panels that a mask selects."""
        return replace(
            self,
            corners=self.corners[mask],
            inside=self.inside[np.repeat(mask, 2)],  # two second collocation points per panel
            deviation=self.deviation[mask],
            admittance=self.admittance[mask],
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
        tolerance : relative residual at which the iteration stops.

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

        The panels must cover the whole body, and the sources must be away from it. The parameters
        of this method are those of ``radiated``. It raises ``InvalidInput`` if the matrix does not
        fit into memory, and ``NotConverged`` if the iteration does not reach the tolerance.
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
        # At loose tolerances and for few panels, a preconditioner takes longer than it saves.
        result = gmres(lambda vectors: matrix.times(vectors, transposed), right_sides, tolerance)
        return result.solution.T.astype(np.complex128)


@dataclass(eq=False)
class EarlierSolutions:
    """The span of solutions x of A x = b for earlier vectors b.

    Attributes
    ----------
    vectors : combinations of the earlier solutions, as rows.
    products : their products with A, as orthonormal rows.
    """

    vectors: Complex64[np.ndarray, "solutions nodes"]
    products: Complex64[np.ndarray, "solutions nodes"]

    def nearest(self, right: Complex64[np.ndarray, "sides nodes"]) -> tuple[SideRows, SideRows]:
        """Return the combination x with the smallest residual b − A x, and this residual."""
        weights = (self.products @ right.conj().T).conj().T  # conjugates the smaller matrix
        return weights @ self.vectors, right - weights @ self.products

    def add(
        self,
        vectors: Complex64[np.ndarray, "added nodes"],
        products: Complex64[np.ndarray, "added nodes"],
    ) -> None:
        """Add solutions and their products with A, unless they depend linearly on earlier ones."""
        if len(self.vectors) > 500:  # more would take much memory and save few iterations
            return
        size = np.linalg.norm(products, axis=1).max()
        for _ in range(2):  # once leaves too large an error in single precision
            weights = (self.products @ products.conj().T).conj().T
            vectors = vectors - weights @ self.vectors
            products = products - weights @ self.products
        turn, lengths, unitary = np.linalg.svd(products, full_matrices=False)
        chosen = lengths > 0.01 * size
        vectors = (turn[:, chosen] / lengths[chosen]).conj().T @ vectors
        self.vectors = np.concatenate([self.vectors, vectors])
        self.products = np.concatenate([self.products, unitary[chosen]])


@dataclass(frozen=True, eq=False)
class BodiesBeforePlane:
    """A fixed arrangement of bodies and sources in front of a moving plane.

    The sound that the plane reflects onto the bodies is weaker than the sound of the sources, so
    twice the relative error is allowed for its scattering.

    Attributes
    ----------
    solver : solver for the reflected sound.
    sources : the monopoles that emit the sound.
    surface, matrix, density : panels of the bodies, their matrix, and the solution without the
        plane.
    factors : factor by which each source's strength is multiplied: 2 on a body and 1 elsewhere.
    earlier : solutions for earlier positions of the plane.
    """

    solver: BoundaryElement
    sources: Monopoles
    surface: DualSurface
    matrix: BlockMatrix
    density: NodeValues
    factors: Float64[np.ndarray, "sources"]
    earlier: EarlierSolutions

    @classmethod
    def of(cls, solver: BoundaryElement, scene: Scene, sources: Monopoles) -> "BodiesBeforePlane":
        """Solve the scene without its plane, with smaller panels where a body faces its image."""
        accuracy = min(2.0 * solver.accuracy, 0.3)
        solver = replace(solver, accuracy=accuracy, precision="float32", estimate=False)
        _, surface = solver._discretised(scene, sources.refined_positions)
        matrix = assemble(surface, "bfloat16", LOW_RANK_ERROR * accuracy)
        right, factors = transposed_right_side(surface, sources.positions, sources.strengths)
        solved = solver._iterate(scene, [matrix], right, True, solver._tolerance(scene))
        nothing = np.empty((0, matrix.count), dtype=np.complex64)
        return cls(
            solver=solver,
            sources=sources,
            surface=surface,
            matrix=matrix,
            density=solved.solution.T,
            factors=factors,
            earlier=EarlierSolutions(nothing, nothing),
        )

    def reflected(self, scene: Scene) -> Monopoles:
        """Return monopoles that radiate the additional field caused by the plane of a scene.

        The monopoles are ordered so that those with neighbouring indices are close together.

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
        # The right-hand side is scaled because squares would leave the range of single precision.
        size = np.abs(right).max(axis=0, initial=0.0)
        size[size == 0.0] = 1.0
        rest = (right / size).T.astype(np.complex64)
        norms = np.maximum(np.linalg.norm(rest, axis=1), 1e-30)
        solution = np.zeros_like(rest)
        # This is looser than the tolerance of a whole solve, because w is the smaller part of v.
        tolerance = 4.0 * self.solver.accuracy
        share = 1.0
        # Each step adds the sound that goes from the bodies to the plane and back once more.
        while share > tolerance:
            step, left = self.earlier.nearest(rest)
            left -= image.times(step, transposed=True)
            shrunk = float((np.linalg.norm(left, axis=1) / norms).max())
            if shrunk > max(0.75 * share, tolerance):
                break
            share = shrunk
            rest = left
            solution += step
        if share <= tolerance:
            # This approximate solution for the rest needs no product with the matrix.
            correction = self.matrix.preconditioned(rest, transposed=True)
        else:
            pairs: list[tuple[SideRows, SideRows]] = []

            def product(vectors: SideRows) -> SideRows:
                step = self.matrix.preconditioned(vectors, transposed=True)
                of_bodies = self.matrix.times(step, transposed=True)
                pairs.append((vectors, of_bodies))
                return of_bodies + image.times(step, transposed=True)

            # Solving more accurately makes better combinations for the following planes.
            closer = 0.7 * tolerance / share
            solved = gmres(product, rest, closer, error=0.5 * self.solver.accuracy).solution
            correction = self.matrix.preconditioned(solved, transposed=True)
            # The vectors of GMRES are orthonormal, so their weights are inner products.
            products = [
                np.einsum("sn,sn->s", vectors.conj(), solved)[:, None] * of_bodies
                for vectors, of_bodies in pairs
            ]
            self.earlier.add(correction, np.sum(products, axis=0))
        solution += correction
        monopoles = TransposedSolution(
            self.sources, self.surface, solution.T * size, self.factors
        ).scattering
        # Put each second collocation point after the nodes that share it.
        nodes = np.arange(len(self.surface.nodes.points)).reshape(-1, _kernels.sharing)
        order = np.column_stack([nodes, nodes.size + np.arange(len(nodes))]).ravel()
        return Monopoles(monopoles.positions[order], monopoles.strengths[order])
