"""Messages of boards: frames in each board's levels, channels and sense of phase, and back.

On every board here a larger phase number delays the pulse of an element. So does the phase of a
drive d in Re[d e^{−iωt}], therefore no codec conjugates. AUTD3: proven in the time domain with its
emulator (tests). SonicSurface: ``PhaseLine.vhd`` starts the pulse when a rising counter reaches the
number. Nano16: ``ArduinoNano.java`` puts the first high step at the number, and
``DriverNano16.ino`` plays the steps in order. OpenMPD: its driver shifts the number of a shorter
pulse by half of the difference, which keeps the middle of the pulse in place.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from jaxtyping import UInt8

from airtact.drives.frame import Frame
from airtact.errors import InvalidInput
from airtact.transducers.boards import Board, board_named
from airtact.transducers.levels import EIGHT_BITS, Levels


@dataclass(frozen=True, eq=False)
class Codec(ABC):
    """The messages of one kind of board.

    Attributes
    ----------
    board : the board.
    levels : amplitudes and phases that it can emit.
    baud : speed of its serial line [bit/s]; None where it has none.
    echo : bytes that it sends back for a frame; empty where it is silent.
    """

    board: Board
    levels: Levels
    baud: int | None = None
    echo: bytes = b""

    @abstractmethod
    def encode(self, frame: Frame) -> bytes:
        """Return the message that makes the boards play a frame, one board after the other."""

    @abstractmethod
    def decode(self, message: bytes) -> Frame:
        """Return the frame of a message.

        Raises
        ------
        InvalidInput
            If the message has another length or other marks than ``encode`` makes.
        """

    def fastest_frames(self, boards: int = 1) -> float:
        """Largest rate of the boards' serial line [frames/s]; infinite where there is none."""
        if self.baud is None:
            return np.inf
        zeros = np.zeros(boards * len(self.board), dtype=np.uint8)
        # 10 bits a byte: with the start bit and the stop bit.
        return self.baud / 10.0 / len(self.encode(Frame(zeros, zeros, self.levels)))

    def _channels(
        self, values: UInt8[np.ndarray, "elements"]
    ) -> UInt8[np.ndarray, "boards channels"]:
        """Bring the value of each element to its position in the board's message."""
        boards = len(values) // len(self.board)
        channels = np.zeros((boards, self.board.message_length), dtype=np.uint8)
        channels[:, self.board.channels] = values.reshape(boards, -1)
        return channels

    def _elements(
        self, channels: UInt8[np.ndarray, "boards channels"]
    ) -> UInt8[np.ndarray, "elements"]:
        return channels[:, self.board.channels].ravel()


def _boards(message: bytes, size: int) -> UInt8[np.ndarray, "boards size"]:
    if len(message) == 0 or len(message) % size:
        raise InvalidInput(
            f"a message of {len(message)} bytes is not made of boards of {size} bytes.",
            code="message_damaged",
        )
    return np.frombuffer(message, dtype=np.uint8).reshape(-1, size)


class AUTD3Codec(Codec):
    """Two bytes an element: phase in 1/256 of a turn, intensity in 1/255 of full scale.

    The firmware makes the pressure linear: it plays intensity i as a pulse of
    round(512/π · asin(i/255)) of 512 ticks, whose first harmonic is i/255.
    """

    def encode(self, frame: Frame) -> bytes:
        """Return phase and intensity, alternating, in the order of the elements."""
        return np.stack([frame.phase, frame.amplitude], axis=1).tobytes()

    def decode(self, message: bytes) -> Frame:
        """Return the frame of alternating bytes."""
        pairs = _boards(message, 2 * len(self.board)).reshape(-1, 2)
        return Frame(pairs[:, 1].copy(), pairs[:, 0].copy(), self.levels)


class SonicSurfaceCodec(Codec):
    """C0 or C1 chooses the board, FE begins its channels (0 to 31, 32 is off), FD swaps."""

    START = 0xFE
    SWAP = 0xFD
    FIRST = 0xC0
    OFF = 32

    def encode(self, frame: Frame) -> bytes:
        """Return each board's channels, then one swap for all."""
        # The board has no amplitudes: a channel is at a phase or off.
        numbers = np.where(frame.amplitude > 0, frame.phase, self.OFF).astype(np.uint8)
        boards = [
            bytes([self.FIRST + b, self.START]) + part.tobytes()
            for b, part in enumerate(self._channels(numbers))
        ]
        return b"".join(boards) + bytes([self.SWAP])

    def decode(self, message: bytes) -> Frame:
        """Return the frame of a message that ends in a swap."""
        boards = _boards(message[:-1], 2 + self.board.message_length)
        marks = [[self.FIRST + index, self.START] for index in range(len(boards))]
        if boards[:, :2].tolist() != marks or message[-1] != self.SWAP:
            raise InvalidInput(
                f"a message of {len(message)} bytes lacks the marks of a SonicSurface frame.",
                code="message_damaged",
            )
        numbers = self._elements(boards[:, 2:])
        if numbers.max() > self.OFF:
            raise InvalidInput(
                f"a channel of a SonicSurface is 0 to {self.OFF}, not {numbers.max()}.",
                code="message_damaged",
            )
        on = numbers < self.OFF
        return Frame(on.astype(np.uint8), np.where(on, numbers, 0).astype(np.uint8), self.levels)


class Nano16Codec(Codec):
    """10 resets, then 16 steps of a period, two ports each, as nibbles marked by 1, and 00 swaps.

    An element is high in the 8 steps that begin at its phase. The reset makes the board discard an
    incomplete frame; its own software does not send it.
    """

    RESET = 0x10
    SWAP = 0x00
    MARK = 0x01

    def encode(self, frame: Frame) -> bytes:
        """Return the nibbles of both ports in every step."""
        start = self._channels(frame.phase)[0].astype(np.int64)
        steps = np.arange(16)[:, None]
        high = ((steps - start) % 16 < 8) & (self._channels(frame.amplitude)[0] > 0)
        ports = np.packbits(high, axis=1, bitorder="little")
        nibbles = np.stack([ports & 0xF0, (ports & 0x0F) << 4], axis=-1) | self.MARK
        return bytes([self.RESET]) + nibbles.tobytes() + bytes([self.SWAP])

    def decode(self, message: bytes) -> Frame:
        """Return the frame of a message of 66 bytes."""
        data = np.frombuffer(message, dtype=np.uint8)
        if (
            len(data) != 66
            or data[0] != self.RESET
            or data[-1] != self.SWAP
            or np.any(data[1:-1] & 0x0F != self.MARK)
        ):
            raise InvalidInput(
                f"a message of {len(message)} bytes lacks the marks of a Nano16 frame of 66 bytes.",
                code="message_damaged",
            )
        halves = data[1:-1].reshape(16, 2, 2)
        ports = ((halves[..., 0] & 0xF0) | (halves[..., 1] >> 4)).astype(np.uint8)
        high = np.unpackbits(ports, axis=1, bitorder="little").astype(bool)
        on = np.any(high, axis=0)
        # Exactly one rise, and half of the steps high: one pulse, which may wrap around the period.
        rises = high & ~np.roll(high, 1, axis=0)
        if np.any(rises.sum(axis=0) != on) or np.any(high.sum(axis=0) != 8 * on):
            raise InvalidInput(
                f"an element of a Nano16 is high in 8 consecutive steps, not {high.sum(axis=0)}.",
                code="message_damaged",
            )
        channels = self.board.channels
        phase = np.argmax(rises, axis=0).astype(np.uint8)
        return Frame(on.astype(np.uint8)[channels], phase[channels], self.levels)


class OpenMPDCodec(Codec):
    """256 phases in 1/128 of a turn, bit 7 of the first one set, then 256 amplitudes, 0 to 64.

    Amplitude a is a pulse of a/128 of a period that begins at the phase number. (64 − a)/2 is added
    to the number, which keeps the middle of the pulse in place. Its first harmonic is sin(πa/128).
    """

    FULL = 64
    START = 0x80

    def encode(self, frame: Frame) -> bytes:
        """Return a message per board, one after the other; each board has a line of its own."""
        shift = (self.FULL - frame.amplitude.astype(np.int64)) // 2
        phases = self._channels(((frame.phase + shift) % 128).astype(np.uint8))
        phases[:, 0] |= self.START
        return np.hstack([phases, self._channels(frame.amplitude)]).tobytes()

    def decode(self, message: bytes) -> Frame:
        """Return the frame of messages of 512 bytes."""
        boards = _boards(message, 2 * self.board.message_length)
        if not np.all(boards[:, 0] & self.START):
            raise InvalidInput(
                f"a message of {len(message)} bytes lacks the mark of an OpenMPD frame in its "
                "first byte.",
                code="message_damaged",
            )
        amplitude = self._elements(boards[:, 256:] & 0x7F)
        if amplitude.max() > self.FULL:
            raise InvalidInput(
                f"an amplitude of OpenMPD is 0 to {self.FULL}, not {amplitude.max()}.",
                code="message_damaged",
            )
        numbers = self._elements(boards[:, :256] & 0x7F).astype(np.int64)
        phase = (numbers - (self.FULL - amplitude.astype(np.int64)) // 2) % 128
        return Frame(amplitude, phase.astype(np.uint8), self.levels)


def codec_of(board: Board | str) -> Codec:
    """Return the codec of a board or of a board's name.

    Raises
    ------
    InvalidInput
        If there is no such board.
    """
    kind = board_named(board) if isinstance(board, str) else board
    if kind.name == "autd3":
        return AUTD3Codec(kind, EIGHT_BITS)
    if kind.name == "openmpd":
        return OpenMPDCodec(kind, Levels(np.sin(np.pi / 128 * np.arange(65)), phases=128))
    on_off = Levels(np.array([0.0, 1.0]), phases=kind.phases)
    if kind.name == "nano16":
        return Nano16Codec(kind, on_off, baud=115_200, echo=b"\x10\x00")
    return SonicSurfaceCodec(kind, on_off, baud=230_400)
