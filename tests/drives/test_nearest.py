"""The drive nearest to a given one: its share of the bound, and that no nearer drive has it."""

import numpy as np
import pytest

import airtact as at
from faults import raises_code

POINTS = np.array([[0.0, 0.0, 0.15], [0.02, 0.0, 0.15]])
ARRAY = at.flat_boards(1, 1)


def transfer_to(points: np.ndarray) -> tuple[at.TransferMatrix, at.Target]:
    target = at.Target(points)
    return at.transfer_matrix(
        at.FreeField().radiate(at.Scene(at.air(celsius=20.0)), target.beacons()), ARRAY
    ), target


def move(one: at.Drive, other: at.Drive) -> float:
    return 1.0 - abs(np.mean(np.exp(1j * (one.phases - other.phases))))


def test_one_focus_meets_the_condition_of_the_optimum() -> None:
    transfer, target = transfer_to(POINTS[:1])
    drive = at.Drive(np.exp(2j * np.pi * np.random.default_rng(1).uniform(size=len(ARRAY))))
    corrected = at.drives.nearest_drive(transfer, target, drive)
    bound = np.abs(transfer.matrix).sum()
    assert np.abs(transfer.pressure(corrected)[0]) == pytest.approx(0.95 * bound, rel=1e-3)
    # Lagrange: the slope of the move is proportional to that of the pressure, element by element.
    waves = transfer.matrix[0] * corrected.amplitudes
    pull = np.imag(waves * np.conj(waves.sum()))
    moved = corrected.amplitudes * np.conj(drive.amplitudes)
    slope = np.imag(moved * np.conj(moved.mean()))
    assert abs(np.corrcoef(pull, slope)[0, 1]) > 0.999


@pytest.mark.parametrize("blur", [0.3, 1.0, 3.0])
def test_two_foci_get_their_share_with_smaller_moves_than_the_best_drive(blur: float) -> None:
    transfer, target = transfer_to(POINTS)
    best = at.best(transfer, target)
    phases = best.phases + np.random.default_rng(3).normal(0.0, blur, len(best))
    drive = at.Drive(best.magnitudes * np.exp(1j * phases))
    corrected = at.drives.nearest_drive(transfer, target, drive, share=0.9)
    bound = at.upper_bound(transfer, target).worst
    assert np.abs(transfer.pressure(corrected)).min() >= 0.89 * bound
    np.testing.assert_allclose(corrected.magnitudes, drive.magnitudes)
    assert move(corrected, drive) < move(best, drive)


def test_a_good_drive_stays() -> None:
    transfer, target = transfer_to(POINTS)
    drive = at.best(transfer, target)
    assert at.drives.nearest_drive(transfer, target, drive, share=0.9) is drive
    with raises_code("out_of_range"):
        at.drives.nearest_drive(transfer, target, drive, share=95.0)
    with raises_code("sizes_differ"):
        at.drives.nearest_drive(transfer, target, at.Drive(np.ones(2, complex)))
