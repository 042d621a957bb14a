"""Messages between applications and the live loop, in JSON; docs/applications.md shows each kind.

Unknown keys in a message are ignored, so that a newer application can talk to an older loop.
Lengths are in metres and positions in scene coordinates.
"""

import difflib
import inspect
import json
import re
from typing import Annotated, Any, ClassVar, Literal

import msgspec
import numpy as np
from msgspec import Meta
from scipy.spatial.transform import Rotation

from airtact.errors import InvalidInput, about
from airtact.geometry.pose import Pose
from airtact.geometry.primitives import Capsule, capsule, sphere
from airtact.geometry.surface import Surface
from airtact.setup.parsing import nearest
from airtact.setup.tables import ObjectKeys, Triple
from airtact.setup.touching import SOLIDS, object_of
from airtact.touch.objects import MAX_OBJECTS, VirtualObject
from airtact.touch.textures import Grating

# Version of the message format.
VERSION = 1

# Largest number of foci per application.
MAX_FOCI = 16

Name = Annotated[str, Meta(min_length=1, max_length=64)]
Version = Annotated[int, Meta(ge=VERSION, le=VERSION)]


class PoseMessage(msgspec.Struct, frozen=True, omit_defaults=True):
    """Pose of an object, which maps the coordinates of its shape to those of the scene.

    Points are first rotated about the origin of the shape's coordinates, then translated.

    Attributes
    ----------
    translation : (x, y, z) in scene coordinates [m]; by default none.
    quaternion : rotation as (x, y, z, w) of any length above zero; by default none.
    """

    translation: Triple = (0.0, 0.0, 0.0)
    quaternion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)

    @classmethod
    def of(cls, pose: Pose | None) -> "PoseMessage":
        """Convert a pose to a message; None becomes the identity."""
        if pose is None:
            return cls()
        quaternion = Rotation.from_matrix(pose.rotation).as_quat()
        return cls(tuple(pose.translation.tolist()), tuple(quaternion.tolist()))

    def made(self) -> Pose:
        """Build the pose."""
        length = float(np.linalg.norm(self.quaternion))
        if not 1e-6 < length < 1e6:  # also NaN
            raise InvalidInput(
                f"the quaternion has length {length:g}; use 0, 0, 0, 1 for no rotation.",
                code="out_of_range",
            )
        return Pose(Rotation.from_quat(self.quaternion).as_matrix(), np.array(self.translation))


class MeshMessage(msgspec.Struct, frozen=True):
    """A closed triangle mesh.

    Attributes
    ----------
    vertices : positions of the vertices [m].
    triangles : three vertex indices per triangle, counterclockwise as seen from
        outside.
    """

    vertices: Annotated[list[Triple], Meta(min_length=4, max_length=20_000)]
    triangles: Annotated[list[tuple[int, int, int]], Meta(min_length=4, max_length=20_000)]


class ObjectMessage(
    ObjectKeys, frozen=True, kw_only=True, forbid_unknown_fields=False, omit_defaults=True
):
    """A virtual object, with the keys of an ``[[objects]]`` table, except those of a mesh file.

    An ``ObjectsMessage`` contains it. Exactly one shape is required: ``mesh``, or one of the
    built-in shapes ``sphere``, ``capsule``, ``box``, ``cylinder``, ``half_space`` and ``button``.
    ``style``, ``stiffness`` and ``grating`` are those of ``VirtualObject`` (``texture`` for a
    ``Grating``).

    Attributes
    ----------
    name : name of the object, 1 to 64 characters. An existing object of this name is replaced, even
        if another application or the scene file added it.
    mesh : shape of the object as a mesh, in the object's own coordinates.
    pose : pose that maps the object's coordinates to those of the scene; by default, both are the
        same.
    """

    one_of: ClassVar = ("sphere", "capsule", "box", "cylinder", "half_space", "button", "mesh")
    name: Name
    mesh: MeshMessage | None = None
    pose: PoseMessage = PoseMessage()

    @classmethod
    def of(cls, thing: VirtualObject) -> "ObjectMessage":
        """Convert a virtual object to a message; its texture, if any, must be a ``Grating``."""
        shape = thing.shape.shape if isinstance(thing.shape, Surface) else thing.shape
        message: dict[str, Any] = {
            "name": thing.name,
            "pose": PoseMessage.of(thing.pose),
            "style": thing.style,
            "stiffness": thing.stiffness,
        }
        if isinstance(shape, Capsule):
            start, end = shape.axis
            message["capsule"] = {"start": start, "end": end, "radius": shape.radius}
        elif isinstance(thing.shape, Surface):
            message["mesh"] = {
                "vertices": thing.shape.vertices,
                "triangles": thing.shape.triangles,
            }
        else:
            key = next(key for key, kind in SOLIDS.items() if kind == type(shape).__name__)
            message[key] = shape
        if isinstance(thing.texture, Grating):
            message["grating"] = thing.texture
        # Dataclasses become dictionaries, and arrays become lists.
        return converted(msgspec.to_builtins(message, enc_hook=np.ndarray.tolist), cls)

    def made(self) -> VirtualObject:
        """Build the object without computing the distance grid of a mesh, which takes about 1 s."""
        with about(f"object {self.name}"):
            shape = None
            if self.mesh is not None:
                shape = Surface(np.array(self.mesh.vertices), np.array(self.mesh.triangles))
            elif self.sphere is not None:
                # Contacts use the exact sphere. The mesh is only displayed and must be fast.
                radius = self.sphere.radius
                shape = sphere(radius, radius / 5.0, self.sphere.centre)
            elif self.capsule is not None:
                start, end, radius = self.capsule.start, self.capsule.end, self.capsule.radius
                length = float(np.linalg.norm(np.subtract(end, start)))
                shape = capsule(start, end, radius, max(radius / 3.0, length / 50.0))
            return object_of(self, self.name, self.pose.made(), shape)


class MoveMessage(msgspec.Struct, frozen=True):
    """A new pose for an existing object.

    Attributes
    ----------
    name : name of the object; the message is rejected if there is no such object.
    pose : new pose, which replaces the earlier one. It maps the coordinates in which the object's
        shape is given to scene coordinates.
    """

    name: Name
    pose: PoseMessage


class FocusMessage(msgspec.Struct, frozen=True, omit_defaults=True):
    """A focus in a ``FociMessage``, given by exactly one of ``point`` and ``place``.

    ``World.receive`` checks the values, and raises ``InvalidInput`` if one is invalid.

    Attributes
    ----------
    id : name of the focus, 1 to 64 characters, unique in its application.
    point : position in scene coordinates, or in those of the object named in ``on``
        [m].
    place : place on a hand, such as "index.pad" or "right.palm"; without a side, on the scene's
        hand.
    on : name of the object that the point moves with; not allowed with ``place``.
    offset : distance from the skin, outward [m], 0 to 0.1; only used with ``place``.
    strength : strength of the focus, from 0 to 1; pressures are proportional to it, and 1 is the
        largest pressure that the array is allowed to produce.
    modulation : frequency at which the strength varies between 0 and its full value [Hz], at most
        20; 0 keeps it constant.
    """

    id: Name
    point: Triple | None = None
    place: str | None = None
    on: str | None = None
    offset: float = 0.5e-3
    strength: float = 1.0
    modulation: float = 0.0


class HandsMessage(msgspec.Struct, frozen=True, tag="hands"):
    """Frames of tracked hands, sent by an application in place of a tracker.

    Attributes
    ----------
    version : version of the message format, 1.
    hands : up to two frames (one per hand) in the JSON format that trackers send, which
        docs/trackers.md describes, with positions in the tracker's coordinates [m].
    """

    version: Version
    hands: Annotated[list[msgspec.Raw], Meta(max_length=2)]


class ObjectsMessage(msgspec.Struct, frozen=True, tag="objects", omit_defaults=True):
    """Changes to the virtual objects: removals first, then additions, then motions.

    Objects that are not listed do not change. If any change is invalid, the whole message is
    rejected and nothing changes.

    Attributes
    ----------
    version : version of the message format, 1.
    add : objects to add; an object with an existing name replaces the existing one. There can be
        64 objects in total.
    move : new poses of existing objects.
    remove : names of existing objects to remove, including those of the scene file.
    """

    version: Version
    add: Annotated[list[ObjectMessage], Meta(max_length=MAX_OBJECTS)] = []
    move: Annotated[list[MoveMessage], Meta(max_length=MAX_OBJECTS)] = []
    remove: Annotated[list[Name], Meta(max_length=MAX_OBJECTS)] = []


class FociMessage(msgspec.Struct, frozen=True, tag="foci"):
    """All foci of the application, which replace its earlier ones.

    Attributes
    ----------
    version : version of the message format, 1.
    foci : up to 16 foci; an empty list removes all foci of the application.
    """

    version: Version
    foci: Annotated[list[FocusMessage], Meta(max_length=MAX_FOCI)]


class ClearMessage(msgspec.Struct, frozen=True, tag="clear"):
    """Request from an application to remove all foci and objects that it has added.

    Attributes
    ----------
    version : version of the message format, 1.
    """

    version: Version


class ContactState(msgspec.Struct, frozen=True):
    """A contact of a hand with a virtual object, as part of a ``StateMessage``.

    Attributes
    ----------
    object : name of the object.
    part : part of the hand, such as "left.index" or "right.palm".
    point : predicted point on the skin that is deepest inside the object, in scene coordinates [m].
    depth : depth of this point below the object's surface [m]; negative, down to −1 mm, while skin
        that touched the object is just outside it.
    """

    object: str
    part: str
    point: Triple
    depth: float


class FocusState(msgspec.Struct, frozen=True):
    """Current position, strength and pressure of a focus, in a ``StateMessage``.

    Attributes
    ----------
    id : name given by the application, or the part of the hand and the object in
        contact, such as "left.index at ball".
    point : predicted position in scene coordinates [m], or null if unknown.
    strength : current strength, from 0 to 1.
    pressure : predicted peak pressure [Pa]; null while the effect of the hand is unknown.
    reason : why the focus receives no sound, for example because it is inside the hand;
        null if it receives sound.
    """

    id: str
    point: Triple | None
    strength: float
    pressure: float | None
    reason: str | None = None


class StateMessage(msgspec.Struct, frozen=True, tag="state"):
    """Message from the live loop to an application about the current foci and contacts.

    Positions in the message are in scene coordinates.

    Attributes
    ----------
    version : version of the message format, 1.
    state : state of the live loop: "playing", "fading" to silence, or "silent".
    reason : sentence that gives the reason for fading or silence, or null.
    contacts : list of the places where hands touch objects.
    foci : list of all foci, those of contacts and those requested by applications.
    """

    version: int
    state: Literal["playing", "fading", "silent"]
    reason: str | None = None
    contacts: list[ContactState] = []
    foci: list[FocusState] = []


class RejectedMessage(msgspec.Struct, frozen=True, tag="rejected"):
    """Notice that a message was rejected and had no effect.

    Attributes
    ----------
    version : version of the message format, 1.
    code : kind of error, as listed in docs/errors.md.
    reason : description of the error and its remedy.
    """

    version: int
    code: str
    reason: str


Message = HandsMessage | ObjectsMessage | FociMessage | ClearMessage
Answer = StateMessage | RejectedMessage


TYPES = ("hands", "objects", "foci", "clear")


class _Head(msgspec.Struct):
    type: str
    version: int


class _AnyHead(msgspec.Struct):
    type: str
    version: Any = None


# Without a decoder, a message would take eight times as long.
_decoder = msgspec.json.Decoder(Message)


def is_message(raw: bytes) -> bool:
    """Return whether a text is an application's message rather than a tracker's frame."""
    if b'"type"' not in raw:  # true of most frames
        return False
    try:
        head = msgspec.json.decode(raw, type=_AnyHead)
    except msgspec.ValidationError:
        return False
    except (ValueError, RecursionError):  # damaged JSON; ``read_message`` reports the fault
        return True
    # Frames of some trackers also have a key "type", but not one that is nearly that of a message.
    return head.version is not None or bool(difflib.get_close_matches(head.type, TYPES))


def read_message(text: bytes | str) -> Message:
    """Read a message from an application.

    Raises
    ------
    InvalidInput
        If the text is not JSON, has another version or an unknown type, or contains an invalid
        value.
    """
    try:
        raw = text.encode() if isinstance(text, str) else text
        if b"NaN" in raw or b"Infinity" in raw:  # not valid JSON, but Python writes it
            json.loads(raw, parse_constant=_not_finite)
        head = msgspec.json.decode(raw, type=_Head)
        if head.type not in TYPES:
            raise InvalidInput(
                f"{head.type!r} is not a message type; {nearest(head.type, TYPES)}",
                code="unknown_name",
            )
        if head.version != VERSION:
            raise InvalidInput(
                f"the message has version {head.version}, but the installed airtact only reads "
                f"version {VERSION}: use that version.",
                code="unsupported_version",
            )
        return _decoder.decode(raw)
    except InvalidInput:
        raise
    except msgspec.ValidationError as error:
        raise _explained(error) from None
    except (ValueError, RecursionError) as error:
        words = "it is nested too deeply" if isinstance(error, RecursionError) else str(error)
        raise InvalidInput(
            f"the message is not JSON: {words}; see docs/applications.md for examples.",
            code="unknown_format",
        ) from None


def converted(data: dict[str, Any], kind: Any) -> Any:
    """Convert keys and values to a message, or raise ``InvalidInput`` if a value is invalid."""
    try:
        return msgspec.convert(data, kind)
    except msgspec.ValidationError as error:
        raise _explained(error) from None


def _not_finite(word: str) -> None:
    raise InvalidInput(f"the message contains {word}; use finite numbers.", code="not_finite")


def _explained(error: msgspec.ValidationError) -> InvalidInput:
    fault, _, path = str(error).rpartition(" - at `$")
    fault = fault or path  # without a path, the fault concerns the whole message
    place = "the message" if fault is path else path.strip("`.")
    if isinstance(error.__cause__, InvalidInput):
        return InvalidInput(f"{place}: {error.__cause__}", code=error.__cause__.code)
    missing = re.fullmatch(r"Object missing required field `(.+)`", fault)
    if missing:
        return InvalidInput(f"{place} has no key {missing[1]}; add it.", code="key_missing")
    codes = {"Invalid enum": "unknown_name", "Object contains unknown": "unknown_key"}
    code = next((code for words, code in codes.items() if fault.startswith(words)), "out_of_range")
    words = f"{fault[:1].lower()}{fault[1:]}; see docs/applications.md."
    return InvalidInput(f"{place}: {words}", code=code)


def read_answer(text: bytes | str) -> Answer | None:
    """Read a message from the live loop; return None if its type is unknown."""
    try:
        return msgspec.json.decode(text, type=Answer)
    except msgspec.MsgspecError:
        return None


def message_schema() -> str:
    """Return the JSON schema of all messages between applications and the live loop.

    Use the schema to check messages, or to generate code for them in other languages.

    Returns
    -------
    The schema as JSON text (draft 2020-12). Each message has a definition with its name, such as
    "ObjectsMessage", under the key "$defs".
    """
    (made,), definitions = msgspec.json.schema_components(
        [Message | Answer], ref_template="#/$defs/{name}"
    )
    for definition in definitions.values():
        # Remove the indentation of the docstrings.
        definition["description"] = inspect.cleandoc(definition["description"])
    schema = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"Messages between applications and airtact live, version {VERSION}",
        **made,
        "$defs": definitions,
    }
    return json.dumps(schema, indent=1) + "\n"
