"""The live loop on a virtual clock: sound follows, fades and rises, and what is not safe is silent."""

import json
import signal
import subprocess
import sys
import time
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import airtact as at
from airtact.hands.tracking.clock import FrameClock
from airtact.live.loop import MIN_INTERVAL
from airtact.live.safety import FADE, MAX_FRAME_AGE, Gain
from live.live_scenes import Kept, Scheduled, distances
from references.motions import JOINTS, reaching_recording, still


def followed(scene, clock, frames, output=None, maker=distances, due=None, **settings):
    output = output or Kept(clock)
    hands = Scheduled(clock, frames, due)
    done = at.live.follow(scene, hands, maker(scene), output=output, **settings)
    return done, output


def loudness(output: Kept) -> np.ndarray:
    return np.abs(output.sent).max(axis=1)


def test_drives_are_made_for_the_time_at_which_boards_play_them(example_scene, clock, tmp_path):
    """Boards that take times play 9 of 10 drives at the time for which the hand was predicted."""
    predicted, wanted = [], []

    class Timed(Kept):
        lead = 0.05

        def send(self, amplitudes, at=None) -> None:
            wanted.append(predicted[-1])
            super().send(amplitudes, at)

    output = Timed(clock, seconds=0.004)
    maker = distances(example_scene)
    made = maker.make
    maker.make = lambda time, controls: predicted.append(time) or made(time, controls)
    writer = at.live.SessionWriter(tmp_path / "session.h5", example_scene)
    frames = reaching_recording()[:30]
    followed(example_scene, clock, frames, output, lambda scene: maker, session=writer)
    playing = [state == "playing" for state in at.live.read_session(tmp_path).states]
    asked = np.array(output.asked, dtype=float)[playing]
    assert np.ptp(asked - np.array(wanted)[playing]) < 1e-9
    ahead = asked - np.array(output.times)[playing]
    assert (ahead[5:] > -1e-9).mean() > 0.85
    assert ahead.max() < 0.05


def test_sound_follows_a_hand_and_the_session_holds_what_was_done(example_scene, clock, tmp_path):
    scene, frames = example_scene, reaching_recording()[:60]
    writer = at.live.SessionWriter(tmp_path / "session.h5", scene)
    done, output = followed(scene, clock, frames, session=writer)
    session = at.live.read_session(tmp_path)
    assert done.frames == 60
    assert 60 <= done.rate <= 121
    np.testing.assert_allclose(session.frame_time, [frame.time for frame in frames])
    np.testing.assert_allclose(session.landmarks, [frame.landmarks for frame in frames], atol=1e-6)
    error = np.abs(session.amplitudes - output.sent).max(axis=1)
    assert (error <= 0.095 * loudness(output)).all()  # steps of 1/7.5 at most
    assert np.abs(session.amplitudes).max() == pytest.approx(1.0, abs=0.095)
    assert not session.amplitudes[-1].any()
    assert session.states[-1] == "silent"
    assert (np.diff(session.time_in_air) > 0.0).all()
    assert (session.drive_frame_time <= session.time_in_air).all()
    assert set(session.drive_frame_time) <= set(session.frame_time)
    # The drives are those of distances to the predicted foci.
    index = len(session.states) // 2
    foci = at.Target(session.foci[index])
    empty = at.Scene(scene.medium, [], frequency=scene.frequency)
    transfer = at.open_air_matrix(empty, scene.array, foci)
    drive = at.weighted_gerchberg_saxton(transfer, foci).amplitudes
    sent = session.amplitudes[index]
    norms = np.linalg.norm(sent) * np.linalg.norm(drive)
    assert abs(np.vdot(sent, drive)) == pytest.approx(norms, rel=3e-3)
    np.testing.assert_array_equal(session.scene.array.positions, scene.array.positions)
    assert session.scene.array.element.same_as(scene.array.element)
    assert session.scene.places == scene.places == ("thumb.pad", "index.pad")
    assert session.scene.modulation == scene.modulation
    assert session.scene.medium == scene.medium


@pytest.mark.parametrize("begun", [0.98, 7.0], ids=["this clock", "other clock"])
@pytest.mark.parametrize(("pace", "ahead"), [(0.9, 0.0), (1.0, 0.1)], ids=["slow", "ahead once"])
def test_on_a_busy_computer_no_sound_is_where_the_hand_was_not(
    example_scene, clock, begun, pace, ahead
):
    """Frames wait while the computer pauses, and so does a drive that is being computed."""
    frames = reaching_recording()[:80]
    taken = np.arange(80) / 60
    tips = np.array([frame.landmarks[[4, 9]].mean(axis=0) for frame in frames])
    foci = []
    distances_to_hand = []

    def resumed(now: float) -> float:
        return next((end for start, end in [(0.5, 0.6), (0.8, 1.1)] if start <= now < end), now)

    class Pausing(at.live.HandAware):
        def make(self, time, controls):
            moment = super().make(time, controls)
            if moment.foci is not None:
                foci[:] = moment.foci.mean(axis=0)
            clock.now = 1.0 + resumed(clock.now - 0.998)
            return moment

    class Compared(Kept):
        def send(self, amplitudes, at=None) -> None:
            recent = tips[(taken > clock.now - 1.3) & (taken <= clock.now - 1.0)]
            if amplitudes.any() and clock.now < 1.0 + taken[-1]:
                distance = np.linalg.norm(recent - foci, axis=1).min(initial=np.inf)
                distances_to_hand.append(distance)
            super().send(amplitudes, at)

    times = begun + pace * taken
    times[40] += ahead
    sent = [replace(frame, time=time) for frame, time in zip(frames, times.tolist(), strict=True)]
    due = [resumed(time) for time in taken.tolist()]
    maker = lambda scene: Pausing(scene, solvers=[])  # noqa: E731
    followed(example_scene, clock, sent, Compared(clock), maker, due)
    assert len(distances_to_hand) > 20
    assert max(distances_to_hand) < 0.02


def test_a_hand_that_is_not_seen_fades_in_time_and_rises_again(example_scene, clock):
    frames = [frame for frame in reaching_recording()[:80] if not 25 <= frame.sequence < 55]
    begun = clock.now
    done, output = followed(example_scene, clock, frames)
    loud = loudness(output) > 0.0
    times = np.array(output.times) - begun
    last, back = frames[24].time, frames[25].time
    silent = times[~loud & (times > last)][0]
    assert sum(done.faded.values()) == 2  # in the gap, and at the end
    assert last + MAX_FRAME_AGE < silent < last + MAX_FRAME_AGE + FADE + 0.02
    assert loud[(times > back + 0.02) & (times < frames[-1].time)].all()
    # The drives of the fade are paced like all others.
    fading = times[(times > last + MAX_FRAME_AGE) & (times <= silent)]
    assert len(fading) > 3
    assert np.diff(fading).min() > 0.99 * MIN_INTERVAL


class Interrupting:
    """Ctrl-C while this object is deleted, where Python drops the exception."""

    def __del__(self) -> None:
        signal.raise_signal(signal.SIGINT)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_ctrl_c_ends_the_loop_even_where_python_drops_the_exception(example_scene, clock):
    class Deleting(Kept):
        def send(self, amplitudes, at=None) -> None:
            if len(self.sent) == 30:
                Interrupting()
            super().send(amplitudes, at)

    handler = signal.getsignal(signal.SIGINT)
    done, output = followed(example_scene, clock, reaching_recording(), Deleting(clock))
    assert done.seconds < 1.0
    assert not loudness(output)[-1]
    assert signal.getsignal(signal.SIGINT) is handler


def test_a_pause_is_not_a_busy_loop(example_scene, clock):
    frames = [still(index, index / 60) for index in range(20)]
    paused = at.live.Controls(playing=False)
    output = Kept(clock)
    beats = []
    output.beat = lambda: beats.append(clock.now)
    done, _ = followed(example_scene, clock, frames, output, controls=paused, seconds=0.5)
    assert done.drives == 0
    assert len(beats) < 60


def test_a_frame_without_a_hand_fades_at_once(example_scene, clock):
    frames = [still(index, index / 60) for index in range(20)]
    frames += [still(index, index / 60, landmarks=None) for index in range(20, 40)]
    begun = clock.now
    done, output = followed(example_scene, clock, frames)
    assert set(done.faded) == {"lost"}
    assert output.times[-1] - begun < frames[20].time + FADE + 0.02
    assert not output.sent[-1].any()


@pytest.mark.parametrize(
    ("shift", "reason"),
    [
        ((0.19, 0.0, 0.0), "through the array's face"),
        ((0.30, 0.0, 0.0), "left the workspace"),
        ((-0.60, 0.0, 0.0), "left the workspace"),
        (None, "waiting for the left hand"),
    ],
)
def test_a_hand_where_no_sound_may_be_or_the_other_one_gets_none(
    example_scene, clock, shift, reason
):
    joints, side = still(0).landmarks, "left"
    if shift is None:
        joints, side = joints * [1.0, 1.0, -1.0], "right"
    else:
        joints = joints + shift
    frames = [still(index, index / 60, side=side, landmarks=joints) for index in range(20)]
    done, output = followed(example_scene, clock, frames)
    assert done.drives == len(output.sent) == 0
    assert reason in done.state


def test_the_cap_limits_every_element(example_scene, clock):
    _, output = followed(example_scene, clock, reaching_recording()[:30], cap=0.25)
    assert loudness(output).max() == pytest.approx(0.25)


def test_without_a_cap_a_head_gets_110_db_at_most(example_scene, clock):
    output = Kept(clock)
    output.levels = at.transducers.Levels.even()
    followed(example_scene, clock, reaching_recording()[:30], output)
    loudest = output.sent[int(loudness(output).argmax())][None]
    scene = example_scene
    wavenumber = scene.wavenumber.real
    head = at.drives.HeadLevel(loudest, scene.array.positions, output.levels, wavenumber)
    assert 106.0 < head.full < 112.0


def test_the_emergency_stop_ends_the_sound_for_good(example_scene, clock, tmp_path):
    session = at.live.SessionWriter(tmp_path / "session.h5", example_scene)
    output = Kept(clock, stop_after=5)
    frames = reaching_recording()[:60]
    done, _ = followed(example_scene, clock, frames, output, session=session, seconds=0.8)
    assert done.stopped
    assert len(output.sent) == 5
    assert "stopped" in done.state
    session = at.live.read_session(tmp_path)
    assert session.states[-1] == "stopped"
    assert not session.amplitudes[-1].any()


def test_the_emergency_stop_counts_before_the_link_is_open():
    boards = at.live.Output(at.emission.RecordingLink())
    boards.stop()
    assert boards.stopped


def test_a_drive_rises_and_falls_at_one_rate_also_after_a_long_silence() -> None:
    gain = Gain()
    gain.advance(0.0, True)
    for begun in (0.0, 100.0):
        rising = [gain.advance(begun + now, True) for now in np.arange(0.01, FADE + 0.02, 0.01)]
        assert rising[0] <= 0.03 / FADE
        assert max(np.diff(rising)) <= 0.01 / FADE + 1e-9
        assert rising[-1] == 1.0
        assert gain.advance(begun + 0.2, False) == 0.0


def test_the_clock_of_the_frames_is_found():
    clock = FrameClock(latency=0.01)
    for index in range(10):
        clock.saw(7.0 + index / 60, 100.0 + index / 60 + 0.02 * (index % 3))
    assert clock.time(101.0) == pytest.approx(8.01, abs=1e-3)


def test_a_clock_of_this_computer_is_recognised():
    shared = FrameClock()
    shared.saw(50.0 - 0.015, 50.0)
    assert shared.time(49.5) == 49.5
    shared.saw(60.1, 60.0)  # a frame of the future: it is another clock after all
    assert shared.time(60.0) >= 60.1


def test_frames_that_come_before_the_loop_begins_are_not_lost():
    hands, came = at.live.HandSource("frames"), []
    frames = reaching_recording()[:6]
    for frame in frames[:5]:
        hands.stream.feed(frame)
    stream = hands.begin(lambda frame, arrived: came.append((frame.sequence, arrived)))
    stream.feed(frames[5])
    hands.close()
    assert [sequence for sequence, _ in came] == list(range(6))
    assert all(first <= second for (_, first), (_, second) in pairwise(came))


def test_a_recording_in_a_loop_goes_on_with_later_frames():
    recording = at.hands.load_recording(at.example("reaching.jsonl"))
    repeated = at.live.RecordedHands(recording, loop=True)._repeated()
    frames = [next(repeated) for _ in range(2 * len(recording.frames))]
    assert (np.diff([frame.time for frame in frames]) > 0.0).all()
    assert (np.diff([frame.sequence for frame in frames]) == 1).all()


def test_a_session_that_is_still_being_closed_is_waited_for(example_scene, clock, tmp_path):
    """The process that writes it locks the file, and may end after the loop."""
    path = tmp_path / "session.h5"
    writer = at.live.SessionWriter(path, example_scene)
    followed(example_scene, clock, reaching_recording()[:20], session=writer)
    held = f"import h5py, time; f = h5py.File({str(path)!r}, 'a'); print(flush=True); time.sleep(1)"
    with subprocess.Popen([sys.executable, "-c", held], stdout=subprocess.PIPE) as holder:
        assert holder.stdout
        holder.stdout.readline()
        assert len(at.live.read_session(path).time_in_air)


class Watched(at.live.HandAware):
    """Keeps when each drive was made and where its foci were."""

    def __init__(self, scene, clock):
        super().__init__(scene, solvers=[])
        self.clock, self.made = clock, []

    def make(self, time, controls):
        moment = super().make(time, controls)
        self.made.append((self.clock.now, moment))
        return moment


def odd(frame, kind):
    """A frame of a tracker whose clock or hand is wrong from the 30th on."""
    time, number, after = frame.time, frame.sequence, frame.sequence >= 30
    if kind == "an outlier" and number == 30:
        return replace(frame, landmarks=frame.landmarks + [-0.3, 0.0, 0.0])
    if kind == "an hour ahead once":
        return replace(frame, time=time + 3600.0 * (number == 30))
    if kind == "restart from 0":
        return replace(frame, time=time + 1e3 * (not after), sequence=number - 30 * after)
    if kind == "an hour on":
        return replace(frame, time=time + 3600.0 * after)
    return replace(frame, time=time * {"ms": 1e3, "ns": 1e9}.get(kind, 1.0))


@pytest.mark.parametrize(
    ("kind", "counted", "silences"),
    [
        ("an hour ahead once", {"time_leap": 1}, 1),
        ("an outlier", {"too_fast": 1}, 1),
        ("restart from 0", {"out_of_order": 18, "restarted": 1}, 2),
        ("an hour on", {"time_leap": 18, "restarted": 1}, 2),
        ("ms", {"time_leap": 17, "restarted": 1, "converted": 72}, 1),
        pytest.param(
            "ns", {"time_leap": 17, "restarted": 1, "converted": 72}, 1, marks=pytest.mark.slow
        ),
    ],
)
def test_odd_times_and_places_never_leave_the_sound_behind(
    example_scene, clock, kind, counted, silences
):
    frames = reaching_recording()[:90]
    begun = clock.now
    maker = Watched(example_scene, clock)
    done, output = followed(
        example_scene,
        clock,
        [odd(frame, kind) for frame in frames],
        maker=lambda scene: maker,
        due=[frame.time for frame in frames],
    )
    for name, count in counted.items():
        assert getattr(done.health, name) == count, name
    ages = [moment.time - moment.frame_time for _, moment in maker.made]
    assert min(ages) > -1e-6  # no frame of the future
    off = []
    for now, moment in maker.made:
        if moment.foci is not None and now < begun + 1.5:
            pads = frames[int((now - begun) * 60.0 + 1e-6)].hand().pads[:2]
            off.append(np.linalg.norm(moment.foci.mean(axis=0) - pads.mean(axis=0)))
    assert np.median(off) < 2e-3
    assert max(off) < 10e-3  # while the frames are rejected the hand is extrapolated
    loud = loudness(output)[np.array(output.times) > begun + 1.2]
    assert loud[0] == pytest.approx(1.0)
    assert (loudness(output)[1:] == 0.0).sum() == silences


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"side": "right"}, "mirrored"),
        ({"landmarks": (1e3 * JOINTS).tolist()}, "not in metres"),
        ({"landmarks": (2.5 * JOINTS).tolist()}, "not in metres"),
        ({"landmarks": [None] * 25}, "half lost"),
        ({"landmarks": JOINTS[:20].tolist()}, "unknown count"),
        ({"landmarks": (JOINTS[::-1]).tolist()}, "impossible"),
        ({"side": "both"}, "unreadable"),
        ({"time": None}, "unreadable"),
    ],
)
def test_why_frames_are_rejected_is_told_within_a_second(example_scene, clock, changed, words):
    hands = Scheduled(clock, [still(0)], due=[10.0])
    message = json.loads(at.hands.to_json(still(0)))
    for number in range(43):
        hands.stream.feed_json(json.dumps(message | {"sequence": number} | changed))
    told = []
    output = Kept(clock)
    at.live.follow(
        example_scene,
        hands,
        distances(example_scene),
        output=output,
        seconds=0.52,
        report=told.append,
    )
    assert told[0].state == f"waiting for a hand; 43 frames rejected: {words}"
    assert not np.any(output.sent)


def test_a_second_tracker_is_told_while_the_first_one_plays(example_scene, clock):
    frames = reaching_recording()[:90]
    hands = Scheduled(clock, frames)
    told = []

    def report(status):
        told.append(status.state)
        hands.stream.feed(still(len(told)), "second")

    at.live.follow(example_scene, hands, distances(example_scene), report=report)
    assert told[0] == "playing"
    assert told[1] == "playing; 1 frame rejected: second tracker"


def test_a_tracker_that_sends_nothing_is_asked_for(monkeypatch):
    hands = at.live.ReceivedHands(0)
    try:
        assert hands.remark() == ""
        now = time.monotonic()
        monkeypatch.setattr(hands.stream, "_clock", lambda: now + 6.0)
        port = hands.words.rpartition(":")[2]
        assert hands.remark() == f"no frames at port {port}; is the tracker's program running?"
        hands.stream.feed_json("rubbish")
        assert hands.remark() == ""
    finally:
        hands.close()


def test_the_cap_holds_at_the_boards(example_setup):
    link = at.emission.RecordingLink()
    with at.live.Output(link) as output:
        output.limit(0.3)
        output._emission.send(at.Drive(-0.9 * np.ones(249, dtype=np.complex128)))
    loudest = max(float(frame.levels.amplitudes[frame.amplitude.max()]) for frame in link.frames)
    assert loudest == pytest.approx(0.3, abs=2e-3)


@pytest.mark.parametrize(
    "wrong",
    [
        {"cap": -1.0},
        {"cap": np.nan},
        {"offset": 1.0},
        {"method": "__class__"},
        {"method": "robust"},
    ],
)
def test_settings_are_checked(wrong):
    with pytest.raises(at.InvalidInput):
        at.live.Controls(**wrong)
