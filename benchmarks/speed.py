"""How long the main job takes and how much memory: every speed figure of the README, measured anew.

Run ``make bench``, or ``PYTHONPATH=.:tests python benchmarks/speed.py``. Each job runs in a process of its own; times
are the best of several, for machines are noisy.
"""

import resource
import subprocess
import sys
import time
from pathlib import Path

EXAMPLES = Path(__file__).parent.parent / "examples"


def pinch_seconds() -> tuple[float, float]:
    """Solve the paper's pinch and make its drive: best of five [s], and the peak memory [GB]."""
    import airtact as at

    best = float("inf")
    for _ in range(5):
        fingers = at.pinch()
        scene = at.Scene(at.Medium(343.1, 1.293), [at.sound_hard(surface) for surface in fingers.surfaces])
        target = at.Target(fingers.foci())
        array = at.surrounding_box()
        began = time.perf_counter()
        beacons = at.BoundaryElement().radiate(scene, target.beacons())
        at.quantise(at.time_reversal(at.transfer_matrix(beacons, array), target))
        best = min(best, time.perf_counter() - began)
    return best, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6


def render_seconds(name: str) -> tuple[float, float]:
    """Render an example with all its files and pictures [s], and the peak memory [GB]."""
    command = [
        str(Path(sys.executable).parent / "airtact"),
        "render",
        str(EXAMPLES / name),
        "--out",
        f"out/bench/{name}",
    ]
    began = time.perf_counter()
    subprocess.run(command, check=True, capture_output=True)
    return time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e6


def import_seconds() -> float:
    """Import airtact in a fresh interpreter, best of five [s]."""
    code = "import time; t = time.perf_counter(); import airtact; print(time.perf_counter() - t)"
    runs = [subprocess.run([sys.executable, "-c", code], check=True, capture_output=True) for _ in range(5)]
    return min(float(run.stdout) for run in runs)


if __name__ == "__main__":
    print("| figure | asked | measured |\n|---|---|---|")
    print(f"| `import airtact` | 1.2 s | {import_seconds():.2f} s |", flush=True)
    seconds, memory = pinch_seconds()
    print(f"| `examples/pinch.toml`: solve and drive | 0.5 s, 1 GB | {seconds:.2f} s, {memory:.2f} GB |", flush=True)
    for example, asked in (("pinch.toml", "-"), ("open_hand.toml", "60 s, 6 GB")):
        seconds, memory = render_seconds(example)
        print(f"| `airtact render examples/{example}` | {asked} | {seconds:.0f} s, {memory:.2f} GB |", flush=True)
