"""Two foci between thumb and finger, in the box of 996 transducers of Inoue and others (2014).

    python examples/two_fingers.py [FOLDER]

Asks for 1,500 Pa half a millimetre from each pad. Prints what this drive and one made for empty air
give at the same energy. Writes two_fingers.png into FOLDER, or into the current folder.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt

import airtact as at

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
folder.mkdir(parents=True, exist_ok=True)

fingers = at.pinch(gap=0.012)  # two capsules, 12 mm apart
bodies = [at.sound_hard(surface) for surface in fingers.surfaces]
scene = at.Scene(at.air(celsius=22.0), bodies, frequency=40e3)
target = at.Target(fingers.foci(offset=0.5e-3), pressures=1500.0)
array = at.surrounding_box()

# A source at a focus makes the same pressure at a transducer as the transducer makes at the focus,
# so one solve per focus serves all 996.
solver = at.BoundaryElement(accuracy=0.03)
transfer = at.transfer_matrix(solver.radiate(scene, target.beacons()), array)
aware = at.best(transfer, target)
unaware = at.best(at.open_air_matrix(scene, array, target), target)
unaware = at.Drive(unaware.factor_to_match(aware) * unaware.amplitudes)  # to the same energy

# A second, finer solve with the transducers as sources gives the pressures.
drives = {"for the fingers": aware, "for empty air": unaware}
figure, axes = plt.subplots(1, 2, figsize=(10, 3.5), layout="constrained")
for ax, (name, drive) in zip(axes, drives.items(), strict=True):
    played = at.evaluate(scene, array, drive, target, solver=at.BoundaryElement(accuracy=0.01))
    print(f"drive {name}: {played.magnitudes[0]:.0f} and {played.magnitudes[1]:.0f} Pa")
    at.plot.field(played, most=1600.0, ax=ax).set_title(f"Drive {name}")
figure.savefig(folder / "two_fingers.png", dpi=100)
