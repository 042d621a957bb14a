"""Safe emission: ramp, cap, watchdog, and silence at the end in every case."""

import atexit
import re
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
from jaxtyping import Complex128, Float64

from airtact.acoustics.medium import air
from airtact.drives.drive import Drive, check_drive
from airtact.drives.frame import Frame, check_cap
from airtact.drives.head_level import HeadLevel
from airtact.drives.sequence import Sequence
from airtact.emission.link import Link, LinkFailed
from airtact.emission.link_process import LinkProcess
from airtact.emission.player import Settings
from airtact.errors import InvalidInput, number, of_kind, positive
from airtact.transducers.levels import AmplitudeModulation


@dataclass(frozen=True)
class Played:
    """Statistics of a playback, as returned by ``Emission.play`` and ``Emission.modulate``.

    Attributes
    ----------
    rate : measured rate of the frames sent [frames/s], or the requested rate if the boards played
        the sequence themselves.
    frames : number of frames that were sent, or that the boards played themselves.
    dropped : number of frames dropped because they would have been late; 0 if the boards played the
        sequence themselves.
    """

    rate: float
    frames: int
    dropped: int


class Emission:
    """Emission of drives by boards. It always ends in silence.

    ``send`` plays a drive, and ``cycle`` a sequence, until the next call. ``play`` plays a
    sequence, ``modulate`` plays a drive of varying amplitude, and ``hold`` keeps the current sound,
    each for a number of seconds. ``set_modulation`` applies to the current and later drives,
    ``silence`` fades the sound, ``stop`` silences the boards at once and for good, and ``beat``
    only shows that the program is still running.

    Use an emission as a context manager: ``with Emission(link) as emission:``. A separate process
    opens the link and ramps up the amplitude. It silences the boards, and waits for their
    confirmation, when the block ends or this process ends for any reason. It does the same if
    ``patience`` seconds pass without a call of ``send``, ``hold``, ``play``, ``cycle``,
    ``modulate``, ``set_modulation``, ``silence`` or ``beat``. In all these cases the emission ends,
    except that a late call continues it if ``resumes`` is True. SIGINT, SIGTERM and SIGHUP in the
    main thread raise ``KeyboardInterrupt`` or ``SystemExit``, which ends the block.

    If the link process itself is killed, the next call raises ``LinkFailed``, and another process
    opens the link and silences the boards. Links that cannot be passed to another process,
    such as those of a class defined in the main script, are opened in this process instead, as are
    all links on systems without POSIX. A warning then states that the boards keep emitting if this
    process is killed.

    Parameters
    ----------
    link : link to the boards, which the emission opens and closes.
    cap : largest amplitude of an element, as a fraction of full scale; larger drives are
        scaled down. By default, each drive is limited to a level of 110 dB SPL at a head 0.5 m
        from the array in open air. Computing this limit takes about 50 ms for 1,000 elements.
        A cap of 1 allows full scale.
    ramp : duration of the ramp from silence to the first drive [s], 0 or more.
    patience : time without a call after which the boards are silenced [s], above 0.
    log : file to which the link process writes one line per event: the time in seconds on the
        clock of ``time.monotonic``, and the event. An earlier log is replaced; any other existing
        file raises ``InvalidInput``. By default, no log is written.
    resumes : whether the emission continues after the boards have been silenced because no call was
        made in time; the next drive is then ramped up. Otherwise the emission ends.

    Attributes
    ----------
    cap : largest amplitude of an element, as a fraction of full scale; it may be changed during the
        emission.
    process : id of the process that opened the link; None before the link is opened, after the
        emission has ended, or if this process opened the link.
    share : factor by which the ramp scaled the latest drive when it was sent; below 1 during a
        ramp.

    Raises
    ------
    InvalidInput
        If the cap is not in the interval (0, 1], or a time is outside its range. Without a cap, a
        drive is rejected if it is too loud for boards that only switch elements on and off, or if
        the poses of several boards are unknown.
    """

    link: Link

    def __init__(
        self,
        link: Link,
        *,
        cap: float | None = None,
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
            # The path is absolute because the link process may have another working directory.
            file = Path(of_kind(log, str | Path, "the log", "a path")).absolute()
        self.link = link
        self.share: float = 1.0
        self.cap: float | None = None if cap is None else check_cap(cap)
        self._settings = Settings(
            ramp=float(ramp),
            patience=positive(patience, "the patience of the watchdog", "s"),
            log=file,
            resumes=resumes,
        )
        self._inside = 0
        self._signal: int | None = None
        self._over = "it has not begun"
        self._link_process: LinkProcess | None = None
        self._handlers: dict[int, Any] = {}

    def __enter__(self) -> "Emission":
        if self._settings.log is not None:
            # The file is emptied here, so that an unwritable file is rejected before anything is
            # sent. The link process appends to it.
            try:
                with self._settings.log.open("a+b") as log:
                    log.seek(0)
                    first = log.readline(64)
                    if first and not re.match(rb"\d+\.\d{6} ", first):
                        raise InvalidInput(
                            f"{self._settings.log} is not the log of an emission, and would be "
                            "overwritten: choose another file.",
                            code="would_overwrite",
                        )
                    log.truncate(0)
            except OSError as error:
                raise InvalidInput(
                    f"the log {self._settings.log} cannot be written (error {error.errno}): "
                    f"{error.strerror}. Choose another file.",
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
                # A link in this process ends with it; a link process notices the end by itself.
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
        # The exception of a signal must not replace an exception that is already being raised.
        if kind is None:
            self._obey()

    def _end(self) -> None:
        process = self._link_process
        if process is None:
            return
        atexit.unregister(self._end)
        failed: LinkFailed | None = None
        try:
            process.ask("finish", "it has ended")
            self.link.collect()
        except LinkFailed as error:
            failed = error
        finally:
            self._link_process = None
            self.link._elsewhere = None
            try:
                self._over = process.close() or "it has ended"
            except LinkFailed as error:
                self._over = "the link process was lost"
                # If silence was confirmed, an error on closing does not matter, unless the link
                # process was lost. A failure to silence the boards is the more serious error.
                silenced = failed is None or failed.code != "silence_failed"
                if error.code != "link_failed" and silenced:
                    failed = error
        if failed is not None:
            raise failed

    @property
    def process(self) -> int | None:
        """Id of the process that opened the link; None if it is this process or no link is open."""
        return None if self._link_process is None else self._link_process.process

    def send(self, drive: Drive, wait: bool = True, at: float | None = None) -> Frame:
        """Play a drive continuously. After silence, its amplitude is ramped up.

        Parameters
        ----------
        drive : complex amplitudes of all elements.
        wait : whether to wait for the end of the ramp. ``share`` shows the progress of the ramp.
        at : time at which the drive takes effect, on the clock of ``time.monotonic`` [s]. It may be
            at most the link's ``lead`` in the future. During a ramp, and on links without a lead,
            the drive takes effect at once.

        Returns
        -------
        The frame that the boards play at the end of the ramp, at the peak of any modulation.

        Raises
        ------
        InvalidInput
            If the drive and the boards have different numbers of elements.
        LinkFailed
            If the link fails or the emission has ended.
        """
        check_drive(drive, "the drive to emit")
        self.link.check_elements(len(drive))
        return self._play(drive.amplitudes[None], np.ones(1), 0.0, wait, at)

    def cycle(self, sequence: Sequence, wait: bool = True) -> None:
        """Start to play a sequence, which repeats until the next call.

        A sequence of the same length as the previous one continues at the same position. Any
        modulation ends. The first sequence is ramped up; if boards repeat it themselves,
        only its most powerful frame is played during the ramp. If ``wait`` is True, the method
        returns after the ramp, otherwise at once.

        Raises
        ------
        InvalidInput
            If the boards or the link cannot play the sequence.
        LinkFailed
            If the link fails, or the emission has already ended.
        """
        self._check_sequence(sequence)
        self._play(sequence.drives, np.ones(len(sequence)), sequence.rate, wait)

    def play(self, sequence: Sequence, seconds: float) -> Played:
        """Repeat a sequence for ``seconds`` after the ramp, and return statistics of the playback.

        Parameters
        ----------
        sequence : drives and their rate.
        seconds : duration [s].

        Returns
        -------
        Statistics of the playback. Boards that repeat a sequence themselves drop no frames. For
        other boards, frames that are late by a full frame duration are dropped to keep the rate.

        Raises
        ------
        InvalidInput
            If the boards or the link cannot play the sequence.
        LinkFailed
            If the link fails, or the emission has ended or ends during playback.
        """
        self._check_sequence(sequence)
        return self._played(sequence.drives, np.ones(len(sequence)), sequence.rate, seconds)

    def modulate(
        self, drive: Drive, seconds: float, modulation: AmplitudeModulation | None = None
    ) -> Played:
        """Play a drive with amplitude modulation for ``seconds`` after the ramp.

        Skin only feels a modulated drive. By default the force varies as a cosine at 200 Hz. On
        boards without amplitude levels, the number of active elements varies instead. The
        amplitude is ramped up first.

        Parameters
        ----------
        drive : complex amplitudes of all elements.
        seconds : duration [s].
        modulation : frequency and depth of the modulation.

        Returns
        -------
        Statistics of the playback.

        Raises
        ------
        InvalidInput
            If the drive and the boards have different numbers of elements, or the modulation is too
            fast.
        LinkFailed
            If the link fails, or the emission has ended or ends during playback.
        """
        check_drive(drive, "the drive to emit")
        self.link.check_elements(len(drive))
        envelope, rate = self._frames_of(
            AmplitudeModulation() if modulation is None else modulation
        )
        self.link.check_sequence(len(envelope), rate)
        return self._played(drive.amplitudes[None], envelope, rate, seconds)

    def set_modulation(self, modulation: AmplitudeModulation | None) -> None:
        """Modulate the amplitude of the current and all later drives; None ends the modulation.

        The modulation continues without a jump while drives change. AUTD3 boards play the
        modulation themselves. For other boards, each frame of the modulation is computed from the
        latest drive.

        Raises
        ------
        InvalidInput
            If the modulation is too fast for the boards.
        LinkFailed
            If the link fails, or the emission has already ended.
        """
        envelope, rate = (None, 0.0) if modulation is None else self._frames_of(modulation)
        self._ask("modulate", envelope, rate)

    def silence(self, fade: float = 0.1, wait: bool = True) -> None:
        """Fade to silence. The next drive is ramped up.

        Parameters
        ----------
        fade : duration of the fade [s].
        wait : whether to wait for the end of the fade.

        Raises
        ------
        LinkFailed
            If the link fails, or the emission has already ended.
        """
        left = self._ask("silence", positive(fade, "the fade", "s"))
        if wait:
            self._outlast(left)

    def stop(self) -> None:
        """Silence the boards at once and permanently.

        Raises
        ------
        LinkFailed
            If the boards cannot be silenced; they may still emit.
        """
        self._ask("finish", "it was stopped")

    def beat(self) -> None:
        """Reset the watchdog, which would otherwise silence the boards.

        Raises
        ------
        LinkFailed
            If the emission has ended or the link has failed.
        """
        self._ask("beat")

    def hold(self, seconds: float) -> None:
        """Keep the boards playing for a number of seconds.

        Raises
        ------
        LinkFailed
            If the link fails, or the emission has ended or ends during this time.
        """
        self.beat()
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            time.sleep(min(left, self._pause))
            self.beat()

    def _frames_of(
        self, modulation: AmplitudeModulation
    ) -> tuple[Float64[np.ndarray, "frames"], float]:
        """Return the factors of a modulation over one period, and their rate [1/s]."""
        of_kind(
            modulation,
            AmplitudeModulation,
            "the modulation",
            "AmplitudeModulation(frequency, depth)",
        )
        count, rate = frames_of_period(modulation.frequency, self.link.fastest_frames)
        return modulation.envelope(count), rate

    def _check_sequence(self, sequence: Sequence) -> None:
        of_kind(sequence, Sequence, "the sequence to play", "Sequence(drives, rate)")
        self.link.check_elements(sequence.drives.shape[1])
        self.link.check_sequence(len(sequence), sequence.rate)

    def _play(
        self,
        drives: Complex128[np.ndarray, "drives elements"],
        factors: Float64[np.ndarray, "frames"],
        rate: float,
        wait: bool = True,
        at: float | None = None,
    ) -> Frame:
        cap = self.cap
        if cap is None:
            self.beat()
            link = self.link
            if link.poses is None:
                raise InvalidInput(
                    f"the poses of the {link.boards} boards of the {link.name} link are unknown, "
                    "so no safe level can be computed: set a cap, such as 0.1.",
                    code="key_missing",
                )
            elements = link.codec.board.positions
            positions = np.concatenate([pose.apply(elements) for pose in link.poses])
            wavenumber = air().wavenumber(40e3).real
            cap = HeadLevel(drives, positions, link.levels, wavenumber).safe_cap()
        frame, left, self.share = self._ask("play", drives, factors, rate, cap, at)
        if wait:
            self._outlast(left)
        return frame

    def _played(
        self,
        drives: Complex128[np.ndarray, "drives elements"],
        factors: Float64[np.ndarray, "frames"],
        rate: float,
        seconds: float,
    ) -> Played:
        self._play(drives, factors, rate)
        dropped_before = self._ask("dropped")
        sent_before = self.link.sent
        begun = time.monotonic()
        self.hold(seconds)
        if self.link.plays_itself:
            return Played(rate, max(round(seconds * rate), 1), 0)
        dropped = self._ask("dropped") - dropped_before
        sent = self.link.sent - sent_before
        return Played(sent / (time.monotonic() - begun), sent, dropped)

    def _outlast(self, left: float) -> None:
        while left > 0.0:
            time.sleep(min(left, self._pause))
            left = self._ask("beat")

    @property
    def _pause(self) -> float:
        return min(self._settings.patience / 5.0, 0.05)

    def _ask(self, name: str, *arguments: Any) -> Any:
        """Call a method of the link's player; no signal can interrupt the call."""
        with self._shielded():
            if self._link_process is None:
                raise self.link.emission_over(self._over)
            answer = self._link_process.ask(name, *arguments)
        self._obey()
        return answer

    # --- signals ---

    @contextmanager
    def _shielded(self) -> Iterator[None]:
        """Postpone signals while the main thread, which receives them, uses the link."""
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
            # A process started with nohup continues after its terminal is closed.
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
        """End the emission if a signal is pending. Only the main thread handles signals."""
        if self._signal is None or threading.current_thread() is not threading.main_thread():
            return
        kind = self._signal
        self._signal = None
        if self._link_process is not None:
            with self._shielded():
                self._link_process.ask(
                    "finish", f"it received the signal {signal.Signals(kind).name}"
                )
        if kind == signal.SIGINT:
            raise KeyboardInterrupt
        # Shells report this exit status for a process that a signal ended.
        raise SystemExit(128 + kind)


def frames_of_period(frequency: float, fastest: float) -> tuple[int, float]:
    """Choose the number of frames per period of a modulation, and their rate [frames/s].

    On boards without a rate limit, a frame lasts a whole number of periods of the 40 kHz sound. The
    number of frames, from 16 to 40, is the one that best matches the frequency; if several match
    equally well, it is the one nearest to 20. Slower serial lines get an even number of frames,
    up to 20; with 2 frames the sound is switched on and off.

    Parameters
    ----------
    frequency : modulation frequency [Hz].
    fastest : largest rate of the boards [frames/s].

    Raises
    ------
    InvalidInput
        If the boards cannot play the frequency. The message states the nearest possible frequency.

    Examples
    --------
    >>> frames_of_period(200.0, np.inf), frames_of_period(40.0, 88.0)
    ((20, 4000.0), (2, 80.0))
    """
    if np.isfinite(fastest):
        # 1e-9 is added because rounding may leave a whole quotient slightly too small.
        count = int(fastest / frequency + 1e-9)
        if count < 2:
            nearest = np.floor(fastest / 2)
            raise InvalidInput(
                f"an amplitude modulation of {frequency:g} Hz needs {2 * frequency:g} frames/s, "
                f"but the boards only accept {fastest:.4g}: use {nearest:g} Hz or less, such as "
                f"--modulate am:{nearest:g}.",
                code="out_of_range",
            )
        count = min(count - count % 2, 20)
        return count, count * frequency
    if frequency > 40e3 / 40:
        raise InvalidInput(
            f"an amplitude modulation of {frequency:g} Hz is too fast: the fastest is "
            f"{40e3 / 40:g} Hz.",
            code="out_of_range",
        )
    counts = np.arange(16, 41)
    periods = np.maximum(np.rint(40e3 / (frequency * counts)), 1.0)
    error = np.round(np.abs(40e3 / (periods * counts) / frequency - 1.0), 9)
    best = np.lexsort((np.abs(counts - 20), error))[0]
    return int(counts[best]), float(40e3 / periods[best])
