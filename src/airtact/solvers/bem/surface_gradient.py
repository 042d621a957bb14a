"""Tangential gradient of the pressure on the surface, from the pressure around each point on its own panel."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Complex128, Float64, Int64, Real

from airtact.mesh.quadratic_triangles import shape_functions, shape_gradients
from airtact.solvers.bem.quadrature import Nodes

REACH = 0.3
"""Size of the triangle of samples around a point, over that of its panel."""

POWERS = [(first, second) for first in range(4) for second in range(4 - first)]
"""Powers of the two reference coordinates in a cubic."""

SAMPLES = np.array(POWERS) / 3.0
"""(10, 2) reference coordinates of the samples that the cubic interpolates."""

CUBIC = np.linalg.inv(np.stack([SAMPLES[:, 0] ** a * SAMPLES[:, 1] ** b for a, b in POWERS], axis=1))
"""(10, 10): column j holds the coefficients of the cubic that is 1 at sample j and 0 at the others."""

POINTS_AT_ONCE = 2048


def _cubic_gradients(points: Real[np.ndarray, "points 2"]) -> tuple[Float64[np.ndarray, "points 10"], ...]:
    """Differentiate the cubics of the ten samples along both reference coordinates, at points (P, 2)."""
    u, v = points[:, 0], points[:, 1]
    along_u = np.stack([a * u ** max(a - 1, 0) * v**b for a, b in POWERS], axis=1)
    along_v = np.stack([b * u**a * v ** max(b - 1, 0) for a, b in POWERS], axis=1)
    return along_u @ CUBIC, along_v @ CUBIC


def surface_gradient(
    nodes: Nodes,
    panel: Int64[np.ndarray, "points"],
    reference: Float64[np.ndarray, "points 2"],
    pressure: Callable[[Float64[np.ndarray, "samples 3"]], Complex128[np.ndarray, "samples sounds"]],
) -> Complex128[np.ndarray, "points 3 sounds"]:
    """Tangential gradient of the pressure [Pa/m], from a cubic through ten samples on the panel of each point.

    The points have reference coordinates on their panels. The samples fill the panel's own triangle shrunk towards the
    point, so that none leaves the panel; ``pressure`` returns the pressure [Pa] there.
    """
    gradients = []
    for first in range(0, len(panel), POINTS_AT_ONCE):
        block = slice(first, first + POINTS_AT_ONCE)
        six, here = nodes.quadratic_triangles[panel[block]], reference[block]
        references = (1.0 - REACH) * here[:, None] + REACH * SAMPLES
        shape = shape_functions(references.reshape(-1, 2)).reshape(len(six), -1, 6)
        sampled = pressure(np.einsum("tkn,tnd->tkd", shape, six).reshape(-1, 3)).reshape(len(six), len(SAMPLES), -1)
        # the point has the same reference coordinates in the shrunken triangle as in the panel
        rises = np.stack([np.einsum("tk,tks->ts", along, sampled) / REACH for along in _cubic_gradients(here)], axis=1)
        along = np.stack([np.einsum("tn,tnd->td", each, six) for each in shape_gradients(here)], axis=1)
        metric = np.linalg.inv(along @ along.transpose(0, 2, 1))
        gradients.append(np.einsum("tad,tab,tbs->tds", along, metric, rises))
    return np.concatenate(gradients)
