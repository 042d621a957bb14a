"""Contacts of a hand with virtual objects, and the target that makes them perceptible."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float64
from scipy.spatial import KDTree

from airtact.acoustics.target import Target
from airtact.acoustics.target_points import outward
from airtact.errors import InvalidInput, between, millimetres, one_line
from airtact.touch.finding import ContactArrays, find, peaks
from airtact.touch.foci import MAX_FOCI, WAVELENGTH, TouchFoci, chosen_foci
from airtact.touch.objects import VirtualObject, objects_of
from airtact.touch.outlines import outline_of, spaced_along
from airtact.touch.skin import Bodies, Skin, skin_of


@dataclass(frozen=True, eq=False)
class Contacts:
    """Contacts of skin with virtual objects, as returned by ``contact``.

    A contact is a connected piece of skin inside one object. Pieces that span several parts of a
    hand, such as two fingers, are divided into one contact per part. Call ``target`` for the target
    that makes the contacts perceptible, or ``foci`` for its foci.

    Attributes
    ----------
    skin : points of the skin, as a ``Skin``. All positions are in the frame of the skin.
    virtual_objects : all objects, whether touched or not; unnamed ones are named "object 1" and
        so on.
    offset : distance of the foci from the skin, outward [m].
    found : ``ContactArrays`` with the properties of all contacts. Its arrays ``points``,
        ``normals``, ``depths`` and ``areas`` are also properties of ``Contacts``. In contrast,
        ``Contacts.objects`` and ``Contacts.places`` contain names instead of indices.
    """

    skin: Skin
    virtual_objects: tuple[VirtualObject, ...]
    offset: float
    found: ContactArrays

    def __len__(self) -> int:
        return len(self.found.depths)

    def __repr__(self) -> str:
        words = [
            f"{place} {millimetres(depth)} in {name}"
            for place, depth, name in zip(self.places, self.depths, self.objects, strict=True)
        ]
        return one_line(self, *(words or ["none"]))

    @property
    def points(self) -> Float64[np.ndarray, "contacts 3"]:
        """(C, 3) deepest point of each contact on the skin [m]."""
        return self.found.points

    @property
    def normals(self) -> Float64[np.ndarray, "contacts 3"]:
        """(C, 3) outward unit normal of the skin at the deepest point of each contact."""
        return self.found.normals

    @property
    def depths(self) -> Float64[np.ndarray, "contacts"]:
        """(C,) largest depth of each contact in its object [m]."""
        return self.found.depths

    @property
    def areas(self) -> Float64[np.ndarray, "contacts"]:
        """(C,) area of the skin inside the object [m²]."""
        return self.found.areas

    @property
    def objects(self) -> tuple[str, ...]:
        """Name of the touched object for each contact."""
        return tuple(self.virtual_objects[index].name for index in self.found.objects)

    @property
    def places(self) -> tuple[str, ...]:
        """Name of the part of the skin, such as a finger, for each contact."""
        return tuple(self.skin.places[index] for index in self.found.places)

    @cached_property
    def outlines(self) -> tuple[tuple[Float64[np.ndarray, "_ 3"], ...], ...]:
        """For each contact, the curves (P, 3) along which the skin meets the object's surface [m].

        A closed curve ends with its first point. A curve is open if the contact continues on
        another part of the skin.
        """
        return tuple(
            outline_of(self.skin, self.virtual_objects[index], members)
            for index, members in zip(self.found.objects, self.found.members, strict=True)
        )

    def foci(self, most: int = MAX_FOCI, wavelength: float = WAVELENGTH) -> TouchFoci:
        """Choose foci: one per contact, or several if the contact is long.

        Parameters
        ----------
        most : largest number of foci. If there are more contacts, the weakest are merged with
            stronger neighbours. Weak contacts without such neighbours get no focus.
        wavelength : wavelength of the sound [m].

        Returns
        -------
        The foci at the distance ``offset`` from the skin, with their strengths.

        Raises
        ------
        InvalidInput
            If ``most`` is not between 1 and 64, or the wavelength is not between 0.3 mm and 0.35 m.
        """
        between(most, 1, 64, "the largest number of foci", "", "each focus takes time to compute.")
        between(wavelength, 3e-4, 0.35, "wavelength", "m")
        objects = self.virtual_objects
        return chosen_foci(self.skin, objects, self.found, self.offset, most, wavelength)

    def target(self, most: int = MAX_FOCI, wavelength: float = WAVELENGTH) -> Target:
        """Return the target that makes the contacts perceptible.

        Its points are the foci that ``foci`` chooses, and its shares are proportional to their
        strengths. For objects of the style "outline", its points lie 2.5 mm apart along all
        outlines, so that a single focus can run through them (see ``at.drives.Motion("stm")``).

        Raises
        ------
        InvalidInput
            If there is no contact, if only some of the touched objects have the style "outline", or
            if ``most`` or the wavelength is outside its range (see ``foci``).
        """
        if not self.runs:
            return self.foci(most, wavelength).target()
        curves = [curve for curves in self.outlines for curve in curves]
        if not curves:
            raise InvalidInput(
                "all of the skin is inside the object, so there is no outline: move the hand.",
                code="empty",
            )
        points = np.concatenate([spaced_along(curve, 2.5e-3) for curve in curves])
        nearest = KDTree(self.skin.points).query(points)[1]
        return Target(points + self.offset * self.skin.normals[nearest])

    @property
    def runs(self) -> bool:
        """Whether a single focus runs along the target's points, as for the style "outline"."""
        styles = {self.virtual_objects[index].style for index in self.found.objects}
        if "outline" in styles and len(styles) > 1:
            raise InvalidInput(
                'only some of the touched objects have style = "outline". One focus runs along '
                "all outlines, so use this style for all of them or for none.",
                code="options_clash",
            )
        return styles == {"outline"}


def contact(
    hand: Bodies, objects: VirtualObject | Sequence[VirtualObject], offset: float = 0.5e-3
) -> Contacts:
    """Find the contacts of a hand, or of other skin, with virtual objects.

    Parameters
    ----------
    hand : a ``Hand``, a ``Surface``, a list of these (which may be mixed), or a mapping from names
        to them. The poses of the objects must map to the coordinates of these bodies.
    objects : one virtual object, or a sequence of up to 64 objects. Unnamed objects are called
        "object 1" and so on.
    offset : distance from the skin, outward, at which ``Contacts.foci`` and ``Contacts.target``
        place the foci [m], 0 to 0.1. It does not affect the contacts.

    Returns
    -------
    ``Contacts`` with one contact for each connected part of a finger, palm, back of the hand or
    surface inside an object; empty if nothing is touched. ``skin_of`` describes the names of these
    parts.

    Raises
    ------
    InvalidInput
        If there are no bodies, there are more than 64 objects, two have the same name, the offset
        is outside its range, an argument has the wrong type, or the skin is too large for objects
        of less than 7 mm.

    Examples
    --------
    >>> import airtact as at
    >>> ball = at.VirtualObject(at.sphere(0.012, edge=0.003), name="ball")
    >>> contacts = contact(at.pinch(gap=0.012).surfaces, ball)
    >>> contacts
    Contacts(body 1 6 mm in ball, body 2 6 mm in ball)
    >>> ((1e3 * contacts.points).round(3) + 0.0).tolist()
    [[-6.0, 0.0, 0.0], [6.0, 0.0, 0.0]]
    """
    offset = between(offset, 0.0, 0.1, "the offset of a focus", "m")
    things = objects_of(objects)
    # A triangle with edges of at most √3 times a ball's radius cannot surround the ball.
    smallest = min((thing.ball[1] for thing in things), default=np.inf)
    skin = skin_of(hand, min(6e-3, np.sqrt(3.0) * smallest))
    assert skin.bodies is not None
    found = find(skin, things)
    # Move the points of contacts to the deepest points of the exact surfaces.
    points = found.points.copy()
    normals = found.normals.copy()
    depths = found.depths.copy()
    # Repeat the fit of ``peaks`` with smaller and smaller circles of points on the exact surface.
    turns = 2.0 * np.pi * np.arange(8) / 8.0
    circle = np.stack([np.cos(turns), np.sin(turns), np.zeros(8)], axis=1)
    for index in range(len(depths)):
        shape = skin.bodies[found.places[index]].shape
        thing = things[found.objects[index]]
        point = shape.project(points[index : index + 1])
        for radius in (1e-3, 0.3e-3, 0.1e-3):
            normal = outward(shape.depth, point)
            axis = np.eye(3)[np.abs(normal[0]).argmin()]
            first = np.cross(normal[0], axis)
            first /= np.linalg.norm(first)
            frame = np.stack([first, np.cross(normal[0], first), normal[0]])
            ring = shape.project(point + radius * circle @ frame)
            around = thing.exact_depth(np.concatenate([point, ring]))
            point = peaks(point, normal, around[:1], ring[None], around[None, 1:])[0]
            point = shape.project(point)
        points[index] = point[0]
        normals[index] = outward(shape.depth, point)[0]
        depths[index] = thing.exact_depth(point)[0]
    found = found._replace(points=points, normals=normals, depths=depths)
    return Contacts(skin, things, offset, found)
