"""The live loop on real frames: sound follows, fades and rises, and the session holds what was done."""

import re
import time
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import airtact as at
from airtact.hands.tracking.recordings import Recording, load_recording
from airtact.hands.tracking.stream import StreamHealth
from airtact.live.session import Session, read_session
from references.motions import reaching_recording, still


@pytest.fixture(scope="module")
def scene():
    return at.live.live_scene(at.read_scene(at.example("live_pinch")))


def followed(scene, hands, path, **settings) -> tuple[at.live.Followed, Session]:
    session = at.live.SessionWriter(path, scene)
    done = at.live.follow(scene, hands, at.live.Distances(scene), session=session, **settings)
    return done, read_session(path)


def recorded(frames) -> at.live.RecordedHands:
    return at.live.RecordedHands(Recording(tuple(frames), StreamHealth()))


def test_the_example_is_what_it_is_said_to_be():
    frames = load_recording(at.example("reaching.jsonl")).frames
    assert at.example("reaching.jsonl").stat().st_size < 300_000
    for frame, made in zip(frames[::40], reaching_recording()[::40], strict=True):
        assert frame.time == pytest.approx(made.time)
        np.testing.assert_allclose(frame.landmarks, made.landmarks, atol=2e-6)


def test_sound_follows_a_recording_and_ends_with_it_in_silence(scene, tmp_path):
    frames = reaching_recording()[:90]
    done, session = followed(scene, recorded(frames), tmp_path / "session.h5")
    assert done.frames >= 5
    np.testing.assert_allclose(session.frame_time, [frame.time for frame in frames])
    np.testing.assert_allclose(session.landmarks, [frame.landmarks for frame in frames], atol=1e-12)
    assert session.amplitudes.shape == (done.drives, 996)
    assert np.abs(session.amplitudes).max() == pytest.approx(1.0, abs=1e-6)
    assert not session.amplitudes[-1].any()
    assert session.states[-1] == "silent"
    assert (np.diff(session.time_in_air) > 0.0).all()
    assert (session.drive_frame_time <= session.time_in_air).all()
    assert set(session.drive_frame_time) <= set(session.frame_time)
    # the drives are those of distances to the foci that were predicted
    index = len(session.states) // 2
    assert session.states[index] in ("playing", "fading")
    drive = at.focus_by_distance(
        scene.array, at.Target(session.foci[index]), scene.medium, scene.frequency
    ).amplitudes
    got = session.amplitudes[index]
    assert abs(np.vdot(got, drive)) == pytest.approx(
        np.linalg.norm(got) * np.linalg.norm(drive), rel=1e-6
    )


def test_a_session_says_what_its_scene_was(scene, tmp_path):
    done, session = followed(
        scene, recorded(reaching_recording()[:10]), tmp_path / "session.h5", seconds=0.2
    )
    assert done.seconds > 0.0
    np.testing.assert_array_equal(session.scene.array.positions, scene.array.positions)
    assert session.scene.array.element.same_as(scene.array.element)
    assert session.scene.places == scene.places == ("thumb.pad", "index.pad")
    assert session.scene.modulation == scene.modulation
    assert session.scene.medium == scene.medium


def test_a_hand_that_is_lost_fades_and_rises_again(scene, tmp_path):
    frames = reaching_recording()[:80]
    gap = [frame for frame in frames if not 25 <= frame.sequence < 55]  # nothing for half a second
    done, session = followed(scene, recorded(gap), tmp_path / "session.h5")
    assert set(done.faded) <= {"stale", "lost"}  # the loop notices, or the prediction
    loud = np.abs(session.amplitudes).max(axis=1) > 0.0
    last = frames[24].time
    zero = session.time_in_air[np.flatnonzero(~loud & (session.time_in_air > last))[0]]
    assert last < zero < frames[55].time + 0.5
    assert loud[session.time_in_air > frames[55].time + 0.1].any()


def test_a_frame_without_a_hand_fades_at_once(scene, tmp_path):
    frames = [still(index, index / 60) for index in range(20)]
    frames += [still(index, index / 60, landmarks=None) for index in range(20, 40)]
    done, session = followed(scene, recorded(frames), tmp_path / "session.h5")
    assert set(done.faded) == {"lost"}
    assert np.isnan(session.landmarks[20:]).all()


def test_frames_of_the_other_hand_are_left_alone(scene, tmp_path):
    mirror = np.array([1.0, 1.0, -1.0])
    frames = [
        still(index, index / 60, side="right", landmarks=still(0).landmarks * mirror)
        for index in range(20)
    ]
    done, session = followed(scene, recorded(frames), tmp_path / "session.h5", seconds=0.8)
    assert done.drives == done.frames == 0
    assert "waiting for the left hand" in done.state
    assert len(session.frame_time) == 0


@pytest.mark.parametrize(
    ("shift", "reason"),
    [
        ((0.19, 0.0, 0.0), "through the array's face"),
        ((0.30, 0.0, 0.0), "left the workspace"),
        ((-0.60, 0.0, 0.0), "left the workspace"),
    ],
)
def test_a_hand_where_no_sound_may_be_gets_none(scene, tmp_path, shift, reason):
    frames = [
        still(index, index / 60, landmarks=still(0).landmarks + np.array(shift))
        for index in range(20)
    ]
    done, _ = followed(scene, recorded(frames), tmp_path / "session.h5", seconds=0.8)
    assert done.drives == 0
    assert reason in done.state


def test_the_clock_of_the_frames_is_found():
    from airtact.live.sources import FrameClock

    clock = FrameClock(latency=0.01)
    for index in range(10):
        clock.saw(7.0 + index / 60, 100.0 + index / 60 + 0.02 * (index % 3))
    assert clock.time(101.0) == pytest.approx(8.01, abs=1e-3)
    now = time.monotonic()
    shared = FrameClock()
    shared.saw(now - 0.015, now)
    before, found, after = time.monotonic(), shared.time(), time.monotonic()
    assert before - 2e-3 <= found <= after + 2e-3


class Kept(at.live.Output):
    """Keeps what is sent, and presses the emergency stop itself after so many drives."""

    def __init__(self, most: int) -> None:
        self.sent, self.most = [], most

    def send(self, amplitudes) -> None:
        self.sent.append(amplitudes)
        if len(self.sent) == self.most:
            self.stop()

    def cycle(self, frames, rate) -> None:
        self.send(frames[0])

    def beat(self) -> None:
        pass


def test_the_emergency_stop_ends_the_sound_for_good(scene, tmp_path):
    output = Kept(5)
    done, session = followed(
        scene, recorded(reaching_recording()), tmp_path / "s.h5", output=output, seconds=1.5
    )
    assert done.stopped
    assert len(output.sent) == 5
    assert "stopped" in done.state
    assert session.states[-1] == "stopped"
    assert not session.amplitudes[-1].any()


def test_a_session_is_verified_against_the_hand_that_was_there(scene, tmp_path):
    frames = [at.hands.HandFrame(index / 60, "left", index, scene_rest()) for index in range(80)]
    _, session = followed(scene, recorded(frames), tmp_path / "s.h5")
    found = at.live.verify_session(session, every=10_000, accuracy=0.1)
    assert len(found.kept) == 1
    assert 0.3 < found.median <= 1.05
    assert found.rules == ("distances",)


def test_frames_that_come_before_the_loop_begins_are_not_lost():
    hands, came = at.live.ReceivedHands("websocket", 0), []
    frames = reaching_recording()[:6]
    for frame in frames[:5]:
        hands._stream.feed(frame)
    stream = hands.begin(lambda frame, arrived: came.append((frame.sequence, arrived)))
    stream.feed(frames[5])
    hands.close()
    assert [sequence for sequence, _ in came] == list(range(6))
    assert all(one <= other for (_, one), (_, other) in pairwise(came))


class Slow(at.live.Output):
    """A link that takes 15 ms a drive."""

    def send(self, amplitudes) -> None:
        time.sleep(0.015)


class Behind(at.live.Distances):
    """Drives as from a solver that solved the hand of 140 ms ago last."""

    def make(self, time, controls):
        return replace(super().make(time, controls), behind=0.14)


@pytest.mark.parametrize(
    ("maker", "settings", "late", "least", "words"),
    [
        (at.live.Distances, {"output": Slow()}, "link", 0.015, r"late: .*link \d+ ms a drive"),
        (at.live.Distances, {"latency": 0.08}, "frames", 0.08, r"late: .*frames \d+ ms old"),
        (Behind, {}, "solver", 0.14, r"late: .*solver 140 ms behind"),
    ],
)
def test_the_status_names_what_is_late(scene, maker, settings, late, least, words):
    said = []
    hands = recorded(reaching_recording()[:60])
    at.live.follow(scene, hands, maker(scene), report=said.append, seconds=3.0, **settings)
    playing = next(one for one in said if one.rate)
    assert playing.late[late] >= least
    assert re.search(words, str(playing))


def test_a_status_without_anything_late_says_so():
    status = at.live.Status("playing", 120.0, 0.012, 0.93, {})
    assert "nothing late" in str(status)
    assert len(str(status)) < 80, "a terminal of 80 columns cuts it"
    assert "late" not in str(at.live.Status("lost", 0.0, np.nan, np.nan, {}))


def scene_rest():
    return at.load_hand(at.example("pinch.json"), 0.012).joints


def test_the_emergency_stop_counts_before_the_link_is_open():
    boards = at.live.Boards(at.emission.RecordingLink())
    boards.stop()
    assert boards.stopped
