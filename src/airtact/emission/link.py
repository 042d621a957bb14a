"""The base class of links to boards, and a link that records frames."""

import hashlib
import os
import tempfile
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from airtact.drives.frame import Frame
from airtact.emission.codecs import Codec, codec_of
from airtact.errors import InvalidInput, counted, of_kind, positive
from airtact.geometry.pose import Pose
from airtact.transducers.levels import Levels


class LinkFailed(RuntimeError):  # noqa: N818 (reads well in a traceback)
    """Error raised if a link to boards fails after it was opened, or is used after it ended.

    It is a ``RuntimeError``. If the boards stop answering, its message describes the last frame
    sent, which they may still be playing.

    Attributes
    ----------
    code : kind of error, which does not change if the message is reworded: "link_failed" for a
        failed link, "emission_over" for a call after the emission has ended.
    """

    def __init__(self, sentence: str, *, code: str) -> None:
        super().__init__(sentence)
        self.code = code

    def __reduce__(self) -> Any:
        # The default implementation would lose the code, which is a keyword argument.
        return partial(type(self), code=self.code), (str(self),)


class Link(ABC):
    """Connection that sends frames to boards of one kind, or makes them play a sequence.

    This is the abstract base class of the links to the various boards, such as ``SerialLink``. Pass
    a link to ``Emission``, which opens and closes it, and adds the safety features: ramp, cap,
    watchdog, and silence at the end. A link itself sends every frame unchanged. To use it directly,
    call ``open``, then ``send`` for single frames or ``play`` for a sequence, then ``stop`` to
    silence the boards, and finally ``close``. Boards that were not silenced keep emitting after
    ``close``. These methods raise ``LinkFailed`` if the boards fail.

    Parameters
    ----------
    board : name of the kind of the boards, such as "autd3"; see ``Board``.
    boards : number of boards, from 1 to ``Board.max_boards``. Every frame lists the elements board
        by board.

    Attributes
    ----------
    codec : encoder and decoder of the messages to the boards.
    name : name of the link on the command line.
    boards, elements : number of boards, and total number of elements.
    poses : poses of the boards in the array's frame; None if unknown.
    plays_itself : whether boards repeat an uploaded sequence and modulate the amplitude themselves;
        otherwise every frame must be sent in time.
    lead : longest possible delay between sending a frame and its effect [s]; 0 if frames take
        effect on arrival.
    last : last ``Frame`` that was sent; None before the first frame.
    sent : number of frames sent since the link was opened.

    Raises
    ------
    InvalidInput
        If the kind of board is unknown, or one link cannot drive this number of boards.
    """

    name: str
    plays_itself: bool = False
    lead: float = 0.0

    def __init__(self, board: str, boards: int = 1) -> None:
        self.codec: Codec = codec_of(board)
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
        # The level around a single board does not depend on its pose, so any pose is suitable.
        self.poses: Sequence[Pose] | None = [Pose.identity()] if boards == 1 else None
        self.last: Frame | None = None
        self.sent = 0
        self._open = False
        self._locked: int | None = None
        self._elsewhere: Callable[..., Any] | None = None

    def __del__(self) -> None:
        self._unlock()

    def __getstate__(self) -> dict[str, Any]:
        # The lock and the connection to the link process belong to this process.
        return {**vars(self), "_elsewhere": None, "_locked": None}

    @property
    def levels(self) -> Levels:
        """Amplitudes and phases that the boards can play."""
        return self.codec.levels

    @property
    def fastest_frames(self) -> float:
        """Largest frame rate of the boards' serial line [frames/s]; infinite if there is none."""
        return self.codec.fastest_frames(self.boards)

    @property
    def devices(self) -> str:
        """Number and kind of the boards as text, such as "2 autd3 boards"."""
        return counted(
            self.boards, f"{self.codec.board.name} board", f"{self.codec.board.name} boards"
        )

    def open(self) -> None:
        """Open the link. The boards are silent when the method returns.

        Raises
        ------
        InvalidInput
            If a library, a port or a device is missing, or another process uses the boards.
        LinkFailed
            If the boards do not answer.
        """
        self.last = None
        self.sent = 0
        resource = self._resource()
        self._locked = None if resource is None else lock_boards(resource)
        try:
            with self._reporting("opening"):
                self._begin()
        except BaseException:
            self._unlock()
            raise
        self._open = True

    def send(self, frame: Frame, at: float | None = None) -> None:
        """Send one frame, which the boards play until the next one.

        Parameters
        ----------
        frame : amplitude and phase levels of all elements.
        at : time at which the frame takes effect, on the clock of ``time.monotonic`` [s], if the
            link has a ``lead``. By default, or if that time has passed, the frame takes effect when
            it arrives.

        Raises
        ------
        InvalidInput
            If the number of elements or levels of the frame does not match the boards, the link is
            not open, or the time is more than ``lead`` in the future.
        LinkFailed
            If the link fails.
        """
        self._check(frame)
        with self._reporting("sending"):
            if at is None or self.lead == 0.0:
                self._transmit(frame)
            else:
                self._transmit_at(frame, at)
        self.last = frame
        self.sent += 1

    def play(self, frames: Sequence[Frame], rate: float) -> None:
        """Make the boards repeat a sequence by themselves, if they can (``plays_itself``).

        Raises
        ------
        InvalidInput
            If the frames or the rate do not fit the boards, the link is not open, or the boards
            cannot repeat a sequence.
        LinkFailed
            If the link fails.
        """
        if not self.plays_itself:
            raise InvalidInput(
                f"{self.codec.board.name} boards cannot store sequences: send single frames.",
                code="not_supported",
            )
        # All frames are checked before any is sent, so that boards never store half a sequence.
        for frame in frames:
            self._check(frame)
        self.check_sequence(len(frames), rate)
        with self._reporting("sending"):
            self._upload(frames, rate)
        self.last = frames[-1]
        self.sent += len(frames)

    def check_sequence(self, frames: int, rate: float) -> None:
        """Check that the boards and the link can play ``frames`` frames at ``rate`` frames/s.

        Raises
        ------
        InvalidInput
            If there are no frames, or the rate is not above zero or exceeds
            ``fastest_frames``.
        """
        if frames < 1:
            raise InvalidInput(f"a sequence needs at least 1 frame, not {frames}.", code="empty")
        self.codec.check_rate(
            frames, positive(rate, "the rate of a sequence", "frames/s"), self.boards
        )

    def check_elements(self, count: int) -> None:
        """Raise ``InvalidInput`` if ``count`` is not the number of elements of the boards."""
        if count != self.elements:
            raise InvalidInput(
                f"a drive for {counted(count, 'element', 'elements')} does not fit {self.devices} "
                f"of {len(self.codec.board)} elements: compute it for {self.elements} elements.",
                code="sizes_differ",
            )

    def stop(self) -> None:
        """Silence the boards, and wait for their confirmation if they can send one.

        Raises
        ------
        LinkFailed
            If the boards cannot be silenced; they may still emit.
        """
        if not self._open:
            return
        with self._reporting("silencing"):
            self._silence()
        self.last = self.zero()
        self.sent += 1

    def probe(self) -> None:
        """Check, without silencing the boards, whether they are connected, if the link supports it.

        Raises
        ------
        LinkFailed
            If the boards are not connected.
        """
        if self._open:
            with self._reporting("looking for the boards"):
                self._look()

    def close(self) -> None:
        """Close the connection. Boards keep emitting, so call ``stop`` first."""
        if self._open:
            # Count as closed even if this fails: the operating system frees the port.
            self._open = False
            try:
                with self._reporting("closing"):
                    self._end()
            finally:
                self._unlock()

    def modulate(  # noqa: B027 (most boards cannot)
        self, envelope: Float64[np.ndarray, "frames"] | None, rate: float
    ) -> None:
        """Make the boards modulate the current and all later frames, if ``plays_itself`` is True.

        Parameters
        ----------
        envelope : factors for the amplitudes over one period, from 0 to 1; None ends the
            modulation.
        rate : number of factors per second.
        """

    def collect(self) -> None:  # noqa: B027 (most links store nothing)
        """Fetch data stored in the link process, which is about to end."""

    def zero(self) -> Frame:
        """Return a frame with all elements off."""
        nothing = np.zeros(self.elements, dtype=np.uint8)
        return Frame(nothing, nothing, self.levels)

    def _resource(self) -> str | None:
        """Return the name of a resource that only one process may use, such as a port, or None."""
        return None

    def _unlock(self) -> None:
        # __del__ calls this too, even if __init__ failed before the lock existed.
        locked = getattr(self, "_locked", None)
        if locked is not None:
            self._locked = None
            os.close(locked)

    @abstractmethod
    def _begin(self) -> None: ...

    @abstractmethod
    def _transmit(self, frame: Frame) -> None: ...

    def _transmit_at(self, frame: Frame, at: float) -> None:
        raise NotImplementedError

    def _upload(self, frames: Sequence[Frame], rate: float) -> None:
        raise NotImplementedError

    def _silence(self) -> None:
        self._transmit(self.zero())

    def _look(self) -> None:  # noqa: B027 (links that cannot check do nothing)
        """Raise an error, within ``_reporting``, if the boards are no longer connected."""

    @abstractmethod
    def _end(self) -> None: ...

    def _check(self, frame: Frame) -> None:
        of_kind(frame, Frame, "the frame to send", "quantise(drive, link.levels)")
        if not self._open:
            raise InvalidInput(
                f"the {self.name} link is not open ({self.sent} frames sent): open it first.",
                code="link_closed",
            )
        self.check_elements(len(frame))
        if not self.levels.same_as(frame.levels):
            raise InvalidInput(
                f"the frame has {len(frame.levels.amplitudes)} amplitude levels and "
                f"{frame.levels.phases} phase levels, but {self.codec.board.name} boards have "
                f"{len(self.levels.amplitudes)} and {self.levels.phases}: quantise the drive with "
                "link.levels.",
                code="sizes_differ",
            )

    @contextmanager
    def _reporting(self, doing: str) -> Iterator[None]:
        try:
            yield
        except Exception as error:
            # A lost terminal raises termios.error, and the AUTD3 libraries raise their own errors.
            own = type(error).__module__.startswith(("termios", "pyautd3", "autd3"))
            if not isinstance(error, OSError) and not own:
                raise
            why = getattr(error, "strerror", None) or str(error).rstrip(".")
            raise self._failed(doing, why) from error

    def _failed(self, doing: str, why: str) -> LinkFailed:
        if self.last is None:
            done = "nothing was sent before"
        elif self.last.silent:
            done = f"the last of {self.sent} frames sent was silence"
        else:
            on = int(np.count_nonzero(self.last.amplitude))
            done = f"the last of {self.sent} frames sent had {on} of {self.elements} elements on"
        return LinkFailed(
            f"the {self.name} link failed while {doing}: {why}; {done}.",
            code="link_failed",
        )

    def emission_over(self, why: str) -> LinkFailed:
        """Return the error for a call after the emission has ended; ``why`` states the reason."""
        return LinkFailed(
            f"nothing was sent, because the emission is not running: {why} ({self.sent} frames "
            "sent).",
            code="emission_over",
        )


class RecordingLink(Link):
    """Link without boards that only records the frames sent to it, for tests and trials.

    Pass it to ``Emission`` like any other link. Opening the link deletes earlier frames.

    Parameters
    ----------
    board : kind of board to imitate: "autd3", "sonicsurface", "nano16" or "openmpd".
    boards : number of boards, from 1 to the ``max_boards`` of this kind of board.

    Attributes
    ----------
    frames : list of the ``Frame`` objects that were sent, in order; each contains the levels of all
        elements.
    seconds : time from opening the link to sending each of these frames [s].

    Raises
    ------
    InvalidInput
        If there is no such kind of board, or one link cannot drive this number of boards.
    """

    name = "recording"

    def __init__(self, board: str = "autd3", boards: int = 1) -> None:
        super().__init__(board, boards)
        self._frames: list[Frame] = []
        self._seconds: list[float] = []

    @property
    def frames(self) -> list[Frame]:
        """Frames that were sent."""
        self.collect()
        return self._frames

    @property
    def seconds(self) -> list[float]:
        """Time from opening the link to sending each frame [s]."""
        self.collect()
        return self._seconds

    def collect(self) -> None:
        """Fetch the frames recorded in the link process, which is about to end."""
        while self._elsewhere is not None:
            frames, seconds = self._elsewhere("recorded", len(self._frames))
            if not frames:
                return
            self._frames += frames
            self._seconds += seconds

    def recorded(self, first: int) -> tuple[list[Frame], list[float]]:
        """Return up to 64 frames from index ``first`` on, and the time [s] when each was sent."""
        # There are at most 64 because a long message would delay the watchdog.
        return self._frames[first : first + 64], self._seconds[first : first + 64]

    def _begin(self) -> None:
        self._frames = []
        self._seconds = []
        self._begun = time.monotonic()

    def _transmit(self, frame: Frame) -> None:
        self._frames.append(frame)
        self._seconds.append(time.monotonic() - self._begun)

    def _end(self) -> None:
        pass


def lock_boards(resource: str) -> int | None:
    """Lock a resource, such as a serial port, against use by other processes.

    Return the descriptor of the lock file, or None if the system does not support locks. Closing
    the file releases the lock.

    Raises
    ------
    InvalidInput
        If another process uses the boards.
    """
    try:
        import fcntl
    except ImportError:
        return None
    name = f"airtact-{hashlib.sha256(resource.encode()).hexdigest()[:16]}.lock"
    path = Path(tempfile.gettempdir()) / name
    # In a folder shared by all users, a symbolic link could point to another user's file.
    options = os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW
    try:
        try:
            file = os.open(path, options | os.O_CREAT, 0o666)
        except PermissionError:
            file = os.open(path, options)  # created by another user
    except OSError as error:
        raise InvalidInput(
            f"the lock file {path} of {resource} cannot be opened: {error.strerror}. Remove it.",
            code="link_in_use",
        ) from None
    # Wait 0.5 s in case a link is just being closed.
    end = time.monotonic() + 0.5
    while True:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return file
        except BlockingIOError:
            if time.monotonic() > end:
                os.close(file)
                raise InvalidInput(
                    f"{resource} is in use by another process: end that process first.",
                    code="link_in_use",
                ) from None
            time.sleep(0.02)
