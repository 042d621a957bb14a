"""What passes between the parts of the live loop: its scene, one moment of it, and what the page sets."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Complex128, Float64, Int64

from airtact.acoustics.medium import Medium
from airtact.acoustics.planes import Plane
from airtact.hands.hand import Side
from airtact.hands.tracking.frame import HandFrame
from airtact.live.images import WithImages
from airtact.printing import in_short
from airtact.transducers.layout import PhasedArray
from airtact.transducers.modulation import AmplitudeModulation

Rule = Literal["distances", "phalanges", "fingers", "hand", "carried"]
"""What a drive was made from: distances alone, a solution of the last phalanges, the fingers or the whole hand, or one
of the whole hand in an earlier pose whose sound was carried along on its skin."""

State = Literal["waiting", "playing", "fading", "silent", "stopped"]
"""What the loop does: waits for a hand, plays, fades after one was lost, is silent, or was stopped for good."""


@dataclass(frozen=True, eq=False)
class MovingFoci:
    """How foci run along paths that ride on the hand, frame by frame, as of ``synthesis.Motion``.

    Attributes
    ----------
    places : (N, K) indices of the places of the K foci in each of N frames.
    shifts : (N, K, 3) where they are from those places, in the axes of the bone, see
        ``Riding.frames`` [m].
    rate : frames a second.
    words : what it is, in a few words.
    """

    places: Int64[np.ndarray, "frames together"]
    shifts: Float64[np.ndarray, "frames together 3"]
    rate: float
    words: str

    __repr__ = in_short


@dataclass(frozen=True, eq=False)
class LiveScene:
    """What stays the same while the hand moves.

    Attributes
    ----------
    medium : what the sound travels in.
    frequency : of the sound [Hz].
    array : the transducers, in the scene's frame, in which the tracker's frames are given, too.
    side : of the hand that carries the foci.
    radii : (25,) of the skin round each joint [m], or None for those of a generic hand.
    places : of a hand, such as ``"thumb.pad"``, one for each of F foci, which ride on it.
    offsets : (F,) distances of the foci from the skin [m].
    method : name of the method that makes the drives.
    modulation : how the amplitude varies so that the drive is felt, or None.
    moving : how foci move so that it is felt, or None.
    planes : a rigid plane, such as a table; none for air without end.
    """

    medium: Medium
    frequency: float
    array: PhasedArray
    side: Side
    radii: Float64[np.ndarray, "25"] | None
    places: tuple[str, ...]
    offsets: Float64[np.ndarray, "foci"]
    method: str = "best"
    modulation: AmplitudeModulation | None = None
    moving: MovingFoci | None = None
    planes: tuple[Plane, ...] = ()

    __repr__ = in_short

    @cached_property
    def sounding(self) -> WithImages:
        """The elements, and their images in the plane."""
        return WithImages.of(self.array, self.planes)


@dataclass(frozen=True, eq=False)
class Moment:
    """One pass of the loop: the drive and what it is expected to do.

    Attributes
    ----------
    time : at which the sound is expected in the air, of the tracker's clock [s].
    frame_time : time in the newest frame that was used [s].
    joints : (25, 3) of the hand as predicted for ``time`` [m], or None where it is lost.
    foci : (F, 3) where they are then [m], or None.
    amplitudes : (E,) complex share of full scale; zeros where it is silent.
    pressures : (F,) predicted at the foci [Pa], or None.
    rule : what the drive was made from.
    shape_age : from the time of the frame that was solved to ``time`` [s]; None for distances.
    behind : from the time of the hand that was solved last, used or not, to ``time`` [s]; None
        before the first, and where noise lets the solvers rest.
    kept : expected share of the attainable pressure at the weakest focus, or None.
    state : what the loop does.
    frames : (N, E) drives that are played in turn in place of ``amplitudes``, where foci move; or
        None.
    """

    time: float
    frame_time: float
    joints: Float64[np.ndarray, "25 3"] | None
    foci: Float64[np.ndarray, "foci 3"] | None
    amplitudes: Complex128[np.ndarray, "elements"]
    pressures: Float64[np.ndarray, "foci"] | None = None
    rule: Rule = "distances"
    shape_age: float | None = None
    behind: float | None = None
    kept: float | None = None
    state: State = "playing"
    frames: Complex128[np.ndarray, "frames elements"] | None = None

    __repr__ = in_short


@dataclass(frozen=True)
class Controls:
    """What the page, or a program, sets while the loop runs.

    Attributes
    ----------
    ignore_hand : whether drives are made from distances alone.
    method : name of the method that makes the drives, or None for the scene's.
    cap : largest amplitude of an element, a share of full scale.
    offset : of all foci from the skin [m], or None for the scene's.
    modulated : whether the amplitude varies, or the foci move.
    playing : False silences until it is True again.
    """

    ignore_hand: bool = False
    method: str | None = None
    cap: float = 1.0
    offset: float | None = None
    modulated: bool = True
    playing: bool = True


class DriveMaker(ABC):
    """Makes drives for a hand that moves; ``take`` and ``make`` return at once, whatever is being solved."""

    @abstractmethod
    def take(self, frame: HandFrame) -> None:
        """Take the tracker's newest frame, in the scene's frame; older ones are forgotten."""

    @abstractmethod
    def make(self, time: float, controls: Controls) -> Moment:
        """Make the drive for sound that is in the air at a time of the tracker's clock [s]."""

    @abstractmethod
    def close(self) -> None:
        """End what runs beside the loop."""
