"""A scan that another method made agrees with the prediction to its noise, and one of another scene does not."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

import airtact as at
from airtact.cli import main
from airtact.setup.solving import solve_foci
from airtact.timing import Clock
from paths import SCENES

BALL = SCENES / "ball.toml"
NOISE = 0.02


def write_scan(path: Path, points: np.ndarray, pressures: np.ndarray) -> Path:
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(["x", "y", "z", "pressure", "phase"])
        writer.writerows(np.column_stack([points, np.abs(pressures), np.angle(pressures)]).tolist())
    return path


@pytest.fixture(scope="module")
def scan_file(tmp_path_factory):
    """A virtual measurement by the series for a sphere: a plane above the ball and across it, with 2 % of noise."""
    setup = at.read_scene(BALL)
    transfer, _ = solve_foci(setup, Clock(lambda step: None))
    drive = at.quantise(setup.synthesise(transfer, setup.target)).drive()
    field = at.SphereSeries().radiate(
        setup.scene, at.evaluation.drive_sources(setup.array, [drive])
    )
    x, z = np.meshgrid(np.arange(-15e-3, 15.1e-3, 3e-3), np.arange(-8e-3, 12.1e-3, 3e-3))
    points = np.stack([x.ravel(), np.zeros(x.size), z.ravel()], axis=1)
    heard = at.evaluation.Microphone().read(field, points)[:, 0]
    rng = np.random.default_rng(1)
    level = NOISE * np.sqrt(np.nanmean(np.abs(heard) ** 2) / 2.0)
    heard[~np.isfinite(heard)] = 0.0  # the stage did not go where the ball is
    heard = 0.013j * (
        heard + level * (rng.normal(size=len(heard)) + 1j * rng.normal(size=len(heard)))
    )
    return write_scan(tmp_path_factory.mktemp("scan") / "scan.csv", points, heard)


def compared(capsys, *arguments) -> tuple[dict, str]:
    assert main(["compare-scan", *map(str, arguments), "--json"]) == 0
    printed = capsys.readouterr()
    return json.loads(printed.out), " ".join(printed.err.split())


def test_the_overlay_finds_scale_and_noise(scan_file, tmp_path, capsys):
    axis = ("--axis", "0", "0", "-1")
    record, said = compared(capsys, scan_file, BALL, "--out", tmp_path, *axis)
    assert f"{record['compared']} of {record['positions']} compared" in said
    assert "positions are skipped" in said
    assert record["positions"] / 2 < record["compared"] < record["positions"]
    assert complex(*record["scale"]) == pytest.approx(0.013j, rel=0.02)
    # noise, and what boundary elements at a third of the scene's 5 % do wrong
    assert NOISE * 0.8 < record["error"] < NOISE + 0.02
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["overlay.csv", "overlay.png"]
    with (tmp_path / "overlay.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == record["positions"]
    measured, predicted = (
        np.array([float(row[name]) for row in rows]) for name in ("measured", "predicted")
    )
    used = (measured > 0.0) & np.isfinite(predicted)
    off = np.linalg.norm((measured - predicted)[used]) / np.linalg.norm(measured[used])
    assert off < record["error"] + 0.01


def test_a_ball_somewhere_else_does_not_fit(scan_file, tmp_path, capsys):
    moved = tmp_path / "moved.toml"
    moved.write_text(
        BALL.read_text(encoding="utf-8")
        .replace("{ radius = 5e-3 }", "{ radius = 5e-3, centre = [4e-3, 0.0, 0.0] }")
        .replace("[8e-3, 0.0, 0.0]", "[12e-3, 0.0, 0.0]")
        .replace("[0.0, 0.0, -5.5e-3]", "[4e-3, 0.0, -5.5e-3]"),
        encoding="utf-8",
    )
    arguments = (scan_file, moved, "--out", tmp_path / "out", "--no-pictures")
    assert compared(capsys, *arguments)[0]["error"] > 0.3


def test_bad_scans_and_microphones_end_with_2(scan_file, tmp_path, capsys):
    bad = tmp_path / "bad.csv"
    bad.write_text("x,y,pressure\n0,0,1\n", encoding="utf-8")
    assert main(["compare-scan", str(bad), str(BALL), "--out", str(tmp_path)]) == 2
    assert "bad.csv has no column z" in capsys.readouterr().err
    scan = at.evaluation.load_scan(scan_file)
    other = write_scan(tmp_path / "other.csv", scan.points, scan.pressures.conj())
    assert main(["compare-scan", str(other), str(BALL), "--out", str(tmp_path)]) == 2
    assert "[does_not_match]" in capsys.readouterr().err
    assert (
        main(
            [
                "compare-scan",
                str(scan_file),
                str(BALL),
                "--out",
                str(tmp_path),
                "--diameter",
                "6.35",
            ]
        )
        == 2
    )
    assert "[out_of_range]" in capsys.readouterr().err
