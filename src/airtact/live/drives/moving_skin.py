"""The skin of a tracked hand: meshed once, then moved with the bones."""

from functools import partial

import numpy as np

from airtact.hands.hand import Hand
from airtact.hands.joints import PerPoint, Points, hand_length
from airtact.hands.shape import hull_weights
from airtact.live.drives.bending import Bones, Weights, bones_of, moved_by_bones
from airtact.touch.skin import Skin, skin_of


class MovingSkin:
    """Skin of one hand, with the same points (about 1,600) in every pose.

    Moving the skin to a pose takes 1 ms.

    Attributes
    ----------
    bones : axes and starting points of the hand's bones in the newest pose; None before the first
        call of ``at``.
    """

    def __init__(self) -> None:
        # The skin as it was meshed, the weights of the bones in its motion, and the bones and the
        # length of the hand in that pose.
        self._meshed: tuple[Skin, Weights, Bones, float] | None = None
        self.bones: Bones | None = None

    def at(self, hand: Hand) -> Skin:
        """Move the skin to the pose of a hand, and return it.

        The skin is meshed at the first call, and again if the length of the hand has changed by a
        tenth.
        """
        self.bones = bones_of(hand)
        length = hand_length(hand.joints)
        # If the hand's length has changed by a tenth, it is another person's hand: mesh it again.
        if self._meshed is None or abs(length / self._meshed[3] - 1.0) > 0.1:
            skin = skin_of(hand, longest_edge=10e-3)
            weights = hull_weights(hand.shape.hulls, skin.points)
            self._meshed = skin, weights, self.bones, length
        skin, weights, bones, _ = self._meshed
        points = moved_by_bones(skin.points, weights, bones, self.bones)
        # Points near creases move up to 0.3 mm off the skin: one step along the gradient of the
        # distance brings them back.
        distances, normals = _look(hand, points)
        points = points - distances[:, None] * normals
        return skin.moved(points, normals, partial(_look, hand))


def _look(hand: Hand, points: Points) -> tuple[PerPoint, Points]:
    """Return the distances (P,) of points from the skin [m], and the unit normals (P, 3) there."""
    near = hand.shape.hulls.look(points)
    slopes = np.sqrt(np.einsum("pi,pi->p", near.gradient, near.gradient))
    return near.distance, near.gradient / np.maximum(slopes, 1e-9)[:, None]
