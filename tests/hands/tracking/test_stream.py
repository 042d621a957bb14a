"""Streams: every kind of bad frame is counted and survived, a lost hand is an event, the newest frame counts."""

import json
import random
from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import airtact as at
from airtact.errors import LONGEST_SENTENCE
from airtact.hands.tracking.clock import FrameClock
from airtact.hands.tracking.stream import MAX_JUMP, MAX_STALE_FRAMES, HandStream
from damage import damaged, seeds
from faults import raises_code
from references.motions import JOINTS, Clock, mirrored, still


@pytest.fixture
def clock():
    return Clock()


def counted(stream):
    """Counts above zero, but of what was received and used."""
    counts = asdict(stream.health)
    return {name: n for name, n in counts.items() if n and name not in ("received", "used")}


def fed(frames, **settings):
    clock = Clock()
    stream = HandStream(clock=clock, **settings)
    for frame in frames:
        clock.now = max(clock.now, 1000.0 + frame.time)
        stream.feed(frame)
    return stream


def test_a_good_stream_has_no_faults():
    stream = fed(still(index) for index in range(10))
    assert counted(stream) == {}
    assert stream.health.used == stream.health.received == 10
    assert str(stream.health) == "10 received, 10 used"


@pytest.mark.parametrize(
    ("order", "faults", "newest"),
    [
        ([0, 1, 1, 2, 1], {"repeated": 2}, 2),
        ([0, 1, 4, 5], {"skipped": 2}, 5),
        ([0, 1, 3, 2, 4], {"out_of_order": 1}, 4),
        ([5, 1, 0], {"out_of_order": 2}, 5),
        ([0, MAX_JUMP + 1], {"restarted": 1}, MAX_JUMP + 1),
    ],
)
def test_the_order_of_frames_is_watched(order, faults, newest):
    stream = fed(still(index) for index in order)
    assert counted(stream) == faults
    assert stream.latest("left").sequence == newest


def test_time_that_goes_back_is_counted_and_left_out():
    times = [*(0.1 * index for index in range(10)), 0.85, 0.9, 1.0]
    stream = fed(still(index, time) for index, time in enumerate(times))
    assert counted(stream) == {"backwards": 2, "skipped": 2}
    assert stream.latest("left").sequence == 12


@pytest.mark.parametrize(("jitter", "most"), [(3e-3, 60), (30e-3, 20)])
def test_frames_whose_times_go_back_again_and_again_are_rejected(jitter, most):
    times = np.arange(60) / 60 + np.random.default_rng(0).normal(0.0, jitter, 60)
    stream = fed(still(index, 5.0 + time) for index, time in enumerate(times))
    assert stream.health.used <= most
    assert jitter > 0.01 or stream.health.used == 60


@pytest.mark.parametrize("begun", [999.98, 7.0])  # by this computer's clock and by another
@pytest.mark.parametrize("pace", [0.5, 0.9, 0.95, 0.999, 1.001, 1.1, 2.0])
def test_a_clock_is_used_while_it_tells_how_old_frames_are(begun, pace):
    """One frame in three is late, and the network pauses for 0.2 s."""
    clock = FrameClock()
    usable = 0
    for index in range(300):
        taken = index / 60
        arrived = 1000.0 + taken + 0.02 * (index % 3)
        if 2.5 <= taken <= 2.7:
            arrived = 1002.7
        clock.saw(begun + pace * taken, arrived)
        if clock.fault is None:
            usable += 1
            age = clock.time(arrived) - begun - pace * taken
            assert abs(age - (arrived - 1000.0 - taken)) < 0.09
    assert (usable > 285) == (abs(pace - 1.0) < 0.01)


@pytest.mark.parametrize("begun", [1000.0, 7.0])
@pytest.mark.parametrize("ahead", [0.1, 0.4, 1.0, 3600.0])
def test_frames_of_the_future_are_left_out(clock, begun, ahead):
    stream = HandStream(clock=clock)
    for index in range(120):
        clock.now = 1000.0 + index / 60
        stream.feed(still(index, begun + index / 60 + ahead * (index in (50, 70, 71))))
    assert counted(stream) == {"time_leap": 3, "skipped": 3}
    assert stream.clock("left").time(clock.now) == pytest.approx(stream.latest("left").time)
    assert stream.clock("left").fault is None


@pytest.mark.parametrize("begun", [1000.0, 7.0])
def test_frames_that_waited_in_a_network_are_old(clock, begun):
    stream = HandStream(clock=clock)
    for index in range(108):
        # None for 0.8 s, then all together.
        clock.now = 1000.0 + (index / 60 if index < 60 else 1.8 + 1e-4 * index)
        stream.feed(still(index, begun + index / 60))
        if index in (61, 80):
            age = stream.clock("left").time(clock.now) - stream.latest("left").time
            assert age == pytest.approx(1.8 - index / 60, abs=0.02)
    assert "restarted" not in counted(stream)


def test_invalid_frames_are_counted_by_kind():
    stream = HandStream(silence=1e6)
    good = json.loads(at.hands.to_json(still(0)))
    points = good["landmarks"]
    for fault, changed in {
        "half_lost": {"landmarks": [None] * 9 + points[9:]},
        "unknown_count": {"landmarks": points[:20]},
        "not_in_metres": {"landmarks": (1e3 * np.array(points)).tolist()},
        "impossible": {"landmarks": [*points[:24], [0.3, 0.3, 0.3]]},
        "mirrored": {"side": "right"},
        "unreadable": {"side": "both"},
    }.items():
        assert stream.feed_json(json.dumps(good | changed)).fault == fault
        assert counted(stream)[fault] == 1
    assert stream.feed_json(at.hands.to_json(still(0))) is None
    assert stream.latest("left").sequence == 0
    assert stream.latest("right") is None


def test_a_lost_hand_is_an_event_and_comes_back(clock):
    stream = HandStream(clock=clock)
    events = []
    for lost in (False, True, True, False):
        index = len(events)
        stream.feed(still(index, landmarks=None) if lost else still(index))
        events.append(stream.wait(0.0).lost)
    assert events == [False, True, True, False]
    assert counted(stream) == {"lost": 1}


def test_silence_is_a_lost_hand(clock):
    stream = HandStream(silence=0.3, clock=clock)
    stream.feed(still(5))
    assert stream.wait(0.0).sequence == 5
    clock.now += 0.29
    assert stream.wait(0.0) is None
    clock.now += 0.02
    assert stream.wait(0.0).lost
    assert stream.wait(0.0) is None
    assert stream.latest("left").lost
    assert counted(stream) == {"lost": 1}
    stream.feed(still(6))
    assert not stream.latest("left").lost


def test_a_tracker_that_restarts_is_followed_at_once_after_a_silence(clock):
    stream = HandStream(clock=clock)
    stream.feed(still(500))
    clock.now += 1.0
    assert stream.latest("left").lost
    stream.feed(still(500))  # repeated, not a restart
    assert stream.latest("left").lost
    for index in range(2):
        stream.feed(still(index))
    assert stream.latest("left").sequence == 1
    assert counted(stream) == {"lost": 1, "repeated": 1, "out_of_order": 1, "restarted": 1}


def test_a_clock_that_stands_still_is_not_a_restart(clock):
    stream = HandStream(clock=clock)
    for index in range(60):
        clock.now += 1 / 30
        stream.feed(still(index, 5.0))
    assert stream.health.used == 1


def test_a_tracker_that_restarts_without_a_pause_is_followed_after_some_frames():
    stream = fed([still(500), *(still(index) for index in range(MAX_STALE_FRAMES))])
    assert stream.latest("left").sequence == MAX_STALE_FRAMES - 1
    assert counted(stream)["restarted"] == 1
    stuck = fed([still(500), *[still(3)] * 100])
    assert stuck.latest("left").sequence == 500


def test_one_frame_from_the_far_future_does_not_end_the_stream():
    stream = fed([still(0), still(2**50, 1e9), *(still(index) for index in range(1, 60))])
    assert stream.latest("left").sequence == 59
    assert counted(stream)["restarted"] == 2


def test_a_slow_reader_gets_the_latest_of_each_hand(clock):
    stream = HandStream(clock=clock)
    for index in range(50):
        stream.feed(still(index))
        stream.feed(mirrored(index))
    newest = [stream.wait(0.0), stream.wait(0.0)]
    assert [(frame.side, frame.sequence) for frame in newest] == [("left", 49), ("right", 49)]
    assert stream.wait(0.0) is None


def test_a_second_tracker_of_a_hand_waits_until_the_first_ends(clock):
    stream = HandStream(clock=clock)
    for index in range(1, 5):
        clock.now += 1 / 30
        assert stream.feed(still(index), "first") is None
        assert stream.feed(still(index + 5000), "second").fault == "second_tracker"
        assert stream.feed(mirrored(index), "second") is None
    stream.disconnect("first", interrupted=False)
    stream.feed(still(5005), "second")  # its clock is another: two frames show that it goes
    assert stream.feed(still(5006), "second") is None
    clock.now += 0.4  # the second one falls silent
    assert stream.feed(still(0, 7e5), "third") is not None
    assert stream.feed(still(1, 7e5 + 0.03), "third") is None
    assert stream.clock("left").time(clock.now) == pytest.approx(stream.latest("left").time)


def test_a_recording_can_be_sent_again_over_a_new_connection(clock):
    stream = HandStream(clock=clock)
    for source in ("first", "second"):
        used = 0
        for index in range(1, 10):
            clock.now += 1 / 60
            used += stream.feed(still(index), source) is None
        assert used >= 7
        stream.disconnect(source, interrupted=False)


def test_a_hand_of_half_or_one_and_a_half_the_size_is_used():
    for size in (0.5, 0.6, 0.75, 1.5):
        assert HandStream().feed(still(0, landmarks=size * JOINTS)) is None
    with pytest.raises(at.InvalidInput):
        still(0, landmarks=2.0 * JOINTS)


def test_times_that_would_overflow_are_unreadable():
    for time in (1e103, 1e308, -1e300):
        message = at.hands.to_json(still(0)).replace(b'"time":0.0', f'"time":{time}'.encode())
        assert HandStream().feed_json(message).fault == "unreadable"


def test_a_silence_must_be_above_zero():
    with raises_code("out_of_range"):
        HandStream(silence=-0.1)


@given(
    st.lists(
        st.tuples(st.integers(0, 40), st.sampled_from(["good", "json", "lost", "mirrored"])),
        max_size=60,
    )
)
def test_all_messages_are_counted_and_the_newest_is_kept(messages):
    clock = Clock()
    stream = HandStream(clock=clock)
    sent = []
    for index, kind in messages:
        clock.now += 0.01
        if kind == "json":
            stream.feed_json(b"{%d" % index)
        elif kind == "mirrored":
            stream.feed_json(at.hands.to_json(still(index)).replace(b"left", b"right"))
        else:
            stream.feed(
                at.hands.HandFrame(index / 90, "left", index, JOINTS if kind == "good" else None)
            )
            sent.append(index)
    health = stream.health
    assert health.received == len(messages)
    faults = counted(stream)
    for event in ("lost", "skipped", "restarted"):
        faults.pop(event, None)
    assert health.received - health.used == sum(faults.values())
    newest = stream.latest("left")
    assert (newest.sequence if newest else None) == max(sent, default=None)


CLOUD = np.random.default_rng(0).normal(scale=0.03, size=(20, 3))


@pytest.mark.parametrize("batch", seeds(60, 1000))
def test_a_damaged_message_is_used_or_counted_and_the_next_frames_are_used(batch):
    for seed in batch:
        draw = random.Random(seed)
        stream = HandStream(silence=1e6)
        frame = draw.choice([still(5), still(5, landmarks=None), still(5, cloud=CLOUD)])
        fault = stream.feed_json(damaged(at.hands.to_json(frame), draw))
        if fault is not None:
            assert str(fault).isprintable()
            assert len(str(fault)) <= LONGEST_SENTENCE
        last = 5 + 2 * MAX_STALE_FRAMES  # the damaged frame may be far ahead
        for index in range(6, last + 1):
            stream.feed(still(index))
        assert stream.latest("left").sequence == last
