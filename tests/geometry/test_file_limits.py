"""Harmful files are rejected before they are expanded; none reads outside its folder."""

import copy
import json
import os
import random
import struct

import numpy as np
import pytest
import trimesh

import airtact as at
from airtact.files.meshes import MAX_FILE_TRIANGLES
from damage import damaged, read_or_rejected, seeds
from faults import raises_code
from geometry.mesh.meshes import torus_mesh

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


def chain(length: int) -> list[dict]:
    return [*({"children": [index + 1]} for index in range(length)), {"mesh": 0}]


def without_view() -> list[dict]:
    accessors = copy.deepcopy(TREE["accessors"])
    del accessors[0]["bufferView"]
    return accessors


def rig(*translations: list[float]) -> dict:
    """A skinned mesh whose joints stand at some places; its own place does not count."""
    joints = list(range(1, 1 + len(translations)))
    return {
        "scenes": [{"nodes": [0, *joints]}],
        "nodes": [
            {"mesh": 0, "skin": 0, "translation": [9.0, 9.0, 9.0]},
            *({"translation": place} for place in translations),
        ],
        "skins": [{"joints": joints}],
    }


REJECTED = {
    "no numbers.glb": (glb(accessors=without_view()), "file_unreadable"),
    "triangles.glb": (
        glb(accessors=[TREE["accessors"][0], TREE["accessors"][1] | {"count": 3_000_000}]),
        "too_many",
    ),
    "outside.glb": (glb(buffers=[{"byteLength": 96, "uri": "side.bin"}]), "file_unreadable"),
    "a quantised accessor.glb": (
        glb(accessors=[TREE["accessors"][0] | {"componentType": 5123}, TREE["accessors"][1]]),
        "file_unreadable",
    ),
    "quantised.glb": (glb(extensionsRequired=["KHR_mesh_quantization"]), "file_unreadable"),
    "instances.glb": (glb(extensionsUsed=["EXT_mesh_gpu_instancing"]), "file_unreadable"),
    "morphed.glb": (glb(nodes=[{"mesh": 0, "weights": [0.0, 1.0]}]), "file_unreadable"),
    "bent.glb": (glb(**rig([0.0, 0.0, 0.0], [0.0, 1e-3, 0.0])), "file_unreadable"),
    "a key twice.glb": (
        glb().replace(b'{"version": "2.0"}', b'{"a": 1, "a": 1}  '),
        "file_unreadable",
    ),
    "underscores.obj": (VERTEX_LINES.replace("0.0", "0_0", 1).encode(), "file_unreadable"),
    "underscores.stl": (b"solid\n" + b"vertex 0_1 0 0\n" * 3 + b"endsolid\n", "file_unreadable"),
    "materials.obj": (
        (VERTEX_LINES + "usemtl a\nf 1 2 3\nusemtl b\n" * 5000).encode(),
        "mesh_faulty",
    ),
    "a wide face.obj": (
        VERTEX_LINES.encode() + b"f" + b" 1 2 3" * MAX_FILE_TRIANGLES,
        "too_many",
    ),
    "nought.obj": ((VERTEX_LINES + "f 0 1 2\n").encode(), "out_of_range"),
    "from the end.obj": ((VERTEX_LINES + "f -4 -2 -5\n").encode(), "out_of_range"),
    "flat.obj": ((VERTEX_LINES.replace("0.0\n", "\n") + "f 1 2 3\n").encode(), "file_unreadable"),
    "words.obj": ((VERTEX_LINES + "f 1 2 x\n").encode(), "file_unreadable"),
    "no text.stl": (b"\xff\xfe" * 500, "file_unreadable"),
    "commas.stl": (b"solid\n" + b"vertex 0,1 0,2 0,3\n" * 3 + b"endsolid\n", "file_unreadable"),
    "cut.stl": (b"solid\n" + b"vertex 1 2 3\n" * 4, "file_unreadable"),
}


@pytest.mark.parametrize("name", REJECTED)
def test_a_harmful_or_damaged_file_is_rejected(name, tmp_path):
    folder = tmp_path / "inside"
    folder.mkdir()
    (tmp_path / "side.bin").write_bytes(NUMBERS)
    os.mkfifo(folder / "pipe")
    raw, code = REJECTED[name]
    (folder / name).write_bytes(raw)
    with raises_code(code, name):
        at.load_surface(folder / name)


def test_a_mesh_that_its_rig_moves_as_a_whole_is_moved(tmp_path):
    (tmp_path / "rig.glb").write_bytes(glb(**rig([0.1, 0.2, 0.0], [0.1, 0.2, 0.0])))
    lowest = at.load_surface(tmp_path / "rig.glb").vertices.min(axis=0)
    np.testing.assert_allclose(lowest, [0.1, 0.2, 0.0], atol=1e-6)


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
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / name).write_bytes(raw)
    assert at.load_surface(tmp_path / name).volume == pytest.approx(1e-6 / 6, rel=1e-6)


@pytest.mark.parametrize(
    ("old", "new"), [("endsolid", "end solid"), ("\n", "\r"), ("\n", "\r\n"), ("e", "E")]
)
def test_dialects_of_ascii_stl_are_read(old, new, tmp_path):
    text = trimesh.Trimesh(*torus_mesh(0.02, 0.005), process=False).export(file_type="stl_ascii")
    (tmp_path / "plain.stl").write_text(text)
    (tmp_path / "dialect.stl").write_bytes(text.replace(old, new).encode())
    volume = at.load_surface(tmp_path / "plain.stl").volume
    assert at.load_surface(tmp_path / "dialect.stl").volume == pytest.approx(volume)


@pytest.fixture(scope="module")
def whole_files(tmp_path_factory) -> list[tuple[str, bytes]]:
    folder = tmp_path_factory.mktemp("whole")
    (folder / "whole.glb").write_bytes(glb(nodes=chain(3)))
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
