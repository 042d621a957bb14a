"""From a scene file and values of its keys to a table and a page."""

import csv
import json
import re
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import airtact as at
from airtact.cli import main
from airtact.cli.sweep import grid_of
from airtact.setup.sweeping import frames_of, scene_points
from faults import raises_code

OPEN_AIR = """
medium = { celsius = 20.0 }
array = { layout = "flat_boards", rows = 1, columns = 1 }
foci = [{ point = [0.0, 0.0, 0.15] }, { point = [0.02, 0.0, 0.15] }]
"""

FINGERS = """
medium = { sound_speed = 343.1, density = 1.293 }
array = { layout = "surrounding_box" }
obstacles = [{ pinch = { gap = 0.012 } }]
foci = [{ at = "thumb.pad", offset = 2e-3 }, { at = "finger.pad", offset = 2e-3 }]
solver = { accuracy = 0.1 }
"""


@pytest.fixture
def open_air(tmp_path) -> Path:
    (tmp_path / "air.toml").write_text(OPEN_AIR, encoding="utf-8")
    return tmp_path / "air.toml"


def rows_of(folder: Path) -> list[dict[str, str]]:
    (file,) = folder.glob("*.csv")
    with file.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def test_a_grid_varies_its_last_path_fastest() -> None:
    assert grid_of(["a=1:2:2", "b=-1:0:2"]) == [{"a": a, "b": b} for a in (1, 2) for b in (-1, 0)]
    (values,) = {tuple(point["a"] for point in grid_of(["a=1:2:3"]))}
    assert values == (1.0, 1.5, 2.0)
    assert [point["a"] for point in grid_of(["a=5e-4:3e-3:6"])] == pytest.approx(
        np.linspace(5e-4, 3e-3, 6)
    )
    assert grid_of([]) == [{}]


@pytest.mark.parametrize(
    "words",
    ["a", "a=1:2", "a=1:2:0", "a=1:2:1", "a=x:2:3", "a=1:inf:3", "a=1:2:2.5", "a=1:2:2000000"],
)
def test_words_that_are_no_values_are_rejected(words) -> None:
    with pytest.raises(at.InvalidInput) as fault:
        grid_of([words])
    assert fault.value.code == "out_of_range"


def test_the_table_of_the_command_line(open_air, tmp_path, capsys) -> None:
    out = tmp_path / "out"
    command = [
        "sweep",
        str(open_air),
        "--vary",
        "foci[0].point[2]=0.1:0.2:3",
        "--vary",
        "medium.celsius=20:5000:2",
    ]
    command += ["--out", str(out), "--processes", "1", "--json"]
    assert main(command) == 0
    record = json.loads(capsys.readouterr().out)
    assert (record["points"], record["failed"]) == (6, 3)
    rows = rows_of(out)
    assert [row["foci[0].point[2]"] for row in rows] == ["0.1", "0.1", "0.15", "0.15", "0.2", "0.2"]
    assert [row["error"] for row in rows] == ["", "out_of_range"] * 3
    assert "5000" in rows[1]["sentence"]
    assert not rows[1]["weakest_Pa"]
    for row in rows[::2]:
        setup = at.read_scene(open_air, {"foci[0].point[2]": float(row["foci[0].point[2]"])})
        true = np.abs(
            setup.synthesise(matrix(setup), setup.target).amplitudes @ matrix(setup).matrix.T
        )
        assert [float(row[f"focus_{index}_Pa"]) for index in (1, 2)] == pytest.approx(
            true, rel=1e-5
        )
        assert (row["gain"], row["unknowns"]) == ("", "0")
    page = (out / "sweep.html").read_text(encoding="utf-8")
    assert re.search(r"<b>3</b><span>failed points", page)

    before = (out / "sweep.csv").read_bytes()
    assert main(command[:-1]) == 0
    assert (out / "sweep.csv").read_bytes() == before
    assert "100% of 6 points, 3 failed" in capsys.readouterr().err


def matrix(setup):
    return at.open_air_matrix(setup.scene, setup.array, setup.target)


def test_what_the_foci_get_is_what_a_more_accurate_solution_gives(tmp_path) -> None:
    (tmp_path / "fingers.toml").write_text(FINGERS, encoding="utf-8")
    row = scene_points(tmp_path / "fingers.toml")({"pinch.gap": 0.014})
    setup = at.read_scene(tmp_path / "fingers.toml", {"pinch.gap": 0.014})
    aware = at.transfer_matrix(
        at.BoundaryElement(accuracy=0.03).radiate(setup.scene, setup.target.beacons()), setup.array
    )
    drives = [at.best(one, setup.target) for one in (aware, matrix(setup))]
    pressures = [np.abs(aware.pressure(one)) / np.abs(one.amplitudes).max() for one in drives]
    assert [row["thumb.pad_Pa"], row["finger.pad_Pa"]] == pytest.approx(pressures[0], rel=0.05)
    assert row["gain"] == pytest.approx(pressures[0].min() / pressures[1].min(), rel=0.05)
    assert row["weakest_Pa"] == min(row["thumb.pad_Pa"], row["finger.pad_Pa"])
    assert row["unknowns"] > 500


def test_frames_of_a_recording_take_the_place_of_the_hand(tmp_path) -> None:
    scene, recording = at.example("live_pinch"), at.example("pinching.jsonl")
    points = frames_of(scene, recording, tmp_path)
    assert len(points) > 10
    setup = at.read_scene(scene, points[5] | {"foci[0].offset": 3e-3})
    number = int(points[5]["obstacles[0].hand"].split("_")[-2])
    (seen,) = [
        frame for frame in at.hands.load_recording(recording).frames if frame.sequence == number
    ]
    assert setup.hands[0].joints == pytest.approx(seen.hand().joints, abs=1e-9)
    assert setup.hands[0].radii == pytest.approx(at.read_scene(scene).hands[0].radii)


def test_a_result_follows_from_all_files_of_a_scene(tmp_path) -> None:
    folder = tmp_path / "hands"
    folder.mkdir()
    pose = at.example("pinch.json").read_bytes()
    (folder / "pinch.json").write_bytes(pose)
    scene = tmp_path / "scene.toml"
    scene.write_bytes(at.example("pinch_pose").read_bytes())
    before = scene_points(scene).content
    assert len(before) == 2
    (folder / "pinch.json").write_bytes(pose.replace(b"0.0", b"0.1", 1))
    assert scene_points(scene).content[0] == before[0]
    assert scene_points(scene).content[1] != before[1]
    with raises_code("unknown_key"):
        frames_of(at.example("pinch"), at.example("pinching.jsonl"), tmp_path)


@pytest.mark.parametrize(
    ("varied", "code"),
    [
        (["foci[7].offset=0:1:2"], "unknown_key"),
        (["foci[0].ofset=0:1:2"], "unknown_key"),
        (["medium.celsius=0:1:2", "medium.celsius=0:1:2"], "given_twice"),
        (["foci[0].point[0]=0:0.01:2", "foci[00].point[0]=0.02:0.02:1"], "given_twice"),
        (["time=0:1:2"], "unknown_key"),
        (["frame=0:1:2"], "unknown_key"),
        (["medium.celsius=4000:5000:2"], "out_of_range"),
        ([], "data_missing"),
    ],
)
def test_a_sweep_that_cannot_be_begins_nothing(varied, code, open_air, tmp_path, capsys) -> None:
    options = [word for words in varied for word in ("--vary", words)]
    assert main(["sweep", str(open_air), *options, "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.endswith(f"[{code}]\n")
    assert not (tmp_path / "out").exists()


def test_a_cluster_gives_the_same_rows(open_air) -> None:
    from distributed import Client, LocalCluster

    points = [{"foci[0].point[2]": z} for z in (0.1, 0.15, 0.2)]
    with (
        LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster) as client,
    ):
        rows = at.sweep(open_air, points, client.get_executor())
    with ThreadPoolExecutor(1) as threads:
        assert at.sweep(at.read_scene(open_air), points, threads) == rows
