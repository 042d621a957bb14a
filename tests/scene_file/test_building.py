"""A scene file becomes bodies, transducers and foci where it says; what cannot be is refused with a number."""

import numpy as np
import pytest

from airtact.conventions import InvalidInput
from airtact.figures.body_figure import sharp_edges
from airtact.scene.medium import air
from airtact.scene_file.building import drawable_bodies, read_scene
from airtact.solvers.free_field import FreeField
from airtact.surfaces.primitives import capsule
from airtact.synthesis.methods import METHODS
from paths import EXAMPLES

MEDIUM = "[medium]\nsound_speed = 343.1\ndensity = 1.293\n"
ARRAY = '[array]\nlayout = "surrounding_box"\n'
BALL = "[[obstacles]]\nsphere = { radius = 5e-3 }\n"
FOCUS = "[[foci]]\npoint = [0.0, 0.0, 8e-3]\n"


@pytest.fixture
def read(tmp_path):
    """Read a scene from its text."""

    def reader(*parts):
        path = tmp_path / "scene.toml"
        path.write_text("".join(parts))
        return read_scene(path)

    return reader


def refusal(read, *parts):
    with pytest.raises(InvalidInput) as caught:
        read(*parts)
    sentence = str(caught.value)
    assert sentence.startswith("scene.toml: ")
    assert "\n" not in sentence
    return sentence.removeprefix("scene.toml: ")


def test_the_papers_scene():
    setup = read_scene(EXAMPLES / "pinch.toml")
    assert (setup.scene.medium.sound_speed, setup.scene.medium.density) == (343.1, 1.293)
    assert len(setup.array) == 996
    assert setup.bodies == ("thumb", "finger")
    assert setup.foci == ("thumb.pad", "finger.pad")
    # 12 mm of gap less 0.5 mm on either side, on the line between the pads.
    np.testing.assert_allclose(setup.target.points, [[-5.5e-3, 0, 0], [5.5e-3, 0, 0]], atol=1e-12)
    assert setup.target.pressures is None


def test_the_open_hand_looks_at_the_boards():
    setup = read_scene(EXAMPLES / "open_hand.toml")
    foci, array = setup.target.points, setup.array
    np.testing.assert_allclose(setup.scene.depth(foci), -0.5e-3, atol=5e-6)
    np.testing.assert_allclose(array.normals, np.tile([1.0, 0.0, 0.0], (996, 1)), atol=1e-12)
    palm = foci[setup.foci.index("palm")]
    np.testing.assert_allclose((palm - array.positions) @ [1.0, 0.0, 0.0], 0.2, atol=1e-9)
    # Each focus but the thumb's stands between the skin and the boards, where nothing is in between.
    for focus in foci[1:]:
        way = focus - np.linspace(1e-4, 0.15, 300)[:, None] * [1.0, 0.0, 0.0]
        assert setup.scene.depth(way).max() < 0


def test_weather_is_air(read):
    setup = read("frequency = 25e3\n[medium]\ncelsius = 30.0\nhumidity = 0.2\n", ARRAY, BALL, FOCUS)
    expected = air(celsius=30.0, humidity=0.2, frequency=25e3)
    assert setup.scene.medium == expected
    assert setup.scene.frequency == 25e3


def test_absorption_is_kept(read):
    assert read(MEDIUM, "absorption = 0.15\n", ARRAY, BALL, FOCUS).scene.medium.absorption == 0.15


def test_a_capsule_stands_where_it_says(read):
    rod = "[[obstacles]]\ncapsule = { start = [0.02, 0.0, 0.0], end = [0.02, 0.0, 0.03], radius = 6e-3 }\n"
    surface = read(MEDIUM, ARRAY, rod, FOCUS).scene.obstacles[0].surface
    expected = capsule(np.array([0.02, 0, 0]), np.array([0.02, 0, 0.03]), radius=6e-3, edge=2.5e-3)
    np.testing.assert_array_equal(surface.vertices, expected.vertices)


def test_a_surface_is_found_beside_the_file_and_scaled(read, tmp_path):
    box = "solid box\n" + "".join(_facet(*corners) for corners in _box_facets(10.0)) + "endsolid box\n"
    (tmp_path / "box.stl").write_text(box)
    setup = read(MEDIUM, ARRAY, '[[obstacles]]\nsurface = "box.stl"\nscale = 1e-3\n', FOCUS)
    assert setup.bodies == ("box",)
    assert setup.scene.obstacles[0].surface.volume == pytest.approx(1e-6, rel=1e-6)


@pytest.mark.parametrize(("degrees", "creases"), [("", 24), ("sharp_degrees = 100.0\n", 0)])
def test_edges_stay_sharp_above_the_angle_asked(read, tmp_path, degrees, creases):
    box = "solid box\n" + "".join(_facet(*corners) for corners in _box_facets(10.0)) + "endsolid box\n"
    (tmp_path / "box.stl").write_text(box)
    focus = FOCUS.replace("8e-3", "20e-3")
    setup = read(MEDIUM, ARRAY, f'[[obstacles]]\nsurface = "box.stl"\nscale = 1e-3\n{degrees}', focus)
    surface = setup.scene.obstacles[0].surface
    assert surface.sharp_degrees == (100.0 if degrees else 75.0)
    assert sharp_edges(surface).sum() == creases  # twelve edges of 90 degrees, each of two triangles


def test_a_sharp_angle_goes_only_with_a_file(read):
    assert refusal(read, MEDIUM, ARRAY, BALL, "sharp_degrees = 30.0\n", FOCUS) == (
        "obstacles[0]: sharp_degrees goes only with surface."
    )


def test_bodies_that_nearly_touch_become_one_where_asked(read):
    balls = [BALL.replace("5e-3", f"5e-3, centre = [{x}, 0.0, 0.0]") for x in (0.0, 10.2e-3, 40e-3)]
    assert "bodies 0 and 1 are 0.2 mm apart" in refusal(read, MEDIUM, ARRAY, *balls, FOCUS)
    setup = read("merge_bodies = true\n", MEDIUM, ARRAY, *balls, FOCUS)
    assert setup.bodies == ("sphere + sphere 2", "sphere 3")
    one, other = (obstacle.surface for obstacle in setup.scene.obstacles)
    ball = 4 / 3 * np.pi * 5e-3**3
    assert one.volume == pytest.approx(2 * ball, rel=0.02)
    assert other.volume == pytest.approx(ball, rel=1e-3)


def test_bodies_of_another_skin_are_not_merged(read):
    other = BALL.replace("5e-3", "5e-3, centre = [10.2e-3, 0.0, 0.0]") + 'boundary = "impedance"\nratio = 5.0\n'
    sentence = refusal(read, "merge_bodies = true\n", MEDIUM, ARRAY, BALL, other, FOCUS)
    assert "bodies 0 and 1 are 0.2 mm apart" in sentence


def test_bodies_that_can_be_drawn_are_found_though_the_scene_is_refused(tmp_path):
    facets = _box_facets(10.0)
    (tmp_path / "open.stl").write_text("solid\n" + "".join(_facet(*corners) for corners in facets[1:]) + "endsolid\n")
    path = tmp_path / "scene.toml"
    files = [f'[[obstacles]]\nsurface = "{name}"\nscale = 1e-3\n' for name in ("open.stl", "missing.stl")]
    path.write_text("".join([MEDIUM, ARRAY, BALL, *files, FOCUS]))
    with pytest.raises(InvalidInput, match=r"scene.toml: obstacles\[1\]: open.stl: "):
        read_scene(path)
    ball, box = drawable_bodies(path)
    assert len(ball[1]) > 100
    assert len(box[1]) == 11
    np.testing.assert_allclose(np.ptp(box[0], axis=0), 0.01)
    path.write_text("[medium")
    with pytest.raises(InvalidInput, match="this is not TOML"):
        drawable_bodies(path)


def test_two_bodies_of_a_kind_are_told_apart(read):
    setup = read(MEDIUM, ARRAY, BALL, BALL.replace("5e-3", "5e-3, centre = [0.03, 0.0, 0.0]"), FOCUS)
    assert setup.bodies == ("sphere", "sphere 2")


def test_the_offset_is_off_the_skin(read):
    pinch = "[[obstacles]]\npinch = { gap = 0.02 }\n"
    focus = '[[foci]]\nat = "finger.pad"\noffset = 2e-3\n'
    np.testing.assert_allclose(read(MEDIUM, ARRAY, pinch, focus).target.points, [[8e-3, 0, 0]], atol=1e-12)


def test_pressures_and_method_are_passed_on(read):
    setup = read(MEDIUM, ARRAY, BALL, FOCUS, "pressure = 700.0\n", '[drive]\nmethod = "phase_conjugate"\n')
    np.testing.assert_array_equal(setup.target.pressures, [700.0])
    assert setup.synthesise is METHODS["phase_conjugate"]
    assert setup.method == "phase_conjugate"


def test_pistons(read):
    element = read(MEDIUM, ARRAY, "piston_radius = 4.5e-3\nsensitivity = 2.0\n", BALL, FOCUS).array.element
    assert (element.radius, element.sensitivity) == (4.5e-3, 2.0)


def test_boards_stand_where_their_poses_say(read):
    array = """[array]
layout = "boards"
[[array.poses]]
translation = [0.0, 0.0, -0.1]
[[array.poses]]
axis = [0.0, 1.0, 0.0]
degrees = 180.0
translation = [0.0, 0.0, 0.1]
"""
    setup = read(MEDIUM, array, BALL, FOCUS)
    assert len(setup.array) == 2 * 249
    np.testing.assert_allclose(setup.array.positions[[0, 249]], [[0, 0, -0.1], [0, 0, 0.1]], atol=1e-12)
    np.testing.assert_allclose(setup.array.normals[[0, 249]], [[0, 0, 1], [0, 0, -1]], atol=1e-12)


def test_the_arrays_pose_is_where_it_stands(read):
    moved = ARRAY + "[array.pose]\nrotation = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]\n"
    plain, turned = (
        read(MEDIUM, array, BALL, FOCUS).array for array in (ARRAY, moved + "translation = [0.0, 0.0, 0.01]\n")
    )
    x, y, z = plain.positions.T
    np.testing.assert_allclose(turned.positions, np.stack([-y, x, z + 0.01], axis=1), atol=1e-12)


def test_an_array_from_a_file(read, tmp_path):
    (tmp_path / "ring.csv").write_text("x,y,z,nx,ny,nz\n0.1,0,0,-1,0,0\n0, 0.1, 0, 0, -2, 0\n")
    array = read(MEDIUM, '[array]\nlayout = "ring.csv"\n', BALL, FOCUS).array
    np.testing.assert_array_equal(array.positions, [[0.1, 0, 0], [0, 0.1, 0]])
    np.testing.assert_allclose(array.normals, [[-1, 0, 0], [0, -1, 0]])


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (
            "x,y,z\n",
            "array: ring.csv has no column nx, ny, nz: it needs x, y, z, nx, ny, nz, and has 3 columns, x, y, z.",
        ),
        (
            "x,y,z,nx,ny,nz\n0.1,0,0,-1,0,0\n0.1,0,0,-1\n",
            "array: line 3 of ring.csv has 4 cells, but there are 6 columns, x, y, z, nx, ny, nz.",
        ),
        ("x,y,z,nx,ny,nz\na,b,c,d,e,f\n", "array: line 2 of ring.csv has 'a' for x, which is not a number."),
        ("x,y,z,nx,ny,nz\n", "array: ring.csv holds 0 transducers."),
    ],
)
def test_a_faulty_array_file_is_refused(read, tmp_path, text, sentence):
    (tmp_path / "ring.csv").write_text(text)
    assert refusal(read, MEDIUM, '[array]\nlayout = "ring.csv"\n', BALL, FOCUS) == sentence


@pytest.mark.parametrize(
    ("parts", "start"),
    [
        (
            ["[medium]\ncelsius = 20.0\ndensity = 1.2\n", ARRAY, BALL, FOCUS],
            "medium: give celsius and humidity, or sound_",
        ),
        (
            ["[medium]\nsound_speed = 340.0\n", ARRAY, BALL, FOCUS],
            "medium: give celsius and humidity, or sound_speed and",
        ),
        (["[medium]\n", ARRAY, BALL, FOCUS], "medium: give celsius and humidity, or sound_speed and density; nothing"),
        ([MEDIUM.replace("1.293", "-1.3"), ARRAY, BALL, FOCUS], "medium: density is -1.3"),
        (["frequency = -4e4\n", MEDIUM, ARRAY, BALL, FOCUS], "frequency is -40000"),
        (
            [MEDIUM, ARRAY, "[[obstacles]]\n", FOCUS],
            "obstacles[0]: give exactly one of pinch, capsule, sphere, surface, hand; 0",
        ),
        (
            [MEDIUM, ARRAY, BALL, "pinch = {}\n", FOCUS],
            "obstacles[0]: give exactly one of pinch, capsule, sphere, surface, hand; 2",
        ),
        ([MEDIUM, ARRAY, "[[obstacles]]\npinch = { gap = -0.01 }\n", FOCUS], "obstacles[0]: gap is -0.01"),
        ([MEDIUM, ARRAY, '[[obstacles]]\nsurface = "no.stl"\n', FOCUS], "obstacles[0]: there is no file"),
        ([MEDIUM, ARRAY, BALL, "scale = 2.0\n", FOCUS], "obstacles[0]: scale goes only with surface"),
        ([MEDIUM, ARRAY, BALL, "ratio = 2.0\n", FOCUS], 'obstacles[0]: ratio goes only with boundary = "impedance"'),
        ([MEDIUM, ARRAY, BALL, 'boundary = "impedance"\n', FOCUS], 'obstacles[0]: boundary = "impedance" needs ratio'),
        (
            [MEDIUM, ARRAY, BALL, 'boundary = "impedance"\nratio = [5.0, 1.0]\n', FOCUS],
            "solver: body 0 is impedance, but boundary_element solves sound_hard bodies only",
        ),
        (
            [MEDIUM, ARRAY, BALL, 'boundary = "filled"\nmedium = { sound_speed = 1481.0, density = 999.7 }\n', FOCUS],
            "solver: body 0 is filled, but boundary_element solves sound_hard bodies only",
        ),
        ([MEDIUM, ARRAY, BALL, BALL, FOCUS], "bodies 0 and 1 overlap or touch: 10 mm deep"),
        (
            [MEDIUM, ARRAY, FOCUS, '[solver]\nname = "boundary_element"'],
            "solver: the scene has 0 obstacles, and boundary_element needs one or more",
        ),
        (
            [MEDIUM, ARRAY.replace("box", "bax"), BALL, FOCUS],
            'array: layout = "surrounding_bax" is neither a known layout',
        ),
        ([MEDIUM, '[array]\nlayout = "boards"\n', BALL, FOCUS], 'array: layout = "boards" needs poses'),
        ([MEDIUM, '[array]\nlayout = "none.csv"\n', BALL, FOCUS], "array: the file {folder}/none.csv does not exist"),
        ([MEDIUM, ARRAY, "rows = 2\n", BALL, FOCUS], 'array: rows goes only with layout = "flat_boards"'),
        ([MEDIUM, ARRAY, "[array.pose]\ndegrees = 3.0\n", BALL, FOCUS], "array: pose: axis and degrees go together"),
        (
            [MEDIUM, ARRAY, "[array.pose]\ndegrees = 3.0\nrotation = [[1,0,0],[0,1,0],[0,0,1]]\n", BALL, FOCUS],
            "array: pose: give rotation, or axis and degrees, not both",
        ),
        ([MEDIUM, ARRAY, "piston_radius = -1e-3\n", BALL, FOCUS], "array: the radius of a piston is -0.001 m"),
        (
            [MEDIUM, ARRAY, BALL, "[[foci]]\n"],
            "foci[0]: give exactly one of at, point, segment, polyline, circle, sphere_shell",
        ),
        ([MEDIUM, ARRAY, BALL, FOCUS, "offset = 1e-3\n"], "foci[0]: offset goes only with at"),
        (
            [MEDIUM, ARRAY, BALL, '[[foci]]\nat = "thumb.pad"\n'],
            'foci[0]: at = "thumb.pad" is not a place of a body; no',
        ),
        ([MEDIUM, ARRAY, BALL, FOCUS, FOCUS, "pressure = 5.0\n"], "foci: 1 of 2 have a pressure; give it to all"),
        ([MEDIUM, ARRAY, BALL, FOCUS, "pressure = -5.0\n"], "foci: a target pressure is -5 Pa"),
        ([MEDIUM, ARRAY, BALL, FOCUS.replace("8e-3", "nan")], "foci: target points hold 1 NaN"),
        (["foci = []\n", MEDIUM, ARRAY, BALL], "foci: target points are empty (0 points)"),
        (
            [MEDIUM, ARRAY, BALL, FOCUS, '[solver]\nname = "finite_elemant"\n'],
            'solver: "finite_elemant" is not a solver here',
        ),
        ([MEDIUM, ARRAY, BALL, FOCUS, "[solver]\naccuracy = 0.9\n"], "solver: accuracy is 0.9"),
        (
            [MEDIUM, ARRAY, BALL, FOCUS, '[drive]\nmethod = "time_reversl"\n'],
            'drive: "time_reversl" is not a method here; did',
        ),
        (
            [MEDIUM, ARRAY, BALL, FOCUS, "[drive]\nlevels = 16\n"],
            "drive: levels = 16, but drives are written in 256 levels",
        ),
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence(read, tmp_path, parts, start):
    assert refusal(read, *parts).startswith(start.replace("{folder}", str(tmp_path)))


def test_an_unknown_place_names_the_nearest(read):
    pinch = "[[obstacles]]\npinch = {}\n"
    sentence = refusal(read, MEDIUM, ARRAY, pinch, '[[foci]]\nat = "thumb.pat"\n')
    assert sentence == 'foci[0]: at = "thumb.pat" is not a place of a body; did you mean thumb.pad?'
    sentence = refusal(read, MEDIUM, ARRAY, pinch, '[[foci]]\nat = "thumb.pad"\noffset = -1e-3\n')
    assert sentence == "foci[0]: offset = -0.001 m must be 0 (on the skin) or more."
    sentence = refusal(read, MEDIUM, ARRAY, pinch, '[[foci]]\nat = "thumb.pad"\noffset = 0.5\n')
    assert sentence.startswith(
        "foci[0]: offset = 0.5 m does not lie in the gap of 12 mm before thumb.pad: is it in mill"
    )


def test_a_focus_inside_a_body_is_refused_with_its_depth(read):
    sentence = refusal(read, MEDIUM, ARRAY, BALL, FOCUS.replace("8e-3", "3e-3"))
    assert sentence.startswith("foci: ")
    assert "2 mm deep" in sentence


def test_a_transducer_inside_a_body_is_refused_with_its_depth(read, tmp_path):
    (tmp_path / "ring.csv").write_text("x,y,z,nx,ny,nz\n0.1,0,0,-1,0,0\n0,1e-3,0,0,-1,0\n")
    sentence = refusal(read, MEDIUM, '[array]\nlayout = "ring.csv"\n', BALL, FOCUS)
    assert sentence.startswith("array: ")
    assert "4 mm deep" in sentence


def test_a_file_that_cannot_be_read_is_refused(tmp_path):
    with pytest.raises(InvalidInput, match=r"the file .*no\.toml does not exist"):
        read_scene(tmp_path / "no.toml")
    (tmp_path / "bytes.toml").write_bytes(b"frequency = 1\n\xff")
    with pytest.raises(InvalidInput, match=r"bytes\.toml is not a text file: byte 14"):
        read_scene(tmp_path / "bytes.toml")


@pytest.mark.parametrize("name", METHODS)
def test_a_file_can_name_every_method(read, name):
    setup = read(MEDIUM, ARRAY, FOCUS, f'[drive]\nmethod = "{name}"')
    assert setup.synthesise is METHODS[name]


def test_open_air_is_solved_in_closed_form(read):
    assert isinstance(read(MEDIUM, ARRAY, FOCUS).solver, FreeField)
    with pytest.raises(InvalidInput, match="the scene has 1 obstacle, and free_field is for open air"):
        read(MEDIUM, ARRAY, BALL, FOCUS, '[solver]\nname = "free_field"')


def _box_facets(side):
    corners = np.array([[x, y, z] for x in (0, side) for y in (0, side) for z in (0, side)]) + 2 * side
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return [corners[list(part)] for a, b, c, d in quads for part in ((a, b, c), (a, c, d))]


def _facet(*corners):
    vertices = "".join("vertex {} {} {}\n".format(*corner) for corner in corners)
    return f"facet normal 0 0 0\nouter loop\n{vertices}endloop\nendfacet\n"
