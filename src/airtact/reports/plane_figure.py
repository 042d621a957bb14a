"""Rigid planes in pictures: a sheet in space, and the part of a window that is behind them."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64, Real
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from airtact.acoustics.planes import Plane
from airtact.evaluation.windows import Window

SHEET = (0.45, 0.36, 0.25, 0.22)
"""Colour of a plane in space: what is behind it shows through."""

BEYOND = 0.15
"""How far a sheet reaches beyond what stands before it, over its extent."""


def sheet_of(plane: Plane, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "4 3"]:
    """Corners (4, 3) of the part of a plane that is below or before some points (P, 3) [m]."""
    first = np.eye(3)[np.abs(plane.normal).argmin()]
    first = first - (first @ plane.normal) * plane.normal
    first /= np.linalg.norm(first)
    sides = np.stack([first, np.cross(plane.normal, first)])
    along = points @ sides.T
    low, high = along.min(axis=0), along.max(axis=0)
    low, high = low - BEYOND * np.ptp([low, high]), high + BEYOND * np.ptp([low, high])
    corners = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
    return corners @ sides + (plane.point @ plane.normal) * plane.normal


def draw_sheets(
    axes: Axes3D, planes: Sequence[Plane], points: Real[np.ndarray, "points 3"]
) -> Float64[np.ndarray, "corners 3"]:
    """Draw the planes below or before points (P, 3) [m] into axes in space; returns their corners (C, 3) [mm]."""
    corners = [1e3 * sheet_of(plane, points) for plane in planes]
    if corners:
        sheets = Poly3DCollection(
            corners, facecolors=SHEET, edgecolors=SHEET[:3], linewidths=0.6, zorder=0
        )
        axes.add_collection3d(sheets, autolim=False)
    return np.concatenate([np.empty((0, 3)), *corners])


def behind_planes(window: Window, planes: Sequence[Plane]) -> list[Float64[np.ndarray, "_ 3"]]:
    """Outlines of what a window shows behind planes [m], as of bodies: none where it shows nothing behind them."""
    loops = []
    half = 0.5 * np.array([[-window.width, -window.height], [window.width, -window.height]])
    rectangle = np.concatenate([half, -half])
    corners = window.centre + rectangle @ np.stack([window.right, window.up])
    for plane in planes:
        heights, loop = plane.height(corners), []
        for index, (height, corner) in enumerate(zip(heights, corners, strict=True)):
            before, place = heights[index - 1], corners[index - 1]
            if (before < 0.0) != (height < 0.0):
                loop.append(place + before / (before - height) * (corner - place))
            if height < 0.0:
                loop.append(corner)
        if loop:
            loops.append(np.array(loop))
    return loops
