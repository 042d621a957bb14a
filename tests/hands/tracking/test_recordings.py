"""Recordings: nothing is lost, every fault is rejected with its place, or left out and counted; replay keeps time."""

import json
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import airtact as at
from airtact.hands.tracking.messages import to_json
from airtact.hands.tracking.recordings import load_recording, replay, save_recording
from faults import raises_code
from references.hand_poses import example
from references.motions import still

JOINTS, _ = example("pinch")
TRACKED = np.delete(JOINTS, [5, 10, 15, 20], axis=0)
MIXED = [
    still(0),
    still(1, landmarks=None),
    still(2, landmarks=TRACKED, cloud=JOINTS),
    still(2, side="right", landmarks=JOINTS * [-1, 1, 1]),
    still(5, landmarks=None, cloud=JOINTS[:3]),
]


@pytest.mark.parametrize(("ending", "exact"), [(".jsonl", 0.6e-6), (".npz", 0.0)])
def test_what_is_written_is_read(tmp_path, ending, exact):
    path = tmp_path / f"hand{ending}"
    save_recording(path, MIXED)
    recording = load_recording(path)
    assert recording.health.used == 5
    assert recording.health.skipped == 2
    for one, two in zip(recording.frames, MIXED, strict=True):
        assert (one.time, one.side, one.sequence, one.lost) == (
            two.time,
            two.side,
            two.sequence,
            two.lost,
        )
        for back, was in ((one.landmarks, two.landmarks), (one.cloud, two.cloud)):
            assert (back is None) == (was is None)
            if was is not None:
                np.testing.assert_allclose(back, was, rtol=0, atol=exact)
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


LINES = [to_json(still(index)).decode() for index in range(4)]


def changed(line, **fields):
    return json.dumps(json.loads(line) | fields)


def scaled(line, factor):
    return changed(line, landmarks=(factor * np.array(json.loads(line)["landmarks"])).tolist())


BAD = {
    "unreadable": ("rubbish", "line 3"),
    "not_metres": (scaled(LINES[2], 1000), "line 3: the landmarks span 156.4 m"),
    "mirrored": (
        scaled(LINES[2], [-1, 1, 1]),
        "line 3: the landmarks are given as those of a left hand",
    ),
    "half_lost": (scaled(LINES[2], np.nan), "line 3: 25 landmarks"),
    "unknown_count": (changed(LINES[2], landmarks=[[0.0, 0.0, 0.0]] * 22), "line 3: 22 landmarks"),
    "backwards": (changed(LINES[2], time=0.01), "line 3: time goes back from 0.0333333 to 0.01 s"),
    "repeated": (LINES[1], "line 3: frame 1 of the left hand had come before"),
    "out_of_order": (
        changed(LINES[2], sequence=1, time=0.01),
        "line 3: frame 1 of the left hand comes after frame 1",
    ),
}


@pytest.mark.parametrize("fault", BAD)
def test_a_fault_is_rejected_with_its_line_or_left_out_and_counted(tmp_path, fault):
    line, shown = BAD[fault]
    path = tmp_path / "hand.jsonl"
    path.write_text("\n".join([*LINES[:2], line, LINES[3]]) + "\n\n")
    with raises_code(fault, f"hand.jsonl: {shown}"):
        load_recording(path)
    recording = load_recording(path, leave_out=True)
    assert [frame.sequence for frame in recording.frames] == [0, 1, 3]
    assert getattr(recording.health, fault) == 1
    assert recording.health.received - recording.health.used == 1


@pytest.mark.parametrize(
    ("name", "content", "code", "shown"),
    [
        ("hand.jsonl", b"", "empty", "0 frames"),
        ("hand.npz", b"", "file_unreadable", "bytes"),
        ("hand.npz", b"rubbish", "file_unreadable", "bytes"),
        ("hand.csv", b"1,2", "unknown_format", "'.csv'"),
    ],
)
@pytest.mark.parametrize("leave_out", [True, False])
def test_files_that_are_no_recording_are_rejected(tmp_path, name, content, code, shown, leave_out):
    (tmp_path / name).write_bytes(content)
    with raises_code(code, f"{name}: ", shown):
        load_recording(tmp_path / name, leave_out)


@pytest.mark.parametrize("name", ["none.jsonl", "none.npz"])
def test_files_that_are_not_there_are_rejected(tmp_path, name):
    with raises_code("file_missing", name):
        load_recording(tmp_path / name)


@pytest.mark.parametrize(
    ("broken", "code", "shown"),
    [
        ({"format_version": np.int64(2)}, "unsupported_version", "version 2"),
        ({"clouds": None}, "data_missing", "clouds"),
        ({"landmarks": np.zeros((3, 3))}, "wrong_shape", "(100, 3)"),
        ({"sequence": np.zeros(3, dtype=int)}, "wrong_shape", "(3,)"),
        ({"sequence": np.zeros(4)}, "wrong_shape", "float64"),
        ({"landmark_counts": np.array([-25, 50, 50, 25])}, "out_of_range", "-25"),
        ({"time": np.array([{}] * 4)}, "file_unreadable", "bytes"),
    ],
)
def test_arrays_that_do_not_fit_are_rejected(tmp_path, broken, code, shown):
    path = tmp_path / "hand.npz"
    save_recording(path, [still(index) for index in range(4)])
    arrays = {**np.load(path)} | broken
    np.savez(path, **{name: one for name, one in arrays.items() if one is not None})
    with raises_code(code, shown):
        load_recording(path)


def test_a_recording_without_a_version_is_read(tmp_path):
    path = tmp_path / "hand.npz"
    save_recording(path, [still(index) for index in range(4)])
    arrays = {**np.load(path)}
    assert arrays.pop("format_version") == 1
    np.savez(path, **arrays)
    assert len(load_recording(path).frames) == 4


def test_nothing_to_write_is_rejected(tmp_path):
    with raises_code("not_writable", "0 frames", "hand.npz"):
        save_recording(tmp_path / "hand.npz", [])
    with raises_code("not_writable", "1 frame", "hand.txt"):
        save_recording(tmp_path / "hand.txt", [still(0)])


@given(
    st.lists(
        st.binary(max_size=60) | st.sampled_from([line.encode() for line in LINES]), max_size=12
    )
)
def test_no_lines_break_the_reader(tmp_path_factory, lines):
    path = tmp_path_factory.mktemp("fuzz") / "hand.jsonl"
    path.write_bytes(b"\n".join(lines))
    try:
        recording = load_recording(path, leave_out=True)
    except at.InvalidInput:
        return
    assert recording.health.used == len(recording.frames)


@pytest.mark.parametrize(("speed", "lasts"), [(1.0, 0.1), (0.5, 0.2), (4.0, 0.025), (np.inf, 0.0)])
def test_replay_gives_no_frame_before_its_time(speed, lasts):
    began = time.monotonic()
    given = [
        (frame.sequence, time.monotonic() - began)
        for frame in replay((still(index) for index in range(4)), speed)
    ]
    assert [index for index, _ in given] == [0, 1, 2, 3]
    assert all(when >= index / 3 * lasts for index, when in given)


def test_a_replay_of_no_speed_is_rejected():
    with raises_code("out_of_range", "0 times"):
        next(replay([still(0)], 0.0))
