"""The issue's list of bad input, each through the real command line: one sentence with a number, and exit code 2."""

import functools
import re
from pathlib import Path

import jaxtyping
import numpy as np
import pytest

import airtact as at
from airtact.cli import main
from airtact.solvers.bem import solver as bem_solver
from airtact.solvers.gmres import gmres
from mesh.meshes import box_mesh, torus_mesh
from paths import SCENES

BALL = (SCENES / "ball.toml").read_text(encoding="utf-8")
SPHERE = "sphere = { radius = 5e-3 }"
CENTRED = ((-0.01, -0.01, -0.01), (0.01, 0.01, 0.01))
FLAT = np.array([[0, 0, 0], [0.01, 0, 0], [0, 0.01, 0], [0.02, 0, 0]])  # three corners in a row


def ply(vertices, triangles) -> str:
    head = (
        f"ply\nformat ascii 1.0\nelement vertex {len(vertices)}\nproperty float x\nproperty float y\nproperty float z\n"
    )
    head += f"element face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    rows = [" ".join(str(number) for number in vertex) for vertex in np.asarray(vertices).tolist()]
    rows += [" ".join(str(index) for index in (3, *triangle)) for triangle in np.asarray(triangles).tolist()]
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
        "the surface is open: 1 hole is wider than 2 mm, the largest 28.3 mm across",
    ),
    "self-crossing": (ply(*torus_mesh(0.015, 0.02)), r"the surface crosses itself: \d+ pairs of triangles meet"),
    "NaN": (box(with_nan), "1 vertex of the surface is NaN or infinite"),
    "index": (box(with_index), r"\b99\b|out of bounds|do not exist"),
    "millimetres": (box(lambda v, t: (1000 * v, t)), r"spans 20 m, more than 2 m: is this in millimetres\?"),
    "tiny": (box(lambda v, t: (v / 1000, t)), r"spans 0.02 mm, less than 0.5 mm: is this in millimetres"),
    "no triangles": (ply(FLAT, np.zeros((0, 3), dtype=int)), "0 triangles|cannot be read"),
    "no file of its kind": ("not a mesh at all", r"mesh.ply \(17 bytes\) cannot be read"),
}

TWIN = f"{SPHERE}\n[[obstacles]]\nsphere = {{ radius = 5e-3, centre = [8e-3, 0.0, 0.0] }}"
TEXTS = {
    "overlapping bodies": ([(SPHERE, TWIN)], "bodies 0 and 1 overlap or touch: 2 mm deep near"),
    "focus in a body": ([("-5.5e-3", "-4.5e-3")], "1 of 2 focus points lies inside a body: focus 0 .* is 0.5 mm deep"),
    "transducer in a body": (
        [("-0.08636, -0.06604, -0.07]", "-0.08128, -0.06096, 1e-3]")],
        r"1 of 249 element points lies inside a body: element \d+ at .* is 4 mm deep",
    ),
    "focus behind a face": (
        [('layout = "boards"', 'layout = "boards"\npiston_radius = 4e-3'), ("-0.07]", "-0.006]"), ("8e-3,", "8e-2,")]
        + [("8e-2, 0.0, 0.0]", "8e-2, 0.0, -0.02]")],
        "focus 1 stands behind the faces of 249 elements, first element 0 by 14 mm",
    ),
    "body behind a face": (
        [('layout = "boards"', 'layout = "boards"\npiston_radius = 4e-3'), ("-0.07]", "-0.004]"), ("-0.08636", "0.01")]
        + [("-5.5e-3", "5.5e-3")],
        "body 0 reaches behind the faces of 249 elements, first element 0 by 1 mm",
    ),
    "zero frequency": ([("[medium]", "frequency = 0.0\n[medium]")], "frequency is 0 Hz"),
    "negative frequency": ([("[medium]", "frequency = -40e3\n[medium]")], "frequency is -40000 Hz"),
    "frequency in kHz": ([("[medium]", "frequency = 40\n[medium]")], r"frequency is 40 Hz, .* is it in kHz\?"),
    "frequency NaN": ([("[medium]", "frequency = nan\n[medium]")], "frequency is nan Hz"),
    "frequency in words": (
        [("[medium]", 'frequency = "40 kHz"\n[medium]')],
        "frequency: expected a number, got a string",
    ),
    "zero density": ([("1.293", "0")], "density is 0 kg/m³"),
    "negative speed": ([("343.1", "-343.1")], "sound speed is -343.1 m/s"),
    "infinite speed": ([("343.1", "inf")], "sound speed is inf m/s"),
    "speed in km/s": ([("343.1", "0.3431")], r"sound speed is 0.3431 m/s, .* is it in km/s\?"),
    "zero radius": ([("radius = 5e-3", "radius = 0")], "radius is 0 m"),
    "negative radius": ([("radius = 5e-3", "radius = -5e-3")], "radius is -0.005 m"),
    "radius in mm": ([("radius = 5e-3", "radius = 5")], r"spans 10 m, more than 2 m: is this in millimetres\?"),
    "gap in mm": ([(SPHERE, "pinch = { gap = 12 }")], r"gap is 12 m, .* is it in millimetres\?"),
    "negative gap": ([(SPHERE, "pinch = { gap = -0.01 }")], "gap is -0.01 m"),
    "offset in mm": (
        [(SPHERE, "pinch = {}"), ("point = [8e-3, 0.0, 0.0]", 'at = "thumb.pad"\noffset = 0.5')],
        r"offset = 0.5 m does not lie in the gap of 12 mm before thumb.pad: is it in millimetres\?",
    ),
    "focus in mm": ([("8e-3,", "8.0,")], r"focus 1 at .* is 8 m from the origin .* is this in millimetres\?"),
    "board in mm": ([("-0.07]", "-70.0]")], r"element \d+ stands 70 m from the nearest body, .* in millimetres\?"),
    "NaN focus": ([("8e-3,", "nan,")], r"target points hold 1 NaN or infinite value, the first at index \[1, 0\]"),
    "NaN pressure": ([("600.0", "nan")], r"target pressures hold 1 NaN or infinite value, the first at index \[1\]"),
    "NaN pose": ([("-0.07]", "nan]")], "the pose's translation hold 1 NaN"),
    "wrong shape": ([("8e-3, 0.0, 0.0]", "8e-3, 0.0]")], r"foci\[1\].point: expected a list of length 3, got 2"),
    "pressure for one of two": ([("pressure = 600.0", "")], "1 of 2 have a pressure"),
    "empty target": (
        [(BALL[BALL.index("[[foci]]") :], ""), ("[medium]", "foci = []\n[medium]")],
        r"empty \(0 points\)",
    ),
    "no accuracy": ([("accuracy = 0.05", "accuracy = 0")], "accuracy is 0, but it must lie between 0.0001 and 0.3"),
}


def refusal(capsys, *arguments) -> str:
    """Run the command line, and return its one sentence."""
    code = main([str(argument) for argument in arguments])
    printed = capsys.readouterr()
    assert (code, printed.out) == (2, ""), printed
    *steps, sentence = printed.err.splitlines()
    assert all(re.match(r" +\d+\.\d s  ", step) for step in steps)
    assert sentence.startswith("airtact: ")
    assert "Traceback" not in printed.err
    assert re.search(r"\d|nan|inf|number", sentence.partition(".toml")[2] or sentence)
    return sentence


def write(path: Path, changes) -> Path:
    text = BALL
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("name", MESHES)
def test_a_bad_surface_is_refused(name, tmp_path, capsys):
    content, sentence = MESHES[name]
    (tmp_path / "mesh.ply").write_text(content, encoding="utf-8")
    scene = write(tmp_path / "scene.toml", [(SPHERE, 'surface = "mesh.ply"'), ("-5.5e-3", "-30e-3")])
    assert re.search(sentence, refusal(capsys, "check", scene))


@pytest.mark.parametrize("name", TEXTS)
def test_a_bad_scene_is_refused(name, tmp_path, capsys):
    changes, sentence = TEXTS[name]
    assert re.search(sentence, refusal(capsys, "check", write(tmp_path / "scene.toml", changes)))


@pytest.mark.parametrize("name", ["overlapping bodies", "focus in a body", "frequency in kHz", "NaN pose"])
def test_render_refuses_before_it_makes_a_folder(name, tmp_path, capsys):
    changes, sentence = TEXTS[name]
    scene = write(tmp_path / "scene.toml", changes)
    assert re.search(sentence, refusal(capsys, "render", scene, "--out", tmp_path / "out"))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["[/]", "[bold]pole"])
def test_names_are_words_whatever_they_hold(name, tmp_path, capsys):
    assert main(["check", str(write(tmp_path / "scene.toml", [("south pole", name)]))]) == 0
    assert name in capsys.readouterr().out


def test_a_solver_that_does_not_converge_is_refused(tmp_path, capsys, monkeypatch):
    # No closed body was found that needs more than the 120 iterations allowed, so two are allowed here.
    monkeypatch.setattr(bem_solver, "gmres", functools.partial(gmres, most_iterations=2))
    scene = write(tmp_path / "scene.toml", [])
    sentence = refusal(capsys, "render", scene, "--out", tmp_path / "out")
    assert re.search(r"relative residual of \d\.\de-\d\d .* after 2 iterations; likely", sentence)


def test_a_folder_that_cannot_be_written_is_refused(tmp_path, capsys):
    (tmp_path / "file").touch()
    sentence = refusal(capsys, "render", write(tmp_path / "scene.toml", []), "--out", tmp_path / "file")
    assert re.search(r"cannot write into the output folder .*file: File exists \(error 17\)", sentence)


# --- wrong kinds of object, by the Python interface -----------------------------------------------------------------

AIR = at.Medium(343.1, 1.293)
ARRAY = at.PhasedArray(np.array([[0, 0, 0.1], [0.02, 0, 0.1]]), np.tile([0.0, 0.0, -1.0], (2, 1)))
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
    "radiate target": (lambda: FREE.radiate(SCENE, TARGET), r"is a Target, .*: give target.beacons\(\)"),
    "radiate points": (lambda: at.SphereSeries().radiate(WATER_DROP, TARGET.points), r"array of shape \(1, 3\), but"),
    "radiate backwards": (
        lambda: FREE.radiate(TARGET.beacons(), SCENE),
        "the scene is a Beacons, but it must be a Scene",
    ),
    "transfer of a target": (lambda: at.transfer_matrix(TARGET, ARRAY), r"give solver.radiate\(scene, target.beacons"),
    "transfer to a list": (
        lambda: at.transfer_matrix(FIELD, [ARRAY]),
        r"the array is a list of length 1, but it must be",
    ),
    "evaluate frame": (
        lambda: at.evaluate(SCENE, ARRAY, FRAME, TARGET, solver=FREE),
        r"the drive is a Frame, but it must be a Drive: give frame.drive\(\)",
    ),
    "evaluate amplitudes": (
        lambda: at.evaluate(SCENE, ARRAY, DRIVE.amplitudes, TARGET, solver=FREE),
        r"the drive is an array of shape \(2,\), but it must be a Drive: give Drive\(amplitudes\)",
    ),
    "evaluate points": (
        lambda: at.evaluate(SCENE, ARRAY, DRIVE, TARGET.points, solver=FREE),
        r"give Target\(points, pr",
    ),
    "evaluate by a class": (
        lambda: at.evaluate(SCENE, ARRAY, DRIVE, TARGET, solver=at.FreeField),
        r"the solver is the class FreeField, but it must be a Solver: give one such as FreeField\(\)",
    ),
    "evaluate silence": (
        lambda: at.evaluate(SCENE, ARRAY, SILENT, TARGET, solver=FREE),
        "drive 0 is silent: all 2 amplitudes are 0",
    ),
    "evaluate on an element": (
        lambda: at.evaluate(SCENE, ARRAY, DRIVE, at.Target(ARRAY.positions[1:]), solver=FREE),
        r"point 0 stands on source 1 \(0 mm away\)",
    ),
    "field of a frame": (lambda: at.field_map(SCENE, ARRAY, FRAME, TARGET.points, solver=FREE), "give frame.drive"),
    "field of silence": (
        lambda: at.field_map(SCENE, ARRAY, SILENT, TARGET.points, solver=FREE),
        "all 2 amplitudes are 0",
    ),
    "field without a scene": (
        lambda: at.field_map(AIR, ARRAY, DRIVE, TARGET.points, solver=FREE),
        "the scene is a Medium",
    ),
    "compare list": (
        lambda: at.compare(SCENE, ARRAY, [DRIVE], TARGET, solver=FREE),
        "the drives is a list of length 1, but it must be a Mapping: give a dict of drives by name",
    ),
    "compare frames": (lambda: at.compare(SCENE, ARRAY, {"a": FRAME}, TARGET, solver=FREE), "drive 'a' is a Frame"),
    "reversal backwards": (
        lambda: at.time_reversal(TARGET, TRANSFER),
        "the transfer matrix is a Target, but it must be",
    ),
    "share of a frame": (
        lambda: at.achieved_fraction(TRANSFER, TARGET, FRAME),
        "the drive is a Frame, .* give frame.drive",
    ),
    "quantise a frame": (lambda: at.quantise(FRAME), "what is quantised is a Frame, but it must be a Drive"),
    "focus in kHz": (lambda: at.focus_by_distance(ARRAY, TARGET, AIR, 40), r"frequency is 40 Hz, .* is it in kHz\?"),
    "focus by a speed": (
        lambda: at.focus_by_distance(ARRAY, TARGET, 343.1, 40e3),
        "the medium is 343.1, but it must be",
    ),
    "element not made": (
        lambda: at.surrounding_box(element=at.monopole),
        r"is a function, .* give monopole\(\) or piston",
    ),
    "array in mm": (
        lambda: at.PhasedArray(1e3 * ARRAY.positions, ARRAY.normals),
        r"the elements span 20 m, more than 10 m: is this in millimetres\?",
    ),
    "half a board": (lambda: at.flat_boards(1.5, 1), "whole number of rows, not 1.5"),
    "joining one": (lambda: at.join(ARRAY), "a list of 1 or more arrays, not a PhasedArray"),
    "joining others": (lambda: at.join([ARRAY, AIR]), "array 1 is a Medium, but it must be a PhasedArray"),
    "seen from a point": (lambda: ARRAY.seen_from(np.zeros(3)), r"where the hand is is an array of shape \(3,\)|hand"),
    "surface moved by a point": (lambda: at.sphere(0.01, 0.005).moved(np.zeros(3)), r"must be a Pose: give Pose\("),
    "turn about a plane": (lambda: at.Pose.turn((0, 1), 0.3), r"the axis of a rotation has shape \(2,\)"),
    "turn by words": (
        lambda: at.Pose.turn((0, 0, 1), "90"),
        "the angle of a rotation is '90', but it must be one real number",
    ),
    "array far off": (
        lambda: at.evaluate(SCENE, ARRAY.moved(FAR), DRIVE, TARGET, solver=FREE),
        r"element \d stands 100 m from focus 0, more than 10 m: is the array or its pose in millimetres\?",
    ),
    "focus from far off": (
        lambda: at.focus_by_distance(ARRAY.moved(FAR), TARGET, AIR, 40e3),
        "element . stands 100 m from focus 0",
    ),
    "focus by pistons in mm": (
        lambda: at.focus_by_distance(at.surrounding_box(at.piston(4.5)), TARGET, AIR, 40e3),
        r"ka = 3296.34, .* a radius of at most 6.55 mm",
    ),
    "many boards": (lambda: at.flat_boards(10**6, 10**6), r"span 1\.92e\+05 m, more than 10 m"),
    "depth at a point": (lambda: WATER_DROP.depth(np.zeros(3)), r"points have shape \(3,\)"),
    "depth nowhere": (lambda: at.Surface(*box_mesh()).depth(np.full((1, 3), np.nan)), "points hold 3 NaN or infinite"),
    "boundary in a list": (lambda: at.Obstacle(at.sphere(0.01, 0.005), ["sound_hard"]), "it is one of sound_hard"),
    "ragged triangles": (
        lambda: at.Surface(box_mesh()[0], [[0, 1], [0, 1, 2]]),
        "the 2 surface triangles do not have three indices each",
    ),
    "no path": (lambda: at.load_surface(None), "the path of a surface is a NoneType, but it must be a str . "),
    "drive in words": (lambda: at.Drive(["loud", "quiet"]), "the drive's amplitudes are a list of length 2, but they"),
    "warm air": (lambda: at.air(celsius="warm"), "the air's temperature is 'warm', but it must be one real number"),
}


@pytest.mark.parametrize("name", KINDS)
def test_another_kind_of_object_is_refused(name, monkeypatch):
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)  # as it is outside the tests
    call, sentence = KINDS[name]
    with pytest.raises(at.InvalidInput, match=sentence) as caught:
        call()
    assert "\n" not in str(caught.value)


LISTENERS = {"at": lambda field, p: field.at(p), "valid": lambda field, p: field.valid(p)}
FIELDS = {"open air": FIELD, "sphere": DROP_FIELD}


@pytest.mark.parametrize("field", FIELDS)
@pytest.mark.parametrize("listen", LISTENERS)
@pytest.mark.parametrize(
    ("points", "sentence"),
    [
        (np.zeros(3), r"points have shape \(3,\)"),
        (np.zeros((4, 2)), r"points have shape \(4, 2\)"),
        (np.array([[0, 0, 0], [0, np.nan, 0.1]]), r"points hold 1 NaN or infinite value, the first at index \[1, 1\]"),
        (np.array([[0, 0, np.inf]]), r"points hold 1 NaN or infinite value, the first at index \[0, 2\]"),
    ],
)
def test_points_to_listen_at_are_checked(field, listen, points, sentence, monkeypatch):
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)  # as it is outside the tests
    with pytest.raises(at.InvalidInput, match=sentence):
        LISTENERS[listen](FIELDS[field], points)


@pytest.mark.parametrize("field", FIELDS)
def test_a_point_on_a_source_is_refused(field):
    points = np.array([[0.0, 0.0, 0.05], [0.0, 0.0, 0.02 + 1e-12]])
    with pytest.raises(at.InvalidInput, match=r"point 1 stands on source 0 \(.*e-10 mm away\)"):
        FIELDS[field].at(points)


def test_listening_nowhere_gives_nothing():
    for field in FIELDS.values():
        assert field.at(np.zeros((0, 3))).shape == (0, 1)
        assert field.valid(np.zeros((0, 3))).shape == (0,)
