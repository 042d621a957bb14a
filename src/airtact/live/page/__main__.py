"""The process of the page: moments from its input, settings of the page to its output."""

import os
import pickle
import sys
from contextlib import suppress
from threading import Lock, Thread

from airtact.errors import InvalidInput, extra
from airtact.hands.tracking.frame import HandFrame
from airtact.live.moment import Controls
from airtact.live.page.process import PageSettings, Shown
from airtact.timing import give_way


class Pipe:
    """Connection to the loop; of the moments that come only the newest counts."""

    def __init__(self) -> None:
        self._out = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
        # viser prints to the standard output, which must hold messages only.
        with open(os.devnull, "wb") as nothing:
            os.dup2(nothing.fileno(), sys.stdout.fileno())
        self._lock = Lock()
        self.settings: PageSettings = pickle.load(sys.stdin.buffer)
        self.newest: Shown | None = None
        self.ended = False

    def listen(self) -> None:
        """Take moments from now on."""
        Thread(target=self._listen, daemon=True).start()

    def send(self, message: str | InvalidInput | Controls | HandFrame) -> None:
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
    try:
        with extra("live", "to go without a page give --no-page; the page needs viser"):
            from airtact.live.page.panel import paint
            from airtact.live.page.server import start_server
        server, address = start_server(pipe.settings.port, pipe.settings.host)
    except InvalidInput as fault:
        pipe.send(fault)
        return
    pipe.send(address)
    give_way(5)  # only now: starting computes, and the user waits for the page
    pipe.listen()
    paint(server, pipe.settings, lambda: pipe.newest, pipe.send, lambda: pipe.ended)
    server.stop()


if __name__ == "__main__":
    main()
