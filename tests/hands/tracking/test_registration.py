"""The pose of a tracker from touches: as accurate as asked, wrong touches named, odd input rejected."""

import numpy as np
import pytest

import airtact as at
from airtact.hands.tracking.registration import INDEX_TIP
from faults import raises_code
from references.motions import JOINTS, still

BOARD = at.autd3_board()
# Four corners of the board, and two transducers in its middle
TOUCHED = [0, 17, 231, 248, 105, 148]
POINTS, NORMALS = BOARD.positions[TOUCHED], BOARD.normals[TOUCHED]
OFFSET = 7e-3


def seen(random, points=POINTS, normals=NORMALS, bias=2e-3):
    """A tracker's pose, its bias, and what it measures of touches of a second at 60 frames/s with 1 mm of noise."""
    tracker = at.Pose.turn(
        random.normal(size=3), random.uniform(0, 3), random.uniform(-0.5, 0.5, 3)
    )
    shift = random.normal(size=3)
    shift *= bias / np.linalg.norm(shift)
    noise = 1e-3 * random.normal(size=(60, len(points), 3)).mean(axis=0)
    touched = tracker.inverse().apply(points + OFFSET * normals) + shift + noise
    return tracker, shift, touched


def test_touches_with_noise_and_bias_give_the_pose():
    random = np.random.default_rng(0)
    good, deviations = 0, []
    for _ in range(20):
        tracker, bias, touched = seen(random)
        found = at.hands.register(touched, POINTS, NORMALS, offset=OFFSET)
        assert found.repeat is None
        # The hand is measured with the same bias, which the pose therefore has to undo.
        above = POINTS.mean(axis=0) + [0.0, 0.0, 0.1]
        placed = found.tracker.apply(tracker.inverse().apply(above) + bias)
        middle = found.tracker.apply(tracker.inverse().apply(POINTS.mean(axis=0)) + bias)
        turn = found.tracker.rotation @ tracker.rotation.T
        angle = np.degrees(np.arccos(min((np.trace(turn) - 1.0) / 2.0, 1.0)))
        good += np.linalg.norm(placed - above) < 0.5e-3 and angle < 0.3
        deviations.append(np.abs(middle - POINTS.mean(axis=0)).max() / found.position_error)
    assert good >= 19
    # The largest of three coordinates, in standard deviations
    assert 0.5 < np.median(deviations) < 2.0


@pytest.mark.parametrize("size", [5e-3, 30e-3])
def test_a_wrong_touch_is_named_and_left_out(size):
    random = np.random.default_rng(1)
    named = 0
    for _ in range(20):
        tracker, bias, touched = seen(random)
        wrong = int(random.integers(len(touched)))
        shift = random.normal(size=3)
        touched[wrong] += size * shift / np.linalg.norm(shift)
        found = at.hands.register(touched, POINTS, NORMALS, offset=OFFSET)
        named += found.repeat == wrong
        assert found.residuals[wrong] == pytest.approx(size, rel=0.3)
        placed = found.tracker.apply(tracker.inverse().apply(POINTS[0]) + bias)
        assert np.linalg.norm(placed - POINTS[0]) < 1e-3
    assert named >= 19


def test_a_likely_scale_is_named():
    _, _, touched = seen(np.random.default_rng(3))
    assert at.hands.register(touched, POINTS, NORMALS, offset=OFFSET).likely_scale is None
    found = at.hands.register(touched / 1.03, POINTS, NORMALS, offset=OFFSET)
    assert found.likely_scale == pytest.approx(1.03, abs=5e-3)


def test_scale_and_offset_are_found_if_faces_differ():
    box = at.surrounding_box()
    elements = [0, 248, 300, 480, 600, 700, 800, 995]
    points, normals = box.positions[elements], box.normals[elements]
    _, _, touched = seen(np.random.default_rng(2), points, normals, bias=0.0)
    found = at.hands.register(touched / 1.04, points, normals, offset=None, scale=None)
    assert found.scale == pytest.approx(1.04, abs=2e-3)
    assert found.offset == pytest.approx(OFFSET, abs=0.5e-3)
    np.testing.assert_allclose(
        found.tracker.apply(found.scale * touched / 1.04), points + OFFSET * normals, atol=0.6e-3
    )


TOUCHES = seen(np.random.default_rng(3))[2]


@pytest.mark.parametrize(
    ("code", "arguments", "options"),
    [
        ("too_few", (TOUCHES[:2], POINTS[:2], NORMALS[:2]), {}),
        ("too_few", (TOUCHES[:3], POINTS[0] + np.outer([0, 1, 2], [0.1, 0, 0]), NORMALS[:3]), {}),
        ("sizes_differ", (TOUCHES, POINTS[:5], NORMALS), {}),
        ("data_missing", (TOUCHES, POINTS, NORMALS), {"offset": None}),
        ("pose_not_found", (TOUCHES[[1, 0, 5, 2, 4, 3]], POINTS, NORMALS), {}),
        ("not_finite", (np.nan * TOUCHES, POINTS, NORMALS), {}),
        ("out_of_range", (TOUCHES, POINTS, NORMALS), {"offset": 6.6}),
        ("out_of_range", (TOUCHES, POINTS, NORMALS), {"offset": -0.5}),
    ],
)
def test_touches_that_give_no_pose_are_rejected(code, arguments, options, as_outside_the_tests):
    with raises_code(code):
        at.hands.register(*arguments, **options)


# --- a fingertip at rest ----------------------------------------------------------------------


def rests(finger, places, rate=60.0, start=0):
    """Let the tip be at places; return where it rested, and after how many frames."""
    random = np.random.default_rng(0)
    found = []
    for index, place in enumerate(places, start):
        moved = JOINTS + place - JOINTS[INDEX_TIP] + 1e-3 * random.normal(size=JOINTS.shape)
        place = finger.take(still(index, index / rate, landmarks=moved))
        if place is not None:
            found.append((index, place))
    return found


def test_a_fingertip_at_rest_is_found_once_until_it_moves_away():
    finger = at.hands.RestingFingertip()
    first, second = np.array([0.1, 0.2, 0.3]), np.array([0.1, 0.25, 0.3])
    way = first + np.linspace(0, 1, 30)[:, None] * (second - first)
    found = rests(finger, [*[first] * 150, *way, *[second] * 70])
    assert len(found) == 2
    assert found[0][0] == pytest.approx(60, abs=2)
    for (_, place), true in zip(found, (first, second), strict=True):
        np.testing.assert_allclose(place, true, atol=0.6e-3)


def test_a_moving_or_lost_fingertip_does_not_rest():
    finger = at.hands.RestingFingertip()
    drift = np.arange(120)[:, None] * [0.0, 0.0, 15e-3 / 60]
    assert not rests(finger, drift)
    finger = at.hands.RestingFingertip()
    assert not rests(finger, [np.zeros(3)] * 50)
    assert finger.take(still(50, 50 / 60, landmarks=None)) is None
    assert finger.share == 0.0
    assert not rests(finger, [np.zeros(3)] * 50, start=51)
