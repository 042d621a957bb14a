"""What every link to boards does, and the link that only records."""

import hashlib
import os
import tempfile
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from airtact.checks import counted, of_kind, positive
from airtact.drives.frame import Frame
from airtact.emission.codecs import Codec, codec_of
from airtact.errors import InvalidInput
from airtact.transducers.levels import Levels


class LinkFailed(RuntimeError):  # noqa: N818 (reads as what it is in a traceback)
    """A link failed while it was open; the sentence names what was sent last.

    Attributes
    ----------
    last : the frame that the boards confirmed last, or None.
    sent : how many frames they confirmed.
    code : a short name of the kind of fault, such as "link_failed", which stays when the sentence
        changes.
    """

    def __init__(
        self, sentence: str, last: Frame | None = None, sent: int = 0, *, code: str
    ) -> None:
        super().__init__(sentence)
        self.code = code
        self.last = last
        self.sent = sent

    def __reduce__(self) -> Any:
        return partial(type(self), code=self.code), (str(self), self.last, self.sent)


class Link(ABC):
    """A way to boards of one kind: open it, send frames or play a sequence, stop, close.

    A link sends what it is given. Use ``Emission``, which makes it safe: ramp, cap, watchdog and
    silence at the end.

    Attributes
    ----------
    codec : the messages of its boards.
    name : what commands call it.
    boards, elements : number of boards, and of elements on all of them.
    plays_itself : whether boards repeat a sequence by themselves once it was sent, or need every
        frame in time.
    modulates_itself : whether boards vary the amplitude of what they are sent by themselves.
    real_time : whether a frame is emitted when it is sent, so that frames must be sent at their
        times.
    fastest : frames a second that it can carry at most.
    last : the frame that was sent last, or None.
    sent : how many frames were sent since it was opened.
    holder : number of the process that uses it.
    """

    name: str
    plays_itself: bool = False
    modulates_itself: bool = False
    real_time: bool = True
    fastest: float = np.inf
    codec: Codec
    boards: int
    elements: int
    last: Frame | None
    sent: int
    holder: int

    def __init__(self, board: str, boards: int = 1) -> None:
        self.codec = codec_of(board)
        if (
            not isinstance(boards, int | np.integer)
            or not 1 <= boards <= self.codec.board.max_boards
        ):
            raise InvalidInput(
                f"one link drives 1 to {self.codec.board.max_boards} {board} boards, not {boards}.",
                code="sizes_differ",
            )
        self.elements = boards * len(self.codec.board)
        self.boards = boards
        self.last = None
        self.sent = 0
        self.holder = os.getpid()
        self._open = False
        self._locked: int | None = None
        self._elsewhere: Callable[..., Any] | None = None

    def __del__(self) -> None:
        self._unlock()

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_elsewhere": None, "_locked": None}

    @property
    def levels(self) -> Levels:
        """What its boards can play."""
        return self.codec.levels

    @property
    def fastest_frames(self) -> float:
        """Frames a second that the boards take: what the link carries, and their own serial line."""
        return min(self.fastest, self.codec.fastest_frames(self.boards))

    @property
    def devices(self) -> str:
        """How many boards of what kind, in words."""
        return counted(
            self.boards, f"{self.codec.board.name} board", f"{self.codec.board.name} boards"
        )

    def open(self) -> None:
        """Open the link; the boards are silent when this returns.

        Raises
        ------
        InvalidInput
            If what it needs is not there: a library, a port, a device; or if another process uses the boards.
        LinkFailed
            If the boards do not answer.
        """
        self.last = None
        self.sent = 0
        resource = self._resource()
        self._locked = None if resource is None else lock_boards(resource, self.holder)
        try:
            with self._reporting("opening"):
                self._begin()
        except BaseException:
            self._unlock()
            raise
        self._open = True

    def send(self, frame: Frame) -> None:
        """Send one frame; the boards play it from then on.

        Raises
        ------
        InvalidInput
            If the frame is for another number of elements or other levels, or the link is not open.
        LinkFailed
            If the link fails.
        """
        self._check(frame)
        with self._reporting("sending"):
            self._transmit(frame)
        self.last = frame
        self.sent += 1

    def play(self, frames: Sequence[Frame], rate: float) -> None:
        """Have the boards repeat a sequence by themselves at a rate [frames/s], if ``plays_itself``.

        Raises
        ------
        InvalidInput
            As ``send`` and ``check_sequence``, or if the boards cannot.
        LinkFailed
            If the link fails.
        """
        if not self.plays_itself:
            raise InvalidInput(
                f"{self.codec.board.name} boards keep 0 sequences: send frame by frame.",
                code="not_supported",
            )
        for frame in frames:
            self._check(frame)
        self.check_sequence(len(frames), rate)
        with self._reporting("sending"):
            self._upload(frames, rate)
        self.last = frames[-1]
        self.sent += len(frames)

    def check_sequence(self, frames: int, rate: float) -> None:
        """Check that the boards and the link can play so many frames at a rate [frames/s], or name the nearest.

        Raises
        ------
        InvalidInput
            If there is no frame, or the rate is not above zero or over ``fastest``.
        """
        if frames < 1:
            raise InvalidInput(f"a sequence needs at least 1 frame, not {frames}.", code="empty")
        if positive(rate, "the rate of a sequence", "frames/s") > self.fastest:
            raise InvalidInput(
                f"{rate:g} frames/s are more than the {self.name} link carries to {self.devices}: the nearest is "
                f"{np.floor(self.fastest):g} frames/s.",
                code="out_of_range",
            )

    def check_elements(self, count: int) -> None:
        """Raise "sizes_differ" where a drive or a frame is for another number of elements than the boards have."""
        if count != self.elements:
            raise InvalidInput(
                f"a drive for {counted(count, 'element', 'elements')} does not fit {self.devices} of "
                f"{len(self.codec.board)}: make it for {self.elements}.",
                code="sizes_differ",
            )

    def stop(self) -> None:
        """Silence the boards; those that can confirm it.

        Raises
        ------
        LinkFailed
            If that fails: the boards may still emit.
        """
        if not self._open:
            return
        with self._reporting("silencing"):
            self._silence()
        self.last = self.zero()
        self.sent += 1

    def probe(self) -> None:
        """Check that the boards are still connected, where the link can, while they go on emitting.

        Raises
        ------
        LinkFailed
            If they are not.
        """
        if self._open:
            with self._reporting("looking for the boards"):
                self._look()

    def close(self) -> None:
        """Close the connection; boards go on emitting, so call ``stop`` before."""
        if self._open:
            self._open = False
            try:
                with self._reporting("closing"):
                    self._end()
            finally:
                self._unlock()

    def modulate(self, envelope: Float64[np.ndarray, "frames"] | None, rate: float) -> None:
        """Have the boards vary the amplitude of all frames that are sent from now on, if ``modulates_itself``.

        Parameters
        ----------
        envelope : factors on the amplitudes, from 0 to 1, over one period; None for none.
        rate : factors a second.
        """
        raise NotImplementedError

    def collect(self) -> None:  # noqa: B027 (most links keep nothing)
        """Bring here what the link has kept in another process, before that ends."""

    def zero(self) -> Frame:
        """Return the frame in which all elements are off."""
        nothing = np.zeros(self.elements, dtype=np.uint8)
        return Frame(nothing, nothing, self.levels)

    def _resource(self) -> str | None:
        """Name what only one process may use at a time, such as a port; None where there is no such thing."""
        return None

    def _unlock(self) -> None:
        locked = getattr(self, "_locked", None)
        self._locked = None
        if locked is not None:
            os.close(locked)

    @abstractmethod
    def _begin(self) -> None: ...

    @abstractmethod
    def _transmit(self, frame: Frame) -> None: ...

    def _upload(self, frames: Sequence[Frame], rate: float) -> None:
        raise NotImplementedError

    def _silence(self) -> None:
        self._transmit(self.zero())

    def _look(self) -> None:  # noqa: B027 (links that cannot check do nothing)
        """Raise what ``_reporting`` understands if the boards are gone; links that cannot check do nothing."""

    @abstractmethod
    def _end(self) -> None: ...

    def _check(self, frame: Frame) -> None:
        of_kind(frame, Frame, "what is sent", "quantise(drive, link.levels)")
        if not self._open:
            raise InvalidInput(
                f"the {self.name} link is not open ({self.sent} frames sent): open it first.",
                code="link_closed",
            )
        self.check_elements(len(frame))
        if not self.levels.same_as(frame.levels):
            raise InvalidInput(
                f"a frame of {len(frame.levels.amplitudes)} amplitudes and {frame.levels.phases} phases is not for "
                f"{self.codec.board.name}, which has {len(self.levels.amplitudes)} and {self.levels.phases}: quantise "
                "the drive with link.levels.",
                code="sizes_differ",
            )

    @contextmanager
    def _reporting(self, doing: str) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise self._failed(doing, error.strerror or str(error)) from error

    def _failed(self, doing: str, why: str) -> LinkFailed:
        """Build the error that the link failed, with what was sent last."""
        if self.last is None:
            done = "nothing was sent before"
        elif self.last.silent:
            done = f"the last of {self.sent} frames sent was silence"
        else:
            on = int(np.count_nonzero(self.last.amplitude))
            done = f"the last of {self.sent} frames sent had {on} of {self.elements} elements on"
        return LinkFailed(
            f"the {self.name} link failed while {doing}: {why}; {done}.",
            self.last,
            self.sent,
            code="link_failed",
        )


class RecordingLink(Link):
    """Records what it is sent, for tests and trials.

    Attributes
    ----------
    frames : what was sent.
    seconds : when, counted from opening.
    """

    name = "recording"

    def __init__(self, board: str = "autd3", boards: int = 1) -> None:
        super().__init__(board, boards)
        self._frames: list[Frame] = []
        self._seconds: list[float] = []

    @property
    def frames(self) -> list[Frame]:
        """What was sent."""
        self.collect()
        return self._frames

    @property
    def seconds(self) -> list[float]:
        """When it was sent, counted from opening [s]."""
        self.collect()
        return self._seconds

    def collect(self) -> None:
        """Bring here what was recorded in another process."""
        while self._elsewhere is not None:
            frames, seconds = self._elsewhere("recorded", len(self._frames))
            if not frames:
                return
            self._frames += frames
            self._seconds += seconds

    def recorded(self, first: int) -> tuple[list[Frame], list[float]]:
        """Return some frames from the ``first`` on, and when they were sent; none at the end."""
        # 64: number of recorded frames that one process passes to another at once.
        some = slice(first, first + 64)
        return self._frames[some], self._seconds[some]

    def _begin(self) -> None:
        self._frames = []
        self._seconds = []
        self._begun = time.monotonic()

    def _transmit(self, frame: Frame) -> None:
        self._frames.append(frame)
        self._seconds.append(time.monotonic() - self._begun)

    def _end(self) -> None:
        pass


def lock_boards(resource: str, holder: int) -> int | None:
    """Reserve boards until the file that is returned is closed; None where the system has no such locks.

    Parameters
    ----------
    resource : what they are reached through, such as a port.
    holder : number of the process that others are referred to.

    Raises
    ------
    InvalidInput
        "link_in_use": another process holds them, with its number.
    """
    try:
        import fcntl
    except ImportError:
        return None
    name = f"airtact-{hashlib.sha256(resource.encode()).hexdigest()[:16]}.lock"
    path = Path(tempfile.gettempdir()) / name
    try:
        file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
    except PermissionError:
        file = os.open(path, os.O_RDONLY | os.O_CLOEXEC)  # another user's: enough for the lock
    # 0.5: how long a link waits for the one before it to close [s].
    end = time.monotonic() + 0.5
    while True:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            break
        except BlockingIOError:
            if time.monotonic() > end:
                first = os.pread(file, 40, 0).decode(errors="replace").strip() or "0"
                os.close(file)
                raise InvalidInput(
                    f"{resource} is in use by the process {first}: end it first.",
                    code="link_in_use",
                ) from None
            time.sleep(0.02)
    with suppress(OSError):
        os.ftruncate(file, 0)
        os.pwrite(file, str(holder).encode(), 0)
    return file
