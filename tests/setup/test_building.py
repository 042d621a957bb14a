"""A scene file becomes bodies, transducers and foci at their positions; what cannot be is rejected with a number."""

import numpy as np
import pytest
import trimesh

import airtact as at
from airtact.reports.body_figure import sharp_edges
from airtact.transducers.boards import BOARDS
from faults import facts, raises_code
from paths import EXAMPLES

MEDIUM = "[medium]\nsound_speed = 343.1\ndensity = 1.293\n"


ARRAY = '[array]\nlayout = "surrounding_box"\n'


BALL = "[[obstacles]]\nsphere = { radius = 5e-3 }\n"


FOCUS = "[[foci]]\npoint = [0.0, 0.0, 8e-3]\n"


def fails(read, code, start, *parts):
    """Expect a code, any where None, and one sentence that names the file and the facts of ``start``."""
    with pytest.raises(at.InvalidInput) as caught:
        read(*parts)
    assert code in (None, caught.value.code)
    sentence = str(caught.value)
    assert sentence.startswith("scene.toml: "), sentence
    assert [fact for fact in facts(start) if fact not in sentence] == [], sentence
    assert "\n" not in sentence
    return sentence


def test_the_papers_scene():
    setup = at.read_scene(EXAMPLES / "pinch.toml")
    assert (setup.scene.medium.sound_speed, setup.scene.medium.density) == (343.1, 1.293)
    assert len(setup.array) == 996
    assert setup.bodies == ("thumb", "finger")
    assert setup.foci == ("thumb.pad", "finger.pad")
    # 12 mm of gap less 0.5 mm on either side, on the line between the pads.
    np.testing.assert_allclose(setup.target.points, [[-5.5e-3, 0, 0], [5.5e-3, 0, 0]], atol=1e-12)
    assert setup.target.pressures is None


def test_the_medium_is_air_of_some_weather_or_any_fluid(read):
    assert read(MEDIUM, "absorption = 0.15\n", ARRAY, BALL, FOCUS).medium.absorption == 0.15
    setup = read("frequency = 25e3\n[medium]\ncelsius = 30.0\nhumidity = 0.2\n", ARRAY, BALL, FOCUS)
    assert setup.scene.medium == at.air(celsius=30.0, humidity=0.2, frequency=25e3)
    assert setup.scene.frequency == 25e3


@pytest.mark.parametrize(("degrees", "creases"), [("", 24), ("sharp_degrees = 100.0\n", 0)])
def test_a_surface_beside_the_file_is_scaled_and_keeps_sharp_edges(
    read, tmp_path, degrees, creases
):
    box = trimesh.creation.box(extents=(10.0, 10.0, 10.0))
    box.apply_translation([25.0, 25.0, 25.0]).export(tmp_path / "box.stl")
    focus = FOCUS.replace("8e-3", "20e-3")
    setup = read(
        MEDIUM, ARRAY, f'[[obstacles]]\nsurface = "box.stl"\nscale = 1e-3\n{degrees}', focus
    )
    assert setup.bodies == ("box",)
    surface = setup.scene.obstacles[0].surface
    np.testing.assert_allclose(np.ptp(surface.vertices, axis=0), 0.01)
    assert surface.sharp_degrees == (100.0 if degrees else 75.0)
    assert (
        sharp_edges(surface).sum() == creases
    )  # twelve edges of 90 degrees, each of two triangles


def test_bodies_that_nearly_touch_become_one_where_asked(read):
    balls = [BALL.replace("5e-3", f"5e-3, centre = [{x}, 0.0, 0.0]") for x in (0.0, 10.2e-3, 40e-3)]
    with raises_code("bodies_overlap"):
        read(MEDIUM, ARRAY, *balls, FOCUS)
    setup = read("merge_bodies = true\n", MEDIUM, ARRAY, *balls, FOCUS)
    assert setup.bodies == ("sphere + sphere 2", "sphere 3")
    one, other = (obstacle.surface for obstacle in setup.scene.obstacles)
    ball = 4 / 3 * np.pi * 5e-3**3
    assert one.volume == pytest.approx(2 * ball, rel=0.02)
    assert other.volume == pytest.approx(ball, rel=1e-3)


def test_bodies_of_another_boundary_are_not_merged(read):
    other = (
        BALL.replace("5e-3", "5e-3, centre = [10.2e-3, 0.0, 0.0]")
        + 'boundary = "impedance"\nratio = 5.0\n'
    )
    with raises_code("bodies_overlap"):
        read("merge_bodies = true\n", MEDIUM, ARRAY, BALL, other, FOCUS)


def test_pressures_and_method_are_passed_on(read):
    setup = read(
        MEDIUM, ARRAY, BALL, FOCUS, "pressure = 700.0\n", '[drive]\nmethod = "phase_conjugate"\n'
    )
    np.testing.assert_array_equal(setup.target.pressures, [700.0])
    assert setup.synthesise is at.drives.METHODS["phase_conjugate"]
    assert setup.method == "phase_conjugate"


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
    np.testing.assert_allclose(
        setup.array.positions[[0, 249]], [[0, 0, -0.1], [0, 0, 0.1]], atol=1e-12
    )
    np.testing.assert_allclose(setup.array.normals[[0, 249]], [[0, 0, 1], [0, 0, -1]], atol=1e-12)


def test_the_arrays_pose_is_where_it_stands(read):
    moved = (
        ARRAY + "[array.pose]\nrotation = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]\n"
    )
    plain, turned = (
        read(MEDIUM, array, BALL, FOCUS).array
        for array in (ARRAY, moved + "translation = [0.0, 0.0, 0.01]\n")
    )
    x, y, z = plain.positions.T
    np.testing.assert_allclose(turned.positions, np.stack([-y, x, z + 0.01], axis=1), atol=1e-12)


def test_an_array_from_a_file(read, tmp_path):
    (tmp_path / "ring.csv").write_text("x,y,z,nx,ny,nz\n0.1,0,0,-1,0,0\n0, 0.1, 0, 0, -2, 0\n")
    array = read(MEDIUM, '[array]\nlayout = "ring.csv"\n', BALL, FOCUS).array
    np.testing.assert_array_equal(array.positions, [[0.1, 0, 0], [0, 0.1, 0]])
    np.testing.assert_allclose(array.normals, [[-1, 0, 0], [0, -1, 0]])


def test_monopoles_in_a_file_need_no_directions(read, tmp_path):
    (tmp_path / "ring.csv").write_text("x,y,z\n0.1,0,0\n0,0.1,0\n")
    own = '[array]\nlayout = "ring.csv"\nsource = "monopole"\n'
    array = read(MEDIUM, own, BALL, FOCUS).array
    np.testing.assert_array_equal(array.positions, [[0.1, 0, 0], [0, 0.1, 0]])
    assert not array.element.directional


def test_an_array_file_may_number_its_rows_in_any_order(read, tmp_path):
    for names, high, low in (
        ("index", "1", "0"),
        ("element", "1", "0"),
        ("index,element", "1,1", "0,0"),
    ):
        (tmp_path / "ring.csv").write_text(
            f"{names},x,y,z,nx,ny,nz\n{high},0,0.1,0,0,-1,0\n{low},0.1,0,0,-1,0,0\n"
        )
        array = read(MEDIUM, '[array]\nlayout = "ring.csv"\n', BALL, FOCUS).array
        np.testing.assert_array_equal(array.positions, [[0.1, 0, 0], [0, 0.1, 0]])


@pytest.mark.parametrize(
    ("code", "text", "sentence"),
    [
        (
            "does_not_match",
            "index,element,x,y,z,nx,ny,nz\n1,0,0.1,0,0,-1,0,0\n0,1,0,0.1,0,0,-1,0\n",
            "array: the columns index and element of ring.csv differ; keep one of them.",
        ),
        (
            "out_of_range",
            "element,x,y,z,nx,ny,nz\n1,0.1,0,0,-1,0,0\n1,0,0.1,0,0,-1,0\n",
            "array: element is 1 in line 2 of ring.csv, but this column must contain each "
            "number from 0 to 1 once.",
        ),
        (
            "data_missing",
            "x,y,z\n",
            "array: ring.csv has no column nx, ny, nz: the columns must be x, y, z, nx, ny, nz, "
            "but are x, y, z.",
        ),
        (
            "wrong_shape",
            "x,y,z,nx,ny,nz\n0.1,0,0,-1,0,0\n0.1,0,0,-1\n",
            "array: line 3 of ring.csv has 4 cells, but there are 6 columns, x, y, z, nx, ny, nz.",
        ),
        (
            "file_unreadable",
            "x,y,z,nx,ny,nz\na,b,c,d,e,f\n",
            "array: line 2 of ring.csv has 'a' for x, which is not a number.",
        ),
        ("empty", "x,y,z,nx,ny,nz\n", "array: ring.csv has no transducers."),
    ],
)
def test_a_faulty_array_file_is_rejected(read, tmp_path, code, text, sentence):
    (tmp_path / "ring.csv").write_text(text)
    fails(read, code, sentence, MEDIUM, '[array]\nlayout = "ring.csv"\n', BALL, FOCUS)


@pytest.mark.parametrize(
    ("code", "parts", "start"),
    [
        (
            "key_misplaced",
            ["[medium]\ncelsius = 20.0\ndensity = 1.2\n", ARRAY, BALL, FOCUS],
            "medium: density is valid only with sound_speed.",
        ),
        (
            "key_missing",
            ["[medium]\nsound_speed = 340.0\n", ARRAY, BALL, FOCUS],
            "medium: sound_speed requires density",
        ),
        (
            "options_clash",
            ["[medium]\n", ARRAY, BALL, FOCUS],
            "medium: set exactly one of celsius, sound_speed; 0 are set.",
        ),
        (
            "out_of_range",
            [MEDIUM.replace("1.293", "1.3e6"), ARRAY, BALL, FOCUS],
            "medium: density is 1.3e+06",
        ),
        ("out_of_range", ["frequency = -4e4\n", MEDIUM, ARRAY, BALL, FOCUS], "frequency is -40000"),
        (
            "options_clash",
            [MEDIUM, ARRAY, "[[obstacles]]\n", FOCUS],
            "obstacles[0]: set exactly one of pinch, capsule, sphere, surface, hand; 0",
        ),
        (
            "options_clash",
            [MEDIUM, ARRAY, BALL, "pinch = {}\n", FOCUS],
            "obstacles[0]: set exactly one of pinch, capsule, sphere, surface, hand; 2",
        ),
        (
            "out_of_range",
            [MEDIUM, ARRAY, "[[obstacles]]\npinch = { gap = -0.01 }\n", FOCUS],
            "obstacles[0].pinch.gap is -0.01, but it must be above 0.",
        ),
        (None, [MEDIUM, ARRAY, '[[obstacles]]\nsurface = "no.stl"\n', FOCUS], "obstacles[0]: "),
        (
            "key_misplaced",
            [MEDIUM, ARRAY, BALL, "scale = 2.0\n", FOCUS],
            "obstacles[0]: scale is valid only with surface.",
        ),
        (
            "key_misplaced",
            [MEDIUM, ARRAY, BALL, "ratio = 2.0\n", FOCUS],
            'obstacles[0]: ratio is valid only with boundary = "impedance".',
        ),
        (
            "key_missing",
            [MEDIUM, ARRAY, BALL, 'boundary = "impedance"\n', FOCUS],
            'obstacles[0]: boundary = "impedance" requires ratio',
        ),
        (
            "not_supported",
            [
                MEDIUM,
                ARRAY,
                BALL,
                'boundary = "filled"\nmedium = { sound_speed = 1481.0, density = 999.7 }\n',
                FOCUS,
            ],
            "solver: boundary_element does not solve body 0",
        ),
        (None, [MEDIUM, ARRAY, BALL, BALL, FOCUS], "bodies 0 and 1 overlap or touch: 10 mm deep"),
        (
            "not_supported",
            [MEDIUM, ARRAY, FOCUS, '[solver]\nname = "boundary_element"'],
            "solver: boundary_element does not solve a scene with no obstacles",
        ),
        (
            "unknown_name",
            [MEDIUM, ARRAY.replace("box", "bax"), BALL, FOCUS],
            'array: layout = "surrounding_bax" is neither a .csv file nor a known layout; did you mean surrounding_box?',
        ),
        (
            "key_missing",
            [MEDIUM, '[array]\nlayout = "boards"\n', BALL, FOCUS],
            'array: layout = "boards" requires poses',
        ),
        (
            "out_of_range",
            [MEDIUM, '[array]\nlayout = "boards"\nposes = []\n', BALL, FOCUS],
            "array.poses: expected a list of length >= 1.",
        ),
        (
            "file_missing",
            [MEDIUM, '[array]\nlayout = "none.csv"\n', BALL, FOCUS],
            "array: the file {folder}/none.csv does not exist",
        ),
        (
            "key_misplaced",
            [MEDIUM, ARRAY, "rows = 2\n", BALL, FOCUS],
            'array: rows is valid only with layout = "flat_boards".',
        ),
        (
            "key_missing",
            [MEDIUM, ARRAY, "[array.pose]\ndegrees = 3.0\n", BALL, FOCUS],
            "array.pose: degrees requires axis",
        ),
        (
            "key_misplaced",
            [
                MEDIUM,
                ARRAY,
                "[array.pose]\naxis = [1, 0, 0]\ndegrees = 3\nrotation = "
                "[[1,0,0],[0,1,0],[0,0,1]]\n",
                BALL,
                FOCUS,
            ],
            "array.pose: rotation cannot be combined with axis.",
        ),
        (
            "out_of_range",
            [MEDIUM, ARRAY, "piston_radius = -1e-3\n", BALL, FOCUS],
            "array.piston_radius is -0.001",
        ),
        (
            "options_clash",
            [MEDIUM, ARRAY, BALL, "[[foci]]\n"],
            "foci[0]: set exactly one of at, point, segment, polyline, circle, sphere_shell",
        ),
        (
            "key_misplaced",
            [MEDIUM, ARRAY, BALL, FOCUS, "offset = 1e-3\n"],
            "foci[0]: offset is valid only with at",
        ),
        (
            "key_misplaced",
            [
                MEDIUM,
                ARRAY,
                "[[obstacles]]\npinch = {}\n",
                '[[foci]]\nat = "thumb.pad"\nonto = "thumb"\n',
            ],
            "foci[0]: onto cannot be combined with at.",
        ),
        (
            "unknown_name",
            [MEDIUM, ARRAY, BALL, '[[foci]]\nat = "thumb.pad"\n'],
            'foci[0]: at = "thumb.pad" is not a named point of a body; no',
        ),
        (
            "key_missing",
            [MEDIUM, ARRAY, BALL, FOCUS, FOCUS, "pressure = 5.0\n"],
            "foci: only 1 of 2 tables set a pressure",
        ),
        (
            "out_of_range",
            [MEDIUM, ARRAY, BALL, FOCUS, "pressure = -5.0\n"],
            "foci[0].pressure is -5",
        ),
        (
            "not_finite",
            [MEDIUM, ARRAY, BALL, FOCUS.replace("8e-3", "nan")],
            "foci[0]",
        ),
        (
            "key_missing",
            ["foci = []\n", MEDIUM, ARRAY, BALL],
            "the key foci is missing: add [[foci]] or [[objects]].",
        ),
        (
            "wrong_kind",
            [MEDIUM, ARRAY, BALL, FOCUS.replace("[[foci]]", "[foci]")],
            "foci is a table, but it must be a list of tables: write [[foci]]",
        ),
        (
            "wrong_kind",
            [MEDIUM, '[array]\nlayout = "boards"\nposes = {}\n', BALL, FOCUS],
            "array.poses is a table, but it must be a list of tables: write [[array.poses]]",
        ),
        (
            "unknown_name",
            [MEDIUM, ARRAY, BALL, FOCUS, '[solver]\nname = "finite_elemant"\n'],
            'solver.name = "finite_elemant" is not known; did you mean finite_element?',
        ),
        (
            None,
            [MEDIUM, ARRAY, BALL, FOCUS, "[solver]\naccuracy = 0.9\n"],
            "solver.accuracy is 0.9",
        ),
        (
            "unknown_name",
            [MEDIUM, ARRAY, BALL, FOCUS, '[drive]\nmethod = "time_reversl"\n'],
            'drive: "time_reversl" is not a method; did you mean time_reversal?',
        ),
        (
            "out_of_range",
            [MEDIUM, ARRAY, BALL, FOCUS, "[drive]\nlevels = 1\n"],
            "drive.levels is 1, but it must be at least 2 and at most 256.",
        ),
        (
            "out_of_range",
            [MEDIUM, ARRAY, BALL, FOCUS, "[drive]\nlevels = { phase = 257 }\n"],
            "drive.levels.phase is 257",
        ),
    ],
)
def test_what_cannot_be_is_rejected_in_one_sentence(read, tmp_path, code, parts, start):
    fails(read, code, start.replace("{folder}", str(tmp_path)), *parts)


def test_a_setup_offers_all_that_playing_its_drive_needs(read):
    pose = "[array.pose]\naxis = [0.0, 1.0, 0.0]\ndegrees = 90.0\ntranslation = [0.0, 0.0, 0.1]\n"
    setup = read("frequency = 41e3\n", MEDIUM, ARRAY + 'source = "monopole"\n', pose, FOCUS)
    assert (setup.frequency, setup.medium, setup.board) == (41e3, setup.scene.medium, "autd3")
    assert len(setup.poses) == 4
    for face, place in enumerate(setup.poses):
        there = place.apply(at.transducers.board_named("autd3").positions)
        np.testing.assert_allclose(
            setup.array.positions[249 * face : 249 * (face + 1)], there, atol=1e-12
        )


def test_an_unknown_point_of_a_body_names_the_nearest(read):
    pinch = "[[obstacles]]\npinch = {}\n"
    sentence = 'foci[0]: at = "thumb.pat" is not a named point of a body; did you mean thumb.pad?'
    fails(read, "unknown_name", sentence, MEDIUM, ARRAY, pinch, '[[foci]]\nat = "thumb.pat"\n')
    for offset, code, sentence in (
        (-1e-3, "out_of_range", "foci[0].offset is -0.001"),
        (
            0.5,
            "not_in_metres",
            "foci[0]: offset = 0.5 m exceeds the gap of 12 mm in front of thumb.pad: is it in mill",
        ),
    ):
        focus = f'[[foci]]\nat = "thumb.pad"\noffset = {offset}\n'
        fails(read, code, sentence, MEDIUM, ARRAY, pinch, focus)


def test_a_file_that_cannot_be_read_is_rejected(tmp_path):
    with raises_code("file_missing", str(tmp_path / "no.toml")):
        at.read_scene(tmp_path / "no.toml")
    (tmp_path / "bytes.toml").write_bytes(b"frequency = 1\n\xff")
    with raises_code("file_unreadable"):
        at.read_scene(tmp_path / "bytes.toml")


@pytest.mark.parametrize(
    ("text", "amplitudes", "phases"),
    [
        ("", 256, 256),
        ("[drive]\nlevels = 16\n", 16, 16),
        ("[drive]\nlevels = 2\n", 2, 2),
        ("[drive]\nlevels = { amplitude = 64, phase = 32 }\n", 64, 32),
        ("[drive]\nlevels = { phase = 32 }\n", 256, 32),
    ],
)
def test_levels_are_any_of_2_to_256_amplitude_and_phase_apart(read, text, amplitudes, phases):
    levels = read(MEDIUM, ARRAY, BALL, FOCUS, text).levels
    assert levels.same_as(at.transducers.Levels.even(amplitudes, phases))


# --- Boards and calibration ---


ONE_BOARD = '[array]\nlayout = "boards"\nposes = [{ translation = [0.0, 0.0, -0.1] }]\n'


def test_a_box_of_real_boards(read) -> None:
    array = read(MEDIUM, ARRAY, 'board = "autd3"\n', BALL, FOCUS).array
    np.testing.assert_array_equal(array.positions, at.surrounding_box(board="autd3").positions)
    assert abs(array.positions[0, 0]) == pytest.approx(75.7e-3, abs=1e-12)


def test_calibration_is_read_from_beside_the_scene(read, tmp_path) -> None:
    (tmp_path / "gains.csv").write_text("element,gain,phase\n5,0,0\n248,0.5,0.1\n")
    array = read(MEDIUM, ONE_BOARD, 'calibration = "gains.csv"\n', BALL, FOCUS).array
    assert array.gains[5] == 0.0
    assert array.gains[248] == pytest.approx(0.5 * np.exp(0.1j))
    assert np.count_nonzero(array.gains == 1.0) == 247


@pytest.mark.parametrize(
    ("text", "code", "sentence"),
    [
        (
            ONE_BOARD + 'board = "autd4"',
            "unknown_name",
            "scene.toml: array: 'autd4'",
        ),
        (
            ARRAY + 'board = "nano16"',
            "unknown_name",
            "nano16",
        ),
        (
            '[array]\nlayout = "flat_boards"\nboard = "autd3"',
            "key_misplaced",
            'array: board is valid only with layout = "surrounding_box" or layout = "boards".',
        ),
        (
            ONE_BOARD + 'calibration = "none.csv"',
            "file_missing",
            "scene.toml: array: calibration: the file ",
        ),
        (
            ONE_BOARD + 'calibration = "bad.csv"',
            "unknown_name",
            "line 2 of bad.csv: there is no element 249",
        ),
    ],
)
def test_bad_boards_are_rejected(read, tmp_path, text: str, code: str, sentence: str) -> None:
    (tmp_path / "bad.csv").write_text("element,gain,phase\n249,1,0\n")
    with raises_code(code, sentence):
        read(MEDIUM, text, "\n", BALL, FOCUS)


# --- Poses of bodies, and the pattern of transducers ---


PINCH = "[[obstacles]]\npinch = { gap = 0.012 }\n"


POSE = (
    "[obstacles.pose]\naxis = [0.0, 0.0, 1.0]\ndegrees = 90.0\ntranslation = [0.0, 0.01, 0.002]\n"
)


PAD = '[[foci]]\nat = "thumb.pad"\n'


def test_a_pose_moves_a_body_and_the_foci_that_ride_on_it(read) -> None:
    before, after = read(MEDIUM, ARRAY, PINCH, PAD), read(MEDIUM, ARRAY, PINCH, POSE, PAD)
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    shift = np.array([0.0, 0.01, 0.002])
    np.testing.assert_allclose(
        after.target.points, before.target.points @ quarter.T + shift, atol=1e-12
    )
    for one, other in zip(before.scene.obstacles, after.scene.obstacles, strict=True):
        np.testing.assert_allclose(
            other.surface.vertices, one.surface.vertices @ quarter.T + shift, atol=1e-12
        )
    assert -after.scene.depth(after.target.points)[0] == pytest.approx(0.5e-3, abs=1e-9)


@pytest.mark.parametrize(
    "board", [board for board in BOARDS.values() if board.placed], ids=lambda board: board.name
)
def test_boards_have_the_pistons_of_their_transducers(read, board) -> None:
    array = f'[array]\nlayout = "boards"\nboard = "{board.name}"\nposes = [{{ translation = [0.0, 0.0, -0.1] }}]\n'
    element = read(MEDIUM, array, "[[foci]]\npoint = [0.0, 0.0, 0.0]\n").array.element
    assert element.directional
    assert element.radius == board.radius


def test_a_source_is_a_monopole_by_name(read) -> None:
    focus = "[[foci]]\npoint = [0.0, 0.0, 0.0]\n"
    assert not read(MEDIUM, ARRAY, 'source = "monopole"\n', focus).array.element.directional
    with raises_code("unknown_name"):
        read(MEDIUM, ARRAY, 'source = "pistn"\n', focus)
    with raises_code("key_misplaced"):
        read(MEDIUM, ARRAY, 'source = "monopole"\npiston_radius = 4e-3\n', focus)


def test_a_pose_is_no_scene(tmp_path) -> None:
    with raises_code("unknown_format"):
        at.read_scene(tmp_path / "pinch.json")


# --- Modulation ---


@pytest.mark.parametrize(
    ("text", "modulation"),
    [
        ("", None),
        ('[drive.modulation]\nkind = "am"', at.transducers.AmplitudeModulation(200.0, 1.0)),
        (
            '[drive.modulation]\nkind = "am"\nfrequency = 80\ndepth = 0.5',
            at.transducers.AmplitudeModulation(80.0, 0.5),
        ),
        ('[drive.modulation]\nkind = "lm"', at.drives.Motion("lm")),
        (
            '[drive.modulation]\nkind = "lm"\npath = "line"\nlength = 6e-3',
            at.drives.Motion("lm", "line", 6e-3),
        ),
        (
            '[drive.modulation]\nkind = "stm"\nradius = 0.02\nfrequency = 60.0\nframes = 40\nalong = "array"',
            at.drives.Motion("stm", None, 0.02, 60.0, 40, "array"),
        ),
    ],
)
def test_a_scene_says_how_its_drive_is_modulated(read, text: str, modulation) -> None:
    assert read(MEDIUM, ARRAY, FOCUS, text).modulation == modulation


@pytest.mark.parametrize("name", sorted(path.name for path in EXAMPLES.glob("*.toml")))
def test_the_examples_are_felt(name: str) -> None:
    setup = at.read_scene(EXAMPLES / name)
    expected = None if setup.traps else at.transducers.AmplitudeModulation(200.0, 1.0)
    assert setup.modulation == expected


@pytest.mark.parametrize(
    ("text", "code", "shown"),
    [
        ("frequency = 200.0", "key_missing", "drive.modulation.kind is missing"),
        ('kind = "fm"', "unknown_name", 'drive.modulation.kind = "fm"'),
        ('kind = "am"\nradius = 3e-3', "key_misplaced", "drive.modulation: radius"),
        (
            'kind = "am"\ndepth = 1.5',
            "out_of_range",
            "drive: modulation: the depth of the modulation is 1.5",
        ),
        ('kind = "lm"\npath = "square"', "unknown_name", 'path = "square"'),
        ('kind = "lm"\nlength = 3e-3', "key_misplaced", "length is valid only with"),
        (
            'kind = "lm"\npath = "line"\nradius = 3e-3',
            "key_misplaced",
            "radius cannot be combined with",
        ),
        ('kind = "stm"\npath = "points"', "too_few", "there is 1"),
        ('kind = "lm"\nspeed = 3', "unknown_key", "drive.modulation.speed"),
    ],
)
def test_a_modulation_that_cannot_be_is_rejected(read, text: str, code: str, shown: str) -> None:
    with raises_code(code, shown):
        read(MEDIUM, ARRAY, FOCUS, f"[drive.modulation]\n{text}\n")


# --- Rigid planes ---


OVER_PLANE = """
frequency = 40e3
[medium]
sound_speed = 343.1
density = 1.293
[array]
layout = "flat_boards"
[[planes]]
point = [0.0, 0.0, 0.0]
normal = [0.0, 0.0, 1.0]
[[obstacles]]
sphere = { radius = 0.004, centre = [0.08, 0.06, 0.1] }
[[foci]]
point = [0.08, 0.06, 0.095]
"""


def test_a_plane_is_read_from_a_file(read):
    setup = read(OVER_PLANE)
    (plane,) = setup.scene.planes
    assert np.array_equal(plane.normal, [0, 0, 1])
    assert isinstance(setup.solver, at.BoundaryElement)


@pytest.mark.parametrize(
    ("code", "words", "old", "new"),
    [
        ("behind_plane", "foci: ", "0.095]", "-0.005]"),
        ("bodies_overlap", "body 0 reaches 104 mm behind", "0.0, 1.0]", "0.0, -1.0]"),
        ("behind_plane", "array: ", "point = [0.0, 0.0, 0.0]", "point = [0.0, 0.0, 0.001]"),
        ("out_of_range", "planes[0]: ", "normal = [0.0, 0.0, 1.0]", "normal = [0.0, 0.0, 0.0]"),
        ("not_supported", "solver: ", "[[foci]]", '[solver]\nname = "finite_element"\n[[foci]]'),
    ],
)
def test_what_does_not_go_with_a_plane_is_rejected_by_its_table(read, code, words, old, new):
    with raises_code(code, words):
        read(OVER_PLANE.replace(old, new))


# --- Boards that reflect ---


REFLECTING = """
frequency = 40e3
[medium]
celsius = 20
[array]
layout = "boards"
poses = [{ translation = [-0.086, -0.066, 0.0] }]
reflects = true
[[obstacles]]
sphere = { radius = 0.008, centre = [0.0, 0.0, 0.1] }
[[foci]]
point = [0.0, 0.0, 0.091]
[solver]
accuracy = 0.1
"""


LAYOUT = 'layout = "boards"\nposes = [{ translation = [-0.086, -0.066, 0.0] }]'


OWN = "x,y,z,nx,ny,nz\n0,0,0,0,0,1\n0.01,0,0,0,0,1\n"


def test_boards_reflect_as_the_file_says(read):
    setup = read(REFLECTING)
    assert setup.bodies == ("sphere", "boards")
    assert [obstacle.board for obstacle in setup.scene.obstacles] == [False, True]
    assert np.abs(setup.scene.obstacles[1].surface.depth(setup.array.positions)).max() < 1e-9
    raised = "reflects = true\npose = { translation = [0, 0, 0.01] }"
    moved = read(REFLECTING.replace("reflects = true", raised))
    assert np.isclose(moved.scene.obstacles[1].surface.vertices[:, 2].max(), 0.01)
    assert len(read(REFLECTING.replace("reflects = true", "")).scene.obstacles) == 1


@pytest.mark.parametrize(
    ("code", "words", "old", "new"),
    [
        ("bodies_overlap", "body 0 cuts into", "0.1]", "0.005]"),
        ("unknown_name", "openmpd", 'layout = "boards"', 'layout = "boards"\nboard = "openmpd"'),
        ("not_supported", "finite_element", "[solver]", '[solver]\nname = "finite_element"'),
        ("wrong_kind", "", LAYOUT, 'layout = "own.csv"'),
    ],
)
def test_what_does_not_go_with_reflecting_boards_is_rejected(read, tmp_path, code, words, old, new):
    (tmp_path / "own.csv").write_text(OWN)
    with raises_code(code, words):
        read(REFLECTING.replace(old, new))


# --- Finite elements ---


WATER = """
frequency = 40e3
[medium]
sound_speed = 343.1
density = 1.293
[array]
layout = "surrounding_box"
[[obstacles]]
sphere = { radius = 0.004 }
boundary = "filled"
medium = { sound_speed = 1481.0, density = 999.7 }
[[foci]]
point = [0.0, 0.0, 0.006]
[solver]
name = "finite_element"
accuracy = ACCURACY
"""


@pytest.mark.parametrize(("accuracy", "order"), [("0.03", 4), ("0.01", 5), ("0.002", 6)])
def test_finite_elements_are_taken_for_a_filled_body(read, accuracy, order):
    setup = read(WATER.replace("ACCURACY", accuracy))
    assert setup.solver == at.FiniteElement(order=order)
    assert at.setup.verification_solver(setup) == at.FiniteElement(order=order + 1)


def test_more_than_finite_elements_reach_is_rejected(read):
    with raises_code("out_of_range"):
        read(WATER.replace("ACCURACY", "0.0001"))
