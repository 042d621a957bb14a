"""Touch over time: foci that appear, move and fade without flicker."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64

from airtact.errors import between, number
from airtact.touch.finding import NO_CONTACTS, ContactArrays, find
from airtact.touch.foci import MAX_FOCI, WAVELENGTH, TouchFoci, chosen_foci
from airtact.touch.objects import VirtualObject, objects_of
from airtact.touch.skin import Skin


@dataclass(eq=False)
class _Focus:
    """An emitted focus; its contact is -1 while it fades."""

    number: int
    thing: str
    place: int
    skin_point: int
    shift: Float64[np.ndarray, "3"]  # offset from that skin point [m]
    strength: float
    contact: int
    level: float = 0.0


class TouchState:
    """Compute foci where moving skin touches virtual objects.

    For each frame, call ``update`` with the skin, moved to its new pose (``Skin.moved``), and the
    time [s]. It returns ``TouchFoci``: the positions, strengths (0 to 1, see
    ``VirtualObject.stiffness``) and names of the foci.

    A contact begins when skin enters an object, and ends when the skin is farther from the object
    than ``release``, so that noise does not make it flicker. The strength of a focus changes
    gradually, by at most 1 within the time ``ramp``. It begins at 0 and, after the end of a
    contact, falls to 0, while the focus stays at its point on the skin.

    Parameters
    ----------
    objects : a ``VirtualObject`` or a list of up to 64, in the frame of the skin. To move, add or
        remove objects, assign a new list to the attribute ``objects``.
    offset : distance of the foci from the skin, on its outer side [m], 0 to 0.1; 0.5 mm by default.
    most : largest number of foci, 1 to 64, including those that are fading; 8 by default. If there
        are more contacts, the weakest are merged with stronger neighbours or get no focus.
    wavelength : wavelength of the sound [m], 0.0003 to 0.35; by default 8.6 mm, that of 40 kHz in
        air at 20 °C. Weak contacts are only merged with foci of the same object less than a
        wavelength away.
    release : distance of the skin from an object at which a contact ends [m], 0 to 0.02; 1 mm by
        default.
    ramp : shortest time in which a strength changes between 0 and 1 [s], 0.001 to 1; 20 ms by
        default.

    Attributes
    ----------
    found : contacts at the last update, as ``ContactArrays``; empty before the first update.

    Raises
    ------
    InvalidInput
        If there are more than 64 objects, two have the same name, one has the wrong type, or a
        parameter is outside its range.

    Examples
    --------
    >>> import airtact as at
    >>> skin = at.touch.skin_of(at.pinch(gap=0.012).surfaces)
    >>> state = TouchState(at.VirtualObject(at.sphere(0.012, edge=0.003), name="ball"))
    >>> state.update(skin, time=0.0).strengths.tolist()
    [0.0, 0.0]
    >>> state.update(skin, time=0.015).strengths.round(3).tolist()
    [0.75, 0.75]
    """

    def __init__(
        self,
        objects: VirtualObject | Sequence[VirtualObject],
        offset: float = 0.5e-3,
        most: int = MAX_FOCI,
        wavelength: float = WAVELENGTH,
        release: float = 1e-3,
        ramp: float = 20e-3,
    ) -> None:
        self.offset = between(offset, 0.0, 0.1, "the offset of a focus", "m")
        self.release = between(release, 0.0, 0.02, "the release distance", "m")
        self.ramp = between(ramp, 1e-3, 1.0, "the ramp of a focus", "s", "is it in ms?")
        self.most = int(
            between(
                most, 1, 64, "the largest number of foci", "", "each focus takes time to compute."
            )
        )
        self.wavelength = between(wavelength, 3e-4, 0.35, "wavelength", "m")
        self.objects = objects
        self.found: ContactArrays = NO_CONTACTS
        self._playing: list[_Focus] = []
        self._time: float | None = None
        self._count = 0

    @property
    def objects(self) -> tuple[VirtualObject, ...]:
        """The virtual objects."""
        return self._objects

    @objects.setter
    def objects(self, objects: VirtualObject | Sequence[VirtualObject]) -> None:
        self._objects = objects_of(objects)

    @property
    def numbers(self) -> Int64[np.ndarray, "foci"]:
        """(F,) identifying number of each focus, which the focus keeps until it ends."""
        return np.array([focus.number for focus in self._playing], dtype=np.int64)

    def update(self, skin: Skin, time: float) -> TouchFoci:
        """Update the foci for a new frame of the skin, and return them.

        Parameters
        ----------
        skin : the skin in this frame, with the same triangles in all frames.
        time : time of the frame [s]. If it is earlier than that of the previous frame,
            strengths do not change.

        Returns
        -------
        The ``TouchFoci``, with the current strength of each focus. Fading foci keep their place on
        the skin; the index of their contact is -1.
        """
        time = number(time, "the time of a frame", "s")
        # At the first frame no time has passed, so new foci start silent.
        elapsed = 0.0 if self._time is None else max(time - self._time, 0.0)
        self._time = time
        found = find(skin, self._objects, self.release)
        # Skin just outside an object counts as a contact if it already has a focus.
        held = {(focus.thing, focus.place) for focus in self._playing if focus.contact >= 0}
        names = [self._objects[index].name for index in found.objects]
        begun = [
            index
            for index, name in enumerate(names)
            if found.depths[index] > 0.0 or (name, found.places[index]) in held
        ]
        found = found.chosen(np.array(begun, dtype=np.int64))
        self.found = found
        foci = chosen_foci(skin, self._objects, found, self.offset, self.most, self.wavelength)
        self._match(skin, foci, [names[index] for index in begun], found.places)
        for focus in self._playing:
            change = elapsed / self.ramp
            goal = focus.strength if focus.contact >= 0 else 0.0
            focus.level += float(np.clip(goal - focus.level, -change, change))
        playing = [focus for focus in self._playing if focus.contact >= 0 or focus.level > 0.0]
        self._playing = playing
        # A fading focus moves with its skin point.
        at_skin = np.array([focus.skin_point for focus in playing], dtype=np.int64)
        shifts = np.array([focus.shift for focus in playing]).reshape(-1, 3)
        return replace(
            foci,
            points=skin.points[at_skin] + shifts,
            strengths=np.array([focus.level for focus in playing]),
            contacts=np.array([focus.contact for focus in playing], dtype=np.int64),
            names=tuple(f"{skin.places[focus.place]} at {focus.thing}" for focus in playing),
            skin_points=at_skin,
        )

    def _match(
        self,
        skin: Skin,
        foci: TouchFoci,
        things: list[str],
        places: Int64[np.ndarray, "contacts"],
    ) -> None:
        """Match the current foci with new ones by the object and place of each contact."""
        unmatched = list(self._playing)
        for focus in unmatched:
            focus.contact = -1
        new = []
        for index, contact in enumerate(foci.contacts.tolist()):
            point = foci.points[index]
            thing = things[contact]
            place = int(places[contact])
            skin_point = int(foci.skin_points[index])
            shift = point - skin.points[skin_point]
            strength = float(foci.strengths[index])
            # The nearest focus of the same part and object within a wavelength is the same focus.
            same = [focus for focus in unmatched if (focus.thing, focus.place) == (thing, place)]
            distances = [
                math.dist(skin.points[focus.skin_point] + focus.shift, point) for focus in same
            ]
            if not same or min(distances) >= self.wavelength:
                new.append(_Focus(0, thing, place, skin_point, shift, strength, contact))
                continue
            focus = same[int(np.argmin(distances))]
            unmatched.remove(focus)
            focus.skin_point = skin_point
            focus.shift = shift
            focus.strength = strength
            focus.contact = contact
        # New foci wait until fading ones leave room for them.
        for focus in new[: max(self.most - len(self._playing), 0)]:
            self._count += 1
            focus.number = self._count
            self._playing.append(focus)
