"""The live loop for ten minutes, with a tracker that sends nonsense every minute: no memory, no thread, no fault.

python -m benchmarks.soak
"""

import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from websockets.sync.client import connect

import airtact as at

MINUTES = 10
NONSENSE = [
    b"nonsense",
    b"{}",
    b"[" * 10_000,
    b'{"time": NaN, "side": "left", "sequence": 1}',
    b"\xff" * 1000,
]


def state_of(process: int) -> tuple[float, int]:
    """Return the memory [kB] and the number of threads of a process."""
    text = Path(f"/proc/{process}/status").read_text()
    found = [re.search(rf"{name}:\s+(\d+)", text) for name in ("VmRSS", "Threads")]
    return tuple(int(one[1]) for one in found if one)


def main(folder: Path) -> None:
    """Run the loop, and compare memory and threads with those of its second minute."""
    frames = at.hands.load_recording(at.example("reaching.jsonl")).frames
    command = [
        sys.executable,
        "-m",
        "airtact",
        "live",
        "live_pinch",
        "--no-page",
        "--from",
        "websocket:0",
    ]
    lasting = ["--seconds", str(60 * MINUTES + 5), "--out", str(folder), "--json"]
    with subprocess.Popen(
        [*command, *lasting], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as running:
        assert running.stderr is not None
        address = None
        while address is None:
            address = re.search(r"ws://[\d.:]+", running.stderr.readline())
        seen = []
        with connect(address[0]) as tracker:
            begun = time.monotonic()
            for index in range(60 * 60 * MINUTES):
                time.sleep(max(begun + index / 60 - time.monotonic(), 0.0))
                frame = frames[index % len(frames)]
                message = at.hands.to_json(
                    type(frame)(time.monotonic(), frame.side, index, frame.landmarks)
                )
                tracker.send(message)
                if index % 3600 == 1800:
                    seen.append(state_of(running.pid))
                    for nonsense in NONSENSE:
                        tracker.send(nonsense)
        out, _ = running.communicate(timeout=120)
        assert running.returncode == 0, out
    memory, threads = np.array(seen, dtype=float).T
    assert memory[-1] <= 1.01 * memory[1]  # the first minute fills what is kept of fixed size
    assert threads[-1] == threads[1]
    session = at.live.read_session(folder)
    size = (folder / "session.h5").stat().st_size
    drives = len(session.states)
    rate = size * 60.0 / MINUTES / 1e9
    print(f"session.h5: {size / drives:.0f} bytes a drive, {rate:.2f} GB an hour")
    assert len(session.frame_time) == 60 * 60 * MINUTES
    assert not session.amplitudes[-1].any()


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as results:
        main(Path(results))
