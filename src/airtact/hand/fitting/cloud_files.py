"""Point clouds from files."""

from pathlib import Path

import numpy as np
from jaxtyping import Float64

from airtact.conventions import InvalidInput, about
from airtact.validation import points_of

ENDINGS = (".ply", ".xyz", ".npy")
"""File name endings of clouds that are read."""


def load_cloud(path: Path) -> Float64[np.ndarray, "points 3"]:
    """Read a point cloud.

    Parameters
    ----------
    path : a PLY file, whose triangles are left out if there are any; XYZ text; or a (N, 3) array of NumPy [m].

    Raises
    ------
    InvalidInput
        There is no such file, or it cannot be read or holds no points.
    """
    if path.suffix.lower() not in ENDINGS:
        raise InvalidInput(f"{path} ends in {path.suffix!r}, but clouds are read from 3 kinds: .ply, .xyz, .npy.")
    if not path.is_file():
        raise InvalidInput(f"there is no file {path}; 0 points were read.")
    try:
        if path.suffix.lower() == ".npy":
            points = np.load(path, allow_pickle=False)
        else:
            import trimesh  # takes as long to import as all the rest of airtact

            points = np.asarray(trimesh.load(path, process=False).vertices, dtype=np.float64)  # pyright: ignore
    except Exception as fault:  # every reader has its own way to fail on a damaged file
        raise InvalidInput(f"{path.name} ({path.stat().st_size} bytes) cannot be read: {fault}.") from fault
    with about(path.name):
        return points_of(points, "points of a cloud")
