"""How quickly a hand gets its skin, and how good it is whatever the fingers do.

Run ``PYTHONPATH=.:tests python benchmarks/hand.py [poses]``; with a number, so many random poses are made. 10,000 of
them take half an hour.
"""

import sys
import time
from collections.abc import Callable

import numpy as np

from airtact.scene.hand import hand_from_joints
from airtact.scene.hand_following import Followed
from airtact.scene.hand_hulls import Hulls
from airtact.scene.hand_meshing import Skin, even_skin
from airtact.scene.hand_parts import hand_hulls
from airtact.scene.joints import joints_of
from airtact.scene.topology import cone_volumes, edge_twins
from airtact.solvers.boundary_element import BoundaryElement
from scene.hand_poses import example, random_pose

WAVELENGTH = 343.1 / 40e3


def edge_for(accuracy: float) -> float:
    """Edge of the panels that a solve of this accuracy takes [m]."""
    return WAVELENGTH * np.sqrt(6 / BoundaryElement(accuracy).nodes_per_square_wavelength * 4 / np.sqrt(3))


def quickest(run: Callable[[], Skin | None], times: int = 5) -> tuple[float, Skin]:
    seconds = []
    for _ in range(times):
        began = time.perf_counter()
        skin = run()
        seconds.append(time.perf_counter() - began)
    assert skin is not None
    return min(seconds), skin


def told(what: str, hulls: Hulls, seconds: float, skin: Skin) -> None:
    off = np.abs(hulls.look(skin.vertices).distance).max()
    print(
        f"{what}: {1e3 * seconds:.0f} ms, {len(skin.triangles):,} triangles, smallest angle {skin.angles.min():.0f}°, "
        f"corners {1e6 * off:.2g} µm off the body"
    )


def two_fingers(spread: float) -> Hulls:
    """Thumb and forefinger of the paper, as round cones."""
    balls = [[-14, 0, 0, 8], [-28 - spread, -6, -45, 9.5], [14, 0, 0, 7.2], [28 + spread, 6, -45, 8.5]]
    return Hulls(1e-3 * np.array(balls), np.array([[0, 1, -1], [2, 3, -1]]), np.zeros((2, 2)), 1.0 - np.eye(2))


def times() -> None:
    fine, coarse = WAVELENGTH / 6, edge_for(0.03)
    fingers = two_fingers(0.0)
    seconds, skin = quickest(lambda: even_skin(fingers, fine))
    told("two fingers, edges of λ/6", fingers, seconds, skin)
    moved, before = two_fingers(5.0), Followed(fingers, {fine: skin})
    told("their next frame, 5 mm on", moved, *quickest(lambda: before.deformed(moved, fine)))
    joints, radii = example("pinch")
    hand = hand_from_joints(joints, radii).open_to(0.012)
    hulls = hand.shape.hulls
    seconds, skin = quickest(lambda: even_skin(hulls, coarse))
    told(f"hand, edges of {1e3 * coarse:.2f} mm as for 3 %", hulls, seconds, skin)
    later = hand.open_to(0.021)
    apart = np.linalg.norm(later.joints - hand.joints, axis=1).max()
    before = Followed(hulls, {coarse: skin})
    now = later.shape.hulls
    told(f"its next frame, {1e3 * apart:.1f} mm on", now, *quickest(lambda: before.deformed(now, coarse)))
    for name, build in (("hand of 3 mm", 3e-3), ("hand of 1.43 mm", fine)):
        told(name, hulls, *quickest(lambda build=build: even_skin(hulls, build), times=2))


def poses(count: int) -> None:
    rest, radii = example("relaxed")
    angles, off, touching, faults, seconds = [], 0.0, 0, 0, 0.0
    for seed in range(count):
        hulls, touches = hand_hulls(joints_of(random_pose(seed, rest)), radii)
        began = time.perf_counter()
        skin = even_skin(hulls, 7e-3)
        seconds += time.perf_counter() - began
        faults += edge_twins(skin.triangles).min() < 0 or cone_volumes(skin.vertices[skin.triangles]).sum() < 0
        angles.append(skin.angles.min())
        off = max(off, float(np.abs(hulls.look(skin.vertices).distance).max()))
        touching += bool(touches)
        if angles[-1] < 20:
            print(f"pose {seed}: smallest angle {angles[-1]:.1f}°", flush=True)
    share = 100 * np.mean(np.array(angles) >= 20)
    print(
        f"{count:,} poses, in {touching:,} of them skins touch: {faults} open or inside out, smallest angle at least "
        f"20° in {share:.2f} %, the smallest {min(angles):.1f}°, corners {1e6 * off:.2g} µm off the body at most, "
        f"{1e3 * seconds / count:.0f} ms each"
    )


if __name__ == "__main__":
    poses(int(sys.argv[1])) if len(sys.argv) > 1 else times()
