"""The pads of a hand's fingers over the frames of a recording."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from airtact.conventions import InvalidInput
from airtact.hand.hand import Side
from airtact.printing import in_short
from airtact.tracking.frame import HandFrame
from airtact.validation import fixed


@dataclass(frozen=True, eq=False)
class PadTrack:
    """Where the pads of one hand were.

    Attributes
    ----------
    side : ``"left"`` or ``"right"``.
    times : (N,) of the frames [s].
    sequences : (N,) their numbers.
    pads : (N, 5, 3) the pads, thumb to little finger [m]; NaN where the hand was lost or had no landmarks.
    """

    side: Side
    times: Float64[np.ndarray, "frames"]
    sequences: Float64[np.ndarray, "frames"]
    pads: Float64[np.ndarray, "frames 5 3"]

    __repr__ = in_short

    @property
    def fastest(self) -> float:
        """Largest speed of a pad from one frame to the next [m/s]; 0 where there are no two with landmarks."""
        ways = np.linalg.norm(np.diff(self.pads, axis=0), axis=2)
        speeds = ways / np.diff(self.times)[:, None]
        return float(np.nanmax(speeds)) if np.isfinite(speeds).any() else 0.0

    @property
    def longest_gap(self) -> float:
        """Longest time between two frames that follow each other with landmarks [s]; 0 where there are no two."""
        seen = self.times[np.isfinite(self.pads[:, 0, 0])]
        return float(np.diff(seen).max()) if len(seen) > 1 else 0.0


def pads_over_time(frames: Iterable[HandFrame], side: Side) -> PadTrack:
    """Find the pads of a hand in every frame; the radii of the skin are those of the first frame's hand.

    Raises
    ------
    InvalidInput
        When no frame is of that hand.
    """
    own = [frame for frame in frames if frame.side == side]
    if not own:
        raise InvalidInput(f"0 frames are of a {side} hand; take the other one.", code="no_frames")
    radii, pads = None, np.full((len(own), 5, 3), np.nan)
    for index, frame in enumerate(own):
        if frame.landmarks is not None:
            hand = frame.hand(radii)
            radii, pads[index] = hand.radii, hand.pads
    times, sequences = [frame.time for frame in own], [float(frame.sequence) for frame in own]
    return PadTrack(side, fixed(np.array(times)), fixed(np.array(sequences)), fixed(pads))
