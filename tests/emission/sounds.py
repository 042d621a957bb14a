"""Drives, players and clocks of the emission tests."""

import re
import time
from pathlib import Path

import numpy as np

import airtact as at
from airtact.emission.link import Link, RecordingLink
from airtact.emission.player import Player, Settings

EVENT = re.compile(r"\d+\.\d+ (opened|frame \d+ loudest \S+|silence confirmed|closed)")


def tone(elements: int = 249, loudness: float = 1.0) -> at.Drive:
    return at.Drive(loudness * np.exp(2j * np.pi * np.arange(elements) / 7))


def moving(frames: int, elements: int = 249) -> np.ndarray:
    turns = np.arange(frames)[:, None] / frames + np.arange(elements) / 7
    return np.exp(2j * np.pi * turns)


def ended(link: RecordingLink) -> bool:
    """Whether there was sound, then silence, then nothing."""
    return any(not frame.silent for frame in link.frames) and link.frames[-1].silent


def playing(link, work, **settings) -> None:
    with at.Emission(link, **{"cap": 1.0, "ramp": 0.0, **settings}) as emission:
        work(emission)


def events(log: Path) -> list[str]:
    """Return the events of a log without their times, once its link process has ended."""
    end = time.monotonic() + 120.0
    while not log.read_text().endswith("closed\n") and time.monotonic() < end:
        time.sleep(0.02)
    lines = log.read_text().splitlines()
    assert all(EVENT.fullmatch(line) for line in lines)
    return [line.split(" ", 1)[1] for line in lines]


def strongest(link: RecordingLink) -> list[int]:
    return [int(frame.amplitude.max()) for frame in link.frames]


class VirtualTime:
    """Replaces the module ``time`` where a player and its link read the clock."""

    def __init__(self, monkeypatch) -> None:
        self.now = 0.0
        monkeypatch.setattr("airtact.emission.player.time", self)
        monkeypatch.setattr("airtact.emission.link.time", self)

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds

    def player(self, link: Link, ramp: float = 0.0, **settings) -> Player:
        settings = {"patience": 100.0, "log": None, **settings}
        player = Player(link, Settings(ramp=ramp, **settings))
        player.open()
        return player

    def send(
        self, player: Player, drives: np.ndarray, rate: float = 0.0, cap: float = 1.0
    ) -> at.drives.Frame:
        """Play a drive, or drives in turn at a rate [1/s], from now on."""
        drives = np.atleast_2d(drives)
        frame, _, _ = player.play(drives, np.ones(len(drives)), rate, cap)
        return frame

    def run(self, player: Player, seconds: float, step: float = 1e-3) -> None:
        """Let the player do what is due, once per step of the clock [s]."""
        for _ in range(round(seconds / step)):
            player.step()
            self.now += step
