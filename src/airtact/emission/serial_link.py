"""Link to SonicSurface and Ultraino Nano16 boards over a serial port."""

import os
import time
from typing import Any

import numpy as np

from airtact.drives.frame import Frame
from airtact.emission.link import Link
from airtact.errors import InvalidInput, extra, of_kind

# Time that a board has to accept a frame or to answer it [s].
PATIENCE = 0.5

# Number of times that a frame is sent if it is not answered.
TRIES = 3


def serial_ports() -> list[str]:
    """Return the names of the serial ports."""
    from serial.tools import list_ports

    return sorted(port.device for port in list_ports.comports())


class SerialLink(Link):
    """Serial link to one or two SonicSurface boards, or to one Nano16.

    Pass it to ``Emission``. The link is closed at first; ``Emission`` opens it, which requires the
    package pyserial (``pip install 'airtact[serial]'``) and fails with the code "link_failed" if
    the port cannot be opened.

    A Nano16 echoes the first and the last byte of each frame, which reset and swap its buffers. A
    frame that is not echoed is sent up to three times; then the link fails. A SonicSurface never
    answers, so a frame is considered sent once the port has sent all bytes. Both kinds of board
    have two buffers. Each swap brings back the previous buffer, so silence is sent twice.

    Parameters
    ----------
    port : name of the serial device, such as /dev/ttyUSB0 or COM3.
    board : kind of the boards, "sonicsurface" (the default) or "nano16".
    boards : number of boards, 1 by default. A line can drive one Nano16 or up to two SonicSurface
        boards, of which the first is the primary and the second the secondary.
    boot : time limit [s] for the first answer of a Nano16, which restarts when the port is opened;
        4 s by default.

    Raises
    ------
    InvalidInput
        If the kind of board is unknown or has no serial line, if one line cannot drive this number
        of boards, or if the port is not text.
    """

    name = "serial"

    def __init__(
        self, port: str, board: str = "sonicsurface", boards: int = 1, boot: float = 4.0
    ) -> None:
        super().__init__(board, boards)
        if self.codec.baud is None:
            raise InvalidInput(
                f"{board} has no serial line: use sonicsurface or nano16.",
                code="unknown_name",
            )
        of_kind(port, str, "the port", 'the name of a device, such as "/dev/ttyUSB0"')
        self.port: str = port
        self.boot: float = boot
        self._line: Any = None

    def _resource(self) -> str:
        return f"the port {os.path.realpath(self.port)}"

    def _begin(self) -> None:
        with extra("serial", "serial ports need pyserial"):
            import serial
        speed = self.codec.baud or 0
        try:
            self._line = serial.Serial(
                self.port, speed, timeout=0.02, write_timeout=PATIENCE, exclusive=True
            )
        except (OSError, ValueError) as error:
            raise InvalidInput(
                f"the port {self.port} cannot be opened: {error}. Close any program that uses it, "
                "or join the group that owns it, often dialout. The available ports are "
                f"{', '.join(serial_ports()) or 'none'}.",
                code="link_failed",
            ) from None
        try:
            self._deliver(self.zero(), self.boot if self.codec.echo else 0.0)
            self._deliver(self.zero())
        except BaseException:
            self._line.close()
            raise

    def _transmit(self, frame: Frame) -> None:
        self._deliver(frame)

    def _silence(self) -> None:
        for _ in range(2):  # each of the two buffers
            self._deliver(self.zero())

    def _look(self) -> None:
        # Sending the last frame again changes nothing, but it fails if the cable is unplugged.
        if self.last is not None:
            self._deliver(self.last)

    def _end(self) -> None:
        self._line.close()

    def _deliver(self, frame: Frame, patience: float = 0.0) -> None:
        """Write a frame until it is answered, ``TRIES`` times or for ``patience`` [s] if longer."""
        message = self.codec.encode(frame)
        end = time.monotonic() + patience
        tries = 0
        while tries < TRIES or time.monotonic() < end:
            tries += 1
            # Discard noise and late answers to earlier frames.
            self._line.reset_input_buffer()
            self._line.write(message)
            sent_by = time.monotonic() + PATIENCE
            while self._line.out_waiting:
                if time.monotonic() > sent_by:
                    raise self._failed(
                        "sending", f"{self._line.out_waiting} bytes did not leave {self.port}"
                    )
                time.sleep(0.001)
            if self._answered(message):
                return
        raise self._failed("waiting for an answer", f"{self.port} did not answer {tries} frames")

    def _answered(self, message: bytes) -> bool:
        """Wait for the bytes of the board's answer in order, and skip noise between them."""
        waiting = list(self.codec.echo)
        # The answer follows the last byte of the message and takes 10 bits per byte.
        end = (
            time.monotonic() + PATIENCE / TRIES + 10.0 * len(message) / (self.codec.baud or np.inf)
        )
        while waiting and time.monotonic() < end:
            for byte in self._line.read(max(1, min(self._line.in_waiting, 4096))):
                if waiting and byte == waiting[0]:
                    waiting.pop(0)
        return not waiting
