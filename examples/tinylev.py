"""Traps for a bead in the levitator TinyLev.

    python examples/tinylev.py [FOLDER]

Two caps with 36 transducers each face each other. Prints the traps near the middle for both caps
in phase and in opposite phase. Writes tinylev.png, a map of Gor'kov's potential, to FOLDER (by
default the current folder).
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import airtact as at

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
folder.mkdir(parents=True, exist_ok=True)

array = at.transducers.known_array("tinylev", at.piston(4.5e-3, sensitivity=3.4))
scene = at.Scene(at.air(celsius=20.0))

in_phase = at.Drive(np.ones(len(array), dtype=complex))
drives = {"in phase": in_phase, "opposed": at.traps.signature(array, in_phase, "twin", (0, 1, 0))}
starts = {"in phase": [-2.3e-3, 2.3e-3], "opposed": [-4.7e-3, 0.0, 4.7e-3]}

figure, panels = plt.subplots(1, 2, figsize=(9, 5), sharey=True, layout="constrained")
x, y = np.meshgrid(np.linspace(-6e-3, 6e-3, 61), np.linspace(-8e-3, 8e-3, 81))
points = np.stack([x.ravel(), y.ravel(), 0.0 * x.ravel()], axis=1)
for axes, (name, drive) in zip(panels, drives.items(), strict=True):
    near = np.array([[0.0, height, 0.0] for height in starts[name]])
    traps = at.traps.find(scene, array, drive, near)
    print(f"caps {name}:")
    for verdict in at.traps.verdict(scene, array, drive, traps):
        print(f"  {verdict}")
    potential = at.traps.potential(scene, array, drive, points).reshape(x.shape)
    picture = axes.contourf(1e3 * x, 1e3 * y, 1e9 * potential, levels=np.linspace(-45, 45, 19))
    axes.plot(1e3 * traps[:, 0], 1e3 * traps[:, 1], "wo", fillstyle="none")
    axes.set(title=f"Caps {name}", xlabel="x [mm]", aspect="equal")
panels[0].set_ylabel("y [mm]")
figure.colorbar(picture, ax=panels, label="Gor'kov's potential [nJ]")
figure.savefig(folder / "tinylev.png", dpi=90)
