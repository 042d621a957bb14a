"""Messages to boards: frames in each board's levels, channels and phase convention.

On all of these boards, a larger phase number delays the pulse of an element, like the phase of a
drive d in Re[d e^{−iωt}]. Therefore no codec conjugates the drive. The evidence is as follows. For
AUTD3, the tests compare the sound with that of its emulator in the time domain. For SonicSurface,
``PhaseLine.vhd`` starts the pulse when a rising counter reaches the number. For Nano16,
``ArduinoNano.java`` puts the first high step at the phase number, and ``DriverNano16.ino`` plays
the steps in order. For OpenMPD, the driver adds half of the missing width to the number of a
shorter pulse, which keeps the middle of the pulse in place.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import UInt8

from airtact.drives.frame import Frame
from airtact.errors import InvalidInput, counted
from airtact.transducers.boards import Board, board_named
from airtact.transducers.levels import EIGHT_BITS, Levels

# Bytes of messages, or levels for each board and channel
Bytes = UInt8[np.ndarray, "..."]


@dataclass(frozen=True, eq=False)
class Codec:
    """Encoder and decoder of the messages for one kind of board.

    Attributes
    ----------
    board : the kind of board that the messages are for.
    levels : amplitudes and phases that the board can emit.
    encoded : function that writes the message of a frame; see ``encode``.
    decoded : function that reads the phase and amplitude of each channel from messages to a number
        of boards, one message per row; it returns None for incomplete frames.
    baud : speed of the board's serial line [bit/s]; None if the board has none.
    echo : bytes that the board sends back for a frame; empty if it does not answer.
    """

    board: Board
    levels: Levels
    encoded: Callable[["Codec", Frame], bytes]
    decoded: Callable[[Bytes, int], tuple[Bytes, Bytes] | None]
    baud: int | None = None
    echo: bytes = b""

    def encode(self, frame: Frame) -> bytes:
        """Return the message that makes the boards play a frame, with the bytes board by board."""
        return self.encoded(self, frame)

    def decode(self, message: bytes, boards: int = 1) -> list[Frame]:
        """Decode the messages for some boards; return an empty list if a frame is incomplete."""
        length = self._message_length(boards)
        if not message or len(message) % length:
            return []
        messages = np.frombuffer(message, dtype=np.uint8).reshape(-1, length)
        channels = self.decoded(messages, boards)
        if channels is None:
            return []
        # From (frames × boards, channels) to (frames, elements).
        phases, amplitudes = (
            values[:, self.board.channels].reshape(-1, boards * len(self.board))
            for values in channels
        )
        return [
            Frame(amplitude, phase, self.levels)
            for amplitude, phase in zip(amplitudes, phases, strict=True)
        ]

    def fastest_frames(self, boards: int = 1) -> float:
        """Largest frame rate of the boards' serial line [frames/s]; infinite if there is none."""
        if self.baud is None:
            return np.inf
        # A byte takes 10 bits, including the start and stop bits.
        return self.baud / 10.0 / self._message_length(boards)

    def _message_length(self, boards: int) -> int:
        zeros = np.zeros(boards * len(self.board), dtype=np.uint8)
        return len(self.encode(Frame(zeros, zeros, self.levels)))

    def check_rate(self, frames: int, rate: float, boards: int = 1) -> None:
        """Raise ``InvalidInput`` if a sequence is too fast for the boards' serial line.

        The message states the largest frequency [Hz] at which the line can repeat all frames.
        """
        fastest = self.fastest_frames(boards)
        if rate <= fastest * (1.0 + 1e-6):  # rounding errors of the rate are allowed
            return
        # Two digits, rounded down, because the line cannot play a frequency that is rounded up.
        step = 10.0 ** (np.floor(np.log10(fastest / frames)) - 1.0)
        frequency = step * np.floor(fastest / frames / step)
        line = counted(boards, f"{self.board.name} board", f"{self.board.name} boards")
        raise InvalidInput(
            f"{rate:g} frames/s exceed the {np.floor(fastest):g} frames/s that the serial line of "
            f"{line} can carry: repeat the sequence at most {frequency:.2g} times per second "
            "(frequency in [drive.modulation]), or use fewer frames.",
            code="out_of_range",
        )

    def channels(
        self, values: UInt8[np.ndarray, "elements"]
    ) -> UInt8[np.ndarray, "boards channels"]:
        """Return the values of the elements in the order of the channels in the messages."""
        boards = len(values) // len(self.board)
        channels = np.zeros((boards, self.board.message_length), dtype=np.uint8)
        channels[:, self.board.channels] = values.reshape(boards, -1)
        return channels


def _autd3(codec: Codec, frame: Frame) -> bytes:
    """Encode two bytes per element: phase in 1/256 turn, intensity in 1/255 of full scale.

    The firmware makes the pressure linear in the intensity: it plays intensity i as a pulse of
    round(512/π · asin(i/255)) out of 512 ticks, whose first harmonic is i/255.
    """
    return np.stack([frame.phase, frame.amplitude], axis=1).tobytes()


def _sonicsurface(codec: Codec, frame: Frame) -> bytes:
    """Encode C0 or C1 (the board), FE, one byte per channel (0 to 31; 32 is off), and FD."""
    # FD swaps all channels. A channel has no amplitude: it either has a phase or is off.
    numbers = np.where(frame.amplitude > 0, frame.phase, 32).astype(np.uint8)
    boards = [
        bytes([0xC0 + index, 0xFE]) + part.tobytes()
        for index, part in enumerate(codec.channels(numbers))
    ]
    return b"".join(boards) + b"\xfd"


def _nano16(codec: Codec, frame: Frame) -> bytes:
    """Encode the byte 10 (reset), the 16 steps of a period in nibbles, and the byte 00 (swap).

    Each nibble is marked by 1 and sent for two ports. An element is high in the 8 steps that
    begin at its phase. The reset, which the board's own software does not send, makes the board
    discard an incomplete frame.
    """
    start = codec.channels(frame.phase)[0].astype(np.int64)
    steps = np.arange(16)[:, None]
    high = ((steps - start) % 16 < 8) & (codec.channels(frame.amplitude)[0] > 0)
    ports = np.packbits(high, axis=1, bitorder="little")
    nibbles = np.stack([ports & 0xF0, (ports & 0x0F) << 4], axis=-1) | 0x01
    return b"\x10" + nibbles.tobytes() + b"\x00"


def _openmpd(codec: Codec, frame: Frame) -> bytes:
    """Encode 256 phases in 1/128 turn (bit 7 of the first one set), then 256 amplitudes, 0 to 64.

    Amplitude a is a pulse of a/128 of a period that begins at the phase number. Adding (64 − a)/2
    to the number keeps the middle of the pulse in place. The first harmonic of the pulse is
    sin(πa/128). Each board has its own line; the messages of the boards follow one another.
    """
    shift = (64 - frame.amplitude.astype(np.int64)) // 2
    phases = codec.channels(((frame.phase + shift) % 128).astype(np.uint8))
    phases[:, 0] |= 0x80
    return np.hstack([phases, codec.channels(frame.amplitude)]).tobytes()


def _from_autd3(messages: Bytes, boards: int) -> tuple[Bytes, Bytes]:
    phases, amplitudes = messages.reshape(-1, 249, 2).transpose(2, 0, 1)
    return phases, amplitudes


def _from_sonicsurface(messages: Bytes, boards: int) -> tuple[Bytes, Bytes] | None:
    if (messages[:, -1] != 0xFD).any():
        return None
    heads = messages[:, :-1].reshape(-1, boards, 258)
    if (heads[..., 0] != 0xC0 + np.arange(boards)).any() or (heads[..., 1] != 0xFE).any():
        return None
    numbers = heads[..., 2:].reshape(-1, 256)
    if (numbers > 32).any():
        return None
    return (numbers % 32).astype(np.uint8), (numbers < 32).astype(np.uint8)


def _from_nano16(messages: Bytes, boards: int) -> tuple[Bytes, Bytes] | None:
    if (messages[:, 0] != 0x10).any() or (messages[:, -1] != 0).any():
        return None
    nibbles = messages[:, 1:-1].reshape(-1, 16, 2, 2)
    ports = ((nibbles[..., 0] & 0xF0) | (nibbles[..., 1] >> 4)).astype(np.uint8)
    high = np.unpackbits(ports, axis=2, bitorder="little").astype(np.int8)
    begins = (high > np.roll(high, 1, axis=1)).argmax(axis=1)
    return begins.astype(np.uint8), np.asarray(high.any(axis=1), dtype=np.uint8)


def _from_openmpd(messages: Bytes, boards: int) -> tuple[Bytes, Bytes] | None:
    phases, amplitudes = messages.reshape(-1, 2, 256).transpose(1, 0, 2)
    if (phases[:, 0] < 0x80).any() or (phases[:, 1:] > 127).any() or (amplitudes > 64).any():
        return None
    shift = (64 - amplitudes.astype(np.int64)) // 2
    return ((phases.astype(np.int64) - shift) % 128).astype(np.uint8), amplitudes


def codec_of(board: Board | str) -> Codec:
    """Return the codec of a board, given the board or its name.

    Raises
    ------
    InvalidInput
        If there is no such board.
    """
    kind = board_named(board) if isinstance(board, str) else board
    if kind.name == "autd3":
        return Codec(kind, EIGHT_BITS, _autd3, _from_autd3)
    if kind.name == "openmpd":
        levels = Levels(np.sin(np.pi / 128 * np.arange(65)), phases=128)
        return Codec(kind, levels, _openmpd, _from_openmpd)
    on_off = Levels(np.array([0.0, 1.0]), phases=kind.phases)
    if kind.name == "nano16":
        return Codec(kind, on_off, _nano16, _from_nano16, baud=115_200, echo=b"\x10\x00")
    if kind.name == "sonicsurface":
        return Codec(kind, on_off, _sonicsurface, _from_sonicsurface, baud=230_400)
    raise InvalidInput(
        f"there is no codec for {kind.name} boards; add one to codec_of.",
        code="not_supported",
    )
