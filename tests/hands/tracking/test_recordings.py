"""Recordings: nothing is lost, every fault is rejected with its place, or left out and counted; replay keeps time."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import airtact as at
from airtact.hands.joints import TRACKED
from faults import raises_code
from references.motions import JOINTS, Clock, mirrored, still

MIXED = [
    still(0),
    still(1, landmarks=None),
    still(2, landmarks=JOINTS[TRACKED], cloud=JOINTS),
    mirrored(2),
    still(5, landmarks=None, cloud=JOINTS[:3]),
]
FRAMES = [still(index) for index in range(4)]
LINES = [at.hands.to_json(frame).decode() for frame in FRAMES]


def test_a_written_recording_is_read_back(tmp_path):
    path = tmp_path / "hand.jsonl"
    at.hands.save_recording(path, MIXED)
    recording = at.hands.load_recording(path)
    assert recording.health.used == 5
    assert recording.health.skipped == 2
    for frame, original in zip(recording.frames, MIXED, strict=True):
        for name in ("time", "side", "sequence", "lost"):
            assert getattr(frame, name) == getattr(original, name)
        for name in ("landmarks", "cloud"):
            points = getattr(original, name)
            assert (getattr(frame, name) is None) == (points is None)
            if points is not None:
                np.testing.assert_allclose(getattr(frame, name), points, rtol=0, atol=0.6e-6)
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


def changed(index, **fields):
    return json.dumps(json.loads(LINES[index]) | fields)


@pytest.mark.parametrize(
    ("fault", "line"),
    [
        ("unreadable", "rubbish"),
        ("not_in_metres", changed(2, landmarks=(1e3 * JOINTS).tolist())),
        ("mirrored", changed(2, landmarks=(JOINTS * [-1, 1, 1]).tolist())),
        ("half_lost", changed(2, landmarks=(JOINTS * np.nan).tolist())),
        ("unknown_count", changed(2, landmarks=[[0.0, 0.0, 0.0]] * 22)),
        ("backwards", changed(2, time=0.01)),
        ("repeated", LINES[1]),
        ("out_of_order", changed(2, sequence=1, time=0.01)),
    ],
)
def test_a_fault_is_rejected_with_its_line_or_left_out_and_counted(tmp_path, fault, line):
    path = tmp_path / "hand.jsonl"
    path.write_text("\n".join([*LINES[:2], line, LINES[3]]) + "\n\n")
    with raises_code(fault):
        at.hands.load_recording(path)
    recording = at.hands.load_recording(path, leave_out=True)
    assert [frame.sequence for frame in recording.frames] == [0, 1, 3]
    assert getattr(recording.health, fault) == 1
    assert recording.health.received - recording.health.used == 1


@pytest.mark.parametrize(
    ("name", "content", "code"),
    [
        ("hand.jsonl", b"", "empty"),
        ("hand.csv", b"1,2", "unknown_format"),
        ("none.jsonl", None, "file_missing"),
    ],
)
@pytest.mark.parametrize("leave_out", [True, False])
def test_other_files_are_rejected(tmp_path, name, content, code, leave_out):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with raises_code(code, name):
        at.hands.load_recording(tmp_path / name, leave_out)


def test_nothing_to_write_is_rejected(tmp_path):
    with raises_code("not_writable", "hand.jsonl"):
        at.hands.save_recording(tmp_path / "hand.jsonl", [])
    with raises_code("not_writable", "hand.txt"):
        at.hands.save_recording(tmp_path / "hand.txt", FRAMES)


@given(
    st.lists(
        st.binary(max_size=60) | st.sampled_from([line.encode() for line in LINES]), max_size=12
    )
)
def test_no_lines_break_the_reader(tmp_path_factory, lines):
    path = tmp_path_factory.mktemp("fuzz") / "hand.jsonl"
    path.write_bytes(b"\n".join(lines))
    try:
        recording = at.hands.load_recording(path, leave_out=True)
    except at.InvalidInput:
        return
    assert recording.health.used == len(recording.frames)


@pytest.mark.parametrize("speed", [1.0, 0.5, 4.0, np.inf])
def test_replay_gives_each_frame_at_its_time_or_at_once_where_the_reader_is_slow(speed):
    clock = Clock()
    times = []
    for frame in at.hands.replay(FRAMES, speed, clock=clock, sleep=clock.sleep):
        times.append(clock.now - 1000.0)
        if frame.sequence == 1:
            clock.now += 1.5 / 30 / speed  # reads until after the next frame is due
    assert times == pytest.approx(np.array([0.0, 1.0, 2.5, 3.0]) / 30 / speed)


def test_a_replay_of_no_speed_is_rejected():
    with raises_code("out_of_range", "0 times"):
        next(at.hands.replay([still(0)], 0.0))
