"""The whole hand, solved on panels that bend with it, and its sound carried to the pose of now.

A whole hand takes some 0.2 s to solve, and its factors (see ``factors``) are out of date after 20
ms, as sound that goes by way of a neighbouring finger changes its phase with every millimetre. What
hardly changes is the strength of the sources that the solution puts on the skin, over the sound
that the beacon sends straight there: a smooth function of position on each bone. So the sources are
moved with their bones, their phases follow the paths from the focus, and they radiate to the array
from where they are now: in 20 ms, after which a solution of 0.1 s ago is nearly right. For the
milliseconds until the next time the sources of each bone are taken together, and the phase of what
they radiate follows the path by way of their middle.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex64, Complex128, Float, Float32, Float64

from airtact import _kernels
from airtact.acoustics.scene import Scene, sound_hard
from airtact.acoustics.solvers.bem.solutions import DirectSolution
from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.acoustics.solvers.monopoles import monopole_pressure
from airtact.acoustics.sources import Monopoles
from airtact.acoustics.target import Target
from airtact.geometry.mesh.quadratic_triangles import QuadraticTriangles
from airtact.hands.body import FREE, OWNER, PARTS
from airtact.hands.hand import Hand
from airtact.hands.joints import CHAINS, cross
from airtact.hands.kinematics import bending_axis
from airtact.live.drives.factors import ACCURACY, HandFactors, part_of
from airtact.live.drives.riding import Riding, gap_change, ride
from airtact.live.drives.some_elements import SomeElements
from airtact.live.parts import LiveScene
from airtact.printing import in_short

SEEN, SETTLED = 0.5, 0.2
"""Panels that face fewer of the elements are left out: half the unknowns, for 0.01 of the pressure; relative residual
of the iteration, below which the panels are the larger error."""

SOFT, LEAST_WEIGHT = 3e-3, 1e-3
"""How fast skin goes over from one bone to the next [m], and the smallest weight of a bone that counts."""

LIFTED = 2e-3
"""Panels that bent off the skin by less than this are put back onto it [m]."""

OTHER_POSE = 5e-3
"""Poses whose ``gap_change`` is larger are solved on other panels [m]."""

LOST, LOST_GAP = 0.17, 5e-3
"""Share of the pressure that is lost where sound is carried far, and the ``gap_change`` over which most of it is [m]:
fitted to 32 pairs of poses of an open hand whose fingers wave, with foci at its palm and all
fingertips."""

FEWER = 4
"""Sound by way of a bone is evaluated at so many elements less than there are, and in between: 3 or 4 % off."""

MADE, KEPT = 6, 60
"""Sets of panels and solutions that are kept."""


@dataclass(frozen=True, eq=False)
class Bones:
    """The axes of the bones under all ``PARTS`` of a hand (H, 3, 3), one a row, and a point of each (H, 3) [m]."""

    axes: Float64[np.ndarray, "hulls 3 3"]
    starts: Float64[np.ndarray, "hulls 3"]

    __repr__ = in_short

    def motions_to(
        self, now: "Bones"
    ) -> tuple[Float64[np.ndarray, "hulls 3 3"], Float64[np.ndarray, "hulls 3"]]:
        """Return the rotation (from the right) and the shift that carry each bone to where it is now."""
        turns = np.einsum("hij,hik->hjk", self.axes, now.axes)
        return turns, now.starts - np.einsum("hj,hjk->hk", self.starts, turns)


def bones_of(hand: Hand) -> Bones:
    """Find the bones; a finger's hinges are across its last phalanx and the direction in which its pad faces."""
    (palm, normal), joints = hand.position("palm"), hand.joints
    hinges = np.array([bending_axis(joints, hand.side, finger) for finger in range(5)])
    root, knuckle = joints[list(CHAINS[2][:2])]
    starts, ends = joints[
        PARTS[: FREE + 1, :2].T
    ]  # the one after the phalanges is the thumb's metacarpal
    along = np.vstack([ends - starts, knuckle - root])
    across = np.vstack([hinges[[*OWNER, 0]], cross(knuckle - root, normal)])
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across -= along * np.sum(along * across, axis=1, keepdims=True)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    axes = np.stack([along, across, np.cross(along, across)], axis=1)
    of_palm = len(PARTS) - len(starts)
    return Bones(
        np.vstack([axes[:-1], np.tile(axes[-1], (of_palm, 1, 1))]),
        np.vstack([starts, np.tile(palm, (of_palm, 1))]),
    )


def _weights(
    hand: Hand, points: Float64[np.ndarray, "points 3"]
) -> Float64[np.ndarray, "points hulls"]:
    """Find how much each bone moves points on the skin: the nearest one, and where two are as near, both."""
    away = hand.shape.hulls.each(points)
    weights = np.exp((away.min(axis=1, keepdims=True) - away) / SOFT)
    weights[weights < LEAST_WEIGHT] = 0.0
    return weights / weights.sum(axis=1, keepdims=True)


def _moved(
    points: Float64[np.ndarray, "points 3"],
    weights: Float64[np.ndarray, "points hulls"],
    before: Bones,
    now: Bones,
) -> Float64[np.ndarray, "points 3"]:
    turns, shifts = before.motions_to(now)
    return np.einsum("pj,pjk->pk", points, np.tensordot(weights, turns, 1)) + weights @ shifts


@dataclass(frozen=True, eq=False)
class SkinSources:
    """The sources on the skin that a solution of a hand found for the beacons at its foci.

    Attributes
    ----------
    time : that the pose was predicted for, of the tracker's clock [s].
    riding, bones : of the pose.
    points : (N, 3) of the sources [m].
    weights : (N, H) how much each bone moves them.
    strengths : (N, F) [Pa·m].
    straight : (F,) strengths of the beacons: 2 where one touches the skin.
    """

    time: float
    riding: Riding
    bones: Bones
    points: Float64[np.ndarray, "sources 3"]
    weights: Float64[np.ndarray, "sources hulls"]
    strengths: Complex128[np.ndarray, "sources foci"]
    straight: Float64[np.ndarray, "foci"]

    __repr__ = in_short

    def carried(
        self, scene: LiveScene, riding: Riding, time: float, some: SomeElements
    ) -> "CarriedFactors":
        """Carry the sources to another pose, at a time [s]; ``some`` elements tell what comes by way of each bone."""
        wavenumber, bones = scene.medium.wavenumber(scene.frequency), bones_of(riding.hand)
        points = _moved(self.points, self.weights, self.bones, bones)
        elements = scene.sounding.array.positions[some.chosen]
        longer = _distances(points, riding.foci) - _distances(self.points, self.riding.foci)
        strengths = self.strengths * _phasors(wavenumber.real * longer)
        beacons = np.eye(len(riding.foci), dtype=np.complex128)
        straight = monopole_pressure(elements, riding.foci, beacons, wavenumber, "float32")
        waves = np.zeros((len(PARTS), *straight.T.shape), dtype=np.complex64)
        centres = np.zeros((len(PARTS), len(riding.foci), 3))
        owner = self.weights.argmax(axis=1)
        order = np.argsort(owner, kind="stable")
        points, strengths = points[order], strengths[order]
        sizes = np.real(strengths * np.conj(strengths))
        parts, begin = np.unique(owner[order], return_index=True)
        for part, first, last in zip(parts, begin, [*begin[1:], len(owner)], strict=True):
            own = slice(first, last)
            centres[part] = sizes[own].T @ points[own] / sizes[own].sum(axis=0)[:, None]
            by_way = monopole_pressure(elements, points[own], strengths[own], wavenumber, "float32")
            waves[part] = (by_way / straight).T
        waves *= _phasors(-wavenumber.real * detours(centres, riding.foci, elements))
        lost = 1.0 - np.exp(-float(gap_change(self.riding.distances, riding.distances)) / LOST_GAP)
        waves = some.everywhere(waves)
        return CarriedFactors(
            part="carried",
            time=time,
            foci=riding.foci,
            distances=riding.distances,
            directions=riding.directions,
            factors=_detoured(scene, centres, riding.foci, self.straight, waves),
            share=1.0 - LOST * lost,
            straight=self.straight,
            bones=bones,
            centres=centres,
            waves=waves,
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class CarriedFactors(HandFactors):
    """Factors that know by way of which bone the sound comes.

    Attributes
    ----------
    straight : (F,) the part of ``factors`` that comes straight from the focus.
    bones : of the pose.
    centres : (H, F, 3) the middle of the sources of each bone for each focus [m].
    waves : (H, F, E) the part of ``factors`` that comes by way of each bone, without the phase of
        the detour by the middle of its sources.
    """

    straight: Float64[np.ndarray, "foci"]
    bones: Bones
    centres: Float64[np.ndarray, "hulls foci 3"]
    waves: Complex64[np.ndarray, "hulls foci elements"]

    __repr__ = in_short

    def at(self, scene: LiveScene, riding: Riding) -> Complex64[np.ndarray, "foci elements"]:
        """Return the factors for a pose nearby: each bone takes the middle of its sources along."""
        turns, shifts = self.bones.motions_to(bones_of(riding.hand))
        centres = self.centres @ turns + shifts[:, None]
        return _detoured(scene, centres, riding.foci, self.straight, self.waves)


def _detoured(
    scene: LiveScene,
    centres: Float64[np.ndarray, "hulls foci 3"],
    foci: Float64[np.ndarray, "foci 3"],
    straight: Float64[np.ndarray, "foci"],
    waves: Complex64[np.ndarray, "hulls foci elements"],
) -> Complex64[np.ndarray, "foci elements"]:
    """Add up what comes straight and by way of each bone, whose sources have their middle at ``centres`` [m]."""
    wavenumber, elements = (
        scene.medium.wavenumber(scene.frequency).real,
        scene.sounding.array.positions,
    )
    out = np.empty((len(foci), len(elements)), dtype=np.complex64)
    _kernels.detoured_waves(centres, foci, elements, straight, waves, wavenumber, out)
    return out


def detours(
    centres: Float64[np.ndarray, "hulls foci 3"],
    foci: Float64[np.ndarray, "foci 3"],
    elements: Float64[np.ndarray, "elements 3"],
) -> Float32[np.ndarray, "hulls foci elements"]:
    """Return how much longer the path from each focus by way of a centre is than the straight one [m]."""
    begun = np.linalg.norm(centres - foci, axis=2).astype(np.float32)
    near, far, foci = (one.reshape(-1, 3).astype(np.float32) for one in (centres, elements, foci))
    return (
        begun[..., None] + _distances(near, far).reshape(*begun.shape, -1) - _distances(foci, far)
    )


def _phasors(phases: Float[np.ndarray, "*any"]) -> Complex64[np.ndarray, "*any"]:
    """Return e^{iφ} in single precision, in a third of the time of a complex exponential."""
    phases, out = phases.astype(np.float32, copy=False), np.empty(phases.shape, dtype=np.complex64)
    np.cos(phases, out=out.real)
    np.sin(phases, out=out.imag)
    return out


def _distances(
    points: Float[np.ndarray, "points 3"], foci: Float[np.ndarray, "foci 3"]
) -> Float[np.ndarray, "points foci"]:
    squares = points @ (-2.0 * foci.T)
    squares += np.einsum("pd,pd->p", points, points)[:, None] + np.einsum("fd,fd->f", foci, foci)
    return np.sqrt(np.maximum(squares, 0.0, out=squares), out=squares)


class BendingPanels:
    """Panels of a whole hand that were made for one pose and bend to others.

    Parameters
    ----------
    scene : of the live loop.
    riding : the hand in the pose.
    accuracy : of the solutions.
    seen : least share of the elements that a panel faces; 0 keeps all.

    Raises
    ------
    InvalidInput
        A focus lies inside the body.
    """

    def __init__(
        self, scene: LiveScene, riding: Riding, accuracy: float = ACCURACY, seen: float = SEEN
    ) -> None:
        self._scene, self.riding, hand = scene, riding, riding.hand
        air = Scene(
            scene.medium,
            [sound_hard(part_of(hand, "hand", scene.places))],
            frequency=scene.frequency,
        )
        solver = BoundaryElement(accuracy=accuracy, estimate=False)
        self._panels = solver.moving_panels(air, riding.foci).facing(
            scene.sounding.array.positions, seen
        )
        self._bones, corners = bones_of(hand), self._panels.corners.reshape(-1, 3)
        self._of_corners, self._of_inside = (
            _weights(hand, points) for points in (corners, self._panels.inside)
        )
        of_panels = self._of_corners.reshape(-1, 6, len(PARTS)).mean(axis=1)
        self._of_sources = np.concatenate([np.repeat(of_panels, 6, axis=0), self._of_inside])
        self._depths = hand.shape.hulls.look(corners).distance

    def solved(self, riding: Riding, time: float) -> SkinSources:
        """Solve another pose, at a time [s]; ``NotConverged`` where the iteration does not settle."""
        bones, corners, inside = self._bent(riding)
        found = self._panels.radiated(corners, inside, Target(riding.foci).beacons(), SETTLED)
        sources = found.scattering
        weights, strengths = self._of_sources, sources.strengths
        return SkinSources(
            time, riding, bones, sources.positions, weights, strengths, found.factors
        )

    def received(self, riding: Riding, sources: Monopoles, residual: float) -> DirectSolution:
        """Solve another pose for sources away from the hand; it needs all panels, and raises as ``solved``."""
        _, corners, inside = self._bent(riding)
        return self._panels.received(corners, inside, sources, residual)

    def _bent(
        self, riding: Riding
    ) -> tuple[Bones, QuadraticTriangles, Float64[np.ndarray, "groups 3"]]:
        """Bend the panels and their inside to another pose."""
        bones = bones_of(riding.hand)
        corners = _moved(self._panels.corners.reshape(-1, 3), self._of_corners, self._bones, bones)
        skin = riding.hand.shape.hulls.look(corners)
        off = skin.distance - self._depths
        corners -= np.where(np.abs(off) < LIFTED, off, 0.0)[:, None] * skin.gradient
        return (
            bones,
            corners.reshape(-1, 6, 3),
            _moved(self._panels.inside, self._of_inside, self._bones, bones),
        )


class BendingHand:
    """Solves a whole hand in one pose after the other, and carries what it found to the pose of now.

    ``solved`` and ``carried`` may run in two threads.

    Parameters
    ----------
    scene : of the live loop.
    accuracy, seen : of the panels, see ``BendingPanels``.
    """

    def __init__(self, scene: LiveScene, accuracy: float = ACCURACY, seen: float = SEEN) -> None:
        self._scene, self._accuracy, self._seen = scene, accuracy, seen
        self._some = SomeElements.of(
            scene.sounding.array.positions, -(-len(scene.sounding.array) // FEWER)
        )
        self._panels: list[BendingPanels] = []
        self._found: Sequence[SkinSources] = ()

    def solved(self, joints: Float64[np.ndarray, "25 3"], time: float) -> SkinSources:
        """Solve a pose (25, 3) [m], at a time [s]; errors are those of ``factors.solved``."""
        riding = ride(self._scene, joints)
        return self._panels_for(riding).solved(riding, time)

    def received(
        self, joints: Float64[np.ndarray, "25 3"], sources: Monopoles, residual: float
    ) -> DirectSolution:
        """Solve what a pose receives of sources away from it, to a relative residual; errors as for ``solved``."""
        riding = ride(self._scene, joints)
        return self._panels_for(riding).received(riding, sources, residual)

    def _panels_for(self, riding: Riding) -> BendingPanels:
        off = [gap_change(one.riding.distances, riding.distances) for one in self._panels]
        if not off or min(off) > OTHER_POSE:
            made = BendingPanels(self._scene, riding, self._accuracy, self._seen)
            self._panels = [*self._panels[1 - MADE :], made]
            return made
        return self._panels[int(np.argmin(off))]

    def keep(self, found: SkinSources) -> None:
        """Let a solution be carried from now on."""
        self._found = [*self._found[1 - KEPT :], found]

    def carried(self, joints: Float64[np.ndarray, "25 3"], time: float) -> CarriedFactors | None:
        """Carry the solution of the pose most like this one to it; None before the first; errors as for ``solved``."""
        found, riding = self._found, ride(self._scene, joints)
        if not found:
            return None
        gaps = gap_change(np.array([one.riding.distances for one in found]), riding.distances)
        return found[int(gaps.argmin())].carried(self._scene, riding, time, self._some)
