"""Solve for the paper's beacons with one mesh, and print its cost and the pressures as JSON.

``reproduce.py`` runs this script in a separate process, whose peak memory is that of the solve.
"""

import json
import math
import sys
import time
from pathlib import Path

from reproduce import ARRAY, Fingers

import airtact as at


def peak_memory() -> float:
    """Return the peak memory of this process [bytes]; NaN where it is unknown."""
    status = Path("/proc/self/status")  # ru_maxrss would include the parent's memory
    if not status.exists():
        return math.nan
    lines = status.read_text(encoding="ascii").splitlines()
    return 1024.0 * next(int(line.split()[1]) for line in lines if line.startswith("VmHWM:"))


def main() -> None:
    """Solve with the order and the number of elements per wavelength, given as JSON."""
    order, elements_per_wavelength = json.loads(sys.argv[1])
    solver = at.FiniteElement(order, elements_per_wavelength)
    fingers = Fingers()
    at.FiniteElement(1, 1.0).radiate(fingers.scene, fingers.beacons)  # loads libraries
    begun = time.perf_counter()
    field = solver.radiate(fingers.scene, fingers.beacons)
    received = field.at(ARRAY.positions)[:, 0]
    answer = {
        "tetrahedra": field.report.settings["tetrahedra"],
        "unknowns": field.report.nodes,
        "seconds": time.perf_counter() - begun,
        "memory": peak_memory(),
        "real": received.real.tolist(),
        "imaginary": received.imag.tolist(),
    }
    print(json.dumps(answer))


if __name__ == "__main__":
    main()
