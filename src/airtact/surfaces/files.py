"""Surfaces from files: STL, PLY, OBJ and GLB, read by trimesh."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Float64, Int

from airtact.conventions import InvalidInput, about
from airtact.mesh.curving import SHARP_DEGREES
from airtact.mesh.repair.pipeline import repaired
from airtact.pose import Pose
from airtact.surfaces.mesh_shape import MeshShape
from airtact.surfaces.quadratic_mesh import QuadraticMesh
from airtact.surfaces.surface import Surface
from airtact.validation import fixed, of_kind, positive

SUFFIXES = (".stl", ".ply", ".obj", ".glb", ".gltf")
"""File name endings that are read."""


def load_surface(
    path: str | Path, scale: float = 1.0, largest_hole: float = 2e-3, sharp_degrees: float = SHARP_DEGREES
) -> Surface:
    """Read a closed surface from a file, and repair what is damaged.

    The nodes of a scene graph are put where their transforms place them and joined; vertices at the same position are
    merged, whatever their texture or normal. ``repairs`` of the surface lists what was repaired, a sentence each; see
    ``airtact.mesh.repair.pipeline.repaired`` for what can be.

    Parameters
    ----------
    path : an STL, PLY, OBJ or GLB file.
    scale : metres per unit of the file: 1e-3 for a file in millimetres.
    largest_hole : widest hole that is filled [m], 0 for none.
    sharp_degrees : edges whose triangles turn by more than this stay sharp; the rest of the surface is curved.

    Raises
    ------
    InvalidInput
        When there is no such file, it cannot be read, holds no triangles, or the surface is at fault in a way that
        cannot be repaired.
    """
    of_kind(path, str | Path, "the path of a surface", "the name of a file")
    path, scale = Path(path), positive(scale, "scale", "m per unit of the file")
    vertices, triangles = _joined(path)
    with about(path.name):
        whole = repaired(vertices * scale, triangles, largest_hole)
        mesh = QuadraticMesh(fixed(whole.vertices), whole.triangles, sharp_degrees=sharp_degrees)
        shape = MeshShape(mesh, Pose.identity())
        return Surface(mesh.vertices, mesh.triangles, None, None, sharp_degrees, whole.notes, _known_shape=shape)


def node_positions(path: Path) -> Mapping[str, Float64[np.ndarray, "3"]]:
    """Read where the named nodes of a file are, such as the joints of a rig: (3,) each, in units of the file.

    Raises
    ------
    InvalidInput
        When there is no such file, or it cannot be read.
    """
    graph = _scene(path).graph
    return {str(node): fixed(np.array(graph.get(node)[0][:3, 3], dtype=np.float64)) for node in graph.nodes}


def _scene(path: Path) -> Any:
    if path.suffix.lower() not in SUFFIXES:
        raise InvalidInput(
            f"{path.name} ends in {path.suffix!r}, but surfaces are read from {', '.join(SUFFIXES)}.",
            code="unknown_ending",
        )
    if not path.is_file():
        raise InvalidInput(f"there is no file {path}; 0 triangles were read.", code="file_missing")
    import trimesh  # takes as long to import as all the rest of airtact

    try:
        return trimesh.load_scene(path, process=False)
    except Exception as fault:  # every reader of trimesh has its own way to fail on a damaged file
        raise _unreadable(path, fault) from fault


def _joined(path: Path) -> tuple[Float[np.ndarray, "vertices 3"], Int[np.ndarray, "triangles 3"]]:
    scene = _scene(path)
    try:
        mesh = scene.to_mesh()
    except Exception as fault:  # as above
        raise _unreadable(path, fault) from fault
    if len(mesh.faces) == 0:
        raise InvalidInput(
            f"{path.name} holds 0 triangles; give a file with a closed triangle surface.", code="no_triangles"
        )
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def _unreadable(path: Path, fault: Exception) -> InvalidInput:
    size = path.stat().st_size
    return InvalidInput(f"{path.name} ({size} bytes) cannot be read: {fault}.", code="file_unreadable")
