"""Slopes of the pressure on the skin, from the pressure at places round each point on its own panel."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Complex128, Float64, Int64, Real

from airtact.mesh.quadratic_triangles import shape_functions, shape_gradients
from airtact.solvers.bem.quadrature import Nodes

REACH = 0.3
"""Size of the triangle of places round a point, over that of its panel."""

POWERS = [(first, second) for first in range(4) for second in range(4 - first)]
"""Powers of the two reference coordinates in a cubic."""

PLACES = np.array(POWERS) / 3.0
"""(10, 2) places in the reference triangle through which a cubic is laid."""

CUBIC = np.linalg.inv(np.stack([PLACES[:, 0] ** a * PLACES[:, 1] ** b for a, b in POWERS], axis=1))
"""(10, 10): column j holds the coefficients of the cubic that is 1 at place j and 0 at the others."""

POINTS_AT_ONCE = 2048


def _cubic_slopes(points: Real[np.ndarray, "points 2"]) -> tuple[Float64[np.ndarray, "points 10"], ...]:
    """Differentiate the cubics of the ten places along both reference coordinates, at points (P, 2)."""
    u, v = points[:, 0], points[:, 1]
    along_u = np.stack([a * u ** max(a - 1, 0) * v**b for a, b in POWERS], axis=1)
    along_v = np.stack([b * u**a * v ** max(b - 1, 0) for a, b in POWERS], axis=1)
    return along_u @ CUBIC, along_v @ CUBIC


def skin_slopes(
    nodes: Nodes,
    panel: Int64[np.ndarray, "points"],
    foot: Float64[np.ndarray, "points 2"],
    pressure: Callable[[Float64[np.ndarray, "places 3"]], Complex128[np.ndarray, "places sounds"]],
) -> Complex128[np.ndarray, "points 3 sounds"]:
    """Slope of the pressure along the skin [Pa/m], from a cubic through ten places on the panel of each point.

    The places are the panel's own triangle shrunk towards the point, so that none leaves the panel.

    Parameters
    ----------
    nodes : of the panels.
    panel, foot : (P,) and (P, 2) the panel of each point and its reference coordinates there.
    pressure : gives the pressure [Pa] at points on the panels.
    """
    slopes = []
    for first in range(0, len(panel), POINTS_AT_ONCE):
        block = slice(first, first + POINTS_AT_ONCE)
        six, here = nodes.quadratic_triangles[panel[block]], foot[block]
        references = (1.0 - REACH) * here[:, None] + REACH * PLACES
        shape = shape_functions(references.reshape(-1, 2)).reshape(len(six), -1, 6)
        heard = pressure(np.einsum("tkn,tnd->tkd", shape, six).reshape(-1, 3)).reshape(len(six), len(PLACES), -1)
        # the point has the same reference coordinates in the shrunken triangle as in the panel
        rises = np.stack([np.einsum("tk,tks->ts", slope, heard) / REACH for slope in _cubic_slopes(here)], axis=1)
        along = np.stack([np.einsum("tn,tnd->td", slope, six) for slope in shape_gradients(here)], axis=1)
        metric = np.linalg.inv(along @ along.transpose(0, 2, 1))
        slopes.append(np.einsum("tad,tab,tbs->tds", along, metric, rises))
    return np.concatenate(slopes)
