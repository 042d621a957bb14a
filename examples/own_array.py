"""A custom array from a CSV file: a bowl of 91 transducers above a fingertip.

    python examples/own_array.py [FOLDER]

own_array.toml uses the CSV file as its layout. The columns are the position of each transducer
(x, y, z in metres) and the direction in which it radiates (nx, ny, nz). Prints the pressure at the
fingertip, and writes own_array.png to FOLDER (by default the current folder).
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt

import airtact as at

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
folder.mkdir(parents=True, exist_ok=True)

setup = at.read_scene(Path(__file__).with_name("own_array.toml"))
result = at.render(setup)
print(f"{result.pressures[0]:.0f} Pa at the fingertip from {len(setup.array)} transducers")

figure = plt.figure(figsize=(7, 5))
axes = figure.add_subplot(projection="3d", azim=-60, elev=-8)  # from below, into the bowl
at.plot.scene(setup.scene, setup.array, result.drive, setup.target, ax=axes)
axes.set_title("Phases of a bowl of transducers above a fingertip")
figure.savefig(folder / "own_array.png", dpi=110)
