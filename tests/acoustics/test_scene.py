import math

import numpy as np
import pytest

import airtact as at
from airtact.acoustics.scene import (
    Obstacle,
    Scene,
    check_outside,
    check_sources,
    filled,
    impedance,
    sound_hard,
)
from faults import raises_code
from geometry.mesh.meshes import box_mesh, torus_mesh

AIR = at.Medium(sound_speed=343.1, density=1.293)
WATER = at.Medium(sound_speed=1481.0, density=999.7)


@pytest.fixture(scope="module")
def ball() -> at.Surface:
    return at.sphere(0.01, 0.005)


def test_the_wavenumber_carries_the_absorption():
    scene = Scene(at.air(20.0, 0.5, 40e3), [], frequency=40e3)
    assert scene.wavenumber.real == pytest.approx(
        2 * math.pi * 40e3 / scene.medium.sound_speed, rel=1e-14
    )
    assert scene.wavenumber.imag == scene.medium.absorption > 0
    assert scene.wavelength == scene.medium.sound_speed / 40e3


def test_obstacles_keep_what_they_are(ball):
    assert sound_hard(ball).boundary == "sound_hard"
    assert impedance(ball, 2 - 1j).ratio == 2 - 1j
    assert filled(ball, WATER).medium is WATER
    assert Scene(AIR, [sound_hard(ball)]).obstacles[0].surface is ball


def test_depth_is_the_largest_over_the_bodies(ball):
    scene = Scene(
        AIR, [sound_hard(ball), filled(at.sphere(0.005, 0.005, centre=(0.03, 0.0, 0.0)), WATER)]
    )
    points = np.array([[0.0, 0.0, 0.0], [0.03, 0.0, 0.0], [0.0, 0.0, 0.012], [0.024, 0.0, 0.0]])
    assert scene.depth(points) == pytest.approx([0.01, 0.005, -0.002, -0.001], abs=1e-17)


def test_nothing_is_deep_in_open_air():
    assert Scene(AIR, []).depth(np.zeros((2, 3))).tolist() == [-math.inf, -math.inf]


def test_points_outside_and_on_the_surface_pass(ball):
    scene = Scene(AIR, [sound_hard(ball)])
    check_outside(
        scene, np.array([[0.0, 0.0, 0.01], [0.0, 0.0, 0.01 - 0.9e-9], [1.0, 1.0, 1.0]]), "focus"
    )
    check_outside(Scene(AIR, []), np.zeros((1, 3)), "focus")


def test_points_inside_are_rejected_with_the_deepest_one(ball):
    scene = Scene(AIR, [sound_hard(ball)])
    points = np.array([[0.0, 0.0, 0.02], [0.0, 0.0, 0.009], [0.0075, 0.0, 0.0]])
    with raises_code(
        "inside_body",
    ):
        check_outside(scene, points, "focus")


def test_a_tenth_of_a_micrometre_is_inside(ball):
    with raises_code("inside_body"):
        check_outside(
            Scene(AIR, [sound_hard(ball)]), np.array([[0.0, 0.0, 0.01 - 1e-7]]), "transducer"
        )


def test_points_inside_a_mesh_are_rejected():
    scene = Scene(AIR, [sound_hard(at.Surface(*box_mesh((0, 0, 0), (0.02, 0.03, 0.04))))])
    with raises_code("inside_body"):
        check_outside(scene, np.array([[0.004, 0.015, 0.02]]), "focus")


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_points_that_are_not_finite_are_rejected(ball, value):
    with raises_code("not_finite"):
        check_outside(Scene(AIR, [sound_hard(ball)]), np.array([[0.0, 0.0, value]]), "focus")


@pytest.mark.parametrize("frequency", [0.0, -40e3, math.nan, math.inf])
def test_the_frequency_must_be_above_zero(frequency):
    with raises_code("out_of_range"):
        Scene(AIR, [], frequency)


def test_a_surface_that_crosses_itself_is_rejected():
    with raises_code("mesh_faulty"):
        Scene(AIR, [sound_hard(at.Surface(*torus_mesh(0.015, 0.02)))])


def test_bodies_that_overlap_are_rejected(ball):
    with raises_code("bodies_overlap"):
        Scene(AIR, [sound_hard(ball), sound_hard(at.sphere(0.01, 0.005, centre=(0.015, 0.0, 0.0)))])


@pytest.mark.parametrize(
    ("ratio", "written"),
    [(0, "0"), (-1 + 2j, "-1"), (math.nan, "nan"), (math.inf, "inf"), (complex(1, math.inf), "1")],
)
def test_an_impedance_that_emits_power_or_is_no_number_is_rejected(ball, ratio, written):
    with raises_code("out_of_range"):
        impedance(ball, complex(ratio))


def test_a_lossless_impedance_is_accepted(ball):
    assert impedance(ball, 3j).ratio == 3j


@pytest.mark.usefixtures("as_outside_the_tests")
@pytest.mark.parametrize(
    ("boundary", "ratio", "medium", "code"),
    [
        ("soft", None, None, "unknown_name"),
        ("impedance", None, None, "options_clash"),
        ("filled", None, None, "options_clash"),
        ("sound_hard", 2.0, None, "options_clash"),
        ("impedance", 2.0, WATER, "options_clash"),
    ],
)
def test_a_boundary_takes_what_it_needs_and_no_more(ball, boundary, ratio, medium, code):
    with raises_code(code):
        Obstacle(ball, boundary, ratio, medium)


@pytest.mark.usefixtures("as_outside_the_tests")
@pytest.mark.parametrize(
    ("make", "code"),
    [
        (lambda ball: Scene(AIR, [ball]), "wrong_kind"),
        (lambda ball: Scene(AIR, sound_hard(ball)), "wrong_kind"),
        (lambda ball: Scene(AIR, ball), "wrong_kind"),
        (lambda _: Scene(AIR, None), "wrong_kind"),
        (lambda ball: Scene(AIR, [sound_hard(ball), 3]), "wrong_kind"),
        (lambda _: Scene(343.0, []), "wrong_kind"),
        (lambda _: Scene(at.Medium, []), "wrong_kind"),
        (lambda _: Scene(AIR, [], "40e3"), "not_a_number"),
        (lambda _: Scene(AIR, [], None), "not_a_number"),
        (lambda _: sound_hard(at.pinch()), "wrong_kind"),
        (lambda ball: sound_hard(ball.vertices), "wrong_kind"),
        (lambda ball: filled(ball, 999.7), "wrong_kind"),
        (lambda ball: impedance(ball, "soft"), "not_a_number"),
    ],
)
def test_a_scene_of_the_wrong_kinds_is_rejected(ball, make, code):
    with raises_code(code):
        make(ball)


@pytest.mark.usefixtures("as_outside_the_tests")
def test_sources_are_monopoles(ball):
    scene, target = Scene(AIR, [sound_hard(ball)]), at.Target(np.array([[0.0, 0.0, 0.02]]))
    with raises_code("wrong_kind"):
        check_sources(scene, target)
    with raises_code("wrong_kind"):
        check_sources(scene, target.points)
    with raises_code("wrong_kind"):
        check_sources([scene], target.beacons())
    check_sources(scene, target.beacons())


def test_a_source_in_a_body_is_called_what_it_is(ball):
    scene, inside = Scene(AIR, [sound_hard(ball)]), np.array([[0.0, 0.0, 0.02], [0.0, 0.0, 0.007]])
    with raises_code("inside_body"):
        check_sources(scene, at.Target(inside).beacons())
    with raises_code("inside_body"):
        check_sources(scene, at.Monopoles(inside, np.eye(2)))
    with raises_code("inside_body"):
        check_sources(scene, at.Target(inside[1:]).beacons())


@pytest.mark.parametrize("frequency", [40.0, 999.0, 4e7])
def test_a_frequency_in_kilohertz_is_asked_about(frequency):
    with raises_code("out_of_range"):
        Scene(AIR, [], frequency)


def test_bodies_far_below_a_wavelength_are_asked_about():
    with raises_code("out_of_range"):
        Scene(AIR, [sound_hard(at.sphere(0.001, 0.001))], 1e3)
    assert Scene(AIR, [sound_hard(at.sphere(0.001, 0.001))], 4e3).obstacles
    assert Scene(
        AIR, [sound_hard(at.sphere(d / 2, 0.01, centre=(d, 0, 0))) for d in (2e-3, 2e-2)], 1e3
    ).obstacles


def test_real_ratios_are_numbers_too(ball):
    assert impedance(ball, 2.5).ratio == impedance(ball, 2.5 + 0j).ratio == 2.5
    assert impedance(ball, 3).ratio == 3.0


def test_bodies_placed_in_millimetres_are_asked_about(ball):
    far = at.sphere(0.01, 0.005, centre=(0.0, 0.0, 50.0))
    with raises_code("out_of_range"):
        Scene(AIR, [sound_hard(ball), sound_hard(far)])


def test_an_absorption_in_decibels_is_asked_about():
    with raises_code("out_of_range"):
        Scene(at.Medium(343.1, 1.293, absorption=1300), [])
    assert Scene(at.Medium(343.1, 1.293, absorption=100), []).wavenumber.imag == 100
