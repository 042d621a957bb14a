"""Triangle meshes, point clouds and node positions from files, in the files' units.

trimesh reads PLY and GLB. STL and OBJ are read here, because trimesh skips solids that end in
"end solid" and is slow with many materials. Materials, textures, normals and colours are ignored.
"""

import io
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
from airtact.files.bounded import bytes_of, json_of

# Supported file name extensions
SUFFIXES = (".stl", ".ply", ".obj", ".glb")

# Largest number of triangles of a surface from a file: reading and checking it takes up to 10 s
# and 0.9 GB
MAX_FILE_TRIANGLES = 250_000


def read_mesh(
    path: Path,
) -> tuple[Float64[np.ndarray, "vertices 3"], Int64[np.ndarray, "triangles 3"]]:
    """Read the vertices and triangles of a file, with all nodes placed by their transforms.

    Raises
    ------
    InvalidInput
        If the file is missing, unreadable, too large, or contains no triangles.
    """
    scene = _scene(path, skinned=True)
    with _describing_damage(path):
        # Instances share one mesh, so count triangles before copying them.
        parts = [scene.geometry[scene.graph[node][1]] for node in scene.graph.nodes_geometry]
        _check_triangles(sum(len(getattr(part, "faces", ())) for part in parts))
        mesh = scene.to_mesh()
    with about(path.name):
        if len(mesh.faces) == 0:
            raise InvalidInput(
                "the file contains no triangles; use one with a closed triangle surface.",
                code="empty",
            )
        if mesh.vertices.shape[1:] != (3,):
            raise InvalidInput(
                "the vertices do not have 3 coordinates; export the file as a 3-D mesh.",
                code="file_unreadable",
            )
    return np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)


def read_vertices(path: Path) -> Float64[np.ndarray, "vertices 3"]:
    """Return the vertices of a mesh or point cloud, or raise an error as ``read_mesh`` does."""
    scene = _scene(path)
    with _describing_damage(path):
        parts = [geometry.vertices for geometry in scene.geometry.values()]
        return np.concatenate([np.empty((0, 3)), *parts])


def read_node_positions(path: Path) -> Mapping[str, Float64[np.ndarray, "3"]]:
    """Return the positions of named nodes, or raise an error as ``read_mesh`` does."""
    graph = _scene(path).graph
    return {
        str(node): np.array(graph.get(node)[0][:3, 3], dtype=np.float64) for node in graph.nodes
    }


def _scene(path: Path, skinned: bool = False) -> Any:
    """Read a file; ``skinned`` meshes of a GLB file are placed by the joints of their rig."""
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InvalidInput(
            f"{path.name} ends in {path.suffix!r}, but surface files must end in "
            f"{', '.join(SUFFIXES)}.",
            code="unknown_format",
        )
    if not path.is_file():
        raise InvalidInput(f"there is no file {path}.", code="file_missing")
    content = bytes_of(path, LARGEST_MESH_FILE)
    import trimesh  # imported here because this takes as long as importing the rest of airtact

    # Silence the tracebacks that trimesh prints.
    logging.getLogger("trimesh").addHandler(logging.NullHandler())
    with _describing_damage(path):
        if suffix in (".stl", ".obj"):
            vertices, triangles = _stl(content) if suffix == ".stl" else _obj(content)
            return trimesh.Scene(trimesh.Trimesh(vertices, triangles, process=False))
        end = 0
        tree = {}
        if suffix == ".glb":  # JSON is the first chunk, numbers the second: glTF 2.0, section 4.4
            end = 20 + int.from_bytes(content[12:16], "little")
            tree = json_of(content[20:end])
            _check_tree(tree)
        scene = trimesh.load_scene(
            io.BytesIO(content), file_type=suffix[1:], skip_materials=True, process=False
        )
        if skinned and "skins" in tree:
            _place_by_joints(scene, tree, content[end + 8 :])
        return scene


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


def _check_tree(tree: Mapping[str, Any]) -> None:
    """Raise an error for meshes of a GLB file that trimesh misreads or that are too large."""
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
    if any("bufferView" not in item or "sparse" in item for item in used):
        raise InvalidInput(
            "the numbers are compressed or sparse; export the file without compression.",
            code="file_unreadable",
        )
    # Each triangle has at most three indices and three vertices.
    _check_triangles(sum(int(item["count"]) for item in used) // 6)


def _place_by_joints(scene: Any, tree: Mapping[str, Any], numbers: bytes) -> None:
    """Place each skinned mesh by its joints, which must have moved together (section 3.7.3)."""
    import trimesh

    names = [node.get("name", str(index)) for index, node in enumerate(tree["nodes"])]
    for node, name in zip(tree["nodes"], names, strict=True):
        if "skin" not in node or "mesh" not in node:
            continue
        skin = tree["skins"][node["skin"]]
        joints = np.array([scene.graph.get(names[joint])[0] for joint in skin["joints"]])
        if "inverseBindMatrices" in skin:
            accessor = tree["accessors"][skin["inverseBindMatrices"]]
            view = tree["bufferViews"][accessor["bufferView"]]
            start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
            columns = np.frombuffer(numbers, "<f4", 16 * len(joints), start)
            joints = joints @ columns.reshape(-1, 4, 4).transpose(0, 2, 1)
        # How far each joint moves the corners of the box, compared with the first joint.
        box = trimesh.transform_points(
            trimesh.bounds.corners(scene.bounds), np.linalg.inv(scene.graph.get(name)[0])
        )
        motions = np.linalg.inv(joints[0]) @ joints - np.eye(4)
        apart = motions[:, :3, :3] @ box.T + motions[:, :3, 3:]
        if np.abs(apart).max() > 1e-3 * np.ptp(box, axis=0).max():
            raise InvalidInput(
                "the mesh is posed by a rig; apply the pose (in Blender: the Armature modifier) "
                "and export the file again.",
                code="file_unreadable",
            )
        # The position of the node itself does not matter.
        scene.graph.update(frame_to=name, frame_from=scene.graph.base_frame, matrix=joints[0])
