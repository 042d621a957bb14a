"""A hand from the 21 landmarks of a tracker, with foci at three fingertips.

    python examples/hand_landmarks.py [FOLDER]

hand_landmarks.json contains the landmarks in the order of MediaPipe and Leap, in metres. The board
faces the palm at a distance of 150 mm. Prints the pressure at each fingertip, and writes
hand_landmarks.png to FOLDER (by default the current folder). Requires the extra mesh:
pip install 'airtact[mesh]'.
"""

import sys
from pathlib import Path

import numpy as np

import airtact as at

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
folder.mkdir(parents=True, exist_ok=True)

hand = at.load_hand(Path(__file__).with_name("hand_landmarks.json"))
scene = at.Scene(at.air(celsius=22.0), [at.sound_hard(hand.surface)], frequency=40e3)

pads = [hand.place(name) for name in ("index.pad", "middle.pad", "ring.pad")]
target = at.Target(np.array([point + 0.5e-3 * normal for point, normal in pads]), pressures=800.0)
palm, towards_board = hand.place("palm")
array = at.autd3_board().facing(palm, towards_board, distance=0.15)

result = at.render(at.Setup(scene, array, target, accuracy=0.05))
print(f"{hand.side} hand: {', '.join(f'{pressure:.0f}' for pressure in result.pressures)} Pa")

axes = at.plot.scene(scene, array, result.drive, target)
axes.set_title("A hand from 21 landmarks above a board")
axes.figure.savefig(folder / "hand_landmarks.png", dpi=110)
