"""Prediction: exact where the velocity is constant, as uncertain as the Riccati equation says, better than none."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from airtact.hands.tracking.frame import HandFrame
from airtact.hands.tracking.prediction import (
    BENDING,
    COMMON,
    Predictor,
    first_seen,
    measured,
    process_noise,
    transition,
)
from faults import raises_code
from references.motions import Pinching, pinch_pose, still

JOINTS, _ = pinch_pose()


def gliding(sequence, time, velocity=(0.3, -0.2, 0.35)):
    """A frame of a hand that moves on at a constant velocity of 0.5 m/s."""
    return still(sequence, time, landmarks=JOINTS + time * np.array(velocity))


@pytest.mark.parametrize("latency", [0.0, 0.05, 0.2])
def test_a_constant_velocity_is_predicted_exactly(latency):
    predictor = Predictor(latency)
    for index, time in enumerate([1.0, 1.03, 1.05, 1.1, 1.12, 1.2]):  # frames of any distance
        predictor.take(gliding(index, time))
        if index:
            expected = gliding(index, time + latency)
            predicted = predictor.at(time)
            assert predicted.time == pytest.approx(expected.time, abs=1e-12)
            np.testing.assert_allclose(predicted.landmarks, expected.landmarks, atol=1e-12)


def test_between_frames_the_hand_is_carried_on():
    predictor = Predictor(0.02)
    predictor.take(gliding(0, 0.0))
    predictor.take(gliding(1, 0.03))
    np.testing.assert_allclose(predictor.at(0.11).landmarks, gliding(1, 0.13).landmarks, atol=1e-12)


def test_two_measurements_give_the_covariance_of_their_line():
    """By hand: the velocity is (z2 - z1)/T, so its variance is 2σ²/T², and it shares z2 with the position: σ²/T."""
    noise, step = 2e-3, 0.04
    motion = measured(first_seen(0.0, JOINTS, noise), step, JOINTS, noise, 1e-12)
    expected = noise**2 * np.array([[1, 1 / step], [1 / step, 2 / step**2]])
    np.testing.assert_allclose(motion.covariance, expected, rtol=1e-6)


@pytest.mark.parametrize(("rate", "noise", "agility"), [(30, 1e-3, 0.3), (90, 3e-3, 5.0)])
def test_the_covariance_settles_at_the_solution_of_the_riccati_equation(rate, noise, agility):
    step = 1 / rate
    forward, seen = transition(step), np.array([[1.0, 0.0]])
    variance = 0.0
    for share, agile in ((COMMON, agility), (1.0 - COMMON, BENDING * agility)):
        steady = solve_discrete_are(
            forward.T, seen.T, process_noise(step, agile), np.array([[share * noise**2]])
        )
        variance += steady[0, 0]
    predictor = Predictor(step, noise, agility)
    for index in range(200):
        predictor.take(still(index, index * step))
    assert predictor.spread(199 * step) == pytest.approx(np.sqrt(variance), rel=1e-6)


def test_errors_are_as_large_as_the_riccati_equation_says():
    """Points pushed by white noise of acceleration and measured with noise: the model itself, 1,000 times three."""
    random = np.random.default_rng(5)
    step, noise, agility = 1 / 60, 1e-3, 0.3
    forward, push = transition(step), np.linalg.cholesky(process_noise(step, agility))
    steady = solve_discrete_are(
        forward.T, np.array([[1.0], [0.0]]), process_noise(step, agility), np.array([[noise**2]])
    )
    state = np.zeros((2, 1000, 3))
    motion = first_seen(0.0, state[0] + noise * random.normal(size=(1000, 3)), noise)
    errors = []
    for index in range(1, 80):
        state = np.tensordot(forward, state, 1) + np.tensordot(
            push, random.normal(size=(2, 1000, 3)), 1
        )
        if index > 60:
            errors.append(motion.at(index * step, agility).positions - state[0])
        seen = state[0] + noise * random.normal(size=(1000, 3))
        motion = measured(motion, index * step, seen, noise, agility)
    assert np.mean(np.square(errors)) == pytest.approx(steady[0, 0], rel=0.03)


def test_noise_is_smoothed_in_a_hand_that_rests():
    random = np.random.default_rng(2)
    predictor, errors = Predictor(0.0, agility=1e-4), []
    for index in range(120):
        predictor.take(still(index, landmarks=JOINTS + 1e-3 * random.normal(size=(25, 3))))
        errors.append(predictor.at(index / 30).landmarks - JOINTS)
    assert np.sqrt(np.mean(np.square(errors[60:]))) < 0.5e-3


def test_a_moving_pad_is_predicted_better_than_by_the_last_frame():
    motion = Pinching(5)
    frames = motion.frames(30, 1.5, noise=1e-3)
    predictor, latency, errors, stale = Predictor(0.05), 0.05, [], []
    for frame in frames:
        predictor.take(frame)
        if frame.sequence >= 6:
            true = (
                HandFrame(frame.time, "left", 0, motion.at(frame.time + latency))
                .hand(motion.radii)
                .pads[1]
            )
            predicted = predictor.at(frame.time).hand(motion.radii).pads[1]
            errors.append(np.linalg.norm(predicted - true))
            stale.append(np.linalg.norm(frame.hand(motion.radii).pads[1] - true))
    assert np.mean(errors) < 0.5 * np.mean(stale)
    assert np.mean(errors) < 6e-3


def test_a_hand_that_is_lost_is_carried_on_for_a_while_and_begins_anew():
    predictor = Predictor(0.0, patience=0.1)
    predictor.take(gliding(0, 0.0))
    predictor.take(gliding(1, 0.03))
    predictor.take(still(2, 0.06, landmarks=None))
    np.testing.assert_allclose(predictor.at(0.12).landmarks, gliding(1, 0.12).landmarks, atol=1e-12)
    assert predictor.at(0.14).lost
    predictor.take(still(9, 0.5))
    np.testing.assert_allclose(predictor.at(0.55).landmarks, JOINTS, atol=1e-15)


def test_another_number_of_landmarks_begins_anew():
    predictor = Predictor(0.0)
    predictor.take(gliding(0, 0.0))
    predictor.take(gliding(1, 0.03))
    tracked = np.delete(JOINTS, [5, 10, 15, 20], axis=0)
    predictor.take(still(2, 0.06, landmarks=tracked))
    np.testing.assert_allclose(predictor.at(0.06).landmarks, tracked, atol=1e-15)


@pytest.mark.parametrize("count", [25, 21])
def test_bones_keep_their_lengths_where_they_would_be_none_of_a_hand(count):
    kept = np.arange(25) if count == 25 else np.delete(np.arange(25), [5, 10, 15, 20])
    random = np.random.default_rng(4)
    predictor = Predictor(0.5)
    predictor.take(still(0, 0.0, landmarks=JOINTS[kept]))
    moved = JOINTS[kept] + 1.5e-3 * random.normal(
        size=(count, 3)
    )  # some 60 mm/s, each its own way: 30 mm in half a second
    predictor.take(still(1, 1 / 30, landmarks=moved))
    carried = predictor.at(1 / 30).landmarks
    tips = [(3, 4), (8, 9), (23, 24)] if count == 25 else [(3, 4), (7, 8), (19, 20)]
    for one, other in [*tips, (0, 1)]:
        length = np.linalg.norm(moved[other] - moved[one])
        assert np.linalg.norm(carried[other] - carried[one]) == pytest.approx(length, abs=1e-12)
    assert np.linalg.norm(carried - moved, axis=1).max() > 0.01


def test_what_cannot_be_is_rejected():
    for latency, shown in ((-0.1, "latency is -0.1 s"), (50.0, "latency is 50 s")):
        with raises_code("out_of_range", shown):
            Predictor(latency)
    for name in ("noise", "agility", "patience"):
        with raises_code("out_of_range", f"{name} is 0 "):
            Predictor(0.05, **{name: 0.0})
    predictor = Predictor(0.05)
    with raises_code("empty", "0 frames"):
        predictor.at(0.0)
    with raises_code("empty", "0 frames"):
        predictor.spread(0.0)
    predictor.take(still(3, 1.0))
    with raises_code("out_of_range", "from 1 to 0.9 s at frame 4"):
        predictor.take(still(4, 0.9))
    with raises_code("does_not_match", "frame 5"):
        predictor.take(still(5, 1.1, side="right", landmarks=JOINTS * [-1, 1, 1]))


def test_what_a_prediction_leaves_in_doubt() -> None:
    """A turn by as much as the landmarks are off, about their middle."""
    predictor = Predictor(latency=0.02, noise=1e-3)
    for sequence in range(30):
        predictor.take(gliding(sequence, sequence / 60))
    doubt = predictor.uncertainty(29 / 60)
    assert doubt.position == predictor.spread(29 / 60)
    landmarks = predictor.at(29 / 60).landmarks
    assert landmarks is not None
    lever = np.sqrt(((landmarks - landmarks.mean(axis=0)) ** 2).sum(axis=1).mean())
    assert doubt.rotation == pytest.approx(np.degrees(doubt.position / lever), rel=0.01)


@pytest.mark.parametrize("noise", [0.0, 0.5e-3, 1e-3, 1.5e-3])
def test_the_noise_of_a_tracker_is_found_from_its_frames(noise):
    predictor = Predictor(0.0, noise=None)
    for frame in Pinching().frames(60.0, 2.0, noise):
        predictor.take(frame)
    assert predictor.noise == pytest.approx(max(noise, 1e-4), rel=0.15)


def test_landmarks_that_jump_and_frames_that_are_missing_are_no_noise():
    predictor = Predictor(0.0, noise=None)
    for index, frame in enumerate(Pinching().frames(60.0, 2.0, 0.3e-3)):
        landmarks = frame.landmarks.copy()
        landmarks[index % 25] += 0.004 * (index % 7 == 0)
        if index % 10:
            predictor.take(replace(frame, landmarks=landmarks))
    assert predictor.noise == pytest.approx(0.3e-3, rel=0.2)
