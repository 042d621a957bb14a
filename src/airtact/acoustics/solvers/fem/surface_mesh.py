"""Curved triangles over the surfaces of bodies. Neighbouring triangles share their corners."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64
from scipy.spatial import KDTree

from airtact.geometry.mesh.arrays import QuadraticTriangles
from airtact.geometry.mesh.edge_limits import bend_sizes, strip_sizes
from airtact.geometry.mesh.quadratic_triangles import area_vectors
from airtact.geometry.mesh.remeshing import remeshed
from airtact.geometry.mesh_shape import placed_on
from airtact.geometry.shape import Shape

# Ratio of the longest edge to the nominal edge length.
MAX_EDGE_RATIO = 1.5

# Ratio of the edge length along a bend to the length over which the bend turns by one radian.
BEND_RATIO = 0.6


@dataclass(frozen=True, eq=False, repr=False)
class SurfaceMesh:
    """Curved triangles over the surfaces of all bodies.

    Attributes
    ----------
    vertices : (V, 3) positions [m].
    triangles : (T, 3) vertex indices, anticlockwise when seen from outside the body.
    middles : (T, 3, 3) points of the curved surface at the middles of edges 01, 12, 20 [m], the
        same for both neighbours.
    body : (T,) index of each triangle's obstacle.
    """

    vertices: Float64[np.ndarray, "vertices 3"]
    triangles: Int64[np.ndarray, "triangles 3"]
    middles: Float64[np.ndarray, "triangles 3 3"]
    body: Int64[np.ndarray, "triangles"]

    @property
    def quadratic_triangles(self) -> QuadraticTriangles:
        """The curved triangles as panels (T, 6, 3) [m]."""
        return np.concatenate([self.vertices[self.triangles], self.middles], axis=1)


def surface_mesh(shapes: Sequence[Shape], edge: float) -> SurfaceMesh:
    """Cover the surfaces of bodies with triangles of a nominal edge length [m], using MMG."""
    largest = MAX_EDGE_RATIO * edge
    rough = [shape.coarse_meshes(largest) for shape in shapes]
    vertices, triangles, middles, body = [], [], [], []
    count = 0
    for index, shape in enumerate(shapes):
        neighbours = [
            part.vertices for parts in rough if parts is not rough[index] for part in parts
        ]
        for part in rough[index]:
            bends = bend_sizes(part.vertices, part.triangles, part.ridges, largest / BEND_RATIO)
            strips = strip_sizes(part.vertices, part.ridges, largest)
            sizes = np.minimum(strips, BEND_RATIO * bends)
            if neighbours:
                # Triangles that face another body have edges of at most 1.5 times the gap, but no
                # tiny edges.
                gap = KDTree(np.concatenate(neighbours)).query(part.vertices)[0]
                sizes = np.minimum(sizes, np.maximum(1.5 * gap, 0.15 * edge))
            area = 0.5 * np.linalg.norm(area_vectors(part.vertices[part.triangles]), axis=1).sum()
            flat = remeshed(part, sizes, edge, area / (np.sqrt(3) / 4 * edge**2))
            on_shape, between = placed_on(shape, flat, edge)
            vertices.append(on_shape)
            triangles.append(flat.triangles + count)
            middles.append(between)
            body.append(np.full(len(flat.triangles), index))
            count += len(on_shape)
    return SurfaceMesh(
        np.concatenate(vertices),
        np.concatenate(triangles),
        np.concatenate(middles),
        np.concatenate(body),
    )
