"""Values and slopes of pressures on surfaces, from the nodes around each point.

Products of two pressures change twice as fast along a surface as either, faster than the nodes of
its panels resolve. So the pressures are interpolated first, at points of panels cut in four: by
polynomials in the tangent plane through the nodes near each point, fitted by weighted least squares
(P. Lancaster, K. Salkauskas, Math. Comp. 37 (1981) 141).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex64, Float32, Float64, Int64
from scipy.sparse import csr_array
from scipy.spatial import KDTree

from airtact.acoustics.solvers.bem.quadrature import Nodes, place_nodes
from airtact.geometry.mesh.quadratic_triangles import cut
from airtact.geometry.primitives import turn_from_z

DEGREE, NEIGHBOURS = 5, 36
"""Degree of the polynomials, of 21 terms, and nodes that each is fitted to."""

FALL = 2.0
"""Rate at which the weight of a node falls with the square of its distance over that of the farthest."""

SAME_SIDE = 0.3
"""Cosine between normals above which a node stands on the same side of a body."""

RIDGE = 1e-10
"""Least weight of all terms, so that few nodes, as at an edge, give a polynomial too."""


@dataclass(frozen=True, eq=False)
class SmoothSurface:
    """Points on surfaces, and what turns pressures at the nodes into pressures and slopes there.

    Attributes
    ----------
    points, normals : (P, 3) [m] and outward.
    areas : (P,) that each point stands for [m²].
    operators : (P, Q) each: the pressure, and its slopes along two directions at right angles
        [1/m].
    """

    points: Float64[np.ndarray, "points 3"]
    normals: Float64[np.ndarray, "points 3"]
    areas: Float64[np.ndarray, "points"]
    operators: tuple[csr_array, csr_array, csr_array]

    @classmethod
    def of(cls, nodes: Nodes) -> "SmoothSurface":
        """Cut panels in four and fit polynomials at the points on them."""
        panels = len(nodes.centres)
        pieces, _ = cut(nodes.quadratic_triangles, np.full(panels, 2))
        fine = place_nodes(pieces, np.zeros(len(pieces), dtype=np.int64), np.zeros(len(pieces)))
        near, rows = _fitted(fine.points, fine.normals, nodes)
        starts = np.arange(0, near.size + 1, near.shape[1])
        shape = len(fine.points), len(nodes.points)
        value, first, second = (
            csr_array((row.reshape(-1), near.reshape(-1), starts), shape) for row in rows
        )
        return cls(fine.points, fine.normals, fine.weights, (value, first, second))

    def smoothed(
        self, pressure: Complex64[np.ndarray, "nodes sounds"]
    ) -> Complex64[np.ndarray, "3 points sounds"]:
        """Return pressures [Pa] and both slopes [Pa/m] at the points."""
        return np.stack([one @ pressure for one in self.operators])


def _fitted(
    points: Float64[np.ndarray, "points 3"], normals: Float64[np.ndarray, "points 3"], nodes: Nodes
) -> tuple[Int64[np.ndarray, "points near"], Float32[np.ndarray, "3 points near"]]:
    """Return the nodes near each point, and their weights in the value and both slopes of its polynomial."""
    distance, near = KDTree(nodes.points).query(points, min(NEIGHBOURS, len(nodes.points)))
    reach = distance[:, -1:]
    turns = np.stack([turn_from_z(normal) for normal in normals])
    along = (
        np.einsum("pkd,pdc->pkc", nodes.points[near] - points[:, None], turns[:, :, :2])
        / reach[:, :, None]
    )
    same = np.einsum("pkd,pd->pk", nodes.normals[near], normals) > SAME_SIDE
    weights = np.exp(-FALL * (distance / reach) ** 2) * same
    powers = [
        (first, second) for first in range(DEGREE + 1) for second in range(DEGREE + 1 - first)
    ]
    to_power = np.cumprod(np.stack([np.ones_like(along), *[along] * DEGREE]), axis=0)
    terms = np.stack(
        [to_power[first, ..., 0] * to_power[second, ..., 1] for first, second in powers], axis=1
    )
    weighted = terms * weights[:, None, :] ** 2
    squares = weighted @ terms.transpose(0, 2, 1)
    squares += RIDGE * np.trace(squares, axis1=1, axis2=2)[:, None, None] * np.eye(len(powers))
    wanted = np.zeros((len(points), len(powers), 3))
    for column, power in enumerate([(0, 0), (1, 0), (0, 1)]):
        wanted[:, powers.index(power), column] = 1.0
    rows = np.einsum("ptc,ptk->cpk", np.linalg.solve(squares, wanted), weighted)
    rows[1:] /= reach
    return np.asarray(near), rows.astype(np.float32)
