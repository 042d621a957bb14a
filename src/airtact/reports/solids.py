"""Shaded bodies and planes in 3-D axes, in millimetres."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Real
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, MaxNLocator
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from airtact.acoustics.scene import Plane
from airtact.geometry.mesh.triangles import area_vectors, unit

# Direction toward the viewer: azimuth around z, elevation above the xy plane [degrees]
View = tuple[float, float]

# Axes without walls behind them, with a faint grid
PLAIN: Any = {
    **{f"axes3d.{axis}axis.panecolor": (1.0, 1.0, 1.0, 0.0) for axis in "xyz"},
    "grid.color": "0.9",
    "grid.linewidth": 0.6,
}

# Colour of a plane, translucent
SHEET = (0.45, 0.36, 0.25, 0.22)

# Style of the dots that mark foci
FOCI: Any = {
    "c": "#e8590c",
    "edgecolors": "white",
    "linewidths": 0.8,
    "depthshade": False,
    "zorder": 4,
}


def towards_viewer(azimuth: float, elevation: float) -> Float64[np.ndarray, "3"]:
    """Return the unit vector toward a viewer at an azimuth and elevation [degrees]."""
    around = np.radians(azimuth)
    above = np.radians(elevation)
    return np.array([np.cos(above) * np.cos(around), np.cos(above) * np.sin(around), np.sin(above)])


def broad_view(points: Real[np.ndarray, "points 3"]) -> View:
    """Return a slightly oblique view of the broadest side of a set of points."""
    thinnest = int(np.ptp(points, axis=0).argmin())
    return ((-32.0, 24.0), (-58.0, 24.0), (-58.0, 48.0))[thinnest]


def space_axes(figure: Figure, view: View, position: tuple[int, int, int] = (1, 1, 1)) -> Axes3D:
    """Add 3-D axes with a given view and subplot position to a figure."""
    with rc_context(PLAIN):
        axes = figure.add_subplot(*position, projection="3d", computed_zorder=False)
    assert isinstance(axes, Axes3D)
    axes.view_init(azim=view[0], elev=view[1])
    # The background patch would hide the labels of neighbouring axes.
    axes.patch.set_visible(False)
    return axes


def frame(axes: Axes3D, points: Real[np.ndarray, "points 3"]) -> None:
    """Fit the axes to points [mm], with the same scale along x, y and z."""
    middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
    lengths = np.ptp(points, axis=0)
    # matplotlib requires a box with some thickness, even if all points lie in a plane.
    lengths = np.maximum(lengths, 2e-3 * lengths.max())
    lowest = middle - lengths / 2.0
    highest = middle + lengths / 2.0
    axes.set(
        xlim=(lowest[0], highest[0]), ylim=(lowest[1], highest[1]), zlim=(lowest[2], highest[2])
    )
    # Zooming out leaves room for the labels.
    axes.set_box_aspect(tuple(lengths), zoom=0.9)  # pyright: ignore
    axes.set(xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]")
    for index, axis in enumerate((axes.xaxis, axes.yaxis, axes.zaxis)):
        # At most 7 ticks along the longest side, and fewer along the others, keep labels apart.
        count = round(7 * float(lengths[index] / lengths.max()))
        single = FixedLocator([round(float(middle[index]), 1) + 0.0])
        axis.set_major_locator(MaxNLocator(count) if count > 1 else single)
    axes.tick_params(labelsize=8)


def add_solid(
    axes: Axes3D,
    polygons: Float64[np.ndarray, "polygons corners 3"],
    colours: Float64[np.ndarray, "polygons 4"],
    *,
    outlined: bool = False,
    marked: Bool[np.ndarray, "polygons corners"] | None = None,
    mark: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0),
) -> None:
    """Draw the shaded polygons of a surface [mm]: triangles, or hexagons for curved triangles.

    Parameters
    ----------
    outlined : whether edges are drawn dark.
    marked : whether each edge, from a corner to the next, is drawn in the colour ``mark``.
    """
    viewer = towards_viewer(axes.azim, axes.elev)
    normals = unit(area_vectors(polygons[:, :: polygons.shape[1] // 3]))
    # The surfaces are closed, so omit faces that point away from the viewer.
    shown = normals @ viewer > 0.0
    # Light from above and from the viewer's left reveals the shape of a smooth surface.
    lamp = unit(viewer - 0.35 * unit(np.cross([0.0, 0.0, 1.0], viewer)) + [0.0, 0.0, 0.5])
    faces = colours[shown]
    faces[:, :3] *= 0.65 + 0.35 * np.clip(normals[shown] @ lamp, 0.0, 1.0)[:, None]
    # Drawing edges in the colour of the faces hides the seams between them.
    edges = np.tile((0.2, 0.2, 0.2, 0.7), (len(faces), 1)) if outlined else faces
    parts = [*polygons[shown]]
    if marked is not None:
        # Lines are drawn as polygons with two corners, so that matplotlib sorts them with the
        # faces. Move them toward the viewer, because the faces would hide them.
        chosen = marked & shown[:, None]
        starts = polygons[chosen]
        ends = np.roll(polygons, -1, axis=1)[chosen]
        ahead = 0.5 * np.linalg.norm(ends - starts, axis=1)[:, None, None] * viewer
        parts += [*(np.stack([starts, ends], axis=1) + ahead)]
        lines = np.tile(mark, (len(starts), 1))
        faces = np.concatenate([faces, lines])
        edges = np.concatenate([edges, lines])
    # matplotlib sorts the colours with the polygons but not the widths, so use a single width.
    width = float(np.clip(25.0 / np.sqrt(len(parts) + 1), 0.35, 1.2))
    axes.add_collection3d(
        Poly3DCollection(parts, facecolors=faces, edgecolors=edges, linewidths=width, zorder=3),
        autolim=False,
    )


def sheet_of(plane: Plane, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "4 3"]:
    """Return the corners (4, 3) of the part of a plane below or behind points (P, 3) [m]."""
    first = np.eye(3)[np.abs(plane.normal).argmin()]
    first = unit(first - (first @ plane.normal) * plane.normal)
    axes = np.stack([first, np.cross(plane.normal, first)])
    along = points @ axes.T
    # This part extends beyond the points by 15 % of their extent.
    margin = 0.15 * float(np.ptp(along))
    left, down = along.min(axis=0) - margin
    right, up = along.max(axis=0) + margin
    corners = np.array([[left, down], [right, down], [right, up], [left, up]])
    return corners @ axes + (plane.point @ plane.normal) * plane.normal


def draw_sheets(
    axes: Axes3D, planes: Sequence[Plane], points: Real[np.ndarray, "points 3"]
) -> Float64[np.ndarray, "corners 3"]:
    """Draw planes below or behind points (P, 3) [m]; return the planes' corners (C, 3) [mm]."""
    corners = [1e3 * sheet_of(plane, points) for plane in planes]
    if corners:
        sheets = Poly3DCollection(
            corners, facecolors=SHEET, edgecolors=SHEET[:3], linewidths=0.6, zorder=0
        )
        axes.add_collection3d(sheets, autolim=False)
    return np.concatenate([np.empty((0, 3)), *corners])
