"""Layouts against the numbers of the board and of the paper, and rigid motion against itself."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import airtact as at
from faults import raises_code

unit = st.floats(-1.0, 1.0)
poses = st.builds(
    lambda axis, angle, shift: at.Pose.turn((axis[0], axis[1], 1.1 + axis[2]), angle, shift),
    st.tuples(unit, unit, unit),
    st.floats(-3.2, 3.2),
    st.tuples(unit, unit, unit),
)


def test_board_has_the_cells_and_the_order_of_the_real_one() -> None:
    board = at.autd3_board()
    cells = {
        0: (0, 0),
        17: (17, 0),
        18: (0, 1),
        19: (3, 1),
        31: (15, 1),
        32: (17, 1),
        33: (0, 2),
        248: (17, 13),
    }
    assert len(board) == 249
    for index, (column, row) in cells.items():
        expected = [column * 10.16e-3, row * 10.16e-3, 0.0]
        np.testing.assert_allclose(board.positions[index], expected, rtol=0, atol=1e-12)
    empty = [(1, 1), (2, 1), (16, 1)]
    occupied = {
        tuple(cell) for cell in np.rint(board.positions[:, :2] / 10.16e-3).astype(int).tolist()
    }
    assert occupied == {(x, y) for x in range(18) for y in range(14)} - set(empty)
    np.testing.assert_array_equal(board.normals, np.tile([0.0, 0.0, 1.0], (249, 1)))
    np.testing.assert_array_equal(board.tangents, np.tile([1.0, 0.0, 0.0], (249, 1)))


def test_the_box_stands_around_its_centre_face_by_face() -> None:
    box = at.surrounding_box()
    assert len(box) == 996
    for face, (axis, sign) in enumerate([(0, 1), (0, -1), (1, 1), (1, -1)]):
        part = slice(249 * face, 249 * (face + 1))
        inwards = np.zeros(3)
        inwards[axis] = -sign
        np.testing.assert_allclose(box.positions[part, axis], sign * 70e-3, rtol=0, atol=1e-15)
        np.testing.assert_array_equal(box.normals[part], np.tile(inwards, (249, 1)))
        for across, cells in ((1 - axis, 14), (2, 18)):
            values = np.unique(np.round(box.positions[part, across] * 1e3, 6))
            np.testing.assert_allclose(
                values, (np.arange(cells) - (cells - 1) / 2) * 10.16, rtol=0, atol=1e-6
            )
        first, second = box.positions[249 * face], box.positions[249 * face + 1]
        np.testing.assert_allclose(second - first, [0.0, 0.0, 10.16e-3], rtol=0, atol=1e-15)


def test_flat_boards_lie_edge_to_edge_around_the_origin() -> None:
    array = at.flat_boards(rows=2, columns=3)
    centres = array.positions.reshape(6, 249, 3)
    middle = (centres.min(axis=1) + centres.max(axis=1)) / 2
    expected = [(x, y, 0.0) for y in (-75.7e-3, 75.7e-3) for x in (-192e-3, 0.0, 192e-3)]
    np.testing.assert_allclose(middle, expected, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(array.normals, np.tile([0.0, 0.0, 1.0], (6 * 249, 1)))


@given(poses, poses)
@settings(max_examples=30, deadline=None)
def test_faces_without_given_tangents_move_exactly_too(first: at.Pose, second: at.Pose) -> None:
    normals = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [1.0, 1.0, 1.0], [-0.95, 0.1, 0.2]])
    array = at.PhasedArray(np.arange(12.0).reshape(4, 3) / 10, normals, at.piston(4.5e-3))
    moved = array.moved(first).moved(second)
    np.testing.assert_allclose(
        moved.face_points, (second @ first).apply(array.face_points), rtol=0, atol=1e-12
    )


@given(poses)
@settings(max_examples=30, deadline=None)
def test_seen_from_a_pose_and_carried_back_is_the_array(pose: at.Pose) -> None:
    array = at.autd3_board()
    seen = array.seen_from(pose)
    np.testing.assert_allclose(pose.apply(seen.positions), array.positions, rtol=0, atol=1e-12)
    hand = np.array([0.01, 0.02, 0.03])
    from_hand = np.linalg.norm(seen.positions - hand, axis=1)
    from_array = np.linalg.norm(array.positions - pose.apply(hand), axis=1)
    np.testing.assert_allclose(from_hand, from_array, rtol=0, atol=1e-12)


def test_face_points_stand_in_the_frame_of_tangent_and_normal() -> None:
    element = at.transducers.Element(np.array([[1e-3, 2e-3, 3e-3]]), np.ones(1))
    array = at.PhasedArray(np.zeros((1, 3)), np.array([[0, 0, -2]]), element, np.array([[0, 5, 0]]))
    np.testing.assert_allclose(array.face_points[0, 0], [2e-3, 1e-3, -3e-3], rtol=0, atol=1e-18)


BOARD = at.autd3_board()


def test_join_keeps_order() -> None:
    left = at.autd3_board(at.Pose.shift((-0.2, 0.0, 0.0)))
    both = at.transducers.join([left, BOARD])
    np.testing.assert_array_equal(both.positions, np.concatenate([left.positions, BOARD.positions]))


POINT, UP = np.zeros((2, 3)), np.tile([0.0, 0.0, 1.0], (2, 1))


@pytest.mark.usefixtures("as_outside_the_tests")
@pytest.mark.parametrize(
    ("make", "code"),
    [
        (lambda: at.PhasedArray(np.zeros((0, 3)), np.zeros((0, 3))), "empty"),
        (lambda: at.PhasedArray(POINT, UP[:1]), "wrong_shape"),
        (lambda: at.PhasedArray(POINT, UP, None, UP[:1]), "wrong_shape"),
        (lambda: at.PhasedArray(POINT + [[0], [np.inf]], UP), "not_finite"),
        (lambda: at.PhasedArray(POINT, UP * [[1.0], [0.0]]), "all_zero"),
        (lambda: at.PhasedArray(POINT, UP * np.nan), "all_zero"),
        (lambda: at.PhasedArray(POINT, UP, None, UP + [0.0, 1.0, 0.0]), "out_of_range"),
        (lambda: at.flat_boards(0, 2), "out_of_range"),
        (lambda: at.surrounding_box().facing((0, 0, 0), (0, 0, 1), 0.2), "misplaced"),
        (lambda: at.autd3_board().facing((0, 0, 0), (0, 0, 0), 0.2), "all_zero"),
        (lambda: at.autd3_board().facing((0, 0, 0), (0, 0, 1), -0.2), "out_of_range"),
        (
            lambda: at.transducers.join([BOARD, at.autd3_board(element=at.monopole(1.0))]),
            "sizes_differ",
        ),
        (lambda: at.transducers.join([]), "empty"),
    ],
)
def test_bad_arrays_are_rejected(make, code: str) -> None:
    with raises_code(code):
        make()


@pytest.mark.parametrize("direction", [(0, 0, 1), (0, 0, -1), (-3, 0, 0), (1, 2, -2)])
def test_a_board_faces_a_point_from_any_side(direction) -> None:
    point, away = np.array([0.01, -0.02, 0.03]), np.array(direction) / np.linalg.norm(direction)
    board = at.autd3_board()
    placed = board.facing(point, direction, 0.2)
    np.testing.assert_allclose(placed.positions.mean(axis=0), point + 0.2 * away, atol=1e-12)
    np.testing.assert_allclose(placed.normals, np.tile(-away, (249, 1)), atol=1e-12)
    apart = [np.linalg.norm(one.positions[100] - one.positions, axis=1) for one in (placed, board)]
    np.testing.assert_allclose(apart[0], apart[1], atol=1e-12)


def test_the_spacing_is_that_of_the_nearest_two_elements_wherever_the_array_is():
    board = at.autd3_board()
    assert board.spacing == pytest.approx(10.16e-3)
    assert board.moved(at.Pose.turn((1, 1, 0), 0.7)).spacing == board.spacing
    assert at.PhasedArray(np.zeros((1, 3))).spacing == np.inf
