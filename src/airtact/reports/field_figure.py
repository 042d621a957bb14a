"""Pressure of drives in a plane on one colour scale, and their difference (Fig. 6 and 7)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

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
from airtact.geometry.surface import Surface

BODY = "0.66"
"""Grey of the bodies."""

COLOURS = "magma"
"""Colours of pressure magnitudes: perceptually uniform, black for silence."""

DIFFERENCES = ScalarMappable(Normalize(-6.0, 6.0), "RdBu_r")
"""Colours of the level of one drive over that of another [dB]."""

FAINT = 0.1
"""Share of the largest pressure below which a difference of levels is drawn grey."""

MAX_NAMES = 8
"""Number of foci up to which they have names and large rings."""


@dataclass(frozen=True, eq=False)
class Cut:
    """Pressure of several drives, by name, at the points of one window [Pa], NaN inside bodies.

    ``outlines`` are the closed lines in which the plane cuts bodies without a field inside [m].
    ``error`` is the estimated relative error of the pressures over the window, or NaN.
    """

    window: Window
    pressures: Mapping[str, Complex[np.ndarray, "points"]]
    outlines: Sequence[Float64[np.ndarray, "_ 3"]]
    error: float = float("nan")


def cut_bodies(window: Window, bodies: Sequence[Surface]) -> list[Float64[np.ndarray, "_ 3"]]:
    """Return the closed lines in which the window's plane cuts bodies, around the inside [m]."""
    return [loop for body in bodies for loop in _loops(window.height_of(body.vertices), body)]


def _loops(
    heights: Float64[np.ndarray, "vertices"], body: Surface
) -> list[Float64[np.ndarray, "_ 3"]]:
    """Walk from triangle to triangle along the edges that the plane crosses."""
    above = heights[body.triangles] > 0
    crossed = np.flatnonzero(above.any(axis=1) & ~above.all(axis=1))
    above = above[crossed]
    lone_above = above.sum(axis=1) == 1
    lone = np.argmax(above == lone_above[:, None], axis=1)
    # The lone corner comes first: the plane crosses the two edges that meet there.
    corners = np.take_along_axis(
        body.triangles[crossed], (lone[:, None] + np.arange(3)) % 3, axis=1
    )
    order = np.where(lone_above[:, None], [[1, 2]], [[2, 1]])
    ends = np.take_along_axis(corners, order, axis=1)
    edges = np.sort(np.stack([np.repeat(corners[:, :1], 2, axis=1), ends], axis=2), axis=2)
    low = heights[edges[:, 0, 0]]
    high = heights[edges[:, 0, 1]]
    first = body.vertices[edges[:, 0, 0]]
    second = body.vertices[edges[:, 0, 1]]
    points = first + (low / (low - high))[:, None] * (second - first)
    # An edge is one number; each triangle leads from one crossed edge to the next.
    keys = edges[:, :, 0] * len(body.vertices) + edges[:, :, 1]
    follow = dict(keys.tolist())
    point_of = dict(zip(keys[:, 0].tolist(), points, strict=True))
    loops = []
    while follow:
        key = next(iter(follow))
        loop = []
        while key in follow:
            loop.append(point_of[key])
            key = follow.pop(key)
        loops.append(np.array(loop))
    return loops


def draw_field(
    cut: Cut,
    drive: str,
    peak: float,
    foci: Real[np.ndarray, "foci 3"],
    names: Sequence[str] | None = None,
    axes: Axes | None = None,
) -> Figure:
    """Draw the pressure magnitude of one drive, on a scale that ends at ``peak`` [Pa].

    It goes into axes, or into a new figure. Foci [m] off the plane are dashed.
    """
    scale = _pressure_scale(peak)
    values = np.abs(cut.pressures[drive])
    return _draw_plane(axes, cut, values, scale, foci, names, "peak pressure [Pa]")


def draw_difference(
    cut: Cut,
    drives: tuple[str, str],
    peak: float,
    foci: Real[np.ndarray, "foci 3"],
    names: Sequence[str] | None = None,
    axes: Axes | None = None,
) -> Figure:
    """Draw the level of one drive over another [dB], grey where both are faint against ``peak``."""
    change, strength = _difference(cut, drives, peak)
    label = f"{drives[0]} over {drives[1]} [dB]"
    return _draw_plane(axes, cut, change, DIFFERENCES, foci, names, label, strength)


def _draw_plane(
    axes: Axes | None,
    cut: Cut,
    values: Float64[np.ndarray, "points"],
    scale: ScalarMappable,
    foci: Real[np.ndarray, "foci 3"],
    names: Sequence[str] | None,
    label: str,
    strength: Float64[np.ndarray, "points"] | None = None,
) -> Figure:
    # The bar is below the only axes of a figure, and beside given axes, which may have neighbours.
    location = "right"
    if axes is None:
        location = "bottom"
        left, right, bottom, top = cut.window.extent
        inches = min(3.9 / (right - left), 4.6 / (top - bottom))
        size = ((right - left) * inches + 0.8, (top - bottom) * inches + 1.2)
        axes = Figure(figsize=size, layout="constrained").subplots()
    _draw_cut(axes, cut, values, scale, strength)
    axes.set(xlabel=cut.window.labels[0], ylabel=cut.window.labels[1])
    _mark_foci(axes, cut.window, foci, names)
    extend = "both" if scale is DIFFERENCES else "neither"
    style: dict[str, Any] = {"location": location, "pad": 0.02, "aspect": 30, "extend": extend}
    axes.figure.colorbar(scale, ax=axes, label=label, **style)
    return axes.figure  # pyright: ignore (no subfigure)


def _pressure_scale(peak: float) -> ScalarMappable:
    return ScalarMappable(Normalize(0.0, peak), COLOURS)


def _difference(
    cut: Cut, drives: tuple[str, str], peak: float
) -> tuple[Float64[np.ndarray, "points"], Float64[np.ndarray, "points"]]:
    """Level of one drive over another [dB], and its opacity: none where both are faint."""
    first, second = (np.abs(cut.pressures[name]) for name in drives)
    # 60 dB below the peak: the logarithm of zero is avoided.
    smallest = 1e-3 * peak
    change = 20.0 * np.log10(np.maximum(first, smallest) / np.maximum(second, smallest))
    strength = np.clip(np.maximum(first, second) / (FAINT * peak) - 0.5, 0.0, 1.0)
    return change, np.nan_to_num(strength)


def draw_close_ups(cuts: Sequence[Cut], names: Sequence[str], peak: float) -> Figure:
    """Draw cuts across foci: one column per focus, one row per drive and for the difference.

    The surface lies below the focus. The scale of all pressures ends at ``peak`` [Pa].
    """
    first, second = cuts[0].pressures
    figure = Figure(figsize=(1.6 * len(cuts) + 1.7, 1.75 * 3 + 0.5), layout="constrained")
    axes = figure.subplots(3, len(cuts), squeeze=False, sharex=True, sharey=True)
    pressure = _pressure_scale(peak)
    for column, (cut, name) in enumerate(zip(cuts, names, strict=True)):
        for panel, drive in zip(axes[:2, column], (first, second), strict=True):
            _draw_cut(panel, cut, np.abs(cut.pressures[drive]), pressure, centred=True)
        change, strength = _difference(cut, (first, second), peak)
        _draw_cut(axes[2, column], cut, change, DIFFERENCES, strength, centred=True)
        for panel in axes[:, column]:
            panel.plot(0, 0, "o", markersize=9, markerfacecolor="none", markeredgecolor="white")
            panel.tick_params(labelsize=8)
        axes[0, column].set_title(name, fontsize=10)
    for row, drive in enumerate((first, second, "difference")):
        axes[row, 0].set_ylabel(f"{drive}\noff the focus [mm]", fontsize=9)
    figure.supxlabel("along the surface from the focus [mm]", fontsize=9)
    figure.colorbar(pressure, ax=axes[:2], label="peak pressure [Pa]", pad=0.01, aspect=28)
    label = f"{first}\nover {second} [dB]"
    figure.colorbar(DIFFERENCES, ax=axes[2], label=label, pad=0.01, aspect=14, extend="both")
    return figure


def _draw_cut(
    axes: Axes,
    cut: Cut,
    values: Float64[np.ndarray, "points"],
    scale: ScalarMappable,
    strength: Float64[np.ndarray, "points"] | None = None,
    centred: bool = False,
) -> None:
    """Draw values as opaque as ``strength``; ``centred`` counts from the window's middle."""
    # 3 points: no gap shows between the interpolated values and the outline.
    carried = past_the_surface(cut.window, values, 3)
    draw_values(axes, cut.window, carried, scale, cut.outlines, "bilinear", strength, centred)


def draw_values(
    axes: Axes,
    window: Window,
    values: Real[np.ndarray, "points"],
    scale: ScalarMappable,
    outlines: Sequence[Float64[np.ndarray, "_ 3"]],
    interpolation: str = "nearest",
    strength: Float64[np.ndarray, "points"] | None = None,
    centred: bool = False,
) -> None:
    """Draw values at the points of a window, blank where NaN, and the filled outlines of bodies."""
    left, right, bottom, top = window.extent
    shift = np.array([left + right, bottom + top]) / 2 if centred else np.zeros(2)
    left, right = (left, right) - shift[0]
    bottom, top = (bottom, top) - shift[1]
    rows, columns = window.shape
    # A pixel is centred on its point, so the picture extends half a pixel beyond the window.
    half_width = (right - left) / (columns - 1) / 2
    half_height = (top - bottom) / (rows - 1) / 2
    edges = (left - half_width, right + half_width, bottom - half_height, top + half_height)
    drawn = np.ma.masked_invalid(np.asarray(values, dtype=np.float64).reshape(rows, columns))
    colours = {"cmap": scale.get_cmap(), "norm": scale.norm, "interpolation": interpolation}
    opaque = None if strength is None else strength.reshape(rows, columns)
    axes.imshow(drawn, origin="lower", extent=edges, alpha=opaque, **colours)
    # The grey of blank values.
    axes.set_facecolor("0.86")
    loops = [
        Path(window.seen(np.concatenate([loop, loop[:1]])) - shift, closed=True)
        for loop in outlines
    ]
    if loops:
        bodies = Path.make_compound_path(*loops)
        axes.add_patch(PathPatch(bodies, facecolor=BODY, edgecolor="0.25", linewidth=0.8))
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")


def past_the_surface(
    window: Window, values: Float64[np.ndarray, "points"], points: int
) -> Float64[np.ndarray, "points"]:
    """Continue values, NaN inside bodies, by a number of points into the bodies."""
    from scipy.ndimage import distance_transform_edt

    grid = values.reshape(window.shape)
    inside = np.isnan(grid)
    if not inside.any() or inside.all():
        return values
    distance, (row, column) = distance_transform_edt(inside, return_indices=True)  # pyright: ignore
    return np.where(distance <= points, grid[row, column], np.nan).ravel()


def _mark_foci(
    axes: Axes, window: Window, foci: Real[np.ndarray, "foci 3"], names: Sequence[str] | None
) -> None:
    if not names or len(names) > MAX_NAMES:
        names = [""] * len(foci)
    positions = window.seen(foci)
    # Foci within half a millimetre count as in the plane.
    off = np.abs(window.height_of(foci)) > 0.5e-3
    outwards = positions - positions.mean(axis=0)
    size = 90 if len(foci) <= MAX_NAMES else 12
    plate = {"boxstyle": "round,pad=0.2", "facecolor": "white", "edgecolor": "none", "alpha": 0.75}
    for position, is_off, outward, name in zip(positions, off, outwards, names, strict=True):
        style = (0, (2, 1.5)) if is_off else "solid"
        line = {"edgecolors": "white", "linewidths": 1.3, "linestyles": [style]}
        ring = axes.scatter(*position, s=size, facecolors="none", **line)
        # A black edge shows the white ring on bright colours.
        ring.set_path_effects([withStroke(linewidth=2.4, foreground="black")])
        if name:
            shift, side = ((-10, 0), "right") if outward[0] < 0 else ((10, 0), "left")
            place = {"xytext": shift, "textcoords": "offset points", "ha": side, "va": "center"}
            axes.annotate(name, position, fontsize=8, bbox=plate, **place)
