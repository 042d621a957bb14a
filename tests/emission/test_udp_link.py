"""AUTD3 boards on UDP: what the makers' recorder and their emulated firmware get, over real sockets."""

import importlib.metadata
import sys
import time
from contextlib import suppress

import autd3
import autd3_emulator
import numpy as np
import pytest

import airtact as at
from airtact.emission.link import LinkFailed
from airtact.emission.udp_link import UDPLink
from airtact.transducers.layout import board_array
from emission.sounds import tone
from emission.test_autd3_link import random_frame, random_poses
from faults import raises_code
from references.udp_boards import ACTIVATE, PATTERN, UDPBoards

SINGLE = [at.Pose.identity()]


@pytest.fixture
def boards():
    boards = UDPBoards(4)
    yield boards
    boards.close()


@pytest.fixture
def link(boards):
    link = UDPLink(random_poses(4), boards.address)
    link.open()
    yield link
    # On a busy machine the boards, which are a thread of this process, may not reply in time.
    try:
        link.close()
    except LinkFailed as fault:
        if getattr(fault.__cause__, "code", None) != link._sdk.Autd3Error.TIMEOUT:
            raise


def differ(boards: UDPBoards, frame: at.drives.Frame, index: int = 0) -> int:
    return np.count_nonzero(boards.playing(index) != np.stack([frame.phase, frame.amplitude]))


def test_our_layout_is_that_of_the_makers(link) -> None:
    """Four boards at random poses; autd3 computes in single precision."""
    table = autd3_emulator.Emulator(link._geometry).transducer_table()
    array = board_array("autd3", link.poses)
    theirs = table.select("x[mm]", "y[mm]", "z[mm]").to_numpy()
    assert np.abs(theirs - 1e3 * array.positions).max() < 1e-4
    looks = table.select("nx", "ny", "nz").to_numpy()
    np.testing.assert_allclose(looks, array.normals, rtol=0, atol=1e-6)


def test_every_byte_reaches_the_recorder_and_the_boards(boards, link) -> None:
    for seed in range(5):
        frame = random_frame(996, seed)

        def play(recorder, frame=frame) -> None:
            recorder.send(autd3.commands.SetSilencer.disable())
            recorder.send(link._pattern(frame))
            recorder.tick(autd3.Duration.from_micros(100))

        record = autd3_emulator.Emulator(link._geometry).record(play)
        assert not np.any(record.phase()[:, -1].to_numpy() != frame.phase)
        # Pulses of w of 512 ticks have the first harmonic sin(πw/512).
        widths = np.rint(512 / np.pi * np.arcsin(frame.amplitude / 255))
        assert not np.any(record.pulse_width()[:, -1].to_numpy() != widths)
        link.send(frame)
        assert differ(boards, frame) == 0


@pytest.mark.parametrize("rate", [100.0, 4000.0, 40_000 / 3])
def test_a_sequence_lies_in_the_boards_frame_by_frame(boards, link, rate: float) -> None:
    frames = [random_frame(996, seed) for seed in range(7)]
    link.play(frames, rate)
    assert [differ(boards, frame, index) for index, frame in enumerate(frames)] == 7 * [0]
    link.send(frames[0])
    assert differ(boards, frames[0]) == 0
    link.stop()
    assert boards.loudest == 0


def test_a_modulation_goes_on_while_drives_change(boards, link) -> None:
    link.modulate(np.linspace(0.0, 1.0, 20), 4000.0)
    before = len(boards.commands)
    for seed in range(3):
        link.send(random_frame(996, seed))
    link.modulate(np.linspace(0.0, 1.0, 40), 400.0)
    link.send(random_frame(996))
    link.modulate(None, 0.0)
    link.send(random_frame(996))
    commands = [command for command, _, _ in boards.commands[before:]]
    assert commands.count(PATTERN) == 5
    assert commands.count(0x22) == 3  # a modulation begins


def test_a_frame_that_is_sent_ahead_acts_at_its_time(boards, link) -> None:
    """Within 25 µs by the library's estimate of the boards' clock, which is as good as the relay is quick."""
    frame = random_frame(996)
    for _ in range(50):
        link.send(frame)
    asked, offsets = [], []
    for ahead in np.linspace(2e-3, 48e-3, 24):
        before = time.monotonic_ns()
        device_time = link._client.device_time_now().sys_time
        offsets.append(device_time - 0.5 * (before + time.monotonic_ns()))
        asked.append(time.monotonic() + ahead)
        link.send(frame, at=asked[-1])
    link.send(frame)
    acts = [at for command, _, at in boards.commands if command == PATTERN and at > 0]
    error = 1e-6 * np.array(acts) - asked - 1e-9 * np.array(offsets)
    # The process may be interrupted between the readings of the clocks here.
    assert np.percentile(np.abs(error), 75) < 25e-6
    clocks = np.array([clock[1:] for clock in boards.clocks if clock[0] == 0])
    true = 1e-9 * clocks[:, 2] - clocks[:, :2].T
    assert true[1].max() - 1e-3 < 1e-9 * np.median(offsets) < true[0].min() + 1e-3


def test_emission_sends_ahead_only_without_a_ramp(boards) -> None:
    link = UDPLink(random_poses(4), boards.address)
    with at.Emission(link, cap=1.0, ramp=0.05) as emission:
        emission.send(tone(996), wait=False, at=time.monotonic() + 0.02)
        emission.hold(0.2)
        emission.send(tone(996), at=time.monotonic() + 0.02)
        with raises_code("out_of_range"):
            emission.send(tone(996), at=time.monotonic() + 0.2)
    timed = [at > 0 for command, _, at in boards.commands if command == PATTERN]
    assert timed.count(True) == 1
    assert boards.loudest == 0


def test_lost_messages_are_sent_again(boards, link) -> None:
    for seed, count in enumerate((1, 2, 5, 9)):
        boards.lose = count
        link.send(random_frame(996, seed))
        assert differ(boards, random_frame(996, seed)) == 0


@pytest.mark.parametrize("lost", [(0,), (2,), (0, 1, 2, 3)])
def test_a_lost_board_is_reported_and_can_be_opened_again(boards, lost) -> None:
    link = UDPLink(random_poses(4), boards.address)
    link.open()
    frame = random_frame(996)
    link.send(frame)
    boards.cut = lost
    for call in (lambda: link.send(random_frame(996, 1)), link.probe, link.stop):
        with pytest.raises(LinkFailed):
            call()
    boards.cut = ()
    with pytest.raises(LinkFailed):
        link.stop()
    with suppress(LinkFailed):
        link.close()
    link.open()
    assert boards.loudest == 0
    link.send(frame)
    assert differ(boards, frame) == 0
    link.close()


def test_boards_silence_themselves_and_are_released_only_from_silence(boards, link) -> None:
    """The emulated firmware, too, counts half a second without a message."""
    frame = random_frame(996)
    link.send(frame)
    time.sleep(0.7)
    assert boards.loudest == 0
    for _ in range(2):
        with pytest.raises(LinkFailed, match="silenced itself"):
            link.probe()
        link.send(frame)
        assert boards.loudest == 0
    link.stop()
    link.probe()
    link.send(frame)
    link.probe()
    assert boards.loudest == 255


def test_a_lost_message_does_not_prevent_closing(boards, link) -> None:
    link.send(random_frame(996))
    boards.lose = 1
    link.close()
    assert boards.loudest == 0


def test_an_upload_ends_before_it_plays(boards, link) -> None:
    link.play([random_frame(996, seed) for seed in range(300)], 40_000.0)
    commands = [command for command, _, _ in boards.commands]
    assert commands[-1] == ACTIVATE


@pytest.mark.parametrize(
    ("make", "code"),
    [
        (lambda: UDPLink(129 * SINGLE), "sizes_differ"),
        (lambda: UDPLink(at.Pose.identity()), "wrong_kind"),
        (lambda: UDPLink(SINGLE, "no0").open(), "link_failed"),
        (lambda: UDPLink(SINGLE, "[::1]:x").open(), "link_failed"),
        (lambda: UDPLink(SINGLE, "emulator").send(random_frame(249)), "link_closed"),
    ],
)
@pytest.mark.usefixtures("as_outside_the_tests")
def test_what_cannot_be_is_rejected(make, code: str) -> None:
    with raises_code(code):
        make()


def test_other_numbers_of_boards_are_rejected(boards) -> None:
    with raises_code("link_failed"):
        UDPLink(3 * SINGLE, boards.address).open()


def test_a_missing_library_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "autd3", None)
    with raises_code("extra_missing", "airtact[autd3]"):
        UDPLink(SINGLE, "emulator").open()


def test_an_unknown_version_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.metadata, "version", lambda name: "0.13.1")
    with raises_code("unsupported_version", "0.13.1"):
        UDPLink(SINGLE, "emulator").open()
