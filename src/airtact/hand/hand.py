"""The hand itself: from the joints of a tracker to a closed skin that solvers take, and its pads."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, cast

import numpy as np
from jaxtyping import Float64, Real

from airtact.conventions import InvalidInput
from airtact.hand.anatomy_parts import Touch, hand_hulls
from airtact.hand.joints import (
    CHAINS,
    FINGERS,
    evidence_of,
    joints_of,
    radii_of,
    refuse_swapped_fingers,
    side_of,
    unit,
)
from airtact.hand.kinematics import bending_axis, opened
from airtact.hand.shape import HandShape
from airtact.hand.skin_mesh import Graded, even_skin, midpoints
from airtact.hand.sphere_mesh import Hulls
from airtact.printing import in_short
from airtact.surfaces.surface import Surface
from airtact.validation import fixed, in_mm, within

COARSE, FINE = 7e-3, 2.5e-3
"""Edges of the triangles of ``Hand.surface`` far from the pads and beside them [m]; solvers make their own panels."""

PAD = 0.55
"""Share of the last bone at which its pad lies."""

WIDEST = 0.15
"""Widest gap that a hand is opened to [m]."""

TRIED = (0.5e-3, 1e-3, 2e-3, 3e-3, 4e-3, 6e-3, 8e-3, 12e-3, 16e-3, 20e-3)
"""Gaps that are tried to free a pad [m]."""

Side = Literal["right", "left"]


@dataclass(frozen=True, eq=False)
class Hand:
    """A hand in a pose; built by ``hand_from_joints``.

    Attributes
    ----------
    joints : (25, 3) in the order of WebXR [m].
    radii : (25,) of the skin round each joint [m].
    side : ``"right"`` or ``"left"``.
    follows : in a sequence the keyframe whose meshes are deformed to this hand's where it is near, else None.
    """

    joints: Float64[np.ndarray, "25 3"]
    radii: Float64[np.ndarray, "25"]
    side: Side
    follows: HandShape | None = None

    __repr__ = in_short

    @cached_property
    def shape(self) -> HandShape:
        """The exact body: hulls of balls along the bones, creases filled."""
        return HandShape.following(self._built[0], self.follows)

    @property
    def touches(self) -> tuple[Touch, ...]:
        """Where parts that stand apart in an open hand are so near, under 0.3 mm, that their skins are one here."""
        return self._built[1]

    @cached_property
    def surface(self) -> Surface:
        """The closed skin, with exact points over the middles of edges; fine at the pads, coarse at the wrist."""
        skin = even_skin(self.shape.hulls, COARSE, Graded(COARSE, FINE, self.pads))
        notes = tuple(touch.note for touch in self.touches)
        middles = midpoints(self.shape.hulls, skin)
        return Surface(skin.vertices, skin.triangles, middles, self.shape, repairs=notes)

    @cached_property
    def pads(self) -> Float64[np.ndarray, "5 3"]:
        """The point of the skin in the middle of each fingertip's pad, thumb to little finger (5, 3) [m]."""
        return fixed(np.array([self._pad(finger)[0] for finger in range(5)]))

    @cached_property
    def places(self) -> Mapping[str, tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]]:
        """Points of the skin [m] that a target can name, and the outward normals there.

        They are ``"thumb.pad"``, ``"index.pad"``, ``"middle.pad"``, ``"ring.pad"``, ``"pinky.pad"`` and ``"palm"``.
        """
        named = {f"{finger}.pad": self._pad(index) for index, finger in enumerate(FINGERS)}
        return named | {"palm": self._palm()}

    def place(self, name: str) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]:
        """Find a named place (3,) [m] and the outward normal there (3,).

        Parameters
        ----------
        name : one of ``places``.

        Raises
        ------
        InvalidInput
            When there is no such place, or it lies inside the body because a finger touches it: how deep, and the gap
            to open the hand to that would free it.
        """
        if name not in self.places:
            raise InvalidInput(f"{name!r} is not 1 of the places of a hand: {', '.join(self.places)}.")
        point, normal = self.places[name]
        depth = float(self.shape.depth(point[None])[0])
        if depth > 1e-6:
            raise InvalidInput(
                f"{name} at {in_mm(point)} lies {1e3 * depth:.2g} mm inside the body, where skins are one"
                f"{self._freeing(name)}.",
                point,
            )
        return point, normal

    def open_to(self, gap: float, one: str = "thumb", other: str = "index") -> "Hand":
        """Turn the roots of two fingers until the skins of their last phalanges are a gap apart.

        Parameters
        ----------
        gap : the distance wanted, above zero and at most 0.15 [m].
        one, other : "thumb", "index", "middle", "ring" or "pinky".

        Raises
        ------
        InvalidInput
            When the gap is not such a length, a finger is unknown, or the fingers cannot be brought there: how near or
            far they come.
        """
        gap = within(gap, 0.0, WIDEST, "gap", "m", "is it in millimetres? Give metres.")
        for name in (one, other):
            if name not in FINGERS or one == other:
                raise InvalidInput(f"fingers {one!r} and {other!r} are not 2 of {', '.join(FINGERS)}.")
        joints = opened(self.joints, self.radii, self.side, (FINGERS.index(one), FINGERS.index(other)), gap)
        return hand_from_joints(joints, self.radii, side=self.side)

    def posed(self, joints: Real[np.ndarray, "joints 3"]) -> "Hand":
        """Take the next frame of the same hand, whose meshes keep their triangles where the motion is small.

        Its meshes follow from this pose, the new one and those before, and from nothing that was asked of any of them.

        Parameters
        ----------
        joints : (25, 3) or (21, 3) joints of the new pose [m].

        Raises
        ------
        InvalidInput
            As ``hand_from_joints``.
        """
        new = hand_from_joints(joints, self.radii, side=self.side)
        return Hand(new.joints, new.radii, new.side, self.shape.keyframe)

    @cached_property
    def _built(self) -> tuple[Hulls, tuple[Touch, ...]]:
        return hand_hulls(self.joints, self.radii)

    def _pad(self, finger: int) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]:
        root, tip = CHAINS[finger][-2:]
        bone = unit(self.joints[tip] - self.joints[root])
        out = unit(np.cross(bending_axis(self.joints, self.side, finger), bone))
        start = self.joints[root] + PAD * (self.joints[tip] - self.joints[root])
        slope = (self.radii[root] - self.radii[tip]) / float(np.linalg.norm(self.joints[tip] - self.joints[root]))
        normal = math.sqrt(max(1.0 - slope**2, 0.0)) * out + slope * bone
        radius = (1.0 - PAD) * self.radii[root] + PAD * self.radii[tip]
        return fixed(start + radius * normal), fixed(normal)

    def _palm(self) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]:
        back = np.cross(self.joints[11] - self.joints[0], self.joints[6] - self.joints[21])
        back = unit(back) if self.side == "right" else -unit(back)
        middle = self.joints[[5, 6, 10, 11, 15, 16, 20, 21]].mean(axis=0)
        start = middle - 0.03 * back
        for _ in range(60):  # along the ray, never farther than the distance: it stops at the first skin
            distance = float(self.shape.hulls.look(start[None]).distance[0])
            if distance < 1e-9:
                break
            start = start + 0.8 * distance * back
        normal = unit(self.shape.hulls.look(start[None]).gradient[0])
        return fixed(start), fixed(normal)

    def _freeing(self, name: str) -> str:
        finger = name.removesuffix(".pad")
        other = "index" if finger == "thumb" else "thumb"
        if finger not in FINGERS:
            return "; move the fingers away from it"
        for gap in TRIED:
            try:
                free = self.open_to(gap, finger, other)
            except InvalidInput:
                continue
            if float(free.shape.depth(free.places[name][0][None])[0]) <= 1e-6:
                return f"; open_to({gap:g}, {finger!r}, {other!r}), a gap of {1e3 * gap:g} mm, would free it"
        return "; move the fingers away from it"


def hand_from_joints(
    positions: Real[np.ndarray, "joints 3"],
    radii: Real[np.ndarray, "joints"] | None = None,
    length: float | None = None,
    side: Side | None = None,
) -> Hand:
    """Build a hand from the joints of a tracker.

    Parameters
    ----------
    positions : (25, 3) joints in the order of WebXR, or (21, 3) in that of MediaPipe and Leap [m].
    radii : (25,) or (21,) of the skin round each joint [m]; those of a generic hand of that size unless given.
    length : of the hand, wrist to the tip of the middle finger along the bones [m], which sets radii that are not
        given; taken from the joints unless given.
    side : ``"right"`` or ``"left"``; told from the bends of the fingers unless given.

    Raises
    ------
    InvalidInput
        Joints missing, NaN or in millimetres; a bone of impossible length, or fingers out of order, as joints that are
        swapped make; radii
        that no hand has; a side that the bends contradict, or that they leave open and is not given.
    """
    joints = joints_of(positions)
    refuse_swapped_fingers(joints)
    sizes = radii_of(radii, length, joints)
    seen = side_of(joints)
    if side is not None and side not in ("right", "left"):
        raise InvalidInput(f"the side of a hand is {side!r}, but there are 2: 'right' and 'left'.")
    if side is None and seen == "unknown":
        raise InvalidInput("the 5 fingers are too straight to tell a left hand from a right one; give side.")
    if side is not None and seen not in (side, "unknown"):
        raise InvalidInput(
            f"the joints are said to be of a {side} hand, but the fingers bend and the thumb points as those of a "
            f"{seen} one ({evidence_of(joints):+.2f}, above 0 being right): are they mirrored?"
        )
    return Hand(joints, sizes, side or cast("Side", seen))
