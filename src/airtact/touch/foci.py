"""Foci for contacts: one for each, or several for a long one; by default, at most eight in all."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64
from scipy.spatial.distance import cdist

from airtact.acoustics.target import Target
from airtact.errors import InvalidInput, counted, one_line
from airtact.touch.finding import ContactArrays
from airtact.touch.objects import VirtualObject
from airtact.touch.skin import Skin

# Default largest number of foci. People can hardly distinguish more.
MAX_FOCI = 8

# Default wavelength [m], for 40 kHz in air at 20 °C.
WAVELENGTH = 8.6e-3


@dataclass(frozen=True, eq=False)
class TouchFoci:
    """Foci of contacts, just outside the skin, as returned by ``Contacts.foci``.

    ``target`` converts them to a ``Target``, for which a drive can be computed. Besides the
    contacts counted in ``merged`` and ``dropped``, a contact has no focus of its own if a deeper
    contact with a focus is within 0.8 wavelengths on the same patch of skin.

    Attributes
    ----------
    points : (F, 3) positions outside the skin [m], in the frame of the skin.
    strengths : (F,) strength of the touch at each focus, from 0 to 1 (see ``VirtualObject``).
        The pressure at a focus should be proportional to its strength.
    contacts : (F,) index of the contact to which each focus belongs, in the arrays of ``Contacts``.
        A long contact may have several foci.
    names : name of each focus, "PART at OBJECT" such as "index at ball", numbered if a contact has
        several foci.
    skin_points : (F,) index in ``Skin.points`` of the point nearest to each focus.
    merged : number of contacts without a focus (because the number of foci is limited) that are
        less than a wavelength from a focus of the same object.
    dropped : number of contacts without a focus (because the number of foci is limited) that are at
        least a wavelength from every focus of the same object.
    """

    points: Float64[np.ndarray, "foci 3"]
    strengths: Float64[np.ndarray, "foci"]
    contacts: Int64[np.ndarray, "foci"]
    names: tuple[str, ...]
    skin_points: Int64[np.ndarray, "foci"]
    merged: int = 0
    dropped: int = 0

    def __repr__(self) -> str:
        return one_line(self, ", ".join(self.names) or "no foci", self.note)

    @property
    def note(self) -> str:
        """Sentence about contacts that were merged or have no focus; empty if there are none."""
        if not self.merged + self.dropped:
            return ""
        return (
            f"there are more contacts than the {counted(len(self.points), 'focus', 'foci')} "
            f"allowed: {self.merged} of the weakest were merged with a neighbour, and "
            f"{self.dropped} dropped"
        )

    def target(self) -> Target:
        """Return a target at these foci, with their strengths as ``shares``.

        Shares only define the ratios of the pressures. Multiply the drive by ``strengths.max()`` to
        set the overall strength of the touch.

        Raises
        ------
        InvalidInput
            If there are no foci.
        """
        if not len(self.points):
            raise InvalidInput(
                "no skin is inside a virtual object, so there is nothing to feel: move the hand "
                "or an object.",
                code="empty",
            )
        return Target(self.points, shares=self.strengths)


def chosen_foci(
    skin: Skin,
    objects: tuple[VirtualObject, ...],
    found: ContactArrays,
    offset: float,
    most: int = MAX_FOCI,
    wavelength: float = WAVELENGTH,
) -> TouchFoci:
    """Choose the positions of foci that make contacts perceptible.

    Each contact gets a focus at its deepest point, unless a deeper focus is within 0.8 wavelengths
    on the same patch of skin. If there are too many foci, the weakest are removed. A contact whose
    focus is removed shares a focus of the same object that is less than a wavelength away, if there
    is one. If there are fewer foci than allowed, long contacts get additional foci at least 0.8
    wavelengths apart. A contact is long if the skin deeper than half of its largest depth extends
    over more than a wavelength.
    """
    apart = 0.8 * wavelength
    strengths = _strengths(objects, found.objects, found.points, found.depths)
    # Process contacts from deepest to shallowest; foci on the same patch must be far apart.
    between = cdist(found.points, found.points)
    crowded = (between < apart) & (found.patches[:, None] == found.patches)
    kept: list[int] = []
    for contact in np.argsort(-found.depths, kind="stable").tolist():
        if not crowded[contact, kept].any():
            kept.append(contact)
    merged = 0
    dropped = 0
    # Merging loses little, because the stronger focus within a wavelength covers the same skin.
    while len(kept) > most:
        weakest = min(kept, key=lambda contact: (strengths[contact], found.depths[contact]))
        kept.remove(weakest)
        beside = [other for other in kept if found.objects[other] == found.objects[weakest]]
        if (between[weakest, beside] < wavelength).any():
            merged += 1
        else:
            dropped += 1
    kept.sort()
    contacts = list(kept)
    points = [found.points[contact] for contact in kept]
    normals = [found.normals[contact] for contact in kept]
    depths = []
    nearest = [found.deepest[contact] for contact in kept]
    # Add further foci to each long patch in turn, at its deepest free point.
    waiting = list(kept)
    while waiting and len(points) < most:
        contact = waiting.pop(0)
        # The rim of a fingertip in a ball feels like part of its pad, so it gets no foci.
        inside = found.member_depths[contact] >= 0.5 * max(found.depths[contact], 0.0)
        members = found.members[contact][inside]
        if not len(members) or np.ptp(skin.points[members], axis=0).max() <= wavelength:
            continue
        patch = found.patches[contact]
        taken = [
            point
            for point, other in zip(points, contacts, strict=True)
            if found.patches[other] == patch
        ]
        away = cdist(skin.points[members], np.array(taken)).min(axis=1)
        free = np.flatnonzero(away >= apart)
        if len(free):
            member = members[free[0]]  # members are sorted by depth
            contacts.append(contact)
            points.append(skin.points[member])
            normals.append(skin.normals[member])
            depths.append(found.member_depths[contact][inside][free[0]])
            nearest.append(member)
            waiting.append(contact)
    # The strengths of the foci at the deepest points are already known.
    added = np.array(contacts[len(kept) :], dtype=np.int64)
    on_skin = np.array(points).reshape(-1, 3)
    strengths = strengths[kept]
    if len(added):
        extra = _strengths(objects, found.objects[added], on_skin[len(kept) :], np.array(depths))
        strengths = np.concatenate([strengths, extra])
    # Number the foci if a contact has several, because results refer to foci by name.
    names = [
        f"{skin.places[found.places[contact]]} at {objects[found.objects[contact]].name}"
        for contact in contacts
    ]
    return TouchFoci(
        points=on_skin + offset * np.array(normals).reshape(-1, 3),
        strengths=strengths,
        contacts=np.array(contacts, dtype=np.int64),
        names=tuple(
            f"{name} {names[: place + 1].count(name)}" if names.count(name) > 1 else name
            for place, name in enumerate(names)
        ),
        skin_points=np.array(nearest, dtype=np.int64),
        merged=merged,
        dropped=dropped,
    )


def _strengths(
    objects: tuple[VirtualObject, ...],
    which: Int64[np.ndarray, "some"],
    points: Float64[np.ndarray, "some 3"],
    depths: Float64[np.ndarray, "some"],
) -> Float64[np.ndarray, "some"]:
    strengths = np.zeros(len(which))
    for index in set(which.tolist()):
        of_object = which == index
        strengths[of_object] = objects[index].strengths(points[of_object], depths[of_object])
    return strengths
