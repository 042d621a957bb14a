"""Bodies of which the scattering is kept, put somewhere, and how they hear each other and are heard."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import permutations

import numpy as np
from jaxtyping import Bool, Complex, Complex128, Float64, Real

from airtact import _kernels
from airtact.conventions import InvalidInput
from airtact.pose import Pose
from airtact.printing import in_short
from airtact.scene.scene import Scene
from airtact.scene.sources import Monopoles
from airtact.solvers.bem.layer_potentials import double_layer_transposed
from airtact.solvers.bem.reduced_body import ReducedBody
from airtact.solvers.monopoles import monopole_pressure
from airtact.solvers.problem import RadiatedField, SolveReport, SurfaceField, receivers
from airtact.validation import points_of


@dataclass(frozen=True, eq=False)
class PlacedBody:
    """A part somewhere.

    Attributes
    ----------
    part : in its own frame.
    pose : from there to the scene.
    """

    part: ReducedBody
    pose: Pose

    __repr__ = in_short

    @cached_property
    def local(self) -> Pose:
        """From the scene to the part's own frame."""
        return self.pose.inverse()

    @cached_property
    def ball(self) -> tuple[Float64[np.ndarray, "3"], float]:
        """Centre and radius of a ball that holds all nodes [m]."""
        tree = self.part.tree
        return self.pose.apply(0.5 * (tree.mins + tree.maxes)), 0.5 * float(np.linalg.norm(tree.maxes - tree.mins))

    def clear_of(self, points: Real[np.ndarray, "points 3"]) -> bool:
        """Whether all points (P, 3) [m] are so far off that nothing more need be asked."""
        centre, radius = self.ball
        off = points - centre
        return bool(np.einsum("pd,pd->p", off, off).min(initial=np.inf) > (radius + self.part.reach) ** 2)

    def reaches(self, points: Real[np.ndarray, "points 3"]) -> Bool[np.ndarray, "points"]:
        """Which points (P, 3) [m] are too near to be heard from the skeleton."""
        near = self.boxes(points, self.part.reach)
        if near.any():
            distance, _ = self.part.tree.query(self.local.apply(points[near]), distance_upper_bound=self.part.reach)
            near[near] = np.isfinite(distance)
        return near

    def boxes(self, points: Real[np.ndarray, "points 3"], beyond: float = 0.0) -> Bool[np.ndarray, "points"]:
        """Which points (P, 3) [m] lie in the box round the part, or ``beyond`` [m] of it."""
        tree, local = self.part.tree, self.local.apply(points)
        return ((local > tree.mins - beyond) & (local < tree.maxes + beyond)).all(axis=1)

    def meets(self, other: "PlacedBody") -> bool:
        """Whether another body stands too near."""
        return bool(self.reaches(other.pose.apply(other.part.surface.nodes.points)).any())

    def alone(
        self,
        positions: Real[np.ndarray, "sources 3"],
        spoken: Complex128[np.ndarray, "sources sounds"],
        contact: Bool[np.ndarray, "sources"],
    ) -> Complex[np.ndarray, "hearing sounds"]:
        """Strengths of the hearing skeleton for monopoles, some of which touch a skin, were no other body there."""
        part, surface = self.part, self.part.surface
        local, rule = self.local.apply(positions), surface.near_rule
        heard = double_layer_transposed(
            local, surface.nodes, spoken, surface.wavenumber, rule, surface.precision, contact
        )
        return part.solved @ heard.astype(part.solved.dtype)

    def hears(self, other: "PlacedBody") -> Complex[np.ndarray, "hearing speaking"]:
        """−D(x) + i D(x') at the hearing skeleton, D the double layer of the other's speaking skeleton."""
        count, surface = len(self.part.hears), self.part.surface
        places, normals = other.part.speaking
        kind = self.part.solved.dtype
        rows = np.empty((2 * count, len(places)), dtype=kind)
        fill = getattr(_kernels, f"double_layer_matrix_{surface.precision}")
        listening = self.pose.apply(self.part.hearing)
        fill(listening, other.pose.apply(places), other.pose.rotate(normals), complex(surface.wavenumber), rows)
        heard = rows[count:]
        heard *= 1j
        heard -= rows[:count]
        return heard


@dataclass(frozen=True, eq=False)
class Coupling:
    """How bodies scatter each other's sound.

    Attributes
    ----------
    placed : the bodies.
    heard : for each two of them what the first hears of the second's skin, (R, Q).
    """

    placed: tuple[PlacedBody, ...]
    heard: dict[tuple[int, int], Complex[np.ndarray, "hearing speaking"]]

    __repr__ = in_short

    @classmethod
    def of(cls, placed: Sequence[PlacedBody]) -> "Coupling":
        """Let each body hear each other one."""
        pairs = permutations(range(len(placed)), 2)
        return cls(tuple(placed), {(one, other): placed[one].hears(placed[other]) for one, other in pairs})

    def times(self, strengths: Complex[np.ndarray, "sounds hearing"]) -> Complex[np.ndarray, "sounds hearing"]:
        """Apply the equation for the strengths y of all hearing skeletons: y_b + Σ_c S_b K_cbᵀ y_c."""
        parts = np.split(strengths, np.cumsum([len(one.part.hears) for one in self.placed])[:-1], axis=1)
        out = []
        for body, own in enumerate(self.placed):
            spoken = [part @ self.heard[other, body] for other, part in enumerate(parts) if other != body]
            out.append(parts[body] + sum(spoken) @ own.part.scatters.T if spoken else parts[body])
        return np.concatenate(out, axis=1)


@dataclass(frozen=True, eq=False)
class PartsField(RadiatedField):
    """The field of some monopoles around bodies whose scattering is kept: heard away from the skins only.

    Attributes
    ----------
    scene, sources : what was solved.
    placed : the bodies.
    strengths : (R, S) monopoles at the hearing skeletons of all bodies that stand for their scattering [Pa·m].
    factors : (N,) 1 for sources off the skin, 2 for those on it, which speak with their image.
    report : how it was made.
    """

    scene: Scene
    sources: Monopoles
    placed: tuple[PlacedBody, ...]
    strengths: Complex128[np.ndarray, "hearing sounds"]
    factors: Float64[np.ndarray, "sources"]
    report: SolveReport

    __repr__ = in_short

    @property
    def on_surface(self) -> SurfaceField:
        """Not known from kept scattering."""
        raise InvalidInput(
            f"the pressure on the skin of {len(self.placed)} factorised bodies is not solved for; solve the scene with "
            "BoundaryElement."
        )

    def valid(self, points: Real[np.ndarray, "points 3"]) -> Bool[np.ndarray, "points"]:
        """Whether points (P, 3) [m] lie outside the bodies and farther from them than the kept scattering's reach."""
        points = points_of(points, "points", least=0)
        if all(body.clear_of(points) for body in self.placed):
            return np.ones(len(points), dtype=bool)
        known = ~np.any([body.reaches(points) for body in self.placed], axis=0)
        within = known & np.any([body.boxes(points) for body in self.placed], axis=0)
        known[within] = self.scene.depth(points[within]) < 0
        return known

    def at(self, points: Real[np.ndarray, "points 3"]) -> Complex128[np.ndarray, "points sounds"]:
        """Total pressure [Pa] at points (P, 3) for each of the S sounds; NaN in the bodies and nearer than the reach.

        Raises
        ------
        InvalidInput
            A point is NaN or infinite, or stands on a source.
        """
        points = receivers(points, self.sources)
        out = np.full((len(points), self.strengths.shape[1]), np.nan, dtype=np.complex128)
        known = self.valid(points)
        wavenumber, precision = self.scene.wavenumber, self.placed[0].part.surface.precision
        free = self.factors[:, None] * self.sources.strengths
        out[known] = monopole_pressure(points[known], self.sources.positions, free, wavenumber, "float64")
        out[known] += monopole_pressure(points[known], *self._scattered, wavenumber, precision)
        return out

    def scattered_at(self, points: Real[np.ndarray, "points 3"]) -> Complex128[np.ndarray, "points sounds"]:
        """Scattered pressure [Pa] at points (P, 3), also at the sources; NaN where ``valid`` is False."""
        points = points_of(points, "points", least=0)
        out = np.full((len(points), self.strengths.shape[1]), np.nan, dtype=np.complex128)
        known, image = self.valid(points), self.factors > 1
        wavenumber, precision = self.scene.wavenumber, self.placed[0].part.surface.precision
        out[known] = monopole_pressure(points[known], *self._scattered, wavenumber, precision)
        images = self.sources.positions[image], self.sources.strengths[image]
        out[known] += monopole_pressure(points[known], *images, wavenumber, "float64")
        return out

    @property
    def _scattered(self) -> tuple[Float64[np.ndarray, "places 3"], Complex128[np.ndarray, "places sounds"]]:
        """Monopoles at the skeletons and at the points inside that belong to them."""
        places, strengths, begin = [], [], 0
        for body in self.placed:
            own = self.strengths[begin : begin + len(body.part.hears)]
            places.append(body.pose.apply(body.part.hearing))
            strengths += [own, -1j * own]
            begin += len(own)
        return np.concatenate(places), np.concatenate(strengths)
