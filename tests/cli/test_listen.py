"""The commands for hands that move: what they write and report, and what they reject."""

import re
import signal
import subprocess
import sys

import pytest
import trimesh
from matplotlib.image import imread
from websockets.sync.client import connect

import airtact as at
from cli.running import done, rejected
from paths import HANDS
from references.motions import still

EXAMPLE = HANDS / "pinching.jsonl"


@pytest.fixture
def recording(tmp_path):
    """Nine frames, a mirrored one in their middle and one that is missing."""
    lines = [at.hands.to_json(still(index)).decode() for index in (0, 1, 2, 3, 5, 6, 7, 8, 9)]
    lines[4] = lines[4].replace("left", "right")
    path = tmp_path / "hand.jsonl"
    path.write_text("\n".join(lines))
    return path


def test_a_recording_gives_skins_and_a_picture(capsys, tmp_path):
    path = tmp_path / "hand.jsonl"
    at.hands.save_recording(path, [still(0), still(1, landmarks=None), still(2), still(4)])
    said, _ = done(
        capsys, "hand", path, "--frame", 2, "--edge", "0.012", "--out", tmp_path / "skin.stl"
    )
    assert "4 received, 4 used, 1 lost, 1 skipped" in said
    assert trimesh.load(tmp_path / "skin.stl").is_watertight
    assert imread(tmp_path / "skin.png").shape[1] > 600


def test_faulty_recordings_are_rejected_or_counted(capsys, recording, tmp_path):
    said = rejected(capsys, "hand", recording, "--out", tmp_path / "skin.ply")
    assert "hand.jsonl: line 5" in said
    assert said.endswith(" [mirrored]")
    assert not (tmp_path / "skin.ply").exists()
    out = tmp_path / "skin.ply"
    said, _ = done(
        capsys, "hand", recording, "--leave-out", "--frame", 9, "--edge", "0.012", "--out", out
    )
    assert "9 received, 8 used, 1 mirrored, 2 skipped" in said


def test_what_cannot_be_shown_is_rejected(capsys, recording, tmp_path):
    out = tmp_path / "skin.ply"
    pose = HANDS / "pinch.json"
    for arguments, *numbers, fault in (
        ([recording, "--leave-out", "--frame", 7777], "frame 7777", "data_missing"),
        ([recording, "--gap", 0.01], "options_clash"),
        ([pose, "--frame", 3], "pinch.json", "options_clash"),
        ([tmp_path / "none.jsonl"], "none.jsonl", "file_missing"),
        ([pose, "--edge", 6], "6 m", "out_of_range"),
    ):
        said = rejected(capsys, "hand", *arguments, "--out", out)
        assert said.endswith(f" [{fault}]")
        assert [number for number in numbers if number not in said] == []


def test_what_trackers_send_is_recorded_and_kept_on_ctrl_c(tmp_path):
    command = [
        sys.executable,
        "-m",
        "airtact",
        "live",
        "--from",
        "websocket:0",
        "--seconds",
        "600",
        "--record",
    ]
    file = tmp_path / "recorded.jsonl"
    with subprocess.Popen(
        [*command, file], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as listening:
        assert listening.stdout is not None
        assert listening.stderr is not None
        address = None
        while address is None:
            address = re.search(r"(ws://[\d.:]+)", listening.stderr.readline())
        with connect(address[1]) as tracker:
            for index in range(3):
                tracker.send(at.hands.to_json(still(index)))
            tracker.send("rubbish")
        listening.send_signal(signal.SIGINT)
        said, errors = listening.communicate(timeout=60)
        assert listening.returncode == 0, errors
    assert "Messages: 4 received, 3 used" in said
    assert [frame.sequence for frame in at.hands.load_recording(file).frames] == [0, 1, 2]


@pytest.mark.parametrize(
    ("source", "seconds", "file", "code"),
    [
        ("websocket:0", 0.01, "none.jsonl", "empty"),
        ("websocket:0", -1, "none.jsonl", "out_of_range"),
        ("websocket:0", 1, "none.csv", "unknown_format"),
        ("page", 1, "none.jsonl", "unknown_name"),
    ],
)
def test_nothing_to_record_is_reported(capsys, tmp_path, source, seconds, file, code):
    words = ["live", "--from", source, "--seconds", seconds, "--record", tmp_path / file]
    said = rejected(capsys, *words)
    assert said.endswith(f" [{code}]")
