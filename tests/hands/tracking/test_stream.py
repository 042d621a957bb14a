"""Streams: every kind of bad frame is counted and survived, a lost hand is an event, the newest frame counts."""

import json
from dataclasses import fields

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pythonosc.osc_message_builder import OscMessageBuilder

from airtact.hands.tracking.frame import HandFrame
from airtact.hands.tracking.messages import side_of_osc, to_json, to_osc
from airtact.hands.tracking.stream import FARTHEST, RESTART, HandStream
from faults import raises_code
from references.hand_poses import example
from references.motions import still

JOINTS, _ = example("pinch")


class Clock:
    """A clock that goes when told."""

    def __init__(self):
        self.now = 1000.0

    def __call__(self):
        return self.now


def counted(stream):
    """Counts above zero, those of what was received and used left out."""
    health = stream.health
    counts = {one.name: getattr(health, one.name) for one in fields(health)}
    return {
        name: count for name, count in counts.items() if count and name not in ("received", "used")
    }


def fed(frames, **settings):
    """Feed frames that arrive when they were taken."""
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
    assert stream.health.received - stream.health.used == 0
    assert str(stream.health) == "10 received, 10 used"


@pytest.mark.parametrize(
    ("order", "faults", "newest"),
    [
        ([0, 1, 1, 2, 1], {"repeated": 2}, 2),
        ([0, 1, 4, 5], {"skipped": 2}, 5),
        ([0, 1, 3, 2, 4], {"out_of_order": 1}, 4),
        ([5, 1, 0], {"out_of_order": 2}, 5),
        ([0, FARTHEST + 1], {"restarted": 1}, FARTHEST + 1),
    ],
)
def test_the_order_of_frames_is_watched(order, faults, newest):
    stream = fed(still(index) for index in order)
    assert counted(stream) == faults
    assert stream.latest("left").sequence == newest


def test_time_that_goes_back_is_counted_and_left_out():
    stream = fed([still(0, 0.0), still(1, 0.1), still(2, 0.05), still(3, 0.1), still(4, 0.2)])
    assert counted(stream) == {"backwards": 2, "skipped": 2}
    assert stream.latest("left").sequence == 4


def test_frames_that_are_no_hand_are_counted_by_kind():
    stream = HandStream()
    good = json.loads(to_json(still(0)))
    holes = [None if index < 9 else row for index, row in enumerate(good["landmarks"])]
    for changed in (
        {"landmarks": holes},
        {"landmarks": good["landmarks"][:20]},
        {"landmarks": [[1e3 * x for x in row] for row in good["landmarks"]]},
        {"landmarks": [*good["landmarks"][:24], [0.3, 0.3, 0.3]]},
        {"side": "right"},
        {"side": "both"},
    ):
        assert stream.feed_json(json.dumps(good | changed)) is not None
    assert stream.feed_osc(b"noise").fault == "unreadable"
    kinds = {
        "half_lost": 1,
        "unknown_count": 1,
        "not_metres": 1,
        "impossible": 1,
        "mirrored": 1,
        "unreadable": 2,
    }
    assert counted(stream) == kinds
    assert stream.feed_json(to_json(still(0))) is None
    assert stream.latest("left").sequence == 0
    assert stream.latest("right") is None


def test_late_frames_are_counted_and_used():
    clock = Clock()
    stream = HandStream(patience=0.1, clock=clock)
    for index, delay in enumerate([0.02, 0.03, 0.119, 0.02, 0.13, 0.02]):
        clock.now = 1000.0 + index / 30 * 10 + delay
        stream.feed(still(index, index / 30 * 10))
    assert counted(stream) == {"late": 1}
    assert stream.health.used == 6


def test_a_lost_hand_is_an_event_and_comes_back():
    stream = fed([still(0), still(1, landmarks=None), still(2, landmarks=None), still(3)])
    assert counted(stream) == {"lost": 1}
    events = []
    stream = HandStream()
    for frame in [still(0), still(1, landmarks=None), still(2)]:
        stream.feed(frame)
        events.append(stream.wait(0.0).lost)
    assert events == [False, True, False]


def test_silence_is_a_lost_hand():
    clock = Clock()
    stream = HandStream(silence=0.3, clock=clock)
    stream.feed(still(5))
    assert stream.wait(0.0).sequence == 5
    clock.now += 0.29
    assert stream.wait(0.0) is None
    clock.now += 0.02
    event = stream.wait(0.0)
    assert event.lost
    assert stream.wait(0.0) is None
    assert stream.latest("left").lost
    assert counted(stream) == {"lost": 1}
    stream.feed(still(6))
    assert not stream.latest("left").lost


def test_a_tracker_that_begins_anew_is_followed_at_once_after_a_silence():
    clock = Clock()
    stream = HandStream(clock=clock)
    stream.feed(still(500))
    clock.now += 1.0
    assert stream.latest("left").lost
    stream.feed(still(500))  # what came before is not news
    assert stream.latest("left").lost
    stream.feed(still(0))
    assert stream.latest("left").sequence == 0
    assert counted(stream) == {"lost": 1, "repeated": 1, "restarted": 1}


def test_a_tracker_that_begins_anew_without_a_pause_is_followed_after_some_frames():
    stream = fed([still(500), *(still(index) for index in range(RESTART))])
    assert stream.latest("left").sequence == RESTART - 1
    assert counted(stream)["restarted"] == 1
    stuck = fed([still(500), *[still(3)] * 100])
    assert stuck.latest("left").sequence == 500


def test_one_frame_from_the_far_future_does_not_end_the_stream():
    stream = fed([still(0), still(2**50, 1e9), *(still(index) for index in range(1, 60))])
    assert stream.latest("left").sequence == 59
    assert counted(stream)["restarted"] == 2


def test_a_slow_reader_gets_the_latest_of_each_hand():
    right = JOINTS * [-1, 1, 1]
    stream = HandStream()
    for index in range(50):
        stream.feed(still(index))
        stream.feed(still(index, side="right", landmarks=right))
    given = [stream.wait(0.0) for _ in range(3)]
    assert [(one.side, one.sequence) for one in given[:2]] == [("left", 49), ("right", 49)]
    assert given[2] is None


def test_the_callback_gets_every_frame_that_is_used():
    got = []
    fed([still(0), still(1), still(1), still(2)], on_frame=got.append)
    assert [frame.sequence for frame in got] == [0, 1, 2]


def test_of_messages_that_waited_the_newest_good_one_of_each_hand_is_used():
    right = {"side": "right", "landmarks": JOINTS * [-1, 1, 1]}
    waited = [to_json(still(index)) for index in range(8)]
    waited += [to_json(still(index, **right)) for index in range(3)]
    mirrored = to_json(still(8)).replace(b"left", b"right")
    waited += [b"rubbish", to_json(still(8))[:200], mirrored]
    got = []
    stream = HandStream(patience=10.0, on_frame=got.append)
    stream.feed_waiting(waited)
    assert [(frame.side, frame.sequence) for frame in got] == [("left", 7), ("right", 2)]
    assert stream.health.received == len(waited)
    assert counted(stream) == {"overtaken": 7 + 2, "unreadable": 2, "mirrored": 1}
    stream.feed_waiting([to_json(still(index)) for index in (8, 9, 12)])  # 10 and 11 never came
    assert stream.latest("left").sequence == 12
    assert counted(stream)["skipped"] == 2


def test_of_packets_of_osc_that_waited_the_newest_good_one_of_each_hand_is_used():
    right = {"side": "right", "landmarks": JOINTS * [-1, 1, 1]}
    waited = [to_osc(still(index)) for index in range(8)] + [
        to_osc(still(index, **right)) for index in range(3)
    ]
    waited += [b"noise", to_osc(still(8))[:200], to_osc(still(9)).replace(b",dsh", b",dxh")]
    got = []
    stream = HandStream(patience=10.0, on_frame=got.append)
    stream.feed_waiting_osc(waited)
    assert [(frame.side, frame.sequence) for frame in got] == [("left", 7), ("right", 2)]
    assert stream.health.received == len(waited)
    assert counted(stream) == {"overtaken": 7 + 2, "unreadable": 3}
    stream.feed_waiting_osc([to_osc(still(index)) for index in (8, 9, 12)])  # 10 and 11 never came
    assert counted(stream)["skipped"] == 2


def test_the_side_of_a_packet_is_read_from_its_head():
    for frame in (
        still(3),
        still(3, side="right", landmarks=JOINTS * [-1, 1, 1]),
        HandFrame(1.0, "right", 5),
    ):
        assert side_of_osc(to_osc(frame)) == frame.side
    short = OscMessageBuilder("/airtact/hand")
    for value, kind in ((1.5, "f"), ("right", "s"), (3, "i")):
        short.add_arg(value, kind)
    assert side_of_osc(short.build().dgram) == "right"
    for packet in (
        b"",
        b"noise",
        b"#bundle\0" + bytes(8),
        to_osc(still(3))[:30],
        b"/airtact/hand\0\0\0,ds",
    ):
        assert side_of_osc(packet) is None


def test_every_message_that_waited_is_used_where_it_is_to_be():
    got = []
    stream = HandStream(on_frame=got.append, every=True)
    stream.feed_waiting([to_json(still(index)) for index in range(5)])
    stream.feed_waiting_osc([to_osc(still(index)) for index in range(5, 9)])
    assert [frame.sequence for frame in got] == list(range(9))
    assert "overtaken" not in counted(stream)


@pytest.mark.parametrize("setting", ["patience", "silence"])
def test_waits_must_be_above_zero(setting):
    with raises_code("out_of_range", f"{setting} is -0.1 s"):
        HandStream(**{setting: -0.1})


@given(
    st.lists(
        st.tuples(st.integers(0, 40), st.sampled_from(["good", "json", "osc", "lost", "mirrored"])),
        max_size=60,
    )
)
def test_whatever_comes_all_is_counted_and_the_newest_kept(messages):
    clock = Clock()
    stream = HandStream(clock=clock)
    sent = []
    for place, (index, kind) in enumerate(messages):
        clock.now += 0.01
        if kind == "json":
            stream.feed_json(b"{%d" % index)
        elif kind == "osc":
            stream.feed_osc(to_osc(still(index))[: 4 * index])
        elif kind == "mirrored":
            stream.feed_json(to_json(still(index)).replace(b"left", b"right"))
        else:
            stream.feed(HandFrame(index / 30, "left", index, JOINTS if kind == "good" else None))
            sent.append((index, place))
    health = stream.health
    assert health.received == len([kind for _, kind in messages])
    faults = [one for one in counted(stream) if one not in ("lost", "late", "skipped", "restarted")]
    assert health.received - health.used == sum(getattr(health, one) for one in faults)
    if sent:
        assert stream.latest("left").sequence == max(index for index, _ in sent)
    else:
        assert stream.latest("left") is None
