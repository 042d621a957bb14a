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


def test_depth_is_the_largest_over_the_bodies(ball):
    scene = Scene(
        AIR, [sound_hard(ball), filled(at.sphere(0.005, 0.005, centre=(0.03, 0.0, 0.0)), WATER)]
    )
    points = np.array([[0.0, 0.0, 0.0], [0.03, 0.0, 0.0], [0.0, 0.0, 0.012], [0.024, 0.0, 0.0]])
    assert scene.depth(points) == pytest.approx([0.01, 0.005, -0.002, -0.001], abs=1e-17)


def test_points_outside_and_on_the_surface_pass(ball):
    points = np.array([[0.0, 0.0, 0.01], [0.0, 0.0, 0.01 - 0.9e-9], [1.0, 1.0, 1.0]])
    check_outside(Scene(AIR, [sound_hard(ball)]), points, "focus")
    check_outside(Scene(AIR, []), np.zeros((1, 3)), "focus")


BALL = at.sphere(0.01, 0.005)
BLOCK = at.Surface(*box_mesh((0, 0, 0), (0.02, 0.03, 0.04)))


@pytest.mark.parametrize(
    ("surface", "points", "code"),
    [
        (BALL, [[0.0, 0.0, 0.02], [0.0, 0.0, 0.009], [0.0075, 0.0, 0.0]], "inside_body"),
        (BALL, [[0.0, 0.0, 0.01 - 1e-7]], "inside_body"),
        (BLOCK, [[0.004, 0.015, 0.02]], "inside_body"),
        (BALL, [[0.0, 0.0, np.nan]], "not_finite"),
        (BALL, [[0.0, 0.0, np.inf]], "not_finite"),
    ],
)
def test_points_inside_or_nowhere_are_rejected(surface, points, code):
    with raises_code(code):
        check_outside(Scene(AIR, [sound_hard(surface)]), np.array(points), "focus")


@pytest.mark.parametrize("frequency", [0.0, -40e3, math.nan, math.inf, 40.0, 999.0, 4e7])
def test_a_frequency_is_above_zero_and_in_hertz(frequency):
    with raises_code("out_of_range"):
        Scene(AIR, [], frequency)


@pytest.mark.parametrize("ratio", [0, -1 + 2j, math.nan, math.inf, complex(1, math.inf)])
def test_an_impedance_that_emits_power_or_is_no_number_is_rejected(ball, ratio):
    with raises_code("out_of_range"):
        impedance(ball, complex(ratio))


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
        (lambda _: Scene(AIR, [sound_hard(at.Surface(*torus_mesh(0.015, 0.02)))]), "mesh_faulty"),
        (
            lambda ball: Scene(
                AIR, [sound_hard(ball), sound_hard(at.sphere(0.01, 5e-3, (0.015, 0, 0)))]
            ),
            "bodies_overlap",
        ),
        (lambda _: Scene(AIR, [sound_hard(at.sphere(0.001, 0.001))], 1e3), "out_of_range"),
        # in millimetres, and in decibels per kilometre
        (
            lambda ball: Scene(
                AIR, [sound_hard(ball), sound_hard(at.sphere(0.01, 5e-3, (0, 0, 50)))]
            ),
            "not_in_metres",
        ),
        (lambda _: Scene(at.Medium(343.1, 1.293, absorption=1300), []), "out_of_range"),
    ],
)
def test_a_scene_that_cannot_be_is_rejected(ball, make, code):
    with raises_code(code):
        make(ball)


INSIDE = np.array([[0.0, 0.0, 0.02], [0.0, 0.0, 0.007]])
TARGET = at.Target(INSIDE[:1])


@pytest.mark.usefixtures("as_outside_the_tests")
@pytest.mark.parametrize(
    ("sources", "code"),
    [
        (TARGET, "wrong_kind"),
        (TARGET.points, "wrong_kind"),
        (at.Target(INSIDE).beacons(), "inside_body"),
        (at.Monopoles(INSIDE, np.eye(2)), "inside_body"),
    ],
)
def test_sources_are_monopoles_outside_the_bodies(ball, sources, code):
    scene = Scene(AIR, [sound_hard(ball)])
    check_sources(scene, TARGET.beacons())
    with raises_code("wrong_kind"):
        check_sources([scene], TARGET.beacons())
    with raises_code(code):
        check_sources(scene, sources)
