"""A measured scan beside what was predicted for it."""

import numpy as np
from jaxtyping import Float64
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from airtact.evaluation.scan import Overlay
from airtact.figures.field_figure import COLOURS

FLAT = 0.02
"""Points spread less than this share of their widest spread lie on a line."""


def draw_overlay(overlay: Overlay) -> Figure:
    """Draw what was measured, what was predicted and how they differ, in the plane that the positions lie in.

    Positions on a line are drawn as two curves.

    Parameters
    ----------
    overlay : the scan and its prediction.
    """
    used = overlay.used
    measured = overlay.scan.pressures[used]
    model = overlay.scale * overlay.predicted[used]
    if not overlay.scan.phased:
        measured, model = np.abs(measured), np.abs(model)
    places, axes = _seen(overlay.scan.points[used])
    peak = float(np.abs(measured).max())
    shown = {
        "measured": np.abs(measured) / peak,
        "predicted": np.abs(model) / peak,
        f"difference, {overlay.error:.1%} rms": np.abs(measured - model) / peak,
    }
    return _curves(places[:, 0], axes[0], shown) if len(axes) == 1 else _maps(places, axes, shown)


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
    kept = ways[: 1 if spreads[1] < FLAT * spreads[0] else 2]
    return 1e3 * centred @ kept.T, ("along the scan [mm]", "across the scan [mm]")[: len(kept)]


def _curves(
    along: Float64[np.ndarray, "points"], label: str, shown: dict[str, Float64[np.ndarray, "points"]]
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
    places: Float64[np.ndarray, "points 2"], labels: tuple[str, ...], shown: dict[str, Float64[np.ndarray, "points"]]
) -> Figure:
    wide, tall = np.ptp(places, axis=0)
    size = 3.6 / max(wide, tall)
    figure = Figure(figsize=(3 * max(wide * size, 1.6) + 1.4, max(tall * size, 1.6) + 1.0), layout="constrained")
    axes = figure.subplots(1, 3, sharex=True, sharey=True)
    scale = Normalize(0.0, max(float(values.max()) for values in shown.values()))
    # squares that just meet where the positions form a grid
    side = 72 * size * np.sqrt(wide * tall / len(places))
    for place, (name, values) in zip(axes, shown.items(), strict=True):
        place.scatter(*places.T, c=values, cmap=COLOURS, norm=scale, s=max(side, 2.0) ** 2, marker="s", linewidths=0)
        place.set_title(name, fontsize=11)
        place.set(xlabel=labels[0], aspect="equal", facecolor="0.85")
    axes[0].set_ylabel(labels[1])
    figure.colorbar(
        ScalarMappable(scale, COLOURS), ax=list(axes), label="pressure over the largest measured", aspect=28
    )
    return figure
