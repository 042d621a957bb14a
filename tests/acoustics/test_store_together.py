"""Many solves in a process, and processes and threads that solve at once with one store."""

import subprocess
import sys
from pathlib import Path

import pytest

PATIENCE = 1200.0

ONE_AFTER_ANOTHER = """
import os, sys
import numpy as np, airtact as at

air, array, count = at.air(celsius=20.0), at.autd3_board(), int(sys.argv[1])
solver = at.BoundaryElement(accuracy=0.3)

def solve(index):
    ball = at.sphere(3e-3 + 1e-6 * index, 2e-3).moved(at.Pose(np.eye(3), np.array([0.08, 0.06, 0.1])))
    scene, focus = at.Scene(air, [at.sound_hard(ball)]), at.Target(np.array([[0.08, 0.06, 0.094]]))
    field = solver.radiate(scene, focus.beacons())
    return at.max_min(at.transfer_matrix(field, array), focus)

def held():
    pages = int(open("/proc/self/statm").read().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE"), len(os.listdir("/proc/self/fd"))

for index in range(count // 5):
    solve(index)
memory, files = held()
for index in range(count):
    solve(index)
more, open_files = held()
print(more / memory - 1, open_files - files)
"""

TOGETHER = """
import hashlib, sys, threading
import numpy as np, airtact as at

folder, threads, rounds = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
air, points = at.Medium(343.1, 1.293), np.random.default_rng(0).normal(scale=0.02, size=(40, 3)) + [0, 0, 0.06]
solver = at.Stored(at.BoundaryElement(accuracy=0.1), folder) if threads else at.BoundaryElement(accuracy=0.1)
found, faults = {}, []

def solve(round_, index):
    ball = at.sphere(3e-3 + 1e-4 * index + 1e-6 * round_, 2e-3)
    field = solver.radiate(at.Scene(air, [at.sound_hard(ball)]), at.Monopoles(np.array([[0, 0, 0.012]]), np.ones(1)))
    return hashlib.sha256(field.at(points).tobytes() + field.on_surface.pressure.tobytes()).hexdigest()

def work(first):
    try:
        for round_ in range(rounds):
            for step in range(12):  # more fields than stay in memory, each thread in an order of its own
                index = (first + step) % 12
                one = solve(round_, index)
                if found.setdefault((round_, index), one) != one:
                    faults.append("two threads differ")
    except BaseException as error:
        faults.append(repr(error))

if threads:
    all_of_them = [threading.Thread(target=work, args=(first,)) for first in range(threads)]
    [one.start() for one in all_of_them]
    [one.join() for one in all_of_them]
else:
    work(0)
print(faults, hashlib.sha256(repr(sorted(found.items())).encode()).hexdigest())
"""


def started(script: str, *arguments: object) -> subprocess.Popen[str]:
    command = [sys.executable, "-W", "error", "-c", script, *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def ended(process: subprocess.Popen[str]) -> str:
    try:
        out, fault = process.communicate(timeout=PATIENCE)
    finally:
        process.kill()
    assert process.returncode == 0, fault
    return out


@pytest.mark.parametrize(
    ("solves", "share"),
    [pytest.param(60, 0.03, id="60"), pytest.param(1000, 0.01, id="1000", marks=pytest.mark.slow)],
)
def test_solves_one_after_another_keep_no_memory_and_no_file(solves: int, share: float) -> None:
    growth, files = ended(started(ONE_AFTER_ANOTHER, solves)).split()
    assert float(growth) < share
    assert int(files) == 0


@pytest.mark.parametrize(
    ("processes", "threads", "rounds"),
    [pytest.param(2, 4, 1, id="short"), pytest.param(4, 8, 8, id="long", marks=pytest.mark.slow)],
)
def test_processes_and_threads_with_one_store_find_the_same_bits_as_alone(
    processes: int, threads: int, rounds: int, tmp_path: Path
) -> None:
    alone = ended(started(TOGETHER, tmp_path, 0, rounds))
    together = [started(TOGETHER, tmp_path, threads, rounds) for _ in range(processes)]
    assert [ended(one) for one in together] == [alone] * processes
    assert alone.startswith("[] ")
