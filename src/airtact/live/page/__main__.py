"""The process of the page: it reads moments from its input and writes what was set on the page to its output."""

import os
import pickle
import sys
from contextlib import suppress
from threading import Lock, Thread

from airtact.errors import InvalidInput, extra
from airtact.hands.tracking.frame import HandFrame
from airtact.live.page.process import Fault, PageSettings, Shown
from airtact.live.parts import Controls
from airtact.timing import give_way

NICE = 5
"""Lower priority than the loop's."""


class Pipe:
    """What comes from the loop, of which only the newest counts, and what goes back."""

    def __init__(self) -> None:
        self._out = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
        with open(
            os.devnull, "wb"
        ) as nothing:  # viser prints, and what is printed here is no message
            os.dup2(nothing.fileno(), sys.stdout.fileno())
        self._lock = Lock()
        self.newest: Shown | None = None
        self.ended = False

    def settings(self) -> PageSettings:
        """Read what the page starts from."""
        return pickle.load(sys.stdin.buffer)

    def listen(self) -> None:
        """Take moments from now on."""
        Thread(target=self._listen, daemon=True).start()

    def send(self, message: str | Fault | Controls | HandFrame) -> None:
        """Send a message to the loop, from any thread."""
        with self._lock, suppress(OSError):
            pickle.dump(message, self._out)
            self._out.flush()

    def _listen(self) -> None:
        with suppress(EOFError, OSError, pickle.UnpicklingError):
            while True:
                self.newest = pickle.load(sys.stdin.buffer)
        self.ended = True


def main() -> None:
    """Serve the page until the input ends."""
    pipe = Pipe()
    settings = pipe.settings()
    try:
        with extra("live", "to go without a page give --no-page; the page needs viser"):
            from airtact.live.page.painter import paint
            from airtact.live.page.server import start_server
        server, address = start_server(settings.port, settings.host)
    except InvalidInput as fault:
        pipe.send(Fault(str(fault), fault.code))
        return
    pipe.send(address)
    give_way(NICE)  # only now: to start is to compute, and who waits for the page waits
    pipe.listen()
    paint(server, settings, lambda: pipe.newest, pipe.send, lambda: pipe.ended)
    server.stop()


if __name__ == "__main__":
    main()
