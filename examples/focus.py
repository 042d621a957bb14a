"""A focus in open air, 200 mm above one AUTD3 board.

    python examples/focus.py [FOLDER]

There is no hand in the sound field. Prints the pressure at the focus, and writes focus.png to
FOLDER (by default the current folder).
"""

import sys
from pathlib import Path

import numpy as np

import airtact as at

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
folder.mkdir(parents=True, exist_ok=True)

point = np.array([0.0, 0.0, 0.2])
board = at.autd3_board().facing(point, direction=(0, 0, -1), distance=0.2)
setup = at.Setup(at.Scene(at.air(celsius=22.0), []), board, at.Target(point[None]))
result = at.render(setup)
print(f"{result.pressures[0]:.0f} Pa at the focus with {len(board)} transducers")

axes = at.plot.field(result.verification, plane="xz")
axes.set_title("One focus, 200 mm above the board")
axes.figure.savefig(folder / "focus.png", dpi=120)
