import math

import numpy as np
import pytest
from meshes import box_mesh, torus_mesh

from airtact.conventions import InvalidInput
from airtact.scene.geometry import Surface
from airtact.scene.medium import Medium, air
from airtact.scene.primitives import sphere
from airtact.scene.scene import Obstacle, Scene, check_outside, filled, impedance, sound_hard

AIR = Medium(sound_speed=343.1, density=1.293)
WATER = Medium(sound_speed=1481.0, density=999.7)


@pytest.fixture(scope="module")
def ball() -> Surface:
    return sphere(0.01, 0.005)


def test_the_wavenumber_carries_the_absorption():
    scene = Scene(air(20.0, 0.5, 40e3), [], frequency=40e3)
    assert scene.wavenumber.real == pytest.approx(2 * math.pi * 40e3 / scene.medium.sound_speed, rel=1e-14)
    assert scene.wavenumber.imag == scene.medium.absorption > 0
    assert scene.wavelength == scene.medium.sound_speed / 40e3


def test_obstacles_keep_what_they_are(ball):
    assert sound_hard(ball).boundary == "sound_hard"
    assert impedance(ball, 2 - 1j).ratio == 2 - 1j
    assert filled(ball, WATER).medium is WATER
    assert Scene(AIR, [sound_hard(ball)]).obstacles[0].surface is ball


def test_depth_is_the_largest_over_the_bodies(ball):
    scene = Scene(AIR, [sound_hard(ball), filled(sphere(0.005, 0.005, centre=(0.03, 0.0, 0.0)), WATER)])
    points = np.array([[0.0, 0.0, 0.0], [0.03, 0.0, 0.0], [0.0, 0.0, 0.012], [0.024, 0.0, 0.0]])
    assert scene.depth(points) == pytest.approx([0.01, 0.005, -0.002, -0.001], abs=1e-17)


def test_nothing_is_deep_in_open_air():
    assert Scene(AIR, []).depth(np.zeros((2, 3))).tolist() == [-math.inf, -math.inf]


def test_points_outside_and_on_the_skin_pass(ball):
    scene = Scene(AIR, [sound_hard(ball)])
    check_outside(scene, np.array([[0.0, 0.0, 0.01], [0.0, 0.0, 0.01 - 0.9e-9], [1.0, 1.0, 1.0]]), "focus")
    check_outside(Scene(AIR, []), np.zeros((1, 3)), "focus")


def test_points_inside_are_refused_with_the_deepest_one(ball):
    scene = Scene(AIR, [sound_hard(ball)])
    points = np.array([[0.0, 0.0, 0.02], [0.0, 0.0, 0.009], [0.0075, 0.0, 0.0]])
    with pytest.raises(
        InvalidInput, match=r"2 of 3 focus points lie inside a body: focus 2 at \(7.50, 0.00, 0.00\) mm is 2.5 mm deep"
    ):
        check_outside(scene, points, "focus")


def test_a_tenth_of_a_micrometre_is_inside(ball):
    with pytest.raises(InvalidInput, match=r"transducer 0 .* is 0.0001 mm deep"):
        check_outside(Scene(AIR, [sound_hard(ball)]), np.array([[0.0, 0.0, 0.01 - 1e-7]]), "transducer")


def test_points_inside_a_mesh_are_refused():
    scene = Scene(AIR, [sound_hard(Surface(*box_mesh((0, 0, 0), (0.02, 0.03, 0.04))))])
    with pytest.raises(InvalidInput, match=r"focus 0 .* is 4 mm deep"):
        check_outside(scene, np.array([[0.004, 0.015, 0.02]]), "focus")


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_points_that_are_not_finite_are_refused(ball, value):
    with pytest.raises(InvalidInput, match=r"focus points hold 1 NaN or infinite values, the first at index \[0, 2\]"):
        check_outside(Scene(AIR, [sound_hard(ball)]), np.array([[0.0, 0.0, value]]), "focus")


@pytest.mark.parametrize("frequency", [0.0, -40e3, math.nan, math.inf])
def test_the_frequency_must_be_above_zero(frequency):
    with pytest.raises(InvalidInput, match=f"frequency is {frequency:g} Hz"):
        Scene(AIR, [], frequency)


def test_a_surface_that_crosses_itself_is_refused():
    with pytest.raises(InvalidInput, match=r"crosses itself: \d+ pairs of triangles"):
        Scene(AIR, [sound_hard(Surface(*torus_mesh(0.015, 0.02)))])


def test_bodies_that_overlap_are_refused(ball):
    with pytest.raises(InvalidInput, match="bodies 0 and 1 overlap or touch: 5 mm deep"):
        Scene(AIR, [sound_hard(ball), sound_hard(sphere(0.01, 0.005, centre=(0.015, 0.0, 0.0)))])


@pytest.mark.parametrize(
    ("ratio", "said"), [(0, "0"), (-1 + 2j, "-1"), (math.nan, "nan"), (math.inf, "inf"), (complex(1, math.inf), "1")]
)
def test_an_impedance_that_gives_off_power_or_is_no_number_is_refused(ball, ratio, said):
    with pytest.raises(InvalidInput, match=f"impedance ratio is {said}"):
        impedance(ball, complex(ratio))


def test_a_lossless_impedance_is_accepted(ball):
    assert impedance(ball, 3j).ratio == 3j


@pytest.mark.usefixtures("as_outside_the_tests")
@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("soft", None, None), "boundary is 'soft', but it is one of sound_hard, impedance, filled"),
        (("impedance", None, None), "boundary impedance has ratio None and medium None"),
        (("filled", None, None), "boundary filled has ratio None and medium None"),
        (("sound_hard", 2.0, None), "boundary sound_hard has ratio 2.0 and medium None"),
        (("impedance", 2.0, WATER), "boundary impedance has ratio 2.0 and medium Medium"),
    ],
)
def test_a_boundary_takes_what_it_needs_and_no_more(ball, arguments, sentence):
    boundary, ratio, medium = arguments
    with pytest.raises(InvalidInput, match=sentence):
        Obstacle(ball, boundary, ratio, medium)
