"""Echoes and codes: what they hold, what they reject, and their file."""

import h5py
import numpy as np
import pytest

import airtact as at
from faults import raises_code

CODES = at.sensing.random_codes(6, 3, seed=1)
PRESSURES = np.arange(6).reshape(2, 3) * (1 + 2j)


def test_a_file_holds_all_that_was_measured(tmp_path) -> None:
    echoes = at.Echoes(CODES, PRESSURES, np.array([4, 1]), 25e3, noise=0.3)
    echoes.save(tmp_path / "echoes.h5")
    back = at.sensing.load_echoes(tmp_path / "echoes.h5")
    assert np.array_equal(back.codes, CODES)
    assert np.array_equal(back.pressures, PRESSURES)
    assert back.receiving.tolist() == [4, 1]
    assert (back.frequency, back.noise) == (25e3, 0.3)
    assert not back.pressures.flags.writeable


def test_a_file_says_which_pressures_are_valid(tmp_path) -> None:
    valid = np.array([[True, True, False], [False, True, True]])
    echoes = at.Echoes(CODES, PRESSURES + 1, np.array([4, 1]), valid=valid)
    assert np.array_equal(echoes.pressures, np.where(valid, PRESSURES + 1, 0))
    echoes.save(tmp_path / "echoes.h5")
    assert np.array_equal(at.sensing.load_echoes(tmp_path / "echoes.h5").valid, valid)
    with h5py.File(tmp_path / "echoes.h5") as file:
        assert file["format_version"][()] == 2


def test_a_file_by_others_may_leave_out_receivers_and_noise(tmp_path) -> None:
    with h5py.File(tmp_path / "lab.h5", "w") as file:
        file["format_version"] = 1
        file["frequency"] = 40e3
        for name, values in (("codes", np.eye(2)), ("pressures", np.ones((2, 2)))):
            file[f"{name}_real"] = values
            file[f"{name}_imaginary"] = 0 * values
    assert at.sensing.load_echoes(tmp_path / "lab.h5").receiving.tolist() == [0, 1]


@pytest.mark.parametrize(
    ("given", "code"),
    [
        ({"codes": 1.5 * CODES}, "over_full_scale"),
        ({"codes": CODES[:, :2]}, "sizes_differ"),
        ({"codes": CODES * [1, 0, 1]}, "all_zero"),
        ({"codes": np.ones(6)}, "wrong_shape"),
        ({"pressures": PRESSURES * [1, np.nan, 1]}, "not_finite"),
        ({"pressures": np.ones((0, 3))}, "empty"),
        ({"receivers": np.array([1, 6])}, "out_of_range"),
        ({"receivers": np.array([1, 1])}, "given_twice"),
        ({"receivers": np.array([1, 2, 3])}, "sizes_differ"),
        ({"receivers": np.array([1.0, 2.0])}, "not_a_number"),
        ({"receivers": None}, "sizes_differ"),
        ({"frequency": 40.0}, "out_of_range"),
        ({"noise": 0.0}, "out_of_range"),
        ({"valid": np.zeros((2, 3), dtype=bool)}, "link_failed"),
        ({"valid": np.ones((2, 2), dtype=bool)}, "sizes_differ"),
    ],
)
@pytest.mark.usefixtures("as_outside_the_tests")
def test_echoes_that_cannot_be_are_rejected(given, code) -> None:
    right = {"codes": CODES, "pressures": PRESSURES, "receivers": np.array([0, 5])}
    with raises_code(code):
        at.Echoes(**{**right, **given})


@pytest.mark.parametrize(
    ("code", "fields"),
    [
        ("data_missing", {"format_version": 1, "frequency": 40e3}),
        ("unsupported_version", {"format_version": 7}),
        ("wrong_shape", {"format_version": 1, "frequency": np.zeros(0)}),
    ],
)
def test_files_of_other_fields_are_rejected(code, fields, tmp_path) -> None:
    with h5py.File(tmp_path / "echoes.h5", "w") as file:
        for name, value in fields.items():
            file[name] = value
    with raises_code(code):
        at.sensing.load_echoes(tmp_path / "echoes.h5")


@pytest.mark.parametrize(
    ("code", "name"), [("unknown_format", "echoes.csv"), ("not_writable", "none/echoes.h5")]
)
def test_echoes_are_saved_in_hdf5_where_there_is_a_folder(code, name, tmp_path) -> None:
    with raises_code(code):
        at.Echoes(np.eye(2), np.ones((2, 2))).save(tmp_path / name)
    with raises_code("file_missing"):
        at.sensing.load_echoes(tmp_path / "none.h5")


def test_codes_are_at_full_scale_and_independent() -> None:
    whole = at.sensing.hadamard_codes(5)
    assert whole.shape == (5, 8)
    assert np.array_equal(whole @ whole.T, 8 * np.eye(5))
    assert np.allclose(np.abs(at.sensing.random_codes(5, 4)), 1, rtol=0, atol=1e-15)
    assert np.array_equal(
        at.sensing.random_codes(5, 4, seed=2), at.sensing.random_codes(5, 4, seed=2)
    )
    assert not np.array_equal(
        at.sensing.random_codes(5, 4, seed=2), at.sensing.random_codes(5, 4, seed=3)
    )
    for wrong in (
        lambda: at.sensing.hadamard_codes(5, 9),
        lambda: at.sensing.random_codes(0, 4),
        lambda: at.sensing.random_codes(5, 4, seed=-1),
    ):
        with raises_code("out_of_range"):
            wrong()
