"""Axes in space: an upright frame in millimetres, seen from a chosen side."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64, Real
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import FixedLocator, MaxNLocator
from mpl_toolkits.mplot3d import Axes3D

LIGHT = np.array([0.35, -0.45, 0.82]) / np.linalg.norm([0.35, -0.45, 0.82])
"""Direction from which bodies are lit."""

PLAIN: Any = {
    **{f"axes3d.{axis}axis.panecolor": (1.0, 1.0, 1.0, 0.0) for axis in "xyz"},
    "grid.color": "0.9",
    "grid.linewidth": 0.6,
}
"""No walls behind the axes and a faint grid."""

ROOM_FOR_LABELS: Any = {"zoom": 0.9}

MOST_TICKS = 7
"""Ticks along the longest side of a frame; the others get their share, so that their labels keep apart."""


@dataclass(frozen=True)
class View:
    """From where something is looked at.

    Attributes
    ----------
    azimuth, elevation : [degrees] of the viewer, round z from x and above the plane of both.
    """

    azimuth: float
    elevation: float

    @property
    def towards_viewer(self) -> Float64[np.ndarray, "3"]:
        """(3,) unit vector."""
        around, above = np.radians(self.azimuth), np.radians(self.elevation)
        return np.array([np.cos(above) * np.cos(around), np.cos(above) * np.sin(around), np.sin(above)])

    @property
    def lamp(self) -> Float64[np.ndarray, "3"]:
        """(3,) unit vector towards a lamp over the viewer's left shoulder."""
        lamp = self.towards_viewer - 0.35 * self.plane[:, 0] + [0.0, 0.0, 0.5]
        return lamp / np.linalg.norm(lamp)

    @property
    def plane(self) -> Float64[np.ndarray, "3 2"]:
        """(3, 2) unit vectors to the viewer's right and up, which bring points (P, 3) into the picture."""
        right = np.cross([0.0, 0.0, 1.0], self.towards_viewer)
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(self.towards_viewer, right)], axis=1)

    @property
    def opposite(self) -> "View":
        """The view from the other side."""
        return View(self.azimuth + 180.0, -self.elevation)


def broad_view(points: Real[np.ndarray, "points 3"]) -> View:
    """Look at the broad side of points, at a small angle."""
    thinnest = int(np.ptp(points, axis=0).argmin())
    return (View(-32.0, 24.0), View(-58.0, 24.0), View(-58.0, 48.0))[thinnest]


def space_axes(figure: Figure, view: View) -> Axes3D:
    """Add axes to a figure that it fills."""
    return _plain_axes(figure, view, (1, 1, 1))


def wide_figure(height: float) -> Figure:
    """Begin a figure of a height [inches] for ``two_sides``, with room at its sides for labels in space."""
    return Figure(figsize=(13.0, height), layout=ConstrainedLayoutEngine(w_pad=0.35, h_pad=0.12))


def two_sides(figure: Figure, view: View) -> list[tuple[View, Axes3D]]:
    """Add two axes side by side without perspective: seen from somewhere, and from the other side."""
    sides = [(side, _plain_axes(figure, side, (1, 2, 1 + column))) for column, side in enumerate((view, view.opposite))]
    for _, axes in sides:
        axes.set_proj_type("ortho")
    return sides


def _plain_axes(figure: Figure, view: View, position: tuple[int, int, int]) -> Axes3D:
    with rc_context(PLAIN):
        axes = figure.add_subplot(*position, projection="3d", computed_zorder=False)
    assert isinstance(axes, Axes3D)
    axes.view_init(elev=view.elevation, azim=view.azimuth)
    axes.patch.set_visible(False)  # or it would cover the labels of the axes beside it
    return axes


def frame(axes: Axes3D, parts: Sequence[Real[np.ndarray, "_ 3"]]) -> None:
    """Fit the axes round all parts [mm], equal lengths equally long."""
    everything = np.concatenate(parts)
    lowest, highest = everything.min(axis=0), everything.max(axis=0)
    sides = highest - lowest
    room = np.where(sides < 1e-3 * sides.max(), 1e-3 * sides.max(), 0.0)
    lowest, highest, sides = lowest - room, highest + room, sides + 2 * room
    axes.set(xlim=(lowest[0], highest[0]), ylim=(lowest[1], highest[1]), zlim=(lowest[2], highest[2]))
    axes.set_box_aspect(tuple(sides), **ROOM_FOR_LABELS)
    axes.set(xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]")
    for axis, side, middle in zip((axes.xaxis, axes.yaxis, axes.zaxis), sides, (lowest + highest) / 2.0, strict=True):
        count = round(MOST_TICKS * float(side / sides.max()))
        axis.set_major_locator(MaxNLocator(count) if count > 1 else FixedLocator([round(float(middle), 1) + 0.0]))
    axes.tick_params(labelsize=8)
