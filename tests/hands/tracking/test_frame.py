"""Frames and messages: faults, and that nothing is lost on the way."""

import json
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import airtact as at
from airtact.hands.joints import TRACKED
from airtact.hands.tracking.messages import from_json, to_json
from faults import raises_code
from references.motions import JOINTS, RADII, still

CLOUD = JOINTS + 1e-3 * np.random.default_rng(1).normal(size=JOINTS.shape)
HALF = np.where(np.arange(25)[:, None] < 7, np.nan, JOINTS)
LONG = JOINTS + np.where(np.arange(25)[:, None] == 14, [0.0, 0.3, 0.0], 0.0)


@pytest.mark.parametrize(
    ("fault", "changed"),
    [
        ("half_lost", {"landmarks": HALF}),
        ("unknown_count", {"landmarks": JOINTS[:24]}),
        ("not_in_metres", {"landmarks": 1e3 * JOINTS}),
        ("not_in_metres", {"cloud": 1e3 * JOINTS}),
        ("impossible", {"landmarks": LONG}),
        ("unreadable", {"time": np.nan}),
        ("unreadable", {"sequence": -1}),
        ("unreadable", {"sequence": True}),
        ("unreadable", {"cloud": np.empty((0, 3))}),
        ("unreadable", {"cloud": HALF}),
    ],
)
def test_invalid_frames_are_rejected_by_their_fault(fault, changed):
    fields = {"time": 0.0, "side": "left", "sequence": 0, "landmarks": JOINTS} | changed
    with raises_code(fault) as rejected:
        at.hands.HandFrame(**fields)
    assert isinstance(rejected.value, at.hands.FaultyFrame)
    assert rejected.value.fault == fault


def test_a_frame_makes_the_hand_of_its_landmarks():
    hand = still(0).hand(RADII)
    assert hand.side == "left"
    np.testing.assert_array_equal(hand.joints, JOINTS)
    with raises_code("data_missing"):
        still(4, landmarks=None).hand()


def test_a_frame_moves_with_its_cloud():
    pose = at.Pose.turn((0, 0, 1), np.pi / 2, translation=(0, 0, 0.3))
    moved = still(3, cloud=CLOUD).moved(pose)
    for points, original in ((moved.landmarks, JOINTS), (moved.cloud, CLOUD)):
        turned = np.stack([-original[:, 1], original[:, 0], original[:, 2] + 0.3], axis=1)
        np.testing.assert_allclose(points, turned, atol=1e-15)
    assert still(3, landmarks=None).moved(pose).lost


@pytest.mark.parametrize("landmarks", [JOINTS, JOINTS[TRACKED], None], ids=["25", "21", "lost"])
@pytest.mark.parametrize("cloud", [CLOUD, None], ids=["cloud", "no cloud"])
def test_messages_hold_all_of_a_frame(landmarks, cloud):
    frame = still(7, time=1234.5678, landmarks=landmarks, cloud=cloud)
    back = from_json(to_json(frame))
    assert (back.time, back.side, back.sequence) == (1234.5678, "left", 7)
    for points, original in ((back.landmarks, landmarks), (back.cloud, cloud)):
        assert (points is None) == (original is None)
        if original is not None:
            np.testing.assert_allclose(points, original, atol=0.6e-6)


def test_json_has_the_documented_keys():
    message = json.loads(to_json(still(2, cloud=CLOUD)))
    assert list(message) == ["time", "side", "sequence", "landmarks", "cloud"]
    np.testing.assert_allclose(message["landmarks"], JOINTS, atol=0.6e-6)
    lost = json.loads(to_json(still(2, landmarks=None)))
    assert lost == {"time": 2 / 30, "side": "left", "sequence": 2}


@pytest.mark.parametrize(
    "hole", ["null", "[null, null, null]", "[0.1, NaN, 0.1]", "[0.1, Infinity, 0.1]"]
)
def test_landmarks_that_a_tracker_did_not_find_are_half_lost(hole):
    message = json.loads(to_json(still(0)))
    message["landmarks"][4] = "hole"
    with raises_code("half_lost"):
        from_json(json.dumps(message).replace('"hole"', hole))


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"rubbish",
        b"\xff\xfe\x00",
        b"null",
        b"[]",
        b"{}",
        b"[" * 100_000,
        b'{"NaN": ' * 100_000,
        b'{"time": 0, "side": "middle", "sequence": 1}',
        b'{"time": 0, "side": "left", "sequence": 1, "time": 9}',
        b'{"time": 0, "side": "left", "sequence": 1, "cloud": null, "cl\\u006fud": null}',
        b'{"time": 0, "side": "left", "sequence": 1.5}',
        b'{"time": 0, "side": "left", "sequence": 1e300}',
        b'{"time": 1e999, "side": "left", "sequence": 1}',
        b'{"time": "now", "side": "left", "sequence": 1}',
        b'{"time": 0, "side": "left", "sequence": 1, "landmarks": [[0, 0]]}',
        b'{"time": 0, "side": "left", "sequence": 1, "landmark": [[0, 0, 0]]}',
        b'{"time": 0, "side": "left", "sequence": 1, "cloud": [[0, 0, null]]}',
    ],
    ids=lambda text: repr(text[:40]),
)
def test_other_json_is_unreadable(text):
    with raises_code("unreadable"):
        from_json(text)


# --- fuzzed messages --------------------------------------------------------------------------


@given(st.binary(max_size=400))
def test_no_bytes_break_the_reader(raw):
    with suppress(at.hands.FaultyFrame):
        from_json(raw)
