"""Pressure of drives in a plane on a common colour scale, and their difference (Figs. 6 and 7)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Complex, Float64, Real
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from airtact.acoustics.scene import Scene
from airtact.evaluation.windows import Window
from airtact.geometry.distances import nearest_within

# Grey colour of the bodies
BODY = "0.66"

# Colours of pressure magnitudes; perceptually uniform, black at zero
COLOURS = "magma"

# Colours of the level of one drive relative to another [dB]
DIFFERENCES = ScalarMappable(Normalize(-6.0, 6.0), "RdBu_r")

# Fraction of the largest pressure below which level differences are drawn in grey
FAINT = 0.1

# Largest number of foci that are drawn with names and large rings
MAX_NAMES = 8


@dataclass(frozen=True, eq=False)
class Cut:
    """Pressures [Pa] of several drives, by name, on a plane grid of points (the ``window``).

    Pressures are NaN inside bodies. ``depth`` is the depth of the points in bodies or behind planes
    [m], as returned by ``solid_depth``.
    """

    window: Window
    pressures: Mapping[str, Complex[np.ndarray, "points"]]
    depth: Float64[np.ndarray, "points"]


def solid_depth(
    scene: Scene, points: Real[np.ndarray, "points 3"]
) -> Float64[np.ndarray, "points"]:
    """Return the depth [m] of points (P, 3) behind planes and in bodies that sound cannot enter.

    The depth is negative in the air.
    """
    bodies = [body.surface for body in scene.obstacles if body.boundary != "filled"]
    depths = [body.depth(points) for body in bodies]
    depths += [-plane.height(points) for plane in scene.planes]
    return np.max([np.full(len(points), -np.inf), *depths], axis=0)


def draw_field(
    cut: Cut,
    drive: str,
    peak: float,
    foci: Real[np.ndarray, "foci 3"],
    names: Sequence[str] | None = None,
    axes: Axes | None = None,
) -> Figure:
    """Draw the pressure magnitude of one drive on a scale that ends at ``peak`` [Pa].

    The picture is drawn into ``axes``, or by default into a new figure. Foci outside the plane
    are dashed.
    """
    scale = ScalarMappable(Normalize(0.0, peak), COLOURS)
    values = np.abs(cut.pressures[drive])
    return draw_plane(axes, cut, values, scale, foci, names, "peak pressure [Pa]")


def draw_difference(
    cut: Cut,
    drives: tuple[str, str],
    peak: float,
    foci: Real[np.ndarray, "foci 3"],
    names: Sequence[str] | None = None,
    axes: Axes | None = None,
) -> Figure:
    """Draw the level of one drive relative to another [dB]; grey where both are weak."""
    first, second = (np.abs(cut.pressures[name]) for name in drives)
    # A floor 60 dB below the peak avoids the logarithm of zero.
    smallest = 1e-3 * peak
    change = 20.0 * np.log10(np.maximum(first, smallest) / np.maximum(second, smallest))
    # Opaque, except where both drives are weak
    strength = np.clip(np.maximum(first, second) / (FAINT * peak) - 0.5, 0.0, 1.0)
    strength = np.nan_to_num(strength)
    label = f"{drives[0]} relative to {drives[1]} [dB]"
    return draw_plane(axes, cut, change, DIFFERENCES, foci, names, label, strength)


def draw_plane(
    axes: Axes | None,
    cut: Cut,
    values: Float64[np.ndarray, "points"],
    scale: ScalarMappable,
    foci: Real[np.ndarray, "foci 3"],
    names: Sequence[str] | None,
    label: str,
    strength: Float64[np.ndarray, "points"] | None = None,
) -> Figure:
    """Draw values at the points of a cut, with bodies, foci and a colour bar.

    ``strength`` is the opacity of each point.
    """
    window = cut.window
    left, right, bottom, top = window.extent
    # There may be other axes below these, so draw the colour bar next to them.
    place: dict[str, Any] = {"ax": axes, "location": "right", "pad": 0.02, "aspect": 30}
    if axes is None:
        inches = min(3.9 / (right - left), 4.6 / (top - bottom))
        across = (right - left) * inches
        up = (top - bottom) * inches
        # Fixed margins for the labels, because Matplotlib's layouts take longer than drawing.
        width = across + 1.0
        height = up + 1.4
        figure = Figure(figsize=(width, height))
        axes = figure.add_axes((0.8 / width, 1.2 / height, across / width, up / height))
        bar = figure.add_axes((0.8 / width, 0.6 / height, across / width, 0.13 / height))
        place = {"cax": bar, "orientation": "horizontal"}
    rows, columns = window.shape
    # Each pixel is centred on its point, so the picture extends half a pixel beyond the window.
    half_width = (right - left) / (columns - 1) / 2
    half_height = (top - bottom) / (rows - 1) / 2
    axes.imshow(
        np.ma.masked_invalid(_past_the_surface(values.reshape(rows, columns))),
        origin="lower",
        extent=(left - half_width, right + half_width, bottom - half_height, top + half_height),
        alpha=None if strength is None else strength.reshape(rows, columns),
        cmap=scale.get_cmap(),
        norm=scale.norm,  # pyright: ignore
        interpolation="bilinear",
    )
    axes.set_facecolor("0.86")  # visible where there are no values
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
    draw_solid(axes, window, cut.depth)
    axes.set(xlabel=window.labels[0], ylabel=window.labels[1])
    _mark_foci(axes, window, foci, names)
    extend = "both" if scale is DIFFERENCES else "neither"
    axes.figure.colorbar(scale, label=label, extend=extend, **place)
    return axes.figure  # pyright: ignore (no subfigure)


def draw_solid(axes: Axes, window: Window, depth: Float64[np.ndarray, "points"]) -> None:
    """Fill the parts of a window that are inside bodies, where the depth is positive."""
    if depth.max() > 0.0:
        grid = (*grid_axes(window), depth.reshape(window.shape))
        axes.contourf(*grid, levels=[0.0, 2.0 * depth.max()], colors=[BODY])
        axes.contour(*grid, levels=[0.0], colors="0.25", linewidths=0.8)


def grid_axes(
    window: Window,
) -> tuple[Float64[np.ndarray, "columns"], Float64[np.ndarray, "rows"]]:
    """Return the coordinates of the columns and rows of a window's picture [mm]."""
    left, right, bottom, top = window.extent
    rows, columns = window.shape
    return np.linspace(left, right, columns), np.linspace(bottom, top, rows)


def _past_the_surface(
    values: Float64[np.ndarray, "rows columns"],
) -> Float64[np.ndarray, "rows columns"]:
    """Extend values by 3 points into bodies, where they are NaN.

    Otherwise there would be a gap between the interpolated values and the outlines.
    """
    inside = np.isnan(values)
    places = np.pad(np.argwhere(inside).astype(np.float64), ((0, 0), (0, 1)))
    known = np.pad(np.argwhere(~inside).astype(np.float64), ((0, 0), (0, 1)))
    distance, index = nearest_within(places, known, 3.01)
    extended = values.copy()
    extended[inside] = np.where(np.isfinite(distance), values[~inside][index], np.nan)
    return extended


def _mark_foci(
    axes: Axes, window: Window, foci: Real[np.ndarray, "foci 3"], names: Sequence[str] | None
) -> None:
    if not names or len(names) > MAX_NAMES:
        names = [""] * len(foci)
    positions = window.seen(foci)
    # Foci within half a millimetre of the plane count as being in it.
    off = np.abs(window.height_of(foci)) > 0.5e-3
    outwards = positions - positions.mean(axis=0)
    size = 90 if len(foci) <= MAX_NAMES else 12
    plate = {"boxstyle": "round,pad=0.2", "facecolor": "white", "edgecolor": "none", "alpha": 0.75}
    for position, is_off, outward, name in zip(positions, off, outwards, names, strict=True):
        style = (0, (2, 1.5)) if is_off else "solid"
        line = {"edgecolors": "white", "linewidths": 1.3, "linestyles": [style]}
        ring = axes.scatter(*position, s=size, facecolors="none", **line)
        # A black edge makes the white ring visible on bright colours.
        ring.set_path_effects([withStroke(linewidth=2.4, foreground="black")])
        if name:
            shift, side = ((-10, 0), "right") if outward[0] < 0 else ((10, 0), "left")
            place = {"xytext": shift, "textcoords": "offset points", "ha": side, "va": "center"}
            axes.annotate(name, position, fontsize=8, bbox=plate, **place)
