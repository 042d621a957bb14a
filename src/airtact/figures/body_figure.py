"""Bodies as they were given, seen from two sides, with the edges that stay sharp."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Real
from matplotlib import colormaps
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from airtact.figures.solids import edge_lines, fine_pieces, solid
from airtact.figures.space_axes import broad_view, frame, two_sides, wide_figure
from airtact.surfaces.mesh_shape import MeshShape
from airtact.surfaces.surface import Surface

MOST_EDGES = 8000
"""Edges of triangles are drawn up to so many triangles; more would be black."""

FINENESS = 1.0 / 40.0
"""Share of the extent of everything that a piece of a triangle may have."""

SHARP = (0.75, 0.11, 0.11, 1.0)
FOCUS = "#e8590c"


def draw_bodies(
    bodies: Sequence[Surface],
    names: Sequence[str],
    foci: Real[np.ndarray, "foci 3"] | None = None,
) -> Figure:
    """Draw bodies with their triangles.

    Parameters
    ----------
    bodies : what is drawn.
    names : of each.
    foci : (F, 3) points drawn as dots [m], or none.
    """
    figure = wide_figure(6.0)
    corners = 1e3 * np.concatenate([body.corners for body in bodies])
    tints = colormaps["Pastel2"](np.arange(len(bodies)) % 8)
    colours = np.repeat(tints, [len(body.triangles) for body in bodies], axis=0)
    dots = np.empty((0, 3)) if foci is None else 1e3 * foci
    everything = np.concatenate([corners.reshape(-1, 3), dots])
    step = FINENESS * float(np.ptp(everything, axis=0).max())
    sharp = np.concatenate([sharp_edges(body) for body in bodies])
    lines = [replace(edge_lines(corners, sharp, step), colour=SHARP, breadth=0.25 * step)]
    if len(corners) <= MOST_EDGES:
        lines.append(edge_lines(corners, ~sharp, step))
    pieces, parents = fine_pieces(corners, step)
    for view, axes in two_sides(figure, broad_view(everything)):
        axes.add_collection3d(solid(pieces, colours[parents], lines, view), autolim=False)
        xs, ys, zs = dots.T
        axes.scatter(xs, ys, zs, s=30, c=FOCUS, edgecolors="white", linewidths=0.8, depthshade=False, zorder=4)  # pyright: ignore
        frame(axes, [everything])
    handles: list[Patch | Line2D] = [Patch(color=tint, label=name) for tint, name in zip(tints, names, strict=True)]
    if sharp.any():
        handles.append(Line2D([], [], color=SHARP, label="edges that stay sharp"))
    if len(dots):
        handles.append(Line2D([], [], color=FOCUS, marker="o", linestyle="none", label="foci, seen through bodies"))
    figure.legend(handles=handles, loc="outside lower center", ncols=6, frameon=False)
    return figure


def sharp_edges(body: Surface) -> Bool[np.ndarray, "triangles 3"]:
    """Tell which edges 01, 12, 20 of the triangles of a surface stay sharp when it is curved.

    Parameters
    ----------
    body : the surface; primitives have none.
    """
    if not isinstance(body.shape, MeshShape):
        return np.zeros((len(body.triangles), 3), dtype=bool)
    return body.shape.mesh.sharp
