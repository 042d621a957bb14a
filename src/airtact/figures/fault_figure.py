"""A surface that is refused, and the place of the fault close up."""

import textwrap
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float64, Int64, Real
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch
from mpl_toolkits.mplot3d import Axes3D

from airtact.figures.solids import INSIDE, edge_lines, fine_pieces, polygons_of, solid, unit_normals
from airtact.figures.space_axes import View, broad_view, frame, two_sides, wide_figure
from airtact.mesh.closest_point import closest_on_triangles
from airtact.mesh.topology import edge_twins

SKIN = np.array([0.74, 0.80, 0.86, 1.0])
OPEN = (0.80, 0.07, 0.07, 1.0)
MARK = "#7b1fa2"

ASIDE = 18.0
"""Angle between the view and the normal, so that heights show [degrees]."""

AROUND = 120
"""So many triangles are seen close up."""

MOST_EDGES = 8000
"""Edges of triangles are drawn up to so many triangles; more would be black."""

FINENESS = 1.0 / 40.0
"""Share of the extent of everything that a piece of a triangle may have."""


def draw_fault(
    vertices: Real[np.ndarray, "vertices 3"],
    triangles: Int64[np.ndarray, "triangles 3"],
    sentence: str,
    place: Real[np.ndarray, "3"] | None,
) -> Figure:
    """Draw triangles that are no good surface: whole, and close up where the fault is.

    Backs of triangles and edges without a neighbour have colours of their own. Triangles that name vertices which are
    not there, or are nowhere, are left out.

    Parameters
    ----------
    vertices : (V, 3) [m].
    triangles : (T, 3) vertex indices.
    sentence : why it is refused.
    place : (3,) of the fault [m], or None to see all from two sides.
    """
    figure = wide_figure(6.6)
    corners, lone = _drawable(vertices, triangles)
    mark = None if place is None else 1e3 * np.asarray(place, dtype=np.float64)
    view = broad_view(corners.reshape(-1, 3)) if mark is None else _facing(corners, mark)
    sides = two_sides(figure, view)
    if mark is not None:
        sides[1][1].remove()
        _close_up(figure.add_subplot(1, 2, 2), corners, lone, mark, view)
        sides = sides[:1]
    _whole(sides, corners, lone, mark)
    words = sentence if place is not None else f"{sentence} (No one place was given for this fault.)"
    figure.suptitle(textwrap.fill(words, 130), fontsize=11)
    figure.legend(
        handles=_meanings(mark is not None, bool(lone.any())), loc="outside lower center", ncols=4, frameon=False
    )
    return figure


def _drawable(
    vertices: Real[np.ndarray, "vertices 3"], triangles: Int64[np.ndarray, "triangles 3"]
) -> tuple[Float64[np.ndarray, "drawn 3 3"], Bool[np.ndarray, "drawn 3"]]:
    """Corners of the triangles that can be drawn [mm], and which of their edges have no neighbour."""
    there = triangles[((triangles >= 0) & (triangles < len(vertices))).all(axis=1)]
    corners = np.asarray(vertices[there], dtype=np.float64)
    corners = corners[np.isfinite(corners).all(axis=(1, 2))]
    same = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)[1].reshape(-1, 3)
    return 1e3 * corners, edge_twins(same) < 0


def _facing(corners: Float64[np.ndarray, "triangles 3 3"], mark: Float64[np.ndarray, "3"]) -> View:
    """Look at a place a little from aside, from that side of the skin on which less stands before it."""
    nearest = np.argsort(_distances(corners, mark))[:12]
    normals = unit_normals(corners[nearest])
    outward = normals.sum(axis=0) if np.linalg.norm(normals.sum(axis=0)) > 0.5 else normals[0] + [0.0, 0.0, 1e-9]
    views = []
    for side in (outward, -outward):
        azimuth, height = np.degrees(np.arctan2(side[1], side[0])), side[2] / np.linalg.norm(side)
        elevation = np.clip(np.degrees(np.arcsin(height)) + ASIDE, -80.0, 80.0)
        views.append(View(float(azimuth) + ASIDE, float(elevation)))
    return min(views, key=lambda view: _standing_before(corners - mark, view))


def _standing_before(corners: Float64[np.ndarray, "triangles 3 3"], view: View) -> int:
    """Count the triangles between the origin and the viewer."""
    x, y = np.moveaxis(corners @ view.plane, 2, 0)
    turns = x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1)
    covering = (turns > 0).all(axis=1) | (turns < 0).all(axis=1)
    depth = corners.mean(axis=1) @ view.towards_viewer
    return int((covering & (depth > 1e-3 * np.abs(depth).max())).sum())


def _distances(
    corners: Float64[np.ndarray, "triangles 3 3"], mark: Float64[np.ndarray, "3"]
) -> Float64[np.ndarray, "triangles"]:
    feet = np.einsum("tk,tkd->td", closest_on_triangles(np.tile(mark, (len(corners), 1)), corners), corners)
    return np.linalg.norm(feet - mark, axis=1)


def _whole(
    sides: list[tuple[View, Axes3D]],
    corners: Float64[np.ndarray, "triangles 3 3"],
    lone: Bool[np.ndarray, "triangles 3"],
    mark: Float64[np.ndarray, "3"] | None,
) -> None:
    step = FINENESS * float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    rims = replace(edge_lines(corners, lone, step), colour=OPEN, breadth=0.2 * step)
    lines = [rims, edge_lines(corners, ~lone, step)] if len(corners) <= MOST_EDGES else [rims]
    lines += [replace(some, outward=-some.outward) for some in lines]
    pieces, _ = fine_pieces(corners, step)
    for view, axes in sides:
        axes.add_collection3d(solid(pieces, np.tile(SKIN, (len(pieces), 1)), lines, view, closed=False), autolim=False)
        parts = [corners.reshape(-1, 3)]
        if mark is not None:
            x, y, z = mark.tolist()
            axes.plot(
                [x], [y], [z], "o", markersize=17, markerfacecolor="none", color=MARK, markeredgewidth=2, zorder=4
            )
            parts.append(mark[None])
        frame(axes, parts)


def _close_up(
    axes: Axes,
    corners: Float64[np.ndarray, "triangles 3 3"],
    lone: Bool[np.ndarray, "triangles 3"],
    mark: Float64[np.ndarray, "3"],
    view: View,
) -> None:
    """Draw the nearest triangles flat, as seen from afar."""
    away = _distances(corners, mark)
    extent = float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    reach = float(np.clip(np.sort(away)[: AROUND + 1][-1], 0.02 * extent, 0.6 * extent))
    near, step = away < 1.5 * reach, FINENESS * 5 * reach
    corners, lone = corners[near] - mark, lone[near]
    lines = [edge_lines(corners, ~lone, step)]
    lines += [replace(edge_lines(corners, lone, step), colour=OPEN, breadth=0.015 * reach)]
    lines += [replace(some, outward=-some.outward) for some in lines]
    pieces, _ = fine_pieces(corners, step)
    polygons, painted = polygons_of(pieces, np.tile(SKIN, (len(pieces), 1)), lines, view, closed=False)
    order = np.argsort([polygon.mean(axis=0) @ view.towards_viewer for polygon in polygons])
    flat = [polygons[index] @ view.plane for index in order]
    axes.add_collection(PolyCollection(flat, facecolors=painted[order], edgecolors=painted[order], linewidths=0.5))
    axes.add_patch(Circle((0.0, 0.0), 0.07 * reach, fill=False, color=MARK, linewidth=2, zorder=4))
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
    x, y, z = mark
    axes.set(xlabel="across [mm]", ylabel="up [mm]", title=f"close up: the mark is at ({x:.2f}, {y:.2f}, {z:.2f}) mm")


def _meanings(marked: bool, open_: bool) -> list[Patch | Line2D]:
    handles: list[Patch | Line2D] = [
        Patch(color=tuple(SKIN), label="outside of triangles"),
        Patch(color=tuple(INSIDE), label="inside"),
    ]
    if open_:
        handles.append(Line2D([], [], color=OPEN, linewidth=2.2, label="edge without a neighbour"))
    if marked:
        ring = {"marker": "o", "linestyle": "none", "markersize": 12, "markerfacecolor": "none"}
        handles.append(Line2D([], [], color=MARK, label="place of the fault", **ring))
    return handles
