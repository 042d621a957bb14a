"""Frames in files, and read back."""

import numpy as np
import pytest

from airtact.conventions import InvalidInput
from airtact.hardware.codecs import codec_of
from airtact.hardware.file_link import FileLink, Frames, read_frames, write_frames
from airtact.hardware.link import RecordingLink
from hardware.receivers import OpenMPD
from hardware.test_codecs import random_frame


@pytest.mark.parametrize("suffix", [".npz", ".csv", ".h5", ".bin"])
@pytest.mark.parametrize("name", ["autd3", "sonicsurface", "openmpd"])
def test_frames_come_back_from_files(tmp_path, name: str, suffix: str) -> None:
    link = FileLink(tmp_path / f"frames{suffix}", name, boards=2)
    frames = [random_frame(name, 2, seed) for seed in range(3)]
    link.open()
    for frame in frames:
        link.send(frame)
    link.stop()
    link.close()
    back = read_frames(link.path, name, boards=2)
    assert back.board == name
    assert len(back.frames) == 4
    assert all(there.same_as(frame) for there, frame in zip(back.frames, frames, strict=False))
    assert back.frames[-1].silent
    assert suffix == ".bin" or np.all(np.diff(back.seconds) >= 0)
    assert sorted(path.name for path in tmp_path.iterdir()) == [link.path.name]


def test_bytes_for_openmpd_are_what_its_receiver_takes(tmp_path) -> None:
    frame = random_frame("openmpd", 1, 7)
    write_frames(tmp_path / "one.bin", Frames("openmpd", (frame,), np.zeros(1)))
    board = OpenMPD()
    for byte in (tmp_path / "one.bin").read_bytes():
        board.hear(byte)
    assert board.playing is not None
    np.testing.assert_array_equal(board.playing[1][codec_of("openmpd").board.channels], frame.amplitude)


def test_a_link_that_was_sent_nothing_writes_nothing(tmp_path) -> None:
    link = FileLink(tmp_path / "none.npz")
    link.open()
    link.close()
    assert not link.path.exists()


def test_a_recording_remembers_frames_and_times() -> None:
    link = RecordingLink("nano16")
    link.open()
    frame = random_frame("nano16", 1, 1)
    link.send(frame)
    link.stop()
    link.close()
    assert link.frames[0] is frame
    assert link.frames[1].silent
    assert link.seconds == sorted(link.seconds)


ONE = Frames("nano16", (random_frame("nano16", 1, 1),), np.zeros(1))
OTHER = random_frame("sonicsurface", 1, 1)


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda folder: write_frames(folder / "a.txt", ONE), r"a\.txt is none of the 4 kinds of frame files: \.npz"),
        (lambda folder: write_frames(folder / "a.npz", Frames("nano16", (), np.zeros(0))), "at least 1 frame, not 0"),
        (
            lambda folder: write_frames(folder / "a.npz", Frames("nano16", (*ONE.frames, OTHER), np.zeros(2))),
            "the 2 frames for a.npz differ",
        ),
        (lambda folder: write_frames(folder / "none" / "a.npz", ONE), r"cannot write .*a\.npz: No such file"),
        (lambda folder: FileLink(folder / "none" / "a.npz").open(), "there is no folder .*none for a.npz"),
        (lambda folder: read_frames(folder / "a.bin"), "does not say of which board"),
        (lambda folder: read_frames(folder / "a.bin", "autd3"), r"cannot read a\.bin: No such file"),
        (lambda folder: read_frames(folder / "a.npz"), r"cannot read a\.npz"),
    ],
)
def test_files_that_cannot_be_are_refused(tmp_path, make, sentence: str) -> None:
    with pytest.raises(InvalidInput, match=sentence):
        make(tmp_path)


def test_bytes_of_another_board_are_refused(tmp_path) -> None:
    write_frames(tmp_path / "a.bin", ONE)
    with pytest.raises(InvalidInput, match="66 bytes are not made of messages of 512 bytes for 1 openmpd boards"):
        read_frames(tmp_path / "a.bin", "openmpd")
    (tmp_path / "a.csv").write_text("frame,seconds\n0,0\n")
    with pytest.raises(InvalidInput, match=r"line 1 of a\.csv must be frame,seconds,element"):
        read_frames(tmp_path / "a.csv", "autd3")
