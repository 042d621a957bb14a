"""The page as the loop sees it: another process, which gets the newest moment and returns what was set on the page."""

import os
import pickle
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from threading import Condition, Thread, Timer
from types import TracebackType
from typing import IO

import numpy as np
from jaxtyping import Float64

from airtact.errors import InvalidInput
from airtact.hands.tracking.frame import HandFrame
from airtact.hands.tracking.stream import HandStream
from airtact.live.drives.solver_process import ONE_THREAD
from airtact.live.parts import Controls, LiveScene, Moment

PORT = 8940
"""Port of the page unless another one is given."""

LONGEST_INTERVAL = 1.0 / 20.0
"""Moments go to the page no faster than one in this time [s]; it shows 13 a second."""

PATIENCE = 30.0
"""How long the page may take to start [s]; it imports its server."""

FAREWELL = 2.0
"""How long the page may take to end before it is killed [s]."""


@dataclass(frozen=True, eq=False)
class PageSettings:
    """What the page needs to start.

    Attributes
    ----------
    scene : what stays the same while the hand moves.
    port : to listen at; 0 takes a free one.
    host : the address to listen at; another than ``127.0.0.1`` needs a token in the page's address.
    hand : (25, 3) joints of the hand that is dragged on the page, where it starts [m]; or None.
    controls : how the page is set from the start.
    """

    scene: LiveScene
    port: int = PORT
    host: str = "127.0.0.1"
    hand: Float64[np.ndarray, "25 3"] | None = None
    controls: Controls = field(default_factory=Controls)


EMERGENCY = "emergency"
"""What comes back when the emergency stop of the page is pressed."""


@dataclass(frozen=True)
class Fault:
    """Why the page cannot start: the sentence of an ``InvalidInput`` and its code."""

    sentence: str
    code: str


@dataclass(frozen=True)
class Shown:
    """What goes to the page at a time.

    Attributes
    ----------
    moment : the newest one.
    drives : number of moments so far, those that the page never saw included.
    """

    moment: Moment
    drives: int


class PageProcess:
    """Serves the page from another process of lower priority; the loop never waits for it.

    Use it in a ``with`` block. Only the newest moment goes to the page, from a thread of its own,
    so that a page that stalls, or ten that are open, cost the loop nothing. Where the process dies
    the loop goes on without a page.

    Parameters
    ----------
    scene : what stays the same while the hand moves.
    port : to listen at; 0 takes a free one, which is in ``address``.
    host : the address to listen at; where it is not ``127.0.0.1``, ``address`` has a token, without
        which nothing is served.
    hand : (25, 3) joints of a hand that is dragged on the page, where it starts [m]; none is unless
        given.
    stream : that the frames of this hand are fed to. They come only while the page is open, so that
        a closed page is a hand that is lost; their clock is ``time.monotonic``.
    controls : how the page is set from the start.
    on_emergency : called at once, by a thread of this class, when the emergency stop is pressed.

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
        hand: Float64[np.ndarray, "25 3"] | None = None,
        stream: HandStream | None = None,
        controls: Controls | None = None,
        on_emergency: Callable[[], None] = lambda: None,
    ) -> None:
        self._stream, self._on_emergency = stream, on_emergency
        self._controls, self._stopped, self._closed = controls or Controls(), False, False
        self._drives, self._newest, self._changed = 0, None, Condition()
        command = [sys.executable, "-m", "airtact.live.page"]
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, **ONE_THREAD},
            start_new_session=True,
        )  # in a session of its own, Ctrl-C is not for the page
        self._threads = [Thread(target=work, daemon=True) for work in (self._send, self._receive)]
        try:
            self.address: str = self._started(PageSettings(scene, port, host, hand, self._controls))
        except BaseException:
            self._end()
            raise
        for thread in self._threads:
            thread.start()

    def __enter__(self) -> "PageProcess":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self.close()

    @property
    def controls(self) -> Controls:
        """The newest setting of the page."""
        return self._controls

    @property
    def stopped(self) -> bool:
        """Whether the emergency stop was pressed."""
        return self._stopped

    @property
    def alive(self) -> bool:
        """Whether the page is being served."""
        return self._process.poll() is None

    def show(self, moment: Moment) -> None:
        """Show a moment unless a newer one comes before the page is ready for it; call it at every pass of the loop."""
        with self._changed:
            self._drives += 1
            self._newest = Shown(moment, self._drives)
            self._changed.notify_all()

    def close(self) -> None:
        """End the page."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        with suppress(
            subprocess.TimeoutExpired
        ):  # the thread that sends ends, and with it what the page reads
            self._process.wait(FAREWELL)
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

    @property
    def _out(self) -> IO[bytes]:
        assert self._process.stdin is not None
        return self._process.stdin

    @property
    def _back(self) -> IO[bytes]:
        assert self._process.stdout is not None
        return self._process.stdout

    def _started(self, settings: PageSettings) -> str:
        """Hand over the settings, and return the address of the page, or raise what is wrong."""
        too_late = Timer(PATIENCE, self._process.kill)
        too_late.start()
        try:
            pickle.dump(settings, self._out)
            self._out.flush()
            answer = pickle.load(self._back)
        except (OSError, EOFError):
            sentence = f"the page did not start within {PATIENCE:g} s; run without it (--no-page)."
            raise InvalidInput(sentence, code="child_failed") from None
        finally:
            too_late.cancel()
        if isinstance(answer, Fault):
            raise InvalidInput(answer.sentence, code=answer.code)
        return answer

    def _send(self) -> None:
        """Send the newest moment whenever the pipe has taken the one before."""
        with suppress(OSError):
            while True:
                with self._changed:
                    self._changed.wait_for(lambda: self._closed or self._newest is not None)
                    shown, self._newest = self._newest, None
                if self._closed:
                    break
                pickle.dump(shown, self._out)
                self._out.flush()
                time.sleep(LONGEST_INTERVAL)
        with suppress(OSError):
            self._out.close()

    def _receive(self) -> None:
        """Take what comes back: settings, frames of the hand on the page, and the emergency stop."""
        with suppress(OSError, EOFError, pickle.UnpicklingError):
            while True:
                got = pickle.load(self._back)
                if isinstance(got, Controls):
                    self._controls = got
                elif isinstance(got, HandFrame) and self._stream is not None:
                    self._stream.feed(got)
                elif got == EMERGENCY:
                    self._stopped = True
                    self._on_emergency()
