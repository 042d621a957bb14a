"""Sequences: what each modulation makes of force and place, what a board can play, and what is rejected."""

import numpy as np
import pytest

from airtact.acoustics.medium import Medium
from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.free_field import FreeField
from airtact.acoustics.target import Target
from airtact.acoustics.target_points import circle
from airtact.drives.drive import Drive
from airtact.drives.linear_methods import phase_conjugate, time_reversal
from airtact.drives.sequence import (
    Sequence,
    amplitude_modulation,
    spatiotemporal_modulation,
)
from airtact.drives.transfer import TransferMatrix, transfer_matrix
from airtact.errors import InvalidInput
from airtact.geometry.pose import Pose
from airtact.transducers.layout import autd3_board
from faults import raises_code

ARRAY = autd3_board(Pose.identity())
OPEN_AIR = Scene(Medium(343.1, 1.293), [])
DRIVE = Drive(np.exp(1j * np.arange(5.0)) * np.linspace(0.2, 1.0, 5))


def matrix_of(target: Target) -> TransferMatrix:
    return transfer_matrix(FreeField().radiate(OPEN_AIR, target.beacons()), ARRAY)


@pytest.mark.parametrize("depth", [1.0, 0.3])
def test_force_swings_as_a_cosine_without_overtones(depth) -> None:
    swing = amplitude_modulation(DRIVE, frequency=150.0, rate=3000.0, depth=depth)
    assert (len(swing), swing.rate) == (20, 3000.0)
    assert swing.seconds == pytest.approx(1 / 150.0)
    force = np.abs(swing.drives[:, 4]) ** 2
    spectrum = np.fft.rfft(force) / len(force)
    assert spectrum[0].real == pytest.approx(1 - depth / 2)
    assert spectrum[1].real == pytest.approx(depth / 4)
    assert np.abs(spectrum[2:]).max() < 1e-15
    np.testing.assert_allclose(swing.drives[0], DRIVE.amplitudes)
    # The phases stay, so the sound keeps its shape.
    emitting = np.abs(swing.drives[:, 0]) > 1e-9
    np.testing.assert_allclose(np.angle(swing.drives[emitting] / DRIVE.amplitudes), 0.0, atol=1e-12)


def test_spatiotemporal_modulation_stays_equally_long_at_every_point() -> None:
    ring = Target(circle((0.0, 0.0, 0.15), radius=0.01, spacing=8e-3))
    transfer = matrix_of(ring)
    sequence = spatiotemporal_modulation(
        transfer, ring, frequency=100.0, rate=2400.0, method=time_reversal
    )
    loudest = np.abs(sequence.pressure(transfer)).argmax(axis=1)
    assert np.all(np.diff(loudest) >= 0)
    assert np.bincount(loudest).tolist() == [3] * 8
    np.testing.assert_allclose(
        sequence.drives[0], time_reversal(*alone(transfer, ring, 0)).amplitudes
    )


def alone(transfer: TransferMatrix, target: Target, index: int) -> tuple[TransferMatrix, Target]:
    return TransferMatrix(transfer.matrix[index : index + 1], 0.0), Target(
        target.points[index : index + 1]
    )


def test_a_led_focus_keeps_what_each_point_asks() -> None:
    points = circle((0.0, 0.0, 0.15), radius=0.01, spacing=0.016)
    transfer = matrix_of(Target(points))
    asked = np.array([400.0, 0.0, 100.0, 300.0])
    sequence = spatiotemporal_modulation(transfer, Target(points, asked), 100.0, 400.0)
    np.testing.assert_allclose(np.diag(np.abs(sequence.pressure(transfer))), asked, rtol=1e-12)
    shares = spatiotemporal_modulation(transfer, Target(points, shares=asked), 100.0, 400.0)
    got = np.diag(np.abs(shares.pressure(transfer))) / np.abs(transfer.matrix).sum(axis=1)
    np.testing.assert_allclose(got, asked / 400.0, rtol=1e-12)


def test_frames_are_drives() -> None:
    sequence = amplitude_modulation(DRIVE, 200.0, 800.0)
    np.testing.assert_array_equal(sequence.drive(1).amplitudes, sequence.drives[1])
    assert not sequence.drives.flags.writeable
    assert repr(sequence) == "Sequence(drives=complex128 (4, 5), rate=800.0)"


@pytest.mark.parametrize(
    ("make", "code"),
    [
        (lambda: Sequence(np.zeros((0, 3), complex), 1.0), "wrong_shape"),
        (lambda: Sequence(np.array([[0.5], [1.2j]]), 1.0), "over_full_scale"),
        (lambda: Sequence(np.array([[0.5j], [np.nan]]), 1.0), "not_finite"),
        (lambda: Sequence(np.ones((2, 2), complex), 0.0), "out_of_range"),
        (lambda: amplitude_modulation(DRIVE).drive(20), "out_of_range"),
        (lambda: amplitude_modulation(DRIVE, 200.0, 600.0), "out_of_range"),
        (lambda: amplitude_modulation(DRIVE, 150.0, 1000.0), "out_of_range"),
        (lambda: amplitude_modulation(DRIVE, depth=1.5), "out_of_range"),
        (lambda: amplitude_modulation(DRIVE, frequency=-1.0), "out_of_range"),
    ],
)
def test_faults_are_rejected_with_the_number(make, code) -> None:
    with raises_code(code):
        make()


def test_paths_that_do_not_fit_are_rejected() -> None:
    ring = Target(circle((0.0, 0.0, 0.15), radius=0.01, spacing=4e-3))
    transfer = matrix_of(ring)
    with raises_code("out_of_range"):
        spatiotemporal_modulation(transfer, ring, 100.0, 800.0)
    single = Target(ring.points[:1])
    with raises_code("too_few"):
        spatiotemporal_modulation(matrix_of(single), single)
    with pytest.raises(InvalidInput, match="does not fit a target of 1"):
        phase_conjugate(transfer, single)
    with raises_code("sizes_differ"):
        amplitude_modulation(DRIVE).pressure(transfer)
