"""Two foci between a thumb and a finger, in the box of 996 transducers of Inoue et al. (2014).

    python examples/two_fingers.py [FOLDER]

Requests 1,500 Pa half a millimetre away from each pad. Prints the pressures produced by this drive,
and by a drive of the same energy that was computed for empty air. Writes two_fingers.png to FOLDER
(by default the current folder).
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

# A source at a focus produces the same pressure at a transducer as the transducer does at the
# focus, so one solve per focus covers all 996 transducers.
solver = at.BoundaryElement(accuracy=0.03)
transfer = at.transfer_matrix(solver.radiate(scene, target.beacons()), array)
aware = at.best(transfer, target)
unaware = at.best(at.open_air_matrix(scene, array, target), target)
unaware = at.Drive(unaware.factor_to_match(aware) * unaware.amplitudes)  # to the same energy

# The pressures come from a second, finer solve with the transducers as sources.
drives = {"for the fingers": aware, "for empty air": unaware}
figure, axes = plt.subplots(1, 2, figsize=(10, 3.5), layout="constrained")
for ax, (name, drive) in zip(axes, drives.items(), strict=True):
    played = at.evaluate(scene, array, drive, target, solver=at.BoundaryElement(accuracy=0.01))
    print(f"drive {name}: {played.magnitudes[0]:.0f} and {played.magnitudes[1]:.0f} Pa")
    at.plot.field(played, most=1600.0, ax=ax).set_title(f"Drive {name}")
figure.savefig(folder / "two_fingers.png", dpi=100)
