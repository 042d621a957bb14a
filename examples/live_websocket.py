"""The live loop with your own tracker, which sends frames over a websocket.

    python examples/live_websocket.py [FOLDER]

Starts `airtact live` without boards and sends it a recorded motion for four seconds, as a tracker
would. Prints the number of frames and drives. Writes live_websocket.png and live/session.h5 (the
recorded session) to FOLDER (by default the current folder). Requires two extras:
pip install 'airtact[mesh,tracking]'
"""

import subprocess
import sys
import time
from pathlib import Path

import matplotlib.pyplot as plt
from websockets.sync.client import connect

import airtact as at

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
folder.mkdir(parents=True, exist_ok=True)
PORT = 8765

motion = at.hands.load_recording(at.example("reaching.jsonl"))  # replace with your tracker's frames
command = [sys.executable, "-m", "airtact", "live", str(at.example("live_pinch"))]
command += ["--from", f"websocket:{PORT}", "--out", str(folder / "live"), "--no-page", "--quiet"]
loop = subprocess.Popen(command)


def connected():
    """Connect to the loop, which opens its port after a few seconds."""
    while loop.poll() is None:
        try:
            return connect(f"ws://127.0.0.1:{PORT}", compression=None)
        except OSError:
            time.sleep(0.2)
    sys.exit("airtact live ended before a connection was made.")


try:
    with connected() as tracker:
        for frame in at.hands.replay(motion.frames):  # in real time
            tracker.send(at.hands.to_json(frame))
finally:
    loop.terminate()  # like Ctrl-C in a terminal: the sound fades and the session is closed
    loop.wait()

session = at.live.read_session(folder / "live")
print(f"{len(session.frame_time)} frames received, {session.playing.sum()} drives played")

figure, ax = plt.subplots(layout="constrained")
start = session.frame_time[0]
ax.plot(session.time_in_air - start, 1e3 * session.foci[:, :, 0])
ax.plot(session.frame_time - start, 1e3 * session.landmarks[:, 0, 0], "k:")
ax.set(xlabel="time [s]", ylabel="x [mm]", title="Foci that follow a hand")
figure.legend([*session.scene.places, "wrist in the frames"], loc="outside lower center", ncols=3)
figure.savefig(folder / "live_websocket.png", dpi=110)
