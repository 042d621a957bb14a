"""The curved panels of a body, seen from two sides and coloured by their smallest angle."""

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from airtact.figures.solids import Lines, solid
from airtact.figures.space_axes import broad_view, frame, two_sides, wide_figure
from airtact.mesh.quadratic_triangles import (
    QuadraticTriangles,
    cut,
    longest_edges,
    points_at,
    shape_functions,
    smallest_angles,
)

ANGLES = Normalize(0.0, 60.0)
"""Range of the colours [degrees]: an equilateral panel has 60."""

COLOURS = "viridis"

PIECES = 4000
"""About as many flat pieces are drawn of few panels, so that they look curved."""


def draw_panels(quadratic_triangles: QuadraticTriangles) -> Figure:
    """Draw panels with their edges.

    Parameters
    ----------
    quadratic_triangles : (T, 6, 3) the panels [m].
    """
    figure = wide_figure(6.4)
    quadratic_triangles = 1e3 * quadratic_triangles
    parts = int(np.clip(np.sqrt(PIECES / len(quadratic_triangles)), 1, 6))
    pieces, parents = cut(quadratic_triangles, np.full(len(quadratic_triangles), parts))
    colours = colormaps[COLOURS](ANGLES(smallest_angles(quadratic_triangles)))[parents]
    lines = _edges(quadratic_triangles, parts)
    sides = two_sides(figure, broad_view(quadratic_triangles.reshape(-1, 3)))
    for view, axes in sides:
        axes.add_collection3d(solid(pieces[:, :3], colours, [lines], view), autolim=False)
        frame(axes, [quadratic_triangles.reshape(-1, 3)])
    label = "smallest angle of the panel [degrees]"
    figure.colorbar(ScalarMappable(ANGLES, COLOURS), ax=[axes for _, axes in sides], label=label, shrink=0.6, aspect=28)
    return figure


def _edges(quadratic_triangles: QuadraticTriangles, parts: int) -> Lines:
    """Cut the edges of panels into straight lines."""
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    steps = np.linspace(0.0, 1.0, 2 * parts + 1)[:, None]
    segments, normals = [], []
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        points = np.einsum("pn,tnd->tpd", shape_functions(start + steps * (end - start)), quadratic_triangles)
        middles = start + (steps[1:] + steps[:-1]) / 2.0 * (end - start)
        for index, middle in enumerate(middles):
            segments.append(points[:, index : index + 2])
            normals.append(points_at(quadratic_triangles, np.broadcast_to(middle, (len(quadratic_triangles), 2)))[1])
    ahead = np.tile(longest_edges(quadratic_triangles) / parts, 6 * parts)
    return Lines(np.concatenate(segments), np.concatenate(normals), ahead)
