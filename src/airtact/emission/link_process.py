"""The process in which a link lives: it plays what its feeder sends, and silences the boards when the feeder is gone.

Nothing that ends the feeder ends this process before the boards are silent: it is in a session of
its own, ignores every signal that it can, and sees at once when the feeder's end of the connection
closes or its process is gone.
"""

import os
import signal
import socket
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from airtact.emission.channel import Channel
from airtact.emission.link import Link, LinkFailed
from airtact.emission.player import Player
from airtact.errors import InvalidInput

RETRIES = 50
RETRY_PAUSE = 0.1
"""How often silence is tried where it is not confirmed and no feeder is left, and the time between [s]."""


def serve(
    channel: Channel, gone: Callable[[], bool] = lambda: False, here: Link | None = None
) -> None:
    """Play a link until its feeder closes it or is gone; a link that is not ``here`` comes with the first message."""
    player: Player | None = None
    try:
        while not gone():
            message = channel.receive(0.1 if player is None else player.wait())
            if message is not None:
                number, name, arguments = message
                player, answer, fault = _obeyed(player, name, arguments, here)
                channel.send((number, answer, fault, 0 if player is None else player.link.sent))
                if name == "close" or player is None:
                    return
            if player is not None:
                player.step()
    except (EOFError, OSError):  # the feeder is gone: what follows silences the boards
        pass
    finally:
        if player is not None:
            _end(player)
        channel.close()


def _obeyed(
    player: Player | None, name: str, arguments: Any, here: Link | None
) -> tuple[Player | None, Any, BaseException | None]:
    """Do what a message asks; return the player, an answer and a fault."""
    try:
        if name == "open":
            link, *settings = arguments
            return _opened(here or link, *settings), None, None
        return player, getattr(player, name)(*arguments), None
    except BaseException as error:
        return player, None, _carried(error)


def _opened(link: Link, settings: Any, feeder: int) -> Player:
    player = Player(link, settings)
    link.holder = feeder
    player.open()
    return player


def _end(player: Player) -> None:
    """Silence the boards without a feeder, and close the link."""
    for _ in range(RETRIES):
        try:
            # "its process was gone": why an emission is over whose feeder died.
            player.finish("its process was gone")
            break
        except BaseException:
            time.sleep(RETRY_PAUSE)
    with suppress(BaseException):
        player.close()


def _carried(error: BaseException) -> BaseException:
    """Return an error as another process can raise it."""
    if isinstance(error, InvalidInput | LinkFailed):
        error.__cause__ = error.__context__ = None
        return error
    return LinkFailed(f"the link raised {type(error).__name__}: {error}.", code="link_failed")


def main() -> None:
    """Serve the feeder whose connection and number are the arguments."""
    for kind in signal.valid_signals():
        with suppress(OSError, ValueError):
            # Children that a library starts must be waited for; faults of the machine must not
            # repeat for ever.
            if kind not in (
                signal.SIGCHLD,
                signal.SIGSEGV,
                signal.SIGFPE,
                signal.SIGILL,
                signal.SIGBUS,
                signal.SIGABRT,
            ):
                signal.signal(kind, signal.SIG_IGN)
    end = socket.socket(fileno=int(sys.argv[1]))
    feeder = int(sys.argv[2])
    serve(Channel(end), lambda: os.getppid() != feeder)


if __name__ == "__main__":
    main()
