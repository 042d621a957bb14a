"""The skin of a fitted hand, and over it the points that it was fitted to, coloured by their distance."""

import numpy as np
from jaxtyping import Float64
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from airtact.figures.solids import solid
from airtact.figures.space_axes import broad_view, frame, two_sides, wide_figure
from airtact.hand.fitting.fit import FittedHand
from airtact.mesh.quadratic_triangles import QuadraticTriangles, cut

OFF = Normalize(-5.0, 5.0)
"""Range of the colours [mm]."""

COLOURS, SKIN, STRAY = "RdBu", (0.82, 0.82, 0.80, 1.0), "#9775fa"


def draw_cloud(
    quadratic_triangles: QuadraticTriangles, fitted: FittedHand, distances: Float64[np.ndarray, "points"]
) -> Figure:
    """Draw points over the skin fitted to them: blue outside it, red inside, strays as crosses.

    Parameters
    ----------
    quadratic_triangles : (T, 6, 3) panels of the skin [m].
    fitted : the hand and its points.
    distances : (N,) of these from the skin, positive outside [m].
    """
    figure = wide_figure(6.4)
    pieces, _ = cut(1e3 * quadratic_triangles, np.full(len(quadratic_triangles), 1))
    points, used = 1e3 * fitted.points, ~fitted.strays
    everything = [pieces.reshape(-1, 3)]
    sides = two_sides(figure, broad_view(pieces.reshape(-1, 3)))
    for view, axes in sides:
        axes.add_collection3d(solid(pieces[:, :3], np.tile(SKIN, (len(pieces), 1)), [], view), autolim=False)
        off = OFF(1e3 * distances[used])
        axes.scatter(*points[used].T, s=5, c=colormaps[COLOURS](off), depthshade=False, zorder=4)  # pyright: ignore
        axes.scatter(*points[~used].T, s=8, c=STRAY, marker="x", linewidths=0.6, zorder=4)  # pyright: ignore
        frame(axes, everything)
    label = "distance of points from the skin, outwards [mm]"
    figure.colorbar(
        ScalarMappable(OFF, COLOURS), ax=[axes for _, axes in sides], label=label, shrink=0.6, aspect=28, extend="both"
    )
    stray = Line2D([], [], color=STRAY, marker="x", linestyle="none")
    figure.legend(
        [stray],
        ["stray points, which count for nothing; all points are seen through the skin"],
        loc="outside lower center",
        frameon=False,
    )
    return figure
