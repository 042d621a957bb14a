"""Bytes and back."""

import numpy as np
import pytest

import airtact as at
from faults import raises_code


def test_every_pair_of_levels_survives_the_way_to_a_drive_and_back() -> None:
    amplitude, phase = (levels.ravel() for levels in np.meshgrid(np.arange(1, 256), np.arange(256)))
    frame = at.drives.Frame(amplitude.astype(np.uint8), phase.astype(np.uint8))
    back = at.quantise(frame.drive())
    np.testing.assert_array_equal(back.amplitude, frame.amplitude)
    np.testing.assert_array_equal(back.phase, frame.phase)


def test_silence_has_no_phase() -> None:
    frame = at.drives.Frame(np.zeros(256, dtype=np.uint8), np.arange(256, dtype=np.uint8))
    drive = frame.drive()
    assert not drive.amplitudes.any()
    back = at.quantise(drive)
    assert not back.amplitude.any()
    assert not back.phase.any()
    whisper = at.quantise(at.Drive(np.array([0.4j / 255.0])))
    assert (whisper.amplitude.item(), whisper.phase.item()) == (0, 0)


def test_a_byte_of_sixty_four_delays_the_wave_by_a_quarter_period() -> None:
    drive = at.drives.Frame(
        np.full(2, 255, dtype=np.uint8), np.array([0, 64], dtype=np.uint8)
    ).drive()
    times = np.linspace(0.0, 1.0, 7)
    wave = np.real(drive.amplitudes[None, :] * np.exp(-2j * np.pi * times)[:, None])
    earlier = np.real(drive.amplitudes[0] * np.exp(-2j * np.pi * (times - 0.25)))
    np.testing.assert_allclose(wave[:, 1], earlier, atol=1e-14)


LEVELS = np.zeros(3, dtype=np.uint8)


@pytest.mark.usefixtures("as_outside_the_tests")
@pytest.mark.parametrize(
    ("amplitude", "phase", "code"),
    [
        (LEVELS, LEVELS[:2], "sizes_differ"),
        (LEVELS, LEVELS.astype(np.int64) + 300, "wrong_shape"),
        (LEVELS[:0], LEVELS[:0], "wrong_shape"),
        (LEVELS[None], LEVELS[None], "wrong_shape"),
    ],
)
def test_bad_frames_are_rejected(amplitude, phase, code) -> None:
    with raises_code(code):
        at.drives.Frame(amplitude, phase)
