"""Shapes, shares, phases and suppression zones of a scene file become a target."""

import numpy as np
import pytest

import airtact as at
from faults import raises_code

HEAD = '[medium]\nsound_speed = 343.1\ndensity = 1.293\n[array]\nlayout = "surrounding_box"\n'


FINGERS = "[[obstacles]]\npinch = { gap = 0.012 }\n"


POINT = "[[foci]]\npoint = [0.0, 0.0, 0.03]\n"


@pytest.fixture
def read(read):
    return lambda *parts: read(HEAD, *parts)


SHAPES = {
    "segment = { start = [0, 0, 0.03], end = [0.02, 0, 0.03], spacing = 4e-3 }": at.acoustics.segment(
        (0, 0, 0.03), (0.02, 0, 0.03), 4e-3
    ),
    "polyline = { corners = [[0, 0, 0], [0.02, 0, 0], [0.02, 0.01, 0]], spacing = 4e-3, closed = true }": at.acoustics.polyline(
        np.array([[0, 0, 0], [0.02, 0, 0], [0.02, 0.01, 0]]), 4e-3, closed=True
    ),
    "circle = { centre = [0, 0, 0.03], radius = 0.01, normal = [0, 1, 1], spacing = 4e-3 }": at.acoustics.circle(
        (0, 0, 0.03), 0.01, 4e-3, normal=(0, 1, 1)
    ),
    "sphere_shell = { centre = [0, 0, 0.03], radius = 0.01, spacing = 5e-3 }": at.acoustics.sphere_shell(
        (0, 0, 0.03), 0.01, 5e-3
    ),
    'text = { words = "AIR", height = 0.02, spacing = 3e-3, centre = [0, 0, 0.03] }': at.acoustics.text(
        "AIR", 0.02, 3e-3, (0.0, 0.0, 0.03)
    ),
    'svg = { path = "M 0 0 H 10 V 5", width = 0.02, spacing = 3e-3, up = [1, 0, 0] }': at.acoustics.svg_path(
        "M 0 0 H 10 V 5", 0.02, 3e-3, up=(1.0, 0.0, 0.0)
    ),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_a_shape_is_the_points_of_its_function(read, shape) -> None:
    setup = read("[[foci]]\n", shape)
    np.testing.assert_allclose(setup.target.points, SHAPES[shape], atol=1e-12)
    assert setup.foci[0] == f"{shape.split()[0]} 1"
    assert len(setup.foci) == len(SHAPES[shape])
    assert (setup.target.pressures, setup.target.shares) == (None, None)


def test_shapes_points_and_names_go_together(read) -> None:
    ring = "[[foci]]\nname = 'ring'\ncircle = { centre = [0, 0, 0.03], radius = 0.01, spacing = 0.016 }\n"
    setup = read(POINT, "pressure = 500.0\n", ring, "pressure = 200.0\n")
    assert setup.foci == ("focus 1", "ring 1", "ring 2", "ring 3", "ring 4")
    assert setup.target.pressures.tolist() == [500.0, 200.0, 200.0, 200.0, 200.0]


def test_shares_and_phases_are_those_of_a_target(read) -> None:
    other = "[[foci]]\npoint = [0.0, 0.01, 0.03]\n"
    setup = read(
        POINT, "share = 1.0\nphase_degrees = 0.0\n", other, "share = 0.5\nphase_degrees = 180.0\n"
    )
    expected = at.Target(setup.target.points, shares=np.array([1.0, -0.5 + 0j]))
    np.testing.assert_allclose(setup.target.wanted, expected.wanted, atol=1e-12)
    phased = read(POINT, "phase_degrees = 90.0\n", other, "phase_degrees = 0.0\n").target
    np.testing.assert_allclose(phased.wanted, [1j, 1.0], atol=1e-12)
    strong = read(POINT, "phase_degrees = 90.0\npressure = 300.0\n").target
    np.testing.assert_allclose(strong.wanted, [300j], atol=1e-9)


def test_an_svg_file_lies_beside_the_scene(read, tmp_path) -> None:
    (tmp_path / "line.svg").write_text(
        '<svg xmlns="http://www.w3.org/2000/svg"><path d="M 0 0 H 10 V 5"/></svg>'
    )
    found = read(
        '[[foci]]\nsvg = { file = "line.svg", width = 0.02, spacing = 3e-3 }\n'
    ).target.points
    np.testing.assert_allclose(
        found, at.acoustics.svg_path("M 0 0 H 10 V 5", 0.02, 3e-3), atol=1e-12
    )


def test_suppression_zones_stand_beside_the_foci(read) -> None:
    back = '[[suppression]]\nsurface = { body = "finger", spacing = 4e-3, facing = [1, 0, 0], within = 60 }\n'
    head = (
        "[[suppression]]\nsphere_shell = { centre = [0, 0, 0.2], radius = 0.05, spacing = 0.03 }\n"
    )
    target = read(FINGERS, '[[foci]]\nat = "thumb.pad"\n', back, head).target
    finger = at.acoustics.surface_points(
        at.pinch().surfaces[1], 4e-3, facing=(1.0, 0.0, 0.0), within=60.0
    )
    np.testing.assert_allclose(
        target.suppression_points,
        [*finger, *at.acoustics.sphere_shell((0, 0, 0.2), 0.05, 0.03)],
        atol=1e-12,
    )
    assert len(target.points) == 1
    assert len(read(FINGERS, '[[foci]]\nat = "thumb.pad"\n').target.suppression_points) == 0


@pytest.mark.parametrize(
    ("code", "parts", "sentences"),
    [
        (
            "options_clash",
            (POINT, "circle = { centre = [0, 0, 0], radius = 1, spacing = 1 }"),
            ("foci[0]: set exactly one of ", "; 2 are set"),
        ),
        ("key_misplaced", (POINT, "offset = 1e-3"), ("foci[0]: offset is valid only with at",)),
        (
            "too_many",
            ("[[foci]]\ncircle = { centre = [0, 0, 0.03], radius = 10.0, spacing = 3e-3 }",),
            ("foci[0]: a spacing of 3 mm",),
        ),
        (
            "key_missing",
            ("[[foci]]\ncircle = { centre = [0, 0, 0], radius = 0.01 }",),
            ("the key foci[0].circle.spacing is missing",),
        ),
        (
            "unknown_key",
            ("[[foci]]\ncircle = { center = [0, 0, 0] }",),
            ("foci[0].circle.center is not a key ", "circle.centre"),
        ),
        (
            "key_missing",
            (POINT, "share = 1.0\n", POINT),
            ("foci: 1 of 2 have a share",),
        ),
        (
            "options_clash",
            (POINT, "share = 1.0\npressure = 3.0"),
            ("foci",),
        ),
        ("out_of_range", (POINT, "share = -1.0"), ("foci[0].share is -1",)),
        (
            "options_clash",
            ("[[foci]]\nsvg = { width = 0.02, spacing = 3e-3 }",),
            ("foci[0].svg: set exactly one of file, path; 0 are set",),
        ),
        (
            "file_missing",
            ('[[foci]]\nsvg = { file = "no.svg", width = 0.02, spacing = 3e-3 }',),
            ("foci[0]: the file ", "no.svg"),
        ),
        (
            "options_clash",
            (POINT, "[[suppression]]\n"),
            ("suppression[0]: set exactly one of point, ", ", surface; 0 are set"),
        ),
        (
            "unknown_name",
            (POINT, "[[suppression]]\nsurface = { body = 'palm', spacing = 4e-3 }"),
            ("suppression[0]: body = ", "there is no body"),
        ),
        (
            "unknown_name",
            (FINGERS, POINT, "[[suppression]]\nsurface = { body = 'fingr', spacing = 4e-3 }"),
            ('suppression[0]: body = "fingr" is not a body; did you mean finger',),
        ),
        (
            "inside_body",
            (FINGERS, POINT, "[[suppression]]\npoint = [0.014, 0, 0]"),
            ("suppression: ", "8 mm"),
        ),
        (
            "misplaced",
            (POINT, "[[suppression]]\npoint = [0.0, 0.0, 0.03]"),
            ("foci: suppression point 0 is 0 mm from focus 0",),
        ),
    ],
)
def test_what_cannot_be_is_rejected_with_its_table(read, code, parts, sentences) -> None:
    with raises_code(code, "scene.toml: " + sentences[0], *sentences[1:]):
        read(*parts)
