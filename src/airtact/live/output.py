"""Outputs of the live loop: boards, through an emission, or none."""

from pathlib import Path
from typing import Any

from airtact.drives.drive import Drive
from airtact.drives.sequence import Sequence
from airtact.emission.emission import Emission
from airtact.emission.link import Link, LinkFailed
from airtact.live.scene import Amplitudes, Frames
from airtact.transducers.levels import Levels
from airtact.transducers.modulation import AmplitudeModulation


class Output:
    """Receiver of drives; a ``with`` block ends in silence.

    This class emits nothing; subclasses raise ``LinkFailed`` if their boards fail.

    Attributes
    ----------
    words : description of the output.
    stopped : whether the emergency stop was pressed; nothing is emitted after that.
    levels : amplitudes and phases of the boards; None without boards.
    share : share of the newest drive's amplitude that was emitted when it was sent; less than 1
        while the sound rises.
    """

    words: str = "no boards"
    stopped: bool = False
    levels: Levels | None = None
    share: float = 1.0

    def __enter__(self) -> "Output":
        return self

    def __exit__(self, *fault: object) -> None:
        """End in silence."""

    def send(self, amplitudes: Amplitudes) -> None:
        """Emit a drive from now on; return when it has reached the link."""

    def cycle(self, frames: Frames, rate: float) -> None:
        """Emit frames in turn at a rate [1/s], starting at the current position in the round."""

    def beat(self) -> None:
        """Keep the output as it is, and feed the watchdog."""

    def modulate(self, modulation: AmplitudeModulation | None) -> None:
        """Modulate the amplitude of all that is sent from now on."""

    def stop(self) -> None:
        """Emergency stop: silence at once and permanently. Any thread may call it."""
        self.stopped = True


class Boards(Output):
    """Boards behind a link; after silence the sound rises within 0.2 s.

    Drives are sent unchanged, because the loop has capped them.

    Parameters
    ----------
    link : link to the boards.
    log : file for one line per event at the link, as for ``Emission``.
    """

    def __init__(self, link: Link, log: Path | None = None) -> None:
        self._emission = Emission(link, cap=1.0, log=log, resumes=True)
        self.levels = link.levels
        self.words = f"{link.devices} through {link.name}"

    def __enter__(self) -> "Boards":
        self._emission.__enter__()
        return self

    def __exit__(self, *fault: Any) -> None:
        self._emission.__exit__(*fault)

    def send(self, amplitudes: Amplitudes) -> None:
        """Send a drive."""
        self._emission.send(Drive(amplitudes), wait=False)
        self.share = self._emission.share

    def cycle(self, frames: Frames, rate: float) -> None:
        """Send frames to be played in turn."""
        self._emission.cycle(Sequence(frames, rate), wait=False)
        self.share = self._emission.share

    def beat(self) -> None:
        """Feed the watchdog."""
        self._emission.beat()

    def modulate(self, modulation: AmplitudeModulation | None) -> None:
        """Have the boards modulate the amplitude themselves."""
        self._emission.set_modulation(modulation)

    def stop(self) -> None:
        """Send the zero frame now."""
        # Set first, so that nothing is sent from now on even if the link is not open yet.
        self.stopped = True
        try:
            self._emission.stop()
        except LinkFailed as failed:
            if failed.code != "emission_over":
                raise
