"""Messages between two processes over a socket: whole ones or none, whatever happens to the other side."""

import pickle
import socket
import struct
import time
from typing import Any

LENGTH = struct.Struct("<Q")
"""What stands before each message: its length in bytes."""


class Channel:
    """One end of a connection that carries Python objects; a message that came in part never blocks.

    Parameters
    ----------
    end : of a pair of connected sockets.
    patience : how long the other side may take to accept a message [s].
    """

    def __init__(self, end: socket.socket, patience: float = 10.0) -> None:
        self._socket = end
        self._patience = patience
        self._received = bytearray()

    def send(self, message: tuple[object, ...]) -> None:
        """Send objects that can be pickled; raise OSError if the other side is gone or does not accept it."""
        data = pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL)
        self._socket.settimeout(self._patience)
        self._socket.sendall(LENGTH.pack(len(data)) + data)

    def receive(self, seconds: float) -> tuple[Any, ...] | None:
        """Return the next message, or None if it is not complete after some seconds.

        Raises
        ------
        EOFError
            If the other side is gone.
        """
        end = time.monotonic() + seconds
        while (message := self._complete()) is None:
            self._socket.settimeout(max(end - time.monotonic(), 0.0))
            try:
                # 1 << 20: most bytes that are read at once.
                part = self._socket.recv(1 << 20)
            except (BlockingIOError, TimeoutError):
                return None
            except OSError:
                part = b""
            if not part:
                raise EOFError
            self._received += part
        return message

    def close(self) -> None:
        """Close this end, which the other side notices at once."""
        self._socket.close()

    def _complete(self) -> tuple[Any, ...] | None:
        """Take the first message from what was received, if all of it is there."""
        if len(self._received) < LENGTH.size:
            return None
        (length,) = LENGTH.unpack_from(self._received)
        whole = LENGTH.size + length
        if len(self._received) < whole:
            return None
        message = pickle.loads(memoryview(self._received)[LENGTH.size : whole].tobytes())
        del self._received[:whole]
        return message
