"""Clouds and landmarks from files."""

import json
from pathlib import Path

import numpy as np
import pytest

from airtact.conventions import InvalidInput
from airtact.hand.files import load_landmarks
from airtact.hand.fitting.cloud_files import load_cloud
from hand.hand_poses import HANDS

POINTS = np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]])


def test_a_cloud_is_read_from_each_kind_of_file(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", POINTS)
    np.savetxt(tmp_path / "a.xyz", POINTS)
    head = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    (tmp_path / "a.ply").write_text(head + "0.1 0.2 0.3\n0.4 0.5 0.6\n", encoding="utf-8")

    for ending in ("npy", "xyz", "ply"):
        np.testing.assert_allclose(load_cloud(tmp_path / f"a.{ending}"), POINTS, atol=1e-7)
    assert load_cloud(HANDS / "seen_hand.ply").shape == (7000, 3)


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("a.pcd", b"", "a.pcd ends in '.pcd', but clouds are read from 3 kinds"),
        ("a.ply", b"no ply", r"a.ply \(6 bytes\) cannot be read"),
        ("a.npy", b"no array", r"a.npy \(8 bytes\) cannot be read"),
    ],
)
def test_files_that_are_no_clouds_are_refused(tmp_path: Path, name: str, content: bytes, sentence: str) -> None:
    (tmp_path / name).write_bytes(content)

    with pytest.raises(InvalidInput, match=sentence):
        load_cloud(tmp_path / name)


def test_a_cloud_that_is_not_there_or_flat_is_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "flat.npy", POINTS[:, :2])

    with pytest.raises(InvalidInput, match="0 points were read"):
        load_cloud(tmp_path / "none.ply")
    with pytest.raises(InvalidInput, match=r"flat.npy: .*have shape \(2, 2\)"):
        load_cloud(tmp_path / "flat.npy")


def test_landmarks_are_read_with_their_side(tmp_path: Path) -> None:
    points, side = load_landmarks(HANDS / "seen_hand.json")
    swapped = json.loads((HANDS / "seen_hand.json").read_text(encoding="utf-8"))
    swapped["joints"].reverse()
    (tmp_path / "swapped.json").write_text(json.dumps(swapped), encoding="utf-8")

    assert points.shape == (25, 3)
    assert side == "right"
    with pytest.raises(InvalidInput, match=r"swapped.json: the 25 joints are not named in the order of WebXR"):
        load_landmarks(tmp_path / "swapped.json")
