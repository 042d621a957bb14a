"""Safe emission: a ramp, a cap, a watchdog, and silence however it ends."""

import atexit
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any

import numpy as np

from airtact.drives.drive import Drive, check_drive
from airtact.drives.frame import Frame, check_cap
from airtact.drives.sequence import Sequence
from airtact.emission.amplitudes import frames_of_period
from airtact.emission.feeding import LinkProcess
from airtact.emission.link import Link, LinkFailed
from airtact.emission.player import Settings
from airtact.errors import InvalidInput, number, of_kind, positive
from airtact.transducers.modulation import AmplitudeModulation


@dataclass(frozen=True)
class Played:
    """What was played of a sequence.

    Attributes
    ----------
    rate : measured rate [frames/s].
    frames : number of frames that were sent or that the boards began themselves.
    dropped : number of frames left out because they would have been late.
    """

    rate: float
    frames: int
    dropped: int


class Emission:
    """Sound from boards, silenced however it ends.

    Use it as ``with Emission(link) as emission:``. A process of its own opens the link, raises the
    sound over a ramp and sends a confirmed frame of zeros: when the block is left, when this
    process is gone for whatever reason, and when half a second passes without ``send``, ``hold``,
    ``play``, ``cycle``, ``modulate``, ``set_modulation``, ``silence`` or ``beat``. Nothing can be
    sent after that, except where calls came too late and the emission ``resumes``. SIGINT, SIGTERM
    and SIGHUP in the main thread leave the block by ``KeyboardInterrupt`` or ``SystemExit``.

    If the link process itself is killed, the next call raises ``LinkFailed``, and another process
    opens the link and silences the boards. A link whose class is defined in the script itself, or
    any link on a system without POSIX, is opened in this process, and a warning says so: the boards
    then go on emitting if this process is killed.

    Parameters
    ----------
    link : the way to the boards, opened and closed here.
    cap : largest amplitude of an element, a share of full scale; drives above it are scaled down.
    ramp : duration of the ramp [s].
    patience : time that boards emit without a call [s].
    log : file to which the link process writes one line per event: the time on the system's
        monotonic clock (``time.monotonic``) [s], and the event.
    resumes : whether boards that were silenced because no call came take the next drive, over the
        ramp.

    Attributes
    ----------
    process : number of the process that holds the link; None where it is this one, or before it is
        open.
    share : share of the newest drive's amplitude that the boards played when it was sent; below 1
        on a ramp.

    Raises
    ------
    InvalidInput
        If the cap is not above 0 and at most 1, or a time is negative or not finite.
    """

    link: Link

    def __init__(
        self,
        link: Link,
        *,
        cap: float = 1.0,
        ramp: float = 0.2,
        patience: float = 0.5,
        log: str | Path | None = None,
        resumes: bool = False,
    ) -> None:
        of_kind(link, Link, "the link", "one such as AUTD3Link(poses)")
        if not 0.0 <= number(ramp, "the ramp", "s") < np.inf:
            raise InvalidInput(
                f"the ramp is {ramp:g} s, but it must be 0 or more.", code="out_of_range"
            )
        file = None
        if log is not None:
            # Absolute: the link process may stand in another folder.
            file = Path(of_kind(log, str | Path, "the log", "a path")).absolute()
        self.link = link
        self.share: float = 1.0
        self._settings = Settings(
            cap=check_cap(cap),
            ramp=float(ramp),
            patience=positive(patience, "the patience of the watchdog", "s"),
            log=file,
            resumes=resumes,
        )
        self._inside = 0
        self._signal: int | None = None
        self._over = "it was not begun"
        self._link_process: LinkProcess | None = None
        self._handlers: dict[int, Any] = {}

    def __enter__(self) -> "Emission":
        if self._settings.log is not None:
            # Emptied here and appended to by the link process: a file that cannot be written is
            # rejected before anything is sent.
            try:
                self._settings.log.write_text("")
            except OSError as error:
                raise InvalidInput(
                    f"the log {self._settings.log} cannot be written (error {error.errno}): "
                    f"{error.strerror}.",
                    code="not_writable",
                ) from None
        with self._shielded():
            self._listen()
            try:
                self._link_process = LinkProcess(self.link, self._settings)
            except BaseException:
                self._unlisten()
                raise
            if self._link_process.process is None:
                # A link in this process ends with it; one in another process notices by itself.
                atexit.register(self._end)
            else:
                self.link._elsewhere = lambda name, *arguments: self._ask("ask", name, *arguments)
        try:
            self._obey()
        except BaseException as error:
            self.__exit__(type(error), error, error.__traceback__)
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with self._shielded():
            try:
                self._end()
            finally:
                self._unlisten()
        # An exception on its way out must not be replaced by that of a signal.
        if kind is None:
            self._obey()

    def _end(self) -> None:
        process = self._link_process
        if process is None:
            return
        atexit.unregister(self._end)
        failed: LinkFailed | None = None
        try:
            process.ask("finish", "it was ended")
            self.link.collect()
        except LinkFailed as error:
            failed = error
        finally:
            self._link_process = None
            self.link._elsewhere = None
            try:
                self._over = process.close() or "it was ended"
            except LinkFailed as error:
                self._over = "the link process was lost"
                # Where silence was confirmed, an error on closing adds nothing, unless the link
                # process was lost. Silence that failed is the graver fault.
                silenced = failed is None or failed.code != "silence_failed"
                if error.code != "link_failed" and silenced:
                    failed = error
        if failed is not None:
            raise failed

    @property
    def process(self) -> int | None:
        """Number of the process that holds the link; None if it is this one, or not open."""
        return None if self._link_process is None else self._link_process.process

    def send(self, drive: Drive, wait: bool = True, outlast: bool = True) -> Frame:
        """Play a drive from now on; the first drive, and one after silence, rise over the ramp.

        Parameters
        ----------
        drive : amplitude of every element.
        wait : whether to return only when the boards have the frame. Otherwise the next call raises
            what fails on the way.
        outlast : whether to wait for the end of the ramp as well; otherwise ``share`` holds how far
            the ramp has come.

        Returns
        -------
        The frame that the boards play at the end of the ramp and at full amplitude of a modulation.

        Raises
        ------
        InvalidInput
            If the drive is for another number of elements.
        LinkFailed
            If the link fails, or the emission was ended before.
        """
        check_drive(drive, "what is emitted")
        self.link.check_elements(len(drive))
        frame, left, self.share = self._ask("send", drive.amplitudes, wait)
        # The link process holds the real link; this copy only reports.
        self.link.last = frame
        if wait and outlast:
            self._outlast(left)
        return frame

    def set_modulation(self, modulation: AmplitudeModulation | None) -> None:
        """Modulate the amplitude of all that ``send`` plays from now on, or stop that.

        The modulation goes on without a jump while drives change. AUTD3 boards play it themselves;
        other boards are sent the newest drive for each of its frames.

        Raises
        ------
        InvalidInput
            If the modulation is too fast for the boards (the fastest).
        LinkFailed
            If the link fails, or the emission was ended before.
        """
        if modulation is None:
            self._ask("modulate", None, 0.0)
            return
        of_kind(
            modulation,
            AmplitudeModulation,
            "the modulation",
            "AmplitudeModulation(frequency, depth)",
        )
        count, rate = frames_of_period(modulation.frequency, self.link.fastest_frames)
        self._ask("modulate", modulation.envelope(count), rate)

    def cycle(self, sequence: Sequence, outlast: bool = True) -> None:
        """Repeat the frames of a sequence from now on.

        A sequence of the same length and rate as the one before continues at the same place in the
        round. A modulation ends. The first sequence rises over the ramp; where boards repeat it
        themselves, only its most powerful frame does. A file gets the frame that is due.
        ``outlast`` is that of ``send``.

        Raises
        ------
        InvalidInput
            As ``play``.
        LinkFailed
            If the link fails, or the emission was ended before.
        """
        of_kind(sequence, Sequence, "what is played", "Sequence(drives, rate)")
        self.link.check_elements(sequence.drives.shape[1])
        self.link.check_sequence(len(sequence), sequence.rate)
        left, self.share = self._ask("cycle", sequence.drives, sequence.rate)
        if outlast:
            self._outlast(left)

    def silence(self, fade: float = 0.1, wait: bool = True) -> None:
        """Fade to silence; the next drive rises over the ramp.

        Parameters
        ----------
        fade : duration [s].
        wait : whether to return only when it is over.

        Raises
        ------
        LinkFailed
            If the link fails, or the emission was ended before.
        """
        left = self._ask("silence", positive(fade, "the fade", "s"))
        if wait:
            self._outlast(left)

    def stop(self) -> None:
        """Silence the boards at once, for good.

        Raises
        ------
        LinkFailed
            If that fails: the boards may still emit.
        """
        self._ask("finish", "it was stopped")

    def beat(self) -> None:
        """Keep the watchdog from silencing the boards.

        Raises
        ------
        LinkFailed
            If the emission was ended before, or the link has failed.
        """
        self._ask("beat")

    def hold(self, seconds: float) -> None:
        """Keep the boards playing for some time [s].

        Raises
        ------
        LinkFailed
            If the emission was ended before or meanwhile, or the link fails.
        """
        self.beat()
        # A file has no time to hold.
        if not self.link.real_time:
            return
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            time.sleep(min(left, self._pause))
            self.beat()

    def play(self, sequence: Sequence, seconds: float) -> Played:
        """Repeat a sequence for some time, after its most powerful frame has risen over the ramp.

        Parameters
        ----------
        sequence : drives and their rate.
        seconds : duration [s].

        Returns
        -------
        What was played. Boards that repeat a sequence themselves drop nothing; otherwise frames
        that would be late by a whole frame are dropped, which keeps the rate.

        Raises
        ------
        InvalidInput
            If the boards or the link cannot play it.
        LinkFailed
            If the link fails, or the emission was ended before or meanwhile.
        """
        of_kind(sequence, Sequence, "what is played", "Sequence(drives, rate)")
        self.link.check_elements(sequence.drives.shape[1])
        self.link.check_sequence(len(sequence), sequence.rate)
        self._outlast(
            self._ask("play", sequence.drives, np.ones(len(sequence)), sequence.rate, seconds)
        )
        return Played(*self._ask("played"))

    def modulate(
        self, drive: Drive, seconds: float, modulation: AmplitudeModulation | None = None
    ) -> Played:
        """Play a drive with amplitude modulation for some time [s].

        Skin only feels a modulated drive. By default the force follows a cosine of 200 Hz. Boards
        without levels of amplitude vary the number of elements that are on. The drive rises over
        the ramp.

        Returns
        -------
        What was played.

        Raises
        ------
        InvalidInput
            If the drive is for another number of elements, or the modulation is too fast.
        LinkFailed
            As ``play``.
        """
        check_drive(drive, "what is emitted")
        modulation = AmplitudeModulation() if modulation is None else modulation
        of_kind(
            modulation,
            AmplitudeModulation,
            "the modulation",
            "AmplitudeModulation(frequency, depth)",
        )
        self.link.check_elements(len(drive))
        count, rate = frames_of_period(modulation.frequency, self.link.fastest_frames)
        self.link.check_sequence(count, rate)
        self._outlast(
            self._ask("play", drive.amplitudes[None], modulation.envelope(count), rate, seconds)
        )
        return Played(*self._ask("played"))

    def _outlast(self, left: float) -> None:
        """Wait until a ramp or a sequence is over, which still takes ``left`` [s]."""
        while left > 0.0:
            time.sleep(min(left, self._pause))
            left = self._ask("beat")

    @property
    def _pause(self) -> float:
        return min(self._settings.patience / 5.0, 0.05)

    def _ask(self, name: str, *arguments: Any) -> Any:
        """Have the link's player do something; no signal can interrupt it."""
        with self._shielded():
            if self._link_process is None:
                raise self.link.emission_over(self._over)
            answer = self._link_process.ask(name, *arguments)
        self._obey()
        return answer

    # --- signals ---

    @contextmanager
    def _shielded(self) -> Iterator[None]:
        """Put signals off while the link is in use by the main thread, which receives them."""
        step = int(threading.current_thread() is threading.main_thread())
        self._inside += step
        try:
            yield
        finally:
            self._inside -= step

    def _listen(self) -> None:
        if threading.current_thread() is not threading.main_thread():
            return
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):
            kind = getattr(signal, name, None)
            # A process that was started with nohup outlives its terminal.
            by_nohup = name == "SIGHUP" and kind and signal.getsignal(kind) == signal.SIG_IGN
            if kind is not None and not by_nohup:
                self._handlers[kind] = signal.signal(kind, self._on_signal)

    def _unlisten(self) -> None:
        for kind, handler in self._handlers.items():
            signal.signal(kind, handler)
        self._handlers = {}

    def _on_signal(self, kind: int, _frame: FrameType | None) -> None:
        self._signal = kind
        if self._inside == 0:
            self._obey()

    def _obey(self) -> None:
        """Act on a signal, now that nothing is being sent; a signal ends the main thread only."""
        if self._signal is None or threading.current_thread() is not threading.main_thread():
            return
        kind = self._signal
        self._signal = None
        if self._link_process is not None:
            with self._shielded():
                self._link_process.ask("finish", f"of the signal {signal.Signals(kind).name}")
        if kind == signal.SIGINT:
            raise KeyboardInterrupt
        # The exit status of shells for a process that a signal ended.
        raise SystemExit(128 + kind)
