"""A drive of the live loop, its controls, and the interface of drive makers."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float64

from airtact.errors import in_short
from airtact.hands.tracking.frame import HandFrame
from airtact.live.scene import Amplitudes, Foci, Frames, Joints, LiveScene

# Basis of a drive: distances, without the hand; a solution of the last phalanges or of the whole
# hand; or a solution of the whole hand in an earlier pose, moved with its bones.
Rule = Literal["distances", "phalanges", "hand", "carried"]

# State of the loop: it waits for a hand, plays, fades after a hand was lost, is silent, or was
# stopped for good.
State = Literal["waiting", "playing", "fading", "silent", "stopped"]


@dataclass(frozen=True, eq=False)
class Moment:
    """A drive and its expected effect.

    Attributes
    ----------
    time : when the sound is expected in the air, on the tracker's clock [s].
    frame_time : time in the newest frame that was used [s].
    joints : (25, 3) of the hand as predicted for ``time`` [m], or None where it is lost.
    foci : (F, 3) as predicted for ``time`` [m], or None.
    amplitudes : (E,) complex share of full scale; zeros for silence.
    pressures : (F,) predicted at the foci [Pa], or None.
    rule : basis of the drive.
    shape_age : time from the pose that was solved to ``time`` [s]; None for distances.
    behind : time from the newest pose that was solved, used or not, to ``time`` [s]; None before
        the first solution and while the solvers rest because of noise.
    kept : expected share of the attainable pressure at the weakest focus, or None.
    state : state of the loop.
    frames : (N, E) drives that are played in turn instead of ``amplitudes`` where foci move; or
        None.
    """

    time: float
    frame_time: float
    joints: Joints | None
    foci: Foci | None
    amplitudes: Amplitudes
    pressures: Float64[np.ndarray, "foci"] | None = None
    rule: Rule = "distances"
    shape_age: float | None = None
    behind: float | None = None
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
    """Settings that the page or a program changes while the loop runs.

    Attributes
    ----------
    ignore_hand : whether drives are focused by distances, without the hand.
    method : name of the method that makes the drives; None for the scene's.
    cap : largest amplitude of an element, a share of full scale.
    offset : of all foci from the skin [m]; None for the scene's.
    modulated : whether the amplitude is modulated, or the foci move.
    playing : False silences until it is True again.
    """

    ignore_hand: bool = False
    method: str | None = None
    cap: float = 1.0
    offset: float | None = None
    modulated: bool = True
    playing: bool = True


class DriveMaker(ABC):
    """Maker of drives for a moving hand; ``take`` and ``make`` must return at once."""

    @abstractmethod
    def take(self, frame: HandFrame) -> None:
        """Take the tracker's newest frame, in the scene's frame; it replaces older ones."""

    @abstractmethod
    def make(self, time: float, controls: Controls) -> Moment:
        """Make the drive for sound that is in the air at a time of the tracker's clock [s]."""

    def close(self) -> None:  # noqa: B027 (some makers have none)
        """End the processes of the maker."""
