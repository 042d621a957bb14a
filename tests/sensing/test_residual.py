"""What is left of echoes, receiver by receiver, against noise and silence of known size and the closed form."""

import numpy as np
import pytest

import airtact as at

SCENE = at.Scene(at.air(celsius=20.0), [at.sound_hard(at.sphere(radius=5e-3, edge=2e-3))])
ARRAY = at.autd3_board(at.Pose(np.eye(3), np.array([-0.09, -0.07, -0.12])), element=at.monopole())
CODES = at.sensing.random_codes(249, 8)
HERE = at.Pose.identity()


@pytest.fixture(scope="module")
def scattering():
    return at.scattering_matrix(at.SphereSeries(), SCENE)


@pytest.fixture(scope="module")
def exact() -> at.Echoes:
    return at.simulate_echoes(at.SphereSeries(), SCENE, ARRAY, CODES)


def test_a_right_pose_leaves_the_noise_alone(exact, scattering) -> None:
    assert at.sensing.unexplained(exact, scattering, ARRAY, HERE).max() < 5e-3
    noisy = at.simulate_echoes(at.SphereSeries(), SCENE, ARRAY, CODES, noise=10.0, seed=1)
    left = at.sensing.unexplained(noisy, scattering, ARRAY, HERE)
    assert np.sqrt(np.mean(left**2)) == pytest.approx(np.sqrt(0.1 / 1.1), rel=0.03)


def test_a_dead_receiver_leaves_what_it_should_have_received_and_a_ringing_one_is_unknown(
    exact, scattering
) -> None:
    whole = np.asarray(exact.pressures)
    pressures = whole.copy()
    valid = np.ones(whole.shape, dtype=bool)
    pressures[3] = 0.0
    valid[7] = False
    valid[8, ::2] = False
    echoes = at.Echoes(CODES, pressures, valid=valid)
    left = at.sensing.unexplained(echoes, scattering, ARRAY, HERE)
    size = np.sqrt(np.mean(np.abs(pressures[valid]) ** 2))
    assert left[3] == pytest.approx(np.sqrt(np.mean(np.abs(whole[3]) ** 2)) / size, rel=0.01)
    assert np.isnan(left[7])
    assert np.nanmax(np.delete(left, 3)) < 5e-3


def test_a_pose_that_is_a_wavelength_off_leaves_more_than_the_echoes(exact, scattering) -> None:
    left = at.sensing.unexplained(
        exact, scattering, ARRAY, at.Pose(np.eye(3), np.array([9e-3, 0.0, 4e-3]))
    )
    assert 1.0 < np.sqrt(np.mean(left**2)) < 2.0
    with pytest.raises(at.InvalidInput) as caught:
        at.sensing.unexplained(exact, scattering, at.surrounding_box(), HERE)
    assert caught.value.code == "sizes_differ"
