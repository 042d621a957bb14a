"""What a focus loses when the hand is a fitted one: its pressure over that of a drive made with the true hand.

Truth is the GLB hand in a pinch, seen from one side. Both drives, of one energy, are judged on the true hand by a finer
solution at two foci 0.5 mm off its pads; the fitted hand aims at its own. Run ``PYTHONPATH=.:tests python
benchmarks/fitted_focus.py [views]``.
"""

import sys

import numpy as np

import airtact as at
from scene.rigged_hand import posed, rough, seen, turned_to_camera

OFF = 0.5e-3
WIDER = 1.6
"""How many times as far off as in the paper's box the boards stand, so that the whole hand fits."""


def heard(surface: at.Surface, foci: np.ndarray, array: at.PhasedArray, accuracy: float) -> at.TransferMatrix:
    scene = at.Scene(at.air(celsius=20.0), [at.sound_hard(surface)])
    field = at.BoundaryElement(accuracy).radiate(scene, at.Target(foci).beacons())
    return at.transfer_matrix(field, array)


def ratio(view: int) -> float:
    true = turned_to_camera(posed("pinch"), view)
    skin = at.Surface(true.vertices, true.triangles)
    fitted = at.fit_hand(seen(true, view), rough(true.joints, view), "right", np.zeros(3))
    pads = [fitted.hand.place(name) for name in ("thumb.pad", "index.pad")]
    aimed = np.array([point + OFF * normal for point, normal in pads])
    foci = at.onto_skin(np.array([point for point, _ in pads]), skin, offset=OFF)
    box = at.surrounding_box()
    middle = 0.5 * (true.vertices.min(axis=0) + true.vertices.max(axis=0))
    array = at.PhasedArray(WIDER * box.positions + middle, box.normals, box.element)
    judge = heard(skin, foci, array, 0.05).matrix
    pressures = []
    for transfer, points in ((heard(fitted.surface, aimed, array, 0.1), aimed), (heard(skin, foci, array, 0.1), foci)):
        drive = at.time_reversal(transfer, at.Target(points)).amplitudes
        pressures.append(np.abs(judge @ (drive / np.linalg.norm(drive))))
    told = ", ".join(f"{share:.2f}" for share in pressures[0] / pressures[1])
    share = float(pressures[0].mean() / pressures[1].mean())
    print(f"view {view}: {share:.2f} of the pressure (thumb, index: {told})", flush=True)
    return share


if __name__ == "__main__":
    shares = [ratio(view) for view in range(int(sys.argv[1]) if len(sys.argv) > 1 else 1)]
    print(f"{len(shares)} views: {np.mean(shares):.2f} in the mean, the worst {min(shares):.2f}")
