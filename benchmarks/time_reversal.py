"""What echoes focus on for two fingers, with no knowledge of them: pressures at the foci, and a picture.

Run ``python benchmarks/time_reversal.py [PICTURE]``, about half a minute on two idle cores. The
pinch stands in the box of 996 monopoles; codes are from noise-free echoes by its scattering matrix,
which is their best case, and pressures from boundary elements. All drives have every element at
full scale, except the first, which may have less.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import airtact as at
from airtact.sensing import dort, hadamard_codes, iterate_time_reversal, random_codes

PICTURE = Path(__file__).resolve().parents[1] / "docs/time-reversal.png"
AIR = at.Medium(sound_speed=343.1, density=1.293)


def drives(array: at.PhasedArray, scene: at.Scene, foci: np.ndarray) -> dict[str, np.ndarray]:
    """Codes (996,) by name."""
    target, solver = at.Target(foci), at.BoundaryElement(accuracy=0.02, estimate=False)
    transfer = at.transfer_matrix(solver.radiate(scene, target.beacons()), array)
    scattering = at.scattering_matrix(solver, scene)

    def echo(code: np.ndarray) -> np.ndarray:
        return at.simulate_echoes(scattering, scene, array, code).pressures

    every = dort(at.simulate_echoes(scattering, scene, array, hadamard_codes(996)), 12)
    print(
        "singular values over the first:",
        np.round(every.values[:12], 2),
        f"{(every.values > 0.5).sum()} above half",
    )
    found = {
        "known hand": at.max_min(transfer, target).amplitudes,
        "distances": at.focus_by_distance(array, target, AIR, scene.frequency).amplitudes,
        "time reversal, 10 times": iterate_time_reversal(echo, random_codes(996, 1)[:, 0], 10),
    }
    for vector in range(12):
        found[f"DORT, vector {vector + 1}"] = every.codes[:, vector]
    for name in list(found)[1:]:
        found[name] = np.exp(1j * np.angle(found[name]))
    for name, code in found.items():
        pressures = np.abs(transfer.matrix @ code)
        print(f"{name}: {pressures[0]:,.0f} and {pressures[1]:,.0f} Pa at the foci", flush=True)
    return found


def main() -> None:
    fingers = at.pinch(gap=0.012)
    foci = fingers.foci()
    scene = at.Scene(AIR, [at.sound_hard(surface) for surface in fingers.surfaces], frequency=40e3)
    array = at.surrounding_box(at.monopole())
    found = drives(array, scene, foci)
    shown = ["known hand", "distances", "DORT, vector 1", "DORT, vector 2"]
    codes = np.stack([found[name] for name in shown], axis=1)
    sources = at.Monopoles(array.positions, array.element.sensitivity * codes)
    field = at.BoundaryElement(accuracy=0.03).radiate(scene, sources)
    figure, axes = plt.subplots(2, 2, figsize=(9, 8), layout="constrained")
    for column, (name, ax) in enumerate(zip(shown, axes.flat, strict=True)):
        at.plot.field(field, at.Target(foci), drive=column, plane="xz", ax=ax)
        ax.set_title(name)
    figure.savefig(sys.argv[1] if len(sys.argv) > 1 else PICTURE, dpi=80)


if __name__ == "__main__":
    main()
