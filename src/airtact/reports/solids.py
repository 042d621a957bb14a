"""Shaded triangles with lines on them, in upright axes in space [mm], from a chosen side."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64, Real
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import FixedLocator, MaxNLocator
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from airtact.acoustics.planes import Plane
from airtact.evaluation.windows import Window
from airtact.geometry.mesh.quadratic_triangles import area_vectors, cut, unit, with_middles

PLAIN: Any = {
    **{f"axes3d.{axis}axis.panecolor": (1.0, 1.0, 1.0, 0.0) for axis in "xyz"},
    "grid.color": "0.9",
    "grid.linewidth": 0.6,
}
"""No walls behind the axes and a faint grid."""

MAX_PARTS = 40
"""Number of parts into which an edge is cut."""

INSIDE = np.array([0.91, 0.45, 0.16, 1.0])
"""Colour of the backs of triangles, which show where a surface is open or turned."""


@dataclass(frozen=True)
class View:
    """Direction of the viewer: azimuth around z, elevation above the xy plane [degrees]."""

    azimuth: float
    elevation: float

    @property
    def towards_viewer(self) -> Float64[np.ndarray, "3"]:
        """Unit vector to the viewer."""
        around = np.radians(self.azimuth)
        above = np.radians(self.elevation)
        level = np.cos(above)
        return np.array([level * np.cos(around), level * np.sin(around), np.sin(above)])

    @property
    def plane(self) -> Float64[np.ndarray, "3 2"]:
        """Unit vectors to the viewer's right and up."""
        right = np.cross([0.0, 0.0, 1.0], self.towards_viewer)
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(self.towards_viewer, right)], axis=1)


def broad_view(points: Real[np.ndarray, "points 3"]) -> View:
    """View of the broad side of points, at a small angle."""
    thinnest = int(np.ptp(points, axis=0).argmin())
    return (View(-32.0, 24.0), View(-58.0, 24.0), View(-58.0, 48.0))[thinnest]


def wide_figure(height: float) -> Figure:
    """Figure of a height [inches] for ``two_sides``, with room at its sides for labels in space."""
    return Figure(figsize=(13.0, height), layout=ConstrainedLayoutEngine(w_pad=0.35, h_pad=0.12))


def two_sides(figure: Figure, view: View) -> list[tuple[View, Axes3D]]:
    """Add two axes side by side without perspective: one for a view, one for the opposite view."""
    views = (view, View(view.azimuth + 180.0, -view.elevation))
    pairs = [(seen, space_axes(figure, seen, (1, 2, 1 + side))) for side, seen in enumerate(views)]
    for _, axes in pairs:
        axes.set_proj_type("ortho")
    return pairs


def space_axes(figure: Figure, view: View, position: tuple[int, int, int] = (1, 1, 1)) -> Axes3D:
    """Add axes in space to a figure."""
    with rc_context(PLAIN):
        axes = figure.add_subplot(*position, projection="3d", computed_zorder=False)
    assert isinstance(axes, Axes3D)
    axes.view_init(elev=view.elevation, azim=view.azimuth)
    # The patch would cover the labels of the axes beside it.
    axes.patch.set_visible(False)
    return axes


def frame(axes: Axes3D, points: Real[np.ndarray, "points 3"]) -> None:
    """Fit the axes around points [mm], with equal scales."""
    lowest = points.min(axis=0)
    highest = points.max(axis=0)
    lengths = highest - lowest
    # Flat points get a thin box, which matplotlib needs.
    room = np.where(lengths < 1e-3 * lengths.max(), 1e-3 * lengths.max(), 0.0)
    lowest = lowest - room
    highest = highest + room
    lengths = lengths + 2 * room
    axes.set(
        xlim=(lowest[0], highest[0]), ylim=(lowest[1], highest[1]), zlim=(lowest[2], highest[2])
    )
    # The zoom leaves room for the labels.
    axes.set_box_aspect(tuple(lengths), zoom=0.9)  # pyright: ignore
    axes.set(xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]")
    middles = (lowest + highest) / 2.0
    for axis, length, middle in zip(
        (axes.xaxis, axes.yaxis, axes.zaxis), lengths, middles, strict=True
    ):
        # 7 ticks along the longest side; the others get their share, which keeps labels apart.
        count = round(7 * float(length / lengths.max()))
        axis.set_major_locator(
            MaxNLocator(count) if count > 1 else FixedLocator([round(float(middle), 1) + 0.0])
        )
    axes.tick_params(labelsize=8)


@dataclass(frozen=True, eq=False)
class Lines:
    """Straight lines on a surface, from end to end [mm], of a width [mm]; 0 is the thinnest.

    ``outward`` are the directions in which the surface faces; lines on its far side are hidden.
    Lines are drawn ``ahead`` of the surface, towards the viewer [mm], or it would cover them.
    """

    segments: Float64[np.ndarray, "lines 2 3"]
    outward: Float64[np.ndarray, "lines 3"]
    ahead: Float64[np.ndarray, "lines"]
    colour: tuple[float, float, float, float] = (0.13, 0.13, 0.13, 1.0)
    breadth: float = 0.0

    def seen(self, view: View) -> Float64[np.ndarray, "seen 4 3"]:
        """Narrow rectangles of the lines on the near side."""
        facing = self.outward @ view.towards_viewer > 0
        segments = self.segments[facing] + self.ahead[facing, None, None] * view.towards_viewer
        start, end = segments.transpose(1, 0, 2)
        across = 0.5 * self.breadth * unit(np.cross(end - start, view.towards_viewer))
        return np.stack([start - across, end - across, end + across, start + across], axis=1)


def polygons_of(
    corners: Float64[np.ndarray, "triangles 3 3"],
    colours: Float64[np.ndarray, "triangles 4"],
    lines: Sequence[Lines],
    view: View,
    closed: bool = True,
) -> tuple[list[Float64[np.ndarray, "_ 3"]], Float64[np.ndarray, "polygons 4"]]:
    """Polygons [mm] of triangles and the lines on them, and their colours.

    A lamp over the viewer's left shoulder shades them. Triangles that face away from the viewer are
    left out if the surface is closed, else they have the colour ``INSIDE``.
    """
    normals = unit(area_vectors(corners))
    facing = normals @ view.towards_viewer
    if closed:
        near = facing > 0
        corners = corners[near]
        colours = colours[near]
        normals = normals[near]
        facing = facing[near]
    # A light from the side shows the shape of a smooth surface.
    lamp = unit(view.towards_viewer - 0.35 * view.plane[:, 0] + [0.0, 0.0, 0.5])
    shaded = np.where(facing[:, None] < 0, INSIDE, colours)
    towards_lamp = np.where(facing < 0, -1.0, 1.0) * (normals @ lamp)
    shaded[:, :3] *= 0.65 + 0.35 * np.clip(towards_lamp, 0, 1)[:, None]
    narrow = [line.seen(view) for line in lines]
    strokes = [
        np.tile(line.colour, (len(part), 1)) for line, part in zip(lines, narrow, strict=True)
    ]
    middles = corners.mean(axis=1, keepdims=True)
    # Triangles are drawn 3 % larger, or the background would shimmer through between them.
    polygons = [
        *(middles + 1.03 * (corners - middles)),
        *np.concatenate([np.empty((0, 4, 3)), *narrow]),
    ]
    return polygons, np.concatenate([shaded, *strokes])


def solid(
    corners: Float64[np.ndarray, "triangles 3 3"],
    colours: Float64[np.ndarray, "triangles 4"],
    lines: Sequence[Lines],
    view: View,
    closed: bool = True,
) -> Poly3DCollection:
    """Triangles and lines in one collection, which matplotlib draws from back to front."""
    polygons, painted = polygons_of(corners, colours, lines, view, closed)
    # The edges hide the seams between polygons. All have one width, because matplotlib sorts the
    # colours with the polygons, but not the widths.
    width = float(np.clip(40.0 / np.sqrt(len(polygons) + 1), 0.35, 0.8))
    return Poly3DCollection(polygons, facecolors=painted, edgecolors=painted, linewidths=width)


def fine_pieces(
    corners: Float64[np.ndarray, "triangles 3 3"], step: float
) -> tuple[Float64[np.ndarray, "pieces 3 3"], Int64[np.ndarray, "pieces"]]:
    """Cut triangles into pieces small enough to sort from back to front.

    ``step`` is the longest edge of a piece [mm]. The triangle of each piece is returned with it.
    """
    longest = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).max(axis=1)
    parts = np.ceil(np.clip(longest / step, 1, MAX_PARTS)).astype(np.int64)
    pieces, parents = cut(with_middles(corners), parts)
    return pieces[:, :3], parents


def edge_lines(
    corners: Float64[np.ndarray, "triangles 3 3"],
    chosen: Bool[np.ndarray, "triangles 3"],
    step: float,
) -> Lines:
    """Lines, no longer than ``step``, along the chosen edges 01, 12, 20 of triangles."""
    starts = corners[chosen]
    ends = np.roll(corners, -1, axis=1)[chosen]
    normals = np.repeat(unit(area_vectors(corners))[:, None], 3, axis=1)[chosen]
    length = np.linalg.norm(ends - starts, axis=1)
    parts = np.ceil(np.clip(length / step, 1, MAX_PARTS)).astype(np.int64)
    # The edge of each part, and its position along the edge.
    owner = np.repeat(np.arange(len(starts)), parts)
    share = (np.arange(len(owner)) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[owner]
    along = (ends - starts)[owner]
    first = starts[owner] + share[:, None] * along
    segments = np.stack([first, first + along / parts[owner, None]], axis=1)
    return Lines(segments, normals[owner], 0.5 * np.minimum(length / parts, step)[owner])


SHEET = (0.45, 0.36, 0.25, 0.22)
"""Colour of a plane in space, through which bodies behind it show."""


def sheet_of(plane: Plane, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "4 3"]:
    """Corners (4, 3) of the part of a plane below or behind points (P, 3) [m]."""
    first = np.eye(3)[np.abs(plane.normal).argmin()]
    first = first - (first @ plane.normal) * plane.normal
    first /= np.linalg.norm(first)
    axes = np.stack([first, np.cross(plane.normal, first)])
    along = points @ axes.T
    low = along.min(axis=0)
    high = along.max(axis=0)
    # Beyond the points by 15 % of their extent.
    margin = 0.15 * np.ptp([low, high])
    low = low - margin
    high = high + margin
    corners = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
    return corners @ axes + (plane.point @ plane.normal) * plane.normal


def draw_sheets(
    axes: Axes3D, planes: Sequence[Plane], points: Real[np.ndarray, "points 3"]
) -> Float64[np.ndarray, "corners 3"]:
    """Draw the planes below or behind points (P, 3) [m]; return their corners (C, 3) [mm]."""
    corners = [1e3 * sheet_of(plane, points) for plane in planes]
    if corners:
        sheets = Poly3DCollection(
            corners, facecolors=SHEET, edgecolors=SHEET[:3], linewidths=0.6, zorder=0
        )
        axes.add_collection3d(sheets, autolim=False)
    return np.concatenate([np.empty((0, 3)), *corners])


def behind_planes(window: Window, planes: Sequence[Plane]) -> list[Float64[np.ndarray, "_ 3"]]:
    """Return closed lines around the parts of a window that are behind planes [m]."""
    loops = []
    half = 0.5 * np.array([[-window.width, -window.height], [window.width, -window.height]])
    rectangle = np.concatenate([half, -half])
    corners = window.centre + rectangle @ np.stack([window.right, window.up])
    for plane in planes:
        heights = plane.height(corners)
        loop = []
        for index, (height, corner) in enumerate(zip(heights, corners, strict=True)):
            # The side from the previous corner crosses the plane where the height changes sign.
            before = heights[index - 1]
            if (before < 0.0) != (height < 0.0):
                side = corner - corners[index - 1]
                loop.append(corners[index - 1] + before / (before - height) * side)
            if height < 0.0:
                loop.append(corner)
        if loop:
            loops.append(np.array(loop))
    return loops
