"""Finite elements: accuracy, time and memory on the pinch and on spheres.

Run ``python -m benchmarks.finite_element [figure ...]``. The reference is the
sphere's series or fundamental solutions; boundary elements at 0.3 % are the other solver. Most
figures need the package ``mkl``.
"""

import subprocess
import sys
import time
from pathlib import Path

import numpy as np

import airtact as at
from airtact.acoustics.solvers.fem import solver as fem
from benchmarks.accuracy import (
    PAPER_AIR,
    directions,
    far_points,
    finger_error,
    one_each,
    relative,
    table,
)
from benchmarks.peers.peak_memory import forget_peak, peak

WATER = at.Medium(1481.0, 999.7)


def sphere_errors(radius: float, kind: str) -> list[float]:
    """Worst far error of 4 sources each in contact, 0.5 mm and 20 mm off a sphere."""
    ball = at.sphere(radius, radius / 2)
    scene = at.Scene(PAPER_AIR, [at.sound_hard(ball) if kind == "hard" else at.filled(ball, WATER)])
    ready, found = at.FiniteElement().factorised(scene), []
    for gap in (0.0, 5e-4, 0.02):
        sources = one_each(directions(4, 0) * (radius + gap))
        field, exact = ready.radiate(scene, sources), at.SphereSeries().radiate(scene, sources)
        found.append(float(relative(field.at(far_points(40)), exact.at(far_points(40))).max()))
    return found


def pinch_scene(kind: str = "hard") -> at.Scene:
    """Build the paper's fingers, hard or of water."""
    surfaces = at.pinch().surfaces
    bodies = [at.sound_hard(one) if kind == "hard" else at.filled(one, WATER) for one in surfaces]
    return at.Scene(PAPER_AIR, bodies)


def pinch_run(factorisation: str, together: bool) -> None:
    """Solve the pinch once in this process and print what it took."""
    scene, array = pinch_scene(), at.surrounding_box()
    beacons = at.Target(at.pinch().foci(0.0)).beacons()
    sources = (
        at.Monopoles(beacons.positions, beacons.strengths.sum(axis=1)) if together else beacons
    )
    if factorisation == "sparsecholesky":
        fem.pardiso_library = lambda: None
    solver = at.FiniteElement()
    solver.radiate(
        at.Scene(PAPER_AIR, [at.sound_hard(at.sphere(0.002, 0.001))]),
        one_each(np.array([[0, 0, 0.01]])),
    )
    forget_peak()
    began = time.perf_counter()
    ready = solver.factorised(scene)
    field = ready.radiate(scene, sources)
    found = field.at(array.positions)
    whole = time.perf_counter() - began
    memory = peak() / 2**30
    more = at.Monopoles(sources.positions + 1e-4 * np.array([0, 0, 1.0]), sources.strengths)
    began = time.perf_counter()
    again = ready.radiate(scene, more)
    solved = time.perf_counter() - began
    again.at(array.positions)
    read = time.perf_counter() - began
    other = at.BoundaryElement(accuracy=0.003).radiate(scene, sources).at(array.positions)
    print(
        f"{100 * relative(found, other).max():.2f} % off boundary elements, {whole:.1f} s, {memory:.2f} GiB, "
        f"{field.report.nodes:,} unknowns; again with {sources.strengths.shape[1]} right-hand sides: solve "
        f"{solved:.2f} s, with read-out {read:.2f} s"
    )


def _pinch(factorisation: str = "pardiso", together: bool = True) -> str:
    command = [sys.executable, __file__, "--pinch", factorisation, str(int(together))]
    return subprocess.run(
        command, capture_output=True, text=True, check=True, cwd=Path.cwd()
    ).stdout.strip()


def verified() -> str:
    """How far the focus pressure of a drive by one solver is from its own prediction, verified by the other."""
    scene, array = pinch_scene(), at.surrounding_box()
    target = at.Target(at.pinch().foci())
    boundary, finite = at.BoundaryElement(), at.FiniteElement()
    found = []
    for maker, verifier in ((boundary, finite), (finite, boundary)):
        transfer = at.transfer_matrix(maker.radiate(scene, target.beacons()), array)
        drive = at.time_reversal(transfer, target)
        own = np.abs(transfer.matrix @ drive.amplitudes)
        there = np.abs(at.field_map(scene, array, drive, target.points, solver=verifier))
        found.append(float(np.abs(there / own - 1).max()))
    return f"{100 * found[0]:.2f} % (boundary elements' drive), {100 * found[1]:.2f} % (finite elements' drive)"


def _fingers() -> str:
    error, own = finger_error(8e-3, 20, 12e-3, solver=at.FiniteElement())
    return f"{100 * error:.2f} % (reference itself {100 * own:.2f} %)"


def _spheres(kind: str) -> str:
    found = np.max([sphere_errors(radius, kind) for radius in (5e-3, 8e-3, 10e-3)], axis=0)
    return " / ".join(f"{100 * value:.2f}" for value in found) + " % in contact, 0.5 mm, 20 mm off"


ROWS = [
    ("rigid spheres of 5, 8 and 10 mm, far field", "0.5 %", lambda: _spheres("hard")),
    ("water spheres of 5, 8 and 10 mm, far field", "0.5 %", lambda: _spheres("water")),
    ("two fingers against fundamental solutions", "1 %", _fingers),
    ("pinch, both foci at once", "1 %, 10 s, 4 GB", _pinch),
    ("pinch, both foci apart", "", lambda: _pinch(together=False)),
    ("without mkl: pinch", "", lambda: _pinch("sparsecholesky")),
    ("drive of one solver verified by the other", "2 %", verified),
]

if __name__ == "__main__":
    if sys.argv[1:2] == ["--pinch"]:
        pinch_run(sys.argv[2], sys.argv[3] == "1")
    else:
        table(ROWS, sys.argv[1:])
