"""A focus that moves along a circle on the palm 100 times per second.

    python examples/palm_stm.py [FOLDER]

A moving focus (spatiotemporal modulation) is easier to feel than a static one. Prints the pressure
along the circle. Writes palm_stm.png and sequence.h5 to FOLDER (by default the current folder);
`airtact emit` plays sequence.h5. Requires the extra mesh: pip install 'airtact[mesh]'.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import airtact as at

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
folder.mkdir(parents=True, exist_ok=True)

setup = at.read_scene(Path(__file__).with_name("palm_stm.toml"))
result = at.render(setup)
result.save(folder)
moving = result.sequence
print(
    f"{len(moving.sequence)} frames; {moving.pressures.min():.0f} to "
    f"{moving.pressures.max():.0f} Pa at the focus"
)

# Pressure at each position of the circle in each frame
pressures = np.abs(moving.sequence.pressure(moving.transfer))
figure, axes = plt.subplots(layout="constrained")
image = axes.imshow(pressures.T, origin="lower", aspect="auto", cmap="magma")
axes.set(xlabel="frame", ylabel="position on the circle", title="A focus that moves along a circle")
figure.colorbar(image, label="peak pressure [Pa]")
figure.savefig(folder / "palm_stm.png", dpi=110)
