"""A drive of the live loop, its controls, and the interface of drive makers."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Float64

import airtact as at
from airtact.drives.methods import FOR_SAMPLES, METHODS
from airtact.errors import between, check_choice, in_short, of_kind
from airtact.hands.tracking.frame import HandFrame
from airtact.live.scene import Amplitudes, Foci, Frames, Joints, LiveScene
from airtact.touch.objects import VirtualObject

# How a drive was computed: from distances, ignoring the hand; from a solution for the last
# phalanges or the whole hand; from a solution for the whole hand that was moved with the bones from
# an earlier pose; or from a solution for the skin near contacts.
Rule = Literal["distances", "phalanges", "hand", "carried", "contacts"]

# Largest numbers of foci and of contacts in a drive. The session has one column for each.
MOST_FOCI = 24
MOST_CONTACTS = 24

# State of the loop: waiting for a hand, playing, fading after the hand was lost, silent, or stopped
# for good.
State = Literal["waiting", "playing", "fading", "silent", "stopped"]


@dataclass(frozen=True, eq=False)
class Moment:
    """A drive of the live loop for one time, with the predicted hand, foci and pressures.

    A ``DriveMaker`` returns it, and the live loop emits it. Positions are in scene coordinates.

    Attributes
    ----------
    time : time at which the sound should be in the air, on the tracker's clock [s].
    frame_time : timestamp of the newest tracker frame that the drive is based on, on the tracker's
        clock [s].
    joints : (25, 3) joints of the hand in WebXR order, predicted for ``time`` [m]; None if the hand
        is lost. If both hands are followed, these are the joints of the hand ``LiveScene.side``.
    foci : (F, 3) foci predicted for ``time`` [m]; None if no hand is seen.
    amplitudes : (E,) complex amplitudes, as fractions of full scale; zeros for silence. The cap and
        fades are applied later.
    pressures : (F,) peak pressures predicted at the foci for ``amplitudes`` [Pa]; None if unknown.
    rule : scattering that the drive accounts for: none ("distances"), by the last phalanges
        ("phalanges"), by the whole hand ("hand", or "carried" if the solution was moved from
        another pose), or by the skin near contacts ("contacts").
    shape_age : age at ``time`` of the pose for which the scattering was computed [s]; None if no
        solution was used.
    kept : expected pressure at the weakest focus, divided by the attainable pressure, which a drive
        computed for the exact hand would produce; None if unknown.
    state : state of the live loop: "waiting" (for a hand), "playing", "fading" (to silence),
        "silent" or "stopped" (by the emergency stop).
    frames : (N, E) drives that are played in turn instead of ``amplitudes`` if the foci move; else
        None.
    rate : number of ``frames`` that are played per second; 0 if there are none.
    other : (25, 3) predicted joints of the other hand [m]; None if it is not seen.
    names : a name for each focus; if empty, the names are the places of the scene.
    strengths : (F,) strengths of the foci, from 0 to 1, to which the pressures are proportional;
        None if all are equal.
    contacts : (C, 3) deepest point of each contact of skin with an object [m]; None if there
        are no objects.
    depths : (C,) depths in the objects at the points ``contacts`` [m]; None if there are no
        objects.
    touching : for each contact, the part of the hand, such as "left.index", and the name of the
        object.
    objects : the virtual objects at ``time``.
    rejected : reasons why requested foci receive no sound, by focus name.
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
    rate: float = 0.0
    other: Joints | None = None
    names: tuple[str, ...] = ()
    strengths: Float64[np.ndarray, "foci"] | None = None
    contacts: Float64[np.ndarray, "contacts 3"] | None = None
    depths: Float64[np.ndarray, "contacts"] | None = None
    touching: tuple[tuple[str, str], ...] = ()
    objects: tuple[VirtualObject, ...] = ()
    rejected: Mapping[str, str] = field(default_factory=dict)

    __repr__ = in_short


def silent_moment(scene: LiveScene, time: float, frame_time: float) -> Moment:
    """Return a ``Moment`` whose amplitudes are zero, for times when no hand is seen."""
    silence = np.zeros(len(scene.array), np.complex128)
    return Moment(time, frame_time, None, None, silence, state="waiting")


@dataclass(frozen=True)
class Controls:
    """Settings of the live loop, which the user can change on the browser page.

    ``follow`` takes the initial settings. The page, or a program that sends the page's messages,
    changes them by sending a new ``Controls`` object. The loop passes the newest object to
    ``DriveMaker.make``.

    Attributes
    ----------
    ignore_hand : whether scattering by the hand is ignored, so that ``method`` uses the
        transfer matrix of open air; False by default.
    method : name of the method that computes the drives, a key of ``drives.METHODS`` other than
        "robust" and "robust_phase_only"; None (the default) for the scene's method.
    cap : largest amplitude of an element, as a fraction of full scale, 0 to 1; 1 by default, and 0
        silences all elements. The smaller of this cap and that of the run (see ``follow``) applies.
    offset : distance of the foci from the skin, outward [m], 0 to 0.1. By default, None: 0.5 mm for
        contacts, and for other foci the distance in the scene file or in ``WantedFocus.offset``.
        Foci that applications request at a ``point`` are not affected.
    modulated : whether the scene's modulation is applied, which varies the amplitude or moves the
        foci along paths or outlines; True by default. Without it, the drive can hardly be felt.
    playing : whether sound is emitted; True by default.
    levels : factors from 0 (off) to 1 by focus name, such as "thumb.pad" or "index at ball".
        The requested relative pressure of the focus is multiplied by its factor, which is 1 for
        foci that are not listed. Unknown names are ignored.

    Raises
    ------
    InvalidInput
        If a value has the wrong type or is outside its range, or if the method is unknown or
        robust.
    """

    ignore_hand: bool = False
    method: str | None = None
    cap: float = 1.0
    offset: float | None = None
    modulated: bool = True
    playing: bool = True
    levels: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        # Programs other than a browser can send arbitrary values to the page.
        for flag in (self.ignore_hand, self.modulated, self.playing):
            of_kind(flag, bool, "a setting", "true or false")
        between(self.cap, 0.0, 1.0, "the cap", "of full scale", "30 per cent is 0.3.")
        if self.offset is not None:
            between(self.offset, 0.0, 0.1, "the offset", "m")
        for name, level in self.levels.items():
            between(level, 0.0, 1.0, f"the level of {name}", "", "use 1 for the full level.")
        # Robust methods require samples of an uncertain scene.
        if self.method is not None:
            methods = [name for name in METHODS if name not in FOR_SAMPLES]
            check_choice(self.method, "the method", methods)


class DriveMaker(ABC):
    """Abstract base class for objects that compute the drives of the live loop (see ``follow``).

    To test another method of computing drives, write a subclass with the methods ``take`` and
    ``make``; the other methods do nothing by default. ``follow`` passes each ``HandFrame`` of a
    tracked hand, in scene coordinates, to ``take(frame)``. For each drive, it calls ``feel(objects,
    foci)`` with the current virtual objects and requested foci, and then ``make(time, controls)``,
    which returns a ``Moment`` for this time on the tracker's clock [s]. Of the ``Controls``,
    ``make`` applies ``ignore_hand``, ``method``, ``offset`` and ``levels``; the loop applies the
    others. If ``make`` raises ``InvalidInput``, the sound fades to silence. ``revive`` restarts
    processes that have ended, and ``close`` is called at the end. All methods must return without
    blocking, because the loop waits for them.
    """

    @abstractmethod
    def take(self, frame: HandFrame) -> None:
        """Process the tracker's newest frame, which is in scene coordinates."""

    @abstractmethod
    def make(self, time: float, controls: Controls) -> Moment:
        """Return a ``Moment`` for sound that is in the air at ``time`` [s] (tracker's clock)."""

    def feel(  # noqa: B027 (some makers have fixed foci)
        self, objects: Sequence[VirtualObject], foci: "Sequence[at.live.WantedFocus]"
    ) -> None:
        """Set the objects and requested foci; the live loop calls this method before each drive."""

    def revive(self) -> int:
        """Restart processes that have ended; return the number of restarts so far."""
        return 0

    def close(self) -> None:  # noqa: B027 (some makers have no processes)
        """End the processes of this object."""
