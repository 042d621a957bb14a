"""Solutions for beacons on skin that touches, or will soon touch, an object.

A focus at a contact may be anywhere on the hand, and it moves along the skin.
Nearly all of the sound that the hand scatters to the focus comes from the skin
around it, and from the skin between it and the elements. At two fingertips, these
panels yield 0.92 to 0.94 of the attainable pressure; all panels yield 0.97, and path
lengths alone 0.68 to 0.75. Solving these panels takes milliseconds, so every drive
uses a solution for its own pose. Near a focus, panels that face away from the
elements matter as well, because the sound bends around a fingertip.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex64, Float64, Int64
from scipy.spatial.distance import cdist

from airtact.acoustics.solvers.bem.moving_panels import MovingPanels
from airtact.acoustics.solvers.shared import monopole_pressure
from airtact.acoustics.target import Target
from airtact.errors import InvalidInput, in_short
from airtact.hands.hand import Hand, Side
from airtact.hands.joints import Points, joints_of
from airtact.hands.shape import hull_weights, motion
from airtact.live.drives.bending import BendingPanels, Bones, Weights, bones_of, moved_by_bones
from airtact.live.drives.factors import ACCURACY
from airtact.live.scene import SIDES, Joints, LiveScene, PosedHand, hand_in

Owners = Int64[np.ndarray, "points"]


def extrapolated(joints: Joints, velocities: Joints, ahead: float) -> Joints:
    """Return joints (25, 3) after ``ahead`` [s]; unchanged if the result would not form a hand."""
    try:
        return joints_of(joints + ahead * velocities)
    except InvalidInput:
        return joints


@dataclass(frozen=True, eq=False)
class SkinRequest:
    """Request to compute the scattering for beacons, which are virtual sources at points on hands.

    Attributes
    ----------
    time : time of the joints, on the tracker's clock [s].
    sent : time when the request was sent, as returned by ``time.monotonic`` [s].
    joints : (25, 3) joints of each hand [m].
    velocities : (25, 3) velocities of the joints of each hand [m/s].
    points : (B, 3) positions of the beacons on hands with the joints ``joints`` [m].
    owners : (B,) index in ``SIDES`` of the hand with which each beacon moves.
    """

    time: float
    sent: float
    joints: Mapping[Side, Joints]
    velocities: Mapping[Side, Joints]
    points: Points
    owners: Owners

    __repr__ = in_short

    def after(self, ahead: float) -> tuple["SkinRequest", Mapping[Side, Joints]]:
        """Return a pair: this request, and each hand's joints predicted for ``ahead`` [s] later.

        See ``extrapolated``.
        """
        return self, {
            side: extrapolated(joints, self.velocities[side], ahead)
            for side, joints in self.joints.items()
        }


@dataclass(frozen=True, eq=False)
class SkinFactors:
    """Solution of the scattering for beacons (virtual sources at points on hands) in one pose.

    Attributes
    ----------
    time : time of the predicted pose, on the tracker's clock [s].
    bones : axes and starting points of the bones of each hand in the predicted pose.
    points : (B, 3) positions of the beacons in the predicted pose [m].
    owners : (B,) index in ``SIDES`` of the hand with which each beacon moves.
    weights : (B, H) weight of each bone in the motion of each beacon.
    factors : (B, R) ratio of the pressure with the hands to that in open air, for each beacon and
        source.
    """

    time: float
    bones: Mapping[Side, Bones]
    points: Points
    owners: Owners
    weights: Weights
    factors: Complex64[np.ndarray, "points sources"]

    __repr__ = in_short

    def at(
        self, bones: Mapping[Side, Bones], foci: Points
    ) -> tuple[Complex64[np.ndarray, "foci sources"], Float64[np.ndarray, "foci"]]:
        """Return factors (F, R) at foci (F, 3) on hands in a pose, and their validity (F,).

        The beacons move with the bones. As the distance of a focus from the nearest beacon
        increases, the validity of its factors falls from 1 to 0, and the factors approach a
        constant, so that the phases become those in open air.
        """
        moved = np.full(self.points.shape, np.inf)
        for index, side in enumerate(SIDES):
            own = self.owners == index
            if own.any() and side in bones and side in self.bones:
                now = bones[side]
                moved[own] = moved_by_bones(
                    self.points[own], self.weights[own], self.bones[side], now
                )
        apart = cdist(foci, np.where(np.isfinite(moved), moved, 1e3))
        nearest = apart.argmin(axis=1)
        found = self.factors[nearest]
        # The factors lose their benefit within 3 mm of the beacon. Measured on skin, they keep 0.93
        # to 0.99 of the pressure at 1 to 2 mm, and 0.72 to 0.96 at 3 to 5 mm.
        benefit = np.exp(-((apart.min(axis=1) / 3e-3) ** 2))
        means = found.mean(axis=1)
        sizes = np.sqrt(np.mean(np.abs(found) ** 2, axis=1))
        means = sizes * means / np.maximum(np.abs(means), 1e-12)
        # If no hand is near, the factor is 1 rather than another constant.
        means[benefit < 1e-6] = 1.0
        share = benefit[:, None].astype(np.float32)
        return (share * found + (1.0 - share) * means[:, None]).astype(np.complex64), benefit


class SkinSolver:
    """Solver for beacons on the skin of one or two hands; call ``solved`` with a request.

    Parameters
    ----------
    scene : scene of the live loop.
    """

    def __init__(self, scene: LiveScene) -> None:
        self._scene = scene
        self._panels: dict[Side, list[BendingPanels]] = {"left": [], "right": []}

    def solved(
        self, asked: tuple[SkinRequest, Mapping[Side, Joints]], time: float
    ) -> SkinFactors | None:
        """Compute the scattering for the beacons of a request in a predicted pose.

        ``asked`` is a result of ``SkinRequest.after``, and ``time`` is the time of the predicted
        pose [s].

        Returns
        -------
        The factors; None if no skin is near any beacon.

        Raises
        ------
        InvalidInput
            If the joints do not form a hand.
        NotConverged
            If the iteration does not converge.
        """
        request, later = asked
        scene = self._scene
        points = request.points.copy()
        weights = np.zeros((0, 0))
        bones = {}
        bodies = []
        for side, joints in later.items():
            own = request.owners == SIDES.index(side)
            before = hand_in(scene, request.joints[side], side)
            hand = hand_in(scene, joints, side)
            panels = self._panels_for(side, hand)
            bones[side], corners, inside = panels.bent(hand)
            of_points = hull_weights(before.shape.hulls, points)
            if not len(weights):
                weights = np.zeros_like(of_points)
            weights[own] = of_points[own]
            points[own] = moved_by_bones(points[own], weights[own], bones_of(before), bones[side])
            bodies.append((panels.panels, corners, inside))
        elements = scene.with_images.array.positions
        every = replace(
            bodies[0][0],
            corners=np.concatenate([corners for _, corners, _ in bodies]),
            inside=np.concatenate([inside for _, _, inside in bodies]),
            deviation=np.concatenate([panels.deviation for panels, _, _ in bodies]),
            admittance=np.concatenate([panels.admittance for panels, _, _ in bodies]),
        )
        if cdist(every.corners[:, 0], points).min() > 60e-3:  # [m]; hands have no effect
            return None
        # The beacons of each hand are solved separately. With two hands, two matrices of 500 panels
        # take 60 ms and keep more of the pressure than one matrix of 800, which takes longer.
        count = 250 if len(bodies) == 1 else 500
        factors = np.empty((len(points), len(elements)), dtype=np.complex64)
        sizes = np.empty((len(points), 1))  # relative to open air
        for owner in np.unique(request.owners):
            own = request.owners == owner
            panels = _most_important(every, points[own], elements, count)
            solution = panels.radiated(
                panels.corners, panels.inside, Target(points[own]).beacons(), 0.2
            )
            beacons = np.eye(len(points[own]), dtype=np.complex128)
            sources = solution.scattering
            scattered = monopole_pressure(
                elements, sources.positions, sources.strengths, scene.wavenumber, "float32"
            )
            straight = monopole_pressure(
                elements, points[own], beacons, scene.wavenumber, "float32"
            )
            factors[own] = (solution.factors + scattered / straight).T
            both = solution.factors * straight + scattered
            sizes[own, 0] = np.linalg.norm(both, axis=0) / np.linalg.norm(straight, axis=0)
        if len(bodies) > 1:
            # Without all other panels, the pressure at some beacons, as at the palm, is
            # overestimated, and a balanced drive neglects them. Halving the differences in decibels
            # keeps 3 % more of the pressure with two hands, but 1 to 2 % less with one.
            factors *= np.sqrt(np.exp(np.log(sizes).mean()) / sizes)
        return SkinFactors(time, bones, points, request.owners, weights, factors)

    def _panels_for(self, side: Side, hand: Hand) -> BendingPanels:
        """Return the panels meshed in the most similar pose, or new ones if none is similar."""
        meshed = self._panels[side]
        moved = [motion(panels.posed.hand.shape.hulls, hand.shape.hulls) for panels in meshed]
        # Bending distorts only the panels at the joints, where foci are rare. [m]
        if not moved or min(moved) > 12e-3:
            none = np.zeros((0, 3))
            # The hand has no foci.
            posed = PosedHand(hand, none, np.zeros((0, 3, 3)), np.zeros(0), np.zeros((0, 1, 3)))
            made = BendingPanels(self._scene, posed, ACCURACY, min_seen=0.0)
            self._panels[side] = [*meshed[-5:], made]
            return made
        return meshed[int(np.argmin(moved))]


def _most_important(
    panels: MovingPanels,
    beacons: Float64[np.ndarray, "beacons 3"],
    elements: Float64[np.ndarray, "elements 3"],
    count: int,
) -> MovingPanels:
    """Return the ``count`` panels that most affect the sound of the beacons at the elements.

    These panels have the shortest detours from a beacon via the panel to the elements, so they
    include those that shadow the beacon. If palms face each other, the panels nearest to the
    beacons keep less of the pressure than path lengths alone.
    """
    first, second, third = np.moveaxis(panels.corners[:, :3], 1, 0)
    centres = (first + second + third) / 3.0
    some = elements[:: max(1, len(elements) // 80)]  # enough for mean values
    away = cdist(centres, beacons)
    # Mean detour. Of panels with equal detours, those near the beacon matter more.
    ranks = (1.1 * away - cdist(beacons, some).mean(axis=1)).min(axis=1)
    ranks += cdist(centres, some).mean(axis=1)
    # Far panels that few elements see hardly matter.
    normals = np.cross(second - first, third - first)
    heights = normals @ some.T - np.einsum("pd,pd->p", normals, centres)[:, None]
    hidden = (heights > 0.0).mean(axis=1) < 0.4
    ranks[hidden & (away.min(axis=1) > 20e-3)] += 1.0  # [m]; after all others
    keep = np.zeros(len(ranks), dtype=bool)
    keep[np.argsort(ranks)[:count]] = True
    return panels.chosen(keep)
