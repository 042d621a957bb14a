"""Poses from echoes that another mesh made: found as well as the noise allows, or not believed."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import airtact as at
from airtact.sensing.echo_model import EchoModel, further_motion
from airtact.sensing.transmission import noisy
from faults import raises_code
from sensing.sensed_scenes import (
    AIR,
    BOX,
    CODES,
    TRUE,
    capsules,
    errors,
    measured,
    off_by,
    relative,
    solved,
)


def located(echoes: at.Echoes, start: at.Pose, array: at.PhasedArray = BOX) -> at.sensing.Located:
    return at.locate(echoes, capsules(), array, start, scattering=solved())


def test_a_pose_nearby_is_found_and_how_sure_it_is() -> None:
    found = located(measured(), off_by(TRUE, 2e-3, np.radians(3), seed=0))
    position, angle = errors(found.pose)
    assert found.converged, found
    assert position < 5e-6
    assert angle < np.radians(0.05)
    assert found.residual == pytest.approx(np.hypot(10 ** (-30 / 20), found.misfit), rel=0.02)
    assert found.deviation[0] < 5e-6
    assert np.all(np.diag(found.bound) <= np.diag(found.covariance))
    assert not len(found.left_out)


def test_a_pose_is_found_from_5_mm_and_8_degrees_off() -> None:
    found = located(measured(), off_by(TRUE, 5e-3, np.radians(8), seed=1))
    assert found.converged, found
    assert errors(found.pose)[0] < 5e-6


def test_errors_are_near_the_cramer_rao_bound() -> None:
    pure = at.simulate_echoes(solved(), capsules(), BOX.seen_from(TRUE), CODES[:, :2]).pressures
    middle = TRUE.apply(solved().centre[None])[0]
    squares = []
    for seed in range(8):
        pressures, deviation = noisy(pure, 20.0, seed)
        found = located(at.Echoes(CODES[:, :2], pressures, noise=deviation), TRUE)
        turn = Rotation.from_matrix(found.pose.rotation @ TRUE.rotation.T).as_rotvec()
        error = np.concatenate([found.centre - middle, turn])
        squares.append(error @ np.linalg.solve(found.bound, error))
    assert 3.0 < np.mean(squares) < 10.0  # chi squared with 6 degrees of freedom: 6 ± 1.2


def test_a_wrong_model_is_not_believed_and_its_doubt_covers_how_far_it_is_off() -> None:
    found = located(measured(gap=0.014), off_by(TRUE, 1e-3, np.radians(2), seed=0))
    assert not found.converged
    assert found.misfit > 0.12
    assert "NOT converged" in repr(found)
    assert 0.3 < errors(found.pose)[0] / found.deviation[0] < 3.0


def test_dead_receivers_are_left_out() -> None:
    dead = np.array([5, 100, 700])
    pressures = measured().pressures.copy()
    pressures[dead] = 0.0
    echoes = replace(measured(), pressures=pressures)
    found = located(echoes, off_by(TRUE, 1e-3, np.radians(2), seed=0))
    assert found.converged
    assert found.left_out.tolist() == dead.tolist()


def test_a_pose_is_found_while_the_emitting_board_rings() -> None:
    boards = np.repeat(np.arange(4), 249)
    codes = at.sensing.random_codes(996, 8, seed=4) * (boards[:, None] == np.arange(8) % 4)
    seen = BOX.seen_from(TRUE)
    echoes = at.simulate_echoes(solved(), capsules(), seen, codes, noise=30.0)
    echoes = replace(echoes, valid=codes == 0.0)
    found = located(echoes, off_by(TRUE, 1e-3, np.radians(2), seed=0))
    assert found.converged, found
    assert errors(found.pose)[0] < 5e-6
    assert found.residual == pytest.approx(10 ** (-30 / 20), rel=0.05)
    assert found.misfit < 0.01
    assert not len(found.left_out)


def test_derivatives_are_those_of_the_echoes() -> None:
    model = EchoModel.of(
        solved(), BOX.seen_from(TRUE), CODES[:, :2], np.arange(0, 996, 50), spare=9
    )
    twist = np.array([9e-4, -4e-4, 7e-4, 0.02, 0.03, -0.01])
    derivatives = np.tensordot(further_motion(twist).T, model.derivatives(twist), 1)
    for axis in range(6):
        step = (1e-4 if axis < 3 else 4e-3) * np.eye(6)[axis]
        near, far = (
            model.echoes(twist + scale * step) - model.echoes(twist - scale * step)
            for scale in (1, 2)
        )
        # central differences of the fourth order, in single precision
        assert relative((8 * near - far) / (12 * step.max()), derivatives[axis]) < 2e-4


NOISE = np.random.default_rng(0).normal(size=(2, 996, 8)).T @ [1, 1j]
CLIPPED = np.clip(NOISE.real, -0.5, 0.5) + 1j * np.clip(NOISE.imag, -0.5, 0.5)


@pytest.mark.parametrize(
    ("code", "locate"),
    [
        ("sizes_differ", lambda: located(measured(), TRUE, at.autd3_board())),
        (
            "does_not_match",
            lambda: located(at.Echoes(CODES, measured().pressures, frequency=25e3), TRUE),
        ),
        ("inside_body", lambda: located(measured(), at.Pose.shift((0.062, 0, 0)))),
        (
            "does_not_match",
            lambda: at.locate(measured(), capsules(0.014), BOX, TRUE, scattering=solved()),
        ),
        ("signal_unusable", lambda: located(at.Echoes(CODES, NOISE.T, noise=np.sqrt(2)), TRUE)),
        ("signal_unusable", lambda: located(at.Echoes(CODES, CLIPPED.T), TRUE)),
    ],
)
def test_echoes_of_something_else_are_rejected(code, locate) -> None:
    with raises_code(code):
        locate()


def test_a_turn_that_changes_nothing_is_named() -> None:
    scene = at.Scene(AIR, [at.sound_hard(at.sphere(5e-3, 2e-3))], frequency=40e3)
    scattering = at.scattering_matrix(at.SphereSeries(), scene)
    echoes = at.simulate_echoes(scattering, scene, BOX, CODES[:, :2])
    with raises_code("pose_not_found"):
        at.locate(
            echoes, scene, BOX, at.Pose(np.eye(3), np.array([1e-4, 0, 0])), scattering=scattering
        )
