"""Reads what trimesh reads, after what a file holds was counted: as arrays, in units of the file."""

import io
import logging
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from airtact.errors import LARGEST_MESH_FILE, InvalidInput, about
from airtact.files.apart import out_of_memory, read_apart
from airtact.files.bounded import Arrays, bytes_of
from airtact.files.mesh_limits import OwnFolder, check_counts, check_triangles, is_plain

SUFFIXES = (".stl", ".ply", ".obj", ".glb", ".gltf")
"""File name endings that are read."""

UNNEEDED = ("networkx", "scipy", "meshio", "PIL", "shapely", "sympy", "lxml", "jsonschema", "httpx")
"""Packages that trimesh imports where they are installed, but not for what is read here: most of its start."""


def arrays_of(path: Path, reader: Callable[[Path], Arrays]) -> Arrays:
    """Read a file by one of the functions below, in a process of its own unless it is plain (``is_plain``).

    Raises
    ------
    InvalidInput
        When there is no such file, it cannot be read, or is beyond the limits.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InvalidInput(
            f"{path.name} ends in {path.suffix!r}, but surfaces are read from {', '.join(SUFFIXES)}.",
            code="unknown_format",
        )
    if not path.is_file():
        raise InvalidInput(f"there is no file {path}; 0 triangles were read.", code="file_missing")
    raw = bytes_of(path, LARGEST_MESH_FILE)
    with about(f"{path.name} ({len(raw)} bytes)"):
        plain = is_plain(suffix, raw, check_counts(suffix, raw))
    return reader(path) if plain else read_apart(reader, path, without=UNNEEDED)


def mesh_arrays(path: Path) -> Arrays:
    """Read "vertices" (V, 3) and "triangles" (T, 3) of all that is in a file, where its nodes put it."""
    scene = _scene(path)
    mesh = _read(path, scene.to_mesh)
    if len(mesh.faces) == 0:
        raise InvalidInput(
            f"{path.name} holds 0 triangles; give a file with a closed triangle surface.",
            code="empty",
        )
    with about(path.name):
        check_triangles(len(mesh.faces))
        if mesh.vertices.shape[1:] != (3,):
            sentence = f"its vertices have {mesh.vertices.shape[1]} coordinates, not 3."
            raise InvalidInput(sentence, code="file_unreadable")
    vertices, triangles = (
        np.asarray(mesh.vertices, dtype=np.float64),
        np.asarray(mesh.faces, dtype=np.int64),
    )
    return {"vertices": vertices, "triangles": triangles}


def vertex_arrays(path: Path) -> Arrays:
    """Read the "vertices" (V, 3) of a file, or the points of a cloud."""
    scene = _scene(path)
    parts = [np.empty((0, 3))]
    joined = _read(
        path, lambda: np.concatenate([*parts, *(one.vertices for one in scene.geometry.values())])
    )
    return {"vertices": joined}


def node_arrays(path: Path) -> Arrays:
    """Read the "names" (N,) and "positions" (N, 3) of the nodes of a file."""
    graph = _scene(path).graph
    positions = [np.array(graph.get(node)[0][:3, 3], dtype=np.float64) for node in graph.nodes]
    return {
        "names": np.array([str(node) for node in graph.nodes]),
        "positions": np.array(positions).reshape(-1, 3),
    }


def _scene(path: Path) -> Any:
    suffix, raw = path.suffix.lower(), bytes_of(path, LARGEST_MESH_FILE)
    with about(f"{path.name} ({len(raw)} bytes)"):
        raw = check_counts(suffix, raw)
    import trimesh  # takes as long to import as all the rest of airtact

    logging.getLogger("trimesh").addHandler(
        logging.NullHandler()
    )  # or it would print tracebacks of its own
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
    except MemoryError:
        raise out_of_memory(path.name) from None
    except Exception as fault:  # every reader of trimesh has its own way to fail on a damaged file
        size = path.stat().st_size
        raise InvalidInput(
            f"{path.name} ({size} bytes) cannot be read: it is damaged ({type(fault).__name__}: {fault}).",
            code="file_unreadable",
        ) from fault
