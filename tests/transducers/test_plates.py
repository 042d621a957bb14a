"""Boards that reflect: their bodies, and what elements in their faces bring to a focus."""

import numpy as np
import pytest

import airtact as at
from airtact.transducers.placement import THICKNESS, check_placement
from faults import raises_code
from geometry.mesh.meshes import box_mesh
from references import relative
from worlds import AIR

DULL = at.Medium(sound_speed=343.1, density=1.293, absorption=100.0)
"""Air in which hardly any sound comes back from the edge of a board, so that it is a baffle without end."""

BALL = at.sound_hard(at.sphere(6e-3, 3e-3, centre=(0.0, 0.0, 0.03)))


def small_board():
    """16 elements in the middle of a board of 80 by 80 mm, and its body."""
    across = 10.16e-3 * (np.arange(4) - 1.5)
    positions = np.array([(x, y, 0.0) for y in across for x in across])
    array = at.PhasedArray(positions, np.tile([0.0, 0.0, 1.0], (16, 1)), at.piston(4e-3, points=12))
    plate = at.Surface(*box_mesh((-0.04, -0.04, -THICKNESS), (0.04, 0.04, 0.0)))
    return array, at.acoustics.Obstacle(plate, "sound_hard", board=True)


@pytest.mark.parametrize(
    ("array", "sides"),
    [
        (at.autd3_board(), [192.0, 151.4, 8.7]),
        (at.flat_boards(2, 1), [192.0, 302.8, 8.7]),
        (at.surrounding_box(), [157.4, 157.4, 192.0]),
        (at.surrounding_box(board="autd3"), [168.8, 168.8, 192.0]),
    ],
)
def test_boards_that_touch_or_overlap_are_one_body_of_the_makers_outline(array, sides):
    (board,) = at.reflecting_boards(array)
    assert np.allclose(1e3 * np.ptp(board.surface.vertices, axis=0), sides, atol=1e-3)
    assert np.abs(board.surface.depth(array.positions)).max() < 1e-9
    at.Scene(AIR, [board])


def test_boards_apart_are_bodies_of_their_own():
    poses = [at.Pose.identity(), at.Pose.turn((0, 1, 0), np.pi, translation=(0.17272, 0, 0.3))]
    boards = at.reflecting_boards(at.transducers.board_array("autd3", poses))
    assert len(boards) == 2
    assert [one.surface.volume for one in boards] == pytest.approx(
        [0.192 * 0.1514 * THICKNESS] * 2, rel=1e-9
    )


def test_before_a_board_without_edges_an_element_is_a_piston_in_a_baffle():
    """The closed form is that of its points in open air: the board's mirror image is in the stated sensitivity."""
    array, board = small_board()
    scene = at.Scene(DULL, [board])
    target = at.Target(np.array([[0.0, 0.0, 0.012], [0.01, 0.005, 0.02]]))
    found = at.transfer_matrix(at.BoundaryElement(0.03).radiate(scene, target.beacons()), array)
    assert relative(found.matrix, at.open_air_matrix(scene, array, target).matrix) < 2e-3


def test_a_body_before_a_board_without_edges_is_as_before_a_plane():
    """A plane doubles what its elements radiate by themselves, a board does not."""
    array, board = small_board()
    target = at.Target(np.array([[0.0, 0.0, 0.023], [0.008, 0.0, 0.028]]))
    solver = at.BoundaryElement(0.03)
    table = at.plane((0, 0, 0), (0, 0, 1))
    scenes = at.Scene(DULL, [BALL, board]), at.Scene(DULL, [BALL], planes=[table])
    found, before_plane = (
        at.transfer_matrix(solver.radiate(one, target.beacons()), array).matrix for one in scenes
    )
    assert relative(found, before_plane) < 0.015


@pytest.mark.slow
def test_a_small_board_with_its_edges_is_that_of_finite_elements():
    plate = at.Surface(*box_mesh((-0.012, -0.01, -4e-3), (0.012, 0.01, 0.0)))
    source = np.array([[0.003, 0.001, 0.007]])
    faces = np.array([[0.0, 0.0, 0.0], [0.007, 0.004, 0.0], [-0.006, -0.005, 0.0]])
    array = at.PhasedArray(faces, np.tile([0.0, 0.0, 1.0], (3, 1)), at.piston(3e-3, points=12))
    beacon = at.Target(source).beacons()
    sound_hard = at.Scene(AIR, [at.sound_hard(plate)])
    on_face = (
        at.FiniteElement(order=4).radiate(sound_hard, beacon).at(array.face_points.reshape(-1, 3))
    )
    exact = 0.5 * array.element.sensitivity * on_face.reshape(3, -1) @ array.element.weights
    scene = at.Scene(AIR, [at.acoustics.Obstacle(plate, "sound_hard", board=True)])
    found = at.transfer_matrix(at.BoundaryElement(0.01).radiate(scene, beacon), array)
    assert relative(found.matrix[0], exact) < 0.02


def test_what_a_drive_makes_is_what_its_transfer_matrix_says():
    """The field of all elements, solved forwards, against the readings of the beacons on the face."""
    array, board = small_board()
    points = np.array([[0.0, 0.0, 0.023], [0.0, 0.0065, 0.03], [0.05, 0.03, 0.1]])
    scene = at.Scene(at.air(), [BALL, board])
    target = at.Target(points)
    solver = at.BoundaryElement(0.03)
    transfer = at.transfer_matrix(solver.radiate(scene, target.beacons()), array)
    drive = at.best(transfer, target)
    made = at.field_map(
        scene, array, drive, np.concatenate([points, [[0.0, 0.0, 1e-3]]]), solver=solver
    )
    assert np.abs(made[:3] - transfer.pressure(drive)).max() < 0.02 * np.abs(made[:3]).max()
    assert np.isnan(made[3])  # beside the face


ARRAY = at.autd3_board()
BOARDS = at.reflecting_boards(ARRAY)
FOCUS = np.array([[0.086, 0.066, 0.1]])


def beside(height: float) -> at.acoustics.Obstacle:
    return at.sound_hard(at.sphere(6e-3, 3e-3, centre=(0.09, 0.07, height)))


@pytest.mark.parametrize(
    ("code", "make"),
    [
        ("wrong_kind", lambda: at.reflecting_boards(at.PhasedArray(ARRAY.positions[:3]))),
        (
            "unknown_name",
            lambda: at.reflecting_boards(at.transducers.board_array("openmpd")),
        ),
        ("out_of_range", lambda: at.reflecting_boards(ARRAY, thickness=1.6)),
        ("bodies_overlap", lambda: at.Scene(AIR, [beside(0.003), *BOARDS])),
        ("bodies_overlap", lambda: at.Scene(AIR, [beside(6.1e-3), *BOARDS])),
        (
            "bodies_overlap",
            lambda: at.Scene(AIR, BOARDS, planes=[at.plane((0, 0, -2e-3), (0, 0, 1))]),
        ),
        (
            "not_supported",
            lambda: check_placement(
                at.Scene(AIR, BOARDS), ARRAY.moved(at.Pose.shift((0, 0, 2e-3))), FOCUS
            ),
        ),
        (
            "not_supported",
            lambda: at.FiniteElement().radiate(at.Scene(AIR, BOARDS), at.Target(FOCUS).beacons()),
        ),
    ],
)
def test_what_does_not_go_together_is_rejected(code, make):
    with raises_code(code):
        make()
