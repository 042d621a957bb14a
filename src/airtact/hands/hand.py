"""A hand in a pose, computed from a tracker's joints: its closed skin for solvers and its pads.

``pinch`` is a simple model of a pinching hand, two capsules that represent thumb and index finger
(Inoue, Makino and Shinoda, 2014, section 4, with the simplifications that ``docs/architecture.md``
describes).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float64, Real

from airtact.acoustics.target_points import outward
from airtact.errors import (
    InvalidInput,
    fixed,
    in_mm,
    in_short,
    millimetres,
    number,
    of_kind,
    one_line,
    sides_in_mm,
    within,
)
from airtact.geometry.pose import Pose
from airtact.geometry.primitives import capsule
from airtact.geometry.surface import Surface
from airtact.hands.body import Hulls, Touch, hand_hulls
from airtact.hands.joints import (
    FINGERS,
    Joints,
    Place,
    Radii,
    Side,
    check_finger_order,
    checked_side,
    cross,
    crossed,
    joints_of,
    radii_of,
    unit,
)
from airtact.hands.kinematics import OUTER_JOINTS, finger_bones, opened
from airtact.hands.shape import HandShape
from airtact.hands.skin_mesh import even_skin, graded, midpoints

# Named positions on the skin of a hand.
PLACES = (*(f"{finger}.pad" for finger in FINGERS), "palm")


@runtime_checkable
class HasFront(Protocol):
    """Any object with positions and directions of elements, such as an array."""

    @property
    def positions(self) -> Float64[np.ndarray, "elements 3"]:
        """Positions (E, 3) of the elements [m]."""
        ...

    @property
    def normals(self) -> Float64[np.ndarray, "elements 3"]:
        """Directions (E, 3) in which the elements radiate."""
        ...


@dataclass(frozen=True, eq=False)
class Hand:
    """A hand in a pose, as returned by ``hand_from_joints``, which checks its arguments.

    ``surface`` is the skin, for a body of a ``Scene``, and ``place`` returns named points on it for
    a ``Target``. All coordinates are in the frame of ``joints``, which is arbitrary.

    Attributes
    ----------
    joints : (25, 3) positions of the joints in WebXR order [m].
    radii : (25,) radius of the skin around each joint [m].
    side : ``"right"`` or ``"left"``.
    follows : ``shape`` of an earlier pose of the same hand, called the keyframe; None (the default)
        if there is none. If both poses are similar, the meshes of the keyframe are deformed to this
        pose, which saves time.
    """

    joints: Joints
    radii: Radii
    side: Side
    follows: HandShape | None = None

    def __repr__(self) -> str:
        return one_line(self, self.side, f"joints within {sides_in_mm(self.joints)}")

    @cached_property
    def _body(self) -> tuple[Hulls, tuple[Touch, ...]]:
        return hand_hulls(self.joints, self.radii)

    @cached_property
    def shape(self) -> HandShape:
        """The exact body: blended hulls of balls along the bones."""
        return HandShape.following(self._body[0], self.follows)

    @property
    def touches(self) -> tuple[Touch, ...]:
        """Pairs of parts whose skins are merged because they are less than 0.3 mm apart."""
        return self._body[1]

    @cached_property
    def surface(self) -> Surface:
        """The closed skin: triangles whose corners and edge midpoints lie exactly on the body.

        The edges are 7 mm long, and 2.5 mm near the pads. Solvers generate their own panels.
        """
        hulls = self.shape.hulls
        skin = graded(hulls, even_skin(hulls, 7e-3), 7e-3, 2.5e-3, self.pads)
        return Surface(
            skin.vertices,
            skin.triangles,
            midpoints(hulls, skin),
            self.shape,
            repairs=tuple(touch.note for touch in self.touches),
        )

    @property
    def pads(self) -> Float64[np.ndarray, "5 3"]:
        """(5, 3) centre of each fingertip's pad on the skin [m], from thumb to little finger."""
        return self._pads[0]

    @cached_property
    def places(self) -> Mapping[str, Place]:
        """Named positions (3,) for foci [m], each with the outward unit normal (3,) of the skin.

        The names are ``"thumb.pad"``, ``"index.pad"``, ``"middle.pad"``, ``"ring.pad"``,
        ``"pinky.pad"``, ``"palm"``.
        """
        return {name: self.position(name) for name in PLACES}

    def position(self, name: str) -> Place:
        """Return the position (3,) [m] and normal (3,) of one of ``places``.

        Unlike ``place``, this method also accepts positions inside the body.

        Raises
        ------
        InvalidInput
            If the name is unknown.
        """
        if name not in PLACES:
            raise InvalidInput(
                f"{name!r} is not a place of a hand; use one of {', '.join(PLACES)}.",
                code="unknown_name",
            )
        if name == "palm":
            return self._palm
        points, normals = self._pads
        finger = PLACES.index(name)
        return points[finger], normals[finger]

    def place(self, name: str) -> Place:
        """Return a named position on the skin (3,) [m] and the outward unit normal there (3,).

        Parameters
        ----------
        name : one of ``places``.

        Raises
        ------
        InvalidInput
            If the name is unknown, or the position is inside the body because a finger touches it.
        """
        point, normal = self.position(name)
        # Exact places are on the skin to within rounding; deeper than 1 µm counts as inside.
        depth = float(self.shape.depth(point[None])[0])
        if depth > 1e-6:
            raise InvalidInput(
                f"{name} at {in_mm(point)} lies {millimetres(depth)} inside the body, because "
                "fingers touch there. Move them apart, for example with open_to(gap, first, "
                "second).",
                point,
                code="inside_body",
            )
        return point, normal

    def focus(self, name: str, offset: float = 0.5e-3) -> Float64[np.ndarray, "3"]:
        """Return the point (3,) in the air ``offset`` metres outside a named position [m].

        Raises
        ------
        InvalidInput
            If the name is unknown, the position is inside the body because a finger touches it, or
            the offset is negative or above 0.1 m.
        """
        point, normal = self.place(name)
        return point + within(offset, 0.0, 0.1, "the offset of a focus", "m") * normal

    def moved(self, pose: Pose) -> "Hand":
        """Return the hand moved rigidly: joints x become ``pose.apply(x)``."""
        of_kind(pose, Pose, "the motion of a hand", "Pose(rotation, translation)")
        return Hand(fixed(pose.apply(self.joints)), self.radii, self.side)

    def over(self, array: HasFront, height: float, place: str = "palm") -> "Hand":
        """Return the hand moved in front of an array, with a named position facing the array.

        Parameters
        ----------
        array : array whose elements all radiate to the same side, such as a board.
        height : distance of the position from the array's centre, along the array's mean normal
            [m].
        place : name of the position, one of ``places``.

        Returns
        -------
        The moved hand; this hand is unchanged.

        Raises
        ------
        InvalidInput
            If the height is not between 0 and 1 m, or if the elements face many directions, so that
            the array has no front. The error is also raised if ``place`` is unknown, or is inside
            the body because a finger touches it.
        """
        height = within(height, 0.0, 1.0, "the height of a hand", "m")
        point, normal = self.place(place)
        of_kind(array, HasFront, "the array", "one such as flat_boards(1, 1)")
        front = array.normals.mean(axis=0)
        # The mean is small if the unit normals mostly cancel: 0 for a box, 0.5 for a hemisphere.
        if np.linalg.norm(front) < 0.3:
            raise InvalidInput(
                "the elements of the array face many directions, so it has no front; use "
                "moved(pose).",
                code="misplaced",
            )
        front = front / np.linalg.norm(front)
        turned = Pose.between(normal, -front)
        goal = array.positions.mean(axis=0) + height * front
        return self.moved(Pose(turned.rotation, goal - turned.apply(point)))

    def open_to(self, gap: float, first: str = "thumb", second: str = "index") -> "Hand":
        """Return the hand with two fingers turned at their roots to set the gap between them.

        Parameters
        ----------
        gap : distance between the skins of the last phalanges [m], above 0 and at most 0.15.
        first, second : names of the fingers: "thumb", "index", "middle", "ring" or "pinky".

        Returns
        -------
        The hand with the new joints; this hand is unchanged.

        Raises
        ------
        InvalidInput
            If the gap is outside its range or cannot be reached, or if a finger is unknown.
        """
        gap = within(gap, 0.0, 0.15, "gap", "m")
        if first not in FINGERS or second not in FINGERS or first == second:
            raise InvalidInput(
                f"{first!r} and {second!r} are not two fingers; use two of {', '.join(FINGERS)}.",
                code="unknown_name",
            )
        pair = (FINGERS.index(first), FINGERS.index(second))
        joints = opened(self.joints, self.radii, self.side, pair, gap)
        return hand_from_joints(joints, self.radii, side=self.side)

    def posed(self, joints: Real[np.ndarray, "joints 3"]) -> "Hand":
        """Return the same hand in the pose of the next frame of a sequence.

        If the motion is small, the meshes keep their triangles. The meshes depend only on the poses
        of the sequence, and not on which meshes were computed before.

        Parameters
        ----------
        joints : (25, 3) or (21, 3) joints of the new pose [m].

        Returns
        -------
        The hand in its new pose, with the same radii.

        Raises
        ------
        InvalidInput
            If joints are missing, NaN or in millimetres, or do not form a plausible hand of the
            same side.
        """
        # The radii are kept, because skin does not swell from one frame to the next.
        new = hand_from_joints(joints, self.radii, side=self.side)
        return Hand(new.joints, new.radii, new.side, self.shape.keyframe)

    @cached_property
    def _pads(self) -> tuple[Float64[np.ndarray, "5 3"], Float64[np.ndarray, "5 3"]]:
        """Centres of the fingertips' pads [m], and the normals there."""
        share = 0.55  # position of the pads along the last bones
        along, lengths, hinges = (
            of_bones[:, -1] for of_bones in finger_bones(self.joints, self.side)
        )
        roots, tips = OUTER_JOINTS[:, -2:].T
        # A pad faces the direction in which its finger bends. The skin of the last bone is a cone,
        # whose normal leans toward the tip by the taper.
        out = crossed(hinges, along)
        taper = ((self.radii[roots] - self.radii[tips]) / lengths)[:, None]
        normals = np.sqrt(np.maximum(1.0 - taper**2, 0.0)) * out + taper * along
        radii = (1.0 - share) * self.radii[roots] + share * self.radii[tips]
        centres = self.joints[roots] + share * lengths[:, None] * along
        return fixed(centres + radii[:, None] * normals), fixed(normals)

    @cached_property
    def _palm(self) -> Place:
        back = unit(cross(self.joints[11] - self.joints[0], self.joints[6] - self.joints[21]))
        inwards = back if self.side == "right" else -back
        # The search starts between the metacarpals of the four fingers, 30 mm outside the skin.
        point = self.joints[[5, 6, 10, 11, 15, 16, 20, 21]].mean(axis=0) - 0.03 * inwards
        skin = self.shape.hulls.look(point[None])
        for _ in range(60):
            distance = float(skin.distance[0])
            if abs(distance) < 1e-9 or distance < -1e-3:  # inside a finger that covers the palm
                break
            # Sphere tracing: no step is longer than the distance, so the search stops at the skin.
            # Near the skin, Newton's method takes fewer steps.
            slope = -float(skin.gradient[0] @ inwards)
            step = 0.8 * distance if abs(distance) > 1e-3 else distance / max(slope, 0.5)
            point = point + step * inwards
            skin = self.shape.hulls.look(point[None])
        return fixed(point), fixed(unit(skin.gradient[0]))


def hand_from_joints(
    positions: Real[np.ndarray, "joints 3"],
    radii: Real[np.ndarray, "joints"] | None = None,
    length: float | None = None,
    side: Side | None = None,
) -> Hand:
    """Build a hand from the joints of a tracker.

    Parameters
    ----------
    positions : (25, 3) joints in WebXR order, (26, 3) in OpenXR order (the palm is ignored), or
        (21, 3) in MediaPipe and Leap order (the other joints are estimated), in any frame [m].
    radii : (25,), (26,) or (21,) distance of the skin from each joint, in the order of
        ``positions`` [m], 0.003 to 0.035; by default the radii of a generic hand of the same
        length.
    length : length of the hand along the bones, from the wrist to the tip of the middle finger [m],
        0.08 to 0.3. It scales the generic radii, not the joints; by default it is measured from the
        joints. It is ignored if ``radii`` are given.
    side : ``"right"`` or ``"left"``; by default it is inferred from how the fingers bend.

    Returns
    -------
    A ``Hand`` in the frame of ``positions``, with 25 joints in WebXR order.

    Raises
    ------
    InvalidInput
        If joints are missing or NaN, or span more than 1 m, if bones have impossible lengths, if
        fingers are out of order, if ``length`` or a radius is outside its range, or if the fingers
        bend like those of the other hand or, without ``side``, are too straight to determine it.
    """
    # The order of checks matters: swapped fingers would be reported as an unclear side.
    joints = joints_of(positions)
    check_finger_order(joints)
    return Hand(joints, radii_of(radii, length, joints), checked_side(joints, side))


def places_on(surface: Surface, hand: Hand) -> Mapping[str, Place]:
    """Find the named positions of a hand on another surface of the same hand, such as a scan.

    Use the function to place foci on a scanned skin by name, such as "index.pad".

    Parameters
    ----------
    surface : surface of the hand, in the frame and the pose of ``hand``.
    hand : hand built from the joints of the scanned hand.

    Returns
    -------
    A mapping from each name in ``hand.places`` to a tuple: the point (3,) of the surface nearest to
    the position on ``hand`` [m], and the outward unit normal (3,) at this point.

    Raises
    ------
    InvalidInput
        If a position on ``hand`` is more than 10 mm from the surface, or its normal deviates by
        more than 60 degrees from that of the surface. Possible causes are joints in another
        frame or pose, and fingers that touch.
    """
    of_kind(surface, Surface, "the surface", "one Surface, such as load_surface(path)")
    of_kind(hand, Hand, "the hand", "one Hand, such as load_rigged_hand(path)")
    points = np.array([point for point, _ in hand.places.values()])
    expected = np.array([normal for _, normal in hand.places.values()])
    nearest = surface.shape.project(points)
    normals = outward(surface.depth, nearest)
    distances = np.linalg.norm(nearest - points, axis=1)
    angles = np.degrees(np.arccos(np.clip(np.einsum("pi,pi->p", normals, expected), -1.0, 1.0)))
    for index, name in enumerate(hand.places):
        # In four scanned hands in five poses, all places are within 5 mm and 12 degrees.
        if distances[index] > 10e-3:
            fault = f"{millimetres(distances[index], 3)} from the surface (10 mm is allowed)"
        elif angles[index] > 60.0:
            fault = f"turned from the surface by {angles[index]:.0f} degrees (60 are allowed)"
        else:
            continue
        raise InvalidInput(
            f"{name}, as computed from the joints, is {fault}. Check that the joints and the "
            "mesh belong to the same hand, in the same pose and frame, in metres.",
            points[index],
            code="misplaced",
        )
    return {
        name: (fixed(nearest[index]), fixed(normals[index]))
        for index, name in enumerate(hand.places)
    }


# Radius of a finger [m].
RADIUS = 8e-3

# Length of a finger's axis [m].
LENGTH = 44e-3

# Angle between each finger and the vertical [rad].
SPREAD = math.radians(20.0)


@dataclass(frozen=True, eq=False)
class Pinch:
    """A thumb and a finger whose tips face each other along x, as returned by ``pinch``.

    The origin is the middle of the gap between the tips, from which thumb and finger run downward
    (-z). In each attribute, the thumb comes first.

    Attributes
    ----------
    surfaces : the ``Surface`` of the thumb (at -x) and of the finger (at +x), for bodies such as
        ``sound_hard(surface)``.
    pads : (2, 3) point on each skin that is nearest to the other skin [m].
    normals : (2, 3) outward unit normals at the pads, along +x and -x.
    gap : distance between the pads [m].
    """

    surfaces: tuple[Surface, Surface]
    pads: Float64[np.ndarray, "2 3"]
    normals: Float64[np.ndarray, "2 3"]
    gap: float

    __repr__ = in_short

    def foci(self, offset: float = 0.5e-3) -> Float64[np.ndarray, "2 3"]:
        """Return one point in front of each pad, as an array (2, 3) [m].

        Parameters
        ----------
        offset : distance from the skin into the gap [m]; 0 for points on the skin.

        Raises
        ------
        InvalidInput
            If the offset is negative or reaches the other finger.
        """
        offset = number(offset, "the offset of the foci", "m")
        if not 0.0 <= offset < self.gap:
            raise InvalidInput(
                f"foci {offset * 1e3:g} mm from the pads do not lie in the gap of "
                f"{self.gap * 1e3:g} mm. Use an offset that is at least 0 and less than the gap.",
                code="out_of_range",
            )
        return self.pads + offset * self.normals


def pinch(gap: float = 0.012, edge: float = 2.5e-3) -> Pinch:
    """Build the thumb and the finger of a pinch, as two capsules with a radius of 8 mm.

    The origin is the middle of the gap; the thumb is at -x and the finger at +x. The centres of
    their rounded tips are at (∓(gap/2 + 8 mm), 0, 0). From there, their axes run 44 mm downward
    (-z), tilted outward by 20° from the vertical.

    Parameters
    ----------
    gap : distance between the two skins [m], above zero and at most 0.2.
    edge : largest edge length of the triangles [m]. The mesh is used only for pictures and files;
        solvers use the exact capsules.

    Returns
    -------
    A ``Pinch`` that contains the surfaces of thumb and finger, and the point of each skin that is
    nearest to the other skin (its pad), with the normal there.

    Raises
    ------
    InvalidInput
        If a length is not above zero, or the gap exceeds 0.2 m.

    Examples
    --------
    >>> pinch(gap=0.012).pads.tolist()
    [[-0.006, 0.0, 0.0], [0.006, 0.0, 0.0]]
    """
    gap = within(gap, 0.0, 0.2, "gap", "m")
    side = np.array([-1.0, 1.0])
    tips = np.outer(side, [gap / 2.0 + RADIUS, 0.0, 0.0])
    roots = tips + LENGTH * np.stack(
        [side * math.sin(SPREAD), np.zeros(2), np.full(2, -math.cos(SPREAD))], axis=1
    )
    return Pinch(
        (capsule(roots[0], tips[0], RADIUS, edge), capsule(roots[1], tips[1], RADIUS, edge)),
        # Adding zero turns -0.0 into 0.0.
        pads=fixed(np.outer(side, [gap / 2.0, 0.0, 0.0]) + 0.0),
        normals=fixed(np.outer(-side, [1.0, 0.0, 0.0]) + 0.0),
        gap=gap,
    )
