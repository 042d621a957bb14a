"""Where the drives of the live loop go: to boards through an emission, or nowhere."""

from abc import ABC, abstractmethod
from pathlib import Path
from types import TracebackType

import numpy as np
from jaxtyping import Complex128

from airtact.hardware.emission import Emission
from airtact.hardware.link import Link, LinkFailed
from airtact.transducers.modulation import AmplitudeModulation
from airtact.transfer import Drive


class Output(ABC):
    """Takes drives; used in a ``with`` block, at whose end it is silent.

    Attributes
    ----------
    words : where drives go, in words.
    stopped : whether the emergency stop was pressed, after which nothing is emitted.
    """

    words: str = "no boards"
    stopped: bool = False

    def __enter__(self) -> "Output":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End in silence; without boards there is nothing to end."""
        return

    @abstractmethod
    def send(self, amplitudes: Complex128[np.ndarray, "elements"]) -> None:
        """Emit a drive from now on; return when it reached the link."""

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

    def beat(self) -> None:
        """Keep nothing."""


class Boards(Output):
    """Boards behind a link.

    Parameters
    ----------
    link : the way to them.
    log : file for one line on each event at the link, as that of ``Emission``.
    """

    def __init__(self, link: Link, log: Path | None = None) -> None:
        self._emission = Emission(link, ramp=0.0, log=log, resumes=True)  # the loop's own gain rises and falls
        self.words = f"{link.devices} through {link.name}"

    def __enter__(self) -> "Boards":
        self._emission.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End in silence, whatever happened."""
        self._emission.__exit__(kind, error, trace)

    def send(self, amplitudes: Complex128[np.ndarray, "elements"]) -> None:
        """Send a drive; raises ``LinkFailed``."""
        self._emission.send(Drive(amplitudes))

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
