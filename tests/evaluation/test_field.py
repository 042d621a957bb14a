"""Forward fields of drives against closed forms."""

import numpy as np
import pytest

import airtact as at
from faults import raises_code

AIR = at.Medium(343.1, 1.293)
FORWARD = np.array([[0.0, 0.0, 1.0]])
FULL = at.Drive(np.ones(1, dtype=np.complex128))


@pytest.mark.parametrize("height", [0.02, 0.05, 0.2, 1.0])
def test_a_piston_on_its_axis_is_the_closed_form(height: float) -> None:
    """Mean of e^{ikr}/r over a disc seen from its axis: 2/(ik a²) (e^{ik√(z²+a²)} − e^{ikz})."""
    radius, k = 4.5e-3, at.Scene(AIR, []).wavenumber.real
    array = at.PhasedArray(np.zeros((1, 3)), FORWARD, at.piston(radius, sensitivity=1.0))
    computed = at.field_map(
        at.Scene(AIR, []), array, FULL, height * FORWARD, solver=at.FreeField()
    )[0]
    edge = np.exp(1j * k * np.hypot(height, radius)) - np.exp(1j * k * height)
    assert abs(computed - 2.0 / (1j * k * radius**2) * edge) < 1e-6 * abs(computed)


def test_sources_are_the_faces_element_by_element_with_one_sound_per_drive() -> None:
    array = at.autd3_board(at.Pose.turn((1, 1, 0), 0.3), at.piston(4.5e-3))
    random = np.random.default_rng(1)
    drives = [
        at.Drive(random.uniform(-0.7, 0.7, 249) + 1j * random.uniform(-0.7, 0.7, 249))
        for _ in range(3)
    ]
    sources = at.evaluation.drive_sources(array, drives)
    assert sources.strengths.shape == (249 * 19, 3)
    for sound, drive in enumerate(drives):
        strengths = sources.strengths[:, sound].reshape(249, 19)
        np.testing.assert_allclose(strengths.sum(axis=1), 4.38 * drive.amplitudes, rtol=1e-12)
        expected = 4.38 * array.element.weights[7] * drive.amplitudes[100]
        assert strengths[100, 7] == pytest.approx(expected, rel=1e-12)
    np.testing.assert_array_equal(sources.positions[100 * 19 + 7], array.face_points[100, 7])


def test_a_map_is_linear_in_the_drive_and_not_a_number_inside_a_body() -> None:
    scene = at.Scene(AIR, [at.sound_hard(at.sphere(0.010, edge=4e-3))])
    array = at.autd3_board(at.Pose.turn((0, 1, 0), 0.0, (-0.09, -0.07, -0.1)))
    array = at.PhasedArray(array.positions[::25], array.normals[::25])
    points = np.array([[0.0, 0.0, 0.012], [0.0, 0.0, 0.005], [0.03, 0.0, 0.0]])
    random = np.random.default_rng(2)
    first, second = (np.exp(2j * np.pi * random.uniform(size=len(array))) / 2 for _ in range(2))
    one, other, both = (
        at.field_map(scene, array, at.Drive(amplitudes), points, solver=at.SphereSeries())
        for amplitudes in (first, second, first + second)
    )
    assert np.isnan(both).tolist() == [False, True, False]
    np.testing.assert_allclose(both[[0, 2]], (one + other)[[0, 2]], rtol=1e-9)


def test_drives_that_do_not_fit_raise() -> None:
    array = at.autd3_board()
    with raises_code("sizes_differ"):
        at.field_map(at.Scene(AIR, []), array, FULL, FORWARD, solver=at.FreeField())
    with raises_code("too_few"):
        at.evaluation.drive_sources(array, [])
