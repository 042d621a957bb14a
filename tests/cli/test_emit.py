"""Drives to boards through the real command line: what it says, what it refuses, and how it ends."""

import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import jaxtyping
import numpy as np
import pytest

import airtact as at
from airtact.emission.codecs import codec_of
from cli.running import done, output, rejected
from emission.receivers import SonicSurface, wired

BRIEFLY = ("--seconds", "0.05")
FULL = ("--yes", "--full-scale")

SCENE = """frequency = 40e3
[medium]
sound_speed = 343.1
density = 1.293
[array]
layout = "boards"
[[foci]]
point = [0.0, 0.0, 0.1]
"""


def write(
    path: Path,
    array: at.PhasedArray,
    scene: str = SCENE,
    frames: int = 1,
    rate: float | None = None,
    frequency: float = 40e3,
    modulation: at.transducers.AmplitudeModulation | None = None,
) -> Path:
    """Write a drive.h5 for open air, as a run writes it; a sequence turns its phases from frame to frame."""
    target = at.Target(np.array([[0.004, 0.002, 0.1]]))
    open_air = at.Scene(at.Medium(343.1, 1.293), [], frequency=frequency)
    beacons = at.FreeField().radiate(open_air, target.beacons())
    transfer = at.transfer_matrix(beacons, array)
    drive = at.time_reversal(transfer, target)
    if rate is None:
        drive.save(
            path, array, open_air, transfer, target, texts={"scene": SCENE}, modulation=modulation
        )
    else:
        turns = np.exp(0.3j * np.arange(frames))[:, None]
        at.drives.Sequence(turns * drive.amplitudes, rate).save(
            path, array, open_air, transfer, target
        )
    return path


def change(path: Path, **columns) -> Path:
    with h5py.File(path, "a") as file:
        for name, values in columns.items():
            del file[name]
            if values is not None:
                file[name] = values
    return path


@pytest.fixture(scope="module")
def written(tmp_path_factory) -> bytes:
    folder = tmp_path_factory.mktemp("drive")
    return write(folder / "drive.h5", at.surrounding_box(board="autd3")).read_bytes()


@pytest.fixture
def drive(tmp_path, written) -> Path:
    (tmp_path / "drive.h5").write_bytes(written)
    return tmp_path / "drive.h5"


# --- what it says ---------------------------------------------------------------------------------------------------


def test_a_drive_goes_through_the_firmware_model(capsys, drive) -> None:
    printed, _ = done(
        capsys, "emit", drive, "--board", "autd3", "--link", "audit", "--yes", "--seconds", "0.1"
    )
    assert "4 AUTD3, 996 transducers, through audit" in printed
    level = re.search(r"up to (\d+) dB SPL, 0\.5 m from", printed)
    assert level
    assert 100 < int(level[1]) <= 110
    assert re.search(r"cap of 0\.0\d+ .* to 110 dB. --full-scale emits up to 139 dB", printed)
    assert "skin hardly feels a constant force" in printed
    assert "--modulate am:200" in printed
    assert "This is not a safety assessment" in printed
    assert "9 messages were sent. The last one silences the boards, which confirmed it." in printed


def test_a_drive_goes_by_udp(capsys, drive) -> None:
    emulated = ("--board", "autd3", "--link", "udp", "--address", "emulator")
    printed, _ = done(capsys, "emit", drive, *emulated, *BRIEFLY, "--yes", "--modulate", "am:200")
    assert "4 AUTD3, 996 transducers, through udp" in printed
    assert "The last one silences the boards, which confirmed it." in printed


@pytest.mark.parametrize(
    ("board", "count", "advised"),
    [("autd3", 1, 200), ("sonicsurface", 1, 44), ("sonicsurface", 2, 22), ("nano16", 1, 87)],
)
def test_the_advised_modulation_is_one_that_the_boards_take(
    capsys, tmp_path, board, count, advised
) -> None:
    poses = [at.Pose.turn((0, 0, 1), 0.0, (0.2 * index, 0.0, 0.0)) for index in range(count)]
    array = at.transducers.board_array(board, poses)
    path = write(tmp_path / "drive.h5", array)
    to_file = ("--board", board, "--link", "file", "--out", tmp_path / "frames.h5")
    printed, _ = done(capsys, "emit", path, *to_file)
    words = re.search(r"--modulate am:(\d+)", printed)
    assert words
    assert int(words[1]) == advised
    done(capsys, "emit", path, *to_file, "--modulate", f"am:{advised}")
    if advised < 200:
        assert f"frequency = {advised}" in printed
        errors = rejected(capsys, "emit", path, *to_file, "--modulate", f"am:{advised + 1}")
        assert f"--modulate am:{advised}." in errors


def test_a_frame_is_judged_at_the_foci_that_it_is_made_for(capsys, tmp_path) -> None:
    """The pressure that a frame for one focus leaves at another does not count."""
    array = at.autd3_board()
    points = np.array([[0.05, 0.05, 0.15], [0.12, 0.05, 0.15]])
    scene = at.Scene(at.Medium(343.1, 1.293), [])
    target = at.Target(points)
    transfer = at.open_air_matrix(scene, array, target)
    frames = np.stack([np.exp(-1j * np.angle(row)) for row in transfer.matrix])
    path = tmp_path / "drive.h5"
    at.drives.Sequence(frames, 200.0).save(path, array, scene, transfer, target)
    printed, _ = done(capsys, "emit", path, "--board", "autd3", "--link", "audit", *FULL, *BRIEFLY)
    weakest = re.search(r"weakest focus\s+([\d,]+) Pa", printed)
    assert weakest
    expected = np.abs(transfer.matrix @ frames.T).max(axis=1).min()
    assert float(weakest[1].replace(",", "")) == pytest.approx(expected, rel=0.01)


def test_a_drive_is_modulated_as_its_file_or_the_command_says(capsys, tmp_path) -> None:
    path = write(
        tmp_path / "drive.h5",
        at.transducers.board_array("autd3"),
        modulation=at.transducers.AmplitudeModulation(125.0, 0.5),
    )
    printed, _ = done(capsys, "emit", path, *AUDIT, *BRIEFLY)
    assert "amplitude, 125 Hz, 0.5 deep" in printed
    assert "threshold of detection with amplitude modulation" in printed
    assert "The modulated drive was played at 2500 frames/s" in printed
    average = re.search(r"up to (\d+) dB SPL, (\d+) dB on average", printed)
    assert average
    assert 0 <= int(average[1]) - int(average[2]) <= 2  # half of the force swings: 1.2 dB
    printed, _ = done(capsys, "emit", path, *AUDIT, *BRIEFLY, "--modulate", "am:200")
    assert "The modulated drive was played at 4000 frames/s" in printed
    printed, _ = done(capsys, "emit", path, *AUDIT, *BRIEFLY, "--modulate", "none")
    assert "was played at" not in printed
    assert "skin hardly feels a constant force" in printed


def test_boards_that_cannot_be_turned_down_ask_for_full_scale(capsys, tmp_path) -> None:
    path = write(tmp_path / "drive.h5", at.transducers.board_array("sonicsurface"))
    errors = rejected(
        capsys, "emit", path, "--board", "sonicsurface", "--link", "serial", "--port", "x", "--yes"
    )
    assert "140 dB" in errors
    assert errors.endswith("[out_of_range]")
    # Any amplitude is full scale there, and this is what is stated.
    change(path, amplitude=np.full(256, 0.1))
    to_file = ("--link", "file", "--out", tmp_path / "frames.h5", "--modulate", "am:40")
    printed, _ = done(capsys, "emit", path, "--board", "sonicsurface", *to_file)
    assert "1 of full scale, cap 1 (256 of 256 transducers on)" in " ".join(printed.split())
    assert "ignores nonlinear steepening" in printed


def test_a_sequence_tells_its_rate_and_what_was_dropped(capsys, tmp_path) -> None:
    path = write(
        tmp_path / "sequence.h5", at.transducers.board_array("autd3"), frames=8, rate=400.0
    )
    printed, _ = done(
        capsys, "emit", path, "--board", "autd3", "--link", "audit", "--yes", "--seconds", "0.2"
    )
    assert "8 frames at 400 frames/s" in printed
    assert "The sequence was played at 400 frames/s: 80 frames, 0 dropped." in printed


def test_boards_are_listed_with_their_links(capsys) -> None:
    printed, errors = done(capsys, "boards")
    assert errors == ""
    assert "autd3 249 256 x 256 phases 1 to 256" in printed
    assert "sonicsurface 256 on, off x 32 phases 1 to 2" in printed
    assert "audit, ethercrab, twincat, remote, simulator, file" in printed
    assert "Serial ports:" in printed


@pytest.mark.parametrize("kind", ["h5"])
def test_a_file_holds_the_drive_in_the_boards_levels(capsys, tmp_path, kind) -> None:
    path = write(tmp_path / "drive.h5", at.transducers.board_array("openmpd"))
    out = tmp_path / f"frames.{kind}"
    to_file = ("--board", "openmpd", "--link", "file", "--out", out)
    printed, _ = done(capsys, "emit", path, *to_file)
    assert "1 frame was written" in printed
    back = at.load_drive(out)
    assert isinstance(back, at.Drive)
    assert at.quantise(back, codec_of("openmpd").levels).same_as(
        at.quantise(at.load_drive(path), codec_of("openmpd").levels)
    )
    with h5py.File(path) as file:
        asked = file["amplitude"][()] * np.exp(1j * file["phase"][()])
    np.testing.assert_allclose(
        back.amplitudes, asked, rtol=0, atol=0.5 / 64 * np.pi / 2 + np.pi / 128
    )


def test_a_file_holds_one_period_of_a_modulated_drive(capsys, tmp_path) -> None:
    modulation = at.transducers.AmplitudeModulation(200.0)
    path = write(
        tmp_path / "drive.h5", at.transducers.board_array("openmpd"), modulation=modulation
    )
    out = tmp_path / "frames.h5"
    to_file = ("--board", "openmpd", "--link", "file", "--out", out)
    done(capsys, "emit", path, *to_file)
    back = at.load_drive(out)
    assert isinstance(back, at.drives.Sequence)
    assert (len(back), back.rate) == (20, 4000.0)
    largest = np.abs(back.drives).max(axis=1)
    force = (1.0 + np.cos(2 * np.pi * np.arange(20) / 20)) / 2
    np.testing.assert_allclose(largest**2, force, rtol=0, atol=0.03)


def test_a_drive_file_needs_no_scene(capsys, drive) -> None:
    """Frequency and medium stand in the file itself, so keys of scenes may be renamed."""
    done(capsys, "emit", change(drive, scene="colour = 3"), *AUDIT, "--seconds", "0.05")
    done(capsys, "emit", change(drive, scene=None), *AUDIT, "--seconds", "0.05")


# --- what it refuses ------------------------------------------------------------------------------------------------

AUDIT = ("--board", "autd3", "--link", "audit", "--yes")


FAULTS = {
    "no answer": (lambda path: path, AUDIT[:-1], "link_failed", "--yes"),
    "no file": (lambda path: path.with_name("none.h5"), AUDIT, "file_missing", "none.h5"),
    "no HDF5": (lambda path: path.parent / "text.h5", AUDIT, "file_unreadable", "text.h5"),
    "no drive": (
        lambda path: change(path, phase=None),
        AUDIT,
        "data_missing",
        "phase",
    ),
    "a later version": (
        lambda path: change(path, format_version=9),
        AUDIT,
        "unsupported_version",
        "format_version is 9",
    ),
    "no positions": (
        lambda path: change(path, positions=None, normals=None),
        AUDIT,
        "data_missing",
        "drive.h5: the file contains no positions",
    ),
    "996 to nano": (
        lambda path: path,
        ("--board", "nano16", "--link", "serial", "--port", "x", "--yes"),
        "too_many",
        "996 elements require 83 nano16 boards",
    ),
    "996 to sonicsurface": (
        lambda path: path,
        ("--board", "sonicsurface", "--link", "serial", "--port", "x", "--yes"),
        "sizes_differ",
        "which have 256 elements each: use a drive for 512",
    ),
    "wrong link": (
        lambda path: path,
        ("--board", "autd3", "--link", "serial", "--port", "x", "--yes"),
        "unknown_name",
        "audit",
    ),
    "no out": (
        lambda path: path,
        ("--board", "autd3", "--link", "file", "--yes"),
        "key_missing",
        "--out",
    ),
    "another port": (lambda path: path, (*AUDIT, "--port", "x"), "options_clash", "--port x"),
    "cap": (lambda path: path, (*AUDIT, "--cap", "0"), "out_of_range", "is 0 of full scale"),
    "cap in per cent": (
        lambda path: path,
        (*AUDIT, "--cap", "50"),
        "out_of_range",
        "30 per cent is 0.3",
    ),
    "two caps": (
        lambda path: path,
        (*AUDIT, "--cap", "0.5", "--full-scale"),
        "options_clash",
        "--cap 0.5",
    ),
    "modulation": (lambda path: path, (*AUDIT, "--modulate", "fm:3"), "unknown_name", "fm:3"),
    "depth": (
        lambda path: path,
        (*AUDIT, "--modulate", "am:200:3"),
        "out_of_range",
        "is 3 of the force",
    ),
    "seconds": (lambda path: path, (*AUDIT, "--seconds", "-1"), "out_of_range", "-1 s"),
    "remote": (
        lambda path: path,
        ("--board", "autd3", "--link", "remote", "--address", "127.0.0.1:9", "--yes"),
        "link_failed",
        "4 AUTD3",
    ),
    "another frequency": (
        lambda path: change(path, frequency=25e3),
        AUDIT,
        "does_not_match",
        "25000 Hz",
    ),
    "inaudible": (
        lambda path: path,
        (*AUDIT, "--cap", "0.001"),
        "all_zero",
        "0.001",
    ),
}


@pytest.mark.parametrize("name", FAULTS)
def test_what_cannot_be_emitted_is_rejected(
    capsys, drive, name, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)  # as it is outside the tests
    (drive.parent / "text.h5").write_text("not HDF5")
    spoil, arguments, fault, shown = FAULTS[name]
    last = rejected(capsys, "emit", spoil(drive), *arguments)
    assert shown in last
    assert last.startswith("airtact: ")
    assert last.endswith(f"[{fault}]")


@pytest.mark.parametrize(
    ("frames", "rate", "sentence"),
    [
        (4, 70.0, r"nearest rate that AUTD3 can play is 70\.05254"),
        (1100, 100.0, r"2 to 1024 frames, not 1100"),
    ],
)
def test_sequences_that_boards_check_are_told_the_nearest(
    capsys, tmp_path, frames, rate, sentence
) -> None:
    path = write(
        tmp_path / "sequence.h5", at.transducers.board_array("autd3"), frames=frames, rate=rate
    )
    errors = rejected(capsys, "emit", path, *AUDIT)
    assert re.search(sentence, errors)


# --- how it ends ----------------------------------------------------------------------------------------------------


def ended_by(kind, path: Path, moment: float) -> None:
    with wired(SonicSurface()) as wire:
        command = [
            sys.executable,
            "-m",
            "airtact",
            "emit",
            str(path),
            "--board",
            "sonicsurface",
            "--link",
            "serial",
        ]
        process = subprocess.Popen(
            [*command, "--port", wire.port, *FULL, "--seconds", "30"],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            while wire.heard < 259 * 4 and process.poll() is None:
                time.sleep(0.005)
            time.sleep(moment)
            process.send_signal(kind)
            _, errors = process.communicate(timeout=120)
        finally:
            process.kill()
        time.sleep(0.05)
        assert wire.heard >= 259 * 4, errors
        assert not wire.board.pulses().any()
        assert process.returncode == (130 if kind == signal.SIGINT else 143), errors
        assert "Traceback" not in errors


@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM])
def test_a_process_that_is_told_to_end_leaves_silence(tmp_path, kind) -> None:
    ended_by(kind, write(tmp_path / "drive.h5", at.transducers.board_array("sonicsurface")), 0.1)


def test_a_cable_cut_while_emitting_ends_with_1(capsys, tmp_path) -> None:
    path = write(
        tmp_path / "sequence.h5", at.transducers.board_array("sonicsurface"), frames=3, rate=50.0
    )
    with wired(SonicSurface(), cut_after=6000) as wire:
        port = ("--link", "serial", "--port", wire.port)
        code, _, errors = output(capsys, "emit", path, "--board", "sonicsurface", *port, *FULL)
    assert code == 1
    last = errors.splitlines()[-1]
    assert "the serial link failed while silencing" in last
    assert "the boards may still emit: cut their power" in last


def test_emit_without_its_extra_names_it(capsys, monkeypatch, drive, tmp_path) -> None:
    (tmp_path / "pyautd3.py").write_text("raise ImportError")
    monkeypatch.syspath_prepend(tmp_path)  # which the link process has too
    errors = rejected(capsys, "emit", drive, *AUDIT)
    assert "airtact[autd3-legacy]" in errors


def test_boards_keeps_the_name_of_the_extra(capsys, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "serial", None)
    monkeypatch.setitem(sys.modules, "serial.tools", None)
    assert "pip install 'airtact[serial]'" in done(capsys, "boards")[0]
