"""Scenes and moments for the page of the live loop."""

import numpy as np

import airtact as at
from airtact.live.parts import LiveScene, Moment


def one_board() -> LiveScene:
    """One board under a left hand with a focus at the thumb's pad."""
    offsets = np.array([1e-3])
    return LiveScene(at.air(), 40e3, at.autd3_board(), "left", None, ("thumb.pad",), offsets)


def silent(scene: LiveScene, time: float = 0.0) -> Moment:
    """A moment without a hand."""
    return Moment(time, time, None, None, np.zeros(len(scene.array), dtype=np.complex128), state="waiting")
