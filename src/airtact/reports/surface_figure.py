"""Surfaces coloured by a quantity on them, seen from two sides: quality of panels, residuals of a fit."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from mpl_toolkits.mplot3d import Axes3D

from airtact.geometry.mesh.quadratic_triangles import (
    QuadraticTriangles,
    cut,
    longest_edges,
    points_at,
    shape_functions,
    smallest_angles,
)
from airtact.hands.fitting.fit import FittedHand
from airtact.reports.solids import Lines, broad_view, frame, solid, two_sides, wide_figure

ANGLES = 0.0, 60.0
"""Range of the colours of the smallest angle of a panel [degrees]: an equilateral panel has 60."""

RESIDUALS = -5.0, 5.0
"""Range of the colours of the distance of points from a skin [mm]."""

SKIN, OUTLIER = (0.82, 0.82, 0.80, 1.0), "#9775fa"

PIECES = 4000
"""About as many flat pieces are drawn of few panels, so that they look curved."""


def draw_panels(quadratic_triangles: QuadraticTriangles) -> Figure:
    """Draw curved panels with their edges, coloured by their smallest angle."""
    triangles = 1e3 * quadratic_triangles
    parts = int(np.clip(np.sqrt(PIECES / len(triangles)), 1, 6))
    pieces, parents = cut(triangles, np.full(len(triangles), parts))
    scale = ScalarMappable(Normalize(*ANGLES), "viridis")
    colours = scale.to_rgba(smallest_angles(triangles))[parents]
    label, edges = "smallest angle of the panel [degrees]", [_edges(triangles, parts)]
    return _two_sides(pieces[:, :3], colours, triangles.reshape(-1, 3), scale, label, edges)[0]


def draw_cloud(
    quadratic_triangles: QuadraticTriangles,
    fitted: FittedHand,
    distances: Float64[np.ndarray, "points"],
) -> Figure:
    """Draw points over the panels of the skin fitted to them: blue outside it, red inside, outliers as crosses.

    ``distances`` are those of the points from the skin, positive outside [m].
    """
    pieces, _ = cut(1e3 * quadratic_triangles, np.full(len(quadratic_triangles), 1))
    points, used = 1e3 * fitted.points, ~fitted.outliers
    scale = ScalarMappable(Normalize(*RESIDUALS), "RdBu")
    colours, label = (
        np.tile(SKIN, (len(pieces), 1)),
        "distance of points from the skin, outwards [mm]",
    )
    figure, sides = _two_sides(
        pieces[:, :3], colours, pieces.reshape(-1, 3), scale, label, extend="both"
    )
    residuals = scale.to_rgba(1e3 * distances[used])
    for axes in sides:
        axes.scatter(*points[used].T, s=5, c=residuals, depthshade=False, zorder=4)  # pyright: ignore
        axes.scatter(*points[~used].T, s=8, c=OUTLIER, marker="x", linewidths=0.6, zorder=4)  # pyright: ignore
    outlier = Line2D([], [], color=OUTLIER, marker="x", linestyle="none")
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
    """Draw flat pieces [mm] from two sides with a bar of their colours; ``points`` fit into the frame."""
    figure = wide_figure(6.4)
    sides = two_sides(figure, broad_view(points))
    for view, axes in sides:
        axes.add_collection3d(solid(corners, colours, lines, view), autolim=False)
        frame(axes, points)
    both = [axes for _, axes in sides]
    figure.colorbar(scale, ax=both, label=label, shrink=0.6, aspect=28, extend=extend)
    return figure, both


def _edges(triangles: QuadraticTriangles, parts: int) -> Lines:
    """Cut the edges of panels into straight lines."""
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    steps = np.linspace(0.0, 1.0, 2 * parts + 1)[:, None]
    segments, normals = [], []
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        points = np.einsum("pn,tnd->tpd", shape_functions(start + steps * (end - start)), triangles)
        middles = start + (steps[1:] + steps[:-1]) / 2.0 * (end - start)
        for index, middle in enumerate(middles):
            segments.append(points[:, index : index + 2])
            normals.append(points_at(triangles, np.broadcast_to(middle, (len(triangles), 2)))[1])
    ahead = np.tile(longest_edges(triangles) / parts, 6 * parts)
    return Lines(np.concatenate(segments), np.concatenate(normals), ahead)
