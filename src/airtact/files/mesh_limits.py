"""What a file of a surface holds, counted before a reader expands it, and which files it may lead to.

Materials, textures, normals and colours are never read. A GLB or glTF says in its JSON how much it
will become; the lines of a text are counted. That bounds what a reader takes for a plain file; for
others it works in a process of its own (``airtact.files.apart``).
"""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from airtact.errors import (
    LARGEST_MESH_FILE,
    MOST_FILE_TRIANGLES,
    MOST_MESH_LINES,
    MOST_NODES,
    InvalidInput,
)
from airtact.files.bounded import bytes_of

MOST_LEVELS = 256
"""Nodes of a scene graph above each other."""

MOST_PROPERTIES = 256
"""Elements and properties in the header of a PLY file."""

MOST_COMMAS = 1_000_000
"""Values in the JSON of a GLB or glTF file."""

LARGEST_PLAIN = 4_000_000
"""Longest file that its counts alone bound [bytes] ..."""

PLAIN_NODES = 128
"""... and most nodes of its graph."""

SHAPES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
SIZES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
"""Numbers of a value and bytes of a number in an accessor: glTF 2.0, section 3.6.2."""

BREAKS = b"\n\r\x0b\x0c\x1c\x1d\x1e"
"""Bytes at which Python begins a new line of text."""

OBJ_LINE = re.compile(rb"^[ \t]*([vf])[ \t]+([^\n]*)$", re.MULTILINE)
FACE_CORNER = re.compile(rb"([-+]?\d{1,18})(?:/[-+/\d]*)?(?:\s|$)")


class OwnFolder:
    """Opens what a glTF file names, in its own folder only, and ``LARGEST_MESH_FILE`` bytes in all at most."""

    def __init__(self, path: Path) -> None:
        self.folder, self.left = path.parent.resolve(), LARGEST_MESH_FILE
        self.file_name = path.name

    def __getitem__(self, name: str) -> bytes:
        """Read a file by its name as it stands in the glTF file."""
        path = (self.folder / str(name)).resolve()
        if not path.is_relative_to(self.folder):
            sentence = f"it names {name!r}, which is 1 file outside its folder; put what it needs beside it."
            raise InvalidInput(sentence, code="file_unreadable")
        found = bytes_of(path, self.left)
        self.left -= len(found)
        return found

    get = __getitem__


def check_counts(suffix: str, raw: bytes) -> bytes:
    """Count what a file holds, and return it without what is not needed: an OBJ with vertices and faces only.

    Parameters
    ----------
    suffix : the ending of the file's name in small letters.
    raw : all of its bytes.

    Raises
    ------
    InvalidInput
        "too_many", "file_too_large", "too_many", "file_too_large", or "file_unreadable".
    """
    if suffix == ".stl":
        _check_stl(raw)
    elif suffix == ".ply":
        _check_ply(raw)
    elif suffix == ".obj":
        return _plain_obj(raw)
    else:
        _check_graph(_json_of(raw) if suffix == ".glb" else _parsed(raw))
    return raw


def is_plain(suffix: str, raw: bytes, needed: bytes) -> bool:
    """Whether its counts bound what a reader takes for a file.

    A binary STL is plain. Others are where what is ``needed`` has ``LARGEST_PLAIN`` bytes at most,
    and if a PLY has no elements but vertices and faces, or a glTF scene is in one file without
    extensions and has ``PLAIN_NODES`` at most.
    """
    if suffix == ".stl" and len(raw) == 84 + 50 * int.from_bytes(raw[80:84], "little"):
        return True
    if len(needed) > LARGEST_PLAIN:
        return False
    if suffix == ".ply":
        elements = re.findall(rb"^element\s+(\w+)", raw.partition(b"end_header")[0], re.MULTILINE)
        return set(elements) <= {b"vertex", b"face"}
    if suffix in (".glb", ".gltf"):
        tree = _json_of(raw) if suffix == ".glb" else _parsed(raw)
        return (
            not tree.get("extensionsUsed")
            and len(tree.get("nodes", [])) <= PLAIN_NODES
            and all(
                str(one.get("uri", "data:")).startswith("data:") for one in tree.get("buffers", [])
            )
        )
    return True


def check_triangles(count: int) -> None:
    """Raise "too_many" beyond ``MOST_FILE_TRIANGLES``."""
    if count > MOST_FILE_TRIANGLES:
        sentence = (
            f"it has {count:,} triangles, more than {MOST_FILE_TRIANGLES:,}; simplify it, as with MeshLab: edges of "
            "1 mm are fine enough for 40 kHz."
        )
        raise InvalidInput(sentence, code="too_many")


def _check_lines(raw: bytes) -> None:
    count = sum(raw.count(byte) for byte in BREAKS)
    if count > MOST_MESH_LINES:
        sentence = f"it has {count:,} lines, more than {MOST_MESH_LINES:,}; simplify it, or save it in binary."
        raise InvalidInput(sentence, code="file_too_large")


def _check_stl(raw: bytes) -> None:
    count = int.from_bytes(raw[80:84], "little")
    if len(raw) == 84 + 50 * count:
        check_triangles(count)
        return
    _check_lines(raw)
    check_triangles(raw.lower().count(b"vertex") // 3)
    _check_pieces(raw.lower().count(b"endsolid"), "solids")
    try:
        raw.decode()
    except UnicodeDecodeError as error:
        sentence = (
            f"its {len(raw):,} bytes are neither those of {count:,} triangles, as its head says, nor text: byte "
            f"{error.start} is not UTF-8; export it anew."
        )
        raise InvalidInput(sentence, code="file_unreadable") from None


def _check_ply(raw: bytes) -> None:
    head = raw.partition(b"end_header")[0]
    _check_pieces(
        head.count(b"element") + head.count(b"property"), "elements and properties", MOST_PROPERTIES
    )
    check_triangles(_count_of(b"face", head))
    # A vertex that no triangle has costs memory too; with a corner each of its own a triangle has
    # three.
    check_triangles(_count_of(b"vertex", head) // 3)
    if b"ascii" in head:
        _check_lines(raw)


def _count_of(element: bytes, head: bytes) -> int:
    found = re.search(rb"element\s+" + element + rb"\s+(\d{1,18})\s", head)
    return int(found[1]) if found else 0


def _check_pieces(count: int, what: str, most: int = MOST_NODES) -> None:
    if count > most:
        sentence = f"it has {count:,} {what}, more than {most:,}; join them before it is saved."
        raise InvalidInput(sentence, code="too_many")


def _plain_obj(raw: bytes) -> bytes:
    """Keep vertices and faces, and of a face's corners the numbers of the vertices.

    Numbers that count from the end are rejected where vertices follow: which ones they mean depends
    on the line.
    """
    _check_lines(raw)
    raw = raw.replace(b"\r\n", b"\n").replace(b"\r", b"\n").replace(b"\\\n", b" ")
    lines, faces, vertices_end = [], 0, 0
    first_from_end = None
    for kind, words in OBJ_LINE.findall(raw):
        if kind == b"v":
            lines.append(b"v " + b" ".join(words.split()[:3]))
            vertices_end = len(lines)
            continue
        corners = FACE_CORNER.findall(words)
        if len(corners) < len(words.split()) or any(int(one) == 0 for one in corners):
            sentence = f"the corners of face {len(lines) - vertices_end} are {words[:40].decode(errors='replace')!r}"
            raise InvalidInput(
                f"{sentence}, but they are numbers of vertices from 1.", code="file_unreadable"
            )
        faces += max(len(corners) - 2, 0)
        check_triangles(faces)
        if first_from_end is None and any(one.startswith(b"-") for one in corners):
            first_from_end = len(lines)
        lines.append(b"f " + b" ".join(corners))
    if first_from_end is not None and first_from_end < vertices_end:
        sentence = "1 face or more counts its vertices from the end, and vertices follow; count them from 1."
        raise InvalidInput(sentence, code="file_unreadable")
    return b"\n".join(lines)


def _json_of(raw: bytes) -> Mapping[str, Any]:
    """Read the JSON of a GLB file, its first chunk: glTF 2.0, section 4.4."""
    if len(raw) < 20 or raw[:4] != b"glTF" or raw[16:20] != b"JSON":
        raise InvalidInput(
            f"its {len(raw)} bytes do not begin as a GLB file does.", code="file_unreadable"
        )
    return _parsed(raw[20 : 20 + int.from_bytes(raw[12:16], "little")])


def _parsed(words: bytes) -> Mapping[str, Any]:
    if words.count(b",") > MOST_COMMAS:
        sentence = f"its JSON has {words.count(b','):,} values, more than {MOST_COMMAS:,}; leave out what is no mesh."
        raise InvalidInput(sentence, code="file_too_large")
    try:
        tree = json.loads(words)
    except (ValueError, RecursionError) as error:
        raise InvalidInput(f"its JSON is damaged: {error}.", code="file_unreadable") from None
    if not isinstance(tree, dict):
        raise InvalidInput(
            f"its JSON is 1 {type(tree).__name__}, not an object.", code="file_unreadable"
        )
    return tree


def _check_graph(tree: Mapping[str, Any]) -> None:
    """Count nodes, levels, numbers and triangles of a glTF scene as they will be when all is in its place."""
    try:
        nodes, meshes = tree.get("nodes", []), tree.get("meshes", [])
        children = [node.get("children", []) for node in nodes]
        _check_pieces(
            len(nodes) + sum(map(len, children)), "nodes and their children", 2 * MOST_NODES
        )
        _check_pieces(sum(len(mesh["primitives"]) for mesh in meshes), "meshes")
        _check_levels(tree, children)
        _check_sizes(tree)
        triangles = [sum(_triangles(tree, one) for one in mesh["primitives"]) for mesh in meshes]
        check_triangles(sum(triangles[node["mesh"]] for node in nodes if "mesh" in node))
    except InvalidInput:
        raise
    except Exception as error:  # whatever stands in the JSON where something else belongs
        sentence = f"its JSON is not that of glTF 2.0 ({type(error).__name__}: {error})."
        raise InvalidInput(sentence, code="file_unreadable") from None


def _check_levels(tree: Mapping[str, Any], children: list[list[int]]) -> None:
    """Follow the children of each node from the roots; a node that is reached again has another parent, or itself."""
    scenes = tree.get("scenes", [])
    level = list(scenes[tree.get("scene", 0)].get("nodes", [])) if scenes else []
    reached: set[int] = set()
    for _ in range(MOST_LEVELS):
        reached.update(level)
        level = [child for node in level for child in children[node]]
        if reached.intersection(level) or len(set(level)) < len(level):
            raise InvalidInput(
                "1 node or more is the child of several, or of itself.", code="file_unreadable"
            )
        if not level:
            return
    sentence = f"its nodes stand more than {MOST_LEVELS} levels deep in each other; flatten them."
    raise InvalidInput(sentence, code="file_too_large")


def _check_sizes(tree: Mapping[str, Any]) -> None:
    """Add the bytes of all views and accessors, which a reader copies."""
    views = [int(one["byteLength"]) for one in tree.get("bufferViews", [])]
    accessors = [
        (int(one["count"]), SHAPES[one["type"]] * SIZES[one["componentType"]])
        for one in _accessors(tree)
    ]
    if min([*views, *(count for count, _ in accessors)], default=0) < 0:
        raise InvalidInput(
            "1 view or accessor or more has fewer than 0 values.", code="file_unreadable"
        )
    size = max(sum(views), sum(count * each for count, each in accessors))
    if size > LARGEST_MESH_FILE:
        sentence = f"its accessors and views have {size:,} bytes, more than {LARGEST_MESH_FILE:,}; simplify it."
        raise InvalidInput(sentence, code="file_too_large")


def _accessors(tree: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    return tree.get("accessors", [])


def _triangles(tree: Mapping[str, Any], primitive: Mapping[str, Any]) -> int:
    """Count the triangles of a primitive: corners over 3, or one a corner in a strip."""
    if primitive.get("mode", 4) not in (4, 5):
        return 0
    used = [
        primitive["attributes"]["POSITION"],
        *([primitive["indices"]] if "indices" in primitive else []),
    ]
    for index in used:
        if "bufferView" not in _accessors(tree)[index] or "sparse" in _accessors(tree)[index]:
            how = "its numbers are compressed or sparse; export it without compression."
            raise InvalidInput(f"accessor {index} holds 0 bytes: {how}", code="file_unreadable")
    corners = int(_accessors(tree)[used[-1]]["count"])
    return corners // 3 if primitive.get("mode", 4) == 4 else corners
