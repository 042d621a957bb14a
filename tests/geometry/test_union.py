"""Bodies that overlap, touch or nearly touch become one closed body; everything else stays."""

import numpy as np
import pytest

import airtact as at
from airtact.geometry.checks import check_surface
from faults import raises_code
from geometry.mesh.meshes import box_mesh

BALL = 4 / 3 * np.pi * 0.008**3


def pair(gap: float) -> list[at.Surface]:
    return [at.sphere(0.008, 0.004), at.sphere(0.008, 0.004, centre=(0.016 + gap, 0.0, 0.0))]


@pytest.mark.parametrize("overlap", [0.001, 0.004])
def test_balls_that_overlap_hold_the_volume_of_their_union(overlap):
    body = at.geometry.merged(pair(-overlap))
    check_surface(body)
    lens = (
        np.pi * (4 * 0.008 + 0.016 - overlap) * overlap**2 / 12
    )  # two caps, of equal radii and centre distance d
    assert body.volume == pytest.approx(2 * BALL - lens, rel=3e-3)


@pytest.mark.parametrize("gap", [0.0, 0.0001, 0.00025])
def test_balls_that_nearly_touch_are_bridged_and_stay_elsewhere(gap):
    bodies = pair(gap)
    body = at.geometry.merged(bodies)
    check_surface(body)
    assert 2 * BALL * 0.998 < body.volume < 2 * BALL * 1.02
    middle = np.array([[0.008 + gap / 2, 0.0, 0.0]])
    assert body.depth(middle)[0] > 0
    far = body.vertices[np.abs(body.vertices[:, 0] - middle[0, 0]) > 0.003]
    off = np.min([np.abs(one.depth(far)) for one in bodies], axis=0)
    assert off.max() < 2e-5


def test_a_rod_through_a_box_and_three_in_a_row():
    box = at.Surface(*box_mesh(high=(0.02,) * 3))
    rod = at.capsule((-0.02, 0.01, 0.01), (0.04, 0.01, 0.01), 0.004, 0.003)
    body = at.geometry.merged([box, rod])
    check_surface(body)
    inside = np.pi * 0.004**2 * 0.02
    assert body.volume == pytest.approx(8e-6 + rod.volume - inside, rel=5e-3)
    row = [at.sphere(0.005, 0.003, centre=(0.0102 * i, 0.0, 0.0)) for i in range(3)]
    assert at.geometry.merged(row).volume == pytest.approx(4 * np.pi * 0.005**3, rel=2e-2)


def test_one_body_and_one_inside_another_come_back_as_they_are():
    ball = at.sphere(0.008, 0.004)
    assert at.geometry.merged([ball]) is ball
    assert at.geometry.merged([at.sphere(0.003, 0.002), ball]) is ball


def test_bodies_far_apart_are_rejected_with_their_distance():
    with raises_code("misplaced", " 0.3 mm"):
        at.geometry.merged(pair(0.001))
    with raises_code("empty"):
        at.geometry.merged([])
