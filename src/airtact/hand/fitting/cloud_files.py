"""Point clouds from files."""

from pathlib import Path

import numpy as np
from jaxtyping import Float64

from airtact.conventions import InvalidInput, about
from airtact.validation import points_of

ENDINGS = (".ply", ".xyz", ".npy")
"""Endings of the names of files that clouds are read from."""


def load_cloud(path: Path) -> Float64[np.ndarray, "points 3"]:
    """Read a point cloud.

    Parameters
    ----------
    path : a PLY file, of which only the vertices are read; XYZ text; or a (N, 3) array of NumPy [m].

    Raises
    ------
    InvalidInput
        The file does not exist, cannot be read or holds no points.
    """
    if path.suffix.lower() not in ENDINGS:
        endings = ", ".join(ENDINGS)
        raise InvalidInput(
            f"{path} ends in {path.suffix!r}, but clouds are read from {endings}.", code="unknown_ending"
        )
    if not path.is_file():
        raise InvalidInput(f"the file {path} does not exist; 0 points were read.", code="file_missing")
    try:
        if path.suffix.lower() == ".npy":
            points = np.load(path, allow_pickle=False)
        else:
            import trimesh  # takes as long to import as all the rest of airtact

            points = np.asarray(trimesh.load(path, process=False).vertices, dtype=np.float64)  # pyright: ignore
    except Exception as fault:  # every reader has its own way to fail on a damaged file
        sentence = f"{path.name} ({path.stat().st_size} bytes) cannot be read: {fault}."
        raise InvalidInput(sentence, code="file_unreadable") from fault
    with about(path.name):
        return points_of(points, "points of a cloud")
