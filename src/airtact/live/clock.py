"""What time it is by the tracker's clock, from the frames that came."""

import time
from collections.abc import Callable

from airtact.checks import between
from airtact.hands.tracking.stream import DRIFT

OWN_CLOCKS = (time.monotonic, time.time)
"""Clocks of this computer that trackers on it use."""

LATEST = 0.5
"""A frame whose time is at most so long before now, by a clock of this computer, was taken by that clock [s]."""


def checked_latency(latency: float) -> float:
    """Return the latency of a tracker [s]; raise "out_of_range" unless it is from 0 to 0.5 s."""
    return between(
        latency, 0.0, LATEST, "the latency of the tracker", "s", "is it in milliseconds?"
    )


class FrameClock:
    """Maps the computer's monotonic clock to that of the frames.

    A tracker that uses a clock of this computer is recognised by the first frame. Any other clock
    is taken to be off by the least that any frame was late, as if that frame had come ``latency``
    after its time; the tracker's clock may drift by 0.1 %.

    Parameters
    ----------
    latency : least time from the picture to the frame's arrival, of trackers with a clock of their
        own [s].
    now : the computer's clock [s].

    Raises
    ------
    InvalidInput
        When the latency is not from 0 to 0.5 s.
    """

    def __init__(self, latency: float = 0.0, now: Callable[[], float] = time.monotonic) -> None:
        self._latency = checked_latency(latency)
        self._now = now
        self._least: tuple[float, float] | None = None
        self._shared: Callable[[], float] | None = None
        self.known: bool = False

    def saw(self, taken: float, arrived: float) -> None:
        """Take the time of a frame by its own clock and that of its arrival by the computer's [s]."""
        if not self.known:
            self._shared = next((one for one in OWN_CLOCKS if 0.0 <= one() - taken <= LATEST), None)
            self.known = True
        if self._shared is not None and not -LATEST <= self._shared() - taken <= 4.0 * LATEST:
            self._shared = None  # it was a chance, or the clock was set anew
        offset = arrived - taken
        if self._least is not None:
            least, then = self._least
            drifted = least + DRIFT * (arrived - then)
            offset = (
                offset if offset > drifted + LATEST else min(offset, drifted)
            )  # a clock that began anew
        self._least = offset, arrived

    def time(self, now: float | None = None) -> float:
        """Return the time by the frames' clock, now or at a time of the computer's [s]; 0 before the first frame."""
        now = self._now() if now is None else now
        if self._shared is not None:
            return self._shared() + (now - self._now())
        return 0.0 if self._least is None else now - self._least[0] + self._latency
