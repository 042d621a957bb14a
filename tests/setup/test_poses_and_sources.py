"""Poses of bodies, and the pattern of transducers, in scene files."""

import numpy as np
import pytest

from airtact.setup.building import read_scene
from faults import raises_code

AIR = "[medium]\nsound_speed = 343.1\ndensity = 1.293\n"
BOX = '[array]\nlayout = "surrounding_box"\n'
PINCH = "[[obstacles]]\npinch = { gap = 0.012 }\n"
POSE = (
    "[obstacles.pose]\naxis = [0.0, 0.0, 1.0]\ndegrees = 90.0\ntranslation = [0.0, 0.01, 0.002]\n"
)
PAD = '[[foci]]\nat = "thumb.pad"\n'


@pytest.fixture
def read(tmp_path):
    def reader(*parts: str):
        path = tmp_path / "scene.toml"
        path.write_text("".join(parts))
        return read_scene(path)

    return reader


def test_a_pose_moves_a_body_and_the_foci_that_ride_on_it(read) -> None:
    before, after = read(AIR, BOX, PINCH, PAD), read(AIR, BOX, PINCH, POSE, PAD)
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    shift = np.array([0.0, 0.01, 0.002])
    np.testing.assert_allclose(
        after.target.points, before.target.points @ quarter.T + shift, atol=1e-12
    )
    for one, other in zip(before.scene.obstacles, after.scene.obstacles, strict=True):
        np.testing.assert_allclose(
            other.surface.vertices, one.surface.vertices @ quarter.T + shift, atol=1e-12
        )
    assert -after.scene.depth(after.target.points)[0] == pytest.approx(0.5e-3, abs=1e-9)


def test_a_mesh_in_millimetres_is_placed_by_a_pose(read, tmp_path) -> None:
    import trimesh

    trimesh.creation.icosphere(subdivisions=3, radius=5.0).export(tmp_path / "ball.stl")
    mesh = '[[obstacles]]\nsurface = "ball.stl"\nscale = 1e-3\n[obstacles.pose]\ntranslation = [0.0, 0.0, 0.02]\n'
    setup = read(AIR, BOX, mesh, "[[foci]]\npoint = [0.0, 0.0, 0.03]\n")
    middle = setup.scene.obstacles[0].surface.vertices.mean(axis=0)
    np.testing.assert_allclose(middle, [0.0, 0.0, 0.02], atol=1e-5)


def test_a_pose_may_turn_by_more_than_a_whole_turn(read) -> None:
    once, more = (
        read(AIR, BOX, PINCH, POSE.replace("90.0", degrees), PAD) for degrees in ("90.0", "450.0")
    )
    np.testing.assert_allclose(more.target.points, once.target.points, atol=1e-12)


def test_the_pattern_of_autd3_is_half_at_fifty_degrees(read) -> None:
    """As the makers' curve of T4010A1, which the SDK of AUTD3 holds: 0.501 at 50 degrees."""
    setup = read(AIR, BOX, "[[foci]]\npoint = [0.0, 0.0, 0.0]\n")
    sideways = np.array([[np.sin(np.radians(50.0)), 0.0, np.cos(np.radians(50.0))]])
    pattern = setup.array.element.far_pattern(sideways, setup.scene.wavenumber.real)
    assert abs(pattern[0]) == pytest.approx(0.501, abs=0.02)


def test_a_source_is_a_monopole_by_name(read) -> None:
    focus = "[[foci]]\npoint = [0.0, 0.0, 0.0]\n"
    assert not read(AIR, BOX, 'source = "monopole"\n', focus).array.element.directional
    with raises_code("unknown_name", 'source = "pistn"', "did you mean piston?"):
        read(AIR, BOX, 'source = "pistn"\n', focus)
    with raises_code("key_misplaced", "piston_radius = 0.004"):
        read(AIR, BOX, 'source = "monopole"\npiston_radius = 4e-3\n', focus)


def test_a_board_that_faces_away_is_named(read) -> None:
    away = "{ axis = [1.0, 0.0, 0.0], degrees = 180.0, translation = [0.0, 0.0, -0.1] }"
    array = (
        f'[array]\nlayout = "boards"\nposes = [{{ translation = [-0.1, -0.1, -0.1] }}, {away}]\n'
    )
    with raises_code(
        "behind_faces", "focus 0 stands 100 mm behind board 1 of 2 (autd3, 249 elements)"
    ):
        read(AIR, array, "[[foci]]\npoint = [0.0, 0.0, 0.0]\n")


def test_the_name_of_a_board_is_no_layout(read) -> None:
    with raises_code("unknown_name", 'layout = "boards", board = "autd3"'):
        read(AIR, '[array]\nlayout = "autd3"\nrows = 1\n', "[[foci]]\npoint = [0.0, 0.0, 0.0]\n")


def test_a_pose_is_no_scene(tmp_path) -> None:
    with raises_code("unknown_format", "pinch.json is not a scene file"):
        read_scene(tmp_path / "pinch.json")
