"""However an emission ends, the last frame is silence; and it begins softly and never passes its cap."""

import os
import signal
import threading
import time
from contextlib import suppress

import numpy as np
import pytest

import airtact as at
from airtact.drives.sequence import Sequence
from airtact.emission.link import LinkFailed, RecordingLink
from airtact.emission.serial_link import SerialLink
from emission.odd_links import Audit, SignalledLink
from emission.receivers import Nano16, SonicSurface, wired
from emission.sounds import VirtualTime, ended, moving, playing, tone

FEW = 4


# --- how it ends ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_at_any_moment_ends_in_silence(kind) -> None:
    """Real signals to this process, at some moments while frames go out as fast as they can."""
    random = np.random.default_rng(int(kind))
    before = signal.getsignal(kind)
    sounded = 0
    for _ in range(FEW):
        link = RecordingLink()
        strike = threading.Timer(random.uniform(0.0, 0.03), os.kill, (os.getpid(), kind))

        def work(emission, strike=strike) -> None:
            strike.start()
            while True:
                emission.send(tone())

        with pytest.raises(KeyboardInterrupt if kind == signal.SIGINT else SystemExit) as ending:
            playing(link, work)
        assert link.frames[-1].silent
        sounded += ended(link)
        assert kind == signal.SIGINT or ending.value.code == 143
        assert signal.getsignal(kind) is before
    assert sounded  # the others came before the first frame


def test_an_exception_at_any_moment_ends_in_silence() -> None:
    for count in range(FEW):
        link = RecordingLink()

        def work(emission, count=count) -> None:
            for _ in range(count):
                emission.send(tone())
            emission.send(tone())
            raise ZeroDivisionError

        with pytest.raises(ZeroDivisionError):
            playing(link, work)
        assert ended(link)


def test_starving_ends_in_silence() -> None:
    link = RecordingLink()
    with at.Emission(link, cap=1.0, ramp=0.0, patience=0.03) as emission:
        with suppress(LinkFailed):  # a busy machine may starve it here already
            emission.send(tone())
        until = time.monotonic() + 120.0
        while not link.frames[-1].silent and time.monotonic() < until:
            time.sleep(0.005)
        for call in (lambda: emission.send(tone()), lambda: emission.hold(0.1)):
            with pytest.raises(LinkFailed) as over:
                call()
            assert over.value.code == "emission_over"
    assert ended(link)


@pytest.mark.parametrize("resumes", [False, True])
def test_boards_are_silenced_when_no_call_came_for_the_patience(monkeypatch, resumes) -> None:
    clock = VirtualTime(monkeypatch)
    link = RecordingLink()
    player = clock.player(link, patience=0.5, resumes=resumes)
    clock.send(player, tone().amplitudes)
    clock.run(player, 0.4)
    player.beat()
    clock.run(player, 0.6)
    assert [frame.silent for frame in link.frames] == [False, True]
    np.testing.assert_allclose(link.seconds, [0.0, 0.9], atol=2e-3)
    if resumes:
        clock.send(player, tone().amplitudes)
        assert not link.frames[-1].silent
        player.finish("it was stopped")
    with pytest.raises(LinkFailed) as over:
        clock.send(player, tone().amplitudes)
    assert over.value.code == "emission_over"
    assert ended(link)


@pytest.mark.parametrize("resumes", [False, True])
def test_boards_are_silenced_after_a_suspend(monkeypatch, resumes) -> None:
    """The clock of the watchdog stands still meanwhile, and a call of the feeder may come first."""
    clock = VirtualTime(monkeypatch)
    link = RecordingLink()
    player = clock.player(link, patience=0.5, resumes=resumes)
    clock.send(player, tone().amplitudes)
    monkeypatch.setattr("airtact.emission.player.suspended", lambda: 3600.0)
    if resumes:
        player.beat()
    else:
        with pytest.raises(LinkFailed) as over:
            player.beat()
        assert over.value.code == "emission_over"
    assert ended(link)
    assert len(link.frames) == 2


def test_two_signals_in_a_row_end_in_silence() -> None:
    for _ in range(FEW):
        link = RecordingLink()

        def work(emission) -> None:
            emission.send(tone())
            os.kill(os.getpid(), signal.SIGTERM)
            os.kill(os.getpid(), signal.SIGINT)
            while True:
                emission.send(tone())

        with pytest.raises((KeyboardInterrupt, SystemExit)):
            playing(link, work)
        assert ended(link)


def test_a_signal_while_opening_ends_in_silence() -> None:
    link = SignalledLink()
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(SystemExit), at.Emission(link):
        pytest.fail("the block must not begin")
    assert all(frame.silent for frame in link.frames)
    assert signal.getsignal(signal.SIGTERM) is before


def test_leaving_the_block_ends_in_silence_and_nothing_follows() -> None:
    link = RecordingLink()
    emission = at.Emission(link, cap=1.0, ramp=0.0)
    with pytest.raises(LinkFailed):
        emission.send(tone())
    with emission:
        emission.send(tone())
    assert ended(link)
    with pytest.raises(LinkFailed) as over:
        emission.send(tone())
    assert over.value.code == "emission_over"


@pytest.mark.parametrize(
    ("name", "model", "elements"), [("sonicsurface", SonicSurface, 256), ("nano16", Nano16, 12)]
)
def test_a_signal_during_a_sequence_ends_in_silence_on_serial_boards(name, model, elements) -> None:
    strike = threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGTERM))

    def work(emission) -> None:
        strike.start()
        emission.play(Sequence(moving(10, elements), 40.0), seconds=5.0)

    with wired(model()) as wire:
        with pytest.raises(SystemExit):
            playing(SerialLink(wire.port, name), work)
        assert wire.silent()


# --- links that fail ------------------------------------------------------------------------------------------------


def failing(work):
    with pytest.raises(LinkFailed) as failure:
        work()
    return failure.value


def test_a_link_that_fails_says_what_was_last_and_that_boards_may_still_emit() -> None:
    link = Audit()

    def work(emission) -> None:
        emission.send(tone())
        emission.send(tone())
        link.cut()
        failed = failing(lambda: emission.send(tone()))
        assert failed.code == "link_failed"
        assert "2 frames sent had 249 of 249 elements on" in str(failed)

    assert failing(lambda: playing(link, work)).code == "silence_failed"


def test_a_watchdog_that_cannot_silence_is_reported(monkeypatch) -> None:
    clock = VirtualTime(monkeypatch)
    link = Audit()
    player = clock.player(link, patience=0.05)
    clock.send(player, tone().amplitudes)
    link.cut()
    clock.run(player, 0.06)
    assert failing(player.beat).code == "silence_failed"
    failing(player.close)
    link.open()  # restores the cable, so that pyautd3 can free its controller
    link.close()


def test_a_cable_cut_during_play_raises() -> None:
    with wired(SonicSurface(), cut_after=2000) as wire:
        link = SerialLink(wire.port)
        sequence = Sequence(moving(4, 256), 50.0)
        failing(lambda: playing(link, lambda emission: emission.play(sequence, seconds=600.0)))


def test_a_cable_cut_while_boards_play_on_is_noticed() -> None:
    link = Audit()

    def work(emission) -> None:
        emission.send(tone())
        link.cut()
        assert failing(lambda: emission.hold(600.0)).code == "link_failed"

    assert failing(lambda: playing(link, work)).code == "silence_failed"
    with wired(SonicSurface(), cut_after=259 * 3 + 100) as wire:
        link = SerialLink(wire.port)
        failed = failing(
            lambda: playing(link, lambda emission: (emission.send(tone(256)), emission.hold(600.0)))
        )
    assert failed.code == "silence_failed"


def test_a_signal_ends_an_emission_from_another_thread_too() -> None:
    link = RecordingLink()
    errors = []

    def feed(emission) -> None:
        try:
            while True:
                emission.send(tone())
        except LinkFailed as error:
            errors.append(error.code)

    def work(emission) -> None:
        feeder = threading.Thread(target=feed, args=(emission,))
        feeder.start()
        time.sleep(0.05)
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(5.0)
        finally:
            feeder.join(120.0)

    with pytest.raises(SystemExit):
        playing(link, work)
    assert ended(link)
    assert errors == ["emission_over"]


def test_a_process_that_shall_outlive_its_terminal_does() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        link = RecordingLink()
        with at.Emission(link, cap=1.0, ramp=0.0) as emission:
            emission.send(tone())
            os.kill(os.getpid(), signal.SIGHUP)
            emission.send(tone())
    finally:
        signal.signal(signal.SIGHUP, before)
    assert [frame.silent for frame in link.frames] == [False, False, True]
