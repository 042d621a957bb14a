"""``airtact place``: layouts as scene files, the comparison, and what moves cost."""

import json

import numpy as np

import airtact as at
from cli.running import done, output, rejected

SCENE = """
medium = { celsius = 20.0 }

[array]
layout = "flat_boards"
rows = 1
columns = 1

[[foci]]
point = [0.0, 0.0, 0.15]
"""


def test_place_writes_layouts_and_compares_them(tmp_path, capsys) -> None:
    scene = tmp_path / "air.toml"
    scene.write_text(SCENE, encoding="utf-8")
    words = ["place", scene, "--out", tmp_path / "out", "--board", "nano16", "--tries", "1"]
    # Boards are below z = 0, but not at x > 0.
    words += ["--region", *("-1", "-1", "-1", "1", "1", "0")]
    words += ["--keep-out", *("0", "-1", "-1", "1", "1", "1")]
    code, printed, _ = output(capsys, *words, "--json")
    assert code == 0
    record = json.loads(printed)
    assert record["command"] == "place"
    first = record["layouts"][0]
    assert np.isclose(record["verified"], first["weakest"], rtol=1e-6)
    assert np.shape(record["moves"]) == (1, 6)
    setup = at.read_scene(record["files"]["layout_1.toml"])
    assert (setup.array.positions[:, [0, 2]] < 0).all()
    beacons = setup.solver.radiate(setup.scene, setup.target.beacons())
    weakest = np.abs(at.transfer_matrix(beacons, setup.array).matrix).sum()
    assert np.isclose(weakest, first["weakest"], rtol=1e-6)


def test_the_tables_name_layouts_and_moves(tmp_path, capsys) -> None:
    scene = tmp_path / "air.toml"
    scene.write_text(SCENE, encoding="utf-8")
    printed, _ = done(
        capsys, "place", scene, "--out", tmp_path, "--board", "nano16", "--tries", "1"
    )
    assert "layout_1" in printed
    assert "present" in printed
    assert "1 cm" in printed


def test_a_recording_needs_a_hand(tmp_path, capsys) -> None:
    scene = tmp_path / "air.toml"
    scene.write_text(SCENE, encoding="utf-8")
    line = rejected(capsys, "place", scene, "--recording", "pinching.jsonl", "--out", tmp_path)
    assert "[not_supported]" in line
