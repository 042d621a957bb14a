"""The command live: real processes, real sockets, boards' own model; and what it says of bad input."""

import json
import re
import signal
import subprocess
import sys
import time
import urllib.request
from dataclasses import replace
from threading import Event, Thread, Timer

import numpy as np
import pytest
from websockets.sync.client import connect

import airtact as at
from airtact.cli import main
from emission.receivers import Nano16, wired
from paths import EXAMPLES
from references.motions import reaching_recording, still

COMMAND = [sys.executable, "-m", "airtact", "live"]
QUICK = ["live_pinch", "--no-page"]
UNSOLVED = [*QUICK, "--ignore-hand"]
"""For what the solvers of the hand do not matter for: their processes take 2 s to start."""
AUDIT = ["--board", "autd3", "--link", "audit", "--yes", "--cap", "0.5"]


@pytest.fixture
def live(capsys):
    """Run the command to its end: its exit code, its JSON, and what it wrote beside."""

    def run(*arguments, seconds: float | None = 1.0) -> tuple[int, dict, str]:
        lasting = [] if seconds is None else ["--seconds", str(seconds)]
        code = main(["live", *map(str, arguments), *lasting, "--json"])
        printed = capsys.readouterr()
        return code, json.loads(printed.out or "{}"), printed.err

    return run


def changed_scene(path, change):
    text = (EXAMPLES / "live_pinch.toml").read_text()
    hand = str(EXAMPLES / "hands/pinch.json")
    path.write_text(change(text.replace("hands/pinch.json", hand)))
    return path


class Running:
    """A command that runs; ``said`` waits until it wrote words on its standard error."""

    def __init__(self, *arguments) -> None:
        words = [*COMMAND, *map(str, arguments)]
        self.process = subprocess.Popen(
            words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        self.lines: list[str] = []
        # Words that never come would otherwise be waited for without end.
        self.end = Timer(120.0, self.process.kill)
        self.end.start()

    def __enter__(self) -> "Running":
        return self

    def __exit__(self, *fault) -> None:
        self.end.cancel()
        self.process.kill()
        self.process.communicate()

    def said(self, words: str) -> str:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.lines.append(line)
            if re.search(words, line):
                return line
        raise AssertionError(f"{words!r} is not in {self.lines}")

    def ended(self) -> tuple[int, str]:
        out, rest = self.process.communicate(timeout=120)
        return self.process.returncode, "".join(self.lines) + rest + out


def test_it_runs_at_once_with_what_comes_along(tmp_path, live, capsys):
    code, found, said = live(*QUICK, *AUDIT, "--out", tmp_path, seconds=3.0)
    assert code == 0, said
    assert found["frames"] > 0
    session = at.live.read_session(tmp_path)
    assert len(session.time_in_air) == found["drives"] > 0
    assert np.abs(session.amplitudes).max() == pytest.approx(0.5, abs=0.04)
    assert not session.amplitudes[-1].any()
    assert session.text == at.example("live_pinch").read_text()
    assert main(["why", "pinch", "--session", str(tmp_path / "session.h5")]) == 2
    assert "[does_not_match]" in capsys.readouterr().err


def reach_through(tracker, ended: Event) -> None:
    index = 60
    while not ended.wait(1 / 60):
        joints = still(0).landmarks + [0.19, 0.0, 0.0]
        tracker.send(at.hands.to_json(still(index, time.monotonic(), landmarks=joints)))
        index += 1


def test_trackers_by_websocket_are_followed_and_nonsense_is_counted(tmp_path):
    with Running(*UNSOLVED, "--from", "websocket:0", "--out", tmp_path) as running:
        address = re.search(r"ws://[\d.:]+", running.said("following"))
        assert address
        with connect(address[0]) as tracker:
            for frame in reaching_recording()[:60]:
                # A clock that a busy computer slows down would be rejected.
                tracker.send(at.hands.to_json(replace(frame, time=time.monotonic())))
                tracker.send("nonsense")
                time.sleep(1 / 60)
            # The state of the frames that follow shows that all of these were read.
            ended = Event()
            follows = Thread(target=reach_through, args=(tracker, ended))
            follows.start()
            running.said("through the array's face")
            ended.set()
            follows.join()
        running.process.send_signal(signal.SIGINT)
        code, said = running.ended()
    assert code == 0
    said = " ".join(said.split())  # long rows go over two lines
    used = int((re.search(r"(\d+) used", said) or [0, 0])[1])
    assert "60 unreadable" in said
    assert used > 60
    assert len(at.live.read_session(tmp_path).frame_time) == used


def test_the_frames_of_a_session_are_followed_again(tmp_path, live):
    live(*UNSOLVED, "--out", tmp_path / "one", seconds=0.5)
    one = at.live.read_session(tmp_path / "one")
    code, found, said = live(
        *UNSOLVED, "--from", tmp_path / "one", "--out", tmp_path / "two", seconds=None
    )
    assert code == 0, said
    assert found["health"]["used"] == len(one.frame_time)
    two = at.live.read_session(tmp_path / "two")
    np.testing.assert_array_equal(two.frame_time, one.frame_time)
    np.testing.assert_array_equal(two.landmarks, one.landmarks)
    code, found, _ = live(*QUICK, "--from", tmp_path / "two/session.h5", "--out", tmp_path / "two")
    assert (code, found["code"]) == (2, "options_clash")
    assert len(at.live.read_session(tmp_path / "two").frame_time) == len(one.frame_time)


@pytest.mark.slow
def test_a_session_is_verified_with_the_recorded_hand(tmp_path, live, capsys):
    live(*QUICK, "--out", tmp_path, seconds=2.0)
    assert main(["live", "--verify", str(tmp_path), "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    session = at.live.read_session(tmp_path)
    assert 1 <= len(record["verified"]) <= 10
    for row in record["verified"]:
        assert session.playing[row["index"]]
        assert 0.0 < row["kept"] < 1.2
        assert len(row["pressures"]) == 2


def test_what_is_no_session_is_not_followed(tmp_path, live):
    (tmp_path / "bad.h5").write_bytes(b"nothing")
    for source, code in [
        (tmp_path / "bad.h5", "file_unreadable"),
        (tmp_path, "file_missing"),
        (recorded_without_a_hand(tmp_path / "empty"), "empty"),
    ]:
        status, found, _ = live(*QUICK, "--from", source, "--out", tmp_path / "out")
        assert (status, found["code"]) == (2, code), source


def recorded_without_a_hand(folder):
    scene = at.live.live_scene(at.read_scene(at.example("live_pinch")))
    writer = at.live.SessionWriter(folder / "session.h5", scene)
    writer.begin()
    writer.close()
    return folder


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["pinch"], "misplaced"),
        (["open_hand"], "misplaced"),
        ([*QUICK, "--from", "nothing.jsonl"], "file_missing"),
        ([*QUICK, "--from", "reachinx"], "unknown_name"),
        ([*QUICK, "--from", str(EXAMPLES / "hands/relaxed.json")], "unknown_format"),
        ([*QUICK, "--from", "websocket:x"], "not_a_number"),
        ([*QUICK, "--board", "autd3"], "key_missing"),
        (
            [*QUICK, "--board", "nano16", "--link", "serial", "--port", "/dev/null"],
            "does_not_match",
        ),
        ([*QUICK, "--address", "127.0.0.1:1"], "key_missing"),
        ([*QUICK, "--port", "8941"], "options_clash"),
        ([*QUICK, "--cap", "2"], "out_of_range"),
        ([*QUICK, "--latency", "20"], "out_of_range"),
        ([*QUICK, "--seconds", "-1"], "out_of_range"),
        ([*QUICK, "--board", "autd3", "--link", "audit"], "link_failed"),
    ],
)
def test_bad_input_is_rejected(tmp_path, live, arguments, code):
    seconds = None if "--seconds" in arguments else 0.5
    status, found, _ = live(*arguments, "--out", tmp_path, seconds=seconds)
    assert (status, found["code"]) == (2, code)
    assert not (tmp_path / "session.h5").exists()


def test_a_killed_loop_leaves_a_session_that_can_be_read(tmp_path):
    with Running(*UNSOLVED, "--out", tmp_path) as running:
        running.said("playing")
        end = time.monotonic() + 120.0
        # The scene and its array take 120 kB, and the first 128 drives as much again.
        file = tmp_path / "session.h5"
        while time.monotonic() < end and not (file.exists() and file.stat().st_size > 250_000):
            time.sleep(0.05)
        running.process.send_signal(signal.SIGKILL)
        running.process.wait()
    session = None
    end = time.monotonic() + 120.0
    while session is None and time.monotonic() < end:  # the writer ends when it has written all
        try:
            session = at.live.read_session(tmp_path)
        except at.InvalidInput:
            time.sleep(0.1)
    assert session is not None
    assert len(session.time_in_air) > 1  # a busy machine makes few
    assert np.isfinite(session.amplitudes).all()


@pytest.mark.parametrize("times", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_the_page_is_served_and_ctrl_c_ends_in_silence(tmp_path, times):
    with Running("live_pinch", *AUDIT, "--page-port", 0, "--out", tmp_path) as running:
        address = re.search(r"page: (http://\S+)", running.said("page: http"))
        assert address
        with urllib.request.urlopen(address[1], timeout=120) as page:
            assert page.status == 200
        running.said("playing")
        for _ in range(times):
            running.process.send_signal(signal.SIGINT)
            time.sleep(0.02)
        code, said = running.ended()
    assert code == 0 if times == 1 else code in (0, 130), said
    session = at.live.read_session(tmp_path)
    assert len(session.time_in_air) >= 1  # a busy machine makes few


def test_a_scene_with_the_tracker_elsewhere_moves_its_frames(tmp_path, live):
    tracker = "\n[tracker]\ntranslation = [0.01, 0.0, 0.0]\n"
    scene = changed_scene(tmp_path / "scene.toml", lambda text: text + tracker)
    file = tmp_path / "still.jsonl"
    at.hands.save_recording(file, [still(index, index / 60) for index in range(20)])
    code, _, _ = live(scene, *UNSOLVED[1:], "--from", file, "--out", tmp_path, seconds=None)
    assert code == 0
    moved = at.live.read_session(tmp_path).landmarks
    np.testing.assert_allclose(moved[0], still(0).landmarks + np.array([0.01, 0.0, 0.0]), atol=2e-6)


def test_boards_that_fail_in_the_middle_end_it_with_a_session(tmp_path, live):
    pose = "axis = [0.0, 1.0, 0.0]\ndegrees = -90.0\ntranslation = [0.1, -0.02, 0.0]"
    board = f'[array]\nlayout = "boards"\nboard = "nano16"\n[[array.poses]]\n{pose}\n\n'

    def one_small_board(text):
        hand = text[text.index("# The hand at rest") :].split("[drive.modulation]")[0]
        return text.split("[array]")[0] + board + hand  # it is too slow for a modulation

    scene = changed_scene(tmp_path / "scene.toml", one_small_board)
    with wired(Nano16(), cut_after=4000) as wire:
        way = ["--board", "nano16", "--link", "serial", "--port", wire.port, "--full-scale"]
        code, found, said = live(
            scene, *UNSOLVED[1:], *way, "--yes", "--out", tmp_path, seconds=None
        )
    assert code == 1, said
    assert found["code"] in ("link_failed", "silence_failed")
    assert len(at.live.read_session(tmp_path).time_in_air) > 1
