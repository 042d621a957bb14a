"""Run one case with airtact, as the other scripts run it with theirs: ``python airtact_script.py case.npz answer.npz``.

It times the solve and the pressure at the elements, from surfaces that are in memory already.
"""

import sys
import time

import numpy as np
from peak_memory import forget_peak, peak

import airtact as at


def main(case_file: str, answer_file: str) -> None:
    """Time the solve and the pressure at the elements, as often as the case asks, after one coarse run to warm up."""
    case = np.load(case_file)
    surfaces = [
        at.capsule(tuple(start), tuple(end), float(radius), edge=float(radius) / 2)
        for (start, end), radius in zip(case["axes"], case["radii"], strict=True)
    ]
    medium = at.Medium(sound_speed=float(case["sound_speed"]), density=1.293)
    frequency, beacons = float(case["frequency"]), at.Target(case["foci"]).beacons()

    def solve(solver: at.BoundaryElement) -> tuple[at.acoustics.RadiatedField, np.ndarray, float]:
        began = time.perf_counter()
        scene = at.Scene(
            medium, [at.sound_hard(surface) for surface in surfaces], frequency=frequency
        )
        field = solver.radiate(scene, beacons)
        pressure = field.at(case["elements"]).T
        return field, pressure, time.perf_counter() - began

    solver = at.BoundaryElement(accuracy=float(case["accuracy"]), estimate=bool(case["estimate"]))
    solve(at.BoundaryElement(accuracy=0.3))
    before = forget_peak()
    field, matrix, _ = solve(solver)
    above = peak() - before
    seconds = []
    for _ in range(int(case["runs"])):
        field, matrix, took = solve(solver)
        seconds.append(took)
    nodes, version = field.report.nodes, f"airtact {at.__version__}"
    np.savez(
        answer_file, matrix=matrix, seconds=seconds, peak=above, unknowns=nodes, version=version
    )


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
