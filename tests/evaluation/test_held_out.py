"""What drives keep over samples and shifts of the hand, against transfer matrices made for each place."""

import numpy as np
import pytest

import airtact as at
from airtact.evaluation.held_out import held_out, shift_map
from airtact.evaluation.windows import Window
from airtact.reports.plots import draw_shifts
from faults import raises_code

SCENE = at.Scene(at.air(), [at.sound_hard(at.sphere(radius=8e-3, edge=3e-3))], frequency=40e3)
TARGET = at.Target(np.array([[0.0, 0.0, 8.5e-3], [3e-3, 0.0, 8.2e-3]]))
ARRAY = at.flat_boards(1, 1).facing((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 0.1)
DOUBT = at.Uncertainty(position=1e-3)
SHIFTS = Window(np.zeros(3), np.array([1.0, 0, 0]), np.array([0, 0, 1.0]), 4e-3, 4e-3, 2e-3)


@pytest.fixture(scope="module")
def beacons() -> at.acoustics.RadiatedField:
    return at.SphereSeries().radiate(SCENE, TARGET.beacons())


@pytest.fixture(scope="module")
def drives(beacons) -> dict[str, at.Drive]:
    samples = at.ensemble(beacons, ARRAY, DOUBT, samples=16)
    # A drive at half the level counts as much: all are tried at equal energy.
    usual = at.Drive(0.5 * at.time_reversal(samples, TARGET).amplitudes)
    return {"robust": at.robust(samples, TARGET), "time reversal": usual}


def test_a_shift_gives_what_the_matrix_of_that_place_does(beacons, drives) -> None:
    computed = shift_map(beacons, ARRAY, TARGET, drives, SHIFTS)
    energies = [np.linalg.norm(drive.amplitudes) for drive in drives.values()]
    for index in (0, 4, 5):
        there = at.transfer_matrix(
            beacons, ARRAY.seen_from(at.Pose(np.eye(3), SHIFTS.points[index]))
        )
        for row, drive, energy in zip(computed.pressures, drives.values(), energies, strict=True):
            exact = np.abs(there.pressure(drive)).min() * energies[0] / energy
            assert row[index] == pytest.approx(exact, rel=0.01)


def test_samples_give_what_the_sentence_says(beacons, drives) -> None:
    others = at.ensemble(beacons, ARRAY, DOUBT, samples=32, seed=1)
    computed = held_out(others, TARGET, drives)
    usual = drives["time reversal"]
    scale = np.linalg.norm(drives["robust"].amplitudes) / np.linalg.norm(usual.amplitudes)
    lowest = np.quantile(np.abs(others.pressures(usual)).min(axis=1), 0.1)
    assert computed.lowest_tenth[1] == pytest.approx(scale * lowest)
    assert (
        f"{computed.lowest_tenth[0]:.0f} Pa" in computed.sentence() or "kPa" in computed.sentence()
    )
    with raises_code("empty"):
        held_out(others, TARGET, {})


def test_shifts_into_an_element_stay_blank_and_all_panels_have_one_scale(beacons, drives) -> None:
    far = Window(np.zeros(3), SHIFTS.right, SHIFTS.up, 4e-3, 0.2, 0.05)
    computed = shift_map(beacons, ARRAY, TARGET, drives, far)
    assert np.isnan(computed.pressures[:, far.points[:, 2] > 0.09]).all()
    assert np.isfinite(computed.pressures[:, np.abs(far.points[:, 2]) < 0.01]).all()
    near = shift_map(beacons, ARRAY, TARGET, drives, SHIFTS)
    figure = draw_shifts([near, near], list(drives), 1e-3)
    images = [axes.images[0] for axes in figure.axes if axes.images]
    assert {image.get_clim() for image in images} == {(0.0, near.pressures.max())}
    np.testing.assert_allclose(images[1].get_array().ravel(), near.pressures[1])
    assert figure.axes[0].patches[-1].get_radius() == pytest.approx(1.0)
    assert figure.axes[0].get_ylabel() == "shift: z [mm]"
