"""A finger above a table that reflects the sound.

    python examples/finger_over_table.py [FOLDER]

The finger is 30 mm above the table, and the board stands on the table beside it. Requests 1,000 Pa
at the finger. Prints the pressure produced by this drive, and by a drive with the same energy that
ignores the table. Writes finger_over_table.png to FOLDER (by default the current folder).
"""

import sys
from pathlib import Path

import numpy as np

import airtact as at

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
folder.mkdir(parents=True, exist_ok=True)

finger = at.sound_hard(at.capsule((-0.02, 0, 0), (0.02, 0, 0), radius=8e-3, edge=2e-3))
table = at.plane(point=(0, 0, -0.03), normal=(0, 0, 1))
target = at.Target(np.array([[0.0, -9e-3, 0.0]]), pressures=1000.0)  # 1 mm from the skin
upright = at.Pose.turn((1, 0, 0), -np.pi / 2, translation=(-0.09, -0.2, 0.125))
array = at.autd3_board(upright)  # radiates along +y

solver = at.BoundaryElement(accuracy=0.03)
scenes = [at.Scene(at.air(celsius=22.0), [finger], planes=planes) for planes in ([table], [])]
aware, unaware = (
    at.best(at.transfer_matrix(solver.radiate(scene, target.beacons()), array), target)
    for scene in scenes
)
unaware = at.Drive(unaware.factor_to_match(aware) * unaware.amplitudes)  # to the same energy
for name, drive in {"with": aware, "without": unaware}.items():
    played = at.evaluate(scenes[0], array, drive, target, solver=at.BoundaryElement(0.01))
    print(f"drive computed {name} the table: {played.magnitudes[0]:.0f} Pa")

axes = at.plot.scene(scenes[0], array, aware, target)
axes.set_title("A finger above a table, with a board standing on the table")
axes.figure.savefig(folder / "finger_over_table.png", dpi=110)
