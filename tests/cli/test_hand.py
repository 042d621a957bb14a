"""A hand fitted to a cloud from the command line."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

import airtact as at
from airtact.cli import main
from paths import HANDS

CLOUD, LANDMARKS = str(HANDS / "seen_hand.ply"), str(HANDS / "seen_hand.json")


@pytest.fixture(scope="module")
def fitted():
    points = at.hands.load_cloud(Path(CLOUD))
    joints, side = at.hands.load_landmarks(Path(LANDMARKS))
    return at.fit_hand(points, joints, side, np.zeros(3))


@pytest.mark.parametrize("edge", [None, 0.005])
def test_the_file_holds_the_closed_skin_that_was_brought_to_the_points(
    tmp_path: Path, edge: float | None, fitted, capsys
) -> None:
    words = ["hand", CLOUD, "--landmarks", LANDMARKS, "--camera", "0", "0", "0"]
    words += [] if edge is None else ["--edge", str(edge)]
    file = tmp_path / "hand.ply"
    assert main([*words, "--out", str(file)]) == 0
    assert "standard deviation of the joints" in capsys.readouterr().out
    assert file.with_suffix(".png").stat().st_size > 20_000
    skin = trimesh.load(file)
    assert skin.is_watertight  # pyright: ignore[reportAttributeAccessIssue]
    written = at.load_surface(file)
    assert len(written.crossings) == 0
    points = fitted.points[~fitted.outliers]
    body = np.abs(fitted.hand.shape.depth(points))
    assert np.median(np.abs(written.shape.depth(points))) < 0.8 * np.median(body)
    corners = written.vertices[written.triangles]
    middle = np.median(np.linalg.norm(corners[:, 0] - corners[:, 1], axis=1))
    # Curved panels are cut in four flat ones.
    assert middle == pytest.approx(0.5 * (edge or 3.5e-3), rel=0.25)


@pytest.mark.parametrize(
    ("options", "fault"),
    [
        (("--landmarks", LANDMARKS, "--gap", "0.01"), "options_clash"),
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
