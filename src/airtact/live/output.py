"""Output of the live loop: nothing, or boards driven by an ``Emission``."""

from pathlib import Path
from typing import Any

from airtact.drives.drive import Drive
from airtact.drives.frame import check_cap
from airtact.drives.sequence import Sequence
from airtact.emission.emission import Emission
from airtact.emission.link import Link, LinkFailed
from airtact.errors import InvalidInput
from airtact.live.scene import Amplitudes, Frames
from airtact.transducers.levels import AmplitudeModulation, Levels


class Output:
    """Output of the live loop: boards that are connected by a link, or no boards.

    Pass it to ``follow``, or use it in a ``with`` block, which opens the link at the beginning, and
    silences the boards and closes the link at the end. ``send`` emits a drive, ``cycle`` repeats a
    sequence of drives, and ``modulate`` varies the amplitude of later drives. Each call must be
    followed by another, such as ``beat``, within 0.5 s; otherwise the boards are silenced until the
    next drive. Drives above the cap, set by ``limit`` (full scale by default), are scaled down.
    After silence, the amplitude is ramped up over 0.2 s. The methods raise ``LinkFailed`` if the
    boards fail. Without boards, they do nothing.

    Parameters
    ----------
    link : link to the boards; by default, nothing is emitted.
    log : file to which one line per event at the link is written; see ``Emission``.

    Attributes
    ----------
    words : description of the output for the user, such as "no boards".
    stopped : whether ``stop``, the emergency stop, was called. After that, nothing is emitted, and
        methods that use the boards raise ``LinkFailed`` with the code "emission_over".
    levels : amplitude and phase levels that the boards can emit; None if there are no boards.
    lead : longest possible delay between sending a drive and its effect [s]; 0 if drives take
        effect on arrival.
    """

    words: str = "no boards"
    stopped: bool = False
    levels: Levels | None = None
    lead: float = 0.0
    _emission: Emission | None = None

    def __init__(self, link: Link | None = None, log: Path | None = None) -> None:
        if link is not None:
            self._emission = Emission(link, cap=1.0, log=log, resumes=True)
            self.levels = link.levels
            self.lead = link.lead
            self.words = f"{link.devices} through {link.name}"

    def __enter__(self) -> "Output":
        if self._emission is not None:
            self._emission.__enter__()
        return self

    def __exit__(self, *fault: Any) -> None:
        if self._emission is not None:
            self._emission.__exit__(*fault)

    @property
    def share(self) -> float:
        """Factor (at most 1) by which the newest drive was scaled when it was sent."""
        return 1.0 if self._emission is None else self._emission.share

    def limit(self, cap: float) -> None:
        """Limit the amplitudes of all drives to a fraction of full scale, above 0 and at most 1."""
        cap = check_cap(cap)
        if self._emission is not None:
            self._emission.cap = cap

    def send(self, amplitudes: Amplitudes, at: float | None = None) -> None:
        """Emit a drive, at once or at a given time; return as soon as it has reached the link."""
        if self._emission is not None:
            self._emission.send(Drive(amplitudes), wait=False, at=at)

    def cycles(self, frames: int, rate: float) -> bool:
        """Return whether boards and link can play ``frames`` frames at ``rate`` frames/s."""
        try:
            if self._emission is not None:
                self._emission.link.check_sequence(frames, rate)
        except InvalidInput:
            return False
        return True

    def cycle(self, frames: Frames, rate: float) -> None:
        """Play ``rate`` frames per second repeatedly, from the current position in the sequence."""
        if self._emission is not None:
            self._emission.cycle(Sequence(frames, rate), wait=False)

    def beat(self) -> None:
        """Keep the output unchanged, and reset the watchdog."""
        if self._emission is not None:
            self._emission.beat()

    def modulate(self, modulation: AmplitudeModulation | None) -> None:
        """Set the amplitude modulation of all drives that are sent later; None ends it."""
        if self._emission is not None:
            self._emission.set_modulation(modulation)

    def stop(self) -> None:
        """Emergency stop: silence the boards at once and permanently.

        Any thread may call this method.
        """
        # Set this first, so that nothing is sent from now on even if the link is not open yet.
        self.stopped = True
        try:
            if self._emission is not None:
                self._emission.stop()
        except LinkFailed as failed:
            if failed.code != "emission_over":
                raise
