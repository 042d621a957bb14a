"""The process of the page, which gets the newest moment and returns settings."""

import os
import sys
from collections.abc import Callable
from queue import Empty, SimpleQueue

from airtact.errors import InvalidInput, extra
from airtact.hands.tracking.frame import HandFrame
from airtact.hands.tracking.stream import HandStream
from airtact.live.moment import Controls, Moment, silent_moment
from airtact.live.scene import Joints, LiveScene
from airtact.live.worker import Mailbox, Worker
from airtact.timing import give_way

# Default port of the page.
PORT = 8940

# Message of the page when its emergency stop is pressed.
EMERGENCY = "emergency"

# The page first sends its address or an error, then ``EMERGENCY``, settings and frames.
Message = str | InvalidInput | Controls | HandFrame


class PageProcess:
    """Process of lower priority that serves the page; the loop never waits for it.

    Use it in a ``with`` block. A separate thread sends only the newest moment to the page, so slow
    or many open pages do not delay the loop. If the process dies, the loop continues without a
    page.

    Parameters
    ----------
    scene : the fixed part of the scene.
    port : port to listen at; 0 takes a free one, which is part of ``address``.
    host : address to listen at; unless it is ``127.0.0.1``, ``address`` contains a token that every
        request must have.
    hand : (25, 3) initial joints of a hand to drag on the page [m]; none by default.
    stream : receives the frames of this hand, with times of ``time.monotonic``, while the page is
        open. Closing the page counts as losing the hand.
    controls : initial settings.
    on_emergency : called at once, in a thread of this class, when the emergency stop is pressed.

    Attributes
    ----------
    controls : newest settings of the page.
    address : URL of the page.

    Raises
    ------
    InvalidInput
        If the port is taken or viser is not installed.
    """

    def __init__(
        self,
        scene: LiveScene,
        port: int = PORT,
        host: str = "127.0.0.1",
        hand: Joints | None = None,
        stream: HandStream | None = None,
        controls: Controls | None = None,
        on_emergency: Callable[[], None] = lambda: None,
    ) -> None:
        self._stream = stream
        self._on_emergency = on_emergency
        self.controls: Controls = controls or Controls()
        self._drives = 0
        self._moment = silent_moment(scene, 0.0, 0.0)
        self._status = ""
        self._answers: SimpleQueue[Message | None] = SimpleQueue()
        # The page is painted 13 times a second.
        settings = (scene, port, host, hand, self.controls)
        self._worker = Worker(serve_page, settings, self._received, pause=1.0 / 20.0)
        patience = 30.0  # the process imports its server
        try:
            answer = self._answers.get(timeout=patience)
        except Empty:
            answer = None
        if not isinstance(answer, str):
            self._worker.close()
            raise (
                answer
                if isinstance(answer, InvalidInput)
                else InvalidInput(
                    f"the page did not start within {patience:g} s; run without it (--no-page).",
                    code="child_failed",
                )
            )
        self.address: str = answer

    def __enter__(self) -> "PageProcess":
        return self

    def __exit__(self, *fault: object) -> None:
        self.close()

    def show(self, moment: Moment) -> None:
        """Show a moment, unless a newer one comes first; call it in every pass of the loop."""
        self._drives += 1
        self._moment = moment
        self._put()

    def tell(self, status: object) -> None:
        """Show a status in words."""
        self._status = str(status)
        self._put()

    def _put(self) -> None:
        self._worker.put((self._moment, self._drives, self._status))

    @property
    def ended(self) -> bool:
        """Whether the process of the page has ended."""
        return self._worker.ended

    def close(self) -> None:
        """End the page."""
        self._worker.close()

    def _received(self, message: Message | None) -> None:
        if isinstance(message, Controls):
            self.controls = message
        elif isinstance(message, HandFrame):
            if self._stream is not None:
                self._stream.feed(message)
        elif message == EMERGENCY:
            self._on_emergency()
        else:
            self._answers.put(message)


def serve_page(
    mailbox: Mailbox,
    send: Callable[[Message], None],
    scene: LiveScene,
    port: int,
    host: str,
    hand: Joints | None,
    controls: Controls,
) -> None:
    """Serve the page until the loop ends.

    The mailbox has the newest moment, the number of moments so far, and the status in words.
    """
    try:
        with extra("live", "to go without a page give --no-page; the page needs viser"):
            from airtact.live.page.panel import paint
            from airtact.live.page.server import start_server
        server, address = start_server(port, host)
    except InvalidInput as fault:
        send(fault)
        return
    send(address)
    # viser prints tracebacks of messages that no browser sends.
    with open(os.devnull, "wb") as nothing:
        os.dup2(nothing.fileno(), sys.stderr.fileno())
    give_way(5)  # only after the start, because the user waits for the page
    paint(server, mailbox, send, scene, hand, controls)
