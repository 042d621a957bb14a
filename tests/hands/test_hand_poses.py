"""Whatever the fingers do, a hand gets a closed skin of even triangles."""

import numpy as np
import pytest

from airtact.geometry.mesh.triangles import edge_twins, shells
from airtact.hands.body import hand_hulls
from airtact.hands.joints import joints_of
from airtact.hands.skin_mesh import even_skin
from references.hand_poses import example, random_pose

REST, RADII = example("relaxed")


def held_to_the_figures(seeds: range) -> np.ndarray:
    """Smallest angle of each; all are closed, one piece, outward and on the skin."""
    angles = []
    for seed in seeds:
        hulls, _ = hand_hulls(joints_of(random_pose(seed, REST)), RADII)
        skin = even_skin(hulls, 7e-3)
        corners = skin.vertices[skin.triangles]
        volume = np.einsum("ti,ti->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
        assert edge_twins(skin.triangles).min() >= 0, seed
        assert shells(skin.triangles).max() == 0, seed
        assert 2.5e-4 < volume < 4.5e-4, seed
        assert np.abs(hulls.look(skin.vertices).distance).max() < 30e-6, seed
        angles.append(skin.angles.min())
    return np.array(angles)


def test_random_poses_are_closed_and_even():
    assert held_to_the_figures(range(10)).min() >= 20


@pytest.mark.slow
@pytest.mark.parametrize("hundreds", range(100))
def test_ten_thousand_poses_are_closed_and_even(hundreds):
    angles = held_to_the_figures(range(100 * hundreds, 100 * hundreds + 100))
    assert angles.min() >= 10
    assert (
        np.mean(angles >= 20) >= 0.98
    )  # 99.9 % of all: see benchmarks/hand_meshing.py, which counts them together


def test_among_the_poses_are_touching_and_crossing_fingers():
    gaps = [
        touch.gap
        for seed in range(60)
        for touch in hand_hulls(joints_of(random_pose(seed, REST)), RADII)[1]
    ]
    assert len(gaps) > 30
    assert min(gaps) < -5e-3
