"""A drive file holds all that emitting it needs, in datasets whose names and units stay."""

import csv
from pathlib import Path

import h5py
import numpy as np
import pytest

import airtact as at
from airtact.drives.drive_file import COLUMNS, read_drive_file
from faults import raises_code

ARRAY = at.autd3_board().moved(
    at.Pose.turn(np.array([0.0, 1.0, 0.0]), 0.3, translation=(0.1, 0.0, -0.2))
)
SCENE = at.Scene(at.Medium(343.1, 1.293, 0.14), [], frequency=39e3)
MATRIX = at.TransferMatrix(np.arange(2 * 249).reshape(2, 249) * (1 + 2j), 0.01)
TARGET = at.Target(np.array([[0.0, 0, 0.1], [0, 0, 0.2]]), pressures=np.array([10.0, 20.0]))


@pytest.fixture
def drive() -> at.Drive:
    random = np.random.default_rng(3)
    return at.Drive(random.uniform(0, 1, 249) * np.exp(2j * np.pi * random.uniform(size=249)))


@pytest.fixture
def path(tmp_path: Path, drive: at.Drive) -> Path:
    drive.save(
        tmp_path / "drive.h5",
        ARRAY,
        SCENE,
        MATRIX,
        TARGET,
        texts={"scene": "colour = 3 # λ", "report": "{}"},
    )
    return tmp_path / "drive.h5"


def read_csv(path):
    with path.open(newline="") as file:
        header, *rows = csv.reader(file)
    return header, np.array(rows, dtype=float).T


def test_the_table_holds_places_and_the_drive(tmp_path, drive) -> None:
    array = at.autd3_board()
    drive.save(tmp_path / "drive.csv", array)
    header, columns = read_csv(tmp_path / "drive.csv")
    assert tuple(header) == COLUMNS
    assert ",".join(header) == "index,x,y,z,nx,ny,nz,amplitude,phase,amplitude_level,phase_level"
    np.testing.assert_array_equal(columns[0], np.arange(249))
    np.testing.assert_allclose(columns[1:4].T, array.positions, atol=1e-9)
    np.testing.assert_array_equal(columns[4:7].T, array.normals)
    np.testing.assert_allclose(columns[7] * np.exp(1j * columns[8]), drive.amplitudes, atol=1e-8)
    # Levels are 256 steps of full scale and of a turn: half a step of each, to first order.
    levels = columns[9] / 255 * np.exp(2j * np.pi * columns[10] / 256)
    assert set(columns[9:].ravel()) <= set(range(256))
    assert np.abs(levels - drive.amplitudes).max() < 0.5 / 255 + np.pi / 256


def test_the_datasets_keep_their_names_and_units(path, drive) -> None:
    frame = at.quantise(drive)
    with h5py.File(path) as file:
        np.testing.assert_array_equal(file["positions"][:], ARRAY.positions)
        np.testing.assert_array_equal(file["normals"][:], ARRAY.normals)
        np.testing.assert_array_equal(file["amplitude"][:], np.abs(drive.amplitudes))
        np.testing.assert_array_equal(file["phase"][:], np.angle(drive.amplitudes))
        np.testing.assert_array_equal(file["amplitude_level"][:], frame.amplitude)
        np.testing.assert_array_equal(file["phase_level"][:], frame.phase)
        np.testing.assert_array_equal(file["transfer_matrix"][:], MATRIX.matrix)
        np.testing.assert_array_equal(file["foci"][:], TARGET.points)
        np.testing.assert_array_equal(file["wanted_pressures"][:], [10.0, 20.0])
        assert file["scene"].asstr()[()] == "colour = 3 # λ"
        assert file["report"].asstr()[()] == "{}"
        assert file["modulation"].asstr()[()] == "none"
        assert file["format_version"][()] == 1
        assert file["sensitivity"][()] == ARRAY.element.sensitivity
        assert "uncalibrated" in file["sensitivity"].attrs["unit"]
        assert file["frequency"].attrs["unit"] == "Hz"
        assert "rate" not in file


def test_a_file_holds_all_that_emitting_it_needs(path) -> None:
    back = read_drive_file(path)
    assert (back.frequency, back.medium, back.rate) == (39e3, SCENE.medium, None)
    assert (back.sensitivity, back.element_radius) == (ARRAY.element.sensitivity, 4.0e-3)
    assert back.positions is not None
    assert back.normals is not None
    assert back.poses is not None
    assert back.board == "autd3"
    np.testing.assert_allclose(
        back.poses[0].apply(at.transducers.board_named("autd3").positions),
        ARRAY.positions,
        atol=1e-12,
    )
    assert back.foci is not None
    assert back.transfer_matrix is not None
    np.testing.assert_array_equal(back.foci, TARGET.points)
    np.testing.assert_array_equal(back.transfer_matrix, MATRIX.matrix)


def test_other_levels_are_written_with_what_they_stand_for(tmp_path, drive) -> None:
    levels = at.transducers.Levels.even(amplitudes=5, phases=16)
    drive.save(tmp_path / "drive.h5", levels=levels)
    back = read_drive_file(tmp_path / "drive.h5")
    assert back.levels is not None
    assert back.levels.same_as(levels)
    with h5py.File(tmp_path / "drive.h5") as file:
        written = file["amplitude_level"][:]
    assert written.max() == 4
    np.testing.assert_array_equal(written, at.quantise(drive, levels).amplitude)


def test_amplitude_and_phase_are_enough(tmp_path) -> None:
    with h5py.File(tmp_path / "drive.h5", "w") as file:
        file["amplitude"], file["phase"] = np.ones(3), np.zeros(3)
    back = read_drive_file(tmp_path / "drive.h5")
    np.testing.assert_array_equal(back.drives, np.ones((1, 3)))
    assert (back.rate, back.transfer_matrix, back.positions, back.frequency, back.medium) == (
        None,
    ) * 5


def changed(path: Path, **columns) -> Path:
    with h5py.File(path, "a") as file:
        for name, values in columns.items():
            if name in file:
                del file[name]
            if values is not None:
                file[name] = values
    return path


@pytest.mark.parametrize(
    ("columns", "code"),
    [
        ({"format_version": 2}, "unsupported_version"),
        ({"format_version": 0}, "unsupported_version"),
        ({"format_version": "new"}, "unsupported_version"),
        ({"amplitude": None}, "data_missing"),
        ({"normals": None}, "data_missing"),
        ({"amplitude": np.ones(3)}, "wrong_shape"),
        ({"amplitude": np.ones((0, 249)), "phase": np.ones((0, 249))}, "empty"),
        ({"amplitude": np.full(249, 1.5)}, "out_of_range"),
        ({"phase": np.full(249, np.nan)}, "not_finite"),
        ({"rate": -1.0}, "out_of_range"),
        ({"board_rotations": None}, "data_missing"),
        ({"board_rotations": np.eye(3)}, "wrong_shape"),
    ],
)
def test_what_no_drive_is_has_a_code(path, columns, code: str) -> None:
    with raises_code(code):
        read_drive_file(changed(path, **columns))


def test_files_that_cannot_be_read_or_written_are_rejected(tmp_path, drive) -> None:
    (tmp_path / "text.h5").write_text("not a drive")
    with raises_code("file_unreadable"):
        read_drive_file(tmp_path / "text.h5")
    with raises_code("file_missing"):
        read_drive_file(tmp_path / "none.h5")
    with raises_code("unknown_format"):
        drive.save(tmp_path / "drive.txt")
    with raises_code("not_writable"):
        drive.save(tmp_path / "none" / "drive.h5")
    with raises_code("data_missing"):
        drive.save(tmp_path / "drive.csv")
    assert not (tmp_path / "drive.csv").exists()


def test_an_array_or_a_matrix_of_another_size_is_rejected(tmp_path, drive) -> None:
    with raises_code("sizes_differ"):
        drive.save(tmp_path / "drive.h5", at.transducers.board_array("sonicsurface"))
    with raises_code("sizes_differ"):
        drive.save(
            tmp_path / "drive.h5", transfer=at.TransferMatrix(np.ones((1, 3), dtype=complex), 0.0)
        )
