"""Polynomial orders by size: long edges, faces and tetrahedra get higher ones, short ones lower.

Netgen's tetrahedra are up to three times larger and smaller than asked. With one order everywhere
the largest make the error and the smallest the cost; with an order of its own, each contributes
equally to both.
"""

from math import factorial

import numpy as np
from jaxtyping import Float64, Int64, Real
from scipy.spatial import KDTree

from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.fem.libraries import CurvedMesh, FiniteSpace, ngsolve_library
from airtact.acoustics.solvers.fem.mesh import Box

# Orders are at most this much above the one asked for
MAX_ABOVE = 4


def longest_served(order: int, size: float, ease: float = 1.0) -> Float64[np.ndarray, "orders"]:
    """Longest edges [λ] that orders 1, 2 ... serve as well as one order serves a given edge.

    A polynomial of order p misses e^{ikx} over an edge h by 2 (kh/4)^(p+1) / (p+1)! (interpolation
    after Chebyshev). ``order`` serves the edge ``size`` [λ]; ``ease`` is how much more error is
    allowed.
    """
    error = ease * (0.5 * np.pi * size) ** (order + 1) / factorial(order + 1)
    powers = range(2, order + MAX_ABOVE + 2)
    return np.array([(error * factorial(n)) ** (1 / n) / (0.5 * np.pi) for n in powers])


def grade_orders(
    space: FiniteSpace,
    mesh: CurvedMesh,
    scene: Scene,
    box: Box,
    order: int,
    size: float,
    surface: Real[np.ndarray, "nodes 3"] | None,
) -> None:
    """Give edges, faces and tetrahedra the orders that their lengths ask for.

    ``order`` where an edge is ``size`` [λ].

    ``surface`` are points all over the surfaces [λ]; None where the pressure is read off the mesh
    far from them too.
    """
    ngsolve = ngsolve_library()
    points = np.array([vertex.point for vertex in mesh.vertices])
    ends = np.array([[vertex.nr for vertex in edge.vertices] for edge in mesh.edges])
    lengths = np.linalg.norm(points[ends[:, 0]] - points[ends[:, 1]], axis=1)
    lengths *= _shortening(scene, mesh)
    middles = points[ends].mean(axis=1)
    faces = np.array([[edge.nr for edge in face.edges] for face in mesh.faces])
    cells = np.array([[edge.nr for edge in cell.edges] for cell in mesh.Elements(ngsolve.VOL)])
    on_box = 1e-9  # [m] off it the middle of an edge on the box may be
    air = Box(box.low - on_box, box.high + on_box, box.layer, box.mirrors)
    near = None if surface is None else KDTree(surface)
    edges_of = {
        ngsolve.EDGE: np.arange(len(ends))[:, None],
        ngsolve.FACE: faces,
        ngsolve.CELL: cells,
    }
    for kind, edges in edges_of.items():
        longest = lengths[edges].max(axis=1)
        middle = middles[edges].mean(axis=1)
        # Little of the error in the layer and far from the surfaces comes back: three times as much
        # is allowed there.
        eased = ~air.holds(middle * scene.wavelength)
        if near is not None:
            eased |= near.query(middle)[0] > 0.5
        orders = np.where(
            eased, _served(longest, order, size, 3.0), _served(longest, order, size, 1.0)
        )
        for number in np.flatnonzero(orders != order).tolist():
            space.SetOrder(ngsolve.NodeId(kind, number), int(orders[number]))
    space.UpdateDofTables()


def _served(
    lengths: Real[np.ndarray, "nodes"], order: int, size: float, ease: float
) -> Int64[np.ndarray, "nodes"]:
    limits = longest_served(order, 1.5 * size, ease)  # Netgen's longest edges
    return np.clip(1 + np.searchsorted(limits, lengths), min(order, 3), order + MAX_ABOVE)


def _shortening(scene: Scene, mesh: CurvedMesh) -> Float64[np.ndarray, "edges"]:
    """Wavelength in air over the one beside each edge, at least 1."""
    factors = np.ones(mesh.nedge)
    for body, obstacle in enumerate(scene.obstacles):
        if obstacle.medium is not None:
            shorter = scene.medium.sound_speed / obstacle.medium.sound_speed
            for cell in mesh.Materials(f"body{body}").Elements():
                factors[[edge.nr for edge in cell.edges]] = max(shorter, 1.0)
    return factors
