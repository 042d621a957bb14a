"""Laws of time reversal and phase conjugation, on matrices in closed form and at random."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import airtact as at
from closed_form_transfers import any_points, random_matrix
from faults import raises_code

AIR = at.Medium(343.1, 1.293)
FREQUENCY = 40e3
parts = st.floats(-1.0, 1.0)


complex_rows = hnp.arrays(np.float64, (2, 40), elements=parts).filter(
    lambda rows: np.abs(rows).max() > 1e-3
)


@given(st.integers(0, 2**32 - 1), complex_rows)
@settings(max_examples=200, deadline=None)
def test_for_one_focus_no_drive_gives_more_at_equal_energy_or_peak(
    seed: int, rows: np.ndarray
) -> None:
    transfer = random_matrix(seed, foci=1)
    target = at.Target(any_points(1))
    rival = rows[0] + 1j * rows[1]
    pressure = np.abs(transfer.matrix @ rival)[0] * (1.0 - 1e-12)
    reversal = at.time_reversal(transfer, target)
    energy = np.linalg.norm(reversal.amplitudes) / np.linalg.norm(rival)
    assert np.abs(transfer.pressure(reversal))[0] >= energy * pressure
    conjugate = at.drives.phase_conjugate(transfer, target)
    assert np.abs(transfer.pressure(conjugate))[0] >= pressure / np.abs(rival).max()


def test_time_reversal_is_the_weighted_conjugate_scaled_by_one_number() -> None:
    transfer = random_matrix(3, foci=4)
    asked = np.array([100.0, 200.0, 0.0, 50.0])
    drive = at.time_reversal(transfer, at.Target(any_points(4), asked))
    ratio = drive.amplitudes / (asked @ transfer.matrix.conj())
    np.testing.assert_allclose(ratio, ratio[0].real, rtol=1e-12)
    assert ratio[0].real > 0.0


@pytest.mark.parametrize("method", [at.time_reversal, at.drives.phase_conjugate])
def test_wrong_elements_and_foci_that_cancel_raise(method) -> None:
    transfer = random_matrix(6, foci=2)
    with raises_code("sizes_differ"):
        at.drives.achieved_fraction(
            transfer, at.Target(any_points(2)), at.Drive(np.ones(39, dtype=np.complex128))
        )
    opposite = at.TransferMatrix(np.concatenate([transfer.matrix[:1], -transfer.matrix[:1]]), 0.0)
    with raises_code("all_zero"):
        method(opposite, at.Target(any_points(2)))


def test_a_target_elsewhere_than_the_beacons_raises():
    transfer = at.TransferMatrix(
        np.ones((2, 3), dtype=np.complex128), 0.0, np.array([[0.0, 0, 0], [0, 0, 0.01]])
    )
    moved = at.Target(np.array([[0.0, 0, 0], [0, 0.002, 0.01]]))
    for method in (at.time_reversal, at.drives.phase_conjugate):
        with raises_code("sizes_differ"):
            method(transfer, moved)
