"""Values in one plane, side by side on one scale, with the bodies cut and the foci marked."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float64, Real
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path

from airtact.evaluation.windows import Window
from airtact.figures.field_figure import BODY

BLANK = "0.9"
"""Grey of places without a value."""


def carried(window: Window, values: Float64[np.ndarray, "points"]) -> Float64[np.ndarray, "points"]:
    """Carry values two points into the bodies, where their grey covers them, so that no gap shows at the skin."""
    from scipy.ndimage import distance_transform_edt

    grid = values.reshape(window.shape)
    found: Any = distance_transform_edt(np.isnan(grid), return_indices=True)
    distance, (row, column) = found
    return np.where(distance <= 2, grid[row, column], np.nan).ravel()


def draw_planes(
    window: Window,
    values: Mapping[str, Real[np.ndarray, "points"]],
    outlines: Sequence[Float64[np.ndarray, "_ 3"]],
    marks: Real[np.ndarray, "marks 3"],
    scale: tuple[str, float, float, str],
) -> Figure:
    """Draw values at the points of a window, one picture for each name."""
    colours, lowest, highest, label = scale
    left, right, bottom, top = window.extent
    size = min(10.0 / len(values) / (right - left), 5.0 / (top - bottom), 5.0 / (right - left))
    wide, tall = (right - left) * size, (top - bottom) * size
    figure = Figure(figsize=(len(values) * (wide + 0.3) + 1.6, tall + 1.0), layout="constrained")
    axes = figure.subplots(1, len(values), squeeze=False, sharex=True, sharey=True)[0]
    rows, columns = window.shape
    half = (right - left) / (columns - 1) / 2, (top - bottom) / (rows - 1) / 2
    for place, (title, shown) in zip(axes, values.items(), strict=True):
        place.imshow(
            np.ma.masked_invalid(np.asarray(shown, dtype=np.float64).reshape(rows, columns)),
            origin="lower",
            extent=(left - half[0], right + half[0], bottom - half[1], top + half[1]),
            cmap=colours,
            norm=Normalize(lowest, highest),
            interpolation="nearest",
        )
        place.set_facecolor(BLANK)
        for loop in outlines:
            skin = Path(window.seen(np.concatenate([loop, loop[:1]])), closed=True)
            place.add_patch(PathPatch(skin, facecolor=BODY, edgecolor="0.25", linewidth=0.8))
        place.plot(*window.seen(marks).T, "o", markersize=8, markerfacecolor="none", markeredgecolor="black", mew=2.6)
        place.plot(*window.seen(marks).T, "o", markersize=8, markerfacecolor="none", markeredgecolor="white", mew=1.3)
        place.set_title(title, fontsize=11)
        place.set(xlim=(left, right), ylim=(bottom, top), xlabel=window.labels[0])
    axes[0].set_ylabel(window.labels[1])
    figure.colorbar(
        ScalarMappable(Normalize(lowest, highest), colours), ax=list(axes), label=label, pad=0.015, aspect=28
    )
    return figure
