"""Focal pressure with the fitted hand over that with the true hand, pinch.

The reference is the GLB hand and two other builds of it, in a pinch, seen by a depth camera from
one side. One drive is made with the hand that was fitted to this, aimed 0.5 mm off the pads where
that hand has them; the other with the true hand, aimed 0.5 mm off its skin at the positions nearest
to these pads. Both are time reversals of one energy on panels for 0.1, and a verification solution
evaluates both on the true hand, at the second one's foci. The hand is fitted to one frame by
itself, and to the last frame of a sequence in which it closes and turns, so that its sizes are
learned. Run ``python -m benchmarks.fitted_focus [views [builds]]``, with so many
views of the palm's side of each hand and one of its back. The fit was never tuned on the build
``child``.
"""

import sys

import numpy as np

import airtact as at
from references.rigged_hand import BUILDS, Rigged, posed, rough, seen, turned_to_camera

LEARNED_FRAMES = 8  # later frames keep the sizes
OFF = 0.5e-3
WIDER = 1.6
"""How many times as far off as in the paper's box the boards stand, so that the whole hand fits."""

CAMERA = np.zeros(3)


def transfer_of(
    surface: at.Surface, foci: np.ndarray, array: at.PhasedArray, accuracy: float
) -> np.ndarray:
    scene = at.Scene(at.air(celsius=20.0), [at.sound_hard(surface)])
    field = at.BoundaryElement(accuracy).radiate(scene, at.Target(foci).beacons())
    return at.transfer_matrix(field, array).matrix


def pressures(transfer: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Pressures at two foci of a time reversal of energy 1."""
    drive = np.conj(transfer).sum(axis=0)
    return np.abs(reference @ (drive / np.linalg.norm(drive)))


def fits(build: str, view: int, palm: bool) -> tuple[Rigged, list[at.hands.FittedHand]]:
    """Find the true hand, and the ones fitted to one frame and to a sequence that ends with it."""
    before = None
    for frame in range(LEARNED_FRAMES + 1):
        share = frame / LEARNED_FRAMES
        true = turned_to_camera(posed("pinch", share, build), view, 15.0 + 20.0 * share, palm)
        cloud, landmarks = seen(true, 100 * view + frame), rough(true.joints, 100 * view + frame)
        before = at.fit_hand(cloud, landmarks, "right", CAMERA, before)
    assert before is not None
    return true, [at.fit_hand(cloud, landmarks, "right", CAMERA), before]


def shares(build: str, view: int, palm: bool) -> list[float]:
    true, fitted = fits(build, view, palm)
    skin = at.Surface(true.vertices, true.triangles)
    pads = [[hand.place(name) for name in ("thumb.pad", "index.pad")] for hand in fitted]
    foci = at.acoustics.onto_surface(
        np.array([point for pair in pads for point, _ in pair]), skin, offset=OFF
    )
    box = at.surrounding_box()
    middle = 0.5 * (true.vertices.min(axis=0) + true.vertices.max(axis=0))
    array = at.PhasedArray(WIDER * box.positions + middle, box.normals, box.element)
    reference, best = transfer_of(skin, foci, array, 0.05), transfer_of(skin, foci, array, 0.1)
    found = []
    for index, (hand, pair) in enumerate(zip(fitted, pads, strict=True)):
        own = slice(2 * index, 2 * index + 2)
        aimed = np.array([point + OFF * normal for point, normal in pair])
        with_fitted = pressures(transfer_of(hand.surface, aimed, array, 0.1), reference[own])
        with_true = pressures(best[own], reference[own])
        off = ", ".join(f"{1e3 * x:.1f}" for x in np.linalg.norm(aimed - foci[own], axis=1))
        found.append(float(with_fitted.mean() / with_true.mean()))
        ratios = ", ".join(f"{share:.2f}" for share in with_fitted / with_true)
        which = f"{build}, {'palm' if palm else 'back'} seen, view {view}, {('one frame', 'sequence')[index]}"
        print(f"{which}: {found[-1]:.2f} (thumb, index: {ratios}; aimed {off} mm off)", flush=True)
    return found


if __name__ == "__main__":
    views = int(sys.argv[1]) if len(sys.argv) > 1 else 1
    builds = sys.argv[2].split(",") if len(sys.argv) > 2 else list(BUILDS)
    for palm in (True, False):
        all_of = np.array(
            [shares(build, view, palm) for build in builds for view in range(views if palm else 1)]
        )
        for which, column in zip(("one frame", "sequence"), all_of.T, strict=True):
            print(
                f"{'palm' if palm else 'back'} seen, {which}: {column.mean():.2f} in the mean of {len(column)}, "
                f"{column.min():.2f} to {column.max():.2f}"
            )
