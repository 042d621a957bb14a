"""Hands: from joints, from files, fitted to a point cloud; named positions on scans; and the pinch of the paper."""

from airtact.hand.anatomy_parts import Touch
from airtact.hand.files import load_cloud, load_hand, load_landmarks
from airtact.hand.fitting.fit import FittedHand, fit_hand
from airtact.hand.fitting.size_prior import HandAnatomy
from airtact.hand.hand import Hand, hand_from_joints
from airtact.hand.pinch import Pinch, pinch
from airtact.hand.scans import load_rigged_hand, places_on

__all__ = [
    "FittedHand",
    "Hand",
    "HandAnatomy",
    "Pinch",
    "Touch",
    "fit_hand",
    "hand_from_joints",
    "load_cloud",
    "load_hand",
    "load_landmarks",
    "load_rigged_hand",
    "pinch",
    "places_on",
]
