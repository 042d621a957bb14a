"""Sequences: what each modulation makes of force and place, what a board can play, and what is rejected."""

import numpy as np
import pytest

import airtact as at
from faults import raises_code

ARRAY = at.autd3_board(at.Pose.identity())
OPEN_AIR = at.Scene(at.Medium(343.1, 1.293), [])
DRIVE = at.Drive(np.exp(1j * np.arange(5.0)) * np.linspace(0.2, 1.0, 5))


def matrix_of(target: at.Target) -> at.TransferMatrix:
    return at.transfer_matrix(at.FreeField().radiate(OPEN_AIR, target.beacons()), ARRAY)


def test_a_led_focus_keeps_what_each_point_asks() -> None:
    points = at.acoustics.circle((0.0, 0.0, 0.15), radius=0.01, spacing=0.016)
    transfer = matrix_of(at.Target(points))
    asked = np.array([400.0, 0.0, 100.0, 300.0])
    sequence = at.drives.moving_foci(transfer, at.Target(points, asked), 1, 100.0)
    np.testing.assert_allclose(np.diag(np.abs(sequence.pressure(transfer))), asked, rtol=1e-12)
    shares = at.drives.moving_foci(transfer, at.Target(points, shares=asked), 1, 100.0)
    got = np.diag(np.abs(shares.pressure(transfer))) / np.abs(transfer.matrix).sum(axis=1)
    np.testing.assert_allclose(got, asked / 400.0, rtol=1e-12)


def test_frames_are_drives() -> None:
    sequence = at.drives.Sequence(np.outer([1.0, 0.5, 0.0, 0.5], DRIVE.amplitudes), 800.0)
    np.testing.assert_array_equal(sequence.drive(1).amplitudes, sequence.drives[1])
    assert not sequence.drives.flags.writeable
    assert repr(sequence) == "Sequence(drives=complex128 (4, 5), rate=800.0)"


@pytest.mark.parametrize(
    ("make", "code"),
    [
        (lambda: at.drives.Sequence(np.zeros((0, 3), complex), 1.0), "wrong_shape"),
        (lambda: at.drives.Sequence(np.array([[0.5], [1.2j]]), 1.0), "over_full_scale"),
        (lambda: at.drives.Sequence(np.array([[0.5j], [np.nan]]), 1.0), "not_finite"),
        (lambda: at.drives.Sequence(np.ones((2, 2), complex), 0.0), "out_of_range"),
        (lambda: at.drives.Sequence(np.ones((2, 2), complex), 1.0).drive(2), "out_of_range"),
    ],
)
def test_faults_are_rejected_with_the_number(make, code) -> None:
    with raises_code(code):
        make()


def test_a_matrix_of_other_elements_is_rejected() -> None:
    with raises_code("sizes_differ"):
        at.drives.Sequence(np.ones((2, 2), complex), 1.0).pressure(
            matrix_of(at.Target(np.array([[0.0, 0.0, 0.15]])))
        )
