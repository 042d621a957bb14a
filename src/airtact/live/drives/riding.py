"""Foci that ride on a hand: where they are in a pose, and how much two poses differ for the sound at them.

What a hand does to the sound at a focus depends on where the bones of all foci stand to each other,
much less on where the hand stands as a whole. The first is the ``gap_change`` of two poses, the
second their ``turn``.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from airtact.hands.hand import PLACES, Hand
from airtact.hands.joints import CHAINS, cross, unit
from airtact.live.distances import foci_on, hand_in
from airtact.live.parts import LiveScene
from airtact.printing import in_short

SAMPLES = 12
"""Number of elements, spread over the array, whose directions tell how far a hand has turned."""


@dataclass(frozen=True, eq=False)
class Riding:
    """A hand in a pose, with its foci.

    Attributes
    ----------
    hand : in the scene's frame.
    foci : (F, 3) [m].
    frames : (F, 3, 3) axes of the bone of each focus, one a row.
    distances : (K,) between the foci and both ends of their bones, each with each [m].
    directions : (F, S, 3) unit vectors from each focus to elements spread over the array, in the
        frame of its bone.
    """

    hand: Hand
    foci: Float64[np.ndarray, "foci 3"]
    frames: Float64[np.ndarray, "foci 3 3"]
    distances: Float64[np.ndarray, "pairs"]
    directions: Float64[np.ndarray, "foci samples 3"]

    __repr__ = in_short


def bone_of(place: str) -> tuple[int, int]:
    """Joints at both ends of the bone that a place of a hand rides on: the last phalanx, or the middle metacarpal.

    >>> bone_of("index.pad")
    (8, 9)
    """
    if place == "palm":
        return CHAINS[2][0], CHAINS[2][1]
    return CHAINS[PLACES.index(place)][-2], CHAINS[PLACES.index(place)][-1]


def ride(
    scene: LiveScene, joints: Float64[np.ndarray, "25 3"], offset: float | None = None
) -> Riding:
    """Put the foci of a scene onto a hand with the joints (25, 3) [m].

    Parameters
    ----------
    scene : its places, offsets and radii count.
    joints : in the scene's frame [m].
    offset : of all foci from the skin [m], or None for those of the scene.

    Raises
    ------
    InvalidInput
        As ``hand_from_joints``, or a place is unknown; the side is not checked.
    """
    hand = hand_in(scene, joints)
    some = scene.array.positions[:: max(1, len(scene.array) // SAMPLES)]
    foci, frames, ends, directions = foci_on(hand, scene, offset), [], [], []
    for place, focus in zip(scene.places, foci, strict=True):
        start, end = hand.joints[list(bone_of(place))]
        along, across = unit(end - start), unit(cross(end - start, focus - start))
        frame = np.stack([along, across, cross(along, across)])
        frames.append(frame)
        seen = some - focus
        directions.append(seen @ frame.T / np.linalg.norm(seen, axis=1, keepdims=True))
        ends += [focus, start, end]
    points = np.array(ends)
    one, other = np.triu_indices(len(points), 1)
    distances = np.linalg.norm(points[one] - points[other], axis=1)
    return Riding(hand, foci, np.array(frames), distances, np.array(directions))


def gap_change(
    one: Float64[np.ndarray, "*poses pairs"], other: Float64[np.ndarray, "pairs"]
) -> Float64[np.ndarray, "*poses"]:
    """Root mean square change of the ``distances`` of poses [m]."""
    return np.asarray(np.sqrt(np.mean((one - other) ** 2, axis=-1)))


def turn(
    one: Float64[np.ndarray, "*poses foci samples 3"], other: Float64[np.ndarray, "foci samples 3"]
) -> Float64[np.ndarray, "*poses"]:
    """Root mean square change of the ``directions`` of poses [rad]."""
    return np.asarray(np.sqrt(np.mean(np.sum((one - other) ** 2, axis=-1), axis=(-2, -1))))
