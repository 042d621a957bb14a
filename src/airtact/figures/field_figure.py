"""Pressure in a plane, several drives side by side on one colour scale (the paper's Fig. 6 and Fig. 7)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float64, Real
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from matplotlib.patheffects import withStroke

from airtact.evaluation.windows import Window
from airtact.surfaces.surface import Surface

BODY = "0.72"
"""Grey of the bodies."""

COLOURS = "magma"
"""Colours of pressure magnitudes: perceptually uniform, black for silence."""

MOST_COLUMNS = 4
"""More fields than two are drawn in so many columns, without the names of the foci."""

MOST_NAMES = 8
"""More foci than this have small rings and no names."""


@dataclass(frozen=True, eq=False)
class Cut:
    """Pressure of several drives, by name, at the points of one window [Pa], NaN inside bodies.

    ``outlines`` are the closed lines in which the surfaces of bodies without a field inside meet the plane [m].
    """

    window: Window
    pressures: Mapping[str, Complex[np.ndarray, "points"]]
    outlines: Sequence[Float64[np.ndarray, "_ 3"]]


def cut_bodies(window: Window, bodies: Sequence[Surface]) -> list[Float64[np.ndarray, "_ 3"]]:
    """Cut bodies with the window's plane, into closed lines around the inside [m]."""
    return [loop for body in bodies for loop in _loops(window.height_of(body.vertices), body)]


def _loops(heights: Float64[np.ndarray, "vertices"], body: Surface) -> list[Float64[np.ndarray, "_ 3"]]:
    """Walk from triangle to triangle along the edges that the plane crosses."""
    above = heights[body.triangles] > 0
    crossed = np.flatnonzero(above.any(axis=1) & ~above.all(axis=1))
    above = above[crossed]
    lone_above = above.sum(axis=1) == 1
    lone = np.argmax(above == lone_above[:, None], axis=1)
    # The lone corner comes first: the plane crosses the two edges that meet there.
    corners = np.take_along_axis(body.triangles[crossed], (lone[:, None] + np.arange(3)) % 3, axis=1)
    ways = np.where(lone_above[:, None], [[1, 2]], [[2, 1]])
    ends = np.take_along_axis(corners, ways, axis=1)
    edges = np.sort(np.stack([np.repeat(corners[:, :1], 2, axis=1), ends], axis=2), axis=2)
    low, high = heights[edges[:, 0, 0]], heights[edges[:, 0, 1]]
    first, second = body.vertices[edges[:, 0, 0]], body.vertices[edges[:, 0, 1]]
    points = first + (low / (low - high))[:, None] * (second - first)
    keys = edges[:, :, 0] * len(body.vertices) + edges[:, :, 1]
    follow = dict(keys.tolist())
    point_of = dict(zip(keys[:, 0].tolist(), points, strict=True))
    loops = []
    while follow:
        key, loop = next(iter(follow)), []
        while key in follow:
            loop.append(point_of[key])
            key = follow.pop(key)
        loops.append(np.array(loop))
    return loops


def draw_fields(cut: Cut, foci: Real[np.ndarray, "foci 3"], names: Sequence[str], normalisation: str) -> Figure:
    """Draw the drives' pressure magnitudes side by side, in rows where there are more than two.

    Foci [m] off the plane are dashed. ``normalisation`` is what is held equal between the drives, named at the bar.
    """
    left, right, bottom, top = cut.window.extent
    wide, tall = right - left, top - bottom
    count = len(cut.pressures)
    columns = count if count <= 2 else MOST_COLUMNS
    rows = -(-count // columns)
    size = min(10.4 / columns / wide, 5.6 / tall)
    figure = Figure(figsize=(columns * wide * size + 2.0, rows * (tall * size + 0.3) + 0.6), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    scale = _scale([cut])
    for panel, (title, pressure) in zip(axes.ravel(), cut.pressures.items(), strict=False):
        _draw_cut(panel, cut, pressure, scale)
        panel.set_title(title, fontsize=11)
        _mark_foci(panel, cut.window, foci, names if count <= 2 and len(names) <= MOST_NAMES else [""] * len(names))
    for panel in axes[:, 0]:
        panel.set_ylabel(cut.window.labels[1])
    for column, panel in enumerate(axes.T):
        last = (count - 1 - column) // columns
        panel[last].set_xlabel(cut.window.labels[0])
        panel[last].tick_params(labelbottom=True)
        for empty in panel[last + 1 :]:
            empty.remove()
    drawn, label = [panel for panel in axes.ravel() if panel.figure is not None], f"peak pressure [Pa], {normalisation}"
    figure.colorbar(ScalarMappable(scale, COLOURS), ax=drawn, label=label, pad=0.015, aspect=28)
    return figure


def draw_close_ups(cuts: Sequence[Cut], names: Sequence[str], normalisation: str) -> Figure:
    """Draw one column per focus, each with its cut and name, and one row per drive, all on one colour scale.

    The surface lies below the focus. ``normalisation`` is what is held equal between the drives, named at the bar.
    """
    drives = list(cuts[0].pressures)
    figure = Figure(figsize=(1.75 * len(cuts) + 1.6, 1.85 * len(drives) + 0.6), layout="constrained")
    axes = figure.subplots(len(drives), len(cuts), squeeze=False)
    scale = _scale(cuts)
    for column, (cut, name) in enumerate(zip(cuts, names, strict=True)):
        for row, drive in enumerate(drives):
            panel = axes[row, column]
            _draw_cut(panel, cut, cut.pressures[drive], scale, centred=True)
            panel.plot(0, 0, "o", markersize=9, markerfacecolor="none", markeredgecolor="white")
            panel.tick_params(labelsize=8, labelleft=column == 0, labelbottom=row == len(drives) - 1)
        axes[0, column].set_title(name, fontsize=10)
    for row, drive in enumerate(drives):
        axes[row, 0].set_ylabel(f"{drive}\noff the focus [mm]", fontsize=9)
    figure.supxlabel("along the surface from the focus [mm]", fontsize=9)
    label = f"peak pressure [Pa],\n{normalisation}"
    figure.colorbar(ScalarMappable(scale, COLOURS), ax=axes, label=label, pad=0.01, aspect=28)
    return figure


def _scale(cuts: Sequence[Cut]) -> Normalize:
    """One scale for all: from no pressure to the highest in any of them."""
    return Normalize(0.0, max(float(np.nanmax(np.abs(some))) for cut in cuts for some in cut.pressures.values()))


def _draw_cut(
    axes: Axes, cut: Cut, pressure: Complex[np.ndarray, "points"], scale: Normalize, centred: bool = False
) -> None:
    """Draw one pressure, with coordinates from the window's middle if ``centred``."""
    window = cut.window
    left, right, bottom, top = window.extent
    shift = np.array([left + right, bottom + top]) / 2 if centred else np.zeros(2)
    (left, right), (bottom, top) = (left, right) - shift[0], (bottom, top) - shift[1]
    rows, columns = window.shape
    half = (right - left) / (columns - 1) / 2, (top - bottom) / (rows - 1) / 2
    edges = (left - half[0], right + half[0], bottom - half[1], top + half[1])
    magnitude = _past_the_surface(np.abs(pressure).reshape(rows, columns))
    axes.imshow(magnitude, origin="lower", extent=edges, cmap=COLOURS, norm=scale, interpolation="bilinear")
    axes.set_facecolor(BODY)
    loops = [Path(window.seen(np.concatenate([loop, loop[:1]])) - shift, closed=True) for loop in cut.outlines]
    if loops:
        bodies = Path.make_compound_path(*loops)
        axes.add_patch(PathPatch(bodies, facecolor=BODY, edgecolor="0.25", linewidth=0.8))
    axes.set(xlim=(left, right), ylim=(bottom, top))


def _past_the_surface(magnitude: Float64[np.ndarray, "rows columns"]) -> np.ma.MaskedArray:
    """Carry the field three points into the bodies, where their grey covers it, so that no gap shows at the surface."""
    from scipy.ndimage import distance_transform_edt

    inside = np.isnan(magnitude)
    if not inside.any() or inside.all():
        return np.ma.masked_invalid(magnitude)
    distance, (row, column) = distance_transform_edt(inside, return_indices=True)  # pyright: ignore
    return np.ma.masked_where(distance > 3, magnitude[row, column])


def _mark_foci(axes: Axes, window: Window, foci: Real[np.ndarray, "foci 3"], names: Sequence[str]) -> None:
    positions = window.seen(foci)
    off = np.abs(window.height_of(foci)) > 0.5e-3
    outwards = positions - positions.mean(axis=0)
    size = 90 if len(foci) <= MOST_NAMES else 12
    plate = {"boxstyle": "round,pad=0.2", "facecolor": "white", "edgecolor": "none", "alpha": 0.75}
    for position, is_off, away, name in zip(positions, off, outwards, names, strict=True):
        style = (0, (2, 1.5)) if is_off else "solid"
        line = {"edgecolors": "white", "linewidths": 1.3, "linestyles": [style]}
        ring = axes.scatter(*position, s=size, facecolors="none", **line)
        ring.set_path_effects([withStroke(linewidth=2.4, foreground="black")])
        if name:
            shift, side = ((-10, 0), "right") if away[0] < 0 else ((10, 0), "left")
            beside = {"xytext": shift, "textcoords": "offset points", "ha": side, "va": "center"}
            axes.annotate(name, position, fontsize=8, bbox=plate, **beside)
