"""A virtual ball between thumb and index finger, in the box of Inoue et al. (2014).

    python examples/touch_ball.py [FOLDER]

Finds where the fingers touch the ball, computes the drive, and writes touch_ball.png.
"""

import sys
from pathlib import Path

import airtact as at

fingers = at.pinch(gap=0.012)  # two capsules, 12 mm apart
ball = at.VirtualObject(at.sphere(radius=0.012, edge=0.003), name="ball")
contacts = at.contact(fingers.surfaces, ball)
scene = at.Scene(at.air(celsius=22.0), [at.sound_hard(finger) for finger in fingers.surfaces])
result = at.render(at.Setup(scene, at.surrounding_box(), contacts.target(), accuracy=0.03))
for point, pressure in zip(contacts.points, result.pressures, strict=True):
    x, y, z = 1e3 * point
    print(f"{pressure:.0f} Pa at the contact ({x:.2f}, {y:.2f}, {z:.2f}) mm")
folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
at.plot.field(result).figure.savefig(folder / "touch_ball.png", dpi=100)
