"""Frames in files; reading them back is tested with ``load_drive``."""

import time

import numpy as np

import airtact as at
from airtact.drives.sequence import Sequence
from airtact.emission import link_process
from airtact.emission.codecs import codec_of
from airtact.emission.file_link import FileLink
from airtact.emission.link import RecordingLink
from emission.receivers import OpenMPD
from emission.sounds import tone
from emission.test_codecs import random_frame
from faults import raises_code


def test_a_file_holds_what_was_sent_and_nothing_else(tmp_path) -> None:
    link = FileLink(tmp_path / "frames.h5")
    with at.Emission(link, cap=1.0) as emission:
        emission.send(tone())
        emission.hold(3600.0)
    assert at.quantise(at.load_drive(link.path)).same_as(at.quantise(tone()))
    assert sorted(path.name for path in tmp_path.iterdir()) == [link.path.name]


def test_two_thousand_frames_are_two_thousand_frames_on_a_busy_machine(tmp_path) -> None:
    """Played as fast as the disk takes them: none is left out, however late it is."""
    frames = np.exp(2j * np.pi * np.arange(2000)[:, None] / 256) * tone(12).amplitudes
    with at.Emission(FileLink(tmp_path / "frames.h5", "nano16"), cap=1.0) as emission:
        played = emission.play(Sequence(frames, 1.0), seconds=2000.0)
    assert (played.rate, played.frames, played.dropped) == (1.0, 2000, 0)
    back = at.load_drive(tmp_path / "frames.h5")
    assert isinstance(back, Sequence)
    assert (len(back), back.rate) == (2000, 1.0)
    levels = codec_of("nano16").levels
    asked = Sequence(frames, 1.0)
    assert all(
        at.quantise(back.drive(i), levels).same_as(at.quantise(asked.drive(i), levels))
        for i in range(2000)
    )


def test_a_file_may_take_longer_to_write_than_boards_may_take_to_answer(
    tmp_path, monkeypatch
) -> None:
    class Slow(FileLink):
        def _end(self) -> None:
            time.sleep(0.3)
            super()._end()

    monkeypatch.setattr(link_process, "ANSWER_TIMEOUT", 0.05)
    with at.Emission(Slow(tmp_path / "frames.h5"), cap=1.0) as emission:
        emission.send(tone())
    assert (tmp_path / "frames.h5").exists()


def test_sequences_of_two_rates_do_not_go_into_one_file(tmp_path) -> None:
    link = FileLink(tmp_path / "frames.h5", "nano16")
    link.open()
    link.play([random_frame("nano16", 1, 1)], 100.0)
    with raises_code("sizes_differ", "200"):
        link.play([random_frame("nano16", 1, 1)], 200.0)


def test_bytes_for_openmpd_are_what_its_receiver_takes(tmp_path) -> None:
    frame = random_frame("openmpd", 1, 7)
    link = FileLink(tmp_path / "one.bin", "openmpd")
    link.open()
    link.send(frame)
    link.close()
    board = OpenMPD()
    for byte in (tmp_path / "one.bin").read_bytes():
        board.hear(byte)
    assert board.playing is not None
    np.testing.assert_array_equal(
        board.playing[1][codec_of("openmpd").board.channels], frame.amplitude
    )


def test_a_link_that_was_sent_nothing_writes_nothing(tmp_path) -> None:
    link = FileLink(tmp_path / "none.h5")
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


def test_files_that_cannot_be_are_rejected(tmp_path) -> None:
    with raises_code("unknown_format"):
        FileLink(tmp_path / "a.txt")
    with raises_code("not_writable"):
        FileLink(tmp_path / "none" / "a.h5").open()
