"""The page as the loop sees it: a process that gets the newest moment and returns settings."""

import os
import pickle
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from threading import Condition, Thread, Timer
from typing import IO, cast

from airtact.errors import InvalidInput
from airtact.hands.tracking.frame import HandFrame
from airtact.hands.tracking.stream import HandStream
from airtact.live.drives.solver_process import ONE_THREAD
from airtact.live.moment import Controls, Moment
from airtact.live.scene import Joints, LiveScene

PORT = 8940
"""Default port of the page."""

EMERGENCY = "emergency"
"""Message of the page when its emergency stop is pressed."""


@dataclass(frozen=True, eq=False)
class PageSettings:
    """Settings that the page starts with; see ``PageProcess``."""

    scene: LiveScene
    port: int
    host: str
    hand: Joints | None
    controls: Controls


Shown = tuple[Moment, int]
"""Message to the page: the newest moment, and the number of moments so far."""


class PageProcess:
    """Serves the page from another process of lower priority; the loop never waits for it.

    Use it in a ``with`` block. Only the newest moment goes to the page, from a thread of its own,
    so that a page that stalls, or ten that are open, cost the loop nothing. If the process dies,
    the loop goes on without a page.

    Parameters
    ----------
    scene : the fixed part of the scene.
    port : port to listen at; 0 takes a free one, which is in ``address``.
    host : address to listen at; for any but ``127.0.0.1``, ``address`` has a token, without which
        nothing is served.
    hand : (25, 3) initial joints of a hand to drag on the page [m]; none by default.
    stream : fed with the frames of this hand, by the clock ``time.monotonic``. They come only while
        the page is open: closing the page counts as losing the hand.
    controls : initial settings.
    on_emergency : called at once, by a thread of this class, when the emergency stop is pressed.

    Attributes
    ----------
    controls : newest settings of the page.
    stopped : whether the emergency stop was pressed.
    address : URL of the page.

    Raises
    ------
    InvalidInput
        When the port is taken, or viser is not installed.
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
        self.stopped: bool = False
        self._closed = False
        self._drives = 0
        self._newest: Shown | None = None
        self._changed = Condition()
        self._process = subprocess.Popen(
            [sys.executable, "-m", "airtact.live.page"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, **ONE_THREAD},
            start_new_session=True,  # Ctrl-C is not for the page
        )
        self._out = cast(IO[bytes], self._process.stdin)
        self._back = cast(IO[bytes], self._process.stdout)
        self._threads = [Thread(target=work, daemon=True) for work in (self._send, self._receive)]
        # The threads start only once the page has answered: before, ``_started`` uses the pipes.
        try:
            self.address: str = self._started(PageSettings(scene, port, host, hand, self.controls))
        except BaseException:
            self._end()
            raise
        for thread in self._threads:
            thread.start()

    def __enter__(self) -> "PageProcess":
        return self

    def __exit__(self, *fault: object) -> None:
        self.close()

    @property
    def alive(self) -> bool:
        """Whether the page is being served."""
        return self._process.poll() is None

    def show(self, moment: Moment) -> None:
        """Show a moment, unless a newer one comes first; call it at every pass of the loop."""
        with self._changed:
            self._drives += 1
            self._newest = (moment, self._drives)
            self._changed.notify_all()

    def close(self) -> None:
        """End the page."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        # The thread that sends ends, and with it the input of the page, which then ends by itself.
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(2.0)
        self._end()

    def _end(self) -> None:
        self._process.kill()
        self._process.wait()
        for thread in self._threads:
            if thread.ident is not None:
                thread.join()
        for pipe in (self._out, self._back):
            with suppress(OSError):
                pipe.close()

    def _started(self, settings: PageSettings) -> str:
        """Hand over the settings and return the address of the page, or raise what is wrong."""
        patience = 30.0  # the process imports its server
        too_late = Timer(patience, self._process.kill)
        too_late.start()
        try:
            pickle.dump(settings, self._out)
            self._out.flush()
            answer = pickle.load(self._back)
        except (OSError, EOFError):
            raise InvalidInput(
                f"the page did not start within {patience:g} s; run without it (--no-page).",
                code="child_failed",
            ) from None
        finally:
            too_late.cancel()
        if isinstance(answer, InvalidInput):
            raise answer
        return answer

    def _send(self) -> None:
        """Send the newest moment whenever the pipe has taken the previous one."""
        with suppress(OSError):
            while True:
                with self._changed:
                    self._changed.wait_for(lambda: self._closed or self._newest is not None)
                    shown = self._newest
                    self._newest = None
                if self._closed:
                    break
                pickle.dump(shown, self._out)
                self._out.flush()
                time.sleep(1.0 / 20.0)  # the page is painted 13 times a second
        with suppress(OSError):
            self._out.close()

    def _receive(self) -> None:
        """Take what comes back: settings, frames of the dragged hand, and the emergency stop."""
        with suppress(OSError, EOFError, pickle.UnpicklingError):
            while True:
                message = pickle.load(self._back)
                if isinstance(message, Controls):
                    self.controls = message
                elif isinstance(message, HandFrame) and self._stream is not None:
                    self._stream.feed(message)
                elif message == EMERGENCY:
                    self.stopped = True
                    self._on_emergency()
