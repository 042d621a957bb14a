"""What the tests of emissions play, and how."""

import re
import time
from pathlib import Path

import numpy as np

import airtact as at

EVENT = re.compile(r"\d+\.\d+ (opened|frame \d+ loudest \S+|silence confirmed|closed)")
ENOUGH = 120.0


def tone(elements: int = 249, loudness: float = 1.0) -> at.Drive:
    return at.Drive(loudness * np.exp(2j * np.pi * np.arange(elements) / 7))


def moving(frames: int, elements: int = 249) -> np.ndarray:
    turns = np.arange(frames)[:, None] / frames + np.arange(elements) / 7
    return np.exp(2j * np.pi * turns)


def ended(link: at.emission.RecordingLink) -> bool:
    """Whether there was sound, then silence, then nothing."""
    return any(not frame.silent for frame in link.frames) and link.frames[-1].silent


def playing(link, work, **settings) -> None:
    with at.Emission(link, ramp=0.0, **settings) as emission:
        work(emission)


def events(log: Path) -> list[str]:
    """Return the events of a log without their times, once its link process has ended."""
    end = time.monotonic() + ENOUGH
    while not log.read_text().endswith("closed\n") and time.monotonic() < end:
        time.sleep(0.02)
    lines = log.read_text().splitlines()
    assert all(EVENT.fullmatch(line) for line in lines)
    return [line.split(" ", 1)[1] for line in lines]
