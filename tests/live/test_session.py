"""A session's file is checked as a whole before anything is built from it."""

import time
from dataclasses import replace

import h5py
import numpy as np
import pytest

import airtact as at
from faults import full_disk, raises_code
from live.live_scenes import one_board, playing


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> bytes:
    """A session of two frames and three drives."""
    path = tmp_path_factory.mktemp("session") / "session.h5"
    scene = one_board()
    writer = at.live.SessionWriter(path, scene, "a scene")
    for index in range(3):
        moment = playing(scene, 0.01 * index)
        writer.drive(moment, 0.01 * index)
        if index:
            writer.frame(at.hands.HandFrame(0.01 * index, "left", index, moment.joints))
    writer.close()
    return path.read_bytes()


@pytest.fixture
def path(recorded, tmp_path):
    (tmp_path / "session.h5").write_bytes(recorded)
    return tmp_path / "session.h5"


def test_a_session_is_read(path) -> None:
    session = at.live.read_session(path)
    assert (session.text, session.scene.places) == ("a scene", ("thumb.pad", "index.pad"))
    assert session.rules == ("phalanges",) * 3
    assert session.amplitudes.shape == (3, 249)
    assert np.isfinite(session.foci).all()
    assert len(at.live.recording_of(path).frames) == 2


def test_a_session_without_sound_cannot_be_verified(path) -> None:
    session = at.live.read_session(path)
    silent = replace(session, amplitudes=0.0 * session.amplitudes)
    with raises_code("empty"):
        at.live.verify_session(silent)


def test_an_earlier_session_stays_until_the_loop_begins(path) -> None:
    before = path.read_bytes()
    at.live.SessionWriter(path, one_board()).close()
    assert path.read_bytes() == before


def test_a_second_run_into_one_folder_is_turned_away(path) -> None:
    writer = at.live.SessionWriter(path, one_board())
    with raises_code("not_writable"):
        at.live.SessionWriter(path, one_board())
    writer.close()
    at.live.SessionWriter(path, one_board()).close()


@pytest.mark.parametrize("room", [0, 60_000, 900_000])
def test_a_full_disk_keeps_what_was_recorded_and_says_what_is_missing(path, room) -> None:
    """No file may grow over some room: nothing fits, or the header, or some hundred drives."""
    scene = one_board()
    before = path.stat().st_mtime_ns
    with full_disk(room):
        writer = at.live.SessionWriter(path, scene)
        writer.begin()
    end = time.monotonic() + 120.0
    count = 0
    moment = playing(scene)
    while writer.fault is None and time.monotonic() < end:
        noise = np.exp(2j * np.pi * np.random.default_rng(count).random(249))
        writer.drive(replace(moment, amplitudes=noise), 0.01 * count)
        count += 1
        # Rows that arrive too fast, or before the process has started, are written as one block,
        # which does not fit.
        time.sleep(0.002)
        while path.stat().st_mtime_ns == before and writer.fault is None and time.monotonic() < end:
            time.sleep(0.01)
    writer.close()
    assert "too large" in (writer.fault or "")
    kept = len(at.live.read_session(path).time_in_air)
    assert kept == 3 if room == 0 else kept < count
    if room == 900_000:
        assert kept > 100


def test_a_writer_that_hangs_or_is_killed_does_not_stop_the_loop(path) -> None:
    writer = at.live.SessionWriter(path, one_board())
    writer.begin()
    writer._process.kill()
    writer.drive(playing(one_board(), 0.0), 0.0)
    writer.close()
    assert "ended" in (writer.fault or "")


def test_a_session_of_an_hour_is_small(tmp_path) -> None:
    """Random phases, which compress worst, take a fifth of the memory of complex numbers."""
    scene = one_board()
    writer = at.live.SessionWriter(tmp_path / "session.h5", scene)
    random = np.random.default_rng(1)
    moment = playing(scene)
    for count in range(1024):
        noise = np.exp(2j * np.pi * random.random(249))
        writer.drive(replace(moment, amplitudes=noise), 0.01 * count)
    writer.close()
    with h5py.File(tmp_path / "session.h5") as file:
        assert file["drives/amplitudes"].dtype == np.complex64
        assert file["drives/amplitudes"].id.get_storage_size() < 1.5 * 249 * 1024


def replaced(file: h5py.File, name: str, values) -> None:
    del file[name]
    file[name] = values


def zeros_without_end(file: h5py.File) -> None:
    del file["drives/amplitudes"]
    file.create_dataset("drives/amplitudes", (10**10, 249), "c8", chunks=(1, 249))


def circle(file: h5py.File) -> None:
    replaced(file, "array/positions", h5py.SoftLink("/array/positions"))


@pytest.mark.parametrize(
    ("spoil", "code"),
    [
        (zeros_without_end, "file_too_large"),
        (circle, "file_unreadable"),
        (lambda file: file.attrs.update(places=0.5), "not_a_number"),
        (lambda file: file.attrs.update(radius="wide"), "not_a_number"),
        (lambda file: file.attrs.update(places=["thumb.pad", "tail"]), "unknown_name"),
        (lambda file: file.attrs.update(side="both"), "unknown_name"),
        (lambda file: file.attrs.update(frequency=np.nan), "out_of_range"),
        (lambda file: file.attrs.update(format_version=9), "unsupported_version"),
        (lambda file: replaced(file, "drives/state", np.full(3, 99)), "out_of_range"),
        (lambda file: replaced(file, "drives/foci", np.zeros((3, 5, 3))), "wrong_shape"),
        (lambda file: replaced(file, "drives/amplitudes", np.zeros((3, 7))), "wrong_shape"),
        (lambda file: replaced(file, "array/normals", np.zeros((249, 3))), "all_zero"),
        (lambda file: file.pop("drives/rule"), "data_missing"),
    ],
)
def test_a_spoilt_session_is_rejected(path, spoil, code) -> None:
    with h5py.File(path, "a") as file:
        spoil(file)
    with raises_code(code):
        at.live.read_session(path)


def test_columns_of_a_killed_loop_are_cut_to_the_shortest(path) -> None:
    with h5py.File(path, "a") as file:
        replaced(file, "drives/kept", np.ones(2))
    assert len(at.live.read_session(path).time_in_air) == 2
