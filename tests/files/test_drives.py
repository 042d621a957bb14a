"""What is written of a drive is read back the same."""

import csv

import h5py
import numpy as np
import pytest

from airtact.files.drives import COLUMNS, read_drive_h5, write_drive_csv, write_drive_h5, write_sequence_h5
from airtact.scene.target import Target
from airtact.synthesis.quantise import quantise
from airtact.synthesis.sequence import Sequence
from airtact.transducers.layout import autd3_board
from airtact.transfer import Drive, TransferMatrix


@pytest.fixture
def drive():
    random = np.random.default_rng(3)
    return Drive(random.uniform(0, 1, 249) * np.exp(2j * np.pi * random.uniform(size=249)))


def read_csv(path):
    with path.open(newline="") as file:
        header, *rows = csv.reader(file)
    return header, np.array(rows, dtype=float).T


def test_the_table_holds_places_and_the_drive(tmp_path, drive):
    array = autd3_board()
    write_drive_csv(tmp_path / "drive.csv", array, drive, quantise(drive))
    header, columns = read_csv(tmp_path / "drive.csv")
    assert tuple(header) == COLUMNS
    assert ",".join(header) == "index,x,y,z,nx,ny,nz,amplitude,phase,amplitude_level,phase_level"
    np.testing.assert_array_equal(columns[0], np.arange(249))
    np.testing.assert_allclose(columns[1:4].T, array.positions, atol=1e-9)
    np.testing.assert_array_equal(columns[4:7].T, array.normals)
    np.testing.assert_allclose(columns[7] * np.exp(1j * columns[8]), drive.amplitudes, atol=1e-8)


def test_the_levels_are_256_steps_of_full_scale_and_of_a_turn(tmp_path, drive):
    """Half a step of amplitude and half a step of phase, to first order."""
    write_drive_csv(tmp_path / "drive.csv", autd3_board(), drive, quantise(drive))
    columns = read_csv(tmp_path / "drive.csv")[1]
    levels = columns[9] / 255 * np.exp(2j * np.pi * columns[10] / 256)
    assert set(columns[9:].ravel()) <= set(range(256))
    assert np.abs(levels - drive.amplitudes).max() < 0.5 / 255 + np.pi / 256


def test_the_archive_holds_all_that_the_drive_came_from(tmp_path, drive):
    array, matrix = autd3_board(), np.arange(2 * 249).reshape(2, 249) * (1 + 2j)
    target = Target(np.array([[0.0, 0, 0.1], [0, 0, 0.2]]), pressures=np.array([10.0, 20.0]))
    frame = quantise(drive)
    texts = {"scene": "frequency = 4e4 # λ", "report": '{"solver": "x"}'}
    transfer = TransferMatrix(matrix, 0.01)
    write_drive_h5(tmp_path / "drive.h5", array, drive, frame, transfer, target, texts)
    with h5py.File(tmp_path / "drive.h5") as file:
        np.testing.assert_array_equal(file["positions"][:], array.positions)
        np.testing.assert_array_equal(file["normals"][:], array.normals)
        np.testing.assert_allclose(file["amplitude"][:] * np.exp(1j * file["phase"][:]), drive.amplitudes)
        np.testing.assert_array_equal(file["amplitude_level"][:], frame.amplitude)
        np.testing.assert_array_equal(file["phase_level"][:], frame.phase)
        np.testing.assert_array_equal(file["transfer_matrix"][:], matrix)
        np.testing.assert_array_equal(file["foci"][:], target.points)
        np.testing.assert_array_equal(file["wanted_pressures"][:], [10.0, 20.0])
        assert file["scene"].asstr()[()] == texts["scene"]
        assert file["report"].asstr()[()] == texts["report"]
        assert file["sensitivity"][()] == array.element.sensitivity
        assert "uncalibrated" in file["sensitivity"].attrs["unit"]


def test_what_was_written_is_read_back(tmp_path, drive):
    array, matrix = autd3_board(), np.arange(2 * 249).reshape(2, 249) * (1 + 2j)
    target = Target(np.array([[0.0, 0, 0.1], [0, 0, 0.2]]))
    write_drive_h5(
        tmp_path / "drive.h5", array, drive, quantise(drive), TransferMatrix(matrix, 0.0), target, {"scene": "x = 1"}
    )
    stored = read_drive_h5(tmp_path / "drive.h5")
    np.testing.assert_array_equal(stored.positions, array.positions)
    np.testing.assert_array_equal(stored.normals, array.normals)
    np.testing.assert_allclose(stored.drives, drive.amplitudes[None], rtol=0, atol=1e-15)
    assert stored.transfer is not None
    np.testing.assert_array_equal(stored.transfer.matrix, matrix)
    assert (stored.rate, stored.scene, stored.sensitivity) == (None, "x = 1", array.element.sensitivity)


def test_a_sequence_is_read_frame_by_frame(tmp_path, drive):
    sequence = Sequence(np.exp(0.1j * np.arange(5))[:, None] * drive.amplitudes, 200.0)
    transfer, target = TransferMatrix(np.ones((1, 249), dtype=complex), 0.0), Target(np.array([[0.0, 0.0, 0.1]]))
    write_sequence_h5(tmp_path / "sequence.h5", autd3_board(), sequence, transfer, target, {"scene": "x = 1"})
    stored = read_drive_h5(tmp_path / "sequence.h5")
    np.testing.assert_allclose(stored.drives, sequence.drives, rtol=0, atol=1e-15)
    assert (stored.rate, stored.scene) == (200.0, "x = 1")


def test_an_array_and_its_drive_are_enough(tmp_path, drive):
    with h5py.File(tmp_path / "drive.h5", "w") as file:
        file["positions"], file["normals"] = autd3_board().positions, autd3_board().normals
        file["amplitude"], file["phase"] = np.abs(drive.amplitudes), np.angle(drive.amplitudes)
    stored = read_drive_h5(tmp_path / "drive.h5")
    np.testing.assert_allclose(stored.drives, drive.amplitudes[None], rtol=0, atol=1e-15)
    assert (stored.rate, stored.transfer, stored.scene, stored.sensitivity) == (None, None, None, None)
