"""How an emission begins, its amplitudes and frames in time, and what it refuses."""

import numpy as np
import pytest

import airtact as at
from airtact.drives.frame import frame_at
from airtact.drives.sequence import Sequence
from airtact.emission.codecs import codec_of
from airtact.emission.emission import frames_of_period
from airtact.emission.link import RecordingLink
from airtact.transducers.levels import AmplitudeModulation, check_rate
from emission.sounds import VirtualTime, moving, strongest, tone
from faults import raises_code


@pytest.fixture
def clock(monkeypatch) -> VirtualTime:
    return VirtualTime(monkeypatch)


def test_sound_rises_over_the_ramp(clock) -> None:
    link = RecordingLink()
    player = clock.player(link, ramp=0.2)
    clock.send(player, tone().amplitudes)
    clock.run(player, 0.3)
    np.testing.assert_allclose(strongest(link), 255 * np.arange(1, 9) / 8, rtol=0, atol=0.51)
    np.testing.assert_allclose(link.seconds, 0.025 * np.arange(8), rtol=0, atol=1.1e-3)


def test_a_sequence_rises_over_the_ramp(clock) -> None:
    link = RecordingLink()
    player = clock.player(link, ramp=0.2)
    clock.send(player, moving(4), 40.0)
    clock.run(player, 0.3)
    rise = [*range(1, 9), 8, 8, 8, 8]
    np.testing.assert_allclose(strongest(link), 255 * np.array(rise) / 8, rtol=0, atol=0.51)


@pytest.mark.parametrize(("cap", "share"), [(0.4, 0.5), (0.9, 1.0)])
def test_the_cap_turns_a_drive_down_as_a_whole(clock, cap: float, share: float) -> None:
    amplitudes = np.linspace(0.0, 0.8, 249) * tone().amplitudes
    frame = clock.send(clock.player(RecordingLink()), amplitudes, cap=cap)
    np.testing.assert_allclose(
        frame.amplitude / 255, share * np.abs(amplitudes), rtol=0, atol=0.5 / 255
    )


def test_one_cap_holds_for_all_frames_of_a_sequence(clock) -> None:
    link = RecordingLink()
    player = clock.player(link)
    clock.send(player, moving(2) * np.array([[1.0], [0.5]]), 100.0, 0.5)
    clock.run(player, 0.02)
    np.testing.assert_allclose(strongest(link), [127.5, 63.75], rtol=0, atol=0.51)


def test_boards_without_amplitudes_switch_on_fewer_elements() -> None:
    levels = codec_of("sonicsurface").levels
    for share in (0.0, 0.1, 0.5, 1.0):
        frame = frame_at(tone(256).amplitudes, levels, share)
        assert abs(int(frame.amplitude.sum()) - 256 * share) <= 2
    # Spread evenly: every run of 16 elements has its part.
    runs = frame_at(tone(256).amplitudes, levels, 0.5).amplitude.reshape(16, 16).sum(axis=1)
    assert np.all((runs >= 7) & (runs <= 9))


@pytest.mark.parametrize(
    ("step", "frames", "dropped"),
    [(1e-3, 20, 0), (0.05, 8, 10)],
    ids=["in time", "a link that takes 50 ms"],
)
def test_frames_that_would_be_late_are_dropped(clock, step, frames: int, dropped: int) -> None:
    link = RecordingLink()
    player = clock.player(link)
    clock.send(player, moving(10), 50.0)
    clock.run(player, 0.4, step)
    assert (link.sent, player.dropped()) == (frames, dropped)


def test_newer_frames_take_the_place_of_those_before_in_their_round(clock) -> None:
    link = RecordingLink()
    player = clock.player(link)
    for level in (100, 200, 100, 200):
        levels = level + np.arange(8)
        clock.send(player, tone().amplitudes * levels[:, None] / 255.0, 200.0)
        clock.run(player, 0.06)
    levels = np.array(strongest(link))
    assert set(levels // 100) == {1, 2}
    assert len(levels) == 48
    np.testing.assert_array_equal(levels % 100, np.arange(48) % 8)


def test_a_drive_ends_a_round(clock) -> None:
    link = RecordingLink()
    player = clock.player(link)
    clock.send(player, 0.5 * moving(4), 400.0)
    clock.send(player, tone().amplitudes)
    before = len(link.frames)
    clock.run(player, 0.03)
    assert len(link.frames) == before
    assert strongest(link)[-1] == 255


def test_autd3_boards_repeat_the_newest_frames_themselves() -> None:
    drives = moving(4)
    with at.Emission(at.AUTD3Link([at.Pose.identity()]), cap=1.0, ramp=0.0) as emission:
        for turn in (1.0, 1j):
            emission.cycle(Sequence(turn * drives, 800.0))
            for index in (0, 3):
                played = emission.link.played(index).drive().amplitudes
                np.testing.assert_allclose(played, turn * drives[index], rtol=0, atol=0.03)
        played = emission.play(Sequence(moving(8), 500.0), seconds=0.1)
        assert not emission.link.played(7).silent
        assert not emission.link.played(7).same_as(emission.link.played(0))
    assert (played.rate, played.dropped) == (500.0, 0)
    assert emission.link.sent == 4 + 4 + 8 + 1


def test_the_force_of_a_modulated_drive_follows_a_cosine_in_the_firmware() -> None:
    """200 Hz in 20 frames at 4 kHz; the board holds round(255 √(1 − d (1 − cos)/2)) of each element."""
    link = at.AUTD3Link([at.Pose.identity()])
    with at.Emission(link, cap=1.0, ramp=0.0) as emission:
        played = emission.modulate(tone(), 0.1, AmplitudeModulation(200.0, depth=0.8))
        frames = [link.played(index) for index in range(20)]
    assert (played.rate, played.frames, played.dropped) == (4000.0, 400, 0)
    levels = np.array([int(frame.amplitude.max()) for frame in frames])
    force = 1.0 - 0.8 * (1.0 - np.cos(2.0 * np.pi * np.arange(20) / 20)) / 2.0
    np.testing.assert_allclose((levels / 255.0) ** 2, force, rtol=0, atol=1.0 / 255)
    np.testing.assert_array_equal(frames[1].phase, frames[5].phase)  # only the amplitude varies


@pytest.mark.parametrize(("frequency", "count"), [(40.0, 2), (10.0, 8)])
def test_boards_without_amplitudes_modulate_the_number_of_elements(
    clock, frequency: float, count: int
) -> None:
    """A sequence at the rate that the line of a SonicSurface carries; the pressure goes with the elements."""
    link = RecordingLink("sonicsurface")
    player = clock.player(link)
    envelope = AmplitudeModulation(frequency).envelope(count)
    player.play(tone(256).amplitudes[None], envelope, 80.0, 1.0)
    clock.run(player, 0.2)
    elements = np.array([int(frame.amplitude.sum()) for frame in link.frames])
    np.testing.assert_allclose(elements, 256 * np.resize(envelope, 16), rtol=0, atol=2)


@pytest.mark.parametrize("moves", [False, True])
def test_without_a_cap_a_head_gets_110_db_at_most(moves) -> None:
    link = RecordingLink()
    with at.Emission(link, ramp=0.0) as emission:
        if moves:
            emission.play(Sequence(moving(4), 100.0), 0.1)
        else:
            emission.send(tone())
    played = np.stack([frame.drive().amplitudes for frame in link.frames])
    board = link.codec.board
    head = at.drives.HeadLevel(played, board.positions, link.levels, 732.7)
    assert 107.0 < head.full < 110.0


@pytest.mark.parametrize(
    ("link", "elements", "code"),
    [
        (RecordingLink("sonicsurface"), 256, "out_of_range"),
        (RecordingLink("autd3", 2), 498, "key_missing"),
    ],
    ids=["no levels of amplitude", "unknown poses"],
)
def test_without_a_cap_boards_whose_level_cannot_be_kept_stay_silent(link, elements, code) -> None:
    with at.Emission(link) as emission, raises_code(code):
        emission.send(tone(elements))
    assert all(frame.silent for frame in link.frames)


@pytest.mark.parametrize(
    ("make", "code"),
    [
        (lambda link: at.Emission(link, cap=0.0), "out_of_range"),
        (lambda link: at.Emission(link, cap=40.0), "out_of_range"),
        (lambda link: at.Emission(link, cap=np.nan), "out_of_range"),
        (lambda link: at.Emission(link, ramp=-1.0), "out_of_range"),
        (lambda link: at.Emission(link, patience=0.0), "out_of_range"),
        (lambda link: at.Emission("autd3"), "wrong_kind"),
    ],
)
@pytest.mark.usefixtures("as_outside_the_tests")
def test_settings_that_cannot_be_are_rejected(make, code: str) -> None:
    with raises_code(code):
        make(RecordingLink())


@pytest.mark.usefixtures("as_outside_the_tests")
def test_drives_that_do_not_fit_are_rejected_and_silent() -> None:
    link = RecordingLink()
    with at.Emission(link) as emission:
        for work, code in [
            (lambda: emission.send(tone(996)), "sizes_differ"),
            (lambda: emission.send(None), "wrong_kind"),
            (lambda: emission.play(Sequence(moving(3, 12), 10.0), 1), "sizes_differ"),
            (lambda: emission.play(moving(3), 1), "wrong_kind"),
        ]:
            with raises_code(code):
                work()
    assert all(frame.silent for frame in link.frames)
    with (
        at.Emission(RecordingLink("sonicsurface"), cap=1.0) as emission,
        raises_code("out_of_range"),
    ):
        emission.modulate(tone(256), 0.1)


@pytest.mark.parametrize("frequency", [5.0, 30.0, 125.0, 150.0, 200.0, 237.0, 250.0, 1000.0])
def test_a_period_is_whole_frames_of_whole_periods_of_the_sound(frequency: float) -> None:
    count, rate = frames_of_period(frequency, np.inf)
    check_rate(rate, 40e3, 65535, "AUTD3")
    assert 16 <= count <= 40
    assert rate / count == pytest.approx(frequency, rel=0.01)


def test_a_slow_line_gets_fewer_frames_or_the_fastest_that_it_carries() -> None:
    assert frames_of_period(10.0, 88.9) == (8, 80.0)
    assert frames_of_period(44.0, 88.9) == (2, 88.0)
    with raises_code("out_of_range", "am:44"):
        frames_of_period(200.0, 88.9)
    with raises_code("out_of_range", "1000 Hz"):
        frames_of_period(2000.0, np.inf)
