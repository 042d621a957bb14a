"""A scan is read whole or raises, and is compared with a prediction after one complex scale."""

import numpy as np
import pytest

import airtact as at
from airtact.evaluation import Scan, best_shift, load_scan, overlay_scan
from faults import raises_code

POINTS = np.array([[0.0, 0, 0], [0, 0, 0.01], [0, 0.01, 0.02], [0.02, 0.01, 0.02]])


def written(tmp_path, text):
    path = tmp_path / "scan.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_columns_come_in_any_order(tmp_path):
    text = "phase,note,z,y,x,pressure\n0,a,0.03,0.02,0.01,5\n1.5,b,0,0,0,1\n-1.5,c,0.1,0,0,2\n"
    scan = load_scan(written(tmp_path, text))
    assert scan.phased
    np.testing.assert_allclose(scan.points[0], [0.01, 0.02, 0.03])
    np.testing.assert_allclose(scan.pressures, [5.0, np.exp(1.5j), 2 * np.exp(-1.5j)])


def test_a_scan_without_phases_says_so(tmp_path):
    scan = load_scan(written(tmp_path, "x,y,z,pressure\n0,0,0,1\n0,0,0.1,2\n0,0,0.2,3\n"))
    assert not scan.phased
    np.testing.assert_allclose(scan.pressures, [1.0, 2.0, 3.0])


def test_the_scale_and_the_error_are_those_of_the_noise():
    rng = np.random.default_rng(5)
    points = rng.normal(size=(4000, 3)) * 0.01
    model = rng.normal(size=4000) + 1j * rng.normal(size=4000)
    noise = 0.1 * (rng.normal(size=4000) + 1j * rng.normal(size=4000))
    computed = overlay_scan(Scan(points, (2.0 - 1.0j) * model + noise, True), model)
    assert computed.scale == pytest.approx(2.0 - 1.0j, abs=0.01)
    # noise 0.1 against a signal of √5, both per component: 0.1/√(5 + 0.01)
    assert computed.error == pytest.approx(0.1 / np.sqrt(5.01), rel=0.05)
    assert computed.warnings == ()


def test_magnitudes_are_compared_where_no_phase_was_measured():
    model = np.array([1.0 + 0j, 2j, -3.0, 1 - 1j])
    computed = overlay_scan(Scan(POINTS, 7.0 * np.abs(model) + 0j, False), model)
    assert computed.scale == pytest.approx(7.0)
    assert computed.error == pytest.approx(0.0, abs=1e-12)


def test_phases_of_the_other_time_sign_raise():
    model = np.array([1.0, 1j, -1.0, -1j])  # which and its conjugate have nothing in common
    with raises_code("does_not_match"):
        overlay_scan(Scan(POINTS, 3.0 * model.conj(), True), model)


def test_positions_that_cannot_be_predicted_are_left_out_and_counted():
    model = np.array([1.0 + 0j, 2j, np.nan, 1 - 1j])
    computed = overlay_scan(Scan(POINTS, np.array([1.0 + 0j, 2j, 99.0, 1 - 1j]), True), model)
    assert computed.error == pytest.approx(0.0, abs=1e-12)
    assert computed.warnings[0].startswith("1 of 4 positions are skipped")


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("x,y,pressure\n0,0,1\n", "data_missing"),
        ("", "file_unreadable"),
        ("x;y;z;pressure\n0;0;0;1\n", "data_missing"),
        ("x,y,z,pressure\n0,0,0,1\n0,0,one,1\n", "file_unreadable"),
        ("x,y,z,pressure\n0,0,0,1\n0,0,1\n", "wrong_shape"),
        ("x,y,z,pressure\n0,0,0,1\n0,0,1,nan\n0,1,0,1\n", "file_unreadable"),
        ("x,y,z,pressure\n0,0,0,1\n0,0,1,2\n", "too_few"),
        ("x,y,z,pressure\n", "too_few"),
        ("x,y,z,pressure\n0,0,0,1\n0,0,12,2\n0,0,1,2\n", "not_in_metres"),
        ("x,y,z,pressure\n0,0,0,1\n0,0,0,2\n0,0,1,2\n0,0,0,2\n", "too_few"),
        ("x,y,z,pressure\n0,0,0,0\n0,0,1,0\n0,1,0,0\n", "all_zero"),
    ],
)
def test_files_without_a_scan_raise(tmp_path, text, code):
    with raises_code(code):
        load_scan(written(tmp_path, text))


def test_repeated_positions_are_averaged_with_a_warning(tmp_path):
    text = "x,y,z,pressure,phase\n0,0,0,1,0\n0,0,1,4,0\n0,0,0,3,0\n0,1,0,2,0\n"
    scan = load_scan(written(tmp_path, text))
    assert scan.points.tolist() == [[0, 0, 0], [0, 0, 1], [0, 1, 0]]
    assert scan.pressures.tolist() == [2, 4, 2]
    overlay = overlay_scan(scan, np.array([1.0, 2, 1], complex))
    assert overlay.error == pytest.approx(0.0, abs=1e-12)
    assert overlay.warnings[0].startswith("1 position was")


def test_missing_and_binary_files_raise(tmp_path):
    with raises_code("file_missing"):
        load_scan(tmp_path / "missing.csv")
    (tmp_path / "bytes.csv").write_bytes(b"\xff\xfe\x00x,y")
    with raises_code("file_unreadable"):
        load_scan(tmp_path / "bytes.csv")


@pytest.mark.parametrize(
    ("predicted", "code"),
    [
        ([1.0, 1.0, np.nan, np.nan], "signal_unusable"),
        ([0.0] * 4, "all_zero"),
        ([0.0] * 3, "sizes_differ"),
    ],
)
def test_predictions_that_do_not_fit_raise(predicted, code):
    with raises_code(code):
        overlay_scan(Scan(POINTS, np.ones(4, complex), True), np.array(predicted, complex))


def test_phases_in_degrees_raise(tmp_path):
    text = "x,y,z,pressure,phase\n0,0,0,1,170\n0,0,0.1,2,-35\n0,0,0.2,3,12\n"
    with raises_code("out_of_range"):
        load_scan(written(tmp_path, text))


@pytest.mark.parametrize("phased", [True, False])
def test_the_shift_of_a_scan_is_found(phased):
    ball = at.Scene(at.Medium(343.1, 1.293), [at.sound_hard(at.sphere(5e-3, 1e-3))])
    sources = at.Monopoles(np.array([[0.0, 0.01, -0.05], [0.03, 0.0, -0.05]]), np.ones((2, 1)))
    field = at.SphereSeries().radiate(ball, sources)
    x, z = np.meshgrid(np.linspace(-0.015, 0.015, 8), np.linspace(0.008, 0.03, 8))
    points = np.stack([x.ravel(), np.zeros(x.size), z.ravel()], axis=1)
    shift = np.array([5e-3, 0.0, -1e-3])
    readings = field.at(points + shift)[:, 0]
    scan = Scan(points, readings if phased else np.abs(readings) + 0j, phased)
    computed, error = best_shift(scan, lambda points: field.at(points)[:, 0])
    np.testing.assert_allclose(computed, shift, atol=0.3e-3 if phased else 1.1e-3)
    assert error < 0.05
