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
    assert done.frames >= 60
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
    index = session.states.index("playing") + 5
    drive = at.focus_by_distance(scene.array, at.Target(session.foci[index]), scene.medium, scene.frequency).amplitudes
    got = session.amplitudes[index]
    assert abs(np.vdot(got, drive)) == pytest.approx(np.linalg.norm(got) * np.linalg.norm(drive), rel=1e-6)


def test_a_session_says_what_its_scene_was(scene, tmp_path):
    done, session = followed(scene, recorded(reaching_recording()[:10]), tmp_path / "session.h5", seconds=0.2)
    assert done.seconds == pytest.approx(0.2, abs=0.2)
    np.testing.assert_array_equal(session.scene.array.positions, scene.array.positions)
    assert session.scene.array.element.same_as(scene.array.element)
    assert session.scene.places == scene.places == ("thumb.pad", "index.pad")
    assert session.scene.modulation == scene.modulation
    assert session.scene.medium == scene.medium


def test_a_hand_that_is_lost_fades_and_rises_again(scene, tmp_path):
    frames = reaching_recording()[:80]
    gap = [frame for frame in frames if not 25 <= frame.sequence < 55]  # nothing for half a second
    done, session = followed(scene, recorded(gap), tmp_path / "session.h5")
    assert done.faded == {"stale": 2}
    loud = np.abs(session.amplitudes).max(axis=1) > 0.0
    last = frames[24].time
    zero = session.time_in_air[np.flatnonzero(~loud & (session.time_in_air > last))[0]]
    assert last + 0.15 < zero < last + 0.25 + 0.1  # 0.1 s for a machine that does other things, too
    assert loud[session.time_in_air > frames[55].time + 0.1].any()


def test_a_frame_without_a_hand_fades_at_once(scene, tmp_path):
    frames = [still(index, index / 60) for index in range(20)]
    frames += [still(index, index / 60, landmarks=None) for index in range(20, 40)]
    done, session = followed(scene, recorded(frames), tmp_path / "session.h5")
    assert done.faded == {"lost": 1}
    assert np.isnan(session.landmarks[20:]).all()


def test_frames_of_the_other_hand_are_left_alone(scene, tmp_path):
    mirror = np.array([1.0, 1.0, -1.0])
    frames = [still(index, index / 60, side="right", landmarks=still(0).landmarks * mirror) for index in range(20)]
    states = []
    done, session = followed(scene, recorded(frames), tmp_path / "session.h5", seconds=0.8, report=states.append)
    assert done.drives == done.frames == 0
    assert "waiting for the left hand" in states[0].state
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
    states = []
    done, _ = followed(scene, recorded(frames), tmp_path / "session.h5", seconds=0.8, report=states.append)
    assert done.drives == 0
    assert reason in states[0].state


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
