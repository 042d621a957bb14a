"""Frames and messages: faults, and that nothing is lost on the way."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pythonosc.osc_message_builder import OscMessageBuilder

import airtact as at
from airtact.hands.joints import TRACKED
from airtact.hands.tracking.messages import (
    ADDRESS,
    from_json,
    from_osc,
    to_json,
    to_osc,
)
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
        ("not_metres", {"landmarks": 1e3 * JOINTS}),
        ("not_metres", {"cloud": 1e3 * JOINTS}),
        ("impossible", {"landmarks": LONG}),
        ("mirrored", {"side": "right"}),
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
@pytest.mark.parametrize("form", ["json", "osc"])
def test_messages_hold_all_of_a_frame(landmarks, cloud, form):
    frame = still(7, time=1234.5678, landmarks=landmarks, cloud=cloud)
    back = from_json(to_json(frame)) if form == "json" else from_osc(to_osc(frame))[0]
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


def osc(*arguments):
    builder = OscMessageBuilder(ADDRESS)
    for argument in arguments:
        builder.add_arg(*argument) if isinstance(argument, tuple) else builder.add_arg(argument)
    return builder.build().dgram


@pytest.mark.parametrize(
    "packet",
    [
        b"",
        b"\x00",
        b"/airtact/hand",
        osc(),
        osc(1.0, "left"),
        osc(1.0, "up", 3),
        osc("left", 1.0, 3),
        osc(1.0, "left", "3"),
        osc(1.0, "left", 3, 0.1),
        osc(1.0, "left", 3, *[0.1] * 63, b"four"),
        osc(1.0, "left", 3, "x"),
    ],
)
def test_other_osc_is_unreadable(packet):
    with raises_code("unreadable"):
        from_osc(packet)


def test_other_addresses_of_osc_are_passed_over():
    assert from_osc(OscMessageBuilder("/lights").build().dgram) == []


# --- fuzzed messages --------------------------------------------------------------------------


def read_or_fault(read, message):
    try:
        return read(message)
    except at.hands.FaultyFrame:
        return None


@given(st.binary(max_size=400))
def test_no_bytes_break_the_readers(raw):
    read_or_fault(from_json, raw)
    read_or_fault(from_osc, raw)
