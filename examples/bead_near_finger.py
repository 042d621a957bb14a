"""A levitated bead 20 mm from a fingertip that points at it.

    python examples/bead_near_finger.py [FOLDER]

The bead floats between two boards that face each other, and the finger scatters the sound. Prints
the traps of a drive that considers the finger and of a drive that ignores it. Writes
bead_near_finger.png, a map of Gor'kov's potential around the bead, to FOLDER (by default the
current folder).
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import airtact as at

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
folder.mkdir(parents=True, exist_ok=True)

array = at.transducers.known_array(
    "opposed_sonicsurfaces"
)  # two boards that face each other along y
# The bead is at the origin; the distance to the fingertip is 28 mm minus the radius.
finger = at.sound_hard(at.capsule((0, 0.028, 0), (0.035, 0.063, 0), radius=8e-3, edge=2e-3))
scenes = {
    "considered": at.Scene(at.air(celsius=20.0), [finger]),
    "ignored": at.Scene(at.air(celsius=20.0)),
}
scene = scenes["considered"]
point = np.zeros((1, 3))

drives = {
    name: at.traps.hold(believed, array, point, axis=(0, 1, 0)) for name, believed in scenes.items()
}
for name, drive in drives.items():
    trap = at.traps.find(scene, array, drive, point)
    print(f"finger {name}: {at.traps.verdict(scene, array, drive, trap)[0]}")

x, y = np.meshgrid(np.linspace(-0.015, 0.03, 55), np.linspace(-0.015, 0.045, 73))
grid = np.stack([x.ravel(), y.ravel(), 0.0 * x.ravel()], axis=1)
# The potential can only be computed at some distance from the skin.
free = scene.depth(grid) < -0.7e-3
potential = np.full(len(grid), np.nan)
potential[free] = 1e9 * at.traps.potential(scene, array, drives["considered"], grid[free])
figure, axes = plt.subplots(figsize=(6, 6.5), layout="constrained")
levels = np.linspace(-250, 250, 21)
picture = axes.contourf(1e3 * x, 1e3 * y, potential.reshape(x.shape), levels, extend="both")
axes.contourf(1e3 * x, 1e3 * y, scene.depth(grid).reshape(x.shape), [0, 1], colors=["0.66"])
axes.plot(0, 0, "wo", fillstyle="none")
axes.set(title="A bead 20 mm from a fingertip", xlabel="x [mm]", ylabel="y [mm]", aspect="equal")
figure.colorbar(picture, ax=axes, label="Gor'kov's potential [nJ]")
figure.savefig(folder / "bead_near_finger.png", dpi=90)
