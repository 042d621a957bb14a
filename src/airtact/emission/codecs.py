"""Messages of boards: our frames in each board's levels, order of channels, origin and sense of phase, and back.

Every board here starts the pulse of an element later when its phase number is larger, which is our
own sense: a drive d in Re[d e^{−iωt}] has phase arg(d), and a larger one delays the wave. So no
codec conjugates. AUTD3: proven in the time domain with its emulator (tests). SonicSurface:
``PhaseLine.vhd`` starts the pulse when a rising counter reaches the number. Nano16:
``ArduinoNano.java`` puts the first high step at the number, and ``DriverNano16.ino`` plays the
steps in order. OpenMPD: its driver adds half of what a pulse is shorter to the number, which keeps
the middle of a pulse that starts there in place.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
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
    levels : what it can emit.
    baud : speed of its serial line [bit/s]; None where it has none.
    echo : what it sends back for a frame; nothing where it is silent.
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
        """Return how many frames a second the serial line of so many boards carries; infinite where it has none."""
        if self.baud is None:
            return np.inf
        zeros = np.zeros(boards * len(self.board), dtype=np.uint8)
        return (
            self.baud / 10.0 / len(self.encode(Frame(zeros, zeros, self.levels)))
        )  # 10 bits a byte

    def _parts(
        self, levels: UInt8[np.ndarray, "elements"]
    ) -> Sequence[UInt8[np.ndarray, "positions"]]:
        """Bring one number per element to its position in each board's message."""
        parts = []
        for one in np.split(levels, len(levels) // len(self.board)):
            part = np.zeros(self.board.message_length, dtype=np.uint8)
            part[self.board.channels] = one
            parts.append(part)
        return parts

    def _elements(
        self, parts: Sequence[UInt8[np.ndarray, "positions"]]
    ) -> UInt8[np.ndarray, "elements"]:
        return np.concatenate([part[self.board.channels] for part in parts])


def _pieces(message: bytes, size: int, what: str) -> list[UInt8[np.ndarray, "size"]]:
    if len(message) == 0 or len(message) % size:
        raise InvalidInput(
            f"a message of {len(message)} bytes is not made of {what} of {size} bytes.",
            code="message_damaged",
        )
    return list(np.frombuffer(message, dtype=np.uint8).reshape(-1, size))


class AUTD3Codec(Codec):
    """Two bytes an element: phase in 256 of a turn, intensity in 255 of full scale; the firmware makes pressure linear.

    The firmware plays intensity i as a pulse of round(512/π · asin(i/255)) of 512, whose first
    harmonic is i/255.
    """

    def encode(self, frame: Frame) -> bytes:
        """Return phase and intensity, alternating, in the order of the elements."""
        return np.stack([frame.phase, frame.amplitude], axis=1).tobytes()

    def decode(self, message: bytes) -> Frame:
        """Return the frame of alternating bytes."""
        pairs = np.concatenate(_pieces(message, 2 * len(self.board), "boards")).reshape(-1, 2)
        return Frame(pairs[:, 1].copy(), pairs[:, 0].copy(), self.levels)


class SonicSurfaceCodec(Codec):
    """C0 or C1 chooses the board, FE begins its 256 channels (0 to 31 of a turn, 32 is off), FD swaps all boards."""

    START = 0xFE
    SWAP = 0xFD
    FIRST = 0xC0
    OFF = 32

    def encode(self, frame: Frame) -> bytes:
        """Return each board's channels, then one swap for all."""
        numbers = np.where(frame.amplitude > 0, frame.phase, self.OFF).astype(np.uint8)
        boards = [
            bytes([self.FIRST + b, self.START]) + part.tobytes()
            for b, part in enumerate(self._parts(numbers))
        ]
        return b"".join(boards) + bytes([self.SWAP])

    def decode(self, message: bytes) -> Frame:
        """Return the frame of a message that ends in a swap."""
        pieces = _pieces(message[:-1], 2 + self.board.message_length, "boards")
        marks = [(int(piece[0]) - self.FIRST, int(piece[1])) for piece in pieces]
        if marks != [(b, self.START) for b in range(len(pieces))] or message[-1] != self.SWAP:
            raise InvalidInput(
                f"a message of {len(message)} bytes lacks the marks of a SonicSurface frame.",
                code="message_damaged",
            )
        numbers = self._elements([piece[2:] for piece in pieces])
        if numbers.max() > self.OFF:
            raise InvalidInput(
                f"a channel of a SonicSurface is 0 to {self.OFF}, but one is {numbers.max()}.",
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
        on = self._parts(frame.amplitude)[0]
        start = self._parts(frame.phase)[0]
        steps = np.arange(16)[:, None]
        high = ((steps - start.astype(np.int64)) % 16 < 8) & (on > 0)
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
        rises = high & ~np.roll(high, 1, axis=0)
        if np.any(rises.sum(axis=0) != on) or np.any(high.sum(axis=0) != 8 * on):
            raise InvalidInput(
                f"an element of a Nano16 is high in 8 consecutive steps, not {high.sum(axis=0)}.",
                code="message_damaged",
            )
        amplitude = on.astype(np.uint8)
        phase = np.argmax(rises, axis=0).astype(np.uint8)
        channels = self.board.channels
        return Frame(amplitude[channels], phase[channels], self.levels)


class OpenMPDCodec(Codec):
    """512 bytes a board: 256 phases of 128 to a turn, bit 7 of the first set, then 256 amplitudes of 0 to 64.

    Amplitude a is a pulse of a/128 of a period that begins at the phase number, so (64 − a)/2 is
    added to the number to keep its middle in place; the pulse's first harmonic is sin(πa/128).
    """

    FULL = 64
    START = 0x80

    def encode(self, frame: Frame) -> bytes:
        """Return a message per board, one after the other; each board has a line of its own."""
        shift = (self.FULL - frame.amplitude.astype(np.int64)) // 2
        numbers = ((frame.phase + shift) % 128).astype(np.uint8)
        message = b""
        for phases, amplitudes in zip(
            self._parts(numbers), self._parts(frame.amplitude), strict=True
        ):
            phases[0] |= self.START
            message += phases.tobytes() + amplitudes.tobytes()
        return message

    def decode(self, message: bytes) -> Frame:
        """Return the frame of messages of 512 bytes."""
        pieces = _pieces(message, 2 * self.board.message_length, "boards")
        if not all(piece[0] & self.START for piece in pieces):
            raise InvalidInput(
                f"a message of {len(message)} bytes lacks the mark of an OpenMPD frame in its first byte.",
                code="message_damaged",
            )
        amplitude = self._elements([piece[256:] & 0x7F for piece in pieces])
        if amplitude.max() > self.FULL:
            raise InvalidInput(
                f"an amplitude of OpenMPD is 0 to {self.FULL}, but one is {amplitude.max()}.",
                code="message_damaged",
            )
        numbers = self._elements([piece[:256] & 0x7F for piece in pieces]).astype(np.int64)
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
