"""Plots of numbers: methods with their upper bound, a scan with its prediction, and sweeps."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float64
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from airtact.evaluation.scan import Overlay
from airtact.reports.field_figure import COLOURS

BAR = "#5a2a83"
BOUND = "#c2410c"

# Colour of a single bar, followed by colours for colour-blind readers (Okabe and Ito, 2008)
COLOURS_OF_DRIVES = (BAR, "#e69f00", "#56b4e9", "#009e73", "#cc79a7", "#0072b2", "#f0e442")


def draw_bars(
    names: Sequence[str], heights: Float64[np.ndarray, "names"], bound: float, label: str
) -> Figure:
    """Draw one bar per name, from top to bottom, and a line at ``bound``, their upper bound.

    ``label`` states the quantity and its unit.
    """
    # barh draws from the bottom up.
    order = np.arange(len(names))[::-1]
    figure = Figure(figsize=(8.0, 0.34 * len(names) + 1.2), layout="constrained")
    axes = figure.subplots()
    bars = axes.barh([names[index] for index in order], heights[order], color=BAR, height=0.62)
    shares = [f"{share:.0%}" for share in heights[order] / bound]
    axes.bar_label(bars, shares, padding=4, fontsize=9)
    axes.axvline(bound, color=BOUND, linewidth=2, label="bound")
    axes.set(xlabel=label, xlim=(0.0, 1.12 * max(bound, float(heights.max()))))
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(loc="lower right", frameon=False)
    return figure


def draw_shares(
    pressures: Mapping[str, Float64[np.ndarray, "samples"]], expected: Mapping[str, float]
) -> Figure:
    """Draw the cumulative distribution of the pressures [Pa] of each drive over the samples.

    ``expected`` is the pressure of each drive without deviations; a dot at the top marks it.
    """
    figure = Figure(figsize=(8.0, 4.0), layout="constrained")
    axes = figure.subplots()
    for colour, (name, samples) in zip(COLOURS_OF_DRIVES, pressures.items(), strict=False):
        shares = (np.arange(len(samples)) + 1.0) / len(samples)
        axes.step(np.sort(samples), shares, where="post", color=colour, label=name)
        axes.plot(expected[name], 1.0, "o", color=colour, clip_on=False)
    axes.axhline(0.1, color=BOUND, linewidth=1, linestyle="--", label="1 of 10 samples")
    axes.set(xlabel="peak pressure at the weakest focus [Pa]", ylabel="fraction of the samples")
    axes.set(xlim=(0.0, None), ylim=(0.0, 1.0))
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(loc="lower right", frameon=False)
    return figure


def draw_foci(
    axes: Axes,
    pressures: Mapping[str, Float64[np.ndarray, "foci"]],
    asked: Float64[np.ndarray, "foci"] | None,
) -> None:
    """Draw the pressures of drives at the foci [Pa] as bars, and requested pressures as lines."""
    foci = np.arange(len(next(iter(pressures.values()))))
    width = 0.8 / len(pressures)
    for index, (name, heights) in enumerate(pressures.items()):
        shift = (index - (len(pressures) - 1) / 2.0) * width
        colour = COLOURS_OF_DRIVES[index % len(COLOURS_OF_DRIVES)]
        axes.bar(foci + shift, heights, 0.94 * width, color=colour, label=name or None)
    if asked is not None:
        axes.hlines(asked, foci - 0.45, foci + 0.45, colors=BOUND, linewidth=2, label="request")
    axes.set(xlabel="focus", ylabel="peak pressure [Pa]", ylim=(0.0, None))
    # Foci are numbered by integers.
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.spines[["top", "right"]].set_visible(False)
    if asked is not None or len(pressures) > 1:
        axes.legend(frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))


def draw_overlay(overlay: Overlay) -> Figure:
    """Draw the measured and predicted pressures along the scan, and their difference."""
    used = overlay.used
    measured = overlay.scan.pressures[used]
    model = overlay.scale * overlay.predicted[used]
    # Without measured phases, only the magnitudes can be compared.
    if not overlay.scan.phased:
        measured = np.abs(measured)
        model = np.abs(model)
    projected, labels = _seen(overlay.scan.points[used])
    peak = float(np.abs(measured).max())
    shown = {
        "measured": np.abs(measured) / peak,
        "predicted": np.abs(model) / peak,
        f"difference, {overlay.error:.1%} rms": np.abs(measured - model) / peak,
    }
    label = "pressure / largest measured pressure"
    if len(labels) == 1:
        figure = Figure(figsize=(8.0, 4.0), layout="constrained")
        axes = figure.subplots()
        # The positions of the scan may go back and forth.
        order = np.argsort(projected[:, 0])
        for (name, values), style in zip(shown.items(), ("o", "-", ":"), strict=True):
            axes.plot(projected[order, 0], values[order], style, label=name, markersize=4)
        axes.set(xlabel=labels[0], ylabel=label, ylim=(0.0, None))
        axes.legend(frameon=False)
        return figure
    figure = Figure(figsize=(12.0, 4.4), layout="constrained")
    panels = figure.subplots(1, 3, sharex=True, sharey=True)
    largest = max(float(values.max()) for values in list(shown.values())[:2])
    for panel, (name, values) in zip(panels, shown.items(), strict=True):
        # The difference has its own scale.
        end = values.max() if name.startswith("difference") else largest
        dots = panel.scatter(
            *projected.T, c=values, s=24, marker="s", cmap=COLOURS, vmin=0, vmax=end
        )
        figure.colorbar(dots, ax=panel, label=label, location="bottom", aspect=28)
        panel.set(title=name, xlabel=labels[0], aspect="equal", facecolor="0.85")
    panels[0].set_ylabel(labels[1])
    return figure


def _seen(
    points: Float64[np.ndarray, "points 3"],
) -> tuple[Float64[np.ndarray, "points axes"], tuple[str, ...]]:
    # Ignore axes along which the spread is below 2 % of the largest spread.
    spans = np.ptp(points, axis=0)
    wide = np.flatnonzero(spans > 0.02 * spans.max())
    if len(wide) <= 2:
        return 1e3 * points[:, wide], tuple(f"{'xyz'[axis]} [mm]" for axis in wide)
    centred = points - points.mean(axis=0)
    _, spreads, directions = np.linalg.svd(centred, full_matrices=False)
    axes = directions[: 1 if spreads[1] < 0.02 * spreads[0] else 2]
    return 1e3 * centred @ axes.T, ("along the scan [mm]", "across the scan [mm]")[: len(axes)]


def draw_varied(
    axes: Mapping[str, Float64[np.ndarray, "points"]],
    values: Float64[np.ndarray, "points"],
    label: str,
) -> Figure:
    """Plot values against each varied column, with the median of points that share a value."""
    figure = Figure(figsize=(min(4.6 * len(axes), 16.0), 3.6), layout="constrained")
    panels = np.atleast_1d(figure.subplots(1, len(axes), sharey=True))
    for panel, (name, varied) in zip(panels, axes.items(), strict=True):
        finite = np.isfinite(varied) & np.isfinite(values)
        distinct = np.unique(varied[finite])
        panel.plot(varied[finite], values[finite], ".", color=BAR, alpha=0.35, markersize=5)
        # If no points share a value, the median would only connect the points.
        if len(distinct) < finite.sum() or len(axes) == 1:
            medians = [np.median(values[finite & (varied == value)]) for value in distinct]
            panel.plot(distinct, medians, color=BOUND)
        panel.set_xlabel(name)
        panel.xaxis.set_major_locator(MaxNLocator(4))
        panel.spines[["top", "right"]].set_visible(False)
    panels[0].set_ylabel(label, wrap=True)
    return figure
