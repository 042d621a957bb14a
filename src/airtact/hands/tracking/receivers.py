"""Sockets that trackers send their frames to; each listens in threads of its own and feeds a ``HandStream``.

They are for trackers on this computer: they listen at 127.0.0.1 unless another host is given, and
pages of other sites in a browser cannot connect to them.
"""

import re
import socket
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress
from threading import Lock, Thread
from typing import TYPE_CHECKING

from airtact.errors import InvalidInput, extra
from airtact.hands.tracking.stream import HandStream

if TYPE_CHECKING:
    from websockets.sync.server import ServerConnection

LARGEST_MESSAGE = 2**22
"""Longest message that is taken from a websocket [bytes]; a cloud of 50,000 points needs 2 million."""

MOST_WAITING = 256
"""Most messages of a websocket, or packets of OSC, that are taken at once, where they come faster than are read."""

MOST_CONNECTIONS = 64
"""Trackers that may be connected at a time; others are turned away with the code 1013, "try again later"."""

LARGEST_PACKET = 2**16
"""Longest packet of UDP [bytes]."""

LOOKS = 0.1
"""So often a receiver of UDP looks whether it was closed [s]."""

OWN_PAGES = re.compile(r"https?://(localhost|127\.0\.0\.1)(:\d+)?")
"""Pages that may send frames; programs that are no browser name no page and may always."""


class _Receiver(ABC):
    """Listens at a port from its making to the end of its block, and feeds a stream."""

    def __init__(
        self, stream: HandStream | None, kind: socket.SocketKind, port: int, host: str
    ) -> None:
        if not 0 <= port <= 65535:
            raise InvalidInput(
                f"port {port} does not exist; give 1 to 65535, or 0 for any that is free.",
                code="out_of_range",
            )
        self.stream = HandStream() if stream is None else stream
        self._socket = socket.socket(socket.AF_INET, kind)
        try:
            if kind == socket.SOCK_STREAM:
                self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._socket.bind((host, port))
            if kind == socket.SOCK_STREAM:
                self._socket.listen()
        except OSError as error:
            self._socket.close()
            raise InvalidInput(
                f"the receiver cannot listen at {host}, port {port}: {error.strerror}; take another port.",
                code="link_in_use",
            ) from None
        self.port: int = self._socket.getsockname()[1]
        self._closed = False

    def __enter__(self) -> "_Receiver":
        return self

    def __exit__(self, *fault: object) -> None:
        self.close()

    @abstractmethod
    def close(self) -> None:
        """Stop listening."""

    def _start(self, listen: Callable[[], None]) -> None:
        self._thread = Thread(target=listen, name=f"airtact {type(self).__name__}", daemon=True)
        self._thread.start()


class WebSocketReceiver(_Receiver):
    """Listens for websockets that send frames in JSON, up to 64 at a time; a message has 4 MiB at most.

    Use it in a ``with`` block; it listens from its making to the end of the block.

    Parameters
    ----------
    stream : what is fed; a new one unless given.
    port : to listen at; 0 takes a free one, which the attribute ``port`` holds.
    host : the address to listen at.

    Raises
    ------
    InvalidInput
        The port is taken by another program, or does not exist.
    """

    def __init__(
        self, stream: HandStream | None = None, port: int = 0, host: str = "127.0.0.1"
    ) -> None:
        with extra("tracking", "hands by websocket need the package websockets"):
            from websockets.sync.server import serve

        super().__init__(stream, socket.SOCK_STREAM, port, host)
        self._connections: set[ServerConnection] = set()
        self._lock = Lock()
        limits = {"max_size": LARGEST_MESSAGE, "compression": None, "close_timeout": 1}
        self._server = serve(self._receive, sock=self._socket, origins=[None, OWN_PAGES], **limits)
        self._start(self._server.serve_forever)

    def close(self) -> None:
        """Stop listening and end all connections."""
        self._server.shutdown()
        with self._lock:
            self._closed = True
            connections = list(self._connections)
        for connection in connections:
            connection.close()
        self._thread.join()

    def _receive(self, connection: "ServerConnection") -> None:
        from websockets.exceptions import ConnectionClosed, ConnectionClosedOK

        with self._lock:
            if self._closed:
                return
            full = len(self._connections) >= MOST_CONNECTIONS
            if not full:
                self._connections.add(connection)
        if full:
            connection.close(1013, f"{MOST_CONNECTIONS} trackers are connected already")
            return
        try:
            while True:
                self.stream.feed_waiting(_waiting(connection))
        except ConnectionClosedOK:
            pass
        except ConnectionClosed:
            self.stream.interrupt()
        finally:
            with self._lock:
                self._connections.discard(connection)


def _waiting(connection: "ServerConnection") -> list[bytes | str]:
    """Wait for a message, and take those with it that have come as well, ``LARGEST_MESSAGE`` bytes in all at most."""
    from websockets.exceptions import ConnectionClosed

    found = [connection.recv()]
    size = len(found[0])
    with suppress(TimeoutError, ConnectionClosed):  # the next wait raises the latter again
        while len(found) < MOST_WAITING and size < LARGEST_MESSAGE:
            found.append(connection.recv(timeout=0))
            size += len(found[-1])
    return found


class OscReceiver(_Receiver):
    """Listens for OSC over UDP; its parameters, its errors and its use are those of ``WebSocketReceiver``."""

    def __init__(
        self, stream: HandStream | None = None, port: int = 0, host: str = "127.0.0.1"
    ) -> None:
        super().__init__(stream, socket.SOCK_DGRAM, port, host)
        self._socket.settimeout(LOOKS)
        self._start(self._listen)

    def close(self) -> None:
        """Stop listening."""
        self._closed = True
        self._thread.join()
        self._socket.close()

    def _listen(self) -> None:
        while not self._closed:
            try:
                packets = self._waiting()
            except OSError:  # timeout; or of Windows, when an answer could not be delivered: the next packet comes
                continue
            self.stream.feed_waiting_osc(packets)

    def _waiting(self) -> list[bytes]:
        """Wait for a packet, and take those with it that have come as well, ``MOST_WAITING`` at most."""
        found = [self._socket.recv(LARGEST_PACKET)]
        self._socket.settimeout(0.0)
        with suppress(OSError):
            while len(found) < MOST_WAITING:
                found.append(self._socket.recv(LARGEST_PACKET))
        self._socket.settimeout(LOOKS)
        return found
