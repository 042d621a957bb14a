"""The pads of a hand over time."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Real
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from airtact.hand.joints import FINGERS
from airtact.tracking.pads import PadTrack

USUAL = 3.0
"""Frames farther apart than so many times the median are taken for a gap."""


def draw_tracks(tracks: Sequence[PadTrack], said: str = "") -> Figure:
    """Draw where the pads of hands were, coordinate by coordinate, and the gap between thumb and index finger.

    Times at which a hand was lost are grey.

    Parameters
    ----------
    tracks : one for each hand.
    said : a line over all, such as the counted faults.
    """
    figure = Figure(figsize=(5.0 + 3.5 * len(tracks), 7.0), layout="constrained")
    rows = figure.subplots(4, len(tracks), sharex="col", squeeze=False)
    start = min(float(track.times[0]) for track in tracks)
    for column, track in enumerate(tracks):
        times = track.times - start
        whole, lost = _with_breaks(times, track.pads)
        for row, axis in enumerate("xyz"):
            axes = rows[row, column]
            for finger, name in enumerate(FINGERS):
                colour = colormaps["viridis"](finger / 4.4)
                axes.plot(whole, 1e3 * lost[:, finger, row], color=colour, linewidth=1.2, label=name)
            axes.set_ylabel(f"{axis} [mm]")
        gap = 1e3 * np.linalg.norm(lost[:, 0] - lost[:, 1], axis=1)
        rows[3, column].plot(whole, gap, color="#444444", linewidth=1.2)
        rows[3, column].set_ylabel("thumb to index\npad [mm]")
        rows[3, column].set_ylim(bottom=0.0)
        rows[3, column].set_xlabel("time [s]")
        rows[0, column].set_title(f"{track.side} hand", fontsize=10)
        for axes in rows[:, column]:
            _shade(axes, times, np.isfinite(track.pads[:, 0, 0]))
    rows[0, 0].legend(frameon=False, fontsize=8, ncols=5, loc="lower left", bbox_to_anchor=(0.0, 1.12))
    figure.suptitle(said, fontsize=9)
    return figure


def _with_breaks(
    times: Real[np.ndarray, "frames"], pads: Real[np.ndarray, "frames 5 3"]
) -> tuple[Real[np.ndarray, "rows"], Real[np.ndarray, "rows 5 3"]]:
    """Put NaN where frames are missing, so that no line is drawn across."""
    steps = np.diff(times)
    after = 1 + np.flatnonzero(steps > USUAL * np.median(steps)) if len(steps) else np.empty(0, dtype=int)
    return np.insert(times, after, times[after]), np.insert(pads, after, np.nan, axis=0)


def _shade(axes: Axes, times: Real[np.ndarray, "frames"], seen: Bool[np.ndarray, "frames"]) -> None:
    """Make times grey at which the hand was lost, to the next frame that has it."""
    begun = None
    for index, there in enumerate([*seen, True]):
        if not there and begun is None:
            begun = times[index]
        if there and begun is not None:
            axes.axvspan(float(begun), float(times[min(index, len(times) - 1)]), color="#dddddd", linewidth=0)
            begun = None
