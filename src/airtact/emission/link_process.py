"""The process that holds a link: it plays for its feeder, and silences the boards without it.

Nothing that ends the feeder ends this process before the boards are silent. It has a session of its
own, ignores every signal that it can, and notices at once when the feeder's end of the connection
closes or the feeder is gone.
"""

import os
import pickle
import signal
import socket
import struct
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from airtact.emission.link import Link, LinkFailed
from airtact.emission.player import Player
from airtact.errors import InvalidInput


class Channel:
    """One end of a connection that carries Python objects; an incomplete message never blocks.

    Parameters
    ----------
    end : of a pair of connected sockets.
    patience : time that the other side may take to accept a message [s].
    """

    # Precedes each message: its length in bytes.
    LENGTH = struct.Struct("<Q")

    def __init__(self, end: socket.socket, patience: float = 10.0) -> None:
        self._socket = end
        self._patience = patience
        self._received = bytearray()

    def send(self, message: tuple[object, ...]) -> None:
        """Send objects that can be pickled; raise OSError if the other side does not take them."""
        data = pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL)
        # A feeder that does not read must not keep the player from the watchdog.
        self._socket.settimeout(self._patience)
        self._socket.sendall(self.LENGTH.pack(len(data)) + data)

    def receive(self, seconds: float) -> tuple[Any, ...] | None:
        """Return the next message or None in time; raise EOFError if the other side is gone."""
        end = time.monotonic() + seconds
        while (message := self._complete()) is None:
            self._socket.settimeout(max(end - time.monotonic(), 0.0))
            try:
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
        if len(self._received) < self.LENGTH.size:
            return None
        end = self.LENGTH.size + self.LENGTH.unpack_from(self._received)[0]
        if len(self._received) < end:
            return None
        message = pickle.loads(self._received[self.LENGTH.size : end])
        del self._received[:end]
        return message


def serve(
    channel: Channel, gone: Callable[[], bool] = lambda: False, here: Link | None = None
) -> None:
    """Play a link, ``here`` or from the first message, until its feeder closes it or is gone."""
    player: Player | None = None
    try:
        while not gone():
            message = channel.receive(0.1 if player is None else player.wait())
            if message is not None:
                number, name, arguments = message
                answer: Any = None
                fault: BaseException | None = None
                try:
                    if name == "open":
                        link, settings, feeder = arguments
                        opened = Player(here or link, settings)
                        opened.link.holder = feeder
                        opened.open()
                        # Only now: a link that did not open is not silenced, and this process ends.
                        player = opened
                    else:
                        answer = getattr(player, name)(*arguments)
                except BaseException as error:
                    fault = _carried(error)
                channel.send((number, answer, fault, 0 if player is None else player.link.sent))
                if name == "close" or player is None:
                    return
            if player is not None:
                player.step()
    except (EOFError, OSError):  # the feeder is gone: silence the boards below
        pass
    finally:
        if player is not None:
            _end(player)
        channel.close()


def _carried(error: BaseException) -> BaseException:
    """Return an error as another process can raise it."""
    if isinstance(error, InvalidInput | LinkFailed):
        error.__cause__ = error.__context__ = None
        return error
    return LinkFailed(f"the link raised {type(error).__name__}: {error}.", code="link_failed")


def _end(player: Player) -> None:
    """Silence the boards without a feeder, and close the link."""
    # No feeder is left to report to, so silence that is not confirmed is tried again for 5 s.
    for _ in range(50):
        try:
            player.finish("its process was gone")
            break
        except BaseException:
            time.sleep(0.1)
    with suppress(BaseException):
        player.close()


def main() -> None:
    """Serve the feeder whose connection and process number are the arguments."""
    # Children that a library starts must be waited for, and faults of the machine must not repeat
    # for ever.
    needed = {
        signal.SIGCHLD,
        signal.SIGSEGV,
        signal.SIGFPE,
        signal.SIGILL,
        signal.SIGBUS,
        signal.SIGABRT,
    }
    for kind in signal.valid_signals() - needed:
        with suppress(OSError, ValueError):
            signal.signal(kind, signal.SIG_IGN)
    feeder = int(sys.argv[2])
    serve(Channel(socket.socket(fileno=int(sys.argv[1]))), lambda: os.getppid() != feeder)


if __name__ == "__main__":
    main()
