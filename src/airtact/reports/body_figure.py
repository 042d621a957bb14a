"""Pictures of bodies, panels, point clouds and mesh faults, from two sides."""

import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64, Real
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from mpl_toolkits.mplot3d import Axes3D

from airtact.acoustics.planes import Plane
from airtact.geometry.mesh.arrays import QuadraticTriangles
from airtact.geometry.mesh.quadratic_triangles import area_vectors, smallest_angles
from airtact.geometry.mesh.topology import edge_twins
from airtact.geometry.mesh_shape import MeshShape
from airtact.geometry.surface import Surface
from airtact.hands.fitting.fit import FittedHand
from airtact.reports.solids import (
    FOCI,
    INSIDE,
    SHEET,
    View,
    add_solid,
    broad_view,
    draw_sheets,
    frame,
    space_axes,
)

MAX_TRIANGLES_WITH_EDGES = 8000
"""Largest number of triangles with edges drawn; a finer mesh would be black."""

SHARP = (0.75, 0.11, 0.11, 1.0)

OUTSIDE = (0.74, 0.80, 0.86, 1.0)
"""Colour of the outside of an invalid surface."""

OPEN = (0.80, 0.07, 0.07, 1.0)
MARK = "#7b1fa2"

RING: dict[str, Any] = {
    "marker": "o",
    "linestyle": "none",
    "markersize": 14,
    "markerfacecolor": "none",
    "markeredgewidth": 2,
    "color": MARK,
}
"""Style of the ring around the position of a fault."""


def _two_views(height: float, views: tuple[View, View]) -> tuple[Figure, list[Axes3D]]:
    """Make a figure of a height [inches] with two orthographic views side by side."""
    # The padding leaves room for 3-D labels.
    figure = Figure(figsize=(13.0, height), layout=ConstrainedLayoutEngine(w_pad=0.35, h_pad=0.12))
    panels = [space_axes(figure, view, (1, 2, 1 + side)) for side, view in enumerate(views)]
    for axes in panels:
        axes.set_proj_type("ortho")
    return figure, panels


def _two_sides(points: Float64[np.ndarray, "points 3"]) -> tuple[View, View]:
    azimuth, elevation = broad_view(points)
    return (azimuth, elevation), (azimuth + 180.0, -elevation)


def draw_bodies(
    bodies: Sequence[Surface],
    names: Sequence[str],
    foci: Real[np.ndarray, "foci 3"] | None = None,
    planes: Sequence[Plane] = (),
) -> Figure:
    """Draw bodies with their triangles, foci as dots, and planes as sheets [m]."""
    corners = 1e3 * np.concatenate([body.corners for body in bodies])
    # Pale colours leave room for shading.
    tints = colormaps["Pastel2"](np.arange(len(bodies)) % 8)
    colours = np.repeat(tints, [len(body.triangles) for body in bodies], axis=0)
    dots = np.empty((0, 3)) if foci is None else 1e3 * foci
    everything = np.concatenate([corners.reshape(-1, 3), dots])
    sharp = np.concatenate([sharp_edges(body) for body in bodies])
    figure, panels = _two_views(6.0, _two_sides(everything))
    for axes in panels:
        outlined = len(corners) <= MAX_TRIANGLES_WITH_EDGES
        add_solid(axes, corners, colours, outlined=outlined, marked=sharp, mark=SHARP)
        axes.scatter(*dots.T, s=30, **FOCI)  # pyright: ignore
        frame(axes, np.concatenate([everything, draw_sheets(axes, planes, 1e-3 * everything)]))
    handles: list[Patch | Line2D] = [
        Patch(color=tint, label=name) for tint, name in zip(tints, names, strict=True)
    ]
    if sharp.any():
        handles.append(Line2D([], [], color=SHARP, label="edges that stay sharp"))
    if len(dots):
        label = "foci, seen through bodies"
        handles.append(Line2D([], [], color=FOCI["c"], marker="o", linestyle="none", label=label))
    if planes:
        handles.append(Patch(color=SHEET, label="rigid plane"))
    figure.legend(handles=handles, loc="outside lower center", ncols=6, frameon=False)
    return figure


def sharp_edges(body: Surface) -> Bool[np.ndarray, "triangles 3"]:
    """Whether edges 01, 12, 20 of each triangle stay sharp when the surface is curved."""
    if not isinstance(body.shape, MeshShape):
        return np.zeros((len(body.triangles), 3), dtype=bool)
    return body.shape.mesh.sharp


def draw_fault(
    vertices: Real[np.ndarray, "vertices 3"],
    triangles: Int64[np.ndarray, "triangles 3"],
    sentence: str,
    position: Real[np.ndarray, "3"] | None,
) -> Figure:
    """Draw the triangles of an invalid surface, and a close-up of the fault's position [m].

    Backs of triangles and edges without a neighbour are highlighted. Triangles with missing or
    infinite vertices are left out. ``sentence`` states the fault.
    """
    drawable = ((triangles >= 0) & (triangles < len(vertices))).all(axis=1)
    corners = 1e3 * np.asarray(vertices[triangles[drawable]], dtype=np.float64)
    corners = corners[np.isfinite(corners).all(axis=(1, 2))]
    # Neighbours share positions, but not always vertices.
    numbers = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)[1].reshape(-1, 3)
    lone = edge_twins(numbers) < 0
    shown = [np.arange(len(corners))] * 2
    views = _two_sides(corners.reshape(-1, 3))
    mark = np.empty((0, 3))
    if position is not None:
        from trimesh.triangles import closest_point

        mark = 1e3 * np.asarray(position, dtype=np.float64)[None]
        away = closest_point(corners, np.tile(mark, (len(corners), 1))) - mark
        nearest = np.argsort(np.linalg.norm(away, axis=1))
        # The close-up replaces the view of the other side.
        view = _view_of_fault(corners, nearest[:12], mark[0])
        views = (view, view)
        shown[1] = nearest[:120]
    figure, panels = _two_views(6.6, views)
    for axes, chosen in zip(panels, shown, strict=True):
        add_solid(
            axes,
            corners[chosen],
            np.tile(OUTSIDE, (len(chosen), 1)),
            outlined=len(chosen) <= MAX_TRIANGLES_WITH_EDGES,
            closed=False,
            marked=lone[chosen],
            mark=OPEN,
        )
        axes.plot(*mark.T, zorder=4, **RING)
        frame(axes, np.vstack([corners[chosen].reshape(-1, 3), mark]))
    words = sentence if len(mark) else f"{sentence} (The fault has no single position.)"
    if len(mark):
        panels[1].set_title("close up: the mark is at ({:.2f}, {:.2f}, {:.2f}) mm".format(*mark[0]))
    figure.suptitle(textwrap.fill(words, 130), fontsize=11)
    handles: list[Patch | Line2D] = [
        Patch(color=OUTSIDE, label="outside of triangles"),
        Patch(color=INSIDE, label="inside"),
    ]
    if lone.any():
        handles.append(Line2D([], [], color=OPEN, linewidth=2.2, label="edge without a neighbour"))
    if len(mark):
        handles.append(Line2D([], [], label="position of the fault", **RING))
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False)
    return figure


def _view_of_fault(
    corners: Float64[np.ndarray, "triangles 3 3"],
    nearest: Int64[np.ndarray, "nearest"],
    mark: Float64[np.ndarray, "3"],
) -> View:
    """View along the normal of the triangles nearest a fault, from outside."""
    outward = mark - corners.mean(axis=(0, 1))
    normal = area_vectors(corners[nearest]).sum(axis=0)
    # Inverted triangles face inwards. Triangles around a thin part have no common normal.
    if abs(normal @ outward) > 0.1 * np.linalg.norm(normal) * np.linalg.norm(outward):
        outward = normal * np.sign(normal @ outward)
    azimuth = np.degrees(np.arctan2(outward[1], outward[0]))
    elevation = np.degrees(np.arctan2(outward[2], np.hypot(outward[0], outward[1])))
    # A view 18° off the normal shows heights.
    return float(azimuth) + 18.0, float(np.clip(elevation + 18.0, -80.0, 80.0))


def draw_panels(quadratic_triangles: QuadraticTriangles) -> Figure:
    """Draw curved panels with their edges, coloured by their smallest angle."""
    # An equilateral panel has 60°.
    scale = ScalarMappable(Normalize(0.0, 60.0), "viridis")
    hexagons = _hexagons(quadratic_triangles)
    figure, panels = _two_views(6.4, _two_sides(hexagons.reshape(-1, 3)))
    for axes in panels:
        colours = scale.to_rgba(smallest_angles(quadratic_triangles))
        add_solid(axes, hexagons, colours, outlined=True)
        frame(axes, hexagons.reshape(-1, 3))
    label = "smallest angle of the panel [degrees]"
    figure.colorbar(scale, ax=panels, label=label, shrink=0.6, aspect=28)
    return figure


def _hexagons(
    quadratic_triangles: QuadraticTriangles,
) -> Float64[np.ndarray, "panels 6 3"]:
    """Corners and edge midpoints of panels, in order around each panel [mm]."""
    return 1e3 * quadratic_triangles[:, [0, 3, 1, 4, 2, 5]]


def draw_cloud(
    quadratic_triangles: QuadraticTriangles,
    fitted: FittedHand,
    distances: Float64[np.ndarray, "points"],
) -> Figure:
    """Draw points on the skin fitted to them: blue outside, red inside, outliers as crosses.

    ``distances`` of the points from the skin are positive outside [m].
    """
    points = 1e3 * fitted.points
    used = ~fitted.outliers
    scale = ScalarMappable(Normalize(-5.0, 5.0), "RdBu")
    residuals = scale.to_rgba(1e3 * distances[used])
    purple = "#9775fa"
    hexagons = _hexagons(quadratic_triangles)
    figure, panels = _two_views(6.4, _two_sides(hexagons.reshape(-1, 3)))
    for axes in panels:
        add_solid(axes, hexagons, np.tile((0.82, 0.82, 0.80, 1.0), (len(hexagons), 1)))
        axes.scatter(*points[used].T, s=5, c=residuals, depthshade=False, zorder=4)  # pyright: ignore
        axes.scatter(*points[~used].T, s=8, c=purple, marker="x", linewidths=0.6, zorder=4)  # pyright: ignore
        frame(axes, hexagons.reshape(-1, 3))
    label = "distance of points from the skin, outwards [mm]"
    figure.colorbar(scale, ax=panels, label=label, shrink=0.6, aspect=28, extend="both")
    outlier = Line2D([], [], color=purple, marker="x", linestyle="none")
    words = "outliers, which the fit ignores; the skin hides no points"
    figure.legend([outlier], [words], loc="outside lower center", frameon=False)
    return figure
