"""AUTD3 boards on UDP: the emulator of their makers behind a relay that sees and may lose every message."""

import re
import select
import socket
import struct
import threading
import time

import autd3
import numpy as np

CLEAR, RELEASE, ACTIVATE, FRAMES, PATTERN = 0x03, 0x06, 0x12, 0x15, 0x16
"""Commands of the firmware that change what a board plays."""

FAILSAFE = 0.5
"""Boards that hear nothing for so long are mute until they are cleared or released [s]."""


class Board:
    """What one board plays, from the messages that it gets."""

    def __init__(self) -> None:
        self.banks: list[list[np.ndarray]] = [[], []]  # frames of phases and intensities, (2, 249)
        self.bank = 0
        self.mute = False
        self.last = np.inf  # when it last heard anything

    def hear(self, body: bytes) -> None:
        command, values = body[1], body[6:]
        if command == CLEAR:
            self.banks = [[], []]
        if command in (CLEAR, RELEASE):
            self.mute = False
        elif command == PATTERN:
            self.bank = values[0]
            self.banks[self.bank] = [np.frombuffer(values[10:508], np.uint8).reshape(2, 249)]
        elif command == FRAMES:
            bank, count, first = values[0], values[1], struct.unpack("<H", values[2:4])[0]
            frames = np.frombuffer(values[4 : 4 + 498 * count], np.uint8).reshape(count, 2, 249)
            self.banks[bank] = [*self.banks[bank][:first], *frames]
        elif command == ACTIVATE:
            self.bank = values[0]

    @property
    def loudest(self) -> int:
        """Largest intensity."""
        self.mute = self.mute or time.monotonic() > self.last + FAILSAFE
        if self.mute:
            return 0
        return max((int(frame[1].max()) for frame in self.banks[self.bank]), default=0)


class UDPBoards:
    """Boards for ``UDPLink(poses, boards.address)``.

    Attributes
    ----------
    boards : what each plays.
    commands : command of every frame that board 0 got, when, and when it is to act [device's µs].
    clocks : of every answer: board, when its question and itself passed [s], and the board's time [ns].
    lose : number of the next messages to the boards that are lost.
    cut : numbers of boards that get no messages.
    sounded : when a board last sounded [s].
    """

    def __init__(self, count: int = 1) -> None:
        self.emulator = autd3.UdpEmulator(count)
        found = re.search(r"\[::1\]:(\d+)", str(self.emulator.option().iface))
        assert found is not None
        self._group = ("::1", int(found[1]))
        self._door = _socket()
        self._back = _socket()
        self._faces: dict[socket.socket, tuple[str, int]] = {}
        self._client: tuple[str, int] | None = None
        self._numbers: dict[int, int] = {}  # of the boards behind faces; a board has several
        self._asked: dict[tuple[int, bytes], float] = {}
        self.boards = [Board() for _ in range(count)]
        self.commands: list[tuple[int, float, int]] = []
        self.clocks: list[tuple[int, float, float, int]] = []
        self.lose = 0
        self.cut: tuple[int, ...] = ()
        self.sounded = -np.inf
        self._open = True
        self._thread = threading.Thread(target=self._relay, daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        return f"[::1]:{self._door.getsockname()[1]}"

    @property
    def loudest(self) -> int:
        return max(board.loudest for board in self.boards)

    def playing(self, index: int = 0) -> np.ndarray:
        """(2, E) phases and intensities of frame ``index``."""
        return np.hstack([board.banks[board.bank][index] for board in self.boards])

    def close(self) -> None:
        self._open = False
        self._thread.join()
        for one in (self._door, self._back, *self._faces):
            one.close()

    def _relay(self) -> None:
        while self._open:
            if self.loudest > 0:
                self.sounded = time.monotonic()
            for one in select.select([self._door, self._back, *self._faces], [], [], 0.01)[0]:
                if one.fileno() < 0:
                    continue
                data, sender, *_ = one.recvfrom(4096)
                if one is self._back:
                    self._answer(data, sender[:2])
                else:
                    self._client = sender[:2]
                    if one is self._door and data[1] == 2:  # a client begins; addresses change
                        self._forget()
                    if self.lose > 0:
                        self.lose -= 1
                        continue
                    self._ask(one, data)

    def _forget(self) -> None:
        for one in self._faces:
            one.close()
        self._faces = {}
        self._numbers = {}
        self._asked = {}

    def _ask(self, one: socket.socket, data: bytes) -> None:
        if one is not self._door:
            index = list(self._faces).index(one)
            if self._numbers.get(index) in self.cut:
                return
            self._note(index, data)
        self._back.sendto(data, self._faces.get(one, self._group))

    def _note(self, index: int, data: bytes) -> None:
        now = time.monotonic()
        self._asked[index, data[2:4]] = now
        board = self._numbers.get(index)
        if board is None:
            return
        _ = self.boards[board].loudest  # it may have become mute since
        self.boards[board].last = now
        if data[1] == 0 and len(data) >= 10:
            self.boards[board].hear(data[4:])
            if board == 0:
                self.commands.append((data[5], now, struct.unpack("<I", data[6:10])[0]))

    def _answer(self, data: bytes, sender: tuple[str, int]) -> None:
        now = time.monotonic()
        addresses = list(self._faces.values())
        if sender not in addresses:
            self._faces[_socket()] = sender
            addresses.append(sender)
        index = addresses.index(sender)
        # The first frames are resets, so that no number is missed.
        if data[1] == 0 and len(data) >= 16:
            self._numbers[index] = data[7]
            asked = self._asked.get((index, data[2:4]))
            if asked is not None:
                self.clocks.append((data[7], asked, now, struct.unpack("<Q", data[8:16])[0]))
        if self._client is not None:
            list(self._faces)[index].sendto(data, self._client)


def _socket() -> socket.socket:
    one = socket.socket(socket.AF_INET6, socket.SOCK_DGRAM)
    one.bind(("::1", 0))
    return one
