"""OSC over UDP for hands, objects and foci, for Unity, Unreal, TouchDesigner and Max.

Every address begins with /airtact; docs/applications.md lists all addresses. Each OSC message is
converted to a message of ``messages``.
"""

import socket
import time
from collections.abc import Sequence
from contextlib import suppress
from threading import Thread
from typing import Any

import msgspec
import numpy as np

from airtact.errors import InvalidInput, counted, extra
from airtact.hands.tracking.receivers import bound_socket
from airtact.hands.tracking.stream import HandStream
from airtact.live.applications import STATE_INTERVAL, take_text
from airtact.live.messages import VERSION, Message, converted
from airtact.live.world import World
from airtact.setup.parsing import nearest

# Arguments of each address, which follows /airtact/. Those in brackets are optional.
ARGUMENTS = {
    "hand": "side time sequence [x y z ...]",
    "focus": "id x y z [strength] [modulation]",
    "focus/place": "id place [strength] [modulation]",
    "object/sphere": "name x y z radius",
    "object/box": "name x y z width depth height",
    "object/move": "name x y z qx qy qz qw",
    "object/remove": "name",
    "clear": "",
    "json": "text",
    "reply": "port",
}


class OscServer:
    """OSC server for trackers and applications; each sender receives the newest state in return.

    The server listens from its construction until ``close`` is called.

    Parameters
    ----------
    stream : stream to which received frames of hands are added.
    world : objects and foci that applications can change.
    port : port to listen on; 0 selects a free port. The attribute ``port`` contains the port
        used.
    host : address to listen on.

    Raises
    ------
    InvalidInput
        If the port is in use or invalid, or the optional package python-osc is not installed.
    """

    def __init__(
        self, stream: HandStream, world: World, port: int = 0, host: str = "127.0.0.1"
    ) -> None:
        with extra("tracking", "OSC needs python-osc"):
            import pythonosc.osc_packet  # noqa: F401 (the thread uses it)
        self._stream = stream
        self._world = world
        self._socket = bound_socket(socket.SOCK_DGRAM, host, port)
        self._socket.settimeout(STATE_INTERVAL)
        self.port: int = self._socket.getsockname()[1]
        # When each sender last sent a packet, and the reply port requested by each computer.
        self._heard: dict[tuple[str, int], float] = {}
        self._ports: dict[str, int] = {}
        self._closed = False
        self._thread = Thread(target=self._listen, name="airtact osc", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop listening."""
        self._closed = True
        self._thread.join()
        self._socket.close()

    def _listen(self) -> None:
        sent = 0.0
        state = None
        while not self._closed:
            try:
                packet, sender = self._socket.recvfrom(2**16)
                self._take(packet, sender)
            except OSError:  # a timeout; on Windows, also if an answer could not be delivered
                pass
            now = time.monotonic()
            if now - sent < STATE_INTERVAL or self._world.state is state:
                continue
            sent = now
            state = self._world.state
            # A sender that sent nothing for 5 s receives no more states.
            self._heard = {
                sender: heard for sender, heard in self._heard.items() if now < heard + 5.0
            }
            if not self._heard:
                continue
            lines: list[tuple[str, list[Any]]] = [("state", [state.state, state.reason or ""])]
            for contact in state.contacts:
                numbers = [*contact.point, contact.depth]
                lines.append(("state/contact", [contact.object, contact.part, *numbers]))
            for focus in state.foci:
                pressure = np.nan if focus.pressure is None else focus.pressure
                numbers = [*(focus.point or 3 * [np.nan]), focus.strength, pressure]
                lines.append(("state/focus", [focus.id, *numbers, focus.reason or ""]))
            self._send(_bundle(lines), *self._heard)

    def _take(self, packet: bytes, sender: tuple[str, int]) -> None:
        from pythonosc.osc_packet import OscPacket

        # Keep only the newest senders: a program may use a new port for each message.
        self._heard.pop(sender, None)
        self._heard[sender] = time.monotonic()
        if len(self._heard) > 64:
            del self._heard[next(iter(self._heard))]
        try:
            try:
                messages = [timed.message for timed in OscPacket(packet).messages]
            except Exception as error:  # errors of struct and str, and the parser's own errors
                raise InvalidInput(
                    f"the received {len(packet)} bytes are not an OSC message: {error}.",
                    code="unknown_format",
                ) from None
            for message in messages:
                self._process(message.address, list(message.params), sender)
        except InvalidInput as fault:
            self._world.reject(str(fault))
            self._send(_bundle([("rejected", [fault.code, str(fault)])]), sender)

    def _process(self, address: str, values: Sequence[Any], sender: tuple[str, int]) -> None:
        source = f"{sender[0]}:{sender[1]}"
        kind = address.removeprefix("/airtact/")
        values = _checked(kind, values)
        if kind == "hand":
            side, taken, sequence, *numbers = values
            points = [numbers[index : index + 3] for index in range(0, len(numbers), 3)]
            frame = {"time": taken, "side": side, "sequence": sequence, "landmarks": points or None}
            if fault := self._stream.feed_json(msgspec.json.encode(frame), source):
                raise fault
            self._world.alive(source)
        elif kind == "reply":
            (port,) = values
            if not (isinstance(port, int) and 0 < port < 65536):
                raise InvalidInput(
                    f"{port!r} is not a valid port for replies; use 1 to 65535.",
                    code="out_of_range",
                )
            if len(self._ports) < 64:
                self._ports[sender[0]] = port
        elif kind == "json":
            take_text(str(values[0]), source, self._stream, self._world)
        else:
            self._world.receive(message_of(kind, values), source, keep=True)

    def _send(self, packet: bytes, *senders: tuple[str, int]) -> None:
        addresses = {(host, self._ports.get(host, port)) for host, port in senders}
        for address in addresses:
            with suppress(OSError):  # nobody listens there, or the packet is too long
                self._socket.sendto(packet, address)


def message_of(kind: str, values: Sequence[Any]) -> Message:
    """Convert a known OSC address (without its prefix /airtact/) and its arguments to a message.

    Raises
    ------
    InvalidInput
        If a value is invalid.
    """
    name, *numbers = values or [""]
    data: dict[str, Any] = {"version": VERSION, "type": "clear"}
    if kind in ("focus", "focus/place"):
        focus = {"id": name, "point": numbers[:3]}
        if kind == "focus/place":
            focus = {"id": name, "place": numbers[0]}
            numbers = [None, None, *numbers]
        focus |= dict(zip(("strength", "modulation"), numbers[3:], strict=False))
        data |= {"type": "foci", "foci": [focus]}
    elif kind == "object/remove":
        data |= {"type": "objects", "remove": [name]}
    elif kind.startswith("object"):
        thing = {"name": name, "pose": {"translation": numbers[:3]}}
        if kind == "object/move":
            thing["pose"]["quaternion"] = numbers[3:]
            data |= {"type": "objects", "move": [thing]}
        else:
            shape = {"radius": numbers[3]} if kind == "object/sphere" else {"sides": numbers[3:]}
            thing[kind.removeprefix("object/")] = shape
            data |= {"type": "objects", "add": [thing]}
    return converted(data, Message)


def _checked(kind: str, values: Sequence[Any]) -> list[Any]:
    """Check the address and the number of arguments, and return the arguments."""
    arguments = ARGUMENTS.get(kind)
    if arguments is None:
        raise InvalidInput(
            f"/airtact/{kind} is not a known address; {nearest(kind, ARGUMENTS, '/airtact/')}",
            code="unknown_name",
        )
    needed = len(arguments.partition("[")[0].split())
    most = np.inf if "..." in arguments else needed + arguments.count("[")
    if not needed <= len(values) <= most:
        raise InvalidInput(
            f"/airtact/{kind} was sent with {counted(len(values), 'argument', 'arguments')}. "
            f"The arguments must be: {arguments or 'none'}.",
            code="sizes_differ",
        )
    return list(values)


def _bundle(lines: Sequence[tuple[str, Sequence[Any]]]) -> bytes:
    """Encode OSC addresses (without their prefix /airtact/) and their arguments as one packet."""
    from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
    from pythonosc.osc_message_builder import OscMessageBuilder

    bundle = OscBundleBuilder(IMMEDIATELY)
    for kind, values in lines:
        message = OscMessageBuilder(f"/airtact/{kind}")
        for value in values:
            message.add_arg(value)
        bundle.add_content(message.build())
    return bundle.build().dgram
