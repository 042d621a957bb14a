"""Models of boards' receivers, byte by byte from their firmware, and a pseudo-terminal to speak to them through."""

import os
import pty
import threading
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import numpy as np


class SonicSurface:
    """Distribute.vhd and PhaseLine.vhd of upnalab/SonicSurface, primary (mine = 0) or secondary (mine = 1)."""

    def __init__(self, mine: int = 0) -> None:
        self.mine = mine
        self.enabled = True
        self.counter = 0
        self.current = np.zeros(256, dtype=int)
        self.previous = np.zeros(256, dtype=int)

    def hear(self, byte: int) -> bytes:
        if byte == 254 and self.enabled:
            self.counter = 0
        elif byte == 253:
            self.current, self.previous = self.previous, self.current
            self.counter = 0
        elif byte in (150, 151):  # clocks off and on
            pass
        elif byte in (192, 193):
            self.enabled = byte - 192 == self.mine
        elif self.enabled:
            self.previous[self.counter & 255] = byte if byte == 32 else byte & 31
            self.counter += 1
        return b""

    def pulses(self) -> np.ndarray:
        """(32, 256) output in each tick of a period: high for 16 ticks from the one whose number is the phase."""
        return ((np.arange(32)[:, None] - self.current) % 32 < 16) & (self.current < 32)


class TwoSonicSurfaces:
    """Both boards hear all bytes; each knows whether they are for it."""

    def __init__(self) -> None:
        self.boards = [SonicSurface(0), SonicSurface(1)]

    def hear(self, byte: int) -> bytes:
        for board in self.boards:
            board.hear(byte)
        return b""

    def pulses(self) -> np.ndarray:
        return np.concatenate([board.pulses() for board in self.boards], axis=1)


class Nano16:
    """DriverNano16.ino of asiermarzo/Ultraino; it plays its first buffer, half of it high, from the start."""

    def __init__(self, mute: bool = False) -> None:
        self.emitting = np.zeros(32, dtype=int)
        self.reading = np.zeros(32, dtype=int)
        self.emitting[:16] = 255
        self.index = 0
        self.mute = mute

    def hear(self, byte: int) -> bytes:
        echo = b""
        if byte == 0:
            self.emitting, self.reading, self.index = self.reading, self.emitting, 0
            echo = b"\x00"
        elif byte == 16:
            self.index = 0
            echo = b"\x10"
        elif byte & 15 == 1:
            if self.index < 64:  # the firmware writes past its buffer here
                place = self.index // 2
                self.reading[place] = (
                    byte & 0xF0 if self.index % 2 == 0 else self.reading[place] | byte >> 4
                )
            self.index += 1
        else:
            echo = bytes([byte - 1])
        return b"" if self.mute else echo

    def pulses(self) -> np.ndarray:
        """(16, 12) levels of A0 to A5 (port C, bits 0 to 5) and D2 to D7 (port D, bits 2 to 7) in each slot."""
        ports = self.emitting.reshape(16, 2)
        c = (ports[:, :1] >> np.arange(6)) & 1
        d = (ports[:, 1:] >> np.arange(2, 8)) & 1
        return np.concatenate([c, d], axis=1).astype(bool)


class OpenMPD:
    """CommandReader.vhd of RMResearch/OpenMPD_Hardware 3.4.2 for one board."""

    def __init__(self) -> None:
        self.state = "idle"
        self.count = 0
        self.phases = np.zeros(256, dtype=int)
        self.amplitudes = np.zeros(256, dtype=int)
        self.playing: tuple[np.ndarray, np.ndarray] | None = None

    def hear(self, byte: int) -> bytes:
        if self.state == "idle":
            if byte & 128:
                self.phases[0] = byte & 127
                self.count = 1
                self.state = "phases"
        elif self.state == "phases":
            self.phases[self.count] = byte & 127
            self.count += 1
            if self.count == 256:
                self.count = 0
                self.state = "amplitudes"
        else:
            self.amplitudes[self.count] = byte & 127
            self.count += 1
            if self.count == 256:
                self.playing = (self.phases.copy(), self.amplitudes.copy())
                self.state = "idle"
                self.count = 0
        return b""

    def pulses(self) -> np.ndarray:
        """(128, 256) output by pin: as many ticks as the amplitude, from the one whose number is the phase."""
        assert self.playing is not None
        phases, amplitudes = self.playing
        return (np.arange(128)[:, None] - phases) % 128 < amplitudes


def first_harmonic(pulses: np.ndarray) -> np.ndarray:
    """Phasor in Re[p e^{−iωt}] of each column of a period of pulses; full scale is that of a square wave."""
    ticks = len(pulses)
    kernel = np.exp(2j * np.pi * (np.arange(ticks) + 0.5) / ticks)
    square = np.abs(kernel[: ticks // 2].sum())
    # A pulse that begins at tick 0 and lasts half a period is the phase 0 of a board.
    return (kernel @ pulses) / square / 1j


class Wire:
    """A pseudo-terminal: what is written to ``port`` is heard by a board, and its echo comes back."""

    def __init__(self, board, noise: bytes = b"", cut_after: int | None = None) -> None:
        self.master, self.slave = pty.openpty()
        tty.setraw(self.slave)
        self.port = os.ttyname(self.slave)
        self.board = board
        self.cut_after = cut_after
        self.heard = 0
        self.written = bytearray()
        if noise:
            os.write(self.master, noise)
        self._gone = False
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def _listen(self) -> None:
        with suppress(OSError):
            while data := os.read(self.master, 4096):
                for byte in data:
                    self.heard += 1
                    self.written.append(byte)
                    if echo := self.board.hear(byte):
                        os.write(self.master, echo)
                    if self.cut_after is not None and self.heard >= self.cut_after:
                        self._gone = True
                        os.close(self.master)
                        return

    def settle(self, count: int, seconds: float = 60.0) -> None:
        waiter = threading.Event()
        for _ in range(int(seconds / 0.002)):
            if self.heard >= count:
                return
            waiter.wait(0.002)
        raise AssertionError(f"{self.heard} of {count} bytes were heard")

    def silent(self, seconds: float = 120.0) -> bool:
        """Wait until what was written has made the board silent."""
        end = time.monotonic() + seconds
        while self.board.pulses().any() and time.monotonic() < end:
            time.sleep(0.02)
        return not self.board.pulses().any()

    def close(self) -> None:
        os.close(self.slave)
        self._thread.join(0.2)  # the last reader of the terminal is gone, so reading from it ends
        if not self._gone:
            os.close(self.master)


@contextmanager
def wired(board, **settings) -> Iterator[Wire]:
    wire = Wire(board, **settings)
    try:
        yield wire
    finally:
        wire.close()
