"""How hard sound presses on the skin of bodies, seen from two sides."""

import numpy as np
from jaxtyping import Float64, Real
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from airtact.evaluation.radiation import RadiationMap
from airtact.figures.solids import solid
from airtact.figures.space_axes import broad_view, frame, two_sides, wide_figure
from airtact.mesh.quadratic_triangles import NODE_PLACES, cut
from airtact.solvers.bem.quadrature import NODAL, monomials

COLOURS = "YlOrRd"
"""From pale to dark, so that the shape of a quiet body is seen too."""

PARTS = 3
"""Each panel is drawn as this number squared of flat pieces."""

FOCUS = "#1864ab"


def draw_skin(skin: RadiationMap, foci: Real[np.ndarray, "foci 3"] | None = None, most: float | None = None) -> Figure:
    """Draw the radiation pressure on the skin, and the foci as rings.

    Parameters
    ----------
    skin : sound on the skin, as ``radiation_map`` gives it.
    foci : (F, 3) [m], or none.
    most : the brightest colour [Pa], to compare pictures; None for the largest pressure that there is.
    """
    figure = wide_figure(6.4)
    pieces, _ = cut(1e3 * skin.quadratic_triangles, np.full(len(skin.quadratic_triangles), PARTS))
    pressing = _on_pieces(skin)
    largest = float(skin.radiation_pressure.max()) if most is None else most
    scale = PowerNorm(0.5, 0.0, max(largest, 1e-12))  # as even as the pressure of the sound is
    colours = colormaps[COLOURS](scale(np.maximum(pressing, 0.0)))
    rings = np.empty((0, 3)) if foci is None else 1e3 * foci
    everything = [pieces.reshape(-1, 3), rings]
    sides = two_sides(figure, broad_view(pieces.reshape(-1, 3)))
    for view, axes in sides:
        axes.add_collection3d(solid(pieces[:, :3], colours, [], view), autolim=False)
        xs, ys, zs = rings.T
        axes.scatter(xs, ys, zs, s=60, facecolors="none", edgecolors=FOCUS, linewidths=1.4, depthshade=False, zorder=4)  # pyright: ignore
        frame(axes, everything)
    label = "radiation pressure, inwards [Pa]"
    figure.colorbar(ScalarMappable(scale, COLOURS), ax=[axes for _, axes in sides], label=label, shrink=0.6, aspect=28)
    if len(rings):
        ring = Line2D([], [], color=FOCUS, marker="o", markersize=8, fillstyle="none", linestyle="none")
        figure.legend([ring], ["foci, seen through bodies"], loc="outside lower center", frameon=False)
    return figure


def _on_pieces(skin: RadiationMap) -> Float64[np.ndarray, "pieces"]:
    """Radiation pressure in the middle of every piece, by the quadratic through the six points of its panel."""
    flat = np.concatenate([NODE_PLACES, np.zeros((6, 1))], axis=1)[None]
    middles = cut(flat, np.array([PARTS]))[0][:, :3].mean(axis=1)[:, :2]
    values = skin.radiation_pressure.reshape(-1, 6) @ (monomials(middles) @ NODAL).T
    return values.ravel()
