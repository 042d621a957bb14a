"""The open-air bound against sums by hand, and where an array reaches."""

import numpy as np
import pytest

import airtact as at
from airtact.transducers.reach import open_air_bound, strongest_open_air

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
