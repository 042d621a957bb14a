"""Triangle meshes, point clouds and node positions from files, in the files' units.

trimesh reads PLY. STL, OBJ and GLB are read here, because importing trimesh takes 0.3 s, and it
skips solids that end in "end solid". Materials, textures, normals and colours are ignored.
"""

import io
import logging
import re
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64
from scipy.spatial.transform import Rotation

from airtact.errors import LARGEST_MESH_FILE, InvalidInput, about
from airtact.files.bounded import bytes_of, json_of

# Supported file name extensions
SUFFIXES = (".stl", ".ply", ".obj", ".glb")

# Largest number of triangles of a surface from a file: reading and checking it takes up to 10 s
# and 0.9 GB
MAX_FILE_TRIANGLES = 250_000


Mesh = tuple[Float64[np.ndarray, "vertices 3"], Int64[np.ndarray, "triangles 3"]]


def read_mesh(path: Path) -> Mesh:
    """Read the vertices and triangles of a file, with all nodes placed by their transforms.

    Raises
    ------
    InvalidInput
        If the file is missing, unreadable, too large, or contains no triangles.
    """
    vertices, triangles = _read(path)
    with about(path.name):
        if len(triangles) == 0:
            raise InvalidInput(
                "the file contains no triangles; use one with a closed triangle surface.",
                code="empty",
            )
        _check_triangles(len(triangles))
        if vertices.shape[1:] != (3,):
            raise InvalidInput(
                "the vertices do not have 3 coordinates; export the file as a 3-D mesh.",
                code="file_unreadable",
            )
    return np.asarray(vertices, np.float64), np.asarray(triangles, np.int64)


def read_vertices(path: Path) -> Float64[np.ndarray, "vertices 3"]:
    """Return the vertices of a mesh or point cloud, or raise an error as ``read_mesh`` does."""
    return np.asarray(_read(path)[0], np.float64)


def read_node_positions(path: Path) -> Mapping[str, Float64[np.ndarray, "3"]]:
    """Return the positions of named nodes, or raise an error as ``read_mesh`` does."""
    content = _content(path)
    if path.suffix.lower() != ".glb":
        return {}
    with _describing_damage(path):
        tree, _ = _chunks(content)
        return {
            str(tree["nodes"][index].get("name", index)): frame[:3, 3]
            for index, frame in _frames(tree).items()
        }


def _content(path: Path) -> bytes:
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InvalidInput(
            f"{path.name} ends in {path.suffix!r}, but surface files must end in "
            f"{', '.join(SUFFIXES)}.",
            code="unknown_format",
        )
    return bytes_of(path, LARGEST_MESH_FILE)


def _read(path: Path) -> tuple[Any, Any]:
    content = _content(path)
    readers = {".stl": _stl, ".obj": _obj, ".glb": _glb, ".ply": _ply}
    with _describing_damage(path):
        return readers[path.suffix.lower()](content)


@contextmanager
def _describing_damage(path: Path) -> Iterator[None]:
    """Convert all errors and warnings of the readers to ``InvalidInput``."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            warnings.filterwarnings("error", category=RuntimeWarning)
            warnings.filterwarnings("error", "string or file could not be read", DeprecationWarning)
            yield
    except InvalidInput as fault:
        raise InvalidInput(f"{path.name}: {fault}", code=fault.code) from None
    except Exception as fault:  # each reader of trimesh fails in a different way on damaged files
        raise InvalidInput(
            f"{path.name} cannot be read: it is damaged ({type(fault).__name__}: {fault}). Export "
            "it again.",
            code="file_unreadable",
        ) from fault


def _check_triangles(count: int) -> None:
    if count > MAX_FILE_TRIANGLES:
        raise InvalidInput(
            f"the mesh has {count:,} triangles, but at most {MAX_FILE_TRIANGLES:,} are allowed; "
            "simplify it, for example with MeshLab: edges of 1 mm are short enough for 40 kHz.",
            code="too_many",
        )


def _stl(content: bytes) -> tuple[Any, Any]:
    """Read the vertices and triangles of a binary or ASCII STL file."""
    count = int.from_bytes(content[80:84], "little")
    if len(content) == 84 + 50 * count:
        _check_triangles(count)
        facet = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
        corners = np.frombuffer(content, facet, offset=84)["corners"]
    else:
        text = content.lower()
        if b"solid" not in text or b"\0" in text:
            raise InvalidInput(
                f"the size of {len(content):,} bytes does not match the {count:,} triangles of a "
                "binary STL file, and the file is not an ASCII STL file; export it again.",
                code="file_unreadable",
            )
        numbers = re.findall(r"vertex\s+(\S+)\s+(\S+)\s+(\S+)", text.decode(errors="replace"))
        if any("," in number for vertex in numbers[:1] for number in vertex):
            raise InvalidInput(
                "the numbers have decimal commas; export the file with decimal points.",
                code="file_unreadable",
            )
        corners = np.array([[float(_plain(number)) for number in vertex] for vertex in numbers])
    corners = corners.reshape(-1, 3, 3)
    return corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3)


def _plain(word: str) -> str:
    """Return the text of a number, or raise ValueError if only Python accepts it as a number."""
    if "_" in word or not word.isascii():
        raise ValueError(f"{word!r} is not a number")
    return word


def _obj(content: bytes) -> tuple[Any, Any]:
    """Read the vertices and faces of an OBJ file."""
    text = re.sub(r"\\\r?\n", " ", content.decode(errors="replace"))
    vertices: list[list[float]] = []
    triangles: list[tuple[int, ...]] = []
    for line in text.splitlines():
        kind, *words = line.split() or [""]
        if kind == "v":
            vertices.append([float(_plain(word)) for word in words[:3]])
        elif kind == "f":
            numbers = [int(_plain(word.split("/")[0])) for word in words]
            # Negative numbers count back from the newest vertex; 0 becomes -1, which is rejected.
            corners = [n - 1 if n >= 0 else len(vertices) + n for n in numbers]
            triangles += [(corners[0], *pair) for pair in pairwise(corners[1:])]
    return np.reshape(vertices, (-1, 3)), np.reshape(triangles, (-1, 3)).astype(np.int64)


def _ply(content: bytes) -> tuple[Any, Any]:
    """Read the vertices and triangles of a PLY file, or the points of a cloud."""
    import trimesh  # imported here because this takes as long as importing the rest of airtact

    # Silence the tracebacks that trimesh prints.
    logging.getLogger("trimesh").addHandler(logging.NullHandler())
    scene = trimesh.load_scene(
        io.BytesIO(content), file_type="ply", skip_materials=True, process=False
    )
    (mesh,) = scene.geometry.values()
    return mesh.vertices, getattr(mesh, "faces", np.empty((0, 3), dtype=np.int64))


def _glb(content: bytes) -> tuple[Any, Any]:
    """Read the triangles of all nodes of a GLB file (glTF 2.0, Khronos Group)."""
    tree, numbers = _chunks(content)
    frames = _frames(tree)
    vertices = [np.empty((0, 3))]
    triangles = [np.empty((0, 3), dtype=np.int64)]
    count = 0
    for index, frame in frames.items():
        node = tree["nodes"][index]
        for primitive in tree["meshes"][node["mesh"]]["primitives"] if "mesh" in node else ():
            mode = primitive.get("mode", 4)
            if mode not in (4, 5):  # points, lines and fans
                continue
            places = _numbers(tree, numbers, primitive["attributes"]["POSITION"], 3)
            corners = np.arange(len(places))
            if "indices" in primitive:
                corners = _numbers(tree, numbers, primitive["indices"], 1)[:, 0].astype(np.int64)
            if mode == 5:  # in a strip, each further corner adds a triangle
                strip = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
                strip[1::2] = strip[1::2, ::-1]
                corners = strip
            if "skin" in node:  # the position of the node itself does not matter: section 3.7.3
                frame = _frame_of_joints(tree, numbers, tree["skins"][node["skin"]], frames, places)
            corners = corners.reshape(-1, 3)
            if np.linalg.det(frame[:3, :3]) < 0.0:
                corners = corners[:, ::-1]
            triangles.append(corners + sum(map(len, vertices)))
            vertices.append(places @ frame[:3, :3].T + frame[:3, 3])
            count += len(corners)
            _check_triangles(count)  # many nodes may share one mesh
    return np.concatenate(vertices), np.concatenate(triangles)


def _chunks(content: bytes) -> tuple[Any, bytes]:
    """Return the JSON and the numbers of a GLB file, its first and second chunk (section 4.4)."""
    end = 20 + int.from_bytes(content[12:16], "little")
    tree = json_of(content[20:end])
    _check_tree(tree)
    return tree, content[end + 8 :]


def _check_tree(tree: Mapping[str, Any]) -> None:
    """Raise an error for meshes of a GLB file that are not supported or too large."""
    wrong = [
        name
        for name in tree.get("extensionsRequired", [])
        if not name.startswith(("KHR_materials", "KHR_texture"))
    ]
    wrong += {"EXT_mesh_gpu_instancing"}.intersection(tree.get("extensionsUsed", []))
    if wrong:
        raise InvalidInput(
            f"the file uses extensions that are not supported: {', '.join(wrong)}. Export it "
            "without them.",
            code="file_unreadable",
        )
    accessors = tree.get("accessors", [])
    used = []
    morphed = [node.get("weights", []) for node in tree.get("nodes", [])]
    for mesh in tree.get("meshes", []):
        morphed.append(mesh.get("weights", []))
        for primitive in mesh["primitives"]:
            positions = primitive["attributes"]["POSITION"]
            used += [accessors[positions], accessors[primitive.get("indices", positions)]]
            if accessors[positions]["componentType"] != 5126:
                raise InvalidInput(
                    "the positions are quantised; export the file without quantisation.",
                    code="file_unreadable",
                )
    if any(map(any, morphed)):
        raise InvalidInput(
            "morph targets with weights are not supported; apply them and export the file again.",
            code="file_unreadable",
        )
    if any("bufferView" not in item or "sparse" in item for item in used) or any(
        "uri" in buffer for buffer in tree.get("buffers", [])
    ):
        raise InvalidInput(
            "the numbers are compressed, sparse or in another file; export one file without "
            "compression.",
            code="file_unreadable",
        )
    # Each triangle has at most three indices and three vertices.
    _check_triangles(sum(int(item["count"]) for item in used) // 6)


def _frames(tree: Mapping[str, Any]) -> dict[int, Float64[np.ndarray, "4 4"]]:
    """Return the transform from each node of the scene to the frame of the file (section 3.5)."""
    scene = tree["scenes"][tree.get("scene", 0)]
    frames: dict[int, Float64[np.ndarray, "4 4"]] = {}
    waiting = [(root, np.eye(4)) for root in scene.get("nodes", [])]
    while waiting:
        index, parent = waiting.pop()
        if index in frames:  # a damaged file may contain loops
            continue
        node = tree["nodes"][index]
        local = np.reshape(node.get("matrix", np.eye(4)), (4, 4)).T  # listed by columns
        place = np.eye(4)
        place[:3, :3] = Rotation.from_quat(node.get("rotation", (0, 0, 0, 1))).as_matrix()
        place[:3, :3] *= node.get("scale", (1, 1, 1))
        place[:3, 3] = node.get("translation", (0, 0, 0))
        frames[index] = parent @ local @ place
        waiting += [(child, frames[index]) for child in node.get("children", [])]
    return frames


def _numbers(tree: Mapping[str, Any], numbers: bytes, index: int, width: int) -> Any:
    """Return an accessor's rows of ``width`` numbers (section 3.6.2)."""
    accessor = tree["accessors"][index]
    view = tree["bufferViews"][accessor["bufferView"]]
    kind = {5121: "<u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}[accessor["componentType"]]
    size = int(kind[-1])
    # NumPy raises an error if the rows reach beyond the numbers.
    return np.ndarray(
        (accessor["count"], width),
        kind,
        numbers,
        offset=view.get("byteOffset", 0) + accessor.get("byteOffset", 0),
        strides=(view.get("byteStride", width * size), size),
    )


def _frame_of_joints(
    tree: Mapping[str, Any],
    numbers: bytes,
    skin: Mapping[str, Any],
    frames: Mapping[int, Float64[np.ndarray, "4 4"]],
    places: Any,
) -> Float64[np.ndarray, "4 4"]:
    """Return the frame of a skinned mesh; its joints must have moved together (section 3.7.3)."""
    joints = np.array([frames[joint] for joint in skin["joints"]])
    if "inverseBindMatrices" in skin:
        columns = _numbers(tree, numbers, skin["inverseBindMatrices"], 16)[: len(joints)]
        joints = joints @ columns.reshape(-1, 4, 4).transpose(0, 2, 1)
    # How far each joint moves the corners of the box, compared with the first joint.
    box = np.array(list(product(*zip(places.min(axis=0), places.max(axis=0), strict=True))))
    motions = np.linalg.inv(joints[0]) @ joints - np.eye(4)
    apart = motions[:, :3, :3] @ box.T + motions[:, :3, 3:]
    if np.abs(apart).max() > 1e-3 * np.ptp(box, axis=0).max():
        raise InvalidInput(
            "the mesh is posed by a rig; apply the pose (in Blender: the Armature modifier) "
            "and export the file again.",
            code="file_unreadable",
        )
    return joints[0]
