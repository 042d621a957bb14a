"""A custom object from an STL file: a focus above a bowl.

    python examples/own_stl.py [FOLDER]

Reads bowl.stl, which is in millimetres, and requests 1,500 Pa at a point above the bowl. Prints the
pressure produced by this drive, and by a drive of the same energy that was computed for empty air.
Writes own_stl.png to FOLDER (by default the current folder). Requires the extra mesh:
pip install 'airtact[mesh]'.
"""

import sys
from pathlib import Path

import numpy as np

import airtact as at

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
folder.mkdir(parents=True, exist_ok=True)

bowl = at.load_surface(Path(__file__).with_name("bowl.stl"), scale=1e-3)  # millimetres to metres
scene = at.Scene(at.air(celsius=22.0), [at.sound_hard(bowl)], frequency=40e3)
target = at.Target(np.array([[0.0, 0.0, 0.008]]), pressures=1500.0)
array = at.autd3_board().facing((0, 0, 0), direction=(0, 0, 1), distance=0.15)

result = at.render(at.Setup(scene, array, target, accuracy=0.05))
print(
    f"{result.pressures[0]:.0f} Pa above the bowl, "
    f"{result.control_pressures[0]:.0f} Pa with a drive computed for empty air"
)

played = at.evaluate(scene, array, result.drive, target, solver=at.BoundaryElement(accuracy=0.02))
axes = at.plot.field(played, plane="xz")
axes.set_title("Focus above a bowl")
axes.figure.savefig(folder / "own_stl.png", dpi=120)
