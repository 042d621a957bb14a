"""Hands fitted to clouds: against a true hand of another shape family, against our own body, and what is refused."""

import numpy as np
import pytest

from airtact.scene.capture import FittedHand, fit_hand
from scene.rigged_hand import Rigged, posed, rough, seen, turned_to_camera

CAMERA = np.zeros(3)


@pytest.fixture(scope="module")
def true_hand() -> Rigged:
    return turned_to_camera(posed("pinch"), 1)


@pytest.fixture(scope="module")
def fitted(true_hand: Rigged) -> FittedHand:
    return fit_hand(seen(true_hand, 1), rough(true_hand.joints, 1), "right", CAMERA)


def test_true_skin_is_near_the_fitted_one(true_hand: Rigged, fitted: FittedHand) -> None:
    off = np.abs(fitted.hand.shape.depth(true_hand.vertices))

    assert off.mean() < 2.5e-3
