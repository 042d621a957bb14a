"""Surfaces from files: STL, PLY, OBJ and GLB, read by trimesh after what they hold was counted."""

import io
import logging
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64

from airtact.conventions import LARGEST_MESH_FILE, InvalidInput, about
from airtact.file_access.bounded import bytes_of
from airtact.mesh.curving import SHARP_DEGREES
from airtact.mesh.repair.pipeline import repaired
from airtact.pose import Pose
from airtact.surfaces.checks import check_not_crossed
from airtact.surfaces.file_limits import OwnFolder, check_counts, check_triangles
from airtact.surfaces.mesh_shape import MeshShape
from airtact.surfaces.quadratic_mesh import QuadraticMesh
from airtact.surfaces.surface import Surface
from airtact.timing import Progress, no_progress
from airtact.validation import counted, fixed, of_kind, positive

SUFFIXES = (".stl", ".ply", ".obj", ".glb", ".gltf")
"""File name endings that are read."""


def load_surface(
    path: str | Path,
    scale: float = 1.0,
    largest_hole: float = 2e-3,
    sharp_degrees: float = SHARP_DEGREES,
    *,
    progress: Progress | None = None,
) -> Surface:
    """Read a closed surface from a file, and repair what is damaged.

    The nodes of a scene graph are put where their transforms place them and joined; vertices at the same position are
    merged, whatever their texture or normal. ``repairs`` of the surface lists what was repaired, a sentence each; see
    ``airtact.mesh.repair.pipeline.repaired`` for what can be. Files of up to 100 MB and 250,000 triangles are read,
    which takes up to some 10 s and 1 GB. What a file names is read from its own folder only; materials and pictures
    never are.

    Parameters
    ----------
    path : an STL, PLY, OBJ or GLB file.
    scale : metres per unit of the file: 1e-3 for a file in millimetres.
    largest_hole : widest hole that is filled [m], 0 for none.
    sharp_degrees : edges whose triangles turn by more than this stay sharp; the rest of the surface is curved.
    progress : called with the words of each step as it begins.

    Raises
    ------
    InvalidInput
        When there is no such file, it cannot be read, is beyond those limits, holds no triangles, or the surface
        crosses itself or is at fault in another way that cannot be repaired.
    """
    of_kind(path, str | Path, "the path of a surface", "the name of a file")
    path, scale = Path(path), positive(scale, "scale", "m per unit of the file")
    report_step = progress or no_progress
    report_step(f"reading {path.name}")
    vertices, triangles = bare_mesh(path)
    with about(path.name):
        report_step(f"repairing {counted(len(triangles), 'triangle', 'triangles')}")
        with np.errstate(over="ignore"):  # infinite vertices are named below
            scaled = vertices * scale
        whole = repaired(scaled, triangles, largest_hole)
        report_step("curving the surface")
        mesh = QuadraticMesh(fixed(whole.vertices), whole.triangles, sharp_degrees=sharp_degrees)
        shape = MeshShape(mesh, Pose.identity())
        surface = Surface(mesh.vertices, mesh.triangles, None, None, sharp_degrees, whole.notes, _known_shape=shape)
        report_step("looking for crossings")
        check_not_crossed(surface)
        return surface


def node_positions(path: Path) -> Mapping[str, Float64[np.ndarray, "3"]]:
    """Read where the named nodes of a file are, such as the joints of a rig: (3,) each, in units of the file.

    Raises
    ------
    InvalidInput
        When there is no such file, or it cannot be read.
    """
    graph = _scene(path).graph
    return {str(node): fixed(np.array(graph.get(node)[0][:3, 3], dtype=np.float64)) for node in graph.nodes}


def bare_mesh(path: Path) -> tuple[Float64[np.ndarray, "vertices 3"], Int64[np.ndarray, "triangles 3"]]:
    """Read the vertices and triangles of a file as they are, in units of the file.

    Raises
    ------
    InvalidInput
        When there is no such file, it cannot be read, is beyond the limits, or holds no triangles.
    """
    scene = _scene(path)
    mesh = _read(path, scene.to_mesh)
    if len(mesh.faces) == 0:
        raise InvalidInput(
            f"{path.name} holds 0 triangles; give a file with a closed triangle surface.", code="no_triangles"
        )
    with about(path.name):
        check_triangles(len(mesh.faces))
        if mesh.vertices.shape[1:] != (3,):
            sentence = f"its vertices have {mesh.vertices.shape[1]} coordinates, not 3."
            raise InvalidInput(sentence, code="file_unreadable")
    return np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64)


def bare_vertices(path: Path) -> Float64[np.ndarray, "vertices 3"]:
    """Read the vertices of a file or the points of a cloud in PLY, in units of the file; errors as of ``bare_mesh``."""
    scene = _scene(path)
    parts = [np.empty((0, 3))]
    return _read(path, lambda: np.concatenate([*parts, *(one.vertices for one in scene.geometry.values())]))


def _scene(path: Path) -> Any:
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InvalidInput(
            f"{path.name} ends in {path.suffix!r}, but surfaces are read from {', '.join(SUFFIXES)}.",
            code="unknown_ending",
        )
    if not path.is_file():
        raise InvalidInput(f"there is no file {path}; 0 triangles were read.", code="file_missing")
    raw = bytes_of(path, LARGEST_MESH_FILE)
    with about(f"{path.name} ({len(raw)} bytes)"):
        raw = check_counts(suffix, raw)
    import trimesh  # takes as long to import as all the rest of airtact

    logging.getLogger("trimesh").addHandler(logging.NullHandler())  # or it would print tracebacks of its own
    settings = {"file_type": suffix[1:], "resolver": OwnFolder(path), "process": False}
    if suffix != ".stl":
        settings["skip_materials"] = True
    return _read(path, lambda: trimesh.load_scene(io.BytesIO(raw), **settings))


def _read(path: Path, step: Callable[[], Any]) -> Any:
    """Do a step of reading; whatever it raises, and a number that it would pass over, is a fault of the file."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            warnings.filterwarnings("error", category=RuntimeWarning)
            warnings.filterwarnings("error", "string or file could not be read", DeprecationWarning)
            return step()
    except InvalidInput as fault:
        raise InvalidInput(f"{path.name}: {fault}", code=fault.code) from None
    except Exception as fault:  # every reader of trimesh has its own way to fail on a damaged file
        size = path.stat().st_size
        raise InvalidInput(
            f"{path.name} ({size} bytes) cannot be read: it is damaged ({type(fault).__name__}: {fault}).",
            code="file_unreadable",
        ) from fault
