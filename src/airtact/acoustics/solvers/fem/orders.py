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
from airtact.acoustics.solvers.fem.meshing.netgen import CurvedMesh, FiniteSpace, ngsolve_library
from airtact.acoustics.solvers.fem.meshing.volume import Box

REACH = 1.5
"""The order asked for serves edges up to this many times the one asked for."""

EASE = 3.0
"""Error allowed in the perfectly matched layer and far from the surfaces over that near them: little comes back."""

FAR = 0.5
"""Distance from the surfaces that is far [λ]."""

HIGHER, LEAST = 4, 3
"""Orders are at most this much above the one asked for, and at least this high where that one is."""

ON_BOX = 1e-9
"""Distance [m] up to which the middle of an edge lies on the box."""


def longest_served(order: int, size: float, ease: float = 1.0) -> Float64[np.ndarray, "orders"]:
    """Longest edges [λ] that orders 1, 2 ... serve as well as one order serves a given edge.

    A polynomial of order p misses e^{ikx} over an edge h by 2 (kh/4)^(p+1) / (p+1)! (interpolation
    after Chebyshev). ``order`` serves the edge ``size`` [λ]; ``ease`` is how much more error is
    allowed.
    """
    error = ease * (0.5 * np.pi * size) ** (order + 1) / factorial(order + 1)
    return np.array(
        [
            (error * factorial(p + 1)) ** (1 / (p + 1)) / (0.5 * np.pi)
            for p in range(1, order + HIGHER + 1)
        ]
    )


def grade_orders(
    space: FiniteSpace,
    mesh: CurvedMesh,
    scene: Scene,
    box: Box,
    order: int,
    size: float,
    surface: Real[np.ndarray, "nodes 3"] | None,
) -> None:
    """Give edges, faces and tetrahedra the orders that their lengths ask for: ``order`` where an edge is ``size`` [λ].

    ``surface`` are points all over the surfaces [λ]; None where the pressure is read off the mesh
    far from them too.
    """
    ngsolve = ngsolve_library()
    points = np.array([vertex.point for vertex in mesh.vertices])
    ends = np.array([[vertex.nr for vertex in edge.vertices] for edge in mesh.edges])
    lengths = np.linalg.norm(points[ends[:, 0]] - points[ends[:, 1]], axis=1) * _shortening(
        scene, mesh
    )
    faces = np.array([[edge.nr for edge in face.edges] for face in mesh.faces])
    cells = np.array([[edge.nr for edge in cell.edges] for cell in mesh.Elements(ngsolve.VOL)])
    middles = points[ends].mean(axis=1)
    near = None if surface is None else KDTree(surface)
    every = (np.arange(len(ends))[:, None], faces, cells)
    for kind, edges in zip((ngsolve.EDGE, ngsolve.FACE, ngsolve.CELL), every, strict=True):
        longest, middle = lengths[edges].max(axis=1), middles[edges].mean(axis=1)
        eased = ~Box(box.low - ON_BOX, box.high + ON_BOX, box.layer, box.mirrors).holds(
            middle * scene.wavelength
        )
        if near is not None:
            eased |= near.query(middle)[0] > FAR
        orders = np.where(
            eased, _served(longest, order, size, EASE), _served(longest, order, size, 1.0)
        )
        for number in np.flatnonzero(orders != order).tolist():
            space.SetOrder(ngsolve.NodeId(kind, number), int(orders[number]))
    space.UpdateDofTables()


def _served(
    lengths: Real[np.ndarray, "nodes"], order: int, size: float, ease: float
) -> Int64[np.ndarray, "nodes"]:
    limits = longest_served(order, REACH * size, ease)
    return np.clip(1 + np.searchsorted(limits, lengths), min(order, LEAST), order + HIGHER)


def _shortening(scene: Scene, mesh: CurvedMesh) -> Float64[np.ndarray, "edges"]:
    """Divide the wave in air by the one beside each edge, where that is in a filled body and shorter."""
    found = np.ones(mesh.nedge)
    for body, obstacle in enumerate(scene.obstacles):
        if obstacle.medium is None or obstacle.medium.sound_speed >= scene.medium.sound_speed:
            continue
        shorter = scene.medium.sound_speed / obstacle.medium.sound_speed
        for cell in mesh.Materials(f"body{body}").Elements():
            found[[edge.nr for edge in cell.edges]] = shorter
    return found
