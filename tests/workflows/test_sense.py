"""``airtact sense``: the pose of small bodies from simulated echoes, from their file, and echoes of something else."""

import json

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

    status, again = run(tmp_path, capsys, "--echoes", found["files"]["echoes.h5"])
    assert status == 0
    assert again["error"] is None
    assert np.allclose(again["translation"], found["translation"], atol=1e-9)


def test_echoes_that_do_not_fit_are_rejected(tmp_path, capsys) -> None:
    assert run(tmp_path, capsys)[1]["code"] == "echoes_missing"
    assert run(tmp_path, capsys, "--simulate", "--offset", "2")[1]["code"] == "out_of_range"
    assert run(tmp_path, capsys, "--simulate", "--seed", "-1")[1]["code"] == "out_of_range"
    path = tmp_path / "echoes.h5"
    random = np.random.default_rng(0)
    few = np.arange(0, 249, 12)
    at.Echoes(at.sensing.random_codes(249, 2), random.normal(size=(len(few), 2)) * (1 + 1j), few).save(path)
    status, fault = run(tmp_path, capsys, "--echoes", str(path))
    assert (status, fault["code"]) == (2, "pose_not_found")
    at.Echoes(np.eye(3), np.eye(3)).save(path)
    assert run(tmp_path, capsys, "--echoes", str(path))[1]["code"] == "element_count"
