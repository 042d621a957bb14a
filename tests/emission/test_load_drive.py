"""Drives and sequences come back from their files as they were."""

import h5py
import numpy as np
import pytest

import airtact as at
from faults import raises_code

AIR = at.Medium(343.1, 1.293, 0.14)


@pytest.fixture
def drive() -> at.Drive:
    random = np.random.default_rng(3)
    return at.Drive(random.uniform(0, 1, 249) * np.exp(2j * np.pi * random.uniform(size=249)))


@pytest.mark.parametrize(("ending", "digits"), [("h5", 1e-15)])
def test_a_drive_comes_back(tmp_path, drive, ending: str, digits: float) -> None:
    drive.save(tmp_path / f"drive.{ending}", at.autd3_board())
    back = at.load_drive(str(tmp_path / f"drive.{ending}"))
    assert isinstance(back, at.Drive)
    np.testing.assert_allclose(back.amplitudes, drive.amplitudes, rtol=0, atol=digits)
    assert at.quantise(back).same_as(at.quantise(drive))
    drive.save(tmp_path / f"bare.{ending}")
    np.testing.assert_allclose(
        at.load_drive(tmp_path / f"bare.{ending}").amplitudes, drive.amplitudes, rtol=0, atol=digits
    )


@pytest.mark.parametrize(("ending", "digits"), [("h5", 1e-15)])
def test_two_thousand_frames_come_back(tmp_path, ending: str, digits: float) -> None:
    random = np.random.default_rng(4)
    drives = random.uniform(0, 1, (2000, 12)) * np.exp(2j * np.pi * random.uniform(size=(2000, 12)))
    sequence = at.drives.Sequence(drives, 40e3 / 7)
    sequence.save(
        tmp_path / f"sequence.{ending}", at.transducers.board_array("nano16"), at.Scene(AIR, [])
    )
    back = at.load_drive(tmp_path / f"sequence.{ending}")
    assert isinstance(back, at.drives.Sequence)
    assert len(back) == 2000
    assert back.rate == pytest.approx(sequence.rate, rel=1e-11)
    np.testing.assert_allclose(back.drives, sequence.drives, rtol=0, atol=digits)


def test_a_sequence_of_one_frame_stays_a_sequence(tmp_path, drive) -> None:
    at.drives.Sequence(drive.amplitudes[None], 200.0).save(tmp_path / "one.h5")
    back = at.load_drive(tmp_path / "one.h5")
    assert isinstance(back, at.drives.Sequence)
    assert (len(back), back.rate) == (1, 200.0)


def test_a_table_is_read_in_the_order_of_its_index(tmp_path, drive) -> None:
    path = tmp_path / "drive.csv"
    drive.save(path, at.autd3_board())
    header, *lines = path.read_text().splitlines()
    for rows in (lines, sorted(lines, key=lambda line: line.split(",")[7])):  # by amplitude
        path.write_text("\n".join([header, *rows]))
        np.testing.assert_allclose(at.load_drive(path).amplitudes, drive.amplitudes, atol=1e-8)
    for rows in (lines[:-2] + lines[-1:], [*lines, lines[0]]):
        path.write_text("\n".join([header, *rows]))
        with raises_code("out_of_range"):
            at.load_drive(path)
    # Without an index it is another program's table, in the order of its lines.
    path.write_text("amplitude,phase\n1,0\n0.5,0\n")
    np.testing.assert_allclose(at.load_drive(path).amplitudes, [1.0, 0.5])


def test_a_folder_that_is_not_there_is_named(tmp_path, drive) -> None:
    with raises_code("not_writable"):
        drive.save(tmp_path / "none" / "drive.h5")


def test_frames_without_a_rate_are_rejected_until_one_is_given(tmp_path) -> None:
    with h5py.File(tmp_path / "frames.h5", "w") as file:
        file["amplitude"] = file["phase"] = np.ones((3, 12))
    with raises_code("data_missing"):
        at.load_drive(tmp_path / "frames.h5")
    back = at.load_drive(tmp_path / "frames.h5", rate=100.0)
    assert isinstance(back, at.drives.Sequence)
    assert back.rate == 100.0
