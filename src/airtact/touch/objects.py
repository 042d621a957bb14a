"""Virtual objects: shapes in mid-air that can be felt but do not affect the sound."""

from collections.abc import Iterable, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Float64, Real

from airtact.errors import (
    InvalidInput,
    check_choice,
    millimetres,
    of_kind,
    one_line,
    positive,
    shaped,
)
from airtact.geometry.mesh.triangles import FlatMesh, PointLengths, Vector3
from airtact.geometry.pose import Pose
from airtact.geometry.surface import Surface
from airtact.touch.solids import Button, Solid, near_point, solid_of
from airtact.touch.textures import Grating, HeightMap

MAX_OBJECTS = 64
"""Largest number of virtual objects."""

# Smallest radius of the ball around an object [m].
MIN_RADIUS = 2e-3

# Strength at first touch, as a share of full strength.
FIRST_STRENGTH = 0.2


@dataclass(frozen=True, eq=False)
class VirtualObject:
    """A solid that can be felt but does not affect the sound.

    ``contact`` finds the skin of a hand inside the object. Foci on this skin make it perceptible;
    the pressure at a focus is proportional to the strength of the touch, from 0 (no sound) to 1
    (the largest pressure that the array is allowed to produce).

    Attributes
    ----------
    shape : a closed ``Surface``, such as ``at.sphere(...)``; or a ``Box``, ``Cylinder``,
        ``HalfSpace`` or ``Button`` from ``at.touch``. The ball around it must have a diameter of at
        least 4 mm. Except at the finger pads, the live loop may miss objects smaller than 10 mm,
        because they fit between its skin points.
    pose : ``Pose`` that maps the coordinates of ``shape`` to those of the skin, which are scene
        coordinates; None if both are the same.
    name : name of the object in results; unnamed objects are called "object 1" and so on.
    style : "points" places foci where the skin is deepest; "outline" moves a focus along the curve
        where the skin meets the object's surface; "texture" is like "points", but multiplies each
        strength by the height of ``texture``, 0 to 1, at that point. ``Contacts.target`` rejects
        contacts with both "outline" and other styles; the live loop combines them.
    stiffness : increase of the strength per metre of depth [1/m]. The strength is 0.2 at depth 0,
        rises linearly with the depth of the skin inside the object, and is limited to 1. By
        default, it reaches 1 at a depth of 2 mm or, for a ``Button``, at its travel.
    texture : a ``Grating`` or ``HeightMap`` in the coordinates of ``shape``; required for the style
        "texture", and not allowed for the others.

    Raises
    ------
    InvalidInput
        If an argument has the wrong type, the shape is too small, the style is unknown, the
        stiffness is not above zero, or the texture is missing or not allowed. The error is also
        raised if ``pose`` places the centre of the shape (the point of a half-space) more than 2 m
        from the origin of the scene.

    Examples
    --------
    >>> import airtact as at
    >>> ball = VirtualObject(at.sphere(0.012, edge=0.003), at.Pose.shift((0, 0, 0.1)), "ball")
    >>> ball.depth(np.array([[0.0, 0.0, 0.09]])).round(6).tolist()
    [0.002]
    """

    shape: Surface | Solid
    pose: Pose | None = None
    name: str = ""
    _: KW_ONLY
    style: Literal["points", "outline", "texture"] = "points"
    stiffness: float | None = None
    texture: Grating | HeightMap | None = None

    def __post_init__(self) -> None:
        of_kind(
            self.shape,
            Surface | Solid,
            "the shape of a virtual object",
            "one such as at.sphere(radius, edge) or at.touch.Box(sides)",
        )
        if self.pose is not None:
            of_kind(self.pose, Pose, "the pose of a virtual object", "Pose(rotation, translation)")
        of_kind(self.name, str, "the name of a virtual object", 'a text such as "ball"')
        check_choice(self.style, "the style of a virtual object", ("points", "outline", "texture"))
        name = f"the object {self.name}".rstrip()
        centre, radius = self.ball
        near_point(centre, f"the centre of {name}")
        if radius < MIN_RADIUS * (1.0 - 1e-6):
            raise InvalidInput(
                f"{name} is {millimetres(2.0 * radius)} across and would fit between the points of "
                f"the skin: make it at least {millimetres(2.0 * MIN_RADIUS)} across.",
                code="out_of_range",
            )
        if self.stiffness is not None:
            positive(self.stiffness, "the stiffness of a virtual object", "1/m")
        if (self.texture is None) == (self.style == "texture"):
            raise InvalidInput(
                'style = "texture" requires a texture, such as at.touch.Grating(pitch); the other '
                "styles do not use one.",
                code="options_clash",
            )
        if self.texture is not None:
            of_kind(self.texture, Grating | HeightMap, "a texture", "one of these")

    def __repr__(self) -> str:
        return one_line(self, self.name, type(self.shape).__name__.lower(), self.style)

    def moved(self, pose: Pose) -> "VirtualObject":
        """Return a copy of the object, rotated and translated by ``pose`` in the scene."""
        of_kind(pose, Pose, "the motion of a virtual object", "Pose(rotation, translation)")
        return replace(self, pose=pose if self.pose is None else pose @ self.pose)

    @property
    def solid(self) -> Solid:
        """The solid in its own frame."""
        return solid_of(self.shape) if isinstance(self.shape, Surface) else self.shape

    @cached_property
    def ball(self) -> tuple[Vector3, float]:
        """Centre (3,) and radius [m] of an enclosing ball; a half-space has an infinite radius."""
        centre, radius = self.solid.ball()
        return (centre if self.pose is None else self.pose.apply(centre)), radius

    @property
    def mesh(self) -> FlatMesh:
        """Vertices (V, 3) [m] and triangles (T, 3) for display, at the object's pose."""
        vertices, triangles = self.solid.mesh()
        return (vertices if self.pose is None else self.pose.apply(vertices)), triangles

    def depth(self, points: Real[np.ndarray, "points 3"]) -> PointLengths:
        """Return the depth (P,) [m] of points (P, 3) in the object, negative outside.

        Depths in a mesh are interpolated on a grid whose spacing is 1/40 of the longest side. Use
        ``exact_depth`` for exact depths.
        """
        return self.solid.depth(self._local(points))

    def exact_depth(self, points: Real[np.ndarray, "points 3"]) -> PointLengths:
        """Return the depth (P,) [m] of points (P, 3) in the object, without interpolation."""
        return self.solid.exact_depth(self._local(points))

    def strengths(
        self, points: Real[np.ndarray, "points 3"], depths: PointLengths
    ) -> Float64[np.ndarray, "points"]:
        """Return the strength (P,), 0 to 1, of touches at points (P, 3) and depths (P,) [m]."""
        stiffness = self.stiffness
        if stiffness is None:
            full_at = self.shape.travel if isinstance(self.shape, Button) else 2e-3
            stiffness = (1.0 - FIRST_STRENGTH) / full_at
        # Start at a fifth of full strength, because a weaker first touch could not be felt.
        points = shaped(points, (-1, 3), "points")
        depths = shaped(depths, points.shape[:1], "depths")
        strengths = np.minimum(FIRST_STRENGTH + stiffness * np.maximum(depths, 0.0), 1.0)
        if self.texture is None:
            return strengths
        return strengths * self.texture.heights(self._local(points))

    def _local(self, points: Real[np.ndarray, "points 3"]) -> Real[np.ndarray, "points 3"]:
        return points if self._inverse is None else self._inverse.apply(points)

    @cached_property
    def _inverse(self) -> Pose | None:
        return None if self.pose is None else self.pose.inverse()


def objects_of(objects: "VirtualObject | Sequence[VirtualObject]") -> tuple[VirtualObject, ...]:
    """Check virtual objects, and name unnamed ones "object 1" and so on.

    Raises
    ------
    InvalidInput
        If there are more than 64 objects, two have the same name, or one has the wrong type.
    """
    if isinstance(objects, VirtualObject):
        objects = (objects,)
    if not isinstance(objects, Iterable):
        of_kind(objects, VirtualObject, "the virtual object", "VirtualObject(shape)")
    listed = list(objects)
    if len(listed) > MAX_OBJECTS:
        raise InvalidInput(
            f"there are {len(listed)} virtual objects, but at most {MAX_OBJECTS} are possible: "
            "remove some.",
            code="too_many",
        )
    for index, thing in enumerate(listed):
        of_kind(thing, VirtualObject, f"virtual object {index}", "VirtualObject(shape)")
        if not thing.name:
            listed[index] = replace(thing, name=f"object {index + 1}")
    names = [thing.name for thing in listed]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InvalidInput(
            f"two virtual objects are named {twice!r}; use different names.",
            code="given_twice",
        )
    return tuple(listed)
