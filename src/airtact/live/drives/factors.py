"""What a hand does to the sound of each element at each focus: a factor on its pressure in open air.

The factors are solved for one pose of a hand. They change slowly as the hand moves on, unlike the
pressure itself, whose phase turns with every millimetre of path: the transfer matrix of a pose
nearby is the factors times the open air matrix of that pose, which is in closed form.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex64, Complex128, Float64

from airtact.acoustics.scene import Scene, sound_hard
from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.acoustics.solvers.monopoles import monopole_pressure
from airtact.acoustics.target import Target
from airtact.errors import InvalidInput
from airtact.geometry.pose import Pose
from airtact.geometry.surface import Surface
from airtact.hands.body import FREE, OWNER, PARTS, Hulls
from airtact.hands.hand import PLACES, Hand
from airtact.hands.shape import HandShape
from airtact.hands.skin_mesh import midpoints
from airtact.live.drives.moving import moving_points
from airtact.live.drives.riding import Riding, bone_of, ride
from airtact.live.parts import LiveScene, Rule
from airtact.printing import in_short

ACCURACY = 0.06
"""Accuracy of the solutions; a finer one brings less than 0.01 of the pressure."""

RIGID_ACCURACY = 0.045
"""Accuracy of parts that are factorised once, for which a finer one costs no time later."""

SLOWLY, OUTGROWN = 0.02, 1.5e-3
"""Weight of the newest lengths of the bones in the usual ones, and how much these may differ from the bodies' [m]."""

BESIDE = 12e-3
"""Near an element so close to the skin the pressure needs both equations [m]."""

EDGE, FINE = 10e-3, 3e-3
"""Edge of the triangles of a part's surface, and of a rigid one's, where small ones tell at once that bodies are apart
[m]; the solver makes its own panels."""


@dataclass(frozen=True, eq=False)
class HandFactors:
    """A solution for a part of a hand in one pose.

    Attributes
    ----------
    part : of the hand that was solved.
    time : that the pose was predicted for, of the tracker's clock [s].
    foci, distances, directions : of the pose, see ``Riding``.
    factors : (P, E) on the open air pressure of each element at each focus, then at each focus of
        each frame where foci move, as ``beacon_points`` has them.
    share : of the pressure that a fresh solution keeps, what is left where it was carried from
        another pose.
    """

    part: Rule
    time: float
    foci: Float64[np.ndarray, "foci 3"]
    distances: Float64[np.ndarray, "pairs"]
    directions: Float64[np.ndarray, "foci samples 3"]
    factors: Complex64[np.ndarray, "points elements"]
    share: float = 1.0

    __repr__ = in_short

    def at(self, scene: LiveScene, riding: Riding) -> Complex64[np.ndarray, "foci elements"]:
        """Return the factors at the foci for a pose nearby, which here are the same."""
        return self.factors[: len(riding.foci)]


def beacon_points(scene: LiveScene, riding: Riding) -> Float64[np.ndarray, "points 3"]:
    """Return the points for which a hand is solved (P, 3) [m]: its foci, and where they move."""
    if scene.moving is None:
        return riding.foci
    return np.concatenate([riding.foci, moving_points(scene.moving, riding).reshape(-1, 3)])


def hulls_of(part: Rule, places: Sequence[str]) -> list[int]:
    """Return the indices of a hand's ``PARTS`` to solve for foci at some places."""
    if part == "hand":
        return list(range(len(PARTS)))
    fingers = [PLACES.index(place) for place in places if place != "palm"]
    chosen = {index for finger in fingers for index in np.flatnonzero(finger == OWNER).tolist()}
    if part == "phalanges":
        chosen = {int(np.flatnonzero(finger == OWNER)[-1]) for finger in fingers}
    return sorted(chosen) + (list(range(FREE, len(PARTS))) if "palm" in places else [])


def part_of(hand: Hand, part: Rule, places: Sequence[str], edge: float = EDGE) -> Surface:
    """Make the surface of the part of a hand that foci at some places need, of triangles with an edge [m]."""
    whole, some = hand.shape.hulls, np.array(hulls_of(part, places))
    blend, apart = (
        np.ascontiguousarray(table[np.ix_(some, some)]) for table in (whole.blend, whole.apart)
    )
    return _surface(Hulls(whole.balls, whole.parts[some], blend, apart), edge)


def _surface(hulls: Hulls, edge: float = EDGE) -> Surface:
    shape = HandShape(hulls, Pose.identity())
    skin = shape.skin(edge)
    return Surface(skin.vertices, skin.triangles, midpoints(hulls, skin), shape)


def solved(
    scene: LiveScene, joints: Float64[np.ndarray, "25 3"], part: Rule, time: float
) -> HandFactors:
    """Solve a part of a hand in a pose, for foci at the places of a scene.

    Parameters
    ----------
    scene : of the live loop.
    joints : (25, 3) of the hand [m].
    part : ``"phalanges"``, ``"fingers"`` or ``"hand"``.
    time : of the pose, of the tracker's clock [s].

    Raises
    ------
    InvalidInput
        The joints are no hand's, or a focus lies inside the body.
    NotConverged
        The iteration did not settle.
    """
    riding, solver = ride(scene, joints), BoundaryElement(accuracy=ACCURACY, estimate=False)
    edge = solver.panel_edge(
        scene.medium.wavelength(scene.frequency)
    )  # so that both have the same mesh
    surface = part_of(riding.hand, part, scene.places, edge)
    air = Scene(scene.medium, [sound_hard(surface)], frequency=scene.frequency)
    beside = bool((surface.depth(scene.sounding.array.positions) > -BESIDE).any())
    field = replace(solver, estimate=beside).radiate(
        air, Target(beacon_points(scene, riding)).beacons()
    )
    return factors_of(scene, riding, part, time, field.at(scene.sounding.array.positions))


class RigidParts:
    """The last phalanges of the foci of a scene, each a rigid body that was factorised once.

    Solving them anew for another pose takes about a fifth of the time that ``solved`` takes. A
    tracker's bones change their lengths from frame to frame, these bodies do not. The palm, too
    large for this, is a hard plane.

    Parameters
    ----------
    scene : of the live loop.
    joints : (25, 3) of the hand from which the bodies are made [m].

    Raises
    ------
    InvalidInput
        The joints are no hand's, or a focus lies inside the body.
    """

    def __init__(self, scene: LiveScene, joints: Float64[np.ndarray, "25 3"]) -> None:
        self._scene, self._made = scene, ride(scene, joints)
        self._pads = np.array([place != "palm" for place in scene.places])
        pads = np.array(scene.places)[self._pads].tolist()
        self._surfaces = [rigid_part(self._made.hand, place) for place in pads]
        self._lengths = _lengths(scene, joints)
        air = self._air([Pose.identity()] * len(self._surfaces))
        solver = BoundaryElement(accuracy=RIGID_ACCURACY, estimate=False)
        self._solver = solver.factorised(air, refined=self._made.foci)

    def solved(self, joints: Float64[np.ndarray, "25 3"], time: float) -> HandFactors:
        """Solve another pose; parameters and errors are those of ``solved``."""
        riding = ride(self._scene, joints)
        self._lengths += SLOWLY * (_lengths(self._scene, joints) - self._lengths)
        turns = np.swapaxes(riding.frames, 1, 2) @ self._made.frames
        shifts = riding.foci - np.einsum("fij,fj->fi", turns, self._made.foci)
        air = self._air(
            [Pose(*motion) for motion in zip(turns[self._pads], shifts[self._pads], strict=True)]
        )
        points = beacon_points(self._scene, riding)
        field = self._solver.radiate(air, Target(points).beacons())
        found = factors_of(
            self._scene, riding, "phalanges", time, field.at(self._scene.sounding.array.positions)
        )
        moving = self._scene.moving
        places = np.arange(len(riding.foci))
        places = places if moving is None else np.concatenate([places, moving.places.ravel()])
        for index in np.flatnonzero(~self._pads[places]):
            found.factors[index] += _mirrored(self._scene, riding, points[index])
        return found

    @property
    def outgrown(self) -> bool:
        """Whether the bones have been longer or shorter than the bodies for a while, as those of another hand."""
        return bool(
            np.abs(self._lengths - _lengths(self._scene, self._made.hand.joints)).max() > OUTGROWN
        )

    def _air(self, poses: Sequence[Pose]) -> Scene:
        moved = [
            sound_hard(one.moved(pose)) for one, pose in zip(self._surfaces, poses, strict=True)
        ]
        return Scene(self._scene.medium, moved, frequency=self._scene.frequency)


class PartSolver:
    """Solves parts of a hand, last phalanges as rigid bodies where they do not touch.

    Parameters
    ----------
    scene : of the live loop.
    """

    def __init__(self, scene: LiveScene) -> None:
        self._scene = scene
        self._rigid: RigidParts | None = None

    def solved(self, joints: Float64[np.ndarray, "25 3"], part: Rule, time: float) -> HandFactors:
        """Solve a part; parameters and errors are those of the function ``solved``."""
        if part == "phalanges":
            with suppress(InvalidInput):  # bodies that touch are solved as one
                if self._rigid is None or self._rigid.outgrown:
                    self._rigid = RigidParts(self._scene, joints)
                return self._rigid.solved(joints, time)
        return solved(self._scene, joints, part, time)


def rigid_part(hand: Hand, place: str) -> Surface:
    """Make the surface of the last phalanx, or the palm, as a body by itself."""
    some = np.array(hulls_of("phalanges", [place]))
    whole = hand.shape.hulls
    balls, parts = np.unique(whole.parts[some], return_inverse=True)
    missing = int(balls[0] == -1)  # of hulls of two balls
    tables = (
        np.ascontiguousarray(table[np.ix_(some, some)]) for table in (whole.blend, whole.apart)
    )
    hulls = Hulls(
        whole.balls[balls[missing:]], parts.reshape(-1, 3).astype(np.int64) - missing, *tables
    )
    return _surface(hulls, FINE)


def _mirrored(
    scene: LiveScene, riding: Riding, focus: Float64[np.ndarray, "3"]
) -> Complex64[np.ndarray, "elements"]:
    """Pressure by way of a hard plane, the palm, over the direct one at a focus: e^{2ikd cos θ}, d from the plane."""
    point, normal = riding.hand.position("palm")
    away = scene.sounding.array.positions - focus
    slant = away @ normal / np.linalg.norm(away, axis=1)
    path = 2.0 * float((focus - point) @ normal) * slant
    wavenumber = scene.medium.wavenumber(scene.frequency).real
    return np.where(slant > 0.0, np.exp(1j * wavenumber * path), 0.0).astype(np.complex64)


def _lengths(scene: LiveScene, joints: Float64[np.ndarray, "25 3"]) -> Float64[np.ndarray, "foci"]:
    """Length of the bone of each place [m]."""
    ends = np.array([bone_of(place) for place in scene.places])
    return np.linalg.norm(joints[ends[:, 1]] - joints[ends[:, 0]], axis=1)


def factors_of(
    scene: LiveScene,
    riding: Riding,
    part: Rule,
    time: float,
    received: Complex128[np.ndarray, "elements points"],
) -> HandFactors:
    """Divide the pressure of the beacons at the middles of the elements by that in open air."""
    points = beacon_points(scene, riding)
    open_air = monopole_pressure(
        scene.sounding.array.positions,
        points,
        np.eye(len(points), dtype=np.complex128),
        scene.medium.wavenumber(scene.frequency),
        "float64",
    )
    received = np.where(
        np.isfinite(received), received, 0.0
    )  # an image may be in skin that reaches behind the plane
    factors = np.ascontiguousarray((received / open_air).T.astype(np.complex64))
    return HandFactors(part, time, riding.foci, riding.distances, riding.directions, factors)


class OpenAir:
    """The transfer matrix of open air for an array that stands still, and foci that move.

    Parameters
    ----------
    scene : its array, medium and frequency count.
    """

    def __init__(self, scene: LiveScene) -> None:
        array = scene.sounding.array
        self._faces = np.ascontiguousarray(array.face_points.T, dtype=np.float32)  # (3, Q, E)
        self._weights = array.element.weights.astype(np.float32)
        self._strength = array.element.sensitivity * array.gains
        self._normals, self._heights = (
            array.normals,
            np.sum(array.positions * array.normals, axis=1),
        )
        self._directional = array.element.directional
        self._wavenumber = scene.medium.wavenumber(scene.frequency)

    def rows(self, foci: Float64[np.ndarray, "foci 3"]) -> Complex128[np.ndarray, "foci elements"]:
        """Pressure at foci (F, 3) per unit drive of each element [Pa]; 0 behind the face of a directional one.

        In single precision, right to 1e-4.
        """
        rows = np.empty((len(foci), len(self._strength)), dtype=np.complex128)
        for row, focus in zip(rows, foci.astype(np.float32), strict=True):
            away = self._faces - focus[:, None, None]
            away *= away
            distance = np.sqrt(away[0] + away[1] + away[2])
            phase = np.float32(self._wavenumber.real) * distance
            size = np.exp(np.float32(-self._wavenumber.imag) * distance) / distance
            row.real, row.imag = (
                self._weights @ (size * np.cos(phase)),
                self._weights @ (size * np.sin(phase)),
            )
        rows *= self._strength
        if self._directional:
            rows[foci @ self._normals.T < self._heights] = 0.0
        return rows
