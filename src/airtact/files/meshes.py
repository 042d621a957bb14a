"""Surfaces and scene graphs read by trimesh, after what a file holds is counted.

Arrays in units of the file.

trimesh expands what a small file may only name: instances of a mesh, corners of one face, accessors
that share their bytes. So a GLB or glTF is measured by its JSON and the others by their headers and
lines before it reads them. Materials, textures, normals and colours are never read.
"""

import io
import json
import logging
import re
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64

from airtact.errors import LARGEST_MESH_FILE, InvalidInput, about
from airtact.files.bounded import bytes_of

# File name endings that are read
SUFFIXES = (".stl", ".ply", ".obj", ".glb", ".gltf")

# Largest number of triangles of a surface from a file: reading and checking it takes up to 10 s
# and 0.9 GB
MAX_FILE_TRIANGLES = 250_000

# Largest number of lines of a surface in text: an STL of MAX_FILE_TRIANGLES has 1,750,000
MAX_MESH_LINES = 2_500_000

# Largest number of nodes, meshes or solids in a file: a chain of so many nodes takes 6 s
MAX_PIECES = 1024


def read_mesh(
    path: Path,
) -> tuple[Float64[np.ndarray, "vertices 3"], Int64[np.ndarray, "triangles 3"]]:
    """Read the vertices and triangles of all that is in a file, where its nodes put it.

    Raises
    ------
    InvalidInput
        When there is no such file, it cannot be read, is beyond the limits, or holds no triangles.
    """
    scene = _scene(path)
    with _describing_damage(path):
        parts = [scene.geometry[scene.graph[node][1]] for node in scene.graph.nodes_geometry]
        _check_triangles(sum(len(getattr(part, "faces", ())) for part in parts))
        mesh = scene.to_mesh()
    with about(path.name):
        if len(mesh.faces) == 0:
            raise InvalidInput(
                "it holds no triangles; give a file with a closed triangle surface.", code="empty"
            )
        if mesh.vertices.shape[1:] != (3,):
            raise InvalidInput("its vertices do not have 3 coordinates.", code="file_unreadable")
    return np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)


def read_vertices(path: Path) -> Float64[np.ndarray, "vertices 3"]:
    """Read the vertices of a file, or the points of a cloud; raise as ``read_mesh``."""
    scene = _scene(path)
    with _describing_damage(path):
        parts = [geometry.vertices for geometry in scene.geometry.values()]
        return np.concatenate([np.empty((0, 3)), *parts])


def read_node_positions(path: Path) -> Mapping[str, Float64[np.ndarray, "3"]]:
    """Read the positions of the named nodes of a file; raise as ``read_mesh``."""
    graph = _scene(path).graph
    return {
        str(node): np.array(graph.get(node)[0][:3, 3], dtype=np.float64) for node in graph.nodes
    }


def _scene(path: Path) -> Any:
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InvalidInput(
            f"{path.name} ends in {path.suffix!r}, but surfaces are read from "
            f"{', '.join(SUFFIXES)}.",
            code="unknown_format",
        )
    if not path.is_file():
        raise InvalidInput(f"there is no file {path}.", code="file_missing")
    content = bytes_of(path, LARGEST_MESH_FILE)
    with about(path.name):
        if suffix == ".stl":
            _check_stl(content)
        elif suffix == ".ply":
            _check_ply(content)
        elif suffix != ".obj":
            _check_scene_graph(_json_of(content) if suffix == ".glb" else _parsed(content))
    import trimesh  # takes as long to import as all the rest of airtact

    # Otherwise it prints tracebacks of its own.
    logging.getLogger("trimesh").addHandler(logging.NullHandler())
    settings = {"file_type": suffix[1:], "resolver": _OwnFolder(path), "process": False}
    if suffix != ".stl":
        settings["skip_materials"] = True
    with _describing_damage(path):
        if suffix == ".obj":
            return trimesh.Scene(_obj_mesh(content))
        return trimesh.load_scene(io.BytesIO(content), **settings)


@contextmanager
def _describing_damage(path: Path) -> Iterator[None]:
    """Turn whatever trimesh raises or warns of into a fault of the file."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            warnings.filterwarnings("error", category=RuntimeWarning)
            warnings.filterwarnings("error", "string or file could not be read", DeprecationWarning)
            yield
    except InvalidInput as fault:
        raise InvalidInput(f"{path.name}: {fault}", code=fault.code) from None
    except Exception as fault:  # each of trimesh's readers fails in its own way on a damaged file
        raise InvalidInput(
            f"{path.name} cannot be read: it is damaged ({type(fault).__name__}: {fault}).",
            code="file_unreadable",
        ) from fault


class _OwnFolder:
    """Opens what a glTF file names: in its own folder only, and with a limit in all."""

    def __init__(self, path: Path) -> None:
        self.folder = path.parent.resolve()
        self.file_name = path.name
        self.left = LARGEST_MESH_FILE

    def __getitem__(self, name: str) -> bytes:
        """Read a file by its name as it stands in the glTF file."""
        path = (self.folder / str(name)).resolve()
        if not path.is_relative_to(self.folder):
            raise InvalidInput(
                f"it names {name!r}, which is outside its folder; put what it needs beside it.",
                code="file_unreadable",
            )
        content = bytes_of(path, self.left)
        self.left -= len(content)
        return content

    get = __getitem__


def _check_triangles(count: int) -> None:
    if count > MAX_FILE_TRIANGLES:
        raise InvalidInput(
            f"it has {count:,} triangles, more than {MAX_FILE_TRIANGLES:,}; simplify it, as with "
            "MeshLab: edges of 1 mm are fine enough for 40 kHz.",
            code="too_many",
        )


def _check_pieces(count: int, what: str, largest: int = MAX_PIECES) -> None:
    if count > largest:
        raise InvalidInput(
            f"it has {count:,} {what}, more than {largest:,}; join them before it is saved.",
            code="too_many",
        )


def _check_lines(content: bytes) -> None:
    breaks = b"\n\r\x0b\x0c\x1c\x1d\x1e"  # bytes at which Python begins a new line of text
    count = sum(content.count(byte) for byte in breaks)
    if count > MAX_MESH_LINES:
        raise InvalidInput(
            f"it has {count:,} lines, more than {MAX_MESH_LINES:,}; simplify it, or save it in "
            "binary.",
            code="file_too_large",
        )


def _check_stl(content: bytes) -> None:
    count = int.from_bytes(content[80:84], "little")
    if len(content) == 84 + 50 * count:
        _check_triangles(count)
        return
    _check_lines(content)
    lower = content.lower()
    _check_triangles(lower.count(b"vertex") // 3)
    _check_pieces(lower.count(b"endsolid"), "solids")
    try:
        content.decode()
    except UnicodeDecodeError as error:
        raise InvalidInput(
            f"its {len(content):,} bytes are neither those of {count:,} triangles, as its head "
            f"says, nor text: byte {error.start} is not UTF-8; export it again.",
            code="file_unreadable",
        ) from None


def _check_ply(content: bytes) -> None:
    head, _, body = content.partition(b"end_header")
    pieces = head.count(b"element") + head.count(b"property")
    _check_pieces(pieces, "elements and properties", 256)
    counts = {b"vertex": 0, b"face": 0}
    values = 0
    for element in head.split(b"element")[1:]:
        match = re.match(rb"\s+(\w+)\s+(\d{1,18})\s", element)
        if match:
            counts[match[1]] = int(match[2])
            values += int(match[2]) * element.count(b"property")
    _check_triangles(counts[b"face"])
    # A vertex that no triangle has costs memory too; a triangle may have three of its own.
    _check_triangles(counts[b"vertex"] // 3)
    others = sum(counts.values()) - counts[b"face"] - counts[b"vertex"]
    _check_pieces(others, "elements beside vertices and faces", 100_000)
    # A face of millions of corners would become as many triangles.
    corners = 4 * MAX_FILE_TRIANGLES
    if b"ascii" in head:
        _check_lines(content)
        too_long = sum(body.count(byte) for byte in b" \t") > values + corners
    else:
        too_long = len(body) > 8 * values + 4 * corners
    if too_long:
        raise InvalidInput(
            f"its {len(body):,} bytes are more than its elements need; leave out what is no mesh.",
            code="file_too_large",
        )


def _obj_mesh(content: bytes) -> Any:
    """Read the vertices and faces of an OBJ file; trimesh's own reader is slow with materials."""
    import trimesh

    _check_lines(content)
    text = re.sub(r"\\\r?\n", " ", content.decode(errors="replace"))
    vertices: list[tuple[float, float, float]] = []
    triangles: list[tuple[int, int, int]] = []
    for line in text.splitlines():
        kind, *words = line.split(maxsplit=1) or [""]
        if kind == "f":  # corners of one face become triangles
            _check_triangles(len(triangles) + line.count(" ") + line.count("\t") - 2)
        try:
            if kind == "v":
                x, y, z = map(float, words[0].split()[:3])
                vertices.append((x, y, z))
            elif kind == "f":
                corners = [_vertex(word, len(vertices)) for word in words[0].split()]
                triangles += [(corners[0], *pair) for pair in pairwise(corners[1:])]
        except (ValueError, IndexError):
            raise InvalidInput(
                f"the line {line[:40]!r} holds no vertex, and no numbers of vertices from 1.",
                code="file_unreadable",
            ) from None
    _check_triangles(len(vertices) // 3)  # as in a PLY file
    faces = np.reshape(triangles, (-1, 3)).astype(np.int64)
    return trimesh.Trimesh(np.reshape(vertices, (-1, 3)), faces, process=False)


def _vertex(word: str, count: int) -> int:
    """Index of the vertex of a corner, which counts from 1, or back from the last of ``count``."""
    number = int(word.split("/")[0])
    if number == 0 or not -count <= number < 10**9:
        raise ValueError
    return number - 1 if number > 0 else count + number


def _json_of(content: bytes) -> Mapping[str, Any]:
    """Read the JSON of a GLB file, its first chunk: glTF 2.0, section 4.4."""
    if len(content) < 20 or content[:4] != b"glTF" or content[16:20] != b"JSON":
        raise InvalidInput("it does not begin as a GLB file does.", code="file_unreadable")
    return _parsed(content[20 : 20 + int.from_bytes(content[12:16], "little")])


def _parsed(text: bytes) -> Mapping[str, Any]:
    if text.count(b",") > 1_000_000:
        raise InvalidInput(
            f"its JSON has {text.count(b','):,} values, more than 1,000,000; leave out what is no "
            "mesh.",
            code="file_too_large",
        )
    try:
        tree = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InvalidInput(f"its JSON is damaged: {error}.", code="file_unreadable") from None
    if not isinstance(tree, dict):
        raise InvalidInput("its JSON is not an object.", code="file_unreadable")
    return tree


def _check_scene_graph(tree: Mapping[str, Any]) -> None:
    """Count nodes, numbers and corners of a glTF scene before trimesh expands it."""
    try:
        _check_pieces(len(tree.get("nodes", [])), "nodes")
        primitives = [item for mesh in tree.get("meshes", []) for item in mesh["primitives"]]
        _check_pieces(len(primitives), "meshes")
        _check_sizes(tree)
        accessors = tree.get("accessors", [])
        positions = [item["attributes"]["POSITION"] for item in primitives]
        indices = [item.get("indices", item["attributes"]["POSITION"]) for item in primitives]
        used = [accessors[index] for index in positions + indices]
        if any("bufferView" not in item or "sparse" in item for item in used):
            raise InvalidInput(
                "its numbers are compressed or sparse; export it without compression.",
                code="file_unreadable",
            )
        _check_triangles(sum(int(item["count"]) for item in used) // 6)  # with 3 vertices each
    except InvalidInput:
        raise
    except Exception as error:  # the JSON may hold anything anywhere
        raise InvalidInput(
            f"its JSON is not that of glTF 2.0 ({type(error).__name__}: {error}).",
            code="file_unreadable",
        ) from None


def _check_sizes(tree: Mapping[str, Any]) -> None:
    """Add the bytes of all views and accessors, which trimesh copies (glTF 2.0, section 3.6.2)."""
    numbers = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
    number_bytes = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
    views = [int(view["byteLength"]) for view in tree.get("bufferViews", [])]
    accessors = [
        int(item["count"]) * numbers[item["type"]] * number_bytes[item["componentType"]]
        for item in tree.get("accessors", [])
    ]
    if min([*views, *accessors], default=0) < 0:
        raise InvalidInput("a view or accessor has a negative size.", code="file_unreadable")
    size = max(sum(views), sum(accessors))
    if size > LARGEST_MESH_FILE:
        raise InvalidInput(
            f"its accessors and views have {size:,} bytes, more than {LARGEST_MESH_FILE:,}; "
            "simplify it.",
            code="file_too_large",
        )
