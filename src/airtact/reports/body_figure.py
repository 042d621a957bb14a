"""Bodies, panels and clouds seen from two sides; the fault of a rejected mesh, close up."""

import textwrap
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64, Real
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch
from mpl_toolkits.mplot3d import Axes3D

from airtact.acoustics.planes import Plane
from airtact.geometry.mesh.arrays import QuadraticTriangles
from airtact.geometry.mesh.mesh_distance import closest_on_triangles
from airtact.geometry.mesh.quadratic_triangles import (
    area_vectors,
    cut,
    longest_edges,
    points_at,
    shape_functions,
    smallest_angles,
    unit,
)
from airtact.geometry.mesh.topology import edge_twins
from airtact.geometry.mesh_shape import MeshShape
from airtact.geometry.surface import Surface
from airtact.hands.fitting.fit import FittedHand
from airtact.reports.solids import (
    INSIDE,
    SHEET,
    Lines,
    View,
    broad_view,
    draw_sheets,
    edge_lines,
    fine_pieces,
    frame,
    polygons_of,
    solid,
    two_sides,
    wide_figure,
)

MAX_TRIANGLES_WITH_EDGES = 8000
"""Number of triangles up to which edges are drawn; those of more would be black."""

FINENESS = 1.0 / 40.0
"""Longest edge of a piece of a triangle over the extent of everything."""

SHARP = (0.75, 0.11, 0.11, 1.0)
FOCUS = "#e8590c"

OUTSIDE = np.array([0.74, 0.80, 0.86, 1.0])
"""Colour of the outside of triangles that are at fault."""

OPEN = (0.80, 0.07, 0.07, 1.0)
MARK = "#7b1fa2"


def draw_bodies(
    bodies: Sequence[Surface],
    names: Sequence[str],
    foci: Real[np.ndarray, "foci 3"] | None = None,
    planes: Sequence[Plane] = (),
) -> Figure:
    """Draw bodies with their triangles, foci as dots, and planes as sheets [m]."""
    figure = wide_figure(6.0)
    corners = 1e3 * np.concatenate([body.corners for body in bodies])
    # Pale colours leave room for shading.
    tints = colormaps["Pastel2"](np.arange(len(bodies)) % 8)
    colours = np.repeat(tints, [len(body.triangles) for body in bodies], axis=0)
    dots = np.empty((0, 3)) if foci is None else 1e3 * foci
    everything = np.concatenate([corners.reshape(-1, 3), dots])
    step = FINENESS * float(np.ptp(everything, axis=0).max())
    sharp = np.concatenate([sharp_edges(body) for body in bodies])
    lines = [replace(edge_lines(corners, sharp, step), colour=SHARP, breadth=0.25 * step)]
    if len(corners) <= MAX_TRIANGLES_WITH_EDGES:
        lines.append(edge_lines(corners, ~sharp, step))
    pieces, parents = fine_pieces(corners, step)
    for view, axes in two_sides(figure, broad_view(everything)):
        axes.add_collection3d(solid(pieces, colours[parents], lines, view), autolim=False)
        style: dict[str, Any] = {
            "edgecolors": "white",
            "linewidths": 0.8,
            "depthshade": False,
            "zorder": 4,
        }
        axes.scatter(*dots.T, s=30, c=FOCUS, **style)  # pyright: ignore
        frame(axes, np.concatenate([everything, draw_sheets(axes, planes, 1e-3 * everything)]))
    handles: list[Patch | Line2D] = [
        Patch(color=tint, label=name) for tint, name in zip(tints, names, strict=True)
    ]
    if sharp.any():
        handles.append(Line2D([], [], color=SHARP, label="edges that stay sharp"))
    if len(dots):
        label = "foci, seen through bodies"
        handles.append(Line2D([], [], color=FOCUS, marker="o", linestyle="none", label=label))
    if planes:
        handles.append(Patch(color=SHEET, label="rigid plane"))
    figure.legend(handles=handles, loc="outside lower center", ncols=6, frameon=False)
    return figure


def sharp_edges(body: Surface) -> Bool[np.ndarray, "triangles 3"]:
    """Edges 01, 12, 20 of triangles that stay sharp when a surface is curved."""
    if not isinstance(body.shape, MeshShape):
        return np.zeros((len(body.triangles), 3), dtype=bool)
    return body.shape.mesh.sharp


def draw_fault(
    vertices: Real[np.ndarray, "vertices 3"],
    triangles: Int64[np.ndarray, "triangles 3"],
    sentence: str,
    position: Real[np.ndarray, "3"] | None,
) -> Figure:
    """Draw triangles that make no valid surface, and a close-up of the fault's position [m].

    Backs of triangles and edges without a neighbour have special colours. Triangles with missing or
    infinite vertices are left out. The sentence is the reason for the rejection.
    """
    figure = wide_figure(6.6)
    corners, lone = _drawable(vertices, triangles)
    mark = None if position is None else 1e3 * np.asarray(position, dtype=np.float64)
    points = corners.reshape(-1, 3)
    view = broad_view(points) if mark is None else _facing(corners, mark)
    pairs = two_sides(figure, view)
    if mark is not None:
        # The close-up takes the place of the other side.
        pairs.pop()[1].remove()
        _close_up(figure.add_subplot(1, 2, 2), corners, lone, mark, view)
    step = FINENESS * float(np.ptp(points, axis=0).max())
    pieces, colours, lines = _sheet(corners, lone, step, 0.2 * step)
    for seen, axes in pairs:
        axes.add_collection3d(solid(pieces, colours, lines, seen, closed=False), autolim=False)
        if mark is not None:
            ring = {"markersize": 17, "markerfacecolor": "none", "markeredgewidth": 2, "zorder": 4}
            axes.plot(*mark[:, None], "o", color=MARK, **ring)
        frame(axes, points if mark is None else np.vstack([points, mark]))
    words = sentence if position is not None else f"{sentence} (The fault has no single position.)"
    figure.suptitle(textwrap.fill(words, 130), fontsize=11)
    handles: list[Patch | Line2D] = [
        Patch(color=tuple(OUTSIDE), label="outside of triangles"),
        Patch(color=tuple(INSIDE), label="inside"),
    ]
    if lone.any():
        handles.append(Line2D([], [], color=OPEN, linewidth=2.2, label="edge without a neighbour"))
    if mark is not None:
        ring = {"marker": "o", "linestyle": "none", "markersize": 12, "markerfacecolor": "none"}
        handles.append(Line2D([], [], color=MARK, label="position of the fault", **ring))
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False)
    return figure


def _drawable(
    vertices: Real[np.ndarray, "vertices 3"], triangles: Int64[np.ndarray, "triangles 3"]
) -> tuple[Float64[np.ndarray, "drawn 3 3"], Bool[np.ndarray, "drawn 3"]]:
    """Corners of the drawable triangles [mm], and which of their edges have no neighbour."""
    drawable = ((triangles >= 0) & (triangles < len(vertices))).all(axis=1)
    corners = np.asarray(vertices[triangles[drawable]], dtype=np.float64)
    corners = corners[np.isfinite(corners).all(axis=(1, 2))]
    # Neighbours share positions, if not vertices.
    numbers = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)[1].reshape(-1, 3)
    return 1e3 * corners, edge_twins(numbers) < 0


def _facing(corners: Float64[np.ndarray, "triangles 3 3"], mark: Float64[np.ndarray, "3"]) -> View:
    """View of a point from the side of the surface on which fewer triangles hide it."""
    nearest = np.argsort(_distances(corners, mark))[:12]
    normals = unit(area_vectors(corners[nearest]))
    outward = normals.sum(axis=0)
    if np.linalg.norm(outward) <= 0.5:
        outward = normals[0] + [0.0, 0.0, 1e-9]

    def view_along(direction: Float64[np.ndarray, "3"]) -> View:
        azimuth = np.degrees(np.arctan2(direction[1], direction[0]))
        elevation = np.degrees(np.arcsin(direction[2] / np.linalg.norm(direction)))
        # 18° aside, so that heights show.
        return View(float(azimuth) + 18.0, float(np.clip(elevation + 18.0, -80.0, 80.0)))

    def hiding(view: View) -> int:
        """Count the triangles between the mark and the viewer."""
        x, y = np.moveaxis((corners - mark) @ view.plane, 2, 0)
        areas = x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1)
        covering = (areas > 0).all(axis=1) | (areas < 0).all(axis=1)
        depth = (corners - mark).mean(axis=1) @ view.towards_viewer
        return int((covering & (depth > 1e-3 * np.abs(depth).max())).sum())

    return min((view_along(outward), view_along(-outward)), key=hiding)


def _distances(
    corners: Float64[np.ndarray, "triangles 3 3"], mark: Float64[np.ndarray, "3"]
) -> Float64[np.ndarray, "triangles"]:
    nearest = closest_on_triangles(np.tile(mark, (len(corners), 1)), corners)
    return np.linalg.norm(nearest - mark, axis=1)


def _close_up(
    axes: Axes,
    corners: Float64[np.ndarray, "triangles 3 3"],
    lone: Bool[np.ndarray, "triangles 3"],
    mark: Float64[np.ndarray, "3"],
    view: View,
) -> None:
    """Draw the nearest triangles without perspective."""
    distances = _distances(corners, mark)
    extent = float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    # The nearest 120 triangles, within limits.
    reach = float(np.clip(np.sort(distances)[:121][-1], 0.02 * extent, 0.6 * extent))
    near = distances < 1.5 * reach
    pieces, colours, lines = _sheet(
        corners[near] - mark, lone[near], FINENESS * 5 * reach, 0.015 * reach
    )
    polygons, painted = polygons_of(pieces, colours, lines, view, closed=False)
    order = np.argsort([polygon.mean(axis=0) @ view.towards_viewer for polygon in polygons])
    flat = [polygons[index] @ view.plane for index in order]
    painted = painted[order]
    axes.add_collection(
        PolyCollection(flat, facecolors=painted, edgecolors=painted, linewidths=0.5)
    )
    axes.add_patch(Circle((0.0, 0.0), 0.07 * reach, fill=False, color=MARK, linewidth=2, zorder=4))
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
    title = "close up: the mark is at ({:.2f}, {:.2f}, {:.2f}) mm".format(*mark)
    axes.set(xlabel="across [mm]", ylabel="up [mm]", title=title)


def _sheet(
    corners: Float64[np.ndarray, "triangles 3 3"],
    lone: Bool[np.ndarray, "triangles 3"],
    step: float,
    breadth: float,
) -> tuple[Float64[np.ndarray, "pieces 3 3"], Float64[np.ndarray, "pieces 4"], list[Lines]]:
    """Cut two-sided triangles into pieces, with their edges as lines on both sides."""
    lines = [replace(edge_lines(corners, lone, step), colour=OPEN, breadth=breadth)]
    if len(corners) <= MAX_TRIANGLES_WITH_EDGES:
        lines.append(edge_lines(corners, ~lone, step))
    # An open surface is seen from both sides.
    lines += [replace(line, outward=-line.outward) for line in lines]
    pieces, _ = fine_pieces(corners, step)
    return pieces, np.tile(OUTSIDE, (len(pieces), 1)), lines


def draw_panels(quadratic_triangles: QuadraticTriangles) -> Figure:
    """Draw curved panels with their edges, coloured by their smallest angle."""
    triangles = 1e3 * quadratic_triangles
    # Few panels are cut into about 4000 flat pieces, so that they look curved.
    parts = int(np.clip(np.sqrt(4000 / len(triangles)), 1, 6))
    pieces, parents = cut(triangles, np.full(len(triangles), parts))
    # An equilateral panel has 60°.
    scale = ScalarMappable(Normalize(0.0, 60.0), "viridis")
    colours = scale.to_rgba(smallest_angles(triangles))[parents]
    label = "smallest angle of the panel [degrees]"
    edges = [_edges(triangles, parts)]
    return _two_sides(pieces[:, :3], colours, triangles.reshape(-1, 3), scale, label, edges)[0]


def draw_cloud(
    quadratic_triangles: QuadraticTriangles,
    fitted: FittedHand,
    distances: Float64[np.ndarray, "points"],
) -> Figure:
    """Draw points over the skin fitted to them: blue outside, red inside, outliers as crosses.

    ``distances`` of the points from the skin are positive outside [m].
    """
    pieces, _ = cut(1e3 * quadratic_triangles, np.full(len(quadratic_triangles), 1))
    points = 1e3 * fitted.points
    used = ~fitted.outliers
    scale = ScalarMappable(Normalize(-5.0, 5.0), "RdBu")
    colours = np.tile((0.82, 0.82, 0.80, 1.0), (len(pieces), 1))
    purple = "#9775fa"
    label = "distance of points from the skin, outwards [mm]"
    figure, panels = _two_sides(
        pieces[:, :3], colours, pieces.reshape(-1, 3), scale, label, extend="both"
    )
    residuals = scale.to_rgba(1e3 * distances[used])
    for axes in panels:
        axes.scatter(*points[used].T, s=5, c=residuals, depthshade=False, zorder=4)  # pyright: ignore
        axes.scatter(*points[~used].T, s=8, c=purple, marker="x", linewidths=0.6, zorder=4)  # pyright: ignore
    outlier = Line2D([], [], color=purple, marker="x", linestyle="none")
    words = "outliers, which the fit leaves out; all points are seen through the skin"
    figure.legend([outlier], [words], loc="outside lower center", frameon=False)
    return figure


def _two_sides(
    corners: Float64[np.ndarray, "pieces 3 3"],
    colours: Float64[np.ndarray, "pieces 4"],
    points: Float64[np.ndarray, "points 3"],
    scale: ScalarMappable,
    label: str,
    lines: Sequence[Lines] = (),
    extend: str = "neither",
) -> tuple[Figure, list[Axes3D]]:
    """Draw flat pieces [mm] from two sides with a colour bar; ``points`` fit into the frame."""
    figure = wide_figure(6.4)
    panels = []
    for view, axes in two_sides(figure, broad_view(points)):
        axes.add_collection3d(solid(corners, colours, lines, view), autolim=False)
        frame(axes, points)
        panels.append(axes)
    figure.colorbar(scale, ax=panels, label=label, shrink=0.6, aspect=28, extend=extend)
    return figure, panels


def _edges(triangles: QuadraticTriangles, parts: int) -> Lines:
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    steps = np.linspace(0.0, 1.0, 2 * parts + 1)[:, None]
    segments = []
    normals = []
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        points = np.einsum("pn,tnd->tpd", shape_functions(start + steps * (end - start)), triangles)
        middles = start + (steps[1:] + steps[:-1]) / 2.0 * (end - start)
        for index, middle in enumerate(middles):
            segments.append(points[:, index : index + 2])
            normals.append(points_at(triangles, np.broadcast_to(middle, (len(triangles), 2)))[1])
    ahead = np.tile(longest_edges(triangles) / parts, 6 * parts)
    return Lines(np.concatenate(segments), np.concatenate(normals), ahead)
