"""Where the drives of the live loop go: to boards through an emission, or nowhere."""

from abc import ABC, abstractmethod
from pathlib import Path
from types import TracebackType

import numpy as np
from jaxtyping import Complex128

from airtact.drives.drive import Drive
from airtact.drives.sequence import Sequence
from airtact.emission.emission import Emission
from airtact.emission.link import Link, LinkFailed
from airtact.transducers.modulation import AmplitudeModulation


class Output(ABC):
    """Takes drives; used in a ``with`` block, at whose end it is silent.

    Attributes
    ----------
    words : where drives go, in words.
    stopped : whether the emergency stop was pressed, after which nothing is emitted.
    share : of the newest drive's amplitude that was emitted when it was sent; less than 1 while the
        sound rises.
    """

    words: str = "no boards"
    stopped: bool = False
    share: float = 1.0

    def __enter__(self) -> "Output":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End in silence; without boards there is nothing to end."""
        return

    @abstractmethod
    def send(self, amplitudes: Complex128[np.ndarray, "elements"]) -> None:
        """Emit a drive from now on; return when it reached the link."""

    @abstractmethod
    def cycle(self, frames: Complex128[np.ndarray, "frames elements"], rate: float) -> None:
        """Emit frames in turn from now on, so many a second, at the place in the round where those before are."""

    @abstractmethod
    def beat(self) -> None:
        """Keep what is emitted, or the silence."""

    def modulate(self, modulation: AmplitudeModulation | None) -> None:  # noqa: B027 (without boards, nothing does)
        """Vary the amplitude of all that is sent from now on."""

    def stop(self) -> None:
        """Silence at once and for good: the emergency stop, which any thread may call."""
        self.stopped = True


class Nowhere(Output):
    """Drives are made, and recorded where a session is, but not emitted."""

    def send(self, amplitudes: Complex128[np.ndarray, "elements"]) -> None:
        """Emit nothing."""

    def cycle(self, frames: Complex128[np.ndarray, "frames elements"], rate: float) -> None:
        """Emit nothing."""

    def beat(self) -> None:
        """Keep nothing."""


class Boards(Output):
    """Boards behind a link, where the sound rises over 0.2 s from the first drive that they take after silence.

    Parameters
    ----------
    link : the way to them.
    log : file for one line on each event at the link, as that of ``Emission``.
    """

    def __init__(self, link: Link, log: Path | None = None) -> None:
        self._emission = Emission(link, log=log, resumes=True)
        self.words = f"{link.devices} through {link.name}"

    def __enter__(self) -> "Boards":
        self._emission.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End in silence, whatever happened."""
        self._emission.__exit__(kind, error, trace)

    def send(self, amplitudes: Complex128[np.ndarray, "elements"]) -> None:
        """Send a drive; raises ``LinkFailed``."""
        self._emission.send(Drive(amplitudes), outlast=False)
        self.share = self._emission.share

    def cycle(self, frames: Complex128[np.ndarray, "frames elements"], rate: float) -> None:
        """Send frames that are played in turn; raises ``LinkFailed``, or ``InvalidInput`` where the boards cannot."""
        self._emission.cycle(Sequence(frames, rate), outlast=False)
        self.share = self._emission.share

    def beat(self) -> None:
        """Feed the watchdog; raises ``LinkFailed``."""
        self._emission.beat()

    def modulate(self, modulation: AmplitudeModulation | None) -> None:
        """Let the boards vary the amplitude at their own rate; raises ``LinkFailed``."""
        self._emission.set_modulation(modulation)

    def stop(self) -> None:
        """Send the zero frame now; raises ``LinkFailed`` where that fails."""
        self.stopped = True  # from now on nothing is sent, also where the link is not open yet
        try:
            self._emission.stop()
        except LinkFailed as failed:
            if failed.code != "emission_over":
                raise
