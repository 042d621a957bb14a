"""How loud it is around an array, against sums that can be done by hand."""

import numpy as np
import pytest

from airtact.drives.head_level import pressures_around
from airtact.transducers.layout import autd3_board

K = 2 * np.pi * 40e3 / 343.0


def test_one_element_is_as_loud_as_its_distance_says() -> None:
    """p = s d / r on a sphere of half a metre around one element."""
    loud = pressures_around(np.zeros((1, 3)), np.array([[0.5 + 0.0j]]), 4.38, K)
    assert loud == pytest.approx((4.38 * 0.5 / 0.5,) * 2, rel=1e-5)


def test_the_strongest_frame_and_the_mean_of_all_count() -> None:
    drives = np.array([[0.1], [1.0], [0.0]], dtype=complex)
    peak, average = pressures_around(np.zeros((1, 3)), drives, 1.0, K, distance=2.0)
    assert peak == pytest.approx(0.5, rel=1e-5)  # in single precision
    assert average == pytest.approx(0.5 * np.sqrt(1.01 / 3), rel=1e-5)


def test_a_beam_is_found_where_it_goes() -> None:
    """All in phase towards a far point: no more than all summed at the nearest distance, and nearly that."""
    board = autd3_board()
    middle = (board.positions.min(axis=0) + board.positions.max(axis=0)) / 2
    reach = np.linalg.norm(board.positions - middle, axis=1).max()
    apart = np.linalg.norm(board.positions - middle - [0.0, 0.0, reach + 0.5], axis=1)
    drive = np.exp(-1j * K * apart)[None]
    most = np.sum(1.0 / apart)
    assert 0.85 * most < pressures_around(board.positions, drive, 1.0, K)[0] <= 1.01 * most


def test_silence_is_silent() -> None:
    assert pressures_around(np.zeros((1, 3)), np.zeros((1, 1), dtype=complex), 1.0, K) == (0.0, 0.0)
