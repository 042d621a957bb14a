"""Prediction: without lag at constant rates, as uncertain as it says, of constant bones, better than none."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from airtact.hands import HandFrame, Predictor
from airtact.hands.joints import BONES, CHAINS, TRACKED, hand_length
from airtact.hands.kinematics import bending_axis, turned
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


def bent(joints, finger, degrees):
    """Bend the middle joint of a finger."""
    _, _, middle, *outer = CHAINS[finger]
    turn = Rotation.from_rotvec(np.radians(degrees) * bending_axis(joints, "left", finger))
    joints = joints.copy()
    joints[outer] = joints[middle] + turn.apply(joints[outer] - joints[middle])
    return joints


def assert_lands(predictor, time, landmarks, atol=1e-12):
    np.testing.assert_allclose(predictor.at(time).landmarks, landmarks, atol=atol)


@pytest.mark.parametrize("latency", [0.0, 0.05, 0.2])
def test_a_constant_velocity_is_predicted_without_lag(latency):
    predictor = taken(Predictor(latency, noise=1e-4), gliding(0, 1.0))
    for index, time in enumerate([1.03, 1.05, 1.1, 1.12, 1.2, 1.22, 1.25], 1):  # of any distance
        predictor.take(gliding(index, time))
        assert predictor.at(time).time == pytest.approx(time + latency, abs=1e-12)
    assert_lands(predictor, 1.25, gliding(8, 1.25 + latency).landmarks, atol=1e-4)
    np.testing.assert_allclose(predictor.velocities(1.25), [[0.3, -0.2, 0.35]] * 25, atol=1e-3)


@pytest.mark.parametrize("chosen", [np.arange(25), TRACKED], ids=["25", "21"])
def test_a_finger_that_turns_steadily_is_predicted_without_lag(chosen):
    def bending(index):
        return still(index, index / 60, landmarks=turned(JOINTS, "left", 2, -index / 60)[chosen])

    predictor = taken(Predictor(1 / 60, noise=1e-4), *(bending(index) for index in range(30)))
    assert_lands(predictor, 29 / 60, bending(30).landmarks, atol=2e-4)


def test_velocities_include_the_acceleration_of_a_finger():
    def waving(time):
        # The middle finger waves at 1 Hz.
        angle = -0.25 * (1.0 - np.cos(2 * np.pi * time))
        return turned(JOINTS, "left", 2, angle)

    frames = (still(index, index / 60, landmarks=waving(index / 60)) for index in range(61))
    predictor = taken(Predictor(0.02, noise=1e-4), *frames)
    true = (waving(1.07) - waving(1.02)) / 0.05
    tip = CHAINS[2][-1]
    error = np.linalg.norm(predictor.velocities(1.0)[tip] - true[tip])
    # At 1 s the tip is at rest, so a constant velocity would have an error of 100 %.
    assert error < 0.4 * np.linalg.norm(true[tip])


def test_errors_of_a_hand_at_rest_fall_as_those_of_a_regression():
    """26 of the 75 degrees of freedom have rates, so their variance is that of the end of a line."""
    count, noise = 60, 3e-3
    random = np.random.default_rng(1)
    predictor = Predictor(0.0, noise, agility=1e-9)
    errors = []
    for index in range(count):
        landmarks = JOINTS + noise * random.normal(size=(25, 3))
        predictor.take(still(index, index / 60, landmarks=landmarks))
    errors = predictor.at((count - 1) / 60).landmarks - JOINTS
    of_lines = 2.0 * (2 * count - 1) / (count * (count + 1))
    expected = noise * np.sqrt((26 * of_lines + 49 / count) / 75)
    assert predictor.spread((count - 1) / 60) == pytest.approx(expected, rel=0.1)
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(expected, rel=0.35)


def test_the_covariance_is_that_of_the_errors(motion):
    predictor = Predictor(0.0, noise=1e-3)
    ratios = []
    for frame in motion.frames(60, 2.0, noise=1e-3, seed=5):
        predictor.take(frame)
        if frame.sequence >= 20:
            errors = predictor.at(frame.time).landmarks - motion.at(frame.time)
            ratios.append(np.mean(errors**2) / predictor.spread(frame.time) ** 2)
    assert 0.5 < np.mean(ratios) < 1.3


# The fingertips are predicted 10 mm off at most where times are true. Without an estimate of the
# error of the times they were 0.4 and 1.3 m off.
@pytest.mark.parametrize(("jitter", "most"), [(3e-3, 0.03), (10e-3, 0.25)])
def test_wrong_times_of_frames_do_not_throw_the_hand_away(jitter, most, motion):
    random = np.random.default_rng(0)
    predictor = Predictor(0.0, noise=1e-4)
    newest = -np.inf
    worst = 0.0
    for frame in motion.frames(60, 4.0):
        time = frame.time + random.normal(0.0, jitter)
        if time <= newest:
            continue
        newest = time
        predictor.take(replace(frame, time=time))
        then = frame.time + 0.1
        off = predictor.at(max(then, time)).landmarks - motion.at(then)
        if frame.time > 0.5:
            worst = max(worst, np.linalg.norm(off, axis=1).max())
    assert worst < most


def test_bones_keep_the_lengths_that_were_learned(motion):
    def lengths(joints):
        ends = np.array(BONES)
        return np.linalg.norm(joints[ends[:, 1]] - joints[ends[:, 0]], axis=1)

    predictor = Predictor(0.02, noise=None)
    found = []
    for frame in motion.frames(60, 3.0, noise=1e-3):
        predictor.take(frame)
        if frame.sequence >= 60:
            found.append(lengths(predictor.at(frame.time).landmarks))
    assert np.std(found, axis=0).max() < 0.3e-3
    assert np.abs(np.mean(found, axis=0) - lengths(motion.at(0.0))).max() < 0.3e-3


def test_another_hand_is_learned_anew():
    predictor = taken(Predictor(0.0), *(still(index, index / 60) for index in range(60)))
    grown = JOINTS[0] + 1.3 * (JOINTS - JOINTS[0])
    for index in range(60, 90):
        predictor.take(still(index, index / 60, landmarks=grown))
    found = hand_length(predictor.at(89 / 60).landmarks)
    assert found == pytest.approx(1.3 * hand_length(JOINTS), rel=1e-3)


def test_a_finger_does_not_bend_further_than_its_joints_do():
    frames = [
        still(index, index / 60, landmarks=bent(JOINTS, 2, 15.0 * index)) for index in range(5)
    ]
    predictor = taken(Predictor(0.3, noise=1e-4), *frames)
    bones = np.diff(predictor.at(4 / 60).landmarks[11:14], axis=0)
    cosine = bones[0] @ bones[1] / np.prod(np.linalg.norm(bones, axis=1))
    assert np.degrees(np.arccos(cosine)) == pytest.approx(120.0, abs=2.0)


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
    assert_lands(predictor, 0.12, gliding(1, 0.12).landmarks, atol=1e-3)
    assert predictor.at(0.14).lost
    predictor.take(still(9, 0.5))
    assert_lands(predictor, 0.55, JOINTS)


def test_another_number_of_landmarks_continues():
    predictor = taken(Predictor(0.0), gliding(0, 0.0), gliding(1, 0.03))
    predictor.take(replace(gliding(2, 0.06), landmarks=gliding(2, 0.06).landmarks[TRACKED]))
    assert_lands(predictor, 0.06, gliding(2, 0.06).landmarks[TRACKED], atol=1e-3)


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
    predictor = Predictor(latency=0.02, noise=1e-3)
    for sequence in range(30):
        predictor.take(gliding(sequence, sequence / 60))
    doubt = predictor.uncertainty(29 / 60)
    # Position, rotation of all joints about their middle, and bones add up to the spread.
    landmarks = predictor.at(29 / 60).landmarks
    lever = np.sqrt(((landmarks - landmarks.mean(axis=0)) ** 2).sum(axis=1).mean())
    turn = np.radians(doubt.rotation) * lever
    total = np.sqrt(doubt.position**2 + turn**2 * 2 / 3 + doubt.own_position**2)
    assert total == pytest.approx(predictor.spread(29 / 60), rel=0.1)
    assert doubt.own_position < 0.5e-3


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
