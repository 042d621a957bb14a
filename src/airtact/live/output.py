"""Where the drives of the live loop go: to boards through an emission, or nowhere."""

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
    """Receiver of drives, for use in a ``with`` block, which ends in silence.

    This class emits nothing; subclasses raise ``LinkFailed`` if their boards fail.

    Attributes
    ----------
    words : where drives go.
    stopped : whether the emergency stop was pressed, after which nothing is emitted.
    levels : amplitudes and phases of the boards; None without boards.
    share : of the newest drive's amplitude that was emitted when it was sent; less than 1 while the
        sound rises.
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
        """Emit a drive from now on; return once it has reached the link."""

    def cycle(self, frames: Frames, rate: float) -> None:
        """Emit frames in turn at a rate [1/s]; they continue at the current place in the round."""

    def beat(self) -> None:
        """Keep playing, or keep silent."""

    def modulate(self, modulation: AmplitudeModulation | None) -> None:
        """Modulate the amplitude of all that is sent from now on."""

    def stop(self) -> None:
        """Emergency stop: silence at once and for good. Any thread may call it."""
        self.stopped = True


class Boards(Output):
    """Boards behind a link; the sound rises over 0.2 s from the first drive after a silence.

    Drives are sent as they are: the loop has capped them.

    Parameters
    ----------
    link : the way to the boards.
    log : file for one line per event at the link, as that of ``Emission``.
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
        """Send frames that are played in turn."""
        self._emission.cycle(Sequence(frames, rate), wait=False)
        self.share = self._emission.share

    def beat(self) -> None:
        """Feed the watchdog."""
        self._emission.beat()

    def modulate(self, modulation: AmplitudeModulation | None) -> None:
        """Have the boards modulate the amplitude at their own rate."""
        self._emission.set_modulation(modulation)

    def stop(self) -> None:
        """Send the zero frame now."""
        # First, so that nothing is sent from now on even where the link is not open yet.
        self.stopped = True
        try:
            self._emission.stop()
        except LinkFailed as failed:
            if failed.code != "emission_over":
                raise
