"""How an emission begins, how loud it is, and what it refuses."""

import jaxtyping
import numpy as np
import pytest

import airtact as at
from airtact.emission.amplitudes import faded
from airtact.emission.codecs import codec_of
from emission.odd_links import SlowLink
from emission.sounds import moving, tone
from faults import raises_code


def test_sound_rises_over_the_ramp() -> None:
    link = at.emission.RecordingLink()
    with at.Emission(link) as emission:
        emission.send(tone())
        emission.send(tone())
    loudness = [int(frame.amplitude.max()) for frame in link.frames]
    np.testing.assert_allclose(loudness[:7], 255 * np.arange(1, 8) / 8, rtol=0, atol=0.51)
    assert loudness[7:] == [255, 255, 0]
    assert link.seconds[7] - link.seconds[0] >= 0.17


def test_the_cap_turns_a_drive_down_as_a_whole() -> None:
    drive = at.Drive(np.linspace(0.0, 0.8, 249) * tone().amplitudes)
    link = at.emission.RecordingLink()
    with at.Emission(link, cap=0.4, ramp=0.0) as emission:
        frame = emission.send(drive)
    np.testing.assert_allclose(
        frame.amplitude / 255, 0.5 * np.abs(drive.amplitudes), rtol=0, atol=0.5 / 255
    )
    with at.Emission(link, cap=0.9, ramp=0.0) as emission:
        frame = emission.send(drive)
    np.testing.assert_allclose(
        frame.amplitude / 255, np.abs(drive.amplitudes), rtol=0, atol=0.5 / 255
    )


def test_one_cap_holds_for_all_frames_of_a_sequence() -> None:
    drives = moving(2) * np.array([[1.0], [0.5]])
    link = at.emission.RecordingLink()
    with at.Emission(link, cap=0.5, ramp=0.0) as emission:
        emission.play(at.drives.Sequence(drives, 100.0), seconds=0.04)
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
    link = at.emission.RecordingLink()
    with at.Emission(link, ramp=0.0) as emission:
        played = emission.play(at.drives.Sequence(moving(10), 50.0), seconds=0.4)
    assert played.frames + played.dropped == 20
    assert played.dropped == 0 or played.rate < 50.0


def test_newer_frames_take_the_place_of_those_before_in_their_round() -> None:
    link, count, rate = at.emission.RecordingLink(), 8, 200.0
    rounds = [
        at.drives.Sequence(tone().amplitudes * (level + np.arange(count))[:, None] / 255.0, rate)
        for level in (100, 200)
    ]
    with at.Emission(link, ramp=0.0) as emission:
        for sequence in (*rounds, *rounds):
            emission.cycle(sequence)
            emission.hold(0.06)
    levels = np.array([int(frame.amplitude.max()) for frame in link.frames[:-1]])
    times, places = np.array(link.seconds[:-1]), levels % 100
    assert set(levels // 100) == {1, 2}
    steps = np.rint(np.diff(times) * rate)  # frames that a busy machine left out count
    assert np.abs((np.diff(places) - steps + count / 2) % count - count / 2).max() <= 1
    assert link.frames[-1].silent


def test_a_drive_ends_a_round() -> None:
    link = at.emission.RecordingLink()
    with at.Emission(link, ramp=0.0) as emission:
        emission.cycle(at.drives.Sequence(0.5 * moving(4), 400.0))
        emission.send(tone())
        before = len(link.frames)
        emission.hold(0.03)
        assert len(link.frames) == before
        assert link.frames[-1].amplitude.max() == 255


def test_autd3_boards_repeat_the_newest_frames_themselves() -> None:
    drives = moving(4)
    with at.Emission(at.AUTD3Link([at.Pose.identity()]), ramp=0.0) as emission:
        for turn in (1.0, 1j):
            emission.cycle(at.drives.Sequence(turn * drives, 800.0))
            for index in (0, 3):
                played = emission.link.played(index).drive().amplitudes
                np.testing.assert_allclose(played, turn * drives[index], rtol=0, atol=0.03)


def test_frames_that_would_be_late_are_dropped() -> None:
    link = SlowLink()
    with at.Emission(link, ramp=0.0) as emission:
        played = emission.play(at.drives.Sequence(moving(10), 100.0), seconds=0.6)
    assert played.dropped > 10
    assert played.frames + played.dropped == 60


def test_autd3_repeats_a_sequence_by_itself() -> None:
    link = at.AUTD3Link([at.Pose.identity()])
    with at.Emission(link, ramp=0.0) as emission:
        played = emission.play(at.drives.Sequence(moving(8), 500.0), seconds=0.1)
        assert not link.played(7).silent
        assert not link.played(7).same_as(link.played(0))
    assert (played.rate, played.dropped) == (500.0, 0)
    assert link.sent == 8 + 1


def test_a_swing_that_begins_in_silence_rises_too() -> None:
    swing = at.drives.amplitude_modulation(tone(), frequency=100.0, rate=400.0)
    link = at.emission.RecordingLink()
    with at.Emission(link) as emission:
        emission.play(at.drives.Sequence(np.roll(swing.drives, 2, axis=0), 400.0), seconds=0.05)
    loudness = [int(frame.amplitude.max()) for frame in link.frames]
    np.testing.assert_allclose(loudness[:7], 255 * np.arange(1, 8) / 8, rtol=0, atol=0.51)
    assert loudness[7] == 0  # the first frame, after the most powerful one rose


def test_a_modulated_drive_swings_its_force_as_a_cosine_in_the_firmware() -> None:
    """200 Hz in 20 frames at 4 kHz; the board holds round(255 √(1 − d (1 − cos)/2)) of each element."""
    link = at.AUTD3Link([at.Pose.identity()])
    with at.Emission(link, ramp=0.0) as emission:
        played = emission.modulate(
            tone(), 0.1, at.transducers.AmplitudeModulation(200.0, depth=0.8)
        )
        held = np.array([int(link.played(index).amplitude.max()) for index in range(20)])
        phases = [link.played(index).phase.tolist() for index in (1, 5)]
    assert (played.rate, played.frames, played.dropped) == (4000.0, 400, 0)
    force = 1.0 - 0.8 * (1.0 - np.cos(2.0 * np.pi * np.arange(20) / 20)) / 2.0
    np.testing.assert_allclose((held / 255.0) ** 2, force, rtol=0, atol=1.0 / 255)
    assert phases[0] == phases[1]  # only the amplitude varies


def test_boards_without_amplitudes_swing_by_the_number_of_elements() -> None:
    """On and off as fast as the line of a SonicSurface carries; the pressure goes with the number of elements."""
    link = at.emission.RecordingLink("sonicsurface")
    with at.Emission(link, ramp=0.0) as emission:
        played = emission.modulate(tone(256), 0.2, at.transducers.AmplitudeModulation(40.0))
    assert played.frames + played.dropped == 16
    assert {int(frame.amplitude.sum()) for frame in link.frames} == {0, 256}
    with at.Emission(link, ramp=0.0) as emission:
        emission.modulate(tone(256), 0.3, at.transducers.AmplitudeModulation(10.0))
    on = {
        int(frame.amplitude.sum()) for frame in link.frames
    }  # on a busy machine one of the frames may be late
    wanted = 256 * at.transducers.AmplitudeModulation(10.0).envelope(8)
    assert len(on) >= 3
    assert all(np.abs(wanted - count).min() < 2.0 for count in on)
    with at.Emission(link) as emission, raises_code("out_of_range", "200 Hz", "am:44"):
        emission.modulate(tone(256), 0.1)


@pytest.mark.parametrize(
    ("make", "code", "shown"),
    [
        (lambda link: at.Emission(link, cap=0.0), "out_of_range", "is 0,"),
        (lambda link: at.Emission(link, cap=40.0), "out_of_range", "for 40 per cent give 0.4"),
        (lambda link: at.Emission(link, cap=np.nan), "out_of_range", "is nan,"),
        (lambda link: at.Emission(link, ramp=-1.0), "out_of_range", "-1 s"),
        (lambda link: at.Emission(link, patience=0.0), "out_of_range", "0 s"),
        (lambda link: at.Emission("autd3"), "wrong_kind", "'autd3'"),
    ],
)
def test_settings_that_cannot_be_are_rejected(
    make, code: str, shown: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)  # as it is outside the tests
    with raises_code(code, shown):
        make(at.emission.RecordingLink())


@pytest.mark.parametrize(
    ("work", "code", "shown"),
    [
        (
            lambda emission: emission.send(tone(996)),
            "sizes_differ",
            "996 elements does not fit 1 autd3 board of 249",
        ),
        (lambda emission: emission.send(None), "wrong_kind", "NoneType"),
        (
            lambda emission: emission.play(at.drives.Sequence(moving(3, 12), 10.0), 1),
            "sizes_differ",
            "12 elements",
        ),
        (lambda emission: emission.play(moving(3), 1), "wrong_kind", "array"),
    ],
)
def test_what_cannot_be_emitted_is_rejected_and_silent(
    work, code: str, shown: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)  # as it is outside the tests
    link = at.emission.RecordingLink()
    with at.Emission(link) as emission, raises_code(code, shown):
        work(emission)
    assert all(frame.silent for frame in link.frames)
