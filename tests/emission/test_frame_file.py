"""Frames in files: they are those of the drive in the levels of the boards."""

import numpy as np
import pytest

import airtact as at
from airtact.drives.sequence import Sequence
from airtact.emission import write_frames
from airtact.emission.codecs import codec_of
from emission.receivers import OpenMPD
from emission.sounds import tone
from faults import raises_code


@pytest.mark.parametrize("ending", ["h5"])
def test_a_sequence_is_repeated_for_the_seconds_asked(tmp_path, ending) -> None:
    drives = np.exp(2j * np.pi * np.arange(40)[:, None] / 256) * tone(12).amplitudes
    file = tmp_path / f"frames.{ending}"
    assert write_frames(file, Sequence(drives, 1.0), "nano16", seconds=100.0) == (100, 1.0)
    back = at.load_drive(file)
    assert isinstance(back, Sequence)
    assert (len(back), back.rate) == (100, 1.0)
    levels = codec_of("nano16").levels
    for index in (0, 39, 40, 99):
        asked = at.quantise(at.Drive(drives[index % 40]), levels)
        assert at.quantise(back.drive(index), levels).same_as(asked)


def test_bytes_for_openmpd_are_what_its_receiver_takes(tmp_path) -> None:
    codec = codec_of("openmpd")
    draw = np.random.default_rng(7)
    drive = at.Drive(draw.uniform(0, 1, 256) * np.exp(2j * np.pi * draw.uniform(size=256)))
    assert write_frames(tmp_path / "one.bin", drive, "openmpd") == (1, None)
    board = OpenMPD()
    for byte in (tmp_path / "one.bin").read_bytes():
        board.hear(byte)
    assert board.playing is not None
    np.testing.assert_array_equal(
        board.playing[1][codec.board.channels], at.quantise(drive, codec.levels).amplitude
    )


def test_sequences_too_fast_for_the_serial_line_are_rejected(tmp_path) -> None:
    """Two SonicSurface boards receive 44 frames/s, so 16 frames can be repeated 2.7 times."""
    drives = np.tile(tone(512).amplitudes, (16, 1))
    with raises_code("out_of_range", "at most 2.7 times"):
        write_frames(tmp_path / "a.bin", Sequence(drives, 701.0), "sonicsurface")
    assert not (tmp_path / "a.bin").exists()
    assert write_frames(tmp_path / "a.bin", Sequence(drives, 16 * 2.7), "sonicsurface")[0] == 16


def test_files_that_cannot_be_are_rejected(tmp_path) -> None:
    for file, board, code in (
        ("a.txt", "autd3", "unknown_format"),
        ("none/a.h5", "autd3", "not_writable"),
        ("a.h5", "nano16", "sizes_differ"),
    ):
        with raises_code(code):
            write_frames(tmp_path / file, tone(), board)
    with raises_code("options_clash"):
        sequence = Sequence(tone().amplitudes[None], 100.0)
        write_frames(
            tmp_path / "a.h5",
            sequence,
            "autd3",
            modulation=at.transducers.AmplitudeModulation(50.0),
        )
