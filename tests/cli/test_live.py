"""The command live: real processes, real sockets, boards' own model; and what it says of bad input."""

import json
import re
import signal
import socket
import subprocess
import sys
import time
import urllib.request

import numpy as np
import pytest
from websockets.sync.client import connect

import airtact as at
from airtact.cli import main
from airtact.hands.tracking.messages import to_json
from airtact.hands.tracking.recordings import save_recording
from airtact.live.session import read_session
from emission.receivers import Nano16, wired
from paths import EXAMPLES
from references.motions import reaching_recording, still

COMMAND = [sys.executable, "-m", "airtact", "live"]
QUICK = ["live_pinch", "--no-page"]
AUDIT = ["--board", "autd3", "--link", "audit", "--yes", "--cap", "0.5"]


def done(*arguments, seconds: float | None = 1.0) -> tuple[int, dict, str]:
    """Run the command to its end: its exit code, its JSON, and what it wrote beside."""
    lasting = [] if seconds is None else ["--seconds", str(seconds)]
    words = [*COMMAND, *map(str, arguments), *lasting, "--json"]
    ran = subprocess.run(words, capture_output=True, text=True, timeout=120)
    return ran.returncode, json.loads(ran.stdout or "{}"), ran.stderr


class Running:
    """A command that runs; ``said`` waits until it wrote words on its standard error."""

    def __init__(self, *arguments) -> None:
        words = [*COMMAND, *map(str, arguments)]
        self.process = subprocess.Popen(
            words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        self.lines: list[str] = []

    def __enter__(self) -> "Running":
        return self

    def __exit__(self, *fault) -> None:
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


def test_it_runs_at_once_with_what_comes_along(tmp_path):
    code, found, _ = done(*QUICK, "--out", tmp_path, seconds=1.5)
    assert code == 0
    assert found["frames"] > 3
    session = read_session(tmp_path)
    assert len(session.time_in_air) == found["drives"] > 3
    assert not session.amplitudes[-1].any()
    assert session.text == at.example("live_pinch").read_text()


def test_boards_get_the_drives_and_end_in_silence(tmp_path):
    code, found, said = done(*QUICK, *AUDIT, "--out", tmp_path, seconds=1.5)
    assert code == 0, said
    assert found["drives"] > 3
    session = read_session(tmp_path)
    assert np.abs(session.amplitudes).max() == pytest.approx(0.5, abs=1e-6)


def test_a_method_for_what_is_in_doubt_needs_no_table_of_it(tmp_path):
    text = (
        (EXAMPLES / "live_pinch.toml")
        .read_text()
        .replace("hands/pinch.json", str(EXAMPLES / "hands/pinch.json"))
    )
    scene = tmp_path / "scene.toml"
    scene.write_text(
        text.replace("[drive.modulation]", '[drive]\nmethod = "robust"\n\n[drive.modulation]')
    )
    code, found, said = done(scene, "--no-page", "--out", tmp_path, seconds=3.0)
    assert code == 0, said
    assert found["drives"] > 0
    assert read_session(tmp_path).scene.method == "robust"


def loudest_after(log) -> list[float]:
    """Largest amplitude of each drive that the boards took after they fell silent."""
    _, _, after = log.read_text().partition("no call came")
    return [float(line.split()[-1]) for line in after.splitlines() if "loudest" in line]


def test_after_a_stall_the_sound_rises_again(tmp_path):
    with Running(*QUICK, *AUDIT, "--out", tmp_path, "--seconds", "60") as running:
        running.said("playing")
        running.process.send_signal(signal.SIGSTOP)
        log, until = tmp_path / "link.log", time.monotonic() + 120.0
        while "no call came" not in log.read_text() and time.monotonic() < until:
            time.sleep(0.05)
        running.process.send_signal(signal.SIGCONT)
        until = time.monotonic() + 120.0
        while max(loudest_after(log), default=0.0) <= 0.3 and time.monotonic() < until:
            time.sleep(0.05)
        running.process.send_signal(signal.SIGINT)
        code, said = running.ended()
    assert code == 0, said
    _, _, after = log.read_text().partition("no call came")
    assert "silence confirmed" in after.splitlines()[1]
    loudest = loudest_after(log)
    assert max(loudest) > 0.3
    assert loudest[0] < 0.1


def test_trackers_by_websocket_are_followed_and_nonsense_is_counted(tmp_path):
    with Running(*QUICK, "--from", "websocket:0", "--out", tmp_path) as running:
        address = re.search(r"ws://[\d.:]+", running.said("following"))
        assert address
        with connect(address[0]) as tracker:
            for frame in reaching_recording()[:60]:
                tracker.send(to_json(frame))
                tracker.send("nonsense")
                time.sleep(1 / 60)
            time.sleep(3.0)  # for the last message to be read
        running.process.send_signal(signal.SIGINT)
        code, said = running.ended()
    assert code == 0
    said = " ".join(said.split())  # long rows go over two lines
    used, overtaken = (
        int((re.search(rf"(\d+) {word}", said) or [0, 0])[1]) for word in ("used", "overtaken")
    )
    assert "120 received" in said
    assert "60 unreadable" in said
    assert used + overtaken == 60  # a busy machine reads the newest of those that wait
    assert len(read_session(tmp_path).frame_time) == used


def test_without_a_tracker_it_waits_and_is_silent(tmp_path):
    for source in ("websocket:0", "osc:0"):
        code, found, said = done(*QUICK, "--from", source, "--out", tmp_path, seconds=1.2)
        assert code == 0
        assert found["drives"] == 0
        assert found["state"] == "waiting for a hand"
        assert "waiting for a hand" in said


def test_the_frames_of_a_session_are_followed_again(tmp_path):
    done(*QUICK, "--ignore-hand", "--out", tmp_path / "one")
    one = read_session(tmp_path / "one")
    code, found, said = done(
        *QUICK, "--from", tmp_path / "one", "--out", tmp_path / "two", seconds=None
    )
    assert code == 0, said
    assert found["health"]["used"] == len(one.frame_time)
    two = read_session(tmp_path / "two")
    np.testing.assert_array_equal(two.frame_time, one.frame_time)
    np.testing.assert_array_equal(two.landmarks, one.landmarks)
    code, found, _ = done(*QUICK, "--from", tmp_path / "two/session.h5", "--out", tmp_path / "two")
    assert (code, found["code"]) == (2, "options_clash")
    assert len(read_session(tmp_path / "two").frame_time) == len(one.frame_time)


@pytest.mark.slow
def test_a_session_is_checked_against_the_hand_that_was_there(tmp_path, capsys):
    done(*QUICK, "--out", tmp_path, seconds=2.0)
    assert main(["check", str(tmp_path), "--drives", "3", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    session = read_session(tmp_path)
    assert (found["frames"], found["drives"]) == (len(session.frame_time), len(session.time_in_air))
    assert 1 <= len(found["verified"]) <= 3
    for one in found["verified"]:
        assert session.playing[one["index"]]
        assert 0.0 < one["kept"] < 1.2
        assert len(one["pressures"]) == 2


def test_what_is_no_session_is_not_checked_as_one(tmp_path, capsys):
    (tmp_path / "bad.h5").write_bytes(b"nothing")
    empty = recorded_without_a_hand(tmp_path / "empty")
    for arguments, code in [
        ((tmp_path / "bad.h5",), "wrong_kind"),
        ((tmp_path,), "file_missing"),
        ((tmp_path / "bad.h5", "--scale", "2"), "options_clash"),
        (("pinch", "--drives", "3"), "options_clash"),
        ((empty, "--drives", "0"), "too_few"),
        ((empty,), "empty"),
    ]:
        assert main(["check", *map(str, arguments), "--json"]) == 2
        assert json.loads(capsys.readouterr().out)["code"] == code, arguments
    code, found, _ = done(*QUICK, "--from", empty, "--out", tmp_path)
    assert (code, found["code"]) == (2, "empty")


def recorded_without_a_hand(folder):
    """A session in which nothing came."""
    at.live.SessionWriter(
        folder / "session.h5", at.live.live_scene(at.read_scene(at.example("live_pinch")))
    ).close()
    return folder


def test_frames_of_the_other_hand_are_named(tmp_path):
    mirrored = still(0).landmarks * np.array([1.0, 1.0, -1.0])
    file = tmp_path / "right.jsonl"
    save_recording(
        file, [still(index, index / 60, side="right", landmarks=mirrored) for index in range(60)]
    )
    code, found, said = done(*QUICK, "--from", file, "--out", tmp_path)
    assert code == 0
    assert found["drives"] == 0
    assert "waiting for the left hand: these are frames of the right one" in said


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["pinch"], "misplaced"),
        (["open_hand"], "misplaced"),
        ([*QUICK, "--from", "nothing.jsonl"], "unknown_name"),
        ([*QUICK, "--from", "relaxed.json"], "unknown_name"),
        ([*QUICK, "--from", str(EXAMPLES / "hands/relaxed.json")], "unknown_format"),
        ([*QUICK, "--from", "websocket:x"], "not_a_number"),
        ([*QUICK, "--board", "autd3"], "key_missing"),
        (
            [*QUICK, "--board", "nano16", "--link", "serial", "--port", "/dev/null"],
            "does_not_match",
        ),
        ([*QUICK, "--address", "127.0.0.1:1"], "key_missing"),
        ([*QUICK, "--cap", "2"], "out_of_range"),
        ([*QUICK, "--latency", "20"], "out_of_range"),
        ([*QUICK, "--seconds", "-1"], "out_of_range"),
        ([*QUICK, "--board", "autd3", "--link", "audit"], "link_failed"),
    ],
)
def test_bad_input_is_one_sentence(capsys, tmp_path, arguments, code):
    from airtact.cli import main

    lasting = [] if "--seconds" in arguments else ["--seconds", "0.5"]
    assert main(["live", *arguments, *lasting, "--out", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert said.endswith(f" [{code}]\n")
    assert not (tmp_path / "session.h5").exists()


@pytest.mark.parametrize("where", [["--no-page", "--from", "websocket:{}"], ["--page-port", "{}"]])
def test_a_port_in_use_is_named(capsys, tmp_path, where):
    from airtact.cli import main

    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        words = [word.format(port) for word in where]
        code = main(["live", *words, "--seconds", "1", "--out", str(tmp_path)])
        said = capsys.readouterr().err
        assert code == 2
        assert str(port) in said
        assert said.endswith(" [link_in_use]\n")


def test_a_killed_loop_leaves_a_session_that_can_be_read(tmp_path):
    with Running(*QUICK, "--out", tmp_path) as running:
        running.said("playing")
        time.sleep(2.0)
        running.process.send_signal(signal.SIGKILL)
        running.process.wait()
    session = None
    end = time.monotonic() + 120.0
    while session is None and time.monotonic() < end:  # the writer ends when it has written all
        try:
            session = read_session(tmp_path)
        except at.InvalidInput:
            time.sleep(0.1)
    assert session is not None
    assert len(session.time_in_air) > 1  # a busy machine makes few
    assert np.isfinite(session.amplitudes).all()


@pytest.mark.parametrize("times", [1, 2])
def test_ctrl_c_ends_in_silence(tmp_path, times):
    with Running(*QUICK, *AUDIT, "--out", tmp_path) as running:
        running.said("playing")
        for _ in range(times):
            running.process.send_signal(signal.SIGINT)
            time.sleep(0.02)
        code, said = running.ended()
    assert code in (0, 130), said
    session = read_session(tmp_path)
    assert len(session.time_in_air) >= 1  # a busy machine makes few


def test_a_hand_through_the_array_gets_no_sound(tmp_path):
    file = tmp_path / "through.jsonl"
    frames = [
        still(index, index / 60, landmarks=still(0).landmarks + np.array([0.19, 0.0, 0.0]))
        for index in range(60)
    ]
    save_recording(file, frames)
    code, found, said = done(*QUICK, "--from", file, "--out", tmp_path)
    assert code == 0
    assert found["drives"] == 0
    assert "through the array's face" in said


def test_a_scene_with_the_tracker_elsewhere_moves_its_frames(tmp_path):
    text = (
        (EXAMPLES / "live_pinch.toml")
        .read_text()
        .replace("hands/pinch.json", str(EXAMPLES / "hands/pinch.json"))
    )
    scene = tmp_path / "scene.toml"
    scene.write_text(text + "\n[tracker]\ntranslation = [0.01, 0.0, 0.0]\n")
    file = tmp_path / "still.jsonl"
    save_recording(file, [still(index, index / 60) for index in range(20)])
    code, _, _ = done(scene, "--no-page", "--from", file, "--out", tmp_path, seconds=None)
    assert code == 0
    moved = read_session(tmp_path).landmarks
    np.testing.assert_allclose(moved[0], still(0).landmarks + np.array([0.01, 0.0, 0.0]), atol=2e-6)


def test_boards_that_fail_in_the_middle_end_it_with_a_session(tmp_path):
    board = "[[array.poses]]\naxis = [0.0, 1.0, 0.0]\ndegrees = -90.0\ntranslation = [0.1, -0.02, 0.0]\n"
    text = (
        (EXAMPLES / "live_pinch.toml")
        .read_text()
        .replace("hands/pinch.json", str(EXAMPLES / "hands/pinch.json"))
    )
    before, after = text.split("[array]")[0], text[text.index("# This pose is the hand") :]
    scene = tmp_path / "scene.toml"
    after = after.split("[drive.modulation]")[0]  # this board is too slow for a modulation
    scene.write_text(f'{before}[array]\nlayout = "boards"\nboard = "nano16"\n{board}\n{after}')
    with wired(Nano16(), cut_after=4000) as wire:
        port = [
            "--board",
            "nano16",
            "--link",
            "serial",
            "--port",
            wire.port,
            "--full-scale",
            "--yes",
        ]
        with Running(scene, "--no-page", *port, "--out", tmp_path) as running:
            code, said = running.ended()
    assert code == 1, said
    assert "[link_failed]" in said or "[silence_failed]" in said
    assert len(read_session(tmp_path).time_in_air) > 1


def test_the_page_is_served_beside_the_loop(tmp_path):
    with Running("live_pinch", "--page-port", 0, "--out", tmp_path) as running:
        address = re.search(r"page: (http://\S+)", running.said("page: http"))
        assert address
        with urllib.request.urlopen(address[1], timeout=120) as page:
            assert page.status == 200
        running.said("playing")
        running.process.send_signal(signal.SIGINT)
        assert running.ended()[0] == 0


def test_without_viser_it_says_what_to_install(tmp_path, monkeypatch):
    (tmp_path / "viser.py").write_text("raise ImportError('No module named viser')")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    code, _, said = done("live_pinch", "--page-port", 0, "--out", tmp_path)
    assert code == 2
    assert "airtact[live]" in said
    assert "[extra_missing]" in said


def test_only_recordings_are_named_where_hands_come_from_none(tmp_path):
    code, _, said = done("live_pinch", "--from", "reachinx", "--no-page", "--out", tmp_path)
    assert code == 2
    assert "2 examples: pinching.jsonl, reaching.jsonl" in said
