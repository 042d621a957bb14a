"""Applications at the live loop: one reconnects every 10 s, one sends nonsense, and a hand touches the ball.

python -m benchmarks.applications [MINUTES]
"""

import json
import re
import statistics
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from threading import Event, Thread

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

import airtact as at

NONSENSE = [
    "nonsense",
    b"\xff\x00" * 500,
    '{"type": "foci", "version": 2}',
    '{"type": "foci", "version": 1, "foci": [{"id": "a", "point": [0, NaN, 0]}]}',
    '{"type": "foci", "version": 1, "foci": [{"id": "a", "point": [0, 0, 200]}]}',
    '{"type": "objects", "version": 1, "move": [{"name": "bal", "pose": {}}]}',
    json.dumps({"type": "objects", "version": 1, "add": [{"name": "b", "sphere": {"radius": 9}}]}),
    '{"type": "foci", "version": 1, "x": ' + "[" * 10_000,
]


class Load:
    """What happens at the loop, each in a thread of its own, until ``ended``."""

    def __init__(self, address: str) -> None:
        self.address = address
        self.ended = Event()
        self.sent = self.answered = self.connections = 0
        self.states = self.silent_touches = 0
        self.untouched = 0.0  # longest time with sound and without a contact [s]
        kinds = (self.track, self.reconnect, self.disturb, self.watch)
        self.threads = [Thread(target=kind) for kind in kinds]

    def track(self) -> None:
        """Send a recorded hand that grasps the ball and lets it go, 60 times per second."""
        frames = at.hands.load_recording(at.example("grasping.jsonl")).frames
        begun = time.monotonic()
        with connect(self.address, compression=None) as tracker:
            index = 0
            while not self.ended.wait(max(begun + index / 60 - time.monotonic(), 0.0)):
                now = time.monotonic()
                frame = replace(frames[index % len(frames)], time=now, sequence=index)
                tracker.send(at.hands.to_json(frame))
                index += 1

    def reconnect(self) -> None:
        """Give the ball, move it a little, and reconnect every 10 s."""
        while not self.ended.is_set():
            with at.live.Client(self.address) as client:
                self.connections += 1
                client.objects(at.VirtualObject(at.sphere(0.012, edge=0.004), name="ball"))
                for step in range(300):
                    if self.ended.wait(1 / 30):
                        return
                    client.move("ball", at.Pose.shift((0.0, 0.0, 1e-3 * (step % 30) / 30)))

    def disturb(self) -> None:
        """Send nonsense every second, and once in a while a message of 10 MB."""
        while not self.ended.is_set():
            with connect(self.address, compression=None) as client:
                for nonsense in NONSENSE:
                    client.send(nonsense)
                    self.sent += 1
                    while json.loads(client.recv(timeout=30))["type"] != "rejected":
                        pass
                    self.answered += 1
                    if self.ended.wait(1.0):
                        return
                with suppress(ConnectionClosed):
                    client.send(b"x" * 10_000_000)

    def watch(self) -> None:
        """Compare the sound with the contacts in all states."""
        with at.live.Client(self.address) as client:
            client.clear()
            alone = None
            while not self.ended.is_set():
                client.clear()
                state = client.next_state(1.0)
                if state is None:
                    continue
                self.states += 1
                loud = any((focus.pressure or 0.0) > 1.0 for focus in state.foci)
                self.silent_touches += bool(state.contacts) and not loud
                if not loud or state.contacts:
                    alone = None
                    continue
                alone = alone or time.monotonic()
                self.untouched = max(self.untouched, time.monotonic() - alone)


def memory_of(process: int) -> float:
    """Return the memory of a process and its children [MB]."""
    total = 0.0
    for status in Path("/proc").glob("[0-9]*/status"):
        try:
            text = status.read_text()
        except OSError:  # it has just ended
            continue
        found = dict(re.findall(r"^(Pid|PPid|VmRSS):\s+(\d+)", text, re.MULTILINE))
        if str(process) in (found["Pid"], found["PPid"]):
            total += int(found.get("VmRSS", 0)) / 1000
    return total


def steady_memory(process: int) -> float:
    """Return the median memory over 20 s [MB]; that of the session's writer varies by 8 MB."""
    samples = []
    for _ in range(20):
        samples.append(memory_of(process))
        time.sleep(1.0)
    return statistics.median(samples)


def main(folder: Path, minutes: float) -> None:
    """Run the loop under load, and print what grew and what went wrong."""
    command = [sys.executable, "-m", "airtact", "live", "touch_ball", "--no-page", "--json"]
    command += ["--from", "websocket:0", "--seconds", str(60 * minutes + 10), "--out", str(folder)]
    log = folder / "log"
    with log.open("w") as stream:
        running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=stream, text=True)
    address = None
    while address is None and running.poll() is None:
        time.sleep(0.1)
        address = re.search(r"ws://[\d.:]+", log.read_text())
    assert address, log.read_text()
    load = Load(address[0])
    for thread in load.threads:
        thread.start()
    time.sleep(0.25 * 60 * minutes)  # the first quarter fills what is kept of fixed size
    before = steady_memory(running.pid)
    time.sleep(0.75 * 60 * minutes - 40)
    after = steady_memory(running.pid)
    load.ended.set()
    for thread in load.threads:
        thread.join()
    out, _ = running.communicate(timeout=60)
    done = json.loads(out)
    text = log.read_text()
    print(f"memory {before:.0f} MB, then {after:.0f} MB: {after / before - 1:+.1%}")
    print(f"{load.connections} connections; {load.answered} of {load.sent} bad messages answered")
    print(f"exit code {running.returncode}, {text.count('Traceback')} tracebacks")
    print(f"{done['drives']:,} drives, {done['rate']:.0f}/s; faded: {done['faded']}")
    print(
        f"{load.states:,} states; {load.silent_touches} with a contact and without sound; longest "
        f"sound without contact {1e3 * load.untouched:.0f} ms"
    )


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as results:
        main(Path(results), float(sys.argv[1]) if len(sys.argv) > 1 else 10.0)
