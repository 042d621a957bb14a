"""When the sound of the live loop must fade: hands that are lost, stale, out of reach, or through an array's face."""

import numpy as np
from jaxtyping import Float64
from scipy.spatial import KDTree

from airtact.errors import InvalidInput
from airtact.hands.hand import Hand
from airtact.hands.joints import BONES, radii_of
from airtact.hands.tracking.frame import HandFrame
from airtact.live.distances import hand_in
from airtact.live.parts import LiveScene
from airtact.transducers.placement import check_reach

STALE = 0.15
"""A hand of which no good frame came for so long is not where it was [s]."""

FADE = 0.085
"""How long a drive takes from full amplitude to silence, and back [s]; with the time to notice it stays under 0.1 s."""

LONGEST_STEP = 0.03
"""A drive rises no farther in a pass of the loop than in this time [s]."""

FARTHEST = 0.6
"""Largest distance of a focus from the nearest element: beyond, the hand has left the workspace [m]."""

ALONG = np.linspace(0.0, 1.0, 6)
"""Shares of each bone at which its skin is compared with the elements."""


class Workspace:
    """Where a hand may be before an array."""

    def __init__(self, scene: LiveScene) -> None:
        self._scene = scene
        self._elements = KDTree(scene.array.positions)
        self._radius = float(scene.array.element.reach)

    def fault(
        self, joints: Float64[np.ndarray, "25 3"], foci: Float64[np.ndarray, "foci 3"]
    ) -> str | None:
        """Return why a hand with foci before it must not get sound, in a few words, or None."""
        distances, _ = self._elements.query(foci)
        if float(distances.max()) > FARTHEST:
            return f"left the workspace: a focus is {distances.max():.2g} m from the array"
        try:
            check_reach(self._scene.array, foci)
        except InvalidInput as fault:
            return f"left the workspace: {fault}"
        ends = np.array(BONES)
        share = ALONG[:, None, None]
        centres = (1.0 - share) * joints[ends[:, 0]] + share * joints[ends[:, 1]]
        skin = radii_of(self._scene.radii, None, joints)
        radii = (1.0 - share[..., 0]) * skin[ends[:, 0]] + share[..., 0] * skin[ends[:, 1]]
        reach = (
            float(radii.max()) + self._radius
        )  # no element within it: no room to find, and 30 times faster
        room = self._elements.query(centres, distance_upper_bound=reach)[0] - radii - self._radius
        if float(room.min()) < 0.0:
            return f"through the array's face: {-1e3 * room.min():.2g} mm too near"
        for plane in self._scene.planes:
            lowest = float(plane.height(np.concatenate([joints, foci])).min())
            if lowest < 0.0:
                return f"through the plane: {-1e3 * lowest:.2g} mm behind it"
        return None


def hand_of(frame: HandFrame, scene: LiveScene) -> Hand | str:
    """Return the hand of a frame, or what is wrong with it in a few words."""
    if frame.lost or frame.landmarks is None:
        return "lost" if frame.lost else "no landmarks"
    try:
        return hand_in(scene, frame.landmarks)
    except InvalidInput as fault:
        return f"not a hand: {fault}"


class Gain:
    """The share of the amplitude that is asked of the output; boards rise from silence over a ramp of their own."""

    def __init__(self) -> None:
        self.share: float = 0.0
        self._then: float | None = None

    def advance(self, now: float, on: bool) -> float:
        """Go on to a time [s], up or down, and return the share."""
        step = 0.0 if self._then is None else max(now - self._then, 0.0)
        self._then = now
        self.share = float(
            np.clip(self.share + (min(step, LONGEST_STEP) if on else -step) / FADE, 0.0, 1.0)
        )
        return self.share
