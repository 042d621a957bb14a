"""Checks for silence (hand lost, out of reach or inside the array), and the fade."""

import numpy as np
from scipy.spatial import KDTree

from airtact.errors import InvalidInput, millimetres, of_kind
from airtact.hands.hand import Hand
from airtact.hands.joints import BONES, radii_of
from airtact.hands.tracking.frame import HandFrame
from airtact.live.scene import Foci, Joints, LiveScene, hand_in
from airtact.transducers.placement import check_reach

# Longest time without a valid frame before the hand counts as lost [s].
MAX_FRAME_AGE = 0.15

# Duration of a fade between full amplitude and silence, in either direction [s].
FADE = 0.085
# With both, the output is silent 0.24 s after the last valid frame.


class Workspace:
    """The region in front of an array in which a hand may be exposed to sound."""

    def __init__(self, scene: LiveScene) -> None:
        self._scene = of_kind(scene, LiveScene, "the scene", "live_scene(setup)")
        self._elements = KDTree(scene.array.positions)
        self._radius = float(scene.array.element.reach)

    def out_of_reach(self, foci: Foci) -> str | None:
        """Return a short reason why foci must not receive sound, or None if they may."""
        if not len(foci):
            return None
        distances, _ = self._elements.query(foci)
        if float(distances.max()) > 0.6:  # [m] from every element: the hand has left
            return f"left the workspace: a focus is {distances.max():.2g} m from the array"
        try:
            check_reach(self._scene.array, foci)
        except InvalidInput as fault:
            return f"left the workspace: {fault}"
        return self._behind_plane(foci, "a focus")

    def fault(self, joints: Joints, foci: Foci) -> str | None:
        """Return a short reason why a hand must not receive sound, or None if it may."""
        fault = self.out_of_reach(foci)
        if fault is not None:
            return fault
        # Compare the skin with the elements at 6 points along each bone.
        share = np.linspace(0.0, 1.0, 6)[:, None]
        starts, ends = np.array(BONES).T
        skin = radii_of(self._scene.radii, None, joints)
        radii = (1.0 - share) * skin[starts] + share * skin[ends]
        centres = (1.0 - share[..., None]) * joints[starts] + share[..., None] * joints[ends]
        # The upper bound makes the search 30 times faster. All larger distances are safe.
        bound = float(radii.max()) + self._radius
        distances, _ = self._elements.query(centres, distance_upper_bound=bound)
        room = float((distances - radii).min()) - self._radius
        if room < 0.0:
            return f"through the array's face: the skin is {millimetres(-room)} too close"
        return self._behind_plane(joints, "a joint")

    def _behind_plane(self, points: Foci, what: str) -> str | None:
        for plane in self._scene.planes:
            lowest = float(plane.height(points).min())
            if lowest < 0.0:
                return f"through the plane: {what} is {millimetres(-lowest)} behind it"
        return None


def hand_of(frame: HandFrame, scene: LiveScene) -> Hand | str:
    """Return the hand of a frame, or a short reason why there is none."""
    if frame.landmarks is None:
        return "lost" if frame.lost else "no landmarks"
    try:
        return hand_in(scene, frame.landmarks, frame.side)
    except InvalidInput as fault:
        return f"not a hand: {fault}"


class Gain:
    """Factor for all amplitudes that the live loop sends.

    It rises from 0 to 1, or falls to 0, within ``FADE`` seconds.
    """

    def __init__(self) -> None:
        self.share: float = 0.0
        self._then: float | None = None

    def advance(self, now: float, on: bool) -> float:
        """Raise or lower the factor according to the time since the last call, and return it."""
        step = 0.0 if self._then is None else max(now - self._then, 0.0)
        self._then = now
        if on:
            # After a stall the sound must still rise gradually, so at most 30 ms count at once.
            self.share = min(self.share + min(step, 0.03) / FADE, 1.0)
        else:
            self.share = max(self.share - step / FADE, 0.0)
        return self.share
