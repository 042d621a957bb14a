"""Time to find the contacts of a hand with three virtual objects.

    python -m benchmarks.touch

The skin of an open hand moves from frame to frame; its triangles stay. Medians of 500 frames.
"""

import time

import numpy as np

import airtact as at
from airtact.touch import Box, HalfSpace, Skin, TouchState, skin_of
from airtact.touch.finding import find


def live_skin(hand: at.Hand) -> Skin:
    """Skin of a hand with about 3,000 points, as a live loop has it."""
    mesh = hand.shape.skin(4.15e-3)
    fine = skin_of(hand)
    gradients = hand.shape.hulls.look(mesh.vertices).gradient
    nearest = np.linalg.norm(mesh.vertices[:, None] - fine.points[::4], axis=2).argmin(axis=1)
    return Skin(
        mesh.vertices,
        gradients / np.linalg.norm(gradients, axis=1, keepdims=True),
        np.full(len(mesh.vertices), hand.surface.area / len(mesh.vertices)),
        mesh.triangles,
        fine.places,
        fine.place[::4][nearest],
    )


def worlds(hand: at.Hand) -> dict[str, list[at.VirtualObject]]:
    """Three objects each: none touched, two fingers and the palm, nearly the whole hand."""
    index, outwards = hand.places["index.pad"]
    thumb, _ = hand.places["thumb.pad"]
    palm, normal = hand.places["palm"]
    ball = at.VirtualObject(at.sphere(15e-3, 3e-3, tuple(index + 13e-3 * outwards)), name="ball")
    box = at.VirtualObject(Box((0.02, 0.02, 0.02), tuple(thumb)), name="box")
    block = at.VirtualObject(Box((0.06, 0.06, 0.03), tuple(palm + 14e-3 * normal)), name="block")
    table = at.VirtualObject(HalfSpace(tuple(palm), tuple(-normal)), name="table")
    away = at.Pose.shift((0.3, 0.0, 0.0))
    return {
        "none touched": [thing.moved(away) for thing in (ball, box, block)],
        "thumb, index finger and palm": [ball, box, block],
        "also a plane through the hand": [ball, box, table],
    }


def measure(name: str, skin: Skin, objects: list[at.VirtualObject]) -> None:
    """Print the times of one skin with some objects."""
    state = TouchState(objects)
    finding = []
    updating = []
    for frame in range(500):
        moved = skin.moved(skin.points + 1e-6 * frame, skin.normals)
        begun = time.perf_counter()
        found = find(moved, objects)
        between = time.perf_counter()
        state.update(moved, frame / 60.0)
        finding.append(between - begun)
        updating.append(time.perf_counter() - between)
    print(
        f"{name}: {len(found.depths)} contacts; find {1e3 * np.median(finding):.2f} ms, "
        f"95 of 100 under {1e3 * np.quantile(finding, 0.95):.2f} ms; "
        f"with foci, hysteresis and ramps {1e3 * np.median(updating):.2f} ms"
    )


def main() -> None:
    """Print the times."""
    hand = at.load_hand(at.example("relaxed.json"))
    for skin in (live_skin(hand), skin_of(hand, longest_edge=10e-3)):
        print(f"{len(skin.points):,} skin points, 3 objects")
        for name, objects in worlds(hand).items():
            measure(name, skin, objects)


if __name__ == "__main__":
    main()
