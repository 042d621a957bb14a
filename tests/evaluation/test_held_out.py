"""What drives keep over samples of an uncertain hand."""

import numpy as np
import pytest

import airtact as at
from airtact.evaluation.comparison import held_out

SCENE = at.Scene(at.air(), [at.sound_hard(at.sphere(radius=8e-3, edge=3e-3))], frequency=40e3)
TARGET = at.Target(np.array([[0.0, 0.0, 8.5e-3], [3e-3, 0.0, 8.2e-3]]))
ARRAY = at.flat_boards(1, 1).facing((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 0.1)
DOUBT = at.Uncertainty(position=1e-3)


@pytest.fixture(scope="module")
def beacons() -> at.acoustics.RadiatedField:
    return at.SphereSeries().radiate(SCENE, TARGET.beacons())


@pytest.fixture(scope="module")
def drives(beacons) -> dict[str, at.Drive]:
    samples = at.ensemble(beacons, ARRAY, DOUBT, samples=16)
    # A drive at half the level counts as much: all are tried at equal energy.
    usual = at.Drive(0.5 * at.time_reversal(samples, TARGET).amplitudes)
    return {"robust": at.robust(samples, TARGET), "time reversal": usual}


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
