"""Where an array may be in a scene with a plane, and what it reaches in open air."""

import numpy as np
import pytest

import airtact as at
from airtact.setup.sentences import reach_cautions
from airtact.transducers.placement import (
    check_placement,
    open_air_bound,
    overlapping_boards,
    strongest_open_air,
)
from faults import raises_code
from worlds import AIR

SCENE = at.Scene(AIR, [], planes=[at.plane((0, 0, 0), (0, 0, 1))])
FOCUS = np.array([[0.08, 0.06, 0.15]])


def at_height(height: float) -> at.PhasedArray:
    return at.autd3_board(at.Pose(np.eye(3), np.array([0.0, 0.0, height])))


def test_a_board_in_the_plane_or_facing_it_is_right():
    check_placement(SCENE, at_height(0.0), FOCUS)
    turned = at.Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.12, 0.3]))
    check_placement(SCENE, at.autd3_board(turned), FOCUS)


@pytest.mark.parametrize(
    ("obstacles", "height", "code"),
    [
        ([], -1e-3, "behind_plane"),
        # its elements radiate forwards only, and the image of its back would sound
        ([], 0.02, "behind_faces"),
        ([at.sound_hard(at.sphere(5e-3, 2e-3, centre=(0.08, 0.06, 0.15)))], 0.02, "behind_faces"),
    ],
)
def test_a_board_behind_the_plane_or_with_its_back_to_it_is_rejected(obstacles, height, code):
    scene = at.Scene(AIR, obstacles, planes=SCENE.planes)
    with raises_code(code):
        check_placement(scene, at_height(height), None if obstacles else FOCUS)


def twice(array: at.PhasedArray, shift: float) -> at.PhasedArray:
    moved = array.moved(at.Pose(np.eye(3), np.array([shift, 0.0, 0.0])))
    return at.transducers.join([array, moved])


def test_elements_nearer_than_their_radius_are_rejected():
    """A board at one place twice, or a list pasted twice, would double the pressure."""
    scene = at.Scene(AIR, [])
    target = at.Target(FOCUS)
    beacons = at.FreeField().radiate(scene, target.beacons())
    points = at.autd3_board().positions
    for array in (
        twice(at.autd3_board(), 0.0),
        twice(at.autd3_board(), 5 * 10.16e-3),
        twice(at.autd3_board(), 3.9e-3),
        at.PhasedArray(np.concatenate([points, points])),
    ):
        for matrix in (
            lambda array: at.transfer_matrix(beacons, array),
            lambda array: at.open_air_matrix(scene, array, target),
        ):
            with raises_code("bodies_overlap"):
                matrix(array)
    # the paper's own box comes to 5.6 mm at its corners
    for array in (twice(at.autd3_board(), 4.1e-3), at.surrounding_box(), at.flat_boards()):
        check_placement(scene, array)


def test_an_array_with_normals_radiates_forwards_only():
    board = at.autd3_board()
    behind = at.Target(np.array([[0.08, 0.06, -0.1]]))
    scene = at.Scene(AIR, [])
    with raises_code("behind_faces"):
        at.open_air_matrix(scene, at.PhasedArray(board.positions, board.normals), behind)
    assert at.open_air_matrix(scene, at.PhasedArray(board.positions), behind).matrix.all()
    assert at.PhasedArray(board.positions, board.normals).element.radius == 4.5e-3


WAVENUMBER = 2 * np.pi * 40e3 / 343.1


def test_the_bound_of_monopoles_is_the_sum_over_distances() -> None:
    array, point = at.autd3_board(element=at.monopole()), np.array([[0.02, -0.03, -0.15]])
    bound = 4.38 * (1.0 / np.linalg.norm(array.positions - point, axis=1)).sum()
    assert open_air_bound(array, point, WAVENUMBER)[0] == pytest.approx(bound, rel=1e-12)


def test_pistons_bring_nothing_behind_them_and_dead_ones_nothing() -> None:
    board, behind = at.autd3_board(), np.array([[0.08, 0.06, -0.1]])
    assert open_air_bound(board, behind, WAVENUMBER)[0] == 0.0
    half = board.calibrated(np.r_[np.ones(125), np.zeros(124)])
    first = at.PhasedArray(
        board.positions[:125], board.normals[:125], board.element, board.tangents[:125]
    )
    bounds = [open_air_bound(one, -behind * [-1, -1, 1], WAVENUMBER)[0] for one in (half, first)]
    assert bounds[0] == pytest.approx(bounds[1], rel=1e-12)


def test_a_box_reaches_its_middle_and_hardly_half_a_metre_beyond_its_end() -> None:
    box = at.surrounding_box()
    middle, beyond = open_air_bound(box, np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.5]]), WAVENUMBER)
    strongest = strongest_open_air(box, WAVENUMBER)
    assert middle > 0.95 * strongest
    assert beyond < 0.1 * strongest


def test_flat_boards_reach_a_metre() -> None:
    boards = at.flat_boards(2, 2)
    assert open_air_bound(boards, np.array([[0.0, 0.0, 1.0]]), WAVENUMBER)[
        0
    ] > 0.1 * strongest_open_air(boards, WAVENUMBER)


def test_a_board_flush_in_a_table_keeps_its_sensitivity():
    target = at.Target(FOCUS)
    bare = at.Scene(AIR, [])
    board = at_height(0.0)
    matrices = []
    for scene in (SCENE, bare):
        beacons = at.FreeField().radiate(scene, target.beacons())
        matrices.append(at.transfer_matrix(beacons, board).matrix)
        drive = at.Drive(np.ones(len(board), dtype=np.complex128))
        fields = at.evaluate(scene, board, drive, target, solver=at.FreeField())
        np.testing.assert_allclose(fields.pressures, matrices[-1].sum(axis=1), rtol=1e-6)
    np.testing.assert_allclose(matrices[0], matrices[1], rtol=1e-6)


def test_a_table_under_a_board_changes_nothing_and_a_setup_says_so():
    board = at.autd3_board()
    target = at.Target(FOCUS)
    for height in (2e-3, 20e-3, 30e-3):
        table = at.plane((0, 0, -height), (0, 0, 1))
        setup = at.Setup(at.Scene(AIR, [], planes=[table]), board, target)
        assert not setup.scene.planes
        (caution,) = (text for text in reach_cautions(setup) if "plane" in text)
        assert f"{1e3 * height:g} mm" in caution
    # a board over its edge, or one that faces the table, is no board that lies on it
    facing = at.Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.12, 0.3]))
    assert at.Setup(SCENE, at.autd3_board(facing), target).scene.planes


@pytest.mark.parametrize("shift", [(0.1, 0.0, 0.0), (0.0, 0.08, 0.0), (0.17, 0.12, 1e-3)])
def test_boards_that_overlap_are_named_with_the_place(shift):
    # half a pitch, so that no two elements are nearer than a radius
    shift = np.array(shift) + [5.08e-3, 5.08e-3, 0.0]
    boards = at.transducers.board_array("autd3", [at.Pose.identity(), at.Pose.shift(shift)])
    setup = at.Setup(at.Scene(AIR), boards, at.Target(FOCUS))
    (caution,) = (text for text in reach_cautions(setup) if "overlap" in text)
    assert "boards 0 and 1" in caution


def test_boards_edge_to_edge_and_in_the_boxes_of_the_paper_do_not_overlap():
    for array in (at.flat_boards(), at.surrounding_box(), at.surrounding_box(board="autd3")):
        assert overlapping_boards(array) is None
    assert overlapping_boards(at.PhasedArray(at.autd3_board().positions)) is None
