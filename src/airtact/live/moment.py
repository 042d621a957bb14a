"""A drive of the live loop, its controls, and the interface of drive makers."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float64

from airtact.drives.methods import FOR_SAMPLES, METHODS
from airtact.errors import between, check_choice, in_short, of_kind
from airtact.hands.tracking.frame import HandFrame
from airtact.live.scene import Amplitudes, Foci, Frames, Joints, LiveScene

# Basis of a drive: distances, without the hand; a solution of the last phalanges or of the whole
# hand; or a solution of the whole hand, carried from an earlier pose with the bones.
Rule = Literal["distances", "phalanges", "hand", "carried"]

# State of the loop: waiting for a hand, playing, fading after the hand was lost, silent, or stopped
# permanently.
State = Literal["waiting", "playing", "fading", "silent", "stopped"]


@dataclass(frozen=True, eq=False)
class Moment:
    """A drive and its expected effect.

    Attributes
    ----------
    time : when the sound is expected in the air, on the tracker's clock [s].
    frame_time : timestamp of the newest frame used [s].
    joints : (25, 3) joints predicted for ``time`` [m], or None if the hand is lost.
    foci : (F, 3) foci predicted for ``time`` [m], or None.
    amplitudes : (E,) complex share of full scale; zeros for silence.
    pressures : (F,) predicted pressures at the foci [Pa], or None.
    rule : basis of the drive.
    shape_age : time from the solved pose to ``time`` [s]; None for distances.
    kept : expected share of the attainable pressure at the weakest focus, or None.
    state : state of the loop.
    frames : (N, E) drives played in turn instead of ``amplitudes`` if the foci move, or None.
    """

    time: float
    frame_time: float
    joints: Joints | None
    foci: Foci | None
    amplitudes: Amplitudes
    pressures: Float64[np.ndarray, "foci"] | None = None
    rule: Rule = "distances"
    shape_age: float | None = None
    kept: float | None = None
    state: State = "playing"
    frames: Frames | None = None

    __repr__ = in_short


def silent_moment(scene: LiveScene, time: float, frame_time: float) -> Moment:
    """Return a moment without a hand and without sound."""
    silence = np.zeros(len(scene.array), np.complex128)
    return Moment(time, frame_time, None, None, silence, state="waiting")


@dataclass(frozen=True)
class Controls:
    """Settings that the page or a program can change while the loop runs.

    Attributes
    ----------
    ignore_hand : whether phases are set from path lengths alone, as if there were no hand.
    method : name of the method that makes the drives; None for the scene's.
    cap : largest amplitude of an element, as a share of full scale.
    offset : distance of all foci from the skin [m]; None for the scene's.
    modulated : whether the amplitude is modulated or the foci move.
    playing : whether there is sound.

    Raises
    ------
    InvalidInput
        If a value has the wrong type or is out of range.
    """

    ignore_hand: bool = False
    method: str | None = None
    cap: float = 1.0
    offset: float | None = None
    modulated: bool = True
    playing: bool = True

    def __post_init__(self) -> None:
        # Programs other than a browser can send any value to the page.
        for flag in (self.ignore_hand, self.modulated, self.playing):
            of_kind(flag, bool, "a setting", "true or false")
        between(self.cap, 0.0, 1.0, "the cap", "of full scale", "30 per cent is 0.3.")
        if self.offset is not None:
            between(self.offset, 0.0, 0.1, "the offset", "m", "is it in millimetres?")
        # Robust methods need samples of an uncertain scene.
        if self.method is not None:
            methods = [name for name in METHODS if name not in FOR_SAMPLES]
            check_choice(self.method, "the method", methods)


class DriveMaker(ABC):
    """Maker of drives for a moving hand; ``take`` and ``make`` must not block."""

    @abstractmethod
    def take(self, frame: HandFrame) -> None:
        """Take the tracker's newest frame, in scene coordinates; it replaces older ones."""

    @abstractmethod
    def make(self, time: float, controls: Controls) -> Moment:
        """Make the drive for sound that is in the air at a time of the tracker's clock [s]."""

    def revive(self) -> int:
        """Restart processes of the maker that ended; return the number of restarts so far."""
        return 0

    def close(self) -> None:  # noqa: B027 (some makers have none)
        """End the processes of the maker."""
