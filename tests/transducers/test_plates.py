"""Boards that reflect: their bodies, and what elements in their faces bring to a focus."""

import numpy as np
import pytest

import airtact as at
from airtact.transducers.placement import check_placement
from airtact.transducers.plates import THICKNESS
from faults import raises_code

DULL = at.Medium(sound_speed=343.1, density=1.293, absorption=100.0)
"""Air in which hardly any sound comes back from the edge of a board, so that it is a baffle without end."""

AIR = at.Medium(sound_speed=343.1, density=1.293)
BALL = at.sound_hard(at.sphere(6e-3, 3e-3, centre=(0.0, 0.0, 0.03)))


def board_array(name="autd3"):
    return at.transducers.board_array(name)


def box(width, height, thickness):
    """Eight corners under the plane z = 0."""
    x = 0.5 * width
    y = 0.5 * height
    z = -thickness
    corners = np.array([[a, b, c] for a in (-x, x) for b in (-y, y) for c in (z, 0.0)])
    faces = [
        (0, 1, 3),
        (0, 3, 2),
        (4, 6, 7),
        (4, 7, 5),
        (0, 4, 5),
        (0, 5, 1),
        (2, 3, 7),
        (2, 7, 6),
        (0, 2, 6),
        (0, 6, 4),
    ]
    return at.Surface(corners, np.array([*faces, (1, 5, 7), (1, 7, 3)]))


def few(array, chosen):
    """Some elements of an array."""
    parts = array.positions[chosen], array.normals[chosen], array.element, array.tangents[chosen]
    return at.PhasedArray(*parts)


def small_board():
    """16 elements in the middle of a board of 80 by 80 mm, and its body."""
    across = 10.16e-3 * (np.arange(4) - 1.5)
    positions = np.array([(x, y, 0.0) for y in across for x in across])
    array = at.PhasedArray(positions, np.tile([0.0, 0.0, 1.0], (16, 1)), at.piston(4e-3, points=12))
    return array, at.acoustics.Obstacle(box(0.08, 0.08, THICKNESS), "sound_hard", board=True)


def relative(found, exact):
    return float(np.linalg.norm(found - exact) / np.linalg.norm(exact))


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
    plate = box(0.024, 0.02, 4e-3)
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


def test_what_does_not_go_together_is_rejected():
    array = board_array()
    boards = at.reflecting_boards(array)
    with raises_code("wrong_kind"):
        at.reflecting_boards(few(array, slice(0, 3)))
    with raises_code("unknown_name"):
        at.reflecting_boards(board_array("openmpd"))
    with raises_code("out_of_range"):
        at.reflecting_boards(array, thickness=1.6)
    with raises_code("bodies_overlap"):
        at.Scene(AIR, [at.sound_hard(at.sphere(6e-3, 3e-3, centre=(0.09, 0.07, 0.003))), *boards])
    with raises_code("bodies_overlap"):
        at.Scene(AIR, [at.sound_hard(at.sphere(6e-3, 3e-3, centre=(0.09, 0.07, 6.1e-3))), *boards])
    with raises_code("bodies_overlap"):
        at.Scene(AIR, boards, planes=[at.plane((0, 0, -2e-3), (0, 0, 1))])
    scene = at.Scene(AIR, boards)
    target = at.Target(np.array([[0.086, 0.066, 0.1]]))
    lifted = array.moved(at.Pose(np.eye(3), np.array([0, 0, 2e-3])))
    with raises_code("not_supported"):
        check_placement(scene, lifted, target.points)
    with raises_code("not_supported"):
        at.FiniteElement().radiate(scene, target.beacons())
