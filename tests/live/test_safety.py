"""How the sound of the live loop rises and falls."""

import numpy as np
import pytest

from airtact.live.safety import FADE, LONGEST_STEP, RAMP, STALLED, Gain


def test_the_sound_rises_over_the_ramp_also_after_a_long_silence() -> None:
    gain = Gain()
    gain.advance(0.0, True)
    for begun in (0.0, 100.0):
        rising = [gain.advance(begun + now, True) for now in np.arange(0.01, RAMP + 0.02, 0.01)]
        assert rising[0] <= LONGEST_STEP / RAMP
        assert max(np.diff(rising)) <= 0.01 / RAMP + 1e-9
        assert rising[-1] == 1.0
        falling = [gain.advance(begun + 1.0, False)] if begun else [gain.advance(begun + RAMP + 0.02 + FADE, False)]
        assert falling == [0.0]


def test_after_a_stall_it_rises_anew() -> None:
    gain = Gain()
    for now in np.arange(0.0, 1.0, 0.01):
        gain.advance(now, True)
    assert gain.share == 1.0
    assert gain.advance(1.0 + STALLED + 0.01, True) == pytest.approx(LONGEST_STEP / RAMP)
