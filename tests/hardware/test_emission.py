"""However an emission ends, the last frame is silence; and it begins softly and never passes its cap."""

import os
import signal
import threading
import time
from contextlib import suppress

import jaxtyping
import numpy as np
import pytest

from airtact.conventions import InvalidInput
from airtact.hardware.autd3_link import AUTD3Link
from airtact.hardware.codecs import codec_of
from airtact.hardware.emission import Emission
from airtact.hardware.link import LinkFailed, RecordingLink
from airtact.hardware.loudness import faded
from airtact.hardware.serial_link import SerialLink
from airtact.scene.pose import Pose
from airtact.synthesis.sequence import Sequence, amplitude_modulation
from airtact.transfer import Drive
from hardware.receivers import Nano16, SonicSurface, wired

TIMES = 50


def tone(elements: int = 249, loudness: float = 1.0) -> Drive:
    return Drive(loudness * np.exp(2j * np.pi * np.arange(elements) / 7))


def moving(frames: int, elements: int = 249) -> np.ndarray:
    turns = np.arange(frames)[:, None] / frames + np.arange(elements) / 7
    return np.exp(2j * np.pi * turns)


def ended(link: RecordingLink) -> bool:
    """Whether there was sound, then silence, then nothing."""
    return any(not frame.silent for frame in link.frames) and link.frames[-1].silent


# --- how it ends ----------------------------------------------------------------------------------------------------


def playing(link, work) -> None:
    with Emission(link, ramp=0.0) as emission:
        work(emission)


@pytest.mark.parametrize("kind", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_at_any_moment_ends_in_silence(kind) -> None:
    """Real signals to this process, at 50 moments while frames go out as fast as they can."""
    random = np.random.default_rng(int(kind))
    before, sounded = signal.getsignal(kind), 0
    for _ in range(TIMES):
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
    assert sounded > TIMES // 2  # the others came before the first frame


def test_an_exception_at_any_moment_ends_in_silence() -> None:
    for count in range(TIMES):
        link = RecordingLink()

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
        link = RecordingLink()
        with Emission(link, ramp=0.0, patience=patience) as emission:
            with suppress(LinkFailed):  # on a busy machine this very loop may starve it
                for _ in range(random.integers(1, 5)):
                    emission.send(tone())
            last = time.monotonic()
            while not link.frames[-1].silent and time.monotonic() - last < 30.0:
                time.sleep(0.005)
            assert ended(link)
            with pytest.raises(LinkFailed, match=f"over because nobody fed it for {patience:g} s, after"):
                emission.send(tone())
            with pytest.raises(LinkFailed, match="nobody fed it"):
                emission.hold(0.1)
        assert ended(link)
        silence = len(link.frames) - 1 - [frame.silent for frame in reversed(link.frames)].index(False) + 1
        assert link.seconds[silence] - link.seconds[silence - 1] >= patience * 0.9


def test_starving_ends_in_silence() -> None:
    starve(TIMES, patience=0.03)
    starve(1, patience=0.5)


def test_two_signals_in_a_row_end_in_silence() -> None:
    for _ in range(10):
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
    class SlowLink(RecordingLink):
        def _begin(self) -> None:
            super()._begin()
            os.kill(os.getpid(), signal.SIGTERM)

    link, before = SlowLink(), signal.getsignal(signal.SIGTERM)
    with pytest.raises(SystemExit), Emission(link):
        pytest.fail("the block must not begin")
    assert all(frame.silent for frame in link.frames)
    assert signal.getsignal(signal.SIGTERM) is before


def test_leaving_the_block_ends_in_silence_and_nothing_follows() -> None:
    link = RecordingLink()
    emission = Emission(link, ramp=0.0)
    with pytest.raises(LinkFailed, match="it was not begun"):
        emission.send(tone())
    with emission:
        emission.send(tone())
    assert ended(link)
    with pytest.raises(LinkFailed, match="the emission is over because it was ended, after 2 frames"):
        emission.send(tone())


def test_signals_end_in_silence_in_the_firmware() -> None:
    """Through pyautd3, whose callbacks into Python would swallow a KeyboardInterrupt."""
    random = np.random.default_rng(8)
    for _ in range(10):
        link = AUTD3Link([Pose.identity()])
        after: list[bool] = []
        close = link.close

        def look(link=link, after=after, close=close) -> None:
            after.append(link.played().silent)
            close()

        link.close = look
        strike = threading.Timer(random.uniform(0.0, 0.05), os.kill, (os.getpid(), signal.SIGINT))

        def work(emission, strike=strike) -> None:
            strike.start()
            while True:
                emission.send(tone())

        with pytest.raises(KeyboardInterrupt):
            playing(link, work)
        assert after == [True]


@pytest.mark.parametrize(("name", "model", "elements"), [("sonicsurface", SonicSurface, 256), ("nano16", Nano16, 12)])
def test_a_signal_during_a_sequence_ends_in_silence_on_serial_boards(name, model, elements) -> None:
    strike = threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGTERM))

    def work(emission) -> None:
        strike.start()
        emission.play(Sequence(moving(10, elements), 40.0), seconds=5.0)

    with wired(model()) as wire:
        with pytest.raises(SystemExit):
            playing(SerialLink(wire.port, name), work)
        time.sleep(0.05)
        assert not wire.board.pulses().any()


# --- links that fail ------------------------------------------------------------------------------------------------


def test_a_link_that_fails_says_what_was_last_and_that_it_may_sound() -> None:
    link = AUTD3Link([Pose.identity()])

    def work(emission) -> None:
        emission.send(tone())
        emission.send(tone())
        link.cut()
        with pytest.raises(LinkFailed, match=r"while sending: broken; the last of 2 frames sent had 249 of 249"):
            emission.send(tone())

    with pytest.raises(LinkFailed, match=r"while silencing: broken; .* may still sound: cut their power") as failure:
        playing(link, work)
    assert failure.value.last is not None
    assert not failure.value.last.silent
    assert failure.value.sent == 2


def test_a_watchdog_that_cannot_silence_is_heard_of() -> None:
    link = AUTD3Link([Pose.identity()])

    def work(emission) -> None:
        emission.send(tone())
        link.cut()
        time.sleep(0.8)
        with pytest.raises(LinkFailed, match="may still sound"):
            emission.beat()

    with pytest.raises(LinkFailed, match="may still sound"):
        playing(link, work)


def test_a_cable_cut_during_play_raises_in_time() -> None:
    begun = time.monotonic()
    with wired(SonicSurface(), cut_after=2000) as wire, pytest.raises(LinkFailed, match="the serial link failed"):
        playing(SerialLink(wire.port), lambda emission: emission.play(Sequence(moving(4, 256), 50.0), seconds=60.0))
    assert time.monotonic() - begun < 30.0


def test_a_cable_cut_while_boards_play_on_is_noticed() -> None:
    begun, link = time.monotonic(), AUTD3Link([Pose.identity()])

    def work(emission) -> None:
        emission.send(tone())
        link.cut()
        with pytest.raises(LinkFailed, match="while looking for the boards: broken; the last of 1 frames"):
            emission.hold(60.0)

    with pytest.raises(LinkFailed, match="may still sound"):
        playing(link, work)
    with wired(SonicSurface(), cut_after=259 * 3 + 100) as wire, pytest.raises(LinkFailed, match="may still sound"):
        playing(SerialLink(wire.port), lambda emission: (emission.send(tone(256)), emission.hold(60.0)))
    assert time.monotonic() - begun < 30.0


def test_a_signal_ends_an_emission_from_another_thread_too() -> None:
    link, heard = RecordingLink(), []

    def feed(emission) -> None:
        try:
            while True:
                emission.send(tone())
        except LinkFailed as error:
            heard.append(str(error))

    def work(emission) -> None:
        feeder = threading.Thread(target=feed, args=(emission,))
        feeder.start()
        time.sleep(0.05)
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(5.0)
        finally:
            feeder.join(2.0)

    with pytest.raises(SystemExit):
        playing(link, work)
    assert ended(link)
    assert "over because of the signal SIGTERM" in heard[0]


def test_a_process_that_shall_outlive_its_terminal_does() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        link = RecordingLink()
        with Emission(link, ramp=0.0) as emission:
            emission.send(tone())
            os.kill(os.getpid(), signal.SIGHUP)
            emission.send(tone())
    finally:
        signal.signal(signal.SIGHUP, before)
    assert [frame.silent for frame in link.frames] == [False, False, True]


# --- how it begins, and how loud ------------------------------------------------------------------------------------


def test_sound_rises_over_the_ramp() -> None:
    link = RecordingLink()
    with Emission(link) as emission:
        emission.send(tone())
        emission.send(tone())
    loudness = [int(frame.amplitude.max()) for frame in link.frames]
    np.testing.assert_allclose(loudness[:7], 255 * np.arange(1, 8) / 8, rtol=0, atol=0.51)
    assert loudness[7:] == [255, 255, 0]
    assert link.seconds[7] - link.seconds[0] >= 0.17


def test_the_cap_turns_a_drive_down_as_a_whole() -> None:
    drive = Drive(np.linspace(0.0, 0.8, 249) * tone().amplitudes)
    link = RecordingLink()
    with Emission(link, cap=40.0, ramp=0.0) as emission:
        frame = emission.send(drive)
    np.testing.assert_allclose(frame.amplitude / 255, 0.5 * np.abs(drive.amplitudes), rtol=0, atol=0.5 / 255)
    with Emission(link, cap=90.0, ramp=0.0) as emission:
        frame = emission.send(drive)
    np.testing.assert_allclose(frame.amplitude / 255, np.abs(drive.amplitudes), rtol=0, atol=0.5 / 255)


def test_one_cap_holds_for_all_frames_of_a_sequence() -> None:
    drives = moving(2) * np.array([[1.0], [0.5]])
    link = RecordingLink()
    with Emission(link, cap=50.0, ramp=0.0) as emission:
        emission.play(Sequence(drives, 100.0), seconds=0.04)
    loudness = [int(frame.amplitude.max()) for frame in link.frames[:2]]
    np.testing.assert_allclose(loudness, [127.5, 63.75], rtol=0, atol=0.51)


def test_boards_without_amplitudes_are_capped_by_speaking_with_fewer() -> None:
    levels = codec_of("sonicsurface").levels
    for share in (0.0, 0.1, 0.5, 1.0):
        frame = faded(tone(256), levels, share)
        assert abs(int(frame.amplitude.sum()) - 256 * share) <= 2
    # Spread evenly: every run of 16 elements has its part.
    runs = faded(tone(256), levels, 0.5).amplitude.reshape(16, 16).sum(axis=1)
    assert runs.min() >= 7
    assert runs.max() <= 9


def test_a_sequence_keeps_its_rate_and_tells_what_it_dropped() -> None:
    link = RecordingLink()
    with Emission(link, ramp=0.0) as emission:
        played = emission.play(Sequence(moving(10), 50.0), seconds=0.4)
    assert played.frames + played.dropped == 20
    assert played.dropped == 0 or played.rate < 50.0


def test_frames_that_would_be_late_are_dropped() -> None:
    class Slow(RecordingLink):
        def _transmit(self, frame) -> None:
            time.sleep(0.03)
            super()._transmit(frame)

    link = Slow()
    with Emission(link, ramp=0.0) as emission:
        played = emission.play(Sequence(moving(10), 100.0), seconds=0.6)
    assert played.dropped > 10
    assert played.frames + played.dropped == 60


def test_autd3_repeats_a_sequence_by_itself() -> None:
    link = AUTD3Link([Pose.identity()])
    with Emission(link, ramp=0.0) as emission:
        played = emission.play(Sequence(moving(8), 500.0), seconds=0.1)
        assert not link.played(7).silent
        assert not link.played(7).same_as(link.played(0))
    assert (played.rate, played.dropped) == (500.0, 0)
    assert link.sent == 8 + 1


def test_a_swing_that_begins_in_silence_rises_too() -> None:
    swing = amplitude_modulation(tone(), frequency=100.0, rate=400.0)
    link = RecordingLink()
    with Emission(link) as emission:
        emission.play(Sequence(np.roll(swing.drives, 2, axis=0), 400.0), seconds=0.05)
    loudness = [int(frame.amplitude.max()) for frame in link.frames]
    np.testing.assert_allclose(loudness[:7], 255 * np.arange(1, 8) / 8, rtol=0, atol=0.51)
    assert loudness[7] == 0  # the first frame, after the most powerful one rose


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda link: Emission(link, cap=0.0), "the cap is 0 per cent of full scale"),
        (lambda link: Emission(link, cap=120.0), "the cap is 120 per cent"),
        (lambda link: Emission(link, cap=np.nan), "the cap is nan per cent"),
        (lambda link: Emission(link, ramp=-1.0), "the ramp is -1 s"),
        (lambda link: Emission(link, patience=0.0), "the patience of the watchdog is 0 s"),
        (lambda link: Emission("autd3"), "the link is 'autd3', but it must be a Link: give one such as AUTD3Link"),
    ],
)
def test_settings_that_cannot_be_are_refused(make, sentence: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)  # as it is outside the tests
    with pytest.raises(InvalidInput, match=sentence):
        make(RecordingLink())


@pytest.mark.parametrize(
    ("work", "sentence"),
    [
        (lambda emission: emission.send(tone(996)), "a drive for 996 elements does not fit 1 autd3 board of 249"),
        (lambda emission: emission.send(None), "what is emitted is a NoneType"),
        (
            lambda emission: emission.play(Sequence(moving(3, 12), 10.0), 1),
            "a drive for 12 elements does not fit 1 autd3 board",
        ),
        (lambda emission: emission.play(moving(3), 1), "what is played is an array|what is played is a"),
    ],
)
def test_what_cannot_be_emitted_is_refused_and_silent(work, sentence: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)  # as it is outside the tests
    link = RecordingLink()
    with Emission(link) as emission, pytest.raises(InvalidInput, match=sentence):
        work(emission)
    assert all(frame.silent for frame in link.frames)
