"""What each element gives: read from a table, and known to the transfer matrix and to synthesis."""

import numpy as np
import pytest

import airtact as at
from faults import raises_code

SCENE = at.Scene(at.Medium(343.1, 1.293), [])
TARGET = at.Target(np.array([[0.08, 0.06, 0.15]]))


def calibrated(seed: int = 2) -> at.PhasedArray:
    random = np.random.default_rng(seed)
    gains = random.uniform(0.5, 1.5, 249) * np.exp(1j * random.uniform(-3, 3, 249))
    gains[[0, 7, 248]] = 0.0
    return at.transducers.board_array("autd3").calibrated(gains)


def test_the_table_gives_gains_and_leaves_the_others_nominal(tmp_path) -> None:
    path = tmp_path / "gains.csv"
    path.write_text("element,gain,phase\n3,0.5,0.25\n10,0,0\n 1 , 2 , -1.5\n")
    gains = at.transducers.load_calibration(path, 12)
    expected = np.ones(12, dtype=complex)
    expected[[1, 3, 10]] = 2 * np.exp(-1.5j), 0.5 * np.exp(0.25j), 0.0
    np.testing.assert_allclose(gains, expected, rtol=1e-15)


def test_a_forward_field_has_the_pressure_of_the_matrix() -> None:
    """Reciprocity and the forward field know of the gains each by itself."""
    array = calibrated()
    transfer = at.transfer_matrix(at.FreeField().radiate(SCENE, TARGET.beacons()), array)
    drive = at.time_reversal(transfer, TARGET)
    pressure = at.field_map(SCENE, array, drive, TARGET.points, solver=at.FreeField())
    np.testing.assert_allclose(transfer.pressure(drive), pressure, rtol=1e-9)


def test_gains_ride_with_the_array() -> None:
    array = calibrated()
    np.testing.assert_array_equal(array.moved(at.Pose.turn((1, 2, 3), 0.4)).gains, array.gains)
    plain = at.transducers.board_array("autd3", [at.Pose(np.eye(3), np.array([0.3, 0.0, 0.0]))])
    np.testing.assert_array_equal(
        at.transducers.join([array, plain]).gains, np.concatenate([array.gains, np.ones(249)])
    )


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("index,gain\n0,1\n", "data_missing"),
        ("element,gain,phase\n0,1\n", "wrong_shape"),
        ("element,gain,phase\n1.5,1,0\n", "not_a_number"),
        ("element,gain,phase\n0,1,0\n12,1,0\n", "unknown_name"),
        ("element,gain,phase\n0,1,0\n0,1,0\n", "given_twice"),
        ("element,gain,phase\n0,-1,0\n", "out_of_range"),
        ("element,gain,phase\n0,95,0\n", "out_of_range"),
        ("element,gain,phase\n0,nan,0\n", "file_unreadable"),
        ("element,gain,phase\n0,1,inf\n", "file_unreadable"),
    ],
)
def test_bad_tables_are_rejected(tmp_path, text: str, code: str) -> None:
    (tmp_path / "gains.csv").write_text(text)
    with raises_code(code):
        at.transducers.load_calibration(tmp_path / "gains.csv", 12)


@pytest.mark.usefixtures("as_outside_the_tests")
@pytest.mark.parametrize(
    ("gains", "code"),
    [
        (np.ones(3), "wrong_shape"),
        (np.zeros(249), "all_zero"),
        (np.full(249, np.nan), "not_finite"),
    ],
)
def test_bad_gains_are_rejected(gains, code: str) -> None:
    with raises_code(code):
        at.transducers.board_array("autd3").calibrated(gains)
