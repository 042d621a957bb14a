"""The live loop on real frames: sound follows, fades and rises, and the session holds what was done."""

import time

import numpy as np
import pytest

import airtact as at
from airtact.live.session import Session, read_session
from airtact.tracking.recordings import Recording, load_recording
from airtact.tracking.stream import StreamHealth
from tracking.motions import reaching_recording, still


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
    drive = at.focus_by_distance(scene.array, at.Target(session.foci[index]), scene.medium, scene.frequency).amplitudes
    got = session.amplitudes[index]
    assert abs(np.vdot(got, drive)) == pytest.approx(np.linalg.norm(got) * np.linalg.norm(drive), rel=1e-6)


def test_a_session_says_what_its_scene_was(scene, tmp_path):
    done, session = followed(scene, recorded(reaching_recording()[:10]), tmp_path / "session.h5", seconds=0.2)
    assert done.seconds >= 0.2
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
    frames = [still(index, index / 60, side="right", landmarks=still(0).landmarks * mirror) for index in range(20)]
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
    frames = [still(index, index / 60, landmarks=still(0).landmarks + np.array(shift)) for index in range(20)]
    done, _ = followed(scene, recorded(frames), tmp_path / "session.h5", seconds=0.8)
    assert done.drives == 0
    assert reason in done.state


def test_the_clock_of_the_frames_is_found():
    from airtact.live.clock import FrameClock

    clock = FrameClock(latency=0.01)
    for index in range(10):
        clock.saw(7.0 + index / 60, 100.0 + index / 60 + 0.02 * (index % 3))
    assert clock.time(101.0) == pytest.approx(8.01, abs=1e-3)
    now = time.monotonic()
    shared = FrameClock()
    shared.saw(now - 0.015, now)
    assert shared.time() == pytest.approx(time.monotonic(), abs=2e-3)


class Kept(at.live.Output):
    """Keeps what is sent, and presses the emergency stop itself after so many drives."""

    def __init__(self, most: int) -> None:
        self.sent, self.most = [], most

    def send(self, amplitudes) -> None:
        self.sent.append(amplitudes)
        if len(self.sent) == self.most:
            self.stop()

    def beat(self) -> None:
        pass


def test_the_emergency_stop_ends_the_sound_for_good(scene, tmp_path):
    output = Kept(5)
    done, session = followed(scene, recorded(reaching_recording()), tmp_path / "s.h5", output=output, seconds=1.5)
    assert done.stopped
    assert len(output.sent) == 5
    assert "stopped" in done.state
    assert session.states[-1] == "stopped"
    assert not session.amplitudes[-1].any()


def test_a_session_is_verified_against_the_hand_that_was_there(scene, tmp_path):
    frames = [still(index, index / 60) for index in range(40)]
    frames = [at.tracking.HandFrame(one.time, one.side, one.sequence, scene_rest()) for one in frames]
    _, session = followed(scene, recorded(frames), tmp_path / "s.h5", seconds=0.6)
    found = at.live.verify_session(session, every=10_000, accuracy=0.1)
    assert len(found.kept) == 1
    assert 0.3 < found.median <= 1.05
    assert found.rules == ("distances",)


def scene_rest():
    return at.load_hand(at.example("pinch.json"), 0.012).joints


def test_the_emergency_stop_counts_before_the_link_is_open():
    boards = at.live.Boards(at.emission.RecordingLink())
    boards.stop()
    assert boards.stopped
