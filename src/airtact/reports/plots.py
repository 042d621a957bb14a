"""Plots of numbers: methods against a bound, pads over time, a measured scan beside its prediction."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float64, Real
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.ticker import MaxNLocator

from airtact.evaluation.held_out import ShiftMap
from airtact.evaluation.scan import Overlay
from airtact.hands.joints import FINGERS
from airtact.hands.tracking.recordings import PadTrack
from airtact.reports.field_figure import COLOURS, draw_values

BAR, BOUND = "#5a2a83", "#c2410c"

APART = BAR, "#e69f00", "#56b4e9", "#009e73", "#cc79a7", "#0072b2", "#f0e442"
"""Colours that colour-blind readers tell apart (Okabe and Ito, 2008), after that of a bar alone."""


FLAT = 0.02
"""Positions spread less than this part of their widest spread lie on a line."""


def draw_bars(
    names: Sequence[str], heights: Float64[np.ndarray, "names"], bound: float, label: str
) -> Figure:
    """Draw one bar for each name, the longest on top, and a line at the bound, which none can pass.

    The label says what is shown, with its unit.
    """
    order = np.argsort(heights)
    figure = Figure(figsize=(8.0, 0.34 * len(names) + 1.2), layout="constrained")
    axes = figure.subplots()
    bars = axes.barh([names[index] for index in order], heights[order], color=BAR, height=0.62)
    axes.bar_label(
        bars, [f"{heights[index] / bound:.0%}" for index in order], padding=4, fontsize=9
    )
    axes.axvline(bound, color=BOUND, linewidth=2, label="bound")
    axes.set(xlabel=label, xlim=(0.0, 1.12 * max(bound, float(heights.max()))))
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(loc="lower right", frameon=False)
    return figure


def draw_shares(
    pressures: Mapping[str, Float64[np.ndarray, "samples"]], expected: Mapping[str, float]
) -> Figure:
    """Draw for several drives the share of samples in which a pressure [Pa] is not reached, and what is expected."""
    figure = Figure(figsize=(8.0, 4.0), layout="constrained")
    axes = figure.subplots()
    for colour, (name, given) in zip(APART, pressures.items(), strict=False):
        ordered = np.sort(given)
        axes.step(
            ordered,
            (np.arange(len(ordered)) + 1.0) / len(ordered),
            where="post",
            color=colour,
            label=name,
        )
        axes.plot(expected[name], 1.0, "o", color=colour, clip_on=False)
    axes.axhline(0.1, color=BOUND, linewidth=1, linestyle="--", label="one of ten")
    axes.set(
        xlabel="peak pressure of the weakest focus [Pa]",
        ylabel="share of the samples",
        xlim=(0.0, None),
        ylim=(0.0, 1.0),
    )
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(loc="lower right", frameon=False)
    return figure


def draw_shifts(maps: Sequence[ShiftMap], names: Sequence[str], deviation: float) -> Figure:
    """Draw the pressure of the weakest focus by the shift of the hand: a column for each drive, a row for each plane.

    All have one scale. A ring shows a standard deviation [m] of the shift, where it is above zero.
    """
    figure = Figure(figsize=(2.6 * len(names) + 1.4, 2.5 * len(maps) + 0.5), layout="constrained")
    axes = figure.subplots(len(maps), len(names), squeeze=False)
    scale = ScalarMappable(
        Normalize(0.0, max(float(np.nanmax(one.pressures)) for one in maps)), COLOURS
    )
    for row, one in zip(axes, maps, strict=True):
        for panel, values in zip(row, one.pressures, strict=True):
            draw_values(panel, one.shifts, values, scale, (), "bilinear")
            panel.set_xlabel(f"shift: {one.shifts.labels[0]}")
            if deviation > 0.0:
                panel.add_patch(
                    Circle(
                        (0.0, 0.0), 1e3 * deviation, fill=False, edgecolor="white", linewidth=1.2
                    )
                )
        row[0].set_ylabel(f"shift: {one.shifts.labels[1]}")
    for panel, name in zip(axes[0], names, strict=True):
        panel.set_title(name, fontsize=11)
    figure.colorbar(scale, ax=axes, label="peak pressure of the weakest focus [Pa]", aspect=30)
    return figure


def draw_foci(
    axes: Axes,
    pressures: Mapping[str, Float64[np.ndarray, "foci"]],
    asked: Float64[np.ndarray, "foci"] | None,
) -> None:
    """Draw bars of the pressure at each focus [Pa] into axes, a group for several drives, and a line at each asked."""
    count = len(next(iter(pressures.values())))
    foci = np.arange(count)
    width = 0.8 / len(pressures)
    for index, (name, got) in enumerate(pressures.items()):
        shift = (index - (len(pressures) - 1) / 2.0) * width
        axes.bar(
            foci + shift, got, 0.94 * width, color=APART[index % len(APART)], label=name or None
        )
    if asked is not None:
        axes.hlines(asked, foci - 0.45, foci + 0.45, colors=BOUND, linewidth=2, label="asked")
    axes.set(xlabel="focus", ylabel="peak pressure [Pa]", ylim=(0.0, None))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.spines[["top", "right"]].set_visible(False)
    if asked is not None or len(pressures) > 1:
        axes.legend(frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))


def draw_tracks(tracks: Sequence[PadTrack], title: str = "") -> Figure:
    """Draw where the pads of hands were, and the gap between thumb and index finger; grey where a hand was lost."""
    figure = Figure(figsize=(5.0 + 3.5 * len(tracks), 7.0), layout="constrained")
    rows = figure.subplots(4, len(tracks), sharex="col", squeeze=False)
    start = min(float(track.times[0]) for track in tracks)
    for column, track in enumerate(tracks):
        times = track.times - start
        broken_times, broken_pads = _with_breaks(times, track.pads)
        for row, axis in enumerate("xyz"):
            axes = rows[row, column]
            for finger, name in enumerate(FINGERS):
                colour = colormaps["viridis"](finger / 4.4)
                axes.plot(
                    broken_times,
                    1e3 * broken_pads[:, finger, row],
                    color=colour,
                    linewidth=1.2,
                    label=name,
                )
            axes.set_ylabel(f"{axis} [mm]")
        gap = 1e3 * np.linalg.norm(broken_pads[:, 0] - broken_pads[:, 1], axis=1)
        rows[3, column].plot(broken_times, gap, color="#444444", linewidth=1.2)
        rows[3, column].set(xlabel="time [s]", ylabel="thumb to index\npad [mm]", ylim=(0.0, None))
        rows[0, column].set_title(f"{track.side} hand", fontsize=10)
        for axes in rows[:, column]:
            _shade(axes, times, np.isfinite(track.pads[:, 0, 0]))
    rows[0, 0].legend(
        frameon=False, fontsize=8, ncols=5, loc="lower left", bbox_to_anchor=(0.0, 1.12)
    )
    figure.suptitle(title, fontsize=9)
    return figure


def _with_breaks(
    times: Real[np.ndarray, "frames"], pads: Real[np.ndarray, "frames 5 3"]
) -> tuple[Real[np.ndarray, "rows"], Real[np.ndarray, "rows 5 3"]]:
    """Put NaN where frames are missing, so that no line is drawn across."""
    steps = np.diff(times)
    # 3.0: frames farther apart than this times the median count as a gap.
    after = (
        1 + np.flatnonzero(steps > 3.0 * np.median(steps)) if len(steps) else np.empty(0, dtype=int)
    )
    return np.insert(times, after, times[after]), np.insert(pads, after, np.nan, axis=0)


def _shade(axes: Axes, times: Real[np.ndarray, "frames"], seen: Bool[np.ndarray, "frames"]) -> None:
    """Make times grey at which the hand was lost, to the next frame that has it."""
    begun = None
    for index, there in enumerate([*seen, True]):
        if not there and begun is None:
            begun = times[index]
        if there and begun is not None:
            axes.axvspan(
                float(begun), float(times[min(index, len(times) - 1)]), color="#dddddd", linewidth=0
            )
            begun = None


def draw_overlay(overlay: Overlay) -> Figure:
    """Draw what was measured, what was predicted and how they differ, in the plane or line of the positions."""
    used = overlay.used
    measured = overlay.scan.pressures[used]
    model = overlay.scale * overlay.predicted[used]
    if not overlay.scan.phased:
        measured = np.abs(measured)
        model = np.abs(model)
    projected, axes = _seen(overlay.scan.points[used])
    peak = float(np.abs(measured).max())
    shown = {
        "measured": np.abs(measured) / peak,
        "predicted": np.abs(model) / peak,
        f"difference, {overlay.error:.1%} rms": np.abs(measured - model) / peak,
    }
    return (
        _curves(projected[:, 0], axes[0], shown)
        if len(axes) == 1
        else _maps(projected, axes, shown)
    )


def _seen(
    points: Float64[np.ndarray, "points 3"],
) -> tuple[Float64[np.ndarray, "points axes"], tuple[str, ...]]:
    """Project points into their own line or plane [mm]; along the frame's axes where these lie in it."""
    centred = points - points.mean(axis=0)
    spans = np.ptp(points, axis=0)
    wide = np.flatnonzero(spans > FLAT * spans.max())
    if len(wide) <= 2:
        return 1e3 * points[:, wide], tuple(f"{'xyz'[axis]} [mm]" for axis in wide)
    _, spreads, ways = np.linalg.svd(centred, full_matrices=False)
    axes = ways[: 1 if spreads[1] < FLAT * spreads[0] else 2]
    return 1e3 * centred @ axes.T, ("along the scan [mm]", "across the scan [mm]")[: len(axes)]


def _curves(
    along: Float64[np.ndarray, "points"],
    label: str,
    shown: dict[str, Float64[np.ndarray, "points"]],
) -> Figure:
    figure = Figure(figsize=(8.0, 4.0), layout="constrained")
    axes = figure.subplots()
    order = np.argsort(along)
    for (name, values), style in zip(shown.items(), ("o", "-", ":"), strict=True):
        axes.plot(along[order], values[order], style, label=name, markersize=4)
    axes.set(xlabel=label, ylabel="pressure over the largest measured", ylim=(0.0, None))
    axes.legend(frameon=False)
    return figure


def _maps(
    projected: Float64[np.ndarray, "points 2"],
    labels: tuple[str, ...],
    shown: dict[str, Float64[np.ndarray, "points"]],
) -> Figure:
    wide, tall = np.ptp(projected, axis=0)
    size = 3.6 / max(wide, tall)
    figure = Figure(
        figsize=(3 * max(wide * size, 1.6) + 2.4, max(tall * size, 1.6) + 1.0), layout="constrained"
    )
    axes = figure.subplots(1, 3, sharex=True, sharey=True)
    *both, difference = (float(values.max()) for values in shown.values())
    pressure = ScalarMappable(Normalize(0.0, max(both)), COLOURS)
    scales = (pressure, pressure, ScalarMappable(Normalize(0.0, max(difference, 1e-9)), "viridis"))
    cells = _cells(projected)
    for panel, (name, values), scale in zip(axes, shown.items(), scales, strict=True):
        panel.add_collection(
            PolyCollection(
                list(cells), facecolors=scale.to_rgba(values), edgecolors="face", linewidths=0.4
            )
        )
        panel.set_title(name, fontsize=11)
        panel.set(xlabel=labels[0], aspect="equal", facecolor="0.85")
        panel.autoscale_view()
    axes[0].set_ylabel(labels[1])
    figure.colorbar(
        pressure, ax=list(axes[:2]), label="pressure over the largest measured", aspect=28
    )
    figure.colorbar(scales[2], ax=axes[2], label="difference, on a scale of its own", aspect=28)
    return figure


def _cells(projected: Float64[np.ndarray, "points 2"]) -> Float64[np.ndarray, "points 4 2"]:
    """Draw a rectangle round each position, as large as the step between positions along each axis."""
    steps = [_step(along) for along in projected.T]
    corners = 0.5 * np.array(steps) * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return projected[:, None] + corners


def _step(along: Float64[np.ndarray, "points"]) -> float:
    """Find the usual distance of neighbouring coordinates, or what fills their span where they lie on no grid."""
    span = float(np.ptp(along))
    gaps = np.diff(np.sort(along))
    gaps = gaps[gaps > 1e-3 * span]
    return float(max(np.median(gaps), span / np.sqrt(len(along)) / 2.0)) if len(gaps) else span


def draw_varied(
    axes: Mapping[str, Float64[np.ndarray, "points"]],
    values: Float64[np.ndarray, "points"],
    label: str,
) -> Figure:
    """Draw values against each of the columns that were varied, with the median of points that share a value there."""
    figure = Figure(figsize=(min(4.6 * len(axes), 16.0), 3.6), layout="constrained")
    panels = np.atleast_1d(figure.subplots(1, len(axes), sharey=True))
    for panel, (name, varied) in zip(panels, axes.items(), strict=True):
        known = np.isfinite(varied) & np.isfinite(values)
        different = np.unique(varied[known])
        panel.plot(varied[known], values[known], ".", color=BAR, alpha=0.35, markersize=5)
        if len(different) < len(varied[known]) or len(axes) == 1:
            panel.plot(
                different,
                [np.median(values[known & (varied == one)]) for one in different],
                color=BOUND,
            )
        panel.set_xlabel(name)
        panel.xaxis.set_major_locator(MaxNLocator(4))
        panel.spines[["top", "right"]].set_visible(False)
    panels[0].set_ylabel(label, wrap=True)
    return figure
