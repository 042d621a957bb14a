"""The virtual objects and requested foci, which applications can change while the loop runs.

Each application is a source with a name. Its foci end if it sends nothing for ``SILENCE``. Its
objects stay until its connection has been closed for ``SILENCE``, so that an application that
reconnects at once does not lose them.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from threading import RLock

import msgspec
import numpy as np
from jaxtyping import Float64

from airtact.errors import InvalidInput, between, check_finite, in_short
from airtact.hands.hand import PLACES
from airtact.live.messages import (
    MAX_FOCI,
    VERSION,
    ClearMessage,
    ContactState,
    FociMessage,
    FocusMessage,
    FocusState,
    Message,
    ObjectMessage,
    ObjectsMessage,
    StateMessage,
    read_message,
)
from airtact.live.moment import Moment
from airtact.setup.bodies import unsided
from airtact.setup.parsing import nearest
from airtact.touch.objects import MAX_OBJECTS, VirtualObject, objects_of
from airtact.touch.solids import near_point

# Time without a message after which an application loses its foci [s].
SILENCE = 0.5

# Largest number of applications with foci.
MAX_SOURCES = 64


@dataclass(frozen=True, eq=False)
class WantedFocus:
    """A focus that an application requests.

    Pass it to ``Client.foci``. If the live loop cannot produce the focus, for example
    because it is inside the hand, ``StateMessage.foci`` states the reason.

    Attributes
    ----------
    name : name of the focus, unique in its application.
    strength : strength of the focus, from 0 to 1. Pressures at the foci are proportional to their
        strengths, and 1 is the largest pressure that the array is allowed to produce.
    point : (3,) position in scene coordinates, or in those of the object named in
        ``on`` (of its ``shape``) [m], at most 2 m from the origin.
    place : place on a hand, such as ``"right.index.pad"``; if no side is given, the
        scene's hand is used. Either ``point`` or ``place`` is required.
    on : name of the object that the point moves with; None if the point is fixed in the scene. Not
        allowed with ``place``.
    offset : distance from the skin, outward [m], 0 to 0.1; only used with ``place``.
    modulation : frequency at which the strength varies between 0 and its full value [Hz], at most
        20; 0 keeps it constant.

    Raises
    ------
    InvalidInput
        If neither or both of ``point`` and ``place`` are given, ``on`` is given with ``place``, the
        place is unknown, or a value is outside its range.
    """

    name: str
    strength: float = 1.0
    point: Float64[np.ndarray, "3"] | None = None
    place: str | None = None
    on: str | None = None
    offset: float = 0.5e-3
    modulation: float = 0.0

    __repr__ = in_short

    def __post_init__(self) -> None:
        what = f"focus {self.name}"
        if (self.point is None) == (self.place is None):
            raise InvalidInput(f"{what} requires either a point or a place.", code="options_clash")
        if self.point is not None:
            check_finite(self.point, f"the coordinates of {what}")
            object.__setattr__(self, "point", near_point(self.point, what))
        elif self.on is not None:
            raise InvalidInput(
                f"{what} is at a place on the hand, so it cannot move with the object {self.on}: "
                "use a point.",
                code="options_clash",
            )
        if self.place is not None and unsided(self.place) not in PLACES:
            raise InvalidInput(
                f"{what}: the hand has no place {self.place!r}; {nearest(self.place, PLACES)}",
                code="unknown_name",
            )
        between(self.strength, 0.0, 1.0, f"the strength of {what}", "", "full strength is 1.")
        between(self.offset, 0.0, 0.1, f"the offset of {what}", "m")
        slip = "for higher frequencies, set the modulation of the scene."
        # Drives are computed 60 times per second.
        between(self.modulation, 0.0, 20.0, f"the modulation of {what}", "Hz", slip)

    def message(self) -> FocusMessage:
        """Return the message that requests this focus."""
        point = None if self.point is None else tuple(self.point.tolist())
        values = {"offset": self.offset, "strength": self.strength, "modulation": self.modulation}
        return FocusMessage(self.name, point, self.place, self.on, **values)


class World:
    """Virtual objects and requested foci of the live loop; any thread may read and change them.

    Pass the same world to the source of the hands and to ``follow``. Applications change it with
    messages, which their connections pass to ``take`` (as JSON) or ``receive`` (as objects such as
    an ``ObjectsMessage``). The live loop reads ``objects`` and ``foci`` for each drive, and records
    its state for the applications in ``state``. The foci of an application are removed 0.5 s after
    its last message or when its connection is closed; its objects are removed 0.5 s after its
    connection is closed, unless another connection has added them again by then.

    Parameters
    ----------
    objects : objects of the scene file, at most 64; none by default.
    clock : function that returns the current time [s]; by default ``time.monotonic``.

    Raises
    ------
    InvalidInput
        If there are more than 64 objects, or two have the same name.
    """

    def __init__(
        self, objects: Sequence[VirtualObject] = (), clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._clock = clock
        self._lock = RLock()
        self._objects = objects_of(objects)
        self._scene = {thing.name: thing for thing in self._objects}
        # For each object that an application added: its message and the application.
        self._added: dict[str, tuple[ObjectMessage, str]] = {}
        self._foci: dict[str, dict[str, WantedFocus]] = {}
        self._heard: dict[str, float] = {}  # when each source with foci sent its newest message
        self._closed: dict[str, float] = {}  # when the connection of each source with objects ended
        self._rejected: tuple[float, str] = (-np.inf, "")
        self._shown: tuple[Moment | None, str | None, float] = (None, "waiting for a hand", 1.0)
        self._state = (self._shown, _state_of(*self._shown, []))

    @property
    def objects(self) -> tuple[VirtualObject, ...]:
        """The current objects; the tuple is replaced at every change."""
        return self._objects

    def foci(self, now: float) -> tuple[WantedFocus, ...]:
        """Return the currently requested foci with their current strengths.

        ``now`` is the current time on the clock of ``time.monotonic`` [s].
        """
        with self._lock:
            self._forget(now)
            names = {thing.name for thing in self._objects}
            wanted: dict[str, WantedFocus] = {}
            for foci in self._foci.values():
                for focus in foci.values():
                    if focus.on is not None and focus.on not in names:
                        continue
                    # Another application may have used the same name.
                    name = focus.name
                    while name in wanted:
                        name += "'"
                    swing = 0.5 + 0.5 * np.cos(2.0 * np.pi * focus.modulation * now)
                    wanted[name] = replace(focus, name=name, strength=float(focus.strength * swing))
            return tuple(wanted.values())

    def take(self, text: bytes | str, source: str) -> str | None:
        """Process a JSON message; return None, or the reason if the message is rejected."""
        try:
            self.receive(read_message(text), source)
        except InvalidInput as fault:
            self.reject(str(fault))
            return str(fault)
        return None

    def receive(self, message: Message, source: str, keep: bool = False) -> None:
        """Process a message from an application; a rejected message changes nothing.

        Parameters
        ----------
        message : the message. Tracked hands in a message are ignored here.
        source : name of the connection.
        keep : whether to keep earlier foci of the source that are not in the message. If so,
            send a focus with strength 0 to remove it.

        Raises
        ------
        InvalidInput
            If an object does not exist, two foci have the same id, a value is invalid, or there
            would be too many foci, objects or applications.
        """
        if isinstance(message, ObjectsMessage):
            self._change_objects(message, source)
        elif isinstance(message, FociMessage):
            self._change_foci(message, source, keep)
        elif isinstance(message, ClearMessage):
            with self._lock:
                self._foci.pop(source, None)
                self._heard.pop(source, None)
                self._drop({source})
        self.alive(source)

    def alive(self, source: str) -> None:
        """Record that an application has sent a message, so that its foci are kept."""
        with self._lock:
            if source in self._foci:
                self._heard[source] = self._clock()

    def close(self, source: str) -> None:
        """Remove a closed connection's foci at once, and its objects after ``SILENCE`` seconds."""
        with self._lock:
            self._foci.pop(source, None)
            self._heard.pop(source, None)
            if any(owner == source for _, owner in self._added.values()):
                self._closed[source] = self._clock()

    def reject(self, sentence: str) -> None:
        """Record why a message was rejected; the status shows this reason."""
        self._rejected = (self._clock(), sentence)

    @property
    def rejection(self) -> str:
        """Reason why a message was rejected in the last 3 s; empty if none was."""
        when, sentence = self._rejected
        return sentence if self._clock() - when < 3.0 else ""

    def show(self, moment: Moment | None, reason: str | None, scale: float = 1.0) -> None:
        """Record the state of the live loop, which calls this method in every iteration.

        Parameters
        ----------
        moment : the newest drive; None before the first drive.
        reason : reason for silence; None if sound is emitted.
        scale : factor by which the amplitudes, and therefore the pressures, were scaled.
        """
        with self._lock:
            self._forget(self._clock())
            self._shown = (moment, reason, scale)

    @property
    def state(self) -> StateMessage:
        """The newest state; a new object is returned whenever the state may have changed."""
        shown = self._shown
        if self._state[0] is not shown:
            with self._lock:
                names = [name for foci in self._foci.values() for name in foci]
            self._state = (shown, _state_of(*shown, names))
        return self._state[1]

    def _change_objects(self, message: ObjectsMessage, source: str) -> None:
        # Check the number before building the objects, because building takes time.
        count = len({thing.name for thing in (*self._objects, *message.add)} - {*message.remove})
        if count > MAX_OBJECTS:
            raise InvalidInput(
                f"there would be {count} objects, but at most {MAX_OBJECTS} are possible: remove "
                "some.",
                code="too_many",
            )
        made = {thing.name: self._made(thing) for thing in message.add}
        with self._lock:
            things = {thing.name: thing for thing in self._objects}
            for name in message.remove:
                self._check_known(name, things)
                del things[name]
            things |= made
            for motion in message.move:
                self._check_known(motion.name, things)
                things[motion.name] = replace(things[motion.name], pose=motion.pose.made())
            self._objects = objects_of(list(things.values()))
            self._added |= {thing.name: (thing, source) for thing in message.add}
            self._added = {name: added for name, added in self._added.items() if name in things}

    def _made(self, message: ObjectMessage) -> VirtualObject:
        """Build an object, or move the existing object if it has the same shape."""
        with self._lock:
            before, _ = self._added.get(message.name, (None, ""))
            present = next((thing for thing in self._objects if thing.name == message.name), None)
        moved = before is not None and msgspec.structs.replace(before, pose=message.pose) == message
        if moved and present is not None:
            return replace(present, pose=message.pose.made())
        thing = message.made()
        # Compute the distance grid of a mesh here, where the loop does not wait for it.
        thing.depth(np.zeros((1, 3)))
        return thing

    def _check_known(self, name: str, things: dict[str, VirtualObject]) -> None:
        if name not in things:
            choice = nearest(name, things) if things else "there are no objects: add one first."
            raise InvalidInput(f"there is no object {name!r}; {choice}", code="unknown_name")

    def _change_foci(self, message: FociMessage, source: str, keep: bool) -> None:
        with self._lock:
            self._forget(self._clock())
            things = {thing.name: thing for thing in self._objects}
            foci = dict(self._foci.get(source, {})) if keep else {}
            for wanted in message.foci:
                if wanted.on is not None:
                    self._check_known(wanted.on, things)
                if not keep and wanted.id in foci:
                    raise InvalidInput(
                        f"two foci have the id {wanted.id!r}; give each focus a different id.",
                        code="given_twice",
                    )
                foci[wanted.id] = WantedFocus(
                    wanted.id,
                    wanted.strength,
                    None if wanted.point is None else np.array(wanted.point),
                    wanted.place,
                    wanted.on,
                    wanted.offset,
                    wanted.modulation,
                )
                if keep and wanted.strength == 0.0:
                    del foci[wanted.id]
            if len(foci) > MAX_FOCI:
                raise InvalidInput(
                    f"an application can have at most {MAX_FOCI} foci, not {len(foci)}: "
                    "remove some.",
                    code="too_many",
                )
            if source not in self._foci and len(self._foci) >= MAX_SOURCES:
                raise InvalidInput(
                    f"{MAX_SOURCES} applications already have foci: close some of them.",
                    code="too_many",
                )
            self._foci[source] = foci

    def _drop(self, sources: set[str]) -> None:
        gone = {name for name, (_, owner) in self._added.items() if owner in sources}
        if gone:
            things = {thing.name: thing for thing in self._objects}
            for name in gone:
                del things[name]
            # Restore objects of the scene file that had been replaced.
            things |= {name: thing for name, thing in self._scene.items() if name in gone}
            self._objects = tuple(things.values())
            self._added = {name: one for name, one in self._added.items() if name not in gone}

    def _forget(self, now: float) -> None:
        """Remove the foci of silent sources and the objects of closed ones."""
        for source, heard in list(self._heard.items()):
            if now - heard > SILENCE:
                del self._foci[source], self._heard[source]
        ended = {source for source, when in self._closed.items() if now - when > SILENCE}
        if ended:
            self._drop(ended)
            self._closed = {name: when for name, when in self._closed.items() if name not in ended}


def _state_of(
    moment: Moment | None, reason: str | None, scale: float, wanted: Sequence[str]
) -> StateMessage:
    """Return the state after a drive; ``wanted`` are names of foci that applications request."""
    if moment is None or moment.foci is None:
        why = reason or "paused"
        unplayed = [FocusState(name, None, 0.0, 0.0, why) for name in wanted]
        return StateMessage(VERSION, "silent", why, foci=unplayed)
    foci = []
    for index, point in enumerate(moment.foci):
        pressure = None
        # Without a solution, the effect of the hand is unknown: a palm doubles the pressure.
        if moment.pressures is not None and moment.rule != "distances":
            pressure = round(float(scale * moment.pressures[index]), 1)
        strength = 1.0 if moment.strengths is None else round(float(moment.strengths[index]), 3)
        name = moment.names[index] if moment.names else f"focus {index + 1}"
        # A long contact has several foci.
        before = moment.names[:index].count(name) if moment.names else 0
        name = f"{name} {before + 1}" if before else name
        foci.append(FocusState(name, _rounded(point), strength, pressure))
    for name, why in moment.rejected.items():
        foci.append(FocusState(name, None, 0.0, 0.0, why))
    contacts = []
    if moment.contacts is not None and moment.depths is not None:
        depths = moment.depths.round(6).tolist()
        for (part, name), point, depth in zip(
            moment.touching, moment.contacts, depths, strict=True
        ):
            contacts.append(ContactState(name, part, _rounded(point), depth))
    if moment.state in ("playing", "fading") and moment.amplitudes.any():
        return StateMessage(VERSION, moment.state, reason, contacts, foci)
    return StateMessage(VERSION, "silent", reason or "nothing is touched", contacts, foci)


def _rounded(point: Float64[np.ndarray, "3"]) -> tuple[float, float, float]:
    x, y, z = np.round(point, 6).tolist()  # micrometres
    return x, y, z
