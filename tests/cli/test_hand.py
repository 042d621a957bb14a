"""A hand fitted to a cloud from the command line."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

import airtact as at
from airtact.cli import main
from airtact.hands.fitting.fit import EDGES
from airtact.workflows.hand import fit
from paths import HANDS
from references.rigged_hand import posed, rough, seen, turned_to_camera

CLOUD, LANDMARKS = str(HANDS / "seen_hand.ply"), str(HANDS / "seen_hand.json")


def test_a_cloud_gives_a_closed_skin_a_picture_and_how_sure_it_is(tmp_path: Path, capsys) -> None:
    file = tmp_path / "hand.ply"

    assert (
        main(
            ["hand", CLOUD, "--landmarks", LANDMARKS, "--camera", "0", "0", "0", "--out", str(file)]
        )
        == 0
    )

    said = capsys.readouterr().out
    assert "skin uncertain by" in said
    assert "points used" in said
    assert "mm, off by some" in said
    skin = trimesh.load(file)
    assert skin.is_watertight  # pyright: ignore[reportAttributeAccessIssue]
    assert file.with_suffix(".png").stat().st_size > 20_000


@pytest.mark.parametrize("edge", [None, 0.005])
def test_the_file_holds_the_skin_that_was_brought_to_the_points(
    tmp_path: Path, edge: float | None
) -> None:
    done = fit(Path(CLOUD), Path(LANDMARKS), tmp_path / "hand.ply", (0.0, 0.0, 0.0), edge)

    written = at.load_surface(tmp_path / "hand.ply")
    assert len(written.crossings) == 0
    points = done.fitted.points[~done.fitted.outliers]
    body = np.abs(done.hand.shape.depth(points))
    skin = np.abs(written.shape.depth(points))
    assert np.median(skin) < 0.8 * np.median(body)
    assert done.usual == pytest.approx(np.median(skin), abs=0.03e-3)
    for name, point in done.places.items():
        assert abs(written.shape.depth(point[None])[0]) < 0.1e-3, name
    middle = np.median(
        np.linalg.norm(
            written.vertices[written.triangles[:, 0]] - written.vertices[written.triangles[:, 1]],
            axis=1,
        )
    )
    assert middle == pytest.approx(
        0.5 * (edge or EDGES[0]), rel=0.25
    )  # curved panels, cut in four flat ones


def test_pads_that_the_camera_did_not_see_are_said_to_be_less_sure(tmp_path: Path) -> None:
    errors = []
    for palm in (True, False):
        true = turned_to_camera(posed("pinch"), 0, palm=palm)
        np.save(tmp_path / "cloud.npy", seen(true, 8))
        (tmp_path / "joints.json").write_text(
            json.dumps({"positions_m": rough(true.joints, 8).tolist(), "side": "right"})
        )
        done = fit(
            tmp_path / "cloud.npy", tmp_path / "joints.json", tmp_path / "hand.ply", (0.0, 0.0, 0.0)
        )
        errors.append(done.errors["index.pad"])
        off = np.linalg.norm(done.hand.joints[[8, 9]] - true.joints[[8, 9]], axis=1)
        assert np.sqrt(np.mean(off**2)) < 2.5 * done.errors["index.pad"]

    assert errors[1] > 1.2 * errors[0]


@pytest.mark.parametrize(
    ("options", "fault"),
    [
        (("--landmarks", LANDMARKS, "--gap", "0.01"), "options_clash"),
        (("--camera", "0", "0", "0"), "options_clash"),
        ((), "data_missing"),
    ],
)
def test_options_that_do_not_go_together_are_rejected(
    tmp_path: Path, capsys, options: tuple, fault: str
) -> None:
    assert main(["hand", CLOUD, *options, "--out", str(tmp_path / "hand.ply")]) == 2
    assert capsys.readouterr().err.endswith(f" [{fault}]\n")


def test_the_cloud_is_not_written_over(capsys) -> None:
    before = Path(CLOUD).read_bytes()

    assert main(["hand", CLOUD, "--landmarks", LANDMARKS, "--out", CLOUD]) == 2
    assert capsys.readouterr().err.endswith(" [would_overwrite]\n")
    assert Path(CLOUD).read_bytes() == before
