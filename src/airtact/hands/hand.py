"""A hand in a pose: the joints of a tracker give its closed skin, which solvers take, and its pads."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float64, Real

from airtact.checks import fixed, in_mm, within
from airtact.errors import InvalidInput
from airtact.geometry.surface import Surface
from airtact.hands.anatomy_parts import Touch, hand_hulls
from airtact.hands.joints import (
    CHAINS,
    FINGERS,
    Side,
    check_finger_order,
    checked_side,
    cross,
    joints_of,
    radii_of,
    unit,
)
from airtact.hands.kinematics import bending_axis, opened
from airtact.hands.shape import HandShape
from airtact.hands.skin_mesh import even_skin, graded, midpoints
from airtact.hands.sphere_mesh import Hulls
from airtact.printing import html_table, one_line, sides_in_mm

COARSE, FINE = 7e-3, 2.5e-3
"""Edges of the triangles of ``Hand.surface`` far from the pads and beside them [m]; solvers make their own panels."""

PAD = 0.55
"""Position of the pad along the last bone, over its length."""

PLACES = (*(f"{finger}.pad" for finger in FINGERS), "palm")
"""Named positions on the skin of a hand."""

WIDEST = 0.15
"""Widest gap that a hand is opened to [m]."""

TRIED = (0.5e-3, 1e-3, 2e-3, 3e-3, 4e-3, 6e-3, 8e-3, 12e-3, 16e-3, 20e-3)
"""Gaps that are tried to free a pad [m]."""


@dataclass(frozen=True, eq=False)
class Hand:
    """A hand in a pose; ``hand_from_joints`` builds it.

    Attributes
    ----------
    joints : (25, 3) in the order of WebXR [m].
    radii : (25,) of the skin round each joint [m].
    side : ``"right"`` or ``"left"``.
    follows : in a sequence the keyframe whose meshes are deformed to this hand's where it is near,
        else None.
    """

    joints: Float64[np.ndarray, "25 3"]
    radii: Float64[np.ndarray, "25"]
    side: Side
    follows: HandShape | None = None

    def __repr__(self) -> str:
        return one_line(self, self.side, f"joints within {sides_in_mm(self.joints)}")

    def _repr_html_(self) -> str:
        rows = [
            [name, *(f"{1e3 * number:.1f}" for number in point)]
            for name, (point, _) in self.places.items()
        ]
        title = f"Hand: {self.side}, joints within {sides_in_mm(self.joints)}"
        return html_table(title, ["place", "x [mm]", "y [mm]", "z [mm]"], rows)

    @cached_property
    def shape(self) -> HandShape:
        """The exact body: blended hulls of balls along the bones."""
        return HandShape.following(self._built[0], self.follows)

    @property
    def touches(self) -> tuple[Touch, ...]:
        """Where the skins of parts that stand apart in an open hand are nearer than 0.3 mm and therefore one."""
        return self._built[1]

    @cached_property
    def surface(self) -> Surface:
        """The closed skin, with exact points over the middles of edges; fine at the pads, coarse elsewhere."""
        hulls, notes = self.shape.hulls, tuple(touch.note for touch in self.touches)
        skin = graded(hulls, even_skin(hulls, COARSE), COARSE, FINE, self.pads)
        return Surface(
            skin.vertices, skin.triangles, midpoints(hulls, skin), self.shape, repairs=notes
        )

    @cached_property
    def pads(self) -> Float64[np.ndarray, "5 3"]:
        """The middle of each fingertip's pad on the skin, thumb to little finger (5, 3) [m]."""
        return fixed(np.array([self._pad(finger)[0] for finger in range(5)]))

    @cached_property
    def places(self) -> Mapping[str, tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]]:
        """Positions on the skin (3,) [m] that a target can name, and the outward unit normals there (3,).

        The names are ``"thumb.pad"``, ``"index.pad"``, ``"middle.pad"``, ``"ring.pad"``,
        ``"pinky.pad"``, ``"palm"``.
        """
        return {name: self.position(name) for name in PLACES}

    def position(self, name: str) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]:
        """Find one of ``places`` alone (3,) [m] and its outward unit normal (3,), even where it lies inside the body.

        Raises
        ------
        InvalidInput
            The name is unknown.
        """
        if name not in PLACES:
            raise InvalidInput(
                f"{name!r} is not 1 of the places of a hand: {', '.join(PLACES)}.",
                code="unknown_name",
            )
        return self._palm if name == "palm" else self._pad(PLACES.index(name))

    def place(self, name: str) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]:
        """Find a named position on the skin (3,) [m] and the outward unit normal there (3,).

        Parameters
        ----------
        name : one of ``places``.

        Raises
        ------
        InvalidInput
            The name is unknown, or the position lies inside the body because a finger touches it; the sentence has the
            depth and the gap that frees the position.
        """
        point, normal = self.position(name)
        depth = float(self.shape.depth(point[None])[0])
        if depth > 1e-6:
            raise InvalidInput(
                f"{name} at {in_mm(point)} lies {1e3 * depth:.2g} mm inside the body, where skins are one"
                f"{self._freeing(name)}.",
                point,
                code="inside_body",
            )
        return point, normal

    def open_to(self, gap: float, one: str = "thumb", other: str = "index") -> "Hand":
        """Turn two fingers about their roots until the skins of their last phalanges are a gap apart.

        Parameters
        ----------
        gap : the distance wanted, above zero and at most 0.15 [m].
        one, other : "thumb", "index", "middle", "ring" or "pinky".

        Raises
        ------
        InvalidInput
            The gap is out of range, a finger is unknown, or no turn gives the gap; the sentence has the gaps that turns
            give.
        """
        gap = within(gap, 0.0, WIDEST, "gap", "m", "is it in millimetres? Give metres.")
        for name in (one, other):
            if name not in FINGERS or one == other:
                raise InvalidInput(
                    f"fingers {one!r} and {other!r} are not 2 of {', '.join(FINGERS)}.",
                    code="unknown_name",
                )
        joints = opened(
            self.joints, self.radii, self.side, (FINGERS.index(one), FINGERS.index(other)), gap
        )
        return hand_from_joints(joints, self.radii, side=self.side)

    def posed(self, joints: Real[np.ndarray, "joints 3"]) -> "Hand":
        """Return the next frame of the same hand, whose meshes keep their triangles where the motion is small.

        Its meshes depend on the poses of the sequence alone, and not on what was computed of
        earlier frames.

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
        out = unit(cross(bending_axis(self.joints, self.side, finger), bone))
        start = self.joints[root] + PAD * (self.joints[tip] - self.joints[root])
        taper = (self.radii[root] - self.radii[tip]) / float(
            np.linalg.norm(self.joints[tip] - self.joints[root])
        )
        normal = math.sqrt(max(1.0 - taper**2, 0.0)) * out + taper * bone
        radius = (1.0 - PAD) * self.radii[root] + PAD * self.radii[tip]
        return fixed(start + radius * normal), fixed(normal)

    @cached_property
    def _palm(self) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]:
        back = cross(self.joints[11] - self.joints[0], self.joints[6] - self.joints[21])
        back = unit(back) if self.side == "right" else -unit(back)
        middle = self.joints[[5, 6, 10, 11, 15, 16, 20, 21]].mean(axis=0)
        start = middle - 0.03 * back
        for _ in range(
            60
        ):  # sphere tracing: no step is longer than the distance, so that it ends at the first skin
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
    radii : (25,) or (21,) of the skin round each joint [m]; those of a generic hand of that size
        unless given.
    length : of the hand, wrist to the tip of the middle finger along the bones [m]. It scales the
        generic radii; taken from the joints unless given.
    side : ``"right"`` or ``"left"``; found from the bends of the fingers unless given.

    Raises
    ------
    InvalidInput
        Joints missing, NaN or in millimetres; a bone of impossible length; fingers out of order, because joints are
        swapped; radii that no hand has; a side that the bends contradict, or that they leave open and is not given.
    """
    joints = joints_of(positions)
    check_finger_order(joints)
    sizes = radii_of(radii, length, joints)
    return Hand(joints, sizes, checked_side(joints, side))
