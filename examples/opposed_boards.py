"""Four beads between two boards that face each other.

    python examples/opposed_boards.py [FOLDER]

Prints the position and the stiffness of each trap. Writes opposed_boards.png, a map of Gor'kov's
potential in the plane of the beads, to FOLDER (by default the current folder).
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
scene = at.Scene(at.air(celsius=20.0))
places = 1e-3 * np.array([[-18, 8, 0], [-6, -4, 0], [6, 10, 0], [18, 0, 0]])

drive = at.traps.hold(scene, array, places, axis=(0, 1, 0))
traps = at.traps.find(scene, array, drive, places)
for verdict in at.traps.verdict(scene, array, drive, traps):
    print(verdict)

x, y = np.meshgrid(np.linspace(-0.026, 0.026, 53), np.linspace(-0.014, 0.02, 35))
grid = np.stack([x.ravel(), y.ravel(), 0.0 * x.ravel()], axis=1)
potential = 1e9 * at.traps.potential(scene, array, drive, grid).reshape(x.shape)
figure, axes = plt.subplots(figsize=(8, 5), layout="constrained")
picture = axes.contourf(1e3 * x, 1e3 * y, potential, levels=20)
axes.plot(*1e3 * traps[:, :2].T, "wo", fillstyle="none")
axes.set(title="Four beads", xlabel="x [mm]", ylabel="y [mm]", aspect="equal")
figure.colorbar(picture, ax=axes, label="Gor'kov's potential [nJ]", location="bottom")
figure.savefig(folder / "opposed_boards.png", dpi=90)
