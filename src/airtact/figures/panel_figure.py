"""The curved panels of a body, seen from two sides and coloured by their smallest angle."""

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from airtact.figures.solids import Lines, solid
from airtact.figures.space_axes import broad_view, frame, two_sides, wide_figure
from airtact.mesh.quadratic_triangles import SixNodes, cut, longest_edges, points_at, shape_functions, smallest_angles

ANGLES = Normalize(0.0, 60.0)
"""Range of the colours [degrees]: an equilateral panel has 60."""

COLOURS = "viridis"

PIECES = 4000
"""About as many flat pieces are drawn of few panels, so that they look curved."""


def draw_panels(six_nodes: SixNodes) -> Figure:
    """Draw panels with their edges.

    Parameters
    ----------
    six_nodes : (T, 6, 3) the panels [m].
    """
    figure = wide_figure(6.4)
    six_nodes = 1e3 * six_nodes
    parts = int(np.clip(np.sqrt(PIECES / len(six_nodes)), 1, 6))
    pieces, parents = cut(six_nodes, np.full(len(six_nodes), parts))
    colours = colormaps[COLOURS](ANGLES(smallest_angles(six_nodes)))[parents]
    lines = _edges(six_nodes, parts)
    sides = two_sides(figure, broad_view(six_nodes.reshape(-1, 3)))
    for view, axes in sides:
        axes.add_collection3d(solid(pieces[:, :3], colours, [lines], view), autolim=False)
        frame(axes, [six_nodes.reshape(-1, 3)])
    label = "smallest angle of the panel [degrees]"
    figure.colorbar(ScalarMappable(ANGLES, COLOURS), ax=[axes for _, axes in sides], label=label, shrink=0.6, aspect=28)
    return figure


def _edges(six_nodes: SixNodes, parts: int) -> Lines:
    """Cut the edges of panels into straight lines."""
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    steps = np.linspace(0.0, 1.0, 2 * parts + 1)[:, None]
    segments, normals = [], []
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        points = np.einsum("pn,tnd->tpd", shape_functions(start + steps * (end - start)), six_nodes)
        middles = start + (steps[1:] + steps[:-1]) / 2.0 * (end - start)
        for index, middle in enumerate(middles):
            segments.append(points[:, index : index + 2])
            normals.append(points_at(six_nodes, np.broadcast_to(middle, (len(six_nodes), 2)))[1])
    ahead = np.tile(longest_edges(six_nodes) / parts, 6 * parts)
    return Lines(np.concatenate(segments), np.concatenate(normals), ahead)
