"""``airtact sense``: the pose of small bodies from simulated echoes, from their file, and echoes of something else."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

import airtact as at
from airtact.cli import main

SCENE = """
[medium]
sound_speed = 343.1
density = 1.293

[array]
layout = "boards"

[[array.poses]]
translation = [-0.08636, -0.06604, -0.07]

[[obstacles]]
sphere = { radius = 4e-3, centre = [-6e-3, 0.0, 0.0] }

[[obstacles]]
sphere = { radius = 3e-3, centre = [5e-3, 2e-3, 3e-3] }

[[obstacles]]
sphere = { radius = 3.5e-3, centre = [0.0, 8e-3, -3e-3] }

[[foci]]
point = [-6e-3, 0.0, -4.5e-3]

[solver]
accuracy = 0.05
"""


def run(folder, capsys, *words: str) -> tuple[int, dict]:
    scene = folder / "scene.toml"
    scene.write_text(SCENE)
    status = main(["sense", str(scene), "--json", "--out", str(folder / "out"), *words])
    return status, json.loads(capsys.readouterr().out)


def test_a_pose_is_found_from_simulated_echoes_and_from_their_file(tmp_path, capsys) -> None:
    status, found = run(tmp_path, capsys, "--simulate", "--offset", "1e-3", "--turn", "2")
    assert status == 0
    assert found["off"][0] == pytest.approx(1e-3, rel=0.05)
    assert found["error"][0] < 5e-5
    assert found["misfit"] < 0.1
    assert found["corrected"] > found["uncorrected"] > 0
    pose = json.loads((tmp_path / "out/pose.json").read_text())
    assert pose["format_version"] == 1
    assert np.allclose(pose["translation"], found["translation"])
    page = Path(found["files"]["report.html"]).read_text(encoding="utf-8")
    assert page.count("<img ") == 2
    assert not re.search(r"https?://|@import|url\(|<script src|<link", page)
    gained = float(re.search(r"([\d.]+) times", page)[1])  # pyright: ignore[reportOptionalSubscript]
    assert gained == pytest.approx(found["corrected"] / found["uncorrected"], abs=0.006)
    # Noise 20 dB below the echoes is what the pose found leaves; the start leaves far more.
    before, after = re.search(
        r"the residual at each element: ([\d.]+) for the pose in the scene and ([\d.]+)", page
    ).groups()  # pyright: ignore[reportOptionalMemberAccess]
    assert float(after) == pytest.approx(0.1, abs=0.01)
    assert float(before) > 0.3

    status, again = run(tmp_path, capsys, "--no-pictures", "--echoes", found["files"]["echoes.h5"])
    assert not Path(found["files"]["report.html"]).exists(), "the page is of another run"
    assert status == 0
    assert again["error"] is None
    assert np.allclose(again["translation"], found["translation"], atol=1e-9)


def test_echoes_that_do_not_fit_are_rejected(tmp_path, capsys) -> None:
    assert run(tmp_path, capsys)[1]["code"] == "data_missing"
    assert run(tmp_path, capsys, "--simulate", "--offset", "2")[1]["code"] == "wrong_usage"
    path = tmp_path / "echoes.h5"
    random = np.random.default_rng(0)
    few = np.arange(0, 249, 12)
    at.Echoes(
        at.sensing.random_codes(249, 2), random.normal(size=(len(few), 2)) * (1 + 1j), few
    ).save(path)
    status, fault = run(tmp_path, capsys, "--echoes", str(path))
    assert (status, fault["code"]) == (2, "pose_not_found")
    at.Echoes(np.eye(3), np.eye(3)).save(path)
    assert run(tmp_path, capsys, "--echoes", str(path))[1]["code"] == "sizes_differ"


CALIBRATED = """
[medium]
sound_speed = 343.1
density = 1.293

[array]
layout = "boards"
board = "sonicsurface"

[[array.poses]]

[[array.poses]]
axis = [1, 0, 0]
degrees = 180
translation = [0.0, 0.0, 0.12]

[[foci]]
point = [0.0, 0.0, 0.06]
"""


def test_an_array_is_calibrated_by_simulated_transmissions_and_by_a_file(tmp_path, capsys) -> None:
    scene, table = tmp_path / "scene.toml", tmp_path / "calibration.csv"
    scene.write_text(CALIBRATED.replace('"sonicsurface"', '"sonicsurface"\nsource = "monopole"'))
    words = ["calibrate", "--scene", str(scene), "--json", "--out", str(table)]
    assert main([*words, "--simulate"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["error"][0] < 2e-5
    assert found["error"][1] < 0.05
    assert found["misfit"] < 0.1
    scene.write_text(
        scene.read_text().replace('"monopole"', '"monopole"\ncalibration = "calibration.csv"')
    )
    assert not np.allclose(at.read_scene(scene).array.gains, 1.0)
    path = tmp_path / "echoes.h5"
    at.Echoes(at.sensing.hadamard_codes(512), np.ones((1, 512)), np.array([0])).save(path)
    assert main([*words, str(path)]) == 2
    assert json.loads(capsys.readouterr().out)["code"] == "signal_unusable"
    assert main(words) == 2
    assert json.loads(capsys.readouterr().out)["code"] == "data_missing"


@pytest.mark.slow
def test_the_gap_of_a_pinch_is_found_with_its_pose(tmp_path, capsys) -> None:
    words = ["--simulate", "--offset", "1e-3", "--turn", "2", "--opened", "7e-4"]
    assert main(["sense", "pinch", "--json", "--out", str(tmp_path), *words]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["true_gap"] == pytest.approx(0.0127)
    assert found["opening"] == pytest.approx(0.0127, abs=3e-5)
    assert found["error"][0] < 5e-5
    assert found["corrected"] > found["uncorrected"] > 0
    assert json.loads((tmp_path / "pose.json").read_text())["opening"] == found["opening"]
