"""A stream of 2,000 frames a second for a minute, one in ten damaged: what comes through, how old, how much memory.

    python -m benchmarks.stream_load [SECONDS]

A process of its own sends. The age of a frame is the time from its sending to its use by the
stream, by one clock.
"""

import subprocess
import sys
import time
from array import array
from pathlib import Path

import numpy as np

from airtact.hands.tracking.frame import HandFrame
from airtact.hands.tracking.messages import to_json
from airtact.hands.tracking.receivers import WebSocketReceiver
from airtact.hands.tracking.recordings import load_recording
from airtact.hands.tracking.stream import HandStream
from airtact.setup.examples import example

RATE = 2000
"""Frames a second."""

SENDER = """
import sys, time
from websockets.sync.client import connect
port, seconds, rate, line = int(sys.argv[1]), float(sys.argv[2]), float(sys.argv[3]), sys.stdin.readline()
begun, index = time.monotonic(), 0
with connect(f"ws://127.0.0.1:{port}") as tracker:
    while index < seconds * rate:
        due = begun + index / rate
        if (early := due - time.monotonic()) > 0:
            time.sleep(early)
        words = line.replace("12345", str(index)).replace("0.5,", f"{time.monotonic()},", 1)
        tracker.send(words[: len(words) // 2] if index % 10 == 9 else words)
        index += 1
print(time.monotonic() - begun)
"""


def resident() -> int:
    """Memory of this process [bytes]."""
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * 4096


def main(seconds: float) -> None:
    """Send, and print what came."""
    first = next(
        one for one in load_recording(example("pinching.jsonl")).frames if one.landmarks is not None
    )
    line = to_json(HandFrame(0.5, first.side, 12345, first.landmarks)).decode() + "\n"
    ages = array(
        "d", bytes(8 * int(seconds * RATE))
    )  # made before, so that it does not count as growth
    used = 0

    def note(frame: HandFrame) -> None:
        nonlocal used
        ages[used], used = time.monotonic() - frame.time, used + 1

    stream = HandStream(on_frame=note)
    with WebSocketReceiver(stream) as receiver:
        command = [sys.executable, "-c", SENDER, str(receiver.port), str(seconds), str(RATE)]
        sender = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert sender.stdin is not None
        sender.stdin.write(line)
        sender.stdin.close()
        time.sleep(0.2 * seconds)
        early = resident()
        sender.wait()
        time.sleep(0.5)
        late = resident()
    assert sender.stdout is not None
    took, count = float(sender.stdout.read()), int(seconds * RATE)
    age = 1e3 * np.percentile(ages[:used], [50, 99])
    print(f"{count} frames in {took:.1f} s, {stream.health}")
    print(f"age: median {age[0]:.2f} ms, 99 of 100 within {age[1]:.2f} ms")
    print(f"{used / (0.9 * count):.2%} of the good frames used")
    print(
        f"memory {early / 1e6:.1f} MB after a fifth, {late / 1e6:.1f} MB at the end ({(late - early) / early:+.2%})"
    )


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 60.0)
