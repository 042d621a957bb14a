"""Hands as trackers and other programs send them: read whole, or rejected by their cause."""

import json
import runpy
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import airtact as at
from airtact.cli import main
from airtact.hands.joints import TRACKED, side_evidence
from airtact.hands.tracking.recordings import is_recording
from faults import raises_code
from paths import ROOT
from references.motions import Clock, still

RECEIVED = Path(__file__).parent / "received"
POSES = {
    name: np.array(points)
    for name, points in json.loads((RECEIVED / "poses.json").read_text()).items()
}
MIRROR = np.array([1.0, 1.0, -1.0])


def reading(name: str, **options):
    return at.hands.load_recording(RECEIVED / name, **options)


def streamed(frames, rate: float = 70.0):
    """Feed landmarks of a side to a stream at a rate [1/s]; return the stream and the faults."""
    clock = Clock()
    stream = at.hands.HandStream(clock=clock)
    faults = []
    for index, (side, points) in enumerate(frames):
        clock.now += 1.0 / rate
        fault = stream.feed(at.hands.HandFrame(index / rate, side, index, points))
        faults.append(None if fault is None else fault.fault)
    return stream, faults


def through_poses(*names: str) -> list[np.ndarray]:
    """A hand that holds each pose for 16 frames and takes 16 to the next."""
    shares = np.concatenate([np.zeros(16), 0.5 - 0.5 * np.cos(np.pi * np.arange(16) / 16)])
    shift = np.array([0.05, 1.0, -0.3])
    return [
        POSES[first] + share * (POSES[second] - POSES[first]) + shift
        for first, second in pairwise(names)
        for share in shares
    ]


# --- left and right ---------------------------------------------------------------------------


@pytest.mark.parametrize("joints", [slice(None), TRACKED], ids=["25", "21"])
@pytest.mark.parametrize("pose", POSES)
def test_recorded_poses_are_used_with_noise(pose, joints):
    random = np.random.default_rng(0)
    side = pose.partition("-")[2]
    points = POSES[pose][joints] + [0.05, 1.0, -0.3]
    noisy = [points + 1e-3 * random.normal(size=points.shape) for _ in range(140)]
    _, faults = streamed([(side, hand) for hand in noisy])
    assert faults == [None] * 140
    assert at.hand_from_joints(points, side=side).side == side


@pytest.mark.parametrize("joints", [slice(None), TRACKED], ids=["25", "21"])
@pytest.mark.parametrize("pose", ["fist", "horns", "point", "shaka", "relax"])
def test_mirrored_poses_are_reported_within_a_second(pose, joints):
    points = (POSES[f"{pose}-right"] * MIRROR)[joints]
    _, faults = streamed([("right", points)] * 30, rate=30)
    assert faults == ["mirrored"] * 30


def test_a_mirrored_stream_stays_rejected_while_its_hand_is_flat():
    names = ("flat-right", "relax-right", "relax-right", "flat-right", "flat-right")
    hand = through_poses(*names)
    _, faults = streamed([("right", points) for points in hand])
    assert faults == [None] * len(hand)
    _, faults = streamed([("right", points * MIRROR) for points in hand])
    first = faults.index("mirrored")
    # Straight fingers look the same on both hands; bent ones show it within 70 frames, a second.
    assert side_evidence(hand[first]) > 0.0
    assert first < 40
    assert faults[first:] == ["mirrored"] * (len(hand) - first)


def test_a_tracker_that_confuses_the_sides_for_a_while_is_used_again():
    hand = ("right", POSES["relax-right"])
    confused = ("right", POSES["relax-right"] * MIRROR)
    _, faults = streamed([hand] * 30 + [confused] * 30 + [hand] * 30)
    assert faults[:30] == [None] * 30
    assert set(faults[30:60]) == {"mirrored"}
    assert faults[80:] == [None] * 10


def test_fingers_bent_back_by_20_degrees_are_no_other_hand():
    joints = POSES["flat-right"].copy()
    across = joints[6] - joints[21]
    for start in (5, 10, 15, 20):
        turn = at.Pose.turn(across, np.radians(-20.0))
        knuckle = joints[start + 1]
        joints[start + 2 : start + 5] = knuckle + turn.rotate(
            joints[start + 2 : start + 5] - knuckle
        )
    _, faults = streamed([("right", joints)] * 60)
    assert faults == [None] * 60


# --- formats ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "tolerance"),
    [
        ("openxr.jsonl", 1e-4),
        ("vuer.json", 1e-4),
        ("iwer.json", 2e-3),  # rounded to 1 mm twice
        ("quest_streamer.txt", 2e-4),
    ],
)
def test_other_formats_are_the_same_hand(name, tolerance, tmp_path):
    frame = reading(name).frames[0]
    pose = POSES["flat-right" if "vuer" not in name and "openxr" not in name else "relax-right"]
    expected = pose[TRACKED] if len(frame.landmarks) == 21 else pose
    shift = frame.landmarks[0] - expected[0]
    np.testing.assert_allclose(frame.landmarks - shift, expected, atol=tolerance)
    assert frame.side == "right"
    assert is_recording(RECEIVED / name)
    assert reading(name).health.used == reading(name).health.received
    assert reading(name).frames[-1].time == pytest.approx(
        (len(reading(name).frames) - 1) / 70, rel=0.02, abs=0.11
    )


def test_matrices_are_read_by_rows_and_columns_and_relative_to_a_wrist(tmp_path):
    hand = POSES["relax-right"]
    matrices = np.tile(np.eye(4), (25, 1, 1))
    matrices[:, :3, 3] = hand + [0.05, 1.0, -0.3]
    message = {"time": 0, "side": "right", "sequence": 0}
    for given in (matrices, matrices.transpose(0, 2, 1), matrices.reshape(-1)):
        frame = at.hands.from_json(json.dumps(message | {"landmarks": given.tolist()}))
        np.testing.assert_allclose(frame.landmarks, matrices[:, :3, 3])
    wrist = np.eye(4)
    wrist[:3, :3] = at.Pose.turn((0, 1, 0), 0.4).rotation
    wrist[:3, 3] = [0.05, 1.0, -0.3]
    matrices[:, :3, 3] = hand - hand[0]
    path = tmp_path / "vision.json"
    path.write_text(
        json.dumps({"right_fingers": matrices.tolist(), "right_wrist": [wrist.tolist()]})
    )
    frame = at.hands.load_recording(path).frames[0]
    placed = (hand - hand[0]) @ wrist[:3, :3].T + wrist[:3, 3]
    np.testing.assert_allclose(frame.landmarks, placed, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "fault", "words"),
    [
        ("first_25_of_26.jsonl", "impossible", "palm"),
        ("read_by_rows.jsonl", "impossible", "25 joints are at the same position"),
        ("image_coordinates.jsonl", "not_in_metres", "picture"),
    ],
)
def test_what_is_no_hand_is_rejected_by_its_cause(name, fault, words):
    with raises_code(fault, words):
        reading(name)


def test_frames_without_a_landmark_are_left_out():
    health = reading("some_nan.jsonl", leave_out=True).health
    assert (health.received, health.used, health.half_lost) == (7, 4, 3)


def test_a_recording_relative_to_the_wrist_says_so():
    assert "origin" in reading("vuer.json").note
    assert reading("confidence.jsonl").note == ""


def test_further_keys_are_ignored():
    assert reading("confidence.jsonl").health.used == 2
    message = json.loads((RECEIVED / "confidence.jsonl").read_text().splitlines()[0])
    frame = at.hands.from_json(json.dumps(message | {"side": "RIGHT", "id": {"time": [3]}}))
    assert frame.side == "right"


@pytest.mark.parametrize(
    ("message", "words"),
    [
        ((RECEIVED / "quest_streamer.txt").read_text().splitlines()[1], "quest_streamer.py"),
        ((RECEIVED / "vuer.json").read_text(), "vuer"),
        ((RECEIVED / "iwer.json").read_text(), "IWER"),
        ('{"worldLandmarks": [[{"x": 0, "y": 0, "z": 0}]], "handedness": "Left"}', "MediaPipe"),
        ('{"time": 0, "side": "left", "sequence": 0, "joints": [[0, 0, 0]]}', "joints"),
    ],
)
def test_messages_of_other_programs_are_named(message, words):
    with raises_code("unreadable", words):
        at.hands.from_json(message)


@pytest.mark.parametrize(
    "text",
    [
        "{}",
        "[]",
        "[3]",
        "3",
        '{"frames": 3}',
        '{"schema": [], "frames": [[0, 0, 0, 0, 0, 0, 0, 0, [5]]]}',
        "[" * 9999,
    ],
    ids=lambda text: text[:20],
)
def test_other_json_is_no_recording(tmp_path, text):
    path = tmp_path / "session.json"
    path.write_text(text)
    with raises_code("unknown_format", "session.json"):
        at.hands.load_recording(str(path), leave_out=True)


def test_a_recording_of_another_program_is_a_hand_of_the_command_line(tmp_path, capsys):
    file = str(tmp_path / "hand.ply")
    assert main(["hand", str(RECEIVED / "iwer.json"), "--edge", "0.02", "--out", file]) == 0
    assert "rounded to 1 mm" in capsys.readouterr().out


def test_the_adapter_of_the_quest_sends_the_same_hand():
    adapter = runpy.run_path(str(ROOT / "examples/trackers/quest_streamer.py"))
    lines = (RECEIVED / "quest_streamer.txt").read_text().splitlines()
    # A wrist that is turned, too, by the reader's quaternion.
    lines[0] = "Right wrist:, 0.0500, 1.0500, 0.3000, 0.194, -0.116, 0.094, -0.970"
    timed = ((float(number), line) for number, line in enumerate(["", "rubbish: 3", *lines]))
    sent = [at.hands.from_json(json.dumps(frame)) for frame in adapter["frames_in"](timed)]
    read = reading("quest_streamer.txt").frames
    assert len(sent) == len(read) == 3
    np.testing.assert_allclose(sent[1].landmarks, read[1].landmarks, atol=1e-6)
    from airtact.hands.tracking.formats import frames_of_streamer

    turned = next(frames_of_streamer(lines))[1]()
    np.testing.assert_allclose(sent[0].landmarks, turned.landmarks, atol=2e-4)


# --- odd streams ------------------------------------------------------------------------------


def test_bursts_keep_the_newest_frame_and_are_named():
    clock = Clock()
    stream = at.hands.HandStream(clock=clock)
    for index in range(40):
        if index % 5 == 0:
            clock.now += 5.0 / 70.0
        assert stream.feed(still(index, index / 70.0)) is None
        assert stream.latest("left").sequence == index
    assert "bursts" in stream.remark()
    # The clock's estimate is that of the newest frame of a burst, not of the delayed ones.
    assert stream.clock("left").time(clock.now) == pytest.approx(39 / 70.0)


def test_a_wrist_at_the_origin_is_named():
    stream, _ = streamed([("right", POSES["relax-right"] - POSES["relax-right"][0])] * 3)
    assert "origin" in stream.remark()
    stream, _ = streamed([("right", POSES["relax-right"] + 0.1)] * 3)
    assert stream.remark() == ""


def test_a_clock_in_milliseconds_that_jumps_back_is_followed():
    clock = Clock()
    stream = at.hands.HandStream(clock=clock)
    faults = []
    for index in range(120):
        clock.now += 1 / 30
        begun = 5e6 if index < 60 else 1e3
        fault = stream.feed(still(index, begun + 1e3 * index / 30))
        faults.append(fault and fault.fault)
    # 20 consistent frames show the unit, and again the jump back.
    assert faults.count(None) >= 120 - 2 * 22
    assert set(faults) == {None, "time_leap", "backwards"}
    times = stream.latest("left").time
    assert stream.clock("left").time(clock.now) == pytest.approx(times, abs=1e-3)


@pytest.mark.parametrize("load", [at.hands.load_recording, at.hands.load_landmarks, at.load_hand])
def test_files_are_named_by_text_or_path(load, tmp_path):
    path = tmp_path / ("hand.jsonl" if load is at.hands.load_recording else "hand.json")
    if load is at.hands.load_recording:
        at.hands.save_recording(str(path), [still(0)])
    else:
        points = POSES["relax-right"].tolist()
        path.write_text(json.dumps({"positions_m": points, "side": "Right"}))
    for name in (path, str(path)):
        assert load(name)
