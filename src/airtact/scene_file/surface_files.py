"""Surfaces that a scene file or a command names, and their bare triangles where they are refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int64

from airtact.scene.curving import SHARP_DEGREES
from airtact.scene.files import load_surface
from airtact.scene.geometry import Surface

Triangles = tuple[Float64[np.ndarray, "vertices 3"], Int64[np.ndarray, "triangles 3"]]
"""Vertices (V, 3) [m] and the indices of each triangle (T, 3)."""


def read_surface(path: Path, scale: float = 1.0, sharp_degrees: float = SHARP_DEGREES) -> Surface:
    """Read a closed surface from a file, mend it, and say which of its edges stay sharp.

    Parameters
    ----------
    path : an STL, PLY, OBJ or GLB file.
    scale : metres per unit of the file.
    sharp_degrees : edges whose triangles turn by more than this stay sharp.

    Raises
    ------
    InvalidInput
        See ``load_surface`` and ``Surface``.
    """
    return replace(load_surface(path, scale), sharp_degrees=sharp_degrees)


def bare_triangles(path: Path, scale: float = 1.0) -> Triangles | None:
    """Read the triangles of a file as they are, to be drawn where they are no good surface.

    Parameters
    ----------
    path : an STL, PLY, OBJ or GLB file.
    scale : metres per unit of the file.

    Returns
    -------
    The triangles, or None where the file cannot be read or holds none.
    """
    import trimesh  # takes as long to import as all the rest of airtact

    try:
        mesh = trimesh.load_scene(path, process=False).to_mesh()
    except Exception:  # every reader of trimesh has its own way to fail on a damaged file
        return None
    if len(mesh.faces) == 0:
        return None
    return scale * np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64)
