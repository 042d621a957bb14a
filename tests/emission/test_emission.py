"""However an emission ends, the last frame is silence; and it begins softly and never passes its cap."""

import os
import signal
import threading
import time
from contextlib import suppress

import numpy as np
import pytest

import airtact as at
from emission.odd_links import SignalledLink
from emission.receivers import Nano16, SonicSurface, wired
from emission.sounds import ended, events, moving, playing, tone

FEW = 4


# --- how it ends ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_at_any_moment_ends_in_silence(kind) -> None:
    """Real signals to this process, at some moments while frames go out as fast as they can."""
    random = np.random.default_rng(int(kind))
    before, sounded = signal.getsignal(kind), 0
    for _ in range(FEW):
        link = at.emission.RecordingLink()
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
        link = at.emission.RecordingLink()

        def work(emission, count=count) -> None:
            for _ in range(count):
                emission.send(tone())
            emission.send(tone())
            raise ZeroDivisionError

        with pytest.raises(ZeroDivisionError):
            playing(link, work)
        assert ended(link)


def starve(times: int, patience: float) -> None:
    random = np.random.default_rng(3)
    for _ in range(times):
        link = at.emission.RecordingLink()
        with at.Emission(link, ramp=0.0, patience=patience) as emission:
            with suppress(at.emission.LinkFailed):  # on a busy machine this very loop may starve it
                for _ in range(random.integers(1, 5)):
                    emission.send(tone())
            last = time.monotonic()
            while not link.frames[-1].silent and time.monotonic() - last < 120.0:
                time.sleep(0.005)
            assert ended(link)
            with pytest.raises(
                at.emission.LinkFailed, match=f"over because no call came for {patience:g} s, after"
            ):
                emission.send(tone())
            with pytest.raises(at.emission.LinkFailed, match="no call came"):
                emission.hold(0.1)
        assert ended(link)
        silence = (
            len(link.frames)
            - 1
            - [frame.silent for frame in reversed(link.frames)].index(False)
            + 1
        )
        assert link.seconds[silence] - link.seconds[silence - 1] >= patience * 0.9


def test_starving_ends_in_silence() -> None:
    starve(FEW, patience=0.03)
    starve(1, patience=0.5)


def test_one_that_resumes_is_silent_while_no_call_comes() -> None:
    link = at.emission.RecordingLink()
    with at.Emission(link, ramp=0.0, patience=0.2, resumes=True) as emission:
        emission.send(tone())
        until = time.monotonic() + 120.0
        while not link.frames[-1].silent and time.monotonic() < until:
            time.sleep(0.02)
        assert link.frames[-1].silent
        before = len(link.frames)
        emission.send(tone())
        assert not link.frames[before].silent
        emission.stop()
        with pytest.raises(at.emission.LinkFailed, match="it was stopped"):
            emission.send(tone())
    assert ended(link)


def test_two_signals_in_a_row_end_in_silence() -> None:
    for _ in range(FEW):
        link = at.emission.RecordingLink()

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
    link, before = SignalledLink(), signal.getsignal(signal.SIGTERM)
    with pytest.raises(SystemExit), at.Emission(link):
        pytest.fail("the block must not begin")
    assert all(frame.silent for frame in link.frames)
    assert signal.getsignal(signal.SIGTERM) is before


def test_leaving_the_block_ends_in_silence_and_nothing_follows() -> None:
    link = at.emission.RecordingLink()
    emission = at.Emission(link, ramp=0.0)
    with pytest.raises(at.emission.LinkFailed, match="it was not begun"):
        emission.send(tone())
    with emission:
        emission.send(tone())
    assert ended(link)
    with pytest.raises(
        at.emission.LinkFailed, match="the emission is over because it was ended, after 2 frames"
    ) as over:
        emission.send(tone())
    assert over.value.code == "emission_over"


def test_signals_end_in_silence_in_the_firmware(tmp_path) -> None:
    """Through pyautd3, whose callbacks into Python would swallow a KeyboardInterrupt."""
    random, log = np.random.default_rng(8), tmp_path / "log"
    for _ in range(FEW):
        strike = threading.Timer(random.uniform(0.0, 0.05), os.kill, (os.getpid(), signal.SIGINT))

        def work(emission, strike=strike) -> None:
            emission.send(tone())
            strike.start()
            while True:
                emission.send(tone())

        with pytest.raises(KeyboardInterrupt):
            playing(at.AUTD3Link([at.Pose.identity()]), work, log=log)
        assert events(log)[-2:] == ["silence confirmed", "closed"]


@pytest.mark.parametrize(
    ("name", "model", "elements"), [("sonicsurface", SonicSurface, 256), ("nano16", Nano16, 12)]
)
def test_a_signal_during_a_sequence_ends_in_silence_on_serial_boards(name, model, elements) -> None:
    strike = threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGTERM))

    def work(emission) -> None:
        strike.start()
        emission.play(at.drives.Sequence(moving(10, elements), 40.0), seconds=5.0)

    with wired(model()) as wire:
        with pytest.raises(SystemExit):
            playing(at.emission.SerialLink(wire.port, name), work)
        assert wire.silent()


# --- links that fail ------------------------------------------------------------------------------------------------


def test_a_link_that_fails_says_what_was_last_and_that_it_may_sound() -> None:
    link = at.AUTD3Link([at.Pose.identity()])

    def work(emission) -> None:
        emission.send(tone())
        emission.send(tone())
        link.cut()
        with pytest.raises(
            at.emission.LinkFailed,
            match=r"while sending: broken; the last of 2 frames sent had 249 of 249",
        ):
            emission.send(tone())

    with pytest.raises(
        at.emission.LinkFailed, match=r"while silencing: broken; .* may still emit: cut their power"
    ) as failure:
        playing(link, work)
    assert failure.value.code == "silence_failed"
    assert failure.value.last is not None
    assert not failure.value.last.silent
    assert failure.value.sent == 2


def test_a_watchdog_that_cannot_silence_is_heard_of() -> None:
    link = at.AUTD3Link([at.Pose.identity()])

    def work(emission) -> None:
        emission.send(tone())
        link.cut()
        time.sleep(3.0)
        with pytest.raises(at.emission.LinkFailed, match="may still emit"):
            emission.beat()

    with pytest.raises(at.emission.LinkFailed, match="may still emit"):
        playing(link, work)


def test_a_cable_cut_during_play_raises_in_time() -> None:
    begun = time.monotonic()
    with (
        wired(SonicSurface(), cut_after=2000) as wire,
        pytest.raises(at.emission.LinkFailed, match="the serial link failed"),
    ):
        playing(
            at.emission.SerialLink(wire.port),
            lambda emission: emission.play(at.drives.Sequence(moving(4, 256), 50.0), seconds=600.0),
        )
    assert time.monotonic() - begun < 300.0


def test_a_cable_cut_while_boards_play_on_is_noticed() -> None:
    begun, link = time.monotonic(), at.AUTD3Link([at.Pose.identity()])

    def work(emission) -> None:
        emission.send(tone())
        link.cut()
        with pytest.raises(
            at.emission.LinkFailed,
            match="while looking for the boards: broken; the last of 1 frames",
        ):
            emission.hold(600.0)

    with pytest.raises(at.emission.LinkFailed, match="may still emit"):
        playing(link, work)
    with (
        wired(SonicSurface(), cut_after=259 * 3 + 100) as wire,
        pytest.raises(at.emission.LinkFailed, match="may still emit"),
    ):
        playing(
            at.emission.SerialLink(wire.port),
            lambda emission: (emission.send(tone(256)), emission.hold(600.0)),
        )
    assert time.monotonic() - begun < 300.0


def test_a_signal_ends_an_emission_from_another_thread_too() -> None:
    link, heard = at.emission.RecordingLink(), []

    def feed(emission) -> None:
        try:
            while True:
                emission.send(tone())
        except at.emission.LinkFailed as error:
            heard.append(str(error))

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
    assert "over because of the signal SIGTERM" in heard[0]


def test_a_process_that_shall_outlive_its_terminal_does() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        link = at.emission.RecordingLink()
        with at.Emission(link, ramp=0.0) as emission:
            emission.send(tone())
            os.kill(os.getpid(), signal.SIGHUP)
            emission.send(tone())
    finally:
        signal.signal(signal.SIGHUP, before)
    assert [frame.silent for frame in link.frames] == [False, False, True]
