"""Prediction: exact where the velocity is constant, as uncertain as the Riccati equation says, better than none."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from airtact.hands import HandFrame, Predictor
from airtact.hands.joints import TRACKED
from airtact.hands.tracking.prediction import (
    BENDING,
    COMMON,
    process_noise,
    transition,
)
from faults import raises_code
from references.motions import JOINTS, Pinching, mirrored, still


@pytest.fixture(scope="module")
def motion():
    return Pinching(5)


def gliding(sequence, time):
    return still(sequence, time, landmarks=JOINTS + time * np.array([0.3, -0.2, 0.35]))


def taken(predictor, *frames):
    for frame in frames:
        predictor.take(frame)
    return predictor


def assert_lands(predictor, time, landmarks, atol=1e-12):
    np.testing.assert_allclose(predictor.at(time).landmarks, landmarks, atol=atol)


@pytest.mark.parametrize("latency", [0.0, 0.05, 0.2])
def test_a_constant_velocity_is_predicted_exactly(latency):
    predictor = taken(Predictor(latency), gliding(0, 1.0))
    for index, time in enumerate([1.03, 1.05, 1.1, 1.12, 1.2], 1):  # frames of any distance
        predictor.take(gliding(index, time))
        assert predictor.at(time).time == pytest.approx(time + latency, abs=1e-12)
        assert_lands(predictor, time, gliding(index, time + latency).landmarks)


def steady_variance(step, noise, agility):
    measures = np.array([[1.0], [0.0]])
    push = process_noise(step, agility)
    return solve_discrete_are(transition(step).T, measures, push, np.array([[noise**2]]))[0, 0]


@pytest.mark.parametrize(("rate", "noise", "agility"), [(30, 1e-3, 0.3), (90, 3e-3, 5.0)])
def test_the_covariance_settles_at_the_solution_of_the_riccati_equation(rate, noise, agility):
    predictor = Predictor(1 / rate, noise, agility)
    for index in range(200):
        predictor.take(still(index, index / rate))
    variance = steady_variance(1 / rate, np.sqrt(COMMON) * noise, agility)
    variance += steady_variance(1 / rate, np.sqrt(1.0 - COMMON) * noise, BENDING * agility)
    assert predictor.spread(199 / rate) == pytest.approx(np.sqrt(variance), rel=1e-6)


def test_a_moving_pad_is_predicted_better_than_by_the_last_frame(motion):
    latency = 0.05
    predictor = Predictor(latency)
    errors = []
    stale = []
    for frame in motion.frames(30, 1.5, noise=1e-3):
        predictor.take(frame)
        if frame.sequence >= 6:
            true = HandFrame(frame.time, "left", 0, motion.at(frame.time + latency))
            moments = (true, predictor.at(frame.time), frame)
            pad, predicted, last = (moment.hand(motion.radii).pads[1] for moment in moments)
            errors.append(np.linalg.norm(predicted - pad))
            stale.append(np.linalg.norm(last - pad))
    assert np.mean(errors) < 0.5 * np.mean(stale)
    assert np.mean(errors) < 6e-3


def test_a_lost_hand_is_carried_on_for_a_while_and_begins_anew():
    predictor = taken(Predictor(0.0, patience=0.1), gliding(0, 0.0), gliding(1, 0.03))
    predictor.take(still(2, 0.06, landmarks=None))
    assert_lands(predictor, 0.12, gliding(1, 0.12).landmarks)
    assert predictor.at(0.14).lost
    predictor.take(still(9, 0.5))
    assert_lands(predictor, 0.55, JOINTS)


def test_another_number_of_landmarks_begins_anew():
    predictor = taken(Predictor(0.0), gliding(0, 0.0), gliding(1, 0.03))
    predictor.take(still(2, 0.06, landmarks=JOINTS[TRACKED]))
    assert_lands(predictor, 0.06, JOINTS[TRACKED])


@pytest.mark.parametrize("chosen", [np.arange(25), TRACKED], ids=["25", "21"])
def test_the_newest_hand_is_moved_where_the_prediction_is_no_possible_hand(chosen):
    random = np.random.default_rng(4)
    # some 60 mm/s, each landmark in another direction: 30 mm in half a second
    newest = JOINTS[chosen] + 1.5e-3 * random.normal(size=(len(chosen), 3))
    predictor = taken(Predictor(0.5), still(0, 0.0, landmarks=JOINTS[chosen]))
    predictor.take(still(1, 1 / 30, landmarks=newest))
    shift = predictor.at(1 / 30).landmarks - newest
    assert np.ptp(shift, axis=0).max() < 1e-12
    expected = 15 * (newest - JOINTS[chosen]).mean(axis=0)
    np.testing.assert_allclose(shift[0], expected, rtol=1e-6)


@pytest.mark.parametrize(
    "settings",
    [{"latency": -0.1}, {"latency": 50.0}, {"noise": 0.0}, {"agility": 0.0}, {"patience": 0.0}],
)
def test_settings_out_of_range_are_rejected(settings):
    with raises_code("out_of_range", *settings):
        Predictor(**{"latency": 0.05} | settings)


def test_frames_of_another_hand_or_of_the_past_are_rejected():
    predictor = Predictor(0.05)
    for ask in (predictor.at, predictor.spread):
        with raises_code("empty"):
            ask(0.0)
    predictor.take(still(3, 1.0))
    with raises_code("out_of_range"):
        predictor.take(still(4, 0.9))
    with raises_code("does_not_match"):
        predictor.take(mirrored(5, 1.1))


def test_the_uncertainty_of_a_prediction():
    """A turn by as much as the landmarks are off, about their middle."""
    predictor = Predictor(latency=0.02, noise=1e-3)
    for sequence in range(30):
        predictor.take(gliding(sequence, sequence / 60))
    doubt = predictor.uncertainty(29 / 60)
    assert doubt.position == predictor.spread(29 / 60)
    landmarks = predictor.at(29 / 60).landmarks
    lever = np.sqrt(((landmarks - landmarks.mean(axis=0)) ** 2).sum(axis=1).mean())
    assert doubt.rotation == pytest.approx(np.degrees(doubt.position / lever), rel=0.01)


@pytest.mark.parametrize("noise", [0.0, 0.5e-3, 1e-3, 1.5e-3])
def test_the_noise_of_a_tracker_is_estimated_from_its_frames(noise, motion):
    predictor = taken(Predictor(0.0, noise=None), *motion.frames(60.0, 2.0, noise))
    assert predictor.noise == pytest.approx(max(noise, 1e-4), rel=0.15)


def test_landmarks_that_jump_and_missing_frames_are_no_noise(motion):
    predictor = Predictor(0.0, noise=None)
    for index, frame in enumerate(motion.frames(60.0, 2.0, 0.3e-3)):
        landmarks = frame.landmarks.copy()
        landmarks[index % 25] += 0.004 * (index % 7 == 0)
        if index % 10:
            predictor.take(replace(frame, landmarks=landmarks))
    assert predictor.noise == pytest.approx(0.3e-3, rel=0.2)
