"""The pinch has the geometry of its drawing."""

import math

import numpy as np
import pytest

import airtact as at
from airtact.acoustics.scene import Scene, check_outside, sound_hard
from airtact.geometry.primitives import nearest_on_segments
from faults import raises_code


def test_tips_axes_and_tilt_are_those_of_the_drawing():
    for side, surface in zip((-1, 1), at.pinch(gap=0.012).surfaces, strict=True):
        root, tip = surface.primitive.axis
        assert surface.primitive.radius == 8e-3
        assert np.allclose(tip, [side * (0.006 + 0.008), 0, 0], rtol=0, atol=1e-16)
        down = root - tip
        assert np.linalg.norm(down) == pytest.approx(44e-3)
        assert math.degrees(math.acos(-down[2] / 44e-3)) == pytest.approx(20.0)
        assert down[0] * side > 0
        assert down[1] == 0


@pytest.mark.parametrize("gap", [1e-3, 0.012, 0.04])
def test_pads_are_the_points_of_each_skin_nearest_the_other(gap):
    hand = at.pinch(gap)
    thumb, finger = (surface.primitive for surface in hand.surfaces)
    here, there = nearest_on_segments(thumb.axis, finger.axis)
    distance = np.linalg.norm(there - here)
    between = (there - here) / distance
    assert distance - 2 * 8e-3 == pytest.approx(gap)
    assert np.allclose(
        hand.pads, [here + 8e-3 * between, there - 8e-3 * between], rtol=0, atol=1e-16
    )
    assert np.allclose(hand.normals, [between, -between], rtol=0, atol=1e-15)
    assert math.dist(*hand.pads) == pytest.approx(hand.gap)
    assert np.abs(np.diag([thumb.depth(hand.pads), finger.depth(hand.pads)])).max() < 1e-16


def test_foci_stand_off_the_pads_into_the_gap():
    hand = at.pinch()
    scene = Scene(at.Medium(343.1, 1.293), [sound_hard(surface) for surface in hand.surfaces])
    assert scene.depth(hand.foci()) == pytest.approx([-0.5e-3, -0.5e-3], abs=1e-16)
    assert scene.depth(hand.foci(2e-3)) == pytest.approx([-2e-3, -2e-3], abs=1e-16)
    check_outside(scene, hand.foci(0.0), "focus")


@pytest.mark.parametrize("gap", [0.0, -0.01, math.nan, 12])
def test_a_gap_is_above_zero_and_in_metres(gap):
    with raises_code("out_of_range", f"{gap:g} m"):
        at.pinch(gap)


@pytest.mark.parametrize("offset", [-1e-3, 0.012, math.nan])
def test_foci_stay_in_the_gap(offset):
    with raises_code("out_of_range", f"{1e3 * offset:g} mm", "12 mm"):
        at.pinch().foci(offset)
