"""Solutions for a whole hand on panels that bend with it, adapted to the current pose.

Solving for a whole hand takes about 0.1 s. Its factors (see ``factors``) are
outdated after 20 ms, because the phase of the sound scattered by a neighbouring
finger changes with every millimetre. The strengths of the sources on the skin,
relative to the direct sound of the beacon, hardly change: they are smooth functions
of the position on each bone. The sources are therefore moved with their bones,
their phases are updated for the new paths from the focus, and their field is
recomputed. The panels that radiate most are solved again, and only the rest of
the solution is moved. This takes 20 ms and corrects most of the error of a
solution that is 0.1 s old. Until the next update, the sources of each bone are combined, and their
common phase follows the path through their centre.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Complex64, Complex128, Float64, Int64
from scipy.interpolate import RBFInterpolator
from scipy.sparse import csr_array
from scipy.spatial.distance import cdist

from airtact import _kernels
from airtact.acoustics.scene import Scene, sound_hard
from airtact.acoustics.solvers.bem.layer_potentials import NearRule
from airtact.acoustics.solvers.bem.solutions import DirectSolution, TransposedSolution
from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.acoustics.solvers.shared import monopole_pressure
from airtact.acoustics.sources import Monopoles
from airtact.acoustics.target import Target
from airtact.errors import in_short
from airtact.geometry.mesh.triangles import QuadraticTriangles
from airtact.hands.body import FREE, OWNER, PARTS
from airtact.hands.hand import Hand
from airtact.hands.joints import CHAINS, Points, cross
from airtact.hands.kinematics import finger_bones
from airtact.hands.shape import hull_weights
from airtact.live.drives.factors import ACCURACY, Factors, HandFactors, part_of
from airtact.live.drives.moving import phasors
from airtact.live.scene import Joints, LiveScene, PosedHand, gap_change, pose_hand

# Share of the elements that a panel must face. Omitting all other panels halves the number of
# unknowns and reduces the pressure by 1 %.
MIN_SEEN = 0.5

# Weight of each bone in the motion of each point.
Weights = Float64[np.ndarray, "points hulls"]


@dataclass(frozen=True, eq=False)
class Bones:
    """Axes (H, 3, 3), one per row, and starting points (H, 3) [m] of the H bones in ``PARTS``."""

    axes: Float64[np.ndarray, "hulls 3 3"]
    starts: Float64[np.ndarray, "hulls 3"]

    def motions_to(
        self, now: "Bones"
    ) -> tuple[Float64[np.ndarray, "hulls 3 3"], Float64[np.ndarray, "hulls 3"]]:
        """Return the rotations and translations [m] that move all bones to a new pose.

        A point x of a bone moves to x @ rotation + translation.
        """
        turns = np.einsum("hij,hik->hjk", self.axes, now.axes)
        return turns, now.starts - np.einsum("hj,hjk->hk", self.starts, turns)


def bones_of(hand: Hand) -> Bones:
    """Return the bones of a hand, with axes defined by its joints and the hinges of its fingers."""
    joints = hand.joints
    palm = joints[[5, 6, 10, 11, 15, 16, 20, 21]].mean(axis=0)
    normal = cross(joints[11] - joints[0], joints[6] - joints[21])
    _, _, hinges = finger_bones(joints, hand.side)
    root, knuckle = joints[list(CHAINS[2][:2])]
    # The phalanges are followed by the thumb's metacarpal, which turns about the thumb's hinge.
    starts, ends = joints[PARTS[: FREE + 1, :2].T]
    along = np.vstack([ends - starts, knuckle - root])
    across = np.vstack([hinges[[*OWNER, 0], 2], cross(knuckle - root, normal)])
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across -= along * np.sum(along * across, axis=1, keepdims=True)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    axes = np.stack([along, across, np.cross(along, across)], axis=1)
    # All other parts belong to the palm and move with it.
    of_palm = len(PARTS) - len(starts)
    return Bones(
        np.vstack([axes[:-1], np.tile(axes[-1], (of_palm, 1, 1))]),
        np.vstack([starts, np.tile(palm, (of_palm, 1))]),
    )


def moved_by_bones(points: Points, weights: Weights, before: Bones, now: Bones) -> Points:
    """Move points (P, 3) with the bones of a hand from one pose to another."""
    turns, shifts = before.motions_to(now)
    # One product for rotations and translations: (P, H) @ (H, 12).
    motions = weights @ np.concatenate([turns.reshape(-1, 9), shifts], axis=1)
    return np.einsum("pj,pjk->pk", points, motions[:, :9].reshape(-1, 3, 3)) + motions[:, 9:]


@dataclass(frozen=True, eq=False)
class ElementSubset:
    """Elements spread evenly over an array, from which values at all elements are interpolated.

    Attributes
    ----------
    chosen : (S,) indices of the chosen elements.
    weights : (E, S) weights that interpolate values from the chosen elements to all elements with
        linear radial basis functions.
    """

    chosen: Int64[np.ndarray, "chosen"]
    weights: csr_array

    @classmethod
    def of(cls, positions: Points, count: int) -> "ElementSubset":
        """Choose ``count`` elements, far apart from each other, among those at positions (E, 3)."""
        chosen = [0]
        away = np.linalg.norm(positions - positions[0], axis=1)
        while len(chosen) < count:
            chosen.append(int(away.argmax()))
            away = np.minimum(away, np.linalg.norm(positions - positions[chosen[-1]], axis=1))
        # Each value is interpolated from the 8 nearest chosen elements.
        interpolate = RBFInterpolator(
            positions[chosen], np.eye(count), min(8, count), kernel="linear", degree=0
        )
        weights = interpolate(positions)
        weights[np.abs(weights) < 1e-6] = 0.0
        return cls(np.array(chosen), csr_array(weights.astype(np.float32)))

    def interpolated(
        self, values: Complex64[np.ndarray, "*any chosen"]
    ) -> Complex64[np.ndarray, "*any elements"]:
        """Return the values at all elements, interpolated from those at the chosen elements."""
        everywhere = self.weights @ values.reshape(-1, len(self.chosen)).T
        return np.ascontiguousarray(everywhere.T).reshape(*values.shape[:-1], -1)


@dataclass(frozen=True, eq=False)
class SkinSources:
    """Sources on the skin that represent a solution for beacons (virtual sources) at a hand's foci.

    Attributes
    ----------
    time : time of the predicted pose, on the tracker's clock [s].
    posed, bones : the hand in the predicted pose, and its bones.
    points : (N, 3) positions of the sources [m].
    apart : (N, F) distances of the sources from the foci [m].
    weights : (N, H) weight of each bone in the motion of each source.
    parts, begin : the bones that have sources, and the index of the first source of each. The
        sources are sorted by bone.
    straight : (F,) strengths of the beacons: 1, or 2 for a beacon on the skin.
    leading : panels that are solved again in other poses.
    of_leading : indices of the sources on these panels.
    rest : (N, F) strength of each source in the solution for each focus [Pa·m], minus that in a
        solution for the ``leading`` panels alone.
    """

    time: float
    posed: PosedHand
    bones: Bones
    points: Points
    apart: Float64[np.ndarray, "points foci"]
    weights: Weights
    parts: Int64[np.ndarray, "parts"]
    begin: Int64[np.ndarray, "parts"]
    straight: Float64[np.ndarray, "foci"]
    leading: "LeadingPanels"
    of_leading: Int64[np.ndarray, "leading"]
    rest: Complex128[np.ndarray, "points foci"]

    def carried(
        self, scene: LiveScene, posed: PosedHand, time: float, subset: ElementSubset
    ) -> "CarriedFactors":
        """Move the sources to another pose at a given time [s], and return the resulting factors.

        The sound scattered by each bone is evaluated only at a subset of the elements.
        """
        wavenumber = scene.wavenumber
        bones = bones_of(posed.hand)
        points = moved_by_bones(self.points, self.weights, self.bones, bones)
        array = scene.with_images.array
        elements = array.positions[subset.chosen]
        detour = cdist(points, posed.foci) - self.apart
        # The strength contains the phase of the path from the focus to the source, and the wave
        # contains that of the path from the source to the element.
        strengths = self.rest * phasors(wavenumber.real * detour)
        strengths[self.of_leading] += self.leading.strengths(posed)
        beacons = np.eye(len(posed.foci), dtype=np.complex128)
        straight = monopole_pressure(elements, posed.foci, beacons, wavenumber, "float32")
        waves = np.zeros((len(PARTS), *straight.T.shape), dtype=np.complex64)
        centres = np.zeros((len(PARTS), len(posed.foci), 3))
        power = np.real(strengths) ** 2 + np.imag(strengths) ** 2
        ends = [*self.begin[1:], len(points)]
        for part, first, last in zip(self.parts, self.begin, ends, strict=True):
            of_bone = slice(first, last)
            centres[part] = power[of_bone].T @ points[of_bone]
            centres[part] /= power[of_bone].sum(axis=0)[:, None]
            scattered = monopole_pressure(
                elements, points[of_bone], strengths[of_bone], wavenumber, "float32"
            )
            waves[part] = (scattered / straight).T
        # Without the phase of the path through the centre, the waves vary slowly over the array.
        begun = np.linalg.norm(centres - posed.foci, axis=2)
        through = cdist(centres.reshape(-1, 3), elements).reshape(*begun.shape, -1)
        detours = (begun[..., None] + through - cdist(posed.foci, elements)).astype(np.float32)
        waves *= phasors(-wavenumber.real * detours)
        # Elements radiate differently to a bone than to the focus. The centres of a bone for all
        # foci are so close together that their mean is enough.
        towards = np.concatenate([centres.mean(axis=1), posed.foci])[:, None] - elements
        cosines = np.einsum("ted,ed->te", towards, array.normals[subset.chosen])
        cosines /= np.linalg.norm(towards, axis=2)
        pattern = array.element.directivity(cosines, wavenumber.real).astype(np.float32)
        of_bones, of_foci = pattern[: len(PARTS), None], pattern[len(PARTS) :]
        # Near a zero of the pattern, the focus hardly hears the element, so its factor may stay.
        known = np.broadcast_to(np.abs(of_foci) > 0.1, waves.shape)
        waves *= np.divide(of_bones, of_foci, out=np.ones(waves.shape, np.float32), where=known)
        waves = subset.interpolated(waves)
        # Share of the pressure lost by moving a solution far: at most 0.17, at a change of 5 mm.
        # Fitted to 32 pairs of poses of an open, waving hand with foci at the palm and fingertips.
        change = float(gap_change(self.posed.distances, posed.distances))
        return CarriedFactors(
            part="carried",
            time=time,
            foci=posed.foci,
            distances=posed.distances,
            directions=posed.directions,
            factors=_kernels.detoured_waves(
                centres,
                posed.foci,
                array.positions,
                self.straight,
                waves,
                wavenumber.real,
            ),
            share=1.0 - 0.17 * (1.0 - np.exp(-change / 5e-3)),
            straight=self.straight,
            bones=bones,
            centres=centres,
            waves=waves,
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class CarriedFactors(HandFactors):
    """Factors (see ``HandFactors``) as a sum of direct sound and sound scattered by each bone.

    Attributes
    ----------
    straight : (F,) direct part of ``factors``, without scattering.
    bones : axes and starting points of the bones, in the pose to which the factors apply.
    centres : (H, F, 3) centre of the sources of each bone for each focus [m].
    waves : (H, F, R) part of the factors due to the sound that each bone scatters, without the
        phase shift due to the longer path through the centre of the bone's sources.
    """

    straight: Float64[np.ndarray, "foci"]
    bones: Bones
    centres: Float64[np.ndarray, "hulls foci 3"]
    waves: Complex64[np.ndarray, "hulls foci sources"]

    __repr__ = in_short

    def at(self, scene: LiveScene, posed: PosedHand) -> Factors:
        """Return the factors for a nearby pose; the centres of the sources move with the bones."""
        # Rotations are applied from the right, because each row is a point.
        turns, shifts = self.bones.motions_to(bones_of(posed.hand))
        centres = self.centres @ turns + shifts[:, None]
        # Add the direct sound and the sound scattered by each bone.
        return _kernels.detoured_waves(
            centres,
            posed.foci,
            scene.with_images.array.positions,
            self.straight,
            self.waves,
            scene.wavenumber.real,
        )


class BendingPanels:
    """Panels of a whole hand, meshed in one pose and bent into others.

    Parameters
    ----------
    scene : scene of the live loop.
    posed : the hand in the pose in which it is meshed.
    accuracy : target for the relative error of the solutions.
    min_seen : fraction of the elements that a panel must face to be kept; 0 keeps all panels.

    Raises
    ------
    InvalidInput
        If a focus lies inside the hand.
    """

    def __init__(
        self,
        scene: LiveScene,
        posed: PosedHand,
        accuracy: float = ACCURACY,
        min_seen: float = MIN_SEEN,
    ) -> None:
        self.posed = posed
        hand = posed.hand
        solver = BoundaryElement(accuracy=accuracy, estimate=False)
        # Use the solver's panel size as edge length, so that both share one mesh.
        edge = solver.panel_edge(scene.medium.wavelength(scene.frequency))
        body = sound_hard(part_of(hand, "hand", scene.places, edge))
        air = Scene(scene.medium, [body], frequency=scene.frequency)
        panels = solver.moving_panels(air, posed.foci)
        self._elements = scene.with_images.array.positions
        self.panels = panels.facing(self._elements, min_seen)
        if min_seen:
            # Coarse near integrals and low-rank blocks cost none of the pressure of a drive.
            rule = NearRule(0.75, (2, 2))
            self.panels = replace(self.panels, near_rule=rule, low_rank_error=0.06)
        self._leading: LeadingPanels | None = None
        self._bones = bones_of(hand)
        corners = self.panels.corners.reshape(-1, 3)
        self._corner_weights = hull_weights(hand.shape.hulls, corners)
        self._inside_weights = hull_weights(hand.shape.hulls, self.panels.inside)
        self._heights = hand.shape.hulls.look(corners).distance

    def solved(self, posed: PosedHand, time: float) -> SkinSources:
        """Compute the scattering by the hand in another pose, predicted for ``time`` [s].

        Raises
        ------
        NotConverged
            If the iteration does not converge.
        """
        bones, solution = self.radiated(posed)
        sources = solution.scattering
        if self._leading is None:
            mask = self._loudest(posed, sources)
            # Each panel has six sources; two more inside for each panel follow those of all panels.
            on_leading = np.concatenate([np.repeat(mask, 6), np.repeat(mask, 2)])
            self._leading = LeadingPanels(self._part(mask), on_leading)
        rest = sources.strengths.copy()
        rest[self._leading.sources] -= self._leading.strengths(posed)
        # The six sources on a panel move like the mean of its corners.
        panel_weights = self._corner_weights.reshape(-1, 6, len(PARTS)).mean(axis=1)
        weights = np.concatenate([np.repeat(panel_weights, 6, axis=0), self._inside_weights])
        owner = weights.argmax(axis=1)
        order = np.argsort(owner, kind="stable")
        parts, begin = np.unique(owner[order], return_index=True)
        points = sources.positions[order]
        return SkinSources(
            time=time,
            posed=posed,
            bones=bones,
            points=points,
            apart=cdist(points, posed.foci),
            weights=weights[order],
            parts=parts,
            begin=begin,
            straight=solution.factors,
            leading=self._leading,
            of_leading=np.argsort(order)[self._leading.sources],
            rest=rest[order],
        )

    def radiated(self, posed: PosedHand) -> tuple[Bones, TransposedSolution]:
        """Return the bones of a posed hand, and the solution for beacons at its foci."""
        bones, corners, inside = self.bent(posed.hand)
        # Below a relative residual of 0.2, the error is dominated by that of the panels.
        beacons = Target(posed.foci).beacons()
        return bones, self.panels.radiated(corners, inside, beacons, 0.2)

    def _loudest(self, posed: PosedHand, sources: Monopoles) -> Bool[np.ndarray, "panels"]:
        """Select the panels that radiate most to the elements for any focus."""
        elements = self._elements[::16]  # enough for mean values
        apart = cdist(elements, sources.positions)
        waves = phasors(self.panels.wavenumber.real * apart) / apart
        count = len(self.panels.corners)
        parts = []
        for focus, strengths in zip(posed.foci, sources.strengths.T, strict=True):
            sound = waves * strengths * cdist(elements, focus[None])
            nodes, inner = np.split(sound, [6 * count], axis=1)
            of_panels = nodes.reshape(-1, count, 6).sum(axis=2)
            of_panels += inner.reshape(-1, count, 2).sum(axis=2)
            parts.append(np.linalg.norm(of_panels, axis=0))
        ranks = np.max(parts, axis=0)
        # Solving 200 panels again in each pose takes 7 ms. Solutions that are 0.1 s old then keep
        # 0.90 instead of 0.87 of the attainable pressure.
        return ranks >= np.sort(ranks)[-min(200, count)]

    def _part(self, mask: Bool[np.ndarray, "panels"]) -> "BendingPanels":
        part = copy(self)
        part.panels = self.panels.chosen(mask)
        part._corner_weights = self._corner_weights[np.repeat(mask, 6)]
        part._inside_weights = self._inside_weights[np.repeat(mask, 2)]
        part._heights = self._heights[np.repeat(mask, 6)]
        return part

    def received(self, posed: PosedHand, sources: Monopoles, residual: float) -> DirectSolution:
        """Compute the scattering in another pose for sources away from the skin.

        The method requires all panels of the hand, so ``min_seen`` must be 0.
        """
        _, corners, inside = self.bent(posed.hand)
        return self.panels.received(corners, inside, sources, residual)

    def bent(self, hand: Hand) -> tuple[Bones, QuadraticTriangles, Points]:
        """Return the bones of a hand, its bent panels, and the collocation points inside it."""
        bones = bones_of(hand)
        corners = moved_by_bones(
            self.panels.corners.reshape(-1, 3), self._corner_weights, self._bones, bones
        )
        skin = hand.shape.hulls.look(corners)
        lifted = skin.distance - self._heights
        # Bending moves corners up to 2 mm away from the skin; project them back onto it.
        lifted = np.where(np.abs(lifted) < 2e-3, lifted, 0.0)
        corners -= lifted[:, None] * skin.gradient
        inside = moved_by_bones(self.panels.inside, self._inside_weights, self._bones, bones)
        return bones, corners.reshape(-1, 6, 3), inside


@dataclass(frozen=True, eq=False)
class LeadingPanels:
    """The panels of a hand that radiate most.

    Solving for these panels takes a tenth of the time needed for all panels. The difference between
    the two solutions is small, so moving it with the bones causes a smaller error than moving a
    whole solution.

    Attributes
    ----------
    panels : the panels that radiate most.
    sources : mask that selects the sources of ``panels`` from those of all panels of the hand.
    """

    panels: BendingPanels
    sources: Bool[np.ndarray, "sources"]

    def strengths(self, posed: PosedHand) -> Complex128[np.ndarray, "sources foci"]:
        """Return the strengths of the sources in a solution for these panels alone [Pa·m]."""
        return self.panels.radiated(posed)[1].scattering.strengths


class BendingHand:
    """Solver that computes the scattering by a whole hand and adapts solutions to new poses.

    ``solved`` and ``carried`` may run in two different threads.

    Parameters
    ----------
    scene : scene of the live loop.
    accuracy : target for the relative error of the solutions.
    min_seen : fraction of the elements that a panel must face to be kept; 0 keeps all panels.
    """

    def __init__(
        self, scene: LiveScene, accuracy: float = ACCURACY, min_seen: float = MIN_SEEN
    ) -> None:
        self._scene = scene
        self._accuracy = accuracy
        self._min_seen = min_seen
        # Use a quarter of the elements: interpolating between them has an error of 3 to 4 %.
        elements = scene.with_images.array.positions
        self._subset = ElementSubset.of(elements, -(-len(elements) // 4))
        self._panels: list[BendingPanels] = []
        self._solutions: Sequence[SkinSources] = ()

    def solved(self, joints: Joints, time: float) -> SkinSources:
        """Compute the scattering by a hand with joints (25, 3) at a given time [s].

        This method raises ``InvalidInput`` if the joints do not form a hand or a focus lies inside
        the hand, and ``NotConverged`` if the iteration does not converge.
        """
        posed = pose_hand(self._scene, joints)
        return self._panels_for(posed).solved(posed, time)

    def received(self, joints: Joints, sources: Monopoles, residual: float) -> DirectSolution:
        """Compute the scattering for sources away from the skin to this relative residual."""
        posed = pose_hand(self._scene, joints)
        return self._panels_for(posed).received(posed, sources, residual)

    def _panels_for(self, posed: PosedHand) -> BendingPanels:
        changes = [gap_change(panels.posed.distances, posed.distances) for panels in self._panels]
        if not changes or min(changes) > 8e-3:  # [m]; new panels take half a second
            made = BendingPanels(self._scene, posed, self._accuracy, self._min_seen)
            self._panels = [*self._panels[-5:], made]
            return made
        return self._panels[int(np.argmin(changes))]

    def keep(self, solution: SkinSources) -> None:
        """Store a solution for ``carried``; only the 60 newest are kept."""
        # Create a new list, because another thread may be reading the old one.
        self._solutions = [*self._solutions[-59:], solution]

    def carried(self, joints: Joints, time: float) -> CarriedFactors | None:
        """Move the stored solution for the most similar pose to the pose of joints (25, 3).

        ``time`` is the time of the pose [s]. None is returned if no solution is stored.
        """
        solutions = self._solutions
        posed = pose_hand(self._scene, joints)
        if not solutions:
            return None
        distances = np.array([solution.posed.distances for solution in solutions])
        nearest = int(gap_change(distances, posed.distances).argmin())
        return solutions[nearest].carried(self._scene, posed, time, self._subset)
