"""Frames and messages: what is rejected, and that nothing is lost on the way."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pythonosc.osc_message_builder import OscMessageBuilder

import airtact as at
from airtact.hands.tracking.frame import FaultyFrame, HandFrame
from airtact.hands.tracking.messages import ADDRESS, from_json, from_osc, to_json, to_osc
from faults import raises_code
from references.hand_poses import example
from references.motions import still

JOINTS, RADII = example("pinch")
TRACKED = np.delete(JOINTS, [5, 10, 15, 20], axis=0)
CLOUD = JOINTS + 1e-3 * np.random.default_rng(1).normal(size=JOINTS.shape)
HALF = np.where(np.arange(25)[:, None] < 7, np.nan, JOINTS)
LONG = JOINTS + np.where(np.arange(25)[:, None] == 14, [0.0, 0.3, 0.0], 0.0)

FAULTS = {
    "half_lost": ({"landmarks": HALF}, "7 landmarks"),
    "unknown_count": ({"landmarks": JOINTS[:24]}, "24"),
    "not_metres": ({"landmarks": 1e3 * JOINTS}, "156.4 m"),
    "impossible": ({"landmarks": LONG}, "mm"),
    "mirrored": (
        {"side": "right"},
        "those of a right hand, but the fingers bend and the thumb points as those of a left one",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_landmarks_that_are_no_hand_are_rejected_by_what_is_wrong(fault):
    changed, shown = FAULTS[fault]
    with raises_code(fault, shown) as rejected:
        still(0, **changed)
    assert isinstance(rejected.value, FaultyFrame)
    assert rejected.value.fault == fault


@pytest.mark.parametrize(
    ("changed", "shown"),
    [
        ({"time": np.nan}, "nan s"),
        ({"sequence": -1}, "-1"),
        ({"sequence": True}, "True"),
        ({"cloud": np.empty((0, 3))}, "0 points"),
        ({"cloud": HALF}, "21 NaN"),
    ],
)
def test_other_parts_that_are_none_are_unreadable(changed, shown):
    fields = {"time": 0.0, "side": "left", "sequence": 0, "landmarks": JOINTS} | changed
    with raises_code("unreadable", shown) as rejected:
        HandFrame(**fields)
    assert rejected.value.fault == "unreadable"


def test_a_cloud_in_millimetres_is_rejected():
    with raises_code("not_metres", "156.4 m"):
        still(0, cloud=1e3 * JOINTS)


def test_a_frame_makes_the_hand_of_its_landmarks():
    hand = still(0).hand(RADII)
    assert hand.side == "left"
    np.testing.assert_array_equal(hand.joints, JOINTS)
    with raises_code("data_missing", "frame 4 has 0 landmarks"):
        still(4, landmarks=None).hand()


def test_a_frame_moves_with_its_cloud():
    pose = at.Pose.turn((0, 0, 1), np.pi / 2, translation=(0, 0, 0.3))
    moved = still(3, cloud=CLOUD).moved(pose)
    turned = [np.stack([-one[:, 1], one[:, 0], one[:, 2] + 0.3], axis=1) for one in (JOINTS, CLOUD)]
    np.testing.assert_allclose(moved.landmarks, turned[0], atol=1e-15)
    np.testing.assert_allclose(moved.cloud, turned[1], atol=1e-15)
    assert still(3, landmarks=None).moved(pose).lost


@pytest.mark.parametrize("landmarks", [JOINTS, TRACKED, None], ids=["25", "21", "lost"])
@pytest.mark.parametrize("cloud", [CLOUD, None], ids=["cloud", "no cloud"])
@pytest.mark.parametrize("way", ["json", "osc"])
def test_messages_hold_all_of_a_frame(landmarks, cloud, way):
    frame = still(7, time=1234.5678, landmarks=landmarks, cloud=cloud)
    back = from_json(to_json(frame)) if way == "json" else from_osc(to_osc(frame))[0]
    assert (back.time, back.side, back.sequence) == (1234.5678, "left", 7)
    for one, two in ((back.landmarks, landmarks), (back.cloud, cloud)):
        assert (one is None) == (two is None)
        if two is not None:
            np.testing.assert_allclose(one, two, atol=0.6e-6)


def test_json_is_what_the_page_says():
    message = json.loads(to_json(still(2, cloud=CLOUD)))
    assert list(message) == ["time", "side", "sequence", "landmarks", "cloud"]
    np.testing.assert_allclose(message["landmarks"], JOINTS, atol=0.6e-6)
    assert json.loads(to_json(still(2, landmarks=None))) == {
        "time": 2 / 30,
        "side": "left",
        "sequence": 2,
    }


@pytest.mark.parametrize(
    "hole", ["null", "[null, null, null]", "[0.1, NaN, 0.1]", "[0.1, Infinity, 0.1]"]
)
def test_landmarks_that_a_tracker_did_not_find_are_half_lost(hole):
    message = json.loads(to_json(still(0)))
    message["landmarks"][4] = "hole"
    with raises_code("half_lost", "1 landmark", "landmark 4") as rejected:
        from_json(json.dumps(message).replace('"hole"', hole))
    assert rejected.value.fault == "half_lost"


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
def test_what_is_no_frame_in_json_is_unreadable(text):
    with pytest.raises(FaultyFrame) as rejected:
        from_json(text)
    assert rejected.value.fault == "unreadable"


def osc(*arguments):
    builder = OscMessageBuilder(ADDRESS)
    for value in arguments:
        builder.add_arg(value)
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
    ]
    + [
        osc(1.0, "left", "3"),
        osc(1.0, "left", 3, 0.1),
        osc(1.0, "left", 3, *[0.1] * 63, b"four"),
        osc(1.0, "left", 3, "x"),
    ],
)
def test_what_is_no_frame_in_osc_is_unreadable(packet):
    with pytest.raises(FaultyFrame) as rejected:
        from_osc(packet)
    assert rejected.value.fault == "unreadable"


def test_other_addresses_of_osc_are_passed_over():
    assert from_osc(OscMessageBuilder("/lights").build().dgram) == []


@given(st.binary(max_size=400))
def test_no_bytes_break_the_readers(raw):
    for read in (from_json, from_osc):
        try:
            read(raw)
        except FaultyFrame:
            continue


def written(value):
    return json.dumps(value, allow_nan=True).encode()


ODD = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=3), inner, max_size=3)
    ),
    max_leaves=12,
)


@given(st.sampled_from(["time", "side", "sequence", "landmarks", "cloud"]), ODD)
def test_no_value_of_a_key_breaks_the_reader(key, value):
    message = json.loads(to_json(still(2))) | {key: value}
    try:
        frame = from_json(written(message))
    except FaultyFrame:
        return
    assert np.isfinite(frame.time)


@given(
    st.lists(
        st.none()
        | st.booleans()
        | st.integers(-(2**31), 2**31 - 1)
        | st.floats(width=32)
        | st.text(max_size=5)
        | st.binary(min_size=1, max_size=30),
        max_size=70,
    )
)
def test_no_arguments_of_osc_break_the_reader(arguments):
    try:
        from_osc(osc(*arguments))
    except FaultyFrame:
        return
