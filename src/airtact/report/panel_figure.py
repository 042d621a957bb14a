"""The curved panels of a body, seen from two sides and coloured by their smallest angle."""

import numpy as np
from jaxtyping import Float64
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from airtact.report.space_axes import View, broad_view, frame, two_sides
from airtact.scene.six_nodes import SixNodes, cut, longest_edges, points_at, shape_functions, smallest_angles

ANGLES = Normalize(0.0, 60.0)
"""Range of the colours [degrees]: an equilateral panel has 60."""

COLOURS = "viridis"
LINE = (0.13, 0.13, 0.13, 1.0)

PIECES = 4000
"""About as many flat pieces are drawn of few panels, so that they look curved."""

Edges = tuple[Float64[np.ndarray, "segments 2 3"], Float64[np.ndarray, "segments 3"], Float64[np.ndarray, "segments"]]


def draw_panels(six_nodes: SixNodes) -> Figure:
    """Draw panels with their edges.

    Parameters
    ----------
    six_nodes : (T, 6, 3) the panels [m].
    """
    figure = Figure(figsize=(13.0, 6.4), layout="constrained")
    six_nodes = 1e3 * six_nodes
    parts = int(np.clip(np.sqrt(PIECES / len(six_nodes)), 1, 6))
    pieces, parents = cut(six_nodes, np.full(len(six_nodes), parts))
    colours = colormaps[COLOURS](ANGLES(smallest_angles(six_nodes)))[parents]
    sides = two_sides(figure, broad_view(six_nodes.reshape(-1, 3)))
    for view, axes in sides:
        axes.add_collection3d(_drawn(pieces[:, :3], colours, _edges(six_nodes, parts), view), autolim=False)
        frame(axes, [six_nodes.reshape(-1, 3)])
    label = "smallest angle of the panel [degrees]"
    figure.colorbar(ScalarMappable(ANGLES, COLOURS), ax=[axes for _, axes in sides], label=label, shrink=0.6, aspect=28)
    return figure


def _drawn(
    corners: Float64[np.ndarray, "pieces 3 3"],
    colours: Float64[np.ndarray, "pieces 4"],
    edges: Edges,
    view: View,
) -> Poly3DCollection:
    """Put pieces and the lines on them into one collection, which is drawn from the back to the front."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    seen = normals @ view.towards_viewer > 0
    shaded = colours[seen]
    shaded[:, :3] *= 0.65 + 0.35 * np.clip(normals[seen] @ view.lamp, 0, 1)[:, None]
    segments, outward, ahead = edges
    facing = outward @ view.towards_viewer > 0
    # a line is a polygon of no area, in front of the pieces that it bounds
    segments = segments[facing] + ahead[facing, None, None] * view.towards_viewer
    lines = np.tile(LINE, (len(segments), 1))
    return Poly3DCollection(
        [*corners[seen], *segments],
        facecolors=np.concatenate([shaded, lines]),
        edgecolors=np.concatenate([shaded, lines]),
        linewidths=float(np.clip(25.0 / np.sqrt(len(corners)), 0.15, 0.6)),
    )


def _edges(six_nodes: SixNodes, parts: int) -> Edges:
    """Straight pieces of the edges of panels, the normals there, and how large the pieces of the panels are."""
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    steps = np.linspace(0.0, 1.0, 2 * parts + 1)[:, None]
    segments, normals = [], []
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        points = np.einsum("pn,tnd->tpd", shape_functions(start + steps * (end - start)), six_nodes)
        middles = start + (steps[1:] + steps[:-1]) / 2.0 * (end - start)
        for index, middle in enumerate(middles):
            segments.append(points[:, index : index + 2])
            normals.append(points_at(six_nodes, np.broadcast_to(middle, (len(six_nodes), 2)))[1])
    return np.concatenate(segments), np.concatenate(normals), np.tile(longest_edges(six_nodes) / parts, 6 * parts)
