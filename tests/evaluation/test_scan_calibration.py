"""Sensitivity, gains and misalignment of an array from scans that an independent sum simulates."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import airtact as at
from airtact.cli import main
from faults import raises_code

SCENE = at.Scene(at.air(celsius=20.0), [])
TILT = np.radians(7.0)


def face_of_rings(radius: float) -> np.ndarray:
    """A disc as 144 points of equal weight, a rule that the package does not use."""
    rings = radius * np.sqrt((np.arange(6) + 0.5) / 6)
    angles = np.arange(24) * (2.0 * np.pi / 24)
    cosines = np.outer(rings, np.cos(angles)).ravel()
    return np.stack([cosines, np.outer(rings, np.sin(angles)).ravel(), np.zeros(144)], axis=1)


class Bench:
    """An array whose gains are off by 3 % and 0.05 rad, and a stage that is tilted by 7 degrees."""

    def __init__(self, board: str, seed: int = 3) -> None:
        self.random = random = np.random.default_rng(seed)
        self.array = at.transducers.board_array(board)
        count = len(self.array)
        phases = 0.4 + 0.05 * random.normal(size=count)
        self.gains = (1.0 + 0.03 * random.normal(size=count)) * np.exp(1j * phases)
        self.sensitivity = 4.9 * np.abs(self.gains).mean()
        x, y = np.meshgrid(*[np.linspace(-0.03, 0.03, 11)] * 2)
        middle = self.array.positions.mean(axis=0) + [0.0, 0.0, 0.1]
        self.points = np.stack([x.ravel(), y.ravel(), 0.0 * x.ravel()], axis=1) + middle
        self.turn = Rotation.from_rotvec(TILT * np.array([0.8, 0.6, 0.0]))
        true = self.turn.apply(self.points - middle) + middle + [5e-4, -3e-4, 1e-3]
        self.fields = np.zeros((len(true), count), dtype=complex)
        face = face_of_rings(self.array.element.radius)
        for point in face:
            away = np.linalg.norm(true[:, None] - self.array.positions - point, axis=2)
            self.fields += np.exp(1j * SCENE.wavenumber * away) / away / len(face)

    def scan(self, drive: at.Drive, phased: bool = True) -> at.evaluation.Scan:
        """The scan of a drive with 1 % of noise."""
        random = self.random
        heard = 4.9 * self.fields @ (self.gains * drive.amplitudes)
        level = 0.01 * np.sqrt(np.mean(np.abs(heard) ** 2) / 2.0)
        heard += level * (random.normal(size=len(heard)) + 1j * random.normal(size=len(heard)))
        return at.evaluation.Scan(self.points, heard if phased else np.abs(heard) + 0j, phased)

    def focus(self) -> at.Drive:
        away = np.linalg.norm(self.points.mean(axis=0) - self.array.positions, axis=1)
        return at.Drive(np.exp(-1j * SCENE.wavenumber.real * away))

    def singles(self) -> list[at.Drive]:
        return [at.Drive(row) for row in np.eye(len(self.array), dtype=complex)]

    def check(self, calibrated: at.evaluation.ScanCalibration, degrees: float) -> None:
        off = abs(calibrated.sensitivity - self.sensitivity)
        assert off < 3.0 * calibrated.deviation
        assert off < 0.01 * self.sensitivity
        normals = np.stack([calibrated.pose.rotation[:, 2], self.turn.as_matrix()[:, 2]])
        assert np.degrees(np.arccos(normals[0] @ normals[1])) < degrees


@pytest.fixture(scope="module")
def small() -> Bench:
    return Bench("nano16")


def test_single_elements_give_sensitivity_tilt_and_all_gains(small) -> None:
    drives = small.singles()
    scans = [small.scan(drive) for drive in drives]
    calibrated = at.evaluation.calibrate_from_scans(scans, drives, small.array, SCENE)
    small.check(calibrated, 0.2)
    assert calibrated.deviation < 0.002 * calibrated.sensitivity
    assert calibrated.determined.all()
    relative = small.gains / np.abs(small.gains).mean()
    relative = relative * np.exp(-1j * np.angle(relative.mean()))
    errors = np.abs(calibrated.array.gains - relative)
    assert errors.max() < 0.02
    assert np.sqrt(np.mean(errors**2)) < 2.0 * calibrated.gain_deviations.mean()


def test_a_focus_gives_sensitivity_and_tilt() -> None:
    bench = Bench("autd3")
    drive = bench.focus()
    calibrated = at.evaluation.calibrate_from_scans(
        [bench.scan(drive)], [drive], bench.array, SCENE
    )
    bench.check(calibrated, 0.2)
    # 121 positions cannot distinguish 249 elements.
    assert not calibrated.determined.any()
    assert (calibrated.array.gains == 1.0).all()


@pytest.mark.slow
def test_the_stated_deviation_covers_the_tilt_from_a_focus_of_twelve_elements() -> None:
    covered = []
    for seed in range(50):
        bench = Bench("nano16", seed)
        drive = bench.focus()
        calibrated = at.evaluation.calibrate_from_scans(
            [bench.scan(drive)], [drive], bench.array, SCENE
        )
        errors = calibrated.misalignment[:2] - bench.turn.as_rotvec()[:2]
        covered.append(np.abs(errors) < 1.96 * calibrated.misalignment_deviation[:2])
    assert 0.9 <= np.mean(covered) <= 0.99


def test_magnitudes_give_sensitivity_and_tilt(small) -> None:
    drive = small.focus()
    scan = small.scan(drive, phased=False)
    calibrated = at.evaluation.calibrate_from_scans([scan], [drive], small.array, SCENE)
    # Magnitudes hardly depend on the tilt.
    small.check(calibrated, 3.0)
    assert not calibrated.determined.any()


def test_the_face_of_the_microphone_is_taken_into_account(small) -> None:
    """A wide microphone reads a focus 9 % too low; here it is averaged as ``compare-scan`` does."""
    drive = small.focus()
    sources = at.evaluation.drive_sources(small.array, [drive])
    microphone = at.evaluation.Microphone()
    heard = microphone.read(at.FreeField().radiate(SCENE, sources), small.points)[:, 0]
    scan = at.evaluation.Scan(small.points, 1.1 * heard, True)
    calibrated = at.evaluation.calibrate_from_scans([scan], [drive], small.array, SCENE, microphone)
    expected = 1.1 * small.array.element.sensitivity
    assert calibrated.sensitivity == pytest.approx(expected, rel=3e-3)
    assert abs(calibrated.sensitivity - expected) < 3.0 * calibrated.deviation
    assert np.degrees(np.abs(calibrated.misalignment[:2])).max() < 0.2


def test_one_element_does_not_tell_about_the_others(small) -> None:
    drive = small.singles()[5]
    calibrated = at.evaluation.calibrate_from_scans(
        [small.scan(drive)], [drive], small.array, SCENE
    )
    # The gains of transducers are taken to differ by 10 %.
    assert calibrated.deviation == pytest.approx(0.1 * calibrated.sensitivity, rel=0.2)
    assert not calibrated.determined.any()


def test_unusable_scans_are_rejected(small) -> None:
    drive = small.focus()
    scan = small.scan(drive)
    with raises_code("sizes_differ"):
        at.evaluation.calibrate_from_scans([scan], [drive, drive], small.array, SCENE)
    ball = at.Scene(SCENE.medium, [at.sound_hard(at.sphere(5e-3, 2e-3))])
    with raises_code("not_supported"):
        at.evaluation.calibrate_from_scans([scan], [drive], small.array, ball)
    random = np.random.default_rng(0).normal(size=len(scan.points)) + 0j
    other = at.evaluation.Scan(scan.points, random, True)
    with raises_code("pose_not_found"):
        at.evaluation.calibrate_from_scans([other], [drive], small.array, SCENE)


SCENE_FILE = """
[medium]
celsius = 20.0

[array]
layout = "boards"
board = "nano16"

[[array.poses]]
translation = [0.0, 0.0, 0.0]

[[foci]]
point = [0.02, 0.02, 0.1]
"""


def test_the_command_writes_what_a_scene_reads(small, tmp_path, capsys) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text(SCENE_FILE)
    words = ["calibrate", str(scene), "--diameter", "1e-4", "--out", str(tmp_path / "gains.csv")]
    for element, drive in enumerate(small.singles()):
        scan = small.scan(drive)
        path = tmp_path / f"{element}.csv"
        columns = [scan.points, np.abs(scan.pressures), np.angle(scan.pressures)]
        np.savetxt(
            path, np.column_stack(columns), "%.9g", ",", header="x,y,z,pressure,phase", comments=""
        )
        words += ["--scan", str(path), "--element", str(element)]
    assert main([*words, "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["sensitivity"] == pytest.approx(small.sensitivity, rel=0.005)
    assert record["determined"] == list(range(len(small.array)))
    added = f'sensitivity = {record["sensitivity"]}\ncalibration = "gains.csv"\n\n[[array.poses]]'
    scene.write_text(SCENE_FILE.replace("[[array.poses]]", added))
    array = at.read_scene(scene).array
    assert array.element.sensitivity == record["sensitivity"]
    np.testing.assert_allclose(
        np.abs(array.gains), np.abs(small.gains) / np.abs(small.gains).mean(), rtol=0.02
    )
    assert main([*words[:4], "--element", "0"]) == 2
    assert "[options_clash]" in capsys.readouterr().err
    assert main([*words, "--element", "99"]) == 2
    assert "[unknown_name]" in capsys.readouterr().err
