"""Pressure of drives in a plane on one colour scale, and their difference (Figs. 6 and 7)."""

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

BODY = "0.66"
"""Grey of the bodies."""

COLOURS = "magma"
"""Colours of pressure magnitudes: perceptually uniform, black for silence."""

DIFFERENCES = ScalarMappable(Normalize(-6.0, 6.0), "RdBu_r")
"""Colours of the level of one drive relative to another [dB]."""

FAINT = 0.1
"""Fraction of the largest pressure below which a level difference is grey."""

MAX_NAMES = 8
"""Largest number of foci with names and large rings."""


@dataclass(frozen=True, eq=False)
class Cut:
    """Pressure of several drives, by name, at the points of one window [Pa], NaN inside bodies.

    ``depth`` is the ``solid_depth`` of the points.
    """

    window: Window
    pressures: Mapping[str, Complex[np.ndarray, "points"]]
    depth: Float64[np.ndarray, "points"]


def solid_depth(
    scene: Scene, points: Real[np.ndarray, "points 3"]
) -> Float64[np.ndarray, "points"]:
    """Depth of points (P, 3) in bodies without a field inside, or behind planes [m].

    It is negative in the air.
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
    """Draw the pressure magnitude of one drive, on a scale that ends at ``peak`` [Pa].

    It is drawn into ``axes``, or into a new figure. Foci [m] off the plane are dashed.
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
    """Draw the level of one drive relative to another [dB], grey where both are faint."""
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
    # Given axes may have other axes below them, so the bar goes beside them.
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
    """Level of one drive relative to another [dB], and its opacity, 0 where both are faint."""
    first, second = (np.abs(cut.pressures[name]) for name in drives)
    # 60 dB below the peak, to avoid the logarithm of zero.
    smallest = 1e-3 * peak
    change = 20.0 * np.log10(np.maximum(first, smallest) / np.maximum(second, smallest))
    strength = np.clip(np.maximum(first, second) / (FAINT * peak) - 0.5, 0.0, 1.0)
    return change, np.nan_to_num(strength)


def draw_close_ups(cuts: Sequence[Cut], names: Sequence[str], peak: float) -> Figure:
    """Draw cuts through foci: one column per focus, one row per drive and one for the difference.

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
    """Draw values with the opacity ``strength``, and the bodies.

    With ``centred``, the zero is the window's middle.
    """
    # 3 points leave no gap between the interpolated values and the outline.
    carried = past_the_surface(cut.window, values, 3)
    left, right, bottom, top = cut.window.extent
    shift = ((left + right) / 2.0, (bottom + top) / 2.0) if centred else (0.0, 0.0)
    draw_values(axes, cut.window, carried, scale, strength, shift)
    draw_solid(axes, cut.window, cut.depth, shift)


def draw_values(
    axes: Axes,
    window: Window,
    values: Real[np.ndarray, "points"],
    scale: ScalarMappable,
    strength: Float64[np.ndarray, "points"] | None = None,
    shift: tuple[float, float] = (0.0, 0.0),
) -> None:
    """Draw values at the points of a window, blank where NaN; ``shift`` becomes its zero [mm]."""
    left, right, bottom, top = np.subtract(window.extent, np.repeat(shift, 2))
    rows, columns = window.shape
    # A pixel is centred on its point, so the picture extends half a pixel beyond the window.
    half_width = (right - left) / (columns - 1) / 2
    half_height = (top - bottom) / (rows - 1) / 2
    axes.imshow(
        np.ma.masked_invalid(np.asarray(values, dtype=np.float64).reshape(rows, columns)),
        origin="lower",
        extent=(left - half_width, right + half_width, bottom - half_height, top + half_height),
        alpha=None if strength is None else strength.reshape(rows, columns),
        cmap=scale.get_cmap(),
        norm=scale.norm,  # pyright: ignore
        interpolation="bilinear",
    )
    # Blank values are grey.
    axes.set_facecolor("0.86")
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")


def draw_solid(
    axes: Axes,
    window: Window,
    depth: Float64[np.ndarray, "points"],
    shift: tuple[float, float] = (0.0, 0.0),
) -> None:
    """Fill the bodies in a window: the points with a positive depth."""
    if depth.max() > 0.0:
        grid = (*grid_axes(window, shift), depth.reshape(window.shape))
        axes.contourf(*grid, levels=[0.0, 2.0 * depth.max()], colors=[BODY])
        axes.contour(*grid, levels=[0.0], colors="0.25", linewidths=0.8)


def grid_axes(
    window: Window, shift: tuple[float, float] = (0.0, 0.0)
) -> tuple[Float64[np.ndarray, "columns"], Float64[np.ndarray, "rows"]]:
    """Coordinates of the columns and rows of a window's picture [mm]."""
    left, right, bottom, top = np.subtract(window.extent, np.repeat(shift, 2))
    rows, columns = window.shape
    return np.linspace(left, right, columns), np.linspace(bottom, top, rows)


def past_the_surface(
    window: Window, values: Float64[np.ndarray, "points"], points: int
) -> Float64[np.ndarray, "points"]:
    """Extrapolate values, which are NaN inside bodies, by a number of points into the bodies."""
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
    # Foci within half a millimetre of the plane count as in it.
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
