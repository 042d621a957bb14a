"""The bare triangles of a surface file, to be drawn where they are refused."""

from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int64

Triangles = tuple[Float64[np.ndarray, "vertices 3"], Int64[np.ndarray, "triangles 3"]]
"""Vertices (V, 3) [m] and the indices of each triangle (T, 3)."""


def bare_triangles(path: Path, scale: float = 1.0) -> Triangles | None:
    """Read the triangles of a file as they are.

    Parameters
    ----------
    path : an STL, PLY, OBJ or GLB file.
    scale : metres per unit of the file.

    Returns
    -------
    The triangles, or None where the file cannot be read or there is nothing to see.
    """
    import trimesh  # takes as long to import as all the rest of airtact

    try:
        mesh = trimesh.load_scene(path, process=False).to_mesh()
    except Exception:  # every reader of trimesh has its own way to fail on a damaged file
        return None
    vertices = scale * np.asarray(mesh.vertices, dtype=np.float64)
    there = vertices[np.isfinite(vertices).all(axis=1)]
    if len(mesh.faces) == 0 or len(there) == 0 or np.ptp(there, axis=0).max() == 0.0:
        return None
    return vertices, np.asarray(mesh.faces, dtype=np.int64)
