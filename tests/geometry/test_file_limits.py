"""Harmful files are rejected before they are expanded; none reads outside its folder."""

import base64
import copy
import json
import os
import random
import struct

import numpy as np
import pytest
import trimesh

import airtact as at
from airtact.files.meshes import MAX_FILE_TRIANGLES, MAX_MESH_LINES, read_node_positions
from damage import damaged, read_or_rejected, seeds
from faults import raises_code
from geometry.mesh.meshes import box_mesh, torus_mesh

CORNERS = np.array([[0, 0, 0], [0.01, 0, 0], [0, 0.01, 0], [0, 0, 0.01]], dtype="<f4")
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], dtype="<i4")
NUMBERS = CORNERS.tobytes() + FACES.tobytes()
TREE = {
    "asset": {"version": "2.0"},
    "scene": 0,
    "scenes": [{"nodes": [0]}],
    "buffers": [{"byteLength": 96}],
    "bufferViews": [
        {"buffer": 0, "byteOffset": 0, "byteLength": 48},
        {"buffer": 0, "byteOffset": 48, "byteLength": 48},
    ],
    "accessors": [
        {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
        {"bufferView": 1, "componentType": 5125, "count": 12, "type": "SCALAR"},
    ],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
    "nodes": [{"mesh": 0}],
}
VERTEX_LINES = "".join(f"v {x} {y} {z}\n" for x, y, z in CORNERS)
FACE_LINES = "".join(f"f {a + 1}/1/9 {b + 1}//2 {c + 1}\n" for a, b, c in FACES)


def glb(**changes) -> bytes:
    words = json.dumps(TREE | changes).encode()
    words += b" " * (-len(words) % 4)
    chunks = (
        struct.pack("<I4s", len(words), b"JSON")
        + words
        + struct.pack("<I4s", len(NUMBERS), b"BIN\0")
        + NUMBERS
    )
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def gltf(uri: str) -> bytes:
    return json.dumps(TREE | {"buffers": [{"byteLength": 96, "uri": uri}]}).encode()


def chain(length: int) -> list[dict]:
    return [*({"children": [index + 1]} for index in range(length)), {"mesh": 0}]


def without_view() -> list[dict]:
    accessors = copy.deepcopy(TREE["accessors"])
    del accessors[0]["bufferView"]
    return accessors


ZEROS = {"componentType": 5126, "count": 10**8, "type": "VEC3"}
PLY = b"""ply
format ascii 1.0
element vertex 3
property float x
element face 1
property list uchar int i
end_header
"""
HURTFUL = {
    "long chain.glb": (glb(nodes=chain(5000)), "too_many"),
    "instances.glb": (glb(nodes=[{"mesh": 0}] * 5000), "too_many"),
    "zeros.glb": (glb(accessors=[*TREE["accessors"], ZEROS]), "file_too_large"),
    "views.glb": (
        glb(bufferViews=TREE["bufferViews"] + [{"buffer": 0, "byteLength": 10**8}] * 9),
        "file_too_large",
    ),
    "no numbers.glb": (glb(accessors=without_view()), "file_unreadable"),
    "triangles.glb": (
        glb(accessors=[TREE["accessors"][0], TREE["accessors"][1] | {"count": 3_000_000}]),
        "too_many",
    ),
    "nested.gltf": (b"[" * 200_000, "file_unreadable"),
    "digits.gltf": (b'{"nodes": ' + b"9" * 5000 + b"}", "file_unreadable"),
    "values.gltf": (b"[" + b"1," * 2_000_000 + b"1]", "file_too_large"),
    "outside.gltf": (gltf("../side.bin"), "file_unreadable"),
    "device.gltf": (gltf("/dev/zero"), "file_unreadable"),
    "pipe.gltf": (gltf("pipe"), "file_unreadable"),
    "nothing.gltf": (gltf("absent.bin"), "file_missing"),
    "materials.obj": (
        (VERTEX_LINES + "usemtl a\nf 1 2 3\nusemtl b\n" * 5000).encode(),
        "mesh_faulty",
    ),
    "lines.obj": (b"\n" * (MAX_MESH_LINES + 1), "file_too_large"),
    "a wide face.obj": (
        VERTEX_LINES.encode() + b"f" + b" 1 2 3" * MAX_FILE_TRIANGLES,
        "too_many",
    ),
    "nought.obj": ((VERTEX_LINES + "f 0 1 2\n").encode(), "file_unreadable"),
    "from the end.obj": ((VERTEX_LINES + "f -4 -2 -5\n").encode(), "file_unreadable"),
    "digits.obj": ((VERTEX_LINES + "f 1 2 " + "9" * 5000 + "\n").encode(), "file_unreadable"),
    "flat.obj": ((VERTEX_LINES.replace("0.0\n", "\n") + "f 1 2 3\n").encode(), "file_unreadable"),
    "words.obj": ((VERTEX_LINES + "f 1 2 x\n").encode(), "file_unreadable"),
    "number cut.obj": (("v 0 0 a\n" + VERTEX_LINES + FACE_LINES).encode(), "file_unreadable"),
    "lines.ply": (PLY + b"\n" * (MAX_MESH_LINES + 1), "file_too_large"),
    "faces.ply": (PLY.replace(b"face 1", b"face 9999999"), "too_many"),
    "corners.ply": (PLY.replace(b"vertex 3", b"vertex 9999999"), "too_many"),
    "properties.ply": (
        PLY.replace(b"end", b"property float y\n" * 20_000 + b"end"),
        "too_many",
    ),
    "wide face.ply": (
        PLY + b"0 0 0\n" * 3 + b"2000000 " + b"0 " * 2_000_000 + b"\n",
        "file_too_large",
    ),
    "wide face in binary.ply": (
        PLY.replace(b"ascii", b"binary_little_endian") + bytes(12 + 4 + 9_000_000),
        "file_too_large",
    ),
    "edges.ply": (
        PLY.replace(b"element face", b"element edge 2000000\nproperty int a\nelement face"),
        "too_many",
    ),
    "no text.stl": (b"\xff\xfe" * 500, "file_unreadable"),
    "solids.stl": (b"solid a\nendsolid a\n" * 3000, "too_many"),
}


@pytest.mark.parametrize("name", HURTFUL)
def test_a_file_that_hurts_is_rejected(name, tmp_path):
    folder = tmp_path / "inside"
    folder.mkdir()
    (tmp_path / "side.bin").write_bytes(NUMBERS)
    os.mkfifo(folder / "pipe")
    raw, code = HURTFUL[name]
    (folder / name).write_bytes(raw)
    with raises_code(code, name):
        at.load_surface(folder / name)


def test_a_file_of_many_nodes_is_read(tmp_path):
    vertices, triangles = box_mesh((0.01, 0.02, 0.03))
    path = tmp_path / "nodes.glb"
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.Trimesh(vertices, triangles, process=False), node_name="box")
    for index in range(200):
        scene.graph.update(frame_to=f"empty {index}", frame_from="world")
    path.write_bytes(scene.export(file_type="glb"))
    assert at.load_surface(path).volume == pytest.approx(
        trimesh.Trimesh(vertices, triangles).volume, rel=1e-5
    )
    assert "empty 199" in read_node_positions(path)


def test_a_sparse_binary_file_of_many_triangles_is_rejected(tmp_path):
    path, count = tmp_path / "many.stl", MAX_FILE_TRIANGLES + 1
    with path.open("wb") as file:
        file.write(b" " * 80 + struct.pack("<I", count))
        file.truncate(84 + 50 * count)
    with raises_code("too_many", "250,001", "250,000"):
        at.load_surface(path)


@pytest.mark.parametrize(
    ("name", "raw"),
    {
        "whole.glb": glb(),
        "chain.glb": glb(nodes=chain(200)),
        "its own child.glb": glb(nodes=[{"mesh": 0, "children": [0]}]),
        "beside.gltf": gltf("beside.bin"),
        "inside.gltf": gltf(
            "data:application/octet-stream;base64," + base64.b64encode(NUMBERS).decode()
        ),
        "names a pipe.obj": ("mtllib pipe\n" + VERTEX_LINES + "usemtl a\n" + FACE_LINES).encode(),
        "odd.obj": (VERTEX_LINES + "usemtl a\n\ng b\no c\nusemtl d\ns off\n" + FACE_LINES).encode(),
        "not utf-8.obj": b"# caf\xe9\n" + (VERTEX_LINES + FACE_LINES).encode(),
        "lines of Windows.obj": ("g\r\n" + VERTEX_LINES + FACE_LINES)
        .replace("\n", "\r\n")
        .encode(),
        "from the end.obj": (
            VERTEX_LINES + "f -4 -2 -3\nf -4 -3 -1\nf -4 -1 -2\nf -3 -2 -1\n"
        ).encode(),
        "continued.obj": (VERTEX_LINES.replace("0.0\n", "\\\n0.0\n") + FACE_LINES).encode(),
    }.items(),
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_what_harms_nobody_is_read(name, raw, tmp_path):
    (tmp_path / "beside.bin").write_bytes(NUMBERS)
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / name).write_bytes(raw)
    assert at.load_surface(tmp_path / name).volume == pytest.approx(1e-6 / 6, rel=1e-6)


def test_a_surface_that_crosses_itself_is_rejected_when_it_is_read(tmp_path):
    boxes = [
        trimesh.Trimesh(*box_mesh(*corners), process=False)
        for corners in ((), ((0.01,) * 3, (0.05,) * 3))
    ]
    trimesh.util.concatenate(boxes).export(tmp_path / "crossed.ply")
    with raises_code("mesh_faulty"):
        at.load_surface(tmp_path / "crossed.ply")


@pytest.fixture(scope="module")
def whole_files(tmp_path_factory) -> list[tuple[str, bytes]]:
    folder = tmp_path_factory.mktemp("whole")
    (folder / "whole.glb").write_bytes(glb(nodes=chain(3)))
    (folder / "beside.gltf").write_bytes(
        gltf("data:application/octet-stream;base64," + base64.b64encode(NUMBERS).decode())
    )
    ring = trimesh.Trimesh(*torus_mesh(0.02, 0.005, 9, 6), process=False)
    for name in ("ring.stl", "ring.obj", "ring.ply", "ring.glb"):
        ring.export(folder / name)
    ring.export(folder / "text.stl", file_type="stl_ascii")
    ring.export(folder / "text.ply", encoding="ascii")
    return [(path.suffix, path.read_bytes()) for path in sorted(folder.iterdir())]


@pytest.mark.parametrize("batch", seeds(200, 5000, 294, 1498, 2104))
def test_a_damaged_file_is_read_or_rejected_in_one_short_sentence(batch, whole_files, tmp_path):
    for seed in batch:
        draw = random.Random(seed)
        suffix, raw = draw.choice(whole_files)
        read_or_rejected(at.load_surface, tmp_path / f"body{suffix}", damaged(raw, draw))
