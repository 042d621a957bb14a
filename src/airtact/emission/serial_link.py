"""SonicSurface and Ultraino Nano16 over a serial port."""

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from airtact.checks import of_kind
from airtact.drives.frame import Frame
from airtact.emission.link import Link
from airtact.errors import InvalidInput, extra

PATIENCE = 0.5
"""How long a board may take to take a frame or to answer [s]."""

BOOT = 4.0
"""How long a board that begins anew when its port is opened may take for its first answer [s]."""

TRIES = 3
"""How often a frame is sent that is not answered."""


def serial_ports() -> list[str]:
    """List the serial ports that there are now."""
    from serial.tools import list_ports

    return sorted(port.device for port in list_ports.comports())


class SerialLink(Link):
    """Boards on one serial port: one or two SonicSurface, or one Nano16.

    A Nano16 echoes the reset and the swap of a frame, so that every frame is confirmed and sent
    again where the echo stays away. A SonicSurface never answers: there a frame counts as sent when
    the port has let all of it out. Both keep two buffers, and the swap that makes one play brings
    the other to the back; silence is therefore sent twice.

    Parameters
    ----------
    port : the device, such as /dev/ttyUSB0 or COM3.
    board : "sonicsurface" or "nano16".
    boards : how many: the first is the primary, the second the secondary.
    boot : how long the first answer may take [s].
    """

    name = "serial"
    port: str
    boot: float

    def __init__(
        self, port: str, board: str = "sonicsurface", boards: int = 1, boot: float = BOOT
    ) -> None:
        super().__init__(board, boards)
        if self.codec.baud is None:
            raise InvalidInput(
                f"{board} has no serial line (0 baud): sonicsurface and nano16 have one.",
                code="unknown_name",
            )
        of_kind(port, str, "the port", 'the name of a device, such as "/dev/ttyUSB0"')
        self.port = port
        self.boot = boot
        self.fastest = self.fastest_frames
        self._line: Any = None

    def _resource(self) -> str:
        return f"the port {os.path.realpath(self.port)}"

    def _begin(self) -> None:
        serial = _library()
        try:
            self._line = serial.Serial(
                self.port, self.codec.baud, timeout=0.02, write_timeout=PATIENCE, exclusive=True
            )
        except (OSError, ValueError) as error:
            raise InvalidInput(_cannot_open(self.port, error), code="link_failed") from None
        try:
            self._deliver(self.zero(), self.boot if self.codec.echo else 0.0)
            self._deliver(self.zero())
        except BaseException:
            self._line.close()
            raise

    def _transmit(self, frame: Frame) -> None:
        self._deliver(frame)

    def _silence(self) -> None:
        self._deliver(self.zero())
        self._deliver(self.zero())

    def _look(self) -> None:
        # What the boards play already, once more: it changes nothing, and a cable that is gone is
        # noticed.
        if self.last is not None:
            self._deliver(self.last)

    def _end(self) -> None:
        self._line.close()

    @contextmanager
    def _reporting(self, doing: str) -> Iterator[None]:
        try:
            with super()._reporting(doing):
                yield
        except Exception as error:
            # A terminal that is gone raises an error of its own, which is no OSError and not there
            # on every system.
            if type(error).__module__ != "termios":
                raise
            raise self._failed(doing, f"{self.port} is gone ({error})") from error

    def _deliver(self, frame: Frame, patience: float = 0.0) -> None:
        """Write a frame until it is answered, ``TRIES`` times or for so many seconds, whichever is longer."""
        message = self.codec.encode(frame)
        end = time.monotonic() + patience
        tries = 0
        while tries < TRIES or time.monotonic() < end:
            tries += 1
            self._line.reset_input_buffer()
            self._write(message)
            if self._answered(message):
                return
        raise self._failed("waiting for an answer", f"{self.port} did not answer {tries} frames")

    def _write(self, message: bytes) -> None:
        self._line.write(message)
        end = time.monotonic() + PATIENCE
        while self._line.out_waiting:
            if time.monotonic() > end:
                raise self._failed(
                    "sending", f"{self._line.out_waiting} bytes did not leave {self.port}"
                )
            time.sleep(0.001)

    def _answered(self, message: bytes) -> bool:
        """Wait for the bytes that the board answers with, in their order; others between them are passed over."""
        waiting = list(self.codec.echo)
        baud = self.codec.baud or np.inf
        end = time.monotonic() + PATIENCE / TRIES + 10.0 * len(message) / baud
        while waiting and time.monotonic() < end:
            for byte in self._line.read(max(1, min(self._line.in_waiting, 4096))):
                if waiting and byte == waiting[0]:
                    waiting.pop(0)
        return not waiting


def _library() -> Any:
    with extra("serial", "serial ports need pyserial"):
        import serial
    return serial


def _cannot_open(port: str, error: Exception) -> str:
    """Write why a port cannot be opened, and which ports exist."""
    number = getattr(error, "errno", None)
    there = ", ".join(serial_ports()) or "none"
    if number in (11, 16) or "lock" in str(error):
        return f"the port {port} is busy (error {number}): close the program that holds it."
    if number == 13:
        return f"the port {port} may not be opened by you (error 13): join the group that owns it, often dialout."
    return f"the port {port} cannot be opened (error {number or 0}): the ports that there are: {there}."
