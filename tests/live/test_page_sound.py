"""What the page computes of the sound and the skin, against the whole elements and the exact body."""

import numpy as np
import pytest

import airtact as at
from airtact.geometry.mesh.triangles import check_closed
from airtact.live.page.view import MovingSkin
from live.live_scenes import direct_sound, one_board, playing
from references.motions import Pinching


@pytest.fixture(scope="module")
def board():
    scene = one_board()
    return scene, playing(scene)


def in_open_air(scene: at.live.LiveScene, drive: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Pressure of the whole elements, all points of their faces."""
    empty = at.Scene(scene.medium, [], frequency=scene.frequency)
    return at.field_map(empty, scene.array, at.Drive(drive), points, solver=at.FreeField())


def test_elements_as_points_give_the_field_of_whole_ones_near_the_foci(board) -> None:
    scene, moment = board
    middle = moment.foci.mean(axis=0)
    random = np.random.default_rng(1)
    for reach, error in ((0.01, 0.02), (0.06, 0.03)):
        points = middle + random.uniform(-reach, reach, size=(300, 3))
        exact = in_open_air(scene, moment.amplitudes, points)
        found = direct_sound(scene, points, moment.amplitudes)
        most = np.abs(in_open_air(scene, moment.amplitudes, moment.foci)).max()
        print(f"within {reach:g} m: {np.abs(found - exact).max() / most:.4f}")
        assert np.abs(found - exact).max() < error * most


def test_the_skin_stays_closed_on_the_body_while_fingers_open() -> None:
    motion = Pinching(5)
    skin = MovingSkin(motion.radii)
    first = None
    for time in (0.0, 0.2, 0.5):
        joints = motion.at(time)
        vertices = skin.at(joints)
        first = skin.triangles if first is None else first
        assert skin.triangles is first
        check_closed(vertices, first)
        shape = at.hand_from_joints(joints, motion.radii).shape
        assert np.abs(shape.depth(vertices)).max() < 1e-6
