"""Websocket server for trackers and applications."""

import select
import socket
import time
from contextlib import suppress
from typing import TYPE_CHECKING

import msgspec

from airtact.errors import InvalidInput
from airtact.hands.tracking.receivers import MAX_MESSAGE, WebSocketReceiver
from airtact.hands.tracking.stream import HandStream
from airtact.live.messages import (
    VERSION,
    Answer,
    HandsMessage,
    RejectedMessage,
    StateMessage,
    is_message,
    read_message,
)
from airtact.live.world import World

if TYPE_CHECKING:
    from websockets.sync.server import ServerConnection

# Shortest time between two states that are sent to an application [s].
STATE_INTERVAL = 1.0 / 60.0


class ApplicationServer(WebSocketReceiver):
    """Websocket server for trackers and applications.

    Applications send messages of the types defined in ``messages``, which change ``world``. After
    an application's first message, its connection receives the newest state, at most 60 times
    per second. States are skipped while the application has not read the earlier ones. All other
    messages are treated as frames from a tracker.

    Parameters
    ----------
    stream : stream to which received frames of hands are added.
    port, host : port and address to listen on; port 0 selects a free port.
    world : objects and foci that applications can change.
    """

    def __init__(
        self, stream: HandStream, world: World, port: int = 0, host: str = "127.0.0.1"
    ) -> None:
        self._world = world
        # For each application: when the last state was sent, and that state.
        self._sent: dict[str, tuple[float, StateMessage | None]] = {}
        super().__init__(stream, port, host)

    def _receive(self, connection: "ServerConnection") -> None:
        from websockets.frames import CloseCode

        source = str(connection.id)
        # In a large buffer, seconds of old states would accumulate if an application reads slowly.
        # The tracker may already have gone; what it sent is still used.
        with suppress(OSError):
            connection.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 2**16)
        try:
            super()._receive(connection)
        finally:
            closing = connection.protocol.close_sent
            if closing is not None and closing.code == CloseCode.MESSAGE_TOO_BIG:
                size = f"{MAX_MESSAGE:,} bytes"
                self._world.reject(f"a message is longer than {size}; its connection was closed.")
            self._sent.pop(source, None)
            self._world.close(source)

    def _serve(self, connection: "ServerConnection", source: str) -> bool:
        try:
            message = connection.recv(STATE_INTERVAL if source in self._sent else None)
        except TimeoutError:
            self._report(connection, source)
            return False
        try:
            raw = message.encode() if isinstance(message, str) else message
            if is_message(raw):
                self._sent.setdefault(source, (-1.0, None))
                take_text(raw, source, self.stream, self._world)
            elif fault := self.stream.feed_json(raw, source):
                raise fault
        except InvalidInput as fault:
            # Faulty frames of trackers are counted in the health of the stream.
            if source in self._sent or fault.code == "unreadable":
                self._world.reject(str(fault))
            _send(connection, RejectedMessage(VERSION, fault.code, str(fault)))
            return False
        finally:
            self._report(connection, source)
        self._world.alive(source)
        return True

    def _report(self, connection: "ServerConnection", source: str) -> None:
        """Send the newest state to an application if a new state is due."""
        if source not in self._sent:
            return
        then, before = self._sent[source]
        now = time.monotonic()
        if now - then >= STATE_INTERVAL and (state := self._world.state) is not before:
            _send(connection, state)
            self._sent[source] = (now, state)


def take_text(text: bytes | str, source: str, stream: HandStream, world: World) -> None:
    """Process an application's message: pass hands to ``stream`` and the rest to ``world``.

    Raises
    ------
    InvalidInput
        If the message or a frame of a hand is invalid.
    """
    message = read_message(text)
    if isinstance(message, HandsMessage):
        # A fault of one hand must not discard the other.
        faults = [stream.feed_json(bytes(frame), source) for frame in message.hands]
        for fault in filter(None, faults):
            raise fault
    world.receive(message, source)


def _send(connection: "ServerConnection", answer: Answer) -> None:
    # Sending would wait for an application that does not read, so skip the message instead.
    try:
        ready = select.select([], [connection.socket], [], 0.0)[1]
    except (OSError, ValueError):  # the socket was just closed
        return
    if ready:
        connection.send(msgspec.json.encode(answer), text=True)
