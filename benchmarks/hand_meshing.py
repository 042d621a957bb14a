"""Times to mesh a hand, and the quality of its mesh in random poses.

Run ``python -m benchmarks.hand_meshing [poses [record.jsonl]]``; a number makes
so many random poses. 10,000 of them take half an hour; those in the record are not made again.
"""

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.geometry.mesh.triangles import cone_volumes, edge_twins, shells
from airtact.hands.body import Hulls, hand_hulls
from airtact.hands.hand import hand_from_joints
from airtact.hands.joints import joints_of
from airtact.hands.shape import deformed
from airtact.hands.skin_mesh import HandMesh, even_skin
from references.hand_poses import example, random_pose

WAVELENGTH = 343.1 / 40e3


def edge_for(accuracy: float) -> float:
    """Edge of the panels that a solve of this accuracy takes [m]."""
    return WAVELENGTH * np.sqrt(
        6 / BoundaryElement(accuracy).nodes_per_square_wavelength * 4 / np.sqrt(3)
    )


def quickest(run: Callable[[], HandMesh | None], times: int = 5) -> tuple[float, HandMesh]:
    seconds = []
    for _ in range(times):
        began = time.perf_counter()
        skin = run()
        seconds.append(time.perf_counter() - began)
    assert skin is not None
    return min(seconds), skin


def report(what: str, hulls: Hulls, seconds: float, skin: HandMesh) -> None:
    off = np.abs(hulls.look(skin.vertices).distance).max()
    print(
        f"{what}: {1e3 * seconds:.0f} ms, {len(skin.triangles):,} triangles, smallest angle {skin.angles.min():.0f}°, "
        f"corners {1e6 * off:.2g} µm off the body"
    )


def two_fingers(spread: float) -> Hulls:
    """Thumb and forefinger of the paper, as round cones."""
    balls = [
        [-14, 0, 0, 8],
        [-28 - spread, -6, -45, 9.5],
        [14, 0, 0, 7.2],
        [28 + spread, 6, -45, 8.5],
    ]
    return Hulls(
        1e-3 * np.array(balls),
        np.array([[0, 1, -1], [2, 3, -1]]),
        np.zeros((2, 2)),
        1.0 - np.eye(2),
    )


def times() -> None:
    fine, coarse = WAVELENGTH / 6, edge_for(0.03)
    fingers = two_fingers(0.0)
    seconds, skin = quickest(lambda: even_skin(fingers, fine))
    report("two fingers, edges of λ/6", fingers, seconds, skin)
    moved = two_fingers(5.0)
    report(
        "their next frame, 5 mm on", moved, *quickest(lambda: deformed(fingers, skin, moved, fine))
    )
    joints, radii = example("pinch")
    hand = hand_from_joints(joints, radii).open_to(0.012)
    hulls = hand.shape.hulls
    seconds, skin = quickest(lambda: even_skin(hulls, coarse))
    report(f"hand, edges of {1e3 * coarse:.2f} mm as for 3 %", hulls, seconds, skin)
    later = hand.open_to(0.021)
    apart = np.linalg.norm(later.joints - hand.joints, axis=1).max()
    now = later.shape.hulls
    report(
        f"its next frame, {1e3 * apart:.1f} mm on",
        now,
        *quickest(lambda: deformed(hulls, skin, now, coarse)),
    )
    for name, build in (("hand of 3 mm", 3e-3), ("hand of 1.43 mm", fine)):
        report(name, hulls, *quickest(lambda build=build: even_skin(hulls, build), times=2))


def poses(count: int, record: Path | None) -> None:
    lines = record.read_text().splitlines() if record is not None and record.exists() else []
    rows = {row["pose"]: row for row in map(json.loads, lines) if row["pose"] < count}
    for seed in range(count):
        if seed in rows:
            continue
        rows[seed] = row = one_pose(seed)
        if record is not None:
            with record.open("a") as file:
                file.write(json.dumps(row) + "\n")
        if row["angle"] < 20 or row["faulty"]:
            print(
                f"pose {seed}: smallest angle {row['angle']:.1f}°{', faulty' * row['faulty']}",
                flush=True,
            )
    angles = np.array([row["angle"] for row in rows.values()])
    touching, faulty = (sum(row[key] for row in rows.values()) for key in ("touching", "faulty"))
    off, seconds = (
        max(row["off"] for row in rows.values()),
        [row["seconds"] for row in rows.values()],
    )
    print(
        f"{count:,} poses, in {touching:,} of them skins touch: {faulty} open, in pieces or inside out, smallest angle "
        f"at least 20° in {100 * np.mean(angles >= 20):.2f} %, the smallest {angles.min():.2f}°, corners "
        f"{1e6 * off:.2g} µm off the body at most, {1e3 * np.mean(seconds):.0f} ms of processor time each"
    )


def one_pose(seed: int) -> dict[str, float | bool]:
    rest, radii = example("relaxed")
    hulls, touches = hand_hulls(joints_of(random_pose(seed, rest)), radii)
    began = time.process_time()
    skin = even_skin(hulls, 7e-3)
    seconds = time.process_time() - began
    opened, pieces = edge_twins(skin.triangles).min() < 0, shells(skin.triangles).max() > 0
    inside_out = cone_volumes(skin.vertices[skin.triangles]).sum() < 0
    return {
        "pose": seed,
        "angle": float(skin.angles.min()),
        "faulty": bool(opened or pieces or inside_out),
        "touching": bool(touches),
        "off": float(np.abs(hulls.look(skin.vertices).distance).max()),
        "seconds": seconds,
    }


if __name__ == "__main__":
    if len(sys.argv) > 1:
        poses(int(sys.argv[1]), Path(sys.argv[2]) if len(sys.argv) > 2 else None)
    else:
        times()
