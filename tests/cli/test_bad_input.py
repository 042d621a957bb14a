"""Bad input through the real command line: one sentence with its code, and exit code 2."""

import json
import re
from pathlib import Path

import jaxtyping
import numpy as np
import pytest

import airtact as at
from airtact.acoustics.solvers.bem import block_matrix
from airtact.acoustics.solvers.shared import gmres
from airtact.cli import main
from faults import facts, raises_code
from geometry.mesh.meshes import box_mesh, torus_mesh
from paths import SCENES

BALL = (SCENES / "ball.toml").read_text(encoding="utf-8")
SPHERE = "sphere = { radius = 5e-3 }"
CENTRED = ((-0.01, -0.01, -0.01), (0.01, 0.01, 0.01))
FLAT = np.array([[0, 0, 0], [0.01, 0, 0], [0, 0.01, 0], [0.02, 0, 0]])  # three corners in a row


def ply(vertices, triangles) -> str:
    head = f"ply\nformat ascii 1.0\nelement vertex {len(vertices)}\nproperty float x\nproperty float y\nproperty float z\n"
    head += f"element face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    rows = [" ".join(str(number) for number in vertex) for vertex in np.asarray(vertices).tolist()]
    rows += [
        " ".join(str(index) for index in (3, *triangle))
        for triangle in np.asarray(triangles).tolist()
    ]
    return head + "\n".join(rows) + "\n"


def box(change=lambda vertices, triangles: (vertices, triangles)) -> str:
    return ply(*change(*box_mesh(*CENTRED)))


def with_nan(vertices, triangles):
    vertices[0, 0] = np.nan
    return vertices, triangles


def with_index(vertices, triangles):
    triangles[3, 1] = 99
    return vertices, triangles


MESHES = {
    "open": (
        box(lambda v, t: (v, t[1:])),
        "mesh_faulty",
        "1 hole",
        "2 mm",
        "20 mm",
    ),
    "self-crossing": (ply(*torus_mesh(0.015, 0.02)), "mesh_faulty", "pairs of triangles"),
    "NaN": (box(with_nan), "not_finite", "1 vertex"),
    "index": (box(with_index), "out_of_range", "99"),
    "millimetres": (box(lambda v, t: (1000 * v, t)), "not_in_metres", "0.001 for millimetres"),
    "tiny": (box(lambda v, t: (v / 1000, t)), "not_in_metres", "0.02 mm", "0.5 mm", "millimetres"),
    "no triangles": (ply(FLAT, np.zeros((0, 3), dtype=int)), "empty", "no triangles"),
    "no file of its kind": ("not a mesh at all", "file_unreadable", "mesh.ply"),
}

TWIN = f"{SPHERE}\n[[obstacles]]\nsphere = {{ radius = 5e-3, centre = [8e-3, 0.0, 0.0] }}"
TEXTS = {
    "overlapping bodies": ([(SPHERE, TWIN)], "bodies_overlap", "bodies 0 and 1", "2 mm"),
    "focus in a body": ([("-5.5e-3", "-4.5e-3")], "inside_body", "focus 0", "0.5 mm"),
    "transducer in a body": (
        [("-0.08636, -0.06604, -0.07]", "-0.08128, -0.06096, 1e-3]")],
        "bodies_overlap",
        "1 of 249",
        "4 mm",
    ),
    "focus behind a face": (
        [
            ('layout = "boards"', 'layout = "boards"\npiston_radius = 4e-3'),
            ("-0.07]", "-0.006]"),
            ("8e-3,", "8e-2,"),
        ]
        + [("8e-2, 0.0, 0.0]", "8e-2, 0.0, -0.02]")],
        "behind_faces",
        "focus 1",
        "249 elements",
        "14 mm",
    ),
    "body behind a face": (
        [
            ('layout = "boards"', 'layout = "boards"\npiston_radius = 4e-3'),
            ("-0.07]", "-0.004]"),
            ("-0.08636", "0.01"),
        ]
        + [("-5.5e-3", "5.5e-3")],
        "behind_faces",
        "body 0",
        "249 elements",
        "1 mm",
    ),
    "frequency in kHz": (
        [("[medium]", "frequency = 40\n[medium]")],
        "out_of_range",
        "40 Hz",
        "kHz",
    ),
    "frequency NaN": (
        [("[medium]", "frequency = nan\n[medium]")],
        "not_finite",
        "frequency is nan",
    ),
    "speed in km/s": ([("343.1", "0.3431")], "out_of_range", "0.3431 m/s", "km/s"),
    "radius in mm": (
        [("radius = 5e-3", "radius = 5")],
        "not_in_metres",
        "10 m",
        "2 m",
        "millimetres",
    ),
    "gap in mm": ([(SPHERE, "pinch = { gap = 12 }")], "out_of_range", "12 m", "millimetres"),
    "offset in mm": (
        [(SPHERE, "pinch = {}"), ("point = [8e-3, 0.0, 0.0]", 'at = "thumb.pad"\noffset = 0.5')],
        "not_in_metres",
        "0.5 m",
        "12 mm",
        "millimetres",
    ),
    "focus in mm": ([("8e-3,", "8.0,")], "not_in_metres", "focus 1", "8 m", "millimetres"),
    "board in mm": ([("-0.07]", "-70.0]")], "not_in_metres", "70 m", "millimetres"),
    "NaN focus": ([("8e-3,", "nan,")], "not_finite", "foci[1].point[0] is nan"),
    "NaN pressure": ([("600.0", "nan")], "not_finite", "foci[1].pressure is nan"),
    "NaN pose": ([("-0.07]", "nan]")], "not_finite", "translation[2] is nan"),
    "no accuracy": (
        [("accuracy = 0.05", "accuracy = 0")],
        "out_of_range",
        "solver.accuracy is 0",
        "0.0001",
        "0.3",
    ),
}


def rejection(capsys, *arguments) -> str:
    """Run the command line, and return its one sentence with the code."""
    code = main([str(argument) for argument in arguments])
    printed = capsys.readouterr()
    assert (code, printed.out) == (2, ""), printed
    *steps, sentence = printed.err.splitlines()
    assert all(re.match(r" +\d+\.\d s  ", step) for step in steps)
    assert re.fullmatch(r"airtact: .+ \[[a-z_]+\]", sentence)
    assert "Traceback" not in printed.err
    return sentence


def has(sentence: str, code: str, *numbers: str) -> bool:
    missing = [fact for text in numbers for fact in facts(text) if fact not in sentence]
    return sentence.endswith(f" [{code}]") and not missing


def write(path: Path, changes) -> Path:
    text = BALL
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("name", MESHES)
def test_a_bad_surface_is_rejected(name, tmp_path, capsys):
    content, *fault = MESHES[name]
    (tmp_path / "mesh.ply").write_text(content, encoding="utf-8")
    scene = write(
        tmp_path / "scene.toml", [(SPHERE, 'surface = "mesh.ply"'), ("-5.5e-3", "-30e-3")]
    )
    assert has(rejection(capsys, "check", scene), *fault)


@pytest.mark.parametrize("name", TEXTS)
def test_a_bad_scene_is_rejected(name, tmp_path, capsys):
    changes, *fault = TEXTS[name]
    assert has(rejection(capsys, "check", write(tmp_path / "scene.toml", changes)), *fault)


@pytest.mark.parametrize(
    "name", ["overlapping bodies", "focus in a body", "frequency in kHz", "NaN pose"]
)
def test_render_rejects_before_it_makes_a_folder(name, tmp_path, capsys):
    changes, *fault = TEXTS[name]
    scene = write(tmp_path / "scene.toml", changes)
    assert has(rejection(capsys, "render", scene, "--out", tmp_path / "out"), *fault)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["[/]", "[bold]pole"])
def test_names_are_words_whatever_they_hold(name, tmp_path, capsys):
    assert main(["check", str(write(tmp_path / "scene.toml", [("south pole", name)]))]) == 0
    assert name in capsys.readouterr().out


def test_a_scene_for_live_that_touches_nothing_yet_is_checked_with_a_warning(tmp_path, capsys):
    scene = tmp_path / "scene.toml"
    scene.write_text(
        '[medium]\ncelsius = 20\n[array]\nlayout = "flat_boards"\nrows = 1\ncolumns = 1\n'
        f'[[obstacles]]\nhand = "{at.example("pinch.json")}"\npose = {{ translation = [0, 0, 0.2] }}\n'
        "[[objects]]\nsphere = { centre = [0.3, 0.0, 0.3], radius = 0.02 }\n"
    )
    assert main(["check", str(scene), "--json"]) == 0
    assert "no body touches" in json.loads(capsys.readouterr().out)["warnings"][0]
    assert has(rejection(capsys, "render", scene), "empty")


def test_a_solver_that_does_not_converge_is_reported(tmp_path, capsys, monkeypatch):
    # No closed body was found that needs more than the 120 iterations allowed, so two are allowed
    # here.
    monkeypatch.setattr(block_matrix, "gmres", lambda *args, **_: gmres(*args[:3], np.inf, 2))
    scene = write(tmp_path / "scene.toml", [])
    sentence = rejection(capsys, "render", scene, "--out", tmp_path / "out")
    assert re.search(r"relative residual of \d\.\de-\d\d in 2 iterations", sentence)


# --- wrong kinds of object, by the Python interface -----------------------------------------------------------------

AIR = at.Medium(343.1, 1.293)
ARRAY = at.PhasedArray(
    np.array([[0, 0, 0.1], [0.02, 0, 0.1]]), np.tile([0.0, 0.0, -1.0], (2, 1)), at.monopole()
)
SCENE = at.Scene(AIR, [])
TARGET = at.Target(np.array([[0.0, 0.0, 0.02]]))
DRIVE = at.Drive(np.array([1.0, 0.5j]))
SILENT = at.Drive(np.zeros(2, dtype=complex))
FAR = at.Pose(np.eye(3), np.array([0.0, 0.0, 99.92]))
FRAME = at.quantise(DRIVE)
FIELD = at.FreeField().radiate(SCENE, TARGET.beacons())
TRANSFER = at.transfer_matrix(FIELD, ARRAY)
FREE = at.FreeField()
WATER_DROP = at.Scene(AIR, [at.filled(at.sphere(0.01, 0.005), at.Medium(1481, 999.7))])
DROP_FIELD = at.SphereSeries().radiate(WATER_DROP, TARGET.beacons())

KINDS = {
    "radiate target": (
        lambda: FREE.radiate(SCENE, TARGET),
        "wrong_kind",
        "a Target",
        "a Monopoles",
    ),
    "radiate points": (
        lambda: at.SphereSeries().radiate(WATER_DROP, TARGET.points),
        "wrong_kind",
        "an array of shape (1, 3)",
        "a Monopoles",
    ),
    "radiate backwards": (
        lambda: FREE.radiate(TARGET.beacons(), SCENE),
        "wrong_kind",
        "a Beacons",
        "a Scene",
    ),
    "transfer of a target": (
        lambda: at.transfer_matrix(TARGET, ARRAY),
        "wrong_kind",
        "a Target",
        "a RadiatedField",
    ),
    "transfer to a list": (
        lambda: at.transfer_matrix(FIELD, [ARRAY]),
        "wrong_kind",
        "a list of length 1",
        "a PhasedArray",
    ),
    "evaluate frame": (
        lambda: at.evaluate(SCENE, ARRAY, FRAME, TARGET, solver=FREE),
        "wrong_kind",
        "a Frame",
        "a Drive",
    ),
    "evaluate amplitudes": (
        lambda: at.evaluate(SCENE, ARRAY, DRIVE.amplitudes, TARGET, solver=FREE),
        "wrong_kind",
        "an array of shape (2,)",
        "a Drive",
    ),
    "evaluate points": (
        lambda: at.evaluate(SCENE, ARRAY, DRIVE, TARGET.points, solver=FREE),
        "wrong_kind",
        "an array of shape (1, 3)",
        "a Target",
    ),
    "evaluate by a class": (
        lambda: at.evaluate(SCENE, ARRAY, DRIVE, TARGET, solver=at.FreeField),
        "wrong_kind",
        "the class FreeField",
        "a Solver",
    ),
    "evaluate silence": (
        lambda: at.evaluate(SCENE, ARRAY, SILENT, TARGET, solver=FREE),
        "all_zero",
        "drive 0",
        "silent",
    ),
    "evaluate on an element": (
        lambda: at.evaluate(SCENE, ARRAY, DRIVE, at.Target(ARRAY.positions[1:]), solver=FREE),
        "misplaced",
        "point 0",
        "source 1",
        "0 mm",
    ),
    "field of a frame": (
        lambda: at.field_map(SCENE, ARRAY, FRAME, TARGET.points, solver=FREE),
        "wrong_kind",
        "a Frame",
        "a Drive",
    ),
    "field of silence": (
        lambda: at.field_map(SCENE, ARRAY, SILENT, TARGET.points, solver=FREE),
        "all_zero",
        "silent",
    ),
    "field without a scene": (
        lambda: at.field_map(AIR, ARRAY, DRIVE, TARGET.points, solver=FREE),
        "wrong_kind",
        "a Medium",
        "a Scene",
    ),
    "compare list": (
        lambda: at.compare(SCENE, ARRAY, [DRIVE], TARGET, solver=FREE),
        "wrong_kind",
        "a list of length 1",
        "a Mapping",
    ),
    "compare frames": (
        lambda: at.compare(SCENE, ARRAY, {"a": FRAME}, TARGET, solver=FREE),
        "wrong_kind",
        "a Frame",
        "a Drive",
    ),
    "reversal backwards": (
        lambda: at.time_reversal(TARGET, TRANSFER),
        "wrong_kind",
        "a Target",
        "a TransferMatrix",
    ),
    "share of a frame": (
        lambda: at.drives.achieved_fraction(TRANSFER, TARGET, FRAME),
        "wrong_kind",
        "a Frame",
        "a Drive",
    ),
    "quantise a frame": (lambda: at.quantise(FRAME), "wrong_kind", "a Frame", "a Drive"),
    "focus in kHz": (
        lambda: at.focus_by_distance(ARRAY, TARGET, AIR, 40),
        "out_of_range",
        "40 Hz",
        "kHz",
    ),
    "focus by a speed": (
        lambda: at.focus_by_distance(ARRAY, TARGET, 343.1, 40e3),
        "wrong_kind",
        "343.1",
        "a Medium",
    ),
    "element not made": (
        lambda: at.surrounding_box(element=at.monopole),
        "wrong_kind",
        "a function",
        "an Element",
    ),
    "array in mm": (
        lambda: at.PhasedArray(1e3 * ARRAY.positions, ARRAY.normals),
        "not_in_metres",
        "20 m",
        "10 m",
        "millimetres",
    ),
    "half a board": (lambda: at.flat_boards(1.5, 1), "out_of_range", "1.5"),
    "joining one": (
        lambda: at.transducers.join(ARRAY),
        "wrong_kind",
        "a list of arrays",
        "a PhasedArray",
    ),
    "joining others": (
        lambda: at.transducers.join([ARRAY, AIR]),
        "wrong_kind",
        "a Medium",
        "a PhasedArray",
    ),
    "seen from a point": (
        lambda: ARRAY.seen_from(np.zeros(3)),
        "wrong_kind",
        "an array of shape (3,)",
        "a Pose",
    ),
    "surface moved by a point": (
        lambda: at.sphere(0.01, 0.005).moved(np.zeros(3)),
        "wrong_kind",
        "an array of shape (3,)",
        "a Pose",
    ),
    "turn about a plane": (lambda: at.Pose.turn((0, 1), 0.3), "wrong_shape", "(2,)"),
    "turn by words": (
        lambda: at.Pose.turn((0, 0, 1), "90"),
        "not_a_number",
        "90",
    ),
    "array far off": (
        lambda: at.evaluate(SCENE, ARRAY.moved(FAR), DRIVE, TARGET, solver=FREE),
        "not_in_metres",
        "100 m",
        "10 m",
        "millimetres",
    ),
    "focus from far off": (
        lambda: at.focus_by_distance(ARRAY.moved(FAR), TARGET, AIR, 40e3),
        "not_in_metres",
        "100 m",
    ),
    "focus by pistons in mm": (
        lambda: at.focus_by_distance(at.surrounding_box(at.piston(4.5)), TARGET, AIR, 40e3),
        "out_of_range",
        "is 4.5 m",
        "millimetres",
    ),
    "many boards": (lambda: at.flat_boards(10**6, 10**6), "out_of_range", "1.92e+05 m", "10 m"),
    "depth at a point": (lambda: WATER_DROP.depth(np.zeros(3)), "wrong_shape", "3"),
    "depth nowhere": (
        lambda: at.Surface(*box_mesh()).depth(np.full((1, 3), np.nan)),
        "not_finite",
        "3 NaN",
        "[0, 0]",
    ),
    "boundary in a list": (
        lambda: at.acoustics.Obstacle(at.sphere(0.01, 0.005), ["sound_hard"]),
        "unknown_name",
        "'sound_hard'",
    ),
    "ragged triangles": (
        lambda: at.Surface(box_mesh()[0], [[0, 1], [0, 1, 2]]),
        "wrong_shape",
        "2",
    ),
    "no path": (lambda: at.load_surface(None), "wrong_kind", "a NoneType", "a str"),
    "drive in words": (lambda: at.Drive(["loud", "quiet"]), "not_a_number", "2"),
    "warm air": (lambda: at.air(celsius="warm"), "not_a_number", "'warm'"),
}


@pytest.mark.parametrize("name", KINDS)
def test_another_kind_of_object_is_rejected(name, monkeypatch):
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)  # as it is outside the tests
    call, *fault = KINDS[name]
    with raises_code(*fault) as caught:
        call()
    assert "\n" not in str(caught.value)


EVALUATED = {"at": lambda field, p: field.at(p), "valid": lambda field, p: field.valid(p)}
FIELDS = {"open air": FIELD, "sphere": DROP_FIELD}


@pytest.mark.parametrize("field", FIELDS)
@pytest.mark.parametrize("ask", EVALUATED)
@pytest.mark.parametrize(
    ("points", "fault"),
    [
        (np.zeros(3), ("wrong_shape", "(3,)")),
        (np.zeros((4, 2)), ("wrong_shape", "(4, 2)")),
        (np.array([[0, 0, 0], [0, np.nan, 0.1]]), ("not_finite", "1 NaN", "[1, 1]")),
        (np.array([[0, 0, np.inf]]), ("not_finite", "1 NaN", "[0, 2]")),
    ],
)
def test_points_of_evaluation_are_checked(field, ask, points, fault, monkeypatch):
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)  # as it is outside the tests
    with raises_code(*fault):
        EVALUATED[ask](FIELDS[field], points)


@pytest.mark.parametrize("field", FIELDS)
def test_a_point_on_a_source_is_rejected(field):
    points = np.array([[0.0, 0.0, 0.05], [0.0, 0.0, 0.02 + 1e-12]])
    with raises_code("misplaced", "e-10 mm"):
        FIELDS[field].at(points)


def test_no_points_give_nothing():
    for field in FIELDS.values():
        assert field.at(np.zeros((0, 3))).shape == (0, 1)
        assert field.valid(np.zeros((0, 3))).shape == (0,)
