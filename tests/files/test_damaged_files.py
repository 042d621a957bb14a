"""Files of every kind with random damage: each is read, or rejected in one short sentence, without a warning."""

import random
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import trimesh

import airtact as at
from airtact.acoustics.store import name_of, packed, unpacked
from damage import damaged, read_or_rejected, seeds
from references.motions import still

AIR = at.Medium(343.1, 1.293, 0.14)
BALL = at.Scene(AIR, [at.sound_hard(at.sphere(3e-3, 2e-3))])
SOURCE = at.Monopoles(np.array([[0.0, 0.0, 0.012]]), np.ones(1))
OPEN_AIR = at.Scene(AIR, [])
FAR = at.Monopoles(np.array([[0.1, 0.1, 9.0]]), np.ones(1))
DRAWING = """<?xml version="1.0"?><!DOCTYPE svg [<!ENTITY a "3">]>
<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" viewBox="0 0 10 10">
<style>path { stroke: red }</style>
<g transform="rotate(30) scale(2, 1)"><path d="M 0 0 L 1 0 C 1 5 5 1 0 1 Z" transform="matrix(1 0 1 1 2 3)"/></g>
<circle cx="3" cy="&a;" r="1"/><ellipse rx="2" ry="1"/><rect width="2" height="1" rx="0.2"/>
<polygon points="0,0 1,0 1,1"/><path d="m1,1a1 2 30 0 1 3 0q1 1 2 2t3 1s1 1 2 1h1v1"/></svg>"""


def whole_drives(folder: Path) -> None:
    draw = np.random.default_rng(0)
    drives = draw.uniform(0, 1, (3, 12)) * np.exp(2j * np.pi * draw.uniform(size=(3, 12)))
    array, modulation = (
        at.transducers.board_array("nano16"),
        at.transducers.AmplitudeModulation(200.0, 1.0),
    )
    for ending in ("h5",):
        at.Drive(drives[0]).save(folder / f"drive.{ending}", array, OPEN_AIR, modulation=modulation)
        at.drives.Sequence(drives, 1000.0).save(folder / f"sequence.{ending}", array)


def whole_recordings(folder: Path) -> None:
    cloud = np.random.default_rng(0).normal(scale=0.03, size=(20, 3))
    frames = [still(0), still(1, landmarks=None), still(2, cloud=cloud), still(3)]
    at.hands.save_recording(folder / "hand.jsonl", frames)


def whole_clouds(folder: Path) -> None:
    points = np.random.default_rng(0).normal(scale=0.03, size=(50, 3)).round(6)
    trimesh.PointCloud(points).export(folder / "cloud.ply")
    np.savetxt(folder / "cloud.xyz", points)


def whole_tables(folder: Path) -> None:
    lines = [
        f"{x},{y},{z},{0.1 * x + y}-{z + 1}i" for x in range(4) for y in range(3) for z in range(3)
    ]
    (folder / "field.csv").write_text("\n".join(["% a comment", "% x, y, z, pressure", *lines]))
    rows = [line.replace("i", "").replace("-", ",") for line in lines]
    (folder / "scan.csv").write_text("\n".join(["x,y,z,pressure,phase", *rows]))
    (folder / "gains.csv").write_text("element,gain,phase\n0,0.9,0.1\n3,1.1,-0.2\n7,0,0\n")


def table(path: Path) -> None:
    head = path.read_bytes()[:200]
    if b"phase" in head and b"gain" not in head:
        at.evaluation.load_scan(path)
    elif b"gain" in head:
        at.transducers.load_calibration(path, 8)
    else:
        at.acoustics.load_samples(path, OPEN_AIR, FAR, "e^{-iωt}", 1e-3)


def whole_poses(folder: Path) -> None:
    (folder / "pose.json").write_bytes(at.example("pinch.json").read_bytes())


def whole_drawings(folder: Path) -> None:
    (folder / "drawing.svg").write_text(DRAWING)


SOLVER = at.BoundaryElement(accuracy=0.3)


def whole_entries(folder: Path) -> None:
    key = name_of(SOLVER, BALL, SOURCE)
    (folder / "entry.field").write_bytes(packed(SOLVER.radiate(BALL, SOURCE), key))


def entry(path: Path) -> None:
    """Read an entry; a damaged one is left aside and solved again."""
    unpacked(path.read_bytes(), name_of(SOLVER, BALL, SOURCE), BALL, SOURCE)


KINDS = {
    "drives": (whole_drives, at.load_drive),
    "recordings": (whole_recordings, at.hands.load_recording),
    "recordings with gaps": (whole_recordings, partial(at.hands.load_recording, leave_out=True)),
    "clouds": (whole_clouds, at.hands.load_cloud),
    "tables": (whole_tables, table),
    "poses": (whole_poses, at.load_hand),
    "drawings": (
        whole_drawings,
        lambda path: at.acoustics.svg_path(path, width=0.05, spacing=3e-3),
    ),
    "entries of a store": (whole_entries, entry),
}


@pytest.fixture(scope="module")
def whole_files(tmp_path_factory) -> dict[str, list[tuple[str, bytes]]]:
    found = {}
    for name, (write, _) in KINDS.items():
        folder = tmp_path_factory.mktemp("whole")
        write(folder)
        found[name] = [(path.suffix, path.read_bytes()) for path in sorted(folder.iterdir())]
    return found


@pytest.mark.parametrize("kind", KINDS)
def test_whole_files_are_read(kind, whole_files, tmp_path):
    for suffix, raw in whole_files[kind]:
        if kind != "tables":  # each reader takes one of them
            (tmp_path / f"whole{suffix}").write_bytes(raw)
            KINDS[kind][1](tmp_path / f"whole{suffix}")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("batch", seeds(200, 1000))
def test_a_damaged_file_is_read_or_rejected_in_one_short_sentence(
    batch, kind, whole_files, tmp_path
):
    for seed in batch:
        draw = random.Random(seed)
        suffix, raw = draw.choice(whole_files[kind])
        read_or_rejected(KINDS[kind][1], tmp_path / f"one{suffix}", damaged(raw, draw))
