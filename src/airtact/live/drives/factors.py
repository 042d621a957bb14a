"""Effect of a hand on the pressure from each element at each focus, relative to open air.

The factors are solved for one pose of a hand. They change slowly as the hand moves, unlike the
pressure itself, whose phase changes with every millimetre of path. The transfer matrix of a nearby
pose is therefore approximated by the factors times the open-air matrix of that pose, which has a
closed form.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex64, Complex128, Float64
from scipy.spatial.distance import cdist

from airtact.acoustics.scene import Scene, sound_hard
from airtact.acoustics.solvers.bem.layer_potentials import NearRule
from airtact.acoustics.solvers.bem.moving_panels import MovingPanels
from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.acoustics.solvers.shared import monopole_pressure
from airtact.acoustics.target import Target
from airtact.errors import InvalidInput, in_short, of_kind
from airtact.geometry.pose import Pose
from airtact.geometry.surface import Surface
from airtact.hands.body import FREE, OWNER, PARTS, Hulls
from airtact.hands.hand import PLACES, Hand
from airtact.hands.joints import Points
from airtact.hands.shape import (
    NEAR_KEYFRAME,
    HandShape,
    hull_weights,
    motion,
    moved_with_hulls,
)
from airtact.live.moment import Rule
from airtact.live.scene import (
    Foci,
    Joints,
    LiveScene,
    PosedHand,
    Rows,
    bone_of,
    moving_points,
    pose_hand,
)

# Relative error of the solutions; a smaller error would improve the pressure by less than 1 %.
ACCURACY = 0.06

Factors = Complex64[np.ndarray, "foci sources"]


@dataclass(frozen=True, eq=False)
class HandFactors:
    """Solution for a part of a hand in one pose.

    Attributes
    ----------
    part : part of the hand for which the solution was computed.
    time : time of the predicted pose, on the tracker's clock [s].
    foci, distances, directions : attributes of the ``PosedHand`` of the predicted pose.
    factors : (P, R) ratio of the pressure with the hand to that in open air, for each source at
        each of ``beacon_points``.
    share : expected pressure with this solution, divided by that with a new solution for the same
        pose; below 1 if this solution was moved from another pose.
    """

    part: Rule
    time: float
    foci: Foci
    distances: Float64[np.ndarray, "pairs"]
    directions: Float64[np.ndarray, "foci samples 3"]
    factors: Complex64[np.ndarray, "points sources"]
    share: float = 1.0

    __repr__ = in_short

    def at(self, scene: LiveScene, posed: PosedHand) -> Factors:
        """Return the factors at the foci, assuming that they are the same in nearby poses."""
        return self.factors[: len(posed.foci)]


def beacon_points(scene: LiveScene, posed: PosedHand) -> Float64[np.ndarray, "points 3"]:
    """Return the beacon positions (P, 3) [m]: the foci, then the moving foci in each frame."""
    if scene.moving is None:
        return posed.foci
    return np.concatenate([posed.foci, moving_points(scene.moving, posed).reshape(-1, 3)])


def hulls_of(part: str, places: Sequence[str]) -> list[int]:
    """Return the indices, in ``PARTS``, of the bones that belong to a part of a hand.

    The part "hand" contains all bones; "phalanges" contains those that carry the ``places``.
    """
    if part == "hand":
        return list(range(len(PARTS)))
    chosen = set()
    for place in places:
        if place == "palm":
            chosen |= set(range(FREE, len(PARTS)))
        else:
            hulls = np.flatnonzero(PLACES.index(place) == OWNER).tolist()
            chosen |= set(hulls[-1:] if part == "phalanges" else hulls)
    return sorted(chosen)


def part_of(hand: Hand, part: str, places: Sequence[str], edge: float = 10e-3) -> Surface:
    """Return the surface of a part of a hand, meshed with edge length ``edge`` [m]."""
    hulls = _selected(hand.shape.hulls, hulls_of(part, places))
    return _surface(HandShape(hulls, Pose.identity()), edge)


def _selected(hulls: Hulls, chosen: list[int]) -> Hulls:
    table = np.ix_(chosen, chosen)
    # Keep only the balls that these hulls use. A hull of two balls has index -1 for the third.
    balls, parts = np.unique(hulls.parts[chosen], return_inverse=True)
    missing = int(balls[0] == -1)
    return Hulls(
        hulls.balls[balls[missing:]],
        parts.reshape(-1, 3).astype(np.int64) - missing,
        np.ascontiguousarray(hulls.blend[table]),
        np.ascontiguousarray(hulls.apart[table]),
    )


def _surface(shape: HandShape, edge: float) -> Surface:
    skin = shape.skin(edge)  # closed, and no triangle is degenerate
    return Surface(skin.vertices, skin.triangles, primitive=shape, _known_shape=shape)


def factors_of(
    scene: LiveScene,
    posed: PosedHand,
    part: Rule,
    time: float,
    received: Complex128[np.ndarray, "sources points"],
) -> HandFactors:
    """Return the factors for the pressures (R, P) that P beacons produce at R sources."""
    points = beacon_points(scene, posed)
    open_air = monopole_pressure(
        scene.with_images.array.positions,
        points,
        np.eye(len(points), dtype=np.complex128),
        scene.wavenumber,
        "float64",
    )
    # If the hand reaches behind the plane, an image may be inside it. The pressure there is 0.
    received = np.where(np.isfinite(received), received, 0.0)
    factors = np.ascontiguousarray((received / open_air).T.astype(np.complex64))
    return HandFactors(part, time, posed.foci, posed.distances, posed.directions, factors)


class RigidParts:
    """Rigid last phalanges on which the foci of a scene lie; their matrix is factorised once.

    Solving a new pose takes about a fifth of the time that ``PartSolver.meshed`` takes. The bodies
    keep their size, although the bone lengths reported by a tracker vary from frame to frame. All
    foci must be on fingers.

    Parameters
    ----------
    scene : scene of the live loop.
    joints : (25, 3) joints of the hand from which the bodies are built [m].

    Raises
    ------
    InvalidInput
        If the joints do not form a hand, or a focus lies inside a body.
    """

    def __init__(self, scene: LiveScene, joints: Joints) -> None:
        self._scene = scene
        self._reference = pose_hand(scene, joints)
        # This edge length [m] is small enough to tell close bodies apart.
        self._surfaces = [
            part_of(self._reference.hand, "phalanges", [place], 3e-3) for place in scene.places
        ]
        self._lengths = _bone_lengths(scene, joints)
        air = self._air([Pose.identity()] * len(self._surfaces))
        # More accurate than ACCURACY: the bodies are factorised once, so this costs no time later.
        solver = BoundaryElement(accuracy=0.045, estimate=False)
        self._solver = solver.factorised(air, refined=self._reference.foci)

    def solved(self, joints: Joints, time: float) -> HandFactors:
        """Compute the scattering by the rigid bodies, posed by joints (25, 3) at ``time`` [s]."""
        scene = self._scene
        posed = pose_hand(scene, joints)
        # Running mean of the bone lengths, which ``outgrown`` compares with the bodies.
        self._lengths += 0.02 * (_bone_lengths(scene, joints) - self._lengths)
        # Each body moves with the axes of its bone and with the focus in front of it.
        turns = np.swapaxes(posed.frames, 1, 2) @ self._reference.frames
        shifts = posed.foci - np.einsum("fij,fj->fi", turns, self._reference.foci)
        poses = [Pose(turn, shift) for turn, shift in zip(turns, shifts, strict=True)]
        points = beacon_points(scene, posed)
        field = self._solver.radiate(self._air(poses), Target(points).beacons())
        received = field.at(scene.with_images.array.positions)
        return factors_of(scene, posed, "phalanges", time, received)

    @property
    def outgrown(self) -> bool:
        """Whether the mean bone lengths differ from those of the bodies, as for another hand."""
        change = self._lengths - _bone_lengths(self._scene, self._reference.hand.joints)
        return bool(np.abs(change).max() > 1.5e-3)

    def _air(self, poses: Sequence[Pose]) -> Scene:
        moved = [
            sound_hard(surface.moved(pose))
            for surface, pose in zip(self._surfaces, poses, strict=True)
        ]
        return Scene(self._scene.medium, moved, frequency=self._scene.frequency)


class PartSolver:
    """Solver for scattering by parts of a hand; last phalanges are rigid unless they touch.

    Parameters
    ----------
    scene : scene of the live loop.
    """

    def __init__(self, scene: LiveScene) -> None:
        self._scene = scene
        self._rigid: RigidParts | None = None
        self._keyframe: HandShape | None = None
        self._bent: list[BentPanels] = []  # the newest ones first

    def solved(self, joints: Joints, part: Rule, time: float) -> HandFactors:
        """Compute the scattering by part of a hand, as rigid bodies if possible, or else as a mesh.

        ``time`` is the time of the pose, on the tracker's clock [s].
        """
        if part == "phalanges" and "palm" not in self._scene.places:  # the palm is too large
            with suppress(InvalidInput):  # bodies that touch are solved as one body instead
                if self._rigid is None or self._rigid.outgrown:
                    self._rigid = RigidParts(self._scene, joints)
                return self._rigid.solved(joints, time)
        return self.meshed(joints, part, time)

    def meshed(self, joints: Joints, part: Rule, time: float) -> HandFactors:
        """Compute the scattering by a part of the hand, "phalanges" or "hand", as a single body.

        If possible, the mesh is moved from the previous pose.

        Raises
        ------
        InvalidInput
            If the joints do not form a hand, or a focus lies inside the body.
        NotConverged
            If the iteration does not converge.
        """
        scene = self._scene
        posed = pose_hand(scene, joints)
        # Few panels cover the last phalanges, so smaller ones cost little time.
        accuracy = 0.035 if part == "phalanges" else ACCURACY
        solver = BoundaryElement(accuracy=accuracy, estimate=False)
        hulls = _selected(posed.hand.shape.hulls, hulls_of(part, scene.places))
        points = beacon_points(scene, posed)
        elements = scene.with_images.array.positions
        # Within 12 mm of the skin, the pressure at an element requires both integral equations.
        middle = hulls.balls[:, :3].mean(axis=0)
        extent = cdist(hulls.balls[:, :3], middle[None])[:, 0] + hulls.balls[:, 3]
        near = cdist(elements, middle[None]).min() < extent.max() + 12e-3
        # A focus inside the body is an error, which only ``radiate`` raises.
        moving = part == "phalanges" and not near and hulls.look(points).distance.min() > 0.0
        for bent in self._bent if moving else ():
            received = bent.received(hulls, points, elements)
            if received is not None:
                return factors_of(scene, posed, part, time, received)
        shape = HandShape.following(hulls, self._keyframe if part == "phalanges" else None)
        self._keyframe = shape.keyframe
        # Use the solver's panel size as edge length, so that both share one mesh.
        surface = _surface(shape, solver.panel_edge(scene.medium.wavelength(scene.frequency)))
        # By reciprocity, beacons at the foci give the pressures from all elements at once.
        air = Scene(scene.medium, [sound_hard(surface)], frequency=scene.frequency)
        if moving:
            self._bent = [BentPanels(hulls, solver.moving_panels(air, points)), *self._bent[:5]]
            received = self._bent[0].received(hulls, points, elements)
            if received is not None:
                return factors_of(scene, posed, part, time, received)
        near = bool((surface.depth(elements) > -12e-3).any())
        field = replace(solver, estimate=near).radiate(air, Target(points).beacons())
        return factors_of(scene, posed, part, time, field.at(elements))


class BentPanels:
    """Panels of a part of a hand, made in one pose and moved with its hulls to similar poses.

    Parameters
    ----------
    hulls : hulls of the part of the hand, in the pose for which the panels were made.
    panels : panels of the part in this pose.
    """

    def __init__(self, hulls: Hulls, panels: MovingPanels) -> None:
        self._hulls = hulls
        # Coarse integrals over near panels cost none of the pressure of a drive.
        self._panels = replace(panels, near_rule=NearRule(0.75, (2, 2)))
        self._points = np.concatenate([panels.corners.reshape(-1, 3), panels.inside])
        weights = hull_weights(hulls, self._points)
        # Separate fingers do not move each other's panels.
        weights[hulls.apart[weights.argmax(axis=1)] == 1.0] = 0.0
        self._weights = weights / weights.sum(axis=1, keepdims=True)

    def received(
        self, hulls: Hulls, beacons: Foci, elements: Points
    ) -> Complex128[np.ndarray, "points foci"] | None:
        """Return the pressure [Pa] of each beacon at the elements, which are away from the skin.

        None is returned if the panels do not fit the pose.
        """
        if not np.array_equal(hulls.apart, self._hulls.apart):
            return None
        if motion(self._hulls, hulls) > NEAR_KEYFRAME:
            return None
        points = moved_with_hulls(self._hulls, hulls, self._points, self._weights)
        corners, inside = np.split(points, [self._panels.corners.size // 3])
        skin = hulls.look(corners)
        # Where fingers touch, the crease between them moves along the skin.
        if np.abs(skin.distance).max() > 0.1e-3:
            return None
        corners -= skin.distance[:, None] * skin.gradient
        beacon_sources = Target(beacons).beacons()
        solution = self._panels.radiated(corners.reshape(-1, 6, 3), inside, beacon_sources, 0.04)
        return solution.at(elements)


def _bone_lengths(scene: LiveScene, joints: Joints) -> Float64[np.ndarray, "foci"]:
    ends = np.array([bone_of(place) for place in scene.places])
    return np.linalg.norm(joints[ends[:, 1]] - joints[ends[:, 0]], axis=1)


class OpenAir:
    """The transfer matrix in open air for a fixed array and moving foci.

    Parameters
    ----------
    scene : scene of the live loop; its array, medium and frequency are used.
    """

    def __init__(self, scene: LiveScene) -> None:
        of_kind(scene, LiveScene, "the scene", "live_scene(setup)")
        self._array = scene.with_images.array
        self._faces = self._array.face_points.reshape(-1, 3)
        # Height of each face along its normal [m].
        self._fronts = np.sum(self._array.positions * self._array.normals, axis=1)
        self._wavenumber = scene.wavenumber

    def rows(self, foci: Foci) -> Rows:
        """Return the pressure (F, R) [Pa] at foci (F, 3) per unit drive of each source.

        The pressure is 0 behind a directional source. The result is in single precision, with a
        relative error below 1e-4.
        """
        array = self._array
        beacons = np.eye(len(foci), dtype=np.complex128)
        waves = monopole_pressure(self._faces, foci, beacons, self._wavenumber, "float32")
        waves = array.element.weights @ waves.reshape(len(array), -1, len(foci))
        rows = np.ascontiguousarray(waves.T) * (array.element.sensitivity * array.gains)
        if array.element.directional:
            rows[foci @ array.normals.T < self._fronts] = 0.0
        return rows
