"""What the tests of emissions play, and how."""

import numpy as np

from airtact.hardware.emission import Emission
from airtact.hardware.link import RecordingLink
from airtact.transfer import Drive


def tone(elements: int = 249, loudness: float = 1.0) -> Drive:
    return Drive(loudness * np.exp(2j * np.pi * np.arange(elements) / 7))


def moving(frames: int, elements: int = 249) -> np.ndarray:
    turns = np.arange(frames)[:, None] / frames + np.arange(elements) / 7
    return np.exp(2j * np.pi * turns)


def ended(link: RecordingLink) -> bool:
    """Whether there was sound, then silence, then nothing."""
    return any(not frame.silent for frame in link.frames) and link.frames[-1].silent


def playing(link, work) -> None:
    with Emission(link, ramp=0.0) as emission:
        work(emission)
