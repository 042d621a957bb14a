"""Reduced bodies at poses in a scene, how they scatter each other's field, and the field around them."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise, permutations

import numpy as np
from jaxtyping import Bool, Complex, Complex128, Float64, Real

from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.bem.factorised.products import product
from airtact.acoustics.solvers.bem.factorised.reduced_body import ReducedBody
from airtact.acoustics.solvers.bem.layer_potentials import double_layer_transposed
from airtact.acoustics.solvers.loops import loop
from airtact.acoustics.solvers.monopoles import monopole_pressure
from airtact.acoustics.solvers.problem import RadiatedField, SolveReport, SurfaceField, receivers
from airtact.acoustics.sources import Monopoles
from airtact.checks import points_of
from airtact.errors import InvalidInput
from airtact.geometry.pose import Pose
from airtact.printing import in_short


@dataclass(frozen=True, eq=False)
class PlacedBody:
    """A reduced body, and the pose from its own frame to the scene."""

    reduced: ReducedBody
    pose: Pose

    __repr__ = in_short

    @cached_property
    def local(self) -> Pose:
        """From the scene to the body's own frame."""
        return self.pose.inverse()

    @cached_property
    def ball(self) -> tuple[Float64[np.ndarray, "3"], float]:
        """Centre and radius of a ball that holds all nodes [m]."""
        tree = self.reduced.tree
        return self.pose.apply(0.5 * (tree.mins + tree.maxes)), 0.5 * float(
            np.linalg.norm(tree.maxes - tree.mins)
        )

    def clear_of(self, points: Real[np.ndarray, "points 3"], reach: float) -> bool:
        """Whether all points (P, 3) [m] are beyond a reach [m] of all nodes by the distance from the ball alone."""
        centre, radius = self.ball
        off = points - centre
        return bool(np.einsum("pd,pd->p", off, off).min(initial=np.inf) > (radius + reach) ** 2)

    def reaches(self, points: Real[np.ndarray, "points 3"]) -> Bool[np.ndarray, "points"]:
        """Which points (P, 3) [m] are too near for the skeletons."""
        near = self.in_box(points, self.reduced.reach)
        if near.any():
            local, reach = self.local.apply(points[near]), self.reduced.reach
            near[near] = np.isfinite(self.reduced.tree.query(local, distance_upper_bound=reach)[0])
        return near

    def in_box(
        self, points: Real[np.ndarray, "points 3"], beyond: float = 0.0
    ) -> Bool[np.ndarray, "points"]:
        """Which points (P, 3) [m] lie in the box around the body, or within ``beyond`` [m] of it."""
        tree, local = self.reduced.tree, self.local.apply(points)
        return ((local > tree.mins - beyond) & (local < tree.maxes + beyond)).all(axis=1)

    def meets(self, other: "PlacedBody") -> bool:
        """Whether another body is too near for the skeletons."""
        return bool(self.reaches(other.pose.apply(other.reduced.surface.nodes.points)).any())

    def right_side(
        self,
        positions: Real[np.ndarray, "sources 3"],
        strengths: Complex128[np.ndarray, "sources sounds"],
        contact: Bool[np.ndarray, "sources"],
    ) -> Complex128[np.ndarray, "nodes sounds"]:
        """Right-hand side at all nodes for monopoles, some of which touch a surface."""
        surface = self.reduced.surface
        given = strengths, surface.wavenumber, surface.near_rule, surface.precision
        return double_layer_transposed(self.local.apply(positions), surface.nodes, *given, contact)

    def coupling_from(self, other: "PlacedBody") -> Complex[np.ndarray, "rows columns"]:
        """−D(x) + i D(x') at the skeleton of the rows, D the double layer of the other's skeleton of the columns."""
        count, surface = len(self.reduced.rows), self.reduced.surface
        nodes, normals, single = other.reduced.column_nodes
        block = np.empty((count, len(nodes)), dtype=self.reduced.solved.dtype)
        receivers = self.pose.apply(self.reduced.row_points)
        columns = (
            other.pose.apply(nodes),
            other.pose.rotate(normals),
            single,
            complex(surface.wavenumber),
        )
        loop("dual_matrix", surface.precision)(
            receivers[:count], receivers[count:], *columns, block
        )
        return block


@dataclass(frozen=True, eq=False)
class Coupling:
    """How placed bodies scatter each other's field: for each two of them the coupling of the first from the second."""

    placed: tuple[PlacedBody, ...]
    blocks: dict[tuple[int, int], Complex[np.ndarray, "rows columns"]]

    __repr__ = in_short

    @classmethod
    def of(cls, placed: Sequence[PlacedBody]) -> "Coupling | None":
        """Couple each body to each other one; None where two of them are too near each other for their skeletons."""
        if any(
            first.meets(second) for index, first in enumerate(placed) for second in placed[:index]
        ):
            return None
        pairs = permutations(range(len(placed)), 2)
        return cls(
            tuple(placed),
            {(one, other): placed[one].coupling_from(placed[other]) for one, other in pairs},
        )

    def times(
        self, densities: Complex[np.ndarray, "sounds rows"]
    ) -> Complex[np.ndarray, "sounds rows"]:
        """Apply the equation for the densities y on the skeletons of all bodies: y_b + Σ_c S_b K_cbᵀ y_c."""
        out = densities.copy()
        for body, own in enumerate(self.parts):
            others = [other for other in range(len(self.placed)) if other != body]
            coming = [
                product(self.blocks[other, body], densities[:, self.parts[other]], transposed=True)
                for other in others
            ]
            if coming:
                emitted = coming[0] if len(coming) == 1 else np.sum(coming, axis=0)
                out[:, own] += product(self.placed[body].reduced.scattering, emitted)
        return out

    @cached_property
    def parts(self) -> list[slice]:
        """Where the densities of each body stand among those of all."""
        ends = np.cumsum([len(one.reduced.rows) for one in self.placed]).tolist()
        return [slice(begin, end) for begin, end in pairwise([0, *ends])]


@dataclass(frozen=True, eq=False)
class FactorisedField(RadiatedField):
    """The field of some monopoles around factorised bodies, known away from their surfaces only.

    ``densities`` are strengths of the monopoles at all skeletons, which radiate the scattered field
    [Pa·m]; ``factors`` are 1 for sources off the surface, 2 for those on it, which radiate together
    with their image.
    """

    scene: Scene
    sources: Monopoles
    placed: tuple[PlacedBody, ...]
    densities: Complex128[np.ndarray, "rows sounds"]
    factors: Float64[np.ndarray, "sources"]
    report: SolveReport

    __repr__ = RadiatedField.__repr__

    @property
    def on_surface(self) -> SurfaceField:
        """Raise InvalidInput: the pressure on the surfaces does not follow from the reduced scattering."""
        raise InvalidInput(
            f"the pressure on the surface of {len(self.placed)} factorised bodies is not solved for; solve the scene "
            "with BoundaryElement.",
            code="not_supported",
        )

    def valid(self, points: Real[np.ndarray, "points 3"]) -> Bool[np.ndarray, "points"]:
        """Whether points (P, 3) [m] lie outside the bodies and farther from them than the skeletons' reach."""
        points = points_of(points, "points", least=0)
        if all(body.clear_of(points, body.reduced.reach) for body in self.placed):
            return np.ones(len(points), dtype=bool)
        known = ~np.any([body.reaches(points) for body in self.placed], axis=0)
        within = known & np.any([body.in_box(points) for body in self.placed], axis=0)
        known[within] = self.scene.depth(points[within]) < 0
        return known

    def at(self, points: Real[np.ndarray, "points 3"]) -> Complex128[np.ndarray, "points sounds"]:
        """Total pressure [Pa] at points (P, 3) off the sources for each excitation; NaN where ``valid`` is False."""
        free = self.factors[:, None] * self.sources.strengths
        return self._with(receivers(points, self.sources), self.sources.positions, free)

    def scattered_at(
        self, points: Real[np.ndarray, "points 3"]
    ) -> Complex128[np.ndarray, "points sounds"]:
        """Scattered pressure [Pa] at points (P, 3), also at the sources; NaN where ``valid`` is False."""
        image = self.factors > 1
        images = self.sources.positions[image], self.sources.strengths[image]
        return self._with(points_of(points, "points", least=0), *images)

    def _with(
        self,
        points: Float64[np.ndarray, "points 3"],
        positions: Float64[np.ndarray, "sources 3"],
        free: Complex128[np.ndarray, "sources sounds"],
    ) -> Complex128[np.ndarray, "points sounds"]:
        """Pressure of the skeletons together with that of some monopoles in open air."""
        known, given = self.valid(points), points
        wavenumber, precision = self.scene.wavenumber, self.placed[0].reduced.surface.precision
        points = given if known.all() else given[known]
        pressure = monopole_pressure(points, positions, free, wavenumber, "float64")
        pressure += monopole_pressure(points, *self._scattered(points), wavenumber, precision)
        if points is given:
            return pressure
        out = np.full((len(given), pressure.shape[1]), np.nan, dtype=np.complex128)
        out[known] = pressure
        return out

    def _scattered(
        self, points: Float64[np.ndarray, "points 3"]
    ) -> tuple[Float64[np.ndarray, "monopoles 3"], Complex[np.ndarray, "monopoles sounds"]]:
        """Monopoles that radiate to some points: those at the skeletons and their shifted points, or fewer if far."""
        positions, strengths, begin = [], [], 0
        for body in self.placed:
            reduced, far = body.reduced, body.reduced.far
            own = self.densities[begin : begin + len(reduced.rows)]
            if body.clear_of(points, far.reach):
                positions.append(far.positions)
                strengths.append(product(far.combinations, own.T).T)
            else:
                positions.append(reduced.row_points)
                strengths += [own, -1j * own]
            positions[-1] = body.pose.apply(positions[-1])
            begin += len(own)
        return np.concatenate(positions), np.concatenate(strengths)
