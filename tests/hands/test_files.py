"""Read point clouds and landmarks from files."""

import json
from pathlib import Path

import numpy as np
import pytest

import airtact as at
from airtact.hands import load_cloud, load_landmarks
from faults import raises_code
from paths import HANDS

POINTS = np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]])


def test_a_cloud_is_read_from_each_kind_of_file(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "a.xyz", POINTS)
    head = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    (tmp_path / "a.ply").write_text(head + "0.1 0.2 0.3\n0.4 0.5 0.6\n", encoding="utf-8")

    for ending in ("xyz", "ply"):
        np.testing.assert_allclose(load_cloud(tmp_path / f"a.{ending}"), POINTS, atol=1e-7)
    assert load_cloud(HANDS / "seen_hand.ply").shape == (7000, 3)


@pytest.mark.parametrize(
    ("name", "content", "code", "detail"),
    [
        ("a.pcd", b"", "unknown_format", ".pcd"),
        ("a.ply", b"no ply", "file_unreadable", "a.ply"),
        ("a.npy", b"no cloud", "unknown_format", ".npy"),
    ],
)
def test_files_that_are_no_clouds_are_rejected(
    tmp_path: Path, name: str, content: bytes, code: str, detail: str
) -> None:
    (tmp_path / name).write_bytes(content)

    with raises_code(code, detail):
        load_cloud(tmp_path / name)


def test_landmarks_are_read_with_their_side(tmp_path: Path) -> None:
    points, side = load_landmarks(HANDS / "seen_hand.json")
    swapped = json.loads((HANDS / "seen_hand.json").read_text(encoding="utf-8"))
    swapped["joints"].reverse()
    (tmp_path / "swapped.json").write_text(json.dumps(swapped), encoding="utf-8")

    assert points.shape == (25, 3)
    assert side == "right"
    with raises_code("hand_implausible", "swapped.json", "25"):
        load_landmarks(tmp_path / "swapped.json")


def test_what_is_not_a_pose_is_named_once_with_what_to_use(tmp_path: Path) -> None:
    with raises_code("unknown_format", 'surface = "hand.glb"', "load_rigged_hand"):
        at.load_hand(tmp_path / "hand.glb")
    missing = tmp_path / "relaxed.json"
    with raises_code("file_missing", str(at.example("relaxed.json"))) as fault:
        at.load_hand(missing)
    assert str(fault.value).startswith(f"the file {missing} does not exist. ")
