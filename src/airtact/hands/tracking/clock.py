"""The clock of a tracker, estimated from the times and arrivals of its frames."""

import time
from collections import deque

from airtact.errors import between

# Longest time between a tracker's camera image and the arrival of its frame [s].
MAX_LATENCY = 0.5


def checked_latency(latency: float) -> float:
    """Check that the latency of a tracker is from 0 to 0.5 s, and return it [s]."""
    return between(
        latency, 0.0, MAX_LATENCY, "the latency of the tracker", "s", "is it in milliseconds?"
    )


class FrameClock:
    """Estimate of the tracker's clock from the times and arrivals of its frames.

    A tracker that uses a clock of this computer is recognised from its first frame. For any other
    clock, the offset is the smallest difference so far between the arrival and the time of a frame,
    minus ``latency``. The tracker's clock may drift by 0.1 %.

    Attributes
    ----------
    latency : shortest time from the camera image to the frame's arrival [s], for trackers that use
        their own clock.
    """

    def __init__(self, latency: float = 0.0) -> None:
        self.latency = latency
        # Smallest difference between arrival and time of a frame, and when it was found.
        self._offset: tuple[float, float] | None = None
        # Offset to ``time.monotonic`` of the clock of this computer that the tracker uses.
        self._shared: float | None = None
        # Times and arrivals of the frames of the last second, from which the pace follows.
        self._recent: deque[tuple[float, float]] = deque()

    def saw(self, taken: float, arrived: float) -> None:
        """Update the estimate with a frame's time and its arrival on ``time.monotonic`` [s]."""
        offset = arrived - taken
        self._recent.append((taken, arrived))
        while arrived - self._recent[0][1] > 1.0:
            self._recent.popleft()
        if self._offset is None:
            for ahead in (0.0, time.time() - time.monotonic()):
                if self._shared is None and 0.0 <= offset + ahead <= MAX_LATENCY:
                    self._shared = ahead
        else:
            smallest, then = self._offset
            offset = min(offset, smallest + 1e-3 * (arrived - then))
        # A frame that arrives before its own time shows that the match was a coincidence.
        if self._shared is not None and arrived + self._shared < taken - 1e-3:
            self._shared = None
        self._offset = (offset, arrived)

    @property
    def fault(self) -> str | None:
        """Reason why the times of frames cannot be used yet, or None.

        If the tracker's clock ran at half the pace, a hand would seem to move twice as fast, and
        its prediction would be wrong.
        """
        if self._shared is not None or not self._recent:
            return None
        (taken, arrived), (last_taken, last_arrived) = self._recent[0], self._recent[-1]
        if last_arrived - arrived < 0.2:
            return "measuring the rate of the tracker's clock"
        pace = (last_taken - taken) / (last_arrived - arrived)
        # A pause of 0.2 s in the network changes the pace of a second by 0.2.
        if 0.75 < pace < 1.33:
            return None
        return f"the tracker's clock runs {pace:.2g} times as fast as the computer's"

    def time(self, now: float) -> float:
        """Convert a time of ``time.monotonic`` to a time on the clock of the frames [s]."""
        if self._shared is not None:
            return now + self._shared
        return 0.0 if self._offset is None else now - self._offset[0] + self.latency

    def restart(self, now: float) -> float:
        """Return the time for the first frame of a restarted tracker [s].

        Its clock is unknown, so the delay between image and arrival is assumed to be the shortest
        one so far.
        """
        self._shared = None
        self._recent.clear()
        return self.time(now) - self.latency
