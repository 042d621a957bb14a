"""Play a drive in AUTD3's own emulator, and compare its field with that of airtact.

    python examples/autd3_emulator.py [FOLDER]

Plays a focus on one emulated board for 1 ms. Prints the largest difference between the two fields,
and writes autd3_emulator.png to FOLDER (by default the current folder). Requires two packages:
pip install 'airtact[autd3]' pyautd3_emulator==36.0.2
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pyautd3
from pyautd3.gain import Custom
from pyautd3_emulator import Emulator, RangeXYZ, RmsRecordOption

import airtact as at

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
folder.mkdir(parents=True, exist_ok=True)
SPEED = 340.0  # speed of sound [m/s]

# The emulator's transducers radiate in all directions, with this pressure at 1 m [Pa].
array = at.autd3_board(element=at.monopole(275.574246 * 0.2 / (4 * np.pi)))
scene = at.Scene(at.Medium(SPEED, 1.2), [])
target = at.Target(np.array([[0.08, 0.06, 0.15]]))
transfer = at.open_air_matrix(scene, array, target)
frame = at.quantise(at.best(transfer, target))


def play(controller):
    """Send the frame without the silencer, and emit it for 1 ms."""
    levels = [
        pyautd3.Drive(phase=pyautd3.Phase(int(phase)), intensity=pyautd3.Intensity(int(amplitude)))
        for amplitude, phase in zip(frame.amplitude, frame.phase, strict=True)
    ]
    controller.send(pyautd3.Silencer.disable())
    controller.send((pyautd3.Static(), Custom(lambda _: lambda element: levels[element.idx()])))
    controller.tick(pyautd3.Duration.from_millis(1))


window = RangeXYZ(x=(40, 120), y=(60, 60), z=(110, 190), resolution=2.0)  # millimetres
with Emulator([pyautd3.AUTD3(pos=[0, 0, 0], rot=[1, 0, 0, 0])]) as emulator:
    field = emulator.record(play).sound_field(window, RmsRecordOption(sound_speed=1e3 * SPEED))
    points = 1e-3 * field.observe_points().to_numpy().astype(float)
    theirs = np.sqrt(2) * field.next(pyautd3.Duration.from_millis(1)).to_numpy()[:, -1]
ours = np.abs(at.field_map(scene, array, frame.drive(), points, solver=at.FreeField()))
print(f"the fields differ by {abs(theirs - ours).max():.2g} Pa of {ours.max():.0f} Pa")

figure, axes = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
for ax, name, values in zip(axes, ("airtact", "AUTD3 emulator"), (ours, theirs), strict=True):
    image = ax.tripcolor(*1e3 * points[:, [0, 2]].T, values, vmin=0, vmax=ours.max(), cmap="magma")
    ax.set(title=name, xlabel="x [mm]", ylabel="z [mm]", aspect="equal")
figure.colorbar(image, ax=axes, label="peak pressure [Pa]")
figure.savefig(folder / "autd3_emulator.png", dpi=100)
