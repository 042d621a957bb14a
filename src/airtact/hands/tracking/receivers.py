"""A server that receives frames from trackers over a websocket.

The server runs in its own threads and feeds a ``HandStream``. It is meant for trackers on the same
computer: the default address is 127.0.0.1, and web pages of other sites cannot connect.
"""

import logging
import re
import socket
import time
from contextlib import suppress
from threading import Lock, Thread
from typing import TYPE_CHECKING

from airtact.errors import InvalidInput, extra, number
from airtact.hands.tracking.stream import HandStream

if TYPE_CHECKING:
    from websockets.http11 import Request, Response
    from websockets.sync.server import ServerConnection

# Failed handshakes must not print tracebacks.
SILENT = logging.Logger("airtact.receiver")
SILENT.addHandler(logging.NullHandler())

# Longest message on a websocket [bytes]; a cloud of 50,000 points needs 2 million.
MAX_MESSAGE = 2**22


def bound_socket(kind: socket.SocketKind, host: str, port: int) -> socket.socket:
    """Open a socket that is bound to a port; port 0 selects a free port."""
    if not 0 <= number(port, "the port", "") <= 65535:
        raise InvalidInput(
            f"port {port} does not exist; use 1 to 65535, or 0 for any free port.",
            code="out_of_range",
        )
    bound = socket.socket(socket.AF_INET, kind)
    try:
        if kind == socket.SOCK_STREAM:
            bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        bound.bind((host, port))
    except OSError as error:
        bound.close()
        raise InvalidInput(
            f"the receiver cannot listen on {host}, port {port}: {error.strerror}; use another "
            "port.",
            code="link_in_use",
        ) from None
    return bound


class WebSocketReceiver:
    """Websocket server that receives frames of tracked hands in JSON and feeds them to a stream.

    Trackers connect to ws://HOST:PORT and send the JSON format of ``HandStream.feed_json``, in
    messages of up to 4 MiB. Read the frames with ``stream.wait`` or ``stream.latest``. Faulty
    frames are skipped and counted in ``stream.health``. Use the receiver in a ``with`` block; it
    listens from its construction to the end of the block, or until ``close``.

    Parameters
    ----------
    stream : ``HandStream`` that receives the frames, which is also an attribute; by default a new
        one.
    port : port to listen on; 0, the default, selects a free port, which is stored in the attribute
        ``port``.
    host : address to listen on; by default 127.0.0.1, which only this computer can reach.

    Raises
    ------
    InvalidInput
        If the port is in use or does not exist, or if the optional package websockets is not
        installed.
    """

    def __init__(
        self, stream: HandStream | None = None, port: int = 0, host: str = "127.0.0.1"
    ) -> None:
        with extra("tracking", "the websocket receiver needs the package websockets"):
            from websockets.sync.server import serve

        self.stream = HandStream() if stream is None else stream
        bound = bound_socket(socket.SOCK_STREAM, host, port)
        bound.listen()
        self.port: int = bound.getsockname()[1]
        self._closed = False
        # Connections, each with the time when it opened or last sent a used frame.
        self._connections: dict[ServerConnection, float] = {}
        self._lock = Lock()
        self._server = serve(
            self._receive,
            sock=bound,
            # Local pages are allowed, and so are programs without an origin, which are not
            # browsers.
            origins=[None, re.compile(r"https?://(localhost|127\.0\.0\.1)(:\d+)?")],
            process_response=self._open,
            max_size=MAX_MESSAGE,
            compression=None,
            close_timeout=1,
            logger=SILENT,
        )
        self._thread = Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    def __enter__(self) -> "WebSocketReceiver":
        return self

    def __exit__(self, *fault: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop listening and close all connections."""
        self._server.shutdown()
        with self._lock:
            self._closed = True
            connections = list(self._connections)
        for connection in connections:
            connection.close()
        # Messages that were already received are still processed. A connection that broke while it
        # opened stays in the list, hence the limit.
        end = time.monotonic() + 2.0
        while self._connections and time.monotonic() < end:
            time.sleep(0.01)
        self._thread.join()

    def _open(self, connection: "ServerConnection", request: "Request", answer: "Response") -> None:
        """Register a connection before its tracker sees that it is open; ``close`` waits for it."""
        with self._lock:
            if answer.status_code == 101 and not self._closed:
                self._connections[connection] = time.monotonic()

    def _receive(self, connection: "ServerConnection") -> None:
        from websockets.exceptions import ConnectionClosed, ConnectionClosedOK

        with self._lock:
            if connection not in self._connections:
                return
            if len(self._connections) > 64:
                # Idle connections must not keep a tracker out, so the one that has not sent a used
                # frame for the longest time is closed.
                idle = min(self._connections, key=self._connections.__getitem__)
                del self._connections[idle]
                with suppress(OSError):
                    idle.socket.shutdown(socket.SHUT_RDWR)
        source = str(connection.id)
        try:
            while True:
                if self._serve(connection, source) and connection in self._connections:
                    self._connections[connection] = time.monotonic()
        except ConnectionClosedOK:
            self.stream.disconnect(source, interrupted=False)
        except ConnectionClosed:
            self.stream.disconnect(source, interrupted=True)
        finally:
            with self._lock:
                self._connections.pop(connection, None)

    def _serve(self, connection: "ServerConnection", source: str) -> bool:
        """Wait for a message and process it; return whether the frame is used."""
        return self.stream.feed_json(connection.recv(), source) is None
