"""How the sound of boards rises again after a silence."""

import time

import numpy as np

import airtact as at
from airtact.emission.link import RecordingLink
from emission.odd_links import SlowLink


def loudness(link: RecordingLink) -> np.ndarray:
    return np.array(
        [float(frame.levels.amplitudes[frame.amplitude.max()]) for frame in link.frames]
    )


def rise(boards: at.live.Output, drive: np.ndarray) -> None:
    """Send a drive until all of it sounds, however often a busy machine lets the boards fall silent meanwhile."""
    until = time.monotonic() + 120.0
    boards.send(drive)
    while boards.share < 1.0:
        assert time.monotonic() < until
        boards.send(drive)


def test_after_boards_fell_silent_by_themselves_the_first_drive_that_they_take_is_quiet() -> None:
    link, full = SlowLink(), np.ones(249, dtype=np.complex128)
    with at.live.Output(link) as boards:
        boards.send(full)
        assert boards.share < 0.2
        rise(boards, full)
        until = time.monotonic() + 120.0
        while not link.frames[-1].silent and time.monotonic() < until:  # no call comes
            time.sleep(0.02)
        begun = len(link.frames)
        rise(
            boards, full
        )  # these drives are full: the loop does not know yet that the boards fell silent
    rising = loudness(link)[begun:-1]
    assert rising[0] < 0.2
    assert np.diff(rising[: rising.argmax() + 1]).max() < 0.2
    assert rising.max() == 1.0
