"""The clock of a tracker, estimated from the times and arrivals of its frames."""

import time
from collections import deque

from airtact.errors import between

# Longest time between a tracker's camera image and the arrival of its frame [s].
MAX_LATENCY = 0.5


def checked_latency(latency: float) -> float:
    """Return the latency of a tracker [s], after checking that it is between 0 and 0.5 s."""
    return between(
        latency, 0.0, MAX_LATENCY, "the latency of the tracker", "s", "is it in milliseconds?"
    )


class FrameClock:
    """Estimate of a tracker's clock from its frames.

    Call ``saw`` with the time of each frame on the tracker's clock and the time of its arrival on
    ``time.monotonic``. The method ``time`` then converts times to the tracker's clock.

    A tracker that uses a clock of this computer is recognised from its first frame. The offset of
    any other clock is estimated as the smallest difference so far between the arrival and the time
    of a frame, minus ``latency``. The tracker's clock may drift by 0.1 %.

    Attributes
    ----------
    latency : shortest time from the camera image to the frame's arrival [s]; only used for trackers
        with their own clock.
    """

    def __init__(self, latency: float = 0.0) -> None:
        self.latency = latency
        # Smallest difference between arrival and time of a frame, and when it was found.
        self._offset: tuple[float, float] | None = None
        # Whether enough frames arrived to trust the offset.
        self._settled = False
        # Offset to ``time.monotonic`` of the clock of this computer that the tracker uses.
        self._shared: float | None = None
        # The last 2 s in parts of 0.1 s: beginning, smallest offset, and arrival of its frame.
        self._recent: deque[tuple[float, float, float]] = deque()

    def saw(self, taken: float, arrived: float) -> None:
        """Update the estimate with a frame's time and its arrival time (``time.monotonic``) [s]."""
        offset = arrived - taken
        if self._offset is None:
            for ahead in (0.0, time.time() - time.monotonic()):
                if self._shared is None and 0.0 <= offset + ahead <= MAX_LATENCY:
                    self._shared = ahead
        # A frame that arrives before its own time shows that the match was a coincidence.
        if self._shared is not None and arrived + self._shared < taken - 1e-3:
            self._shared = None
        if not self._recent or arrived - self._recent[-1][0] >= 0.1:
            self._recent.append((arrived, offset, arrived))
        elif offset < self._recent[-1][1]:
            self._recent[-1] = (self._recent[-1][0], offset, arrived)
        while arrived - self._recent[0][0] > 2.0:
            self._recent.popleft()
        # The third smallest, so that a single frame whose time is ahead does not count.
        smallest = sorted(offset for _, offset, _ in self._recent)[:3][-1]
        if self._settled and self._offset is not None:
            before, then = self._offset
            smallest = min(smallest, before + 1e-3 * (arrived - then))
        self._settled = self._settled or len(self._recent) >= 3
        self._offset = (smallest, arrived)

    @property
    def fault(self) -> str | None:
        """Reason why the frame times cannot be used yet; None if they can.

        For example, the clock may be too slow: the delay of its frames would seem to grow, so that
        the hand would be predicted too far ahead.
        """
        if not self._recent:
            return None
        if self._shared is None and self._recent[-1][0] - self._recent[0][0] < 0.2:
            return "measuring the rate of the tracker's clock"
        # The earliest frames in both thirds are unaffected by a pause of the network.
        third = max(len(self._recent) // 3, 1)
        parts = list(self._recent)
        _, first, begun = min(parts[:third], key=lambda part: part[1])
        _, last, ended = min(parts[-third:], key=lambda part: part[1])
        # At 0.5 m/s, a hand moves by 25 mm in this time.
        if ended == begun or abs(last - first) < 0.05:
            return None
        pace = 1.0 - (last - first) / (ended - begun)
        cause = f"the tracker's clock runs {pace:.2g} times as fast as the computer's"
        return cause if pace > 1.0 else f"{cause}, or its frames arrive later and later"

    @property
    def margin(self) -> float:
        """Largest time [s] by which a frame may be ahead of ``time(now)``."""
        if self._shared is not None:
            return 0.01  # this computer may adjust its clocks
        return 0.08 if self._settled else MAX_LATENCY

    def time(self, now: float) -> float:
        """Convert a time of ``time.monotonic`` to a time on the clock of the frames [s]."""
        if self._shared is not None:
            return now + self._shared
        return 0.0 if self._offset is None else now - self._offset[0] + self.latency

    def restart(self, now: float) -> float:
        """Return the estimated time [s] of the first frame of a restarted tracker.

        The clock of the restarted tracker is unknown, so the delay between image and arrival is
        assumed to be the shortest one so far.
        """
        self._shared = None
        self._recent.clear()
        return self.time(now) - self.latency
