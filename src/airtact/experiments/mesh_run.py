"""One combination of order, mesh and domain, solved in a process of its own so that its memory can be measured."""

import json
import subprocess
import sys
import time
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128

from airtact.benching.peers.peak_memory import peak
from airtact.experiments.dummies import dummies
from airtact.printing import in_short
from airtact.solvers.fem.meshing.netgen import netgen_libraries, ngsolve_library
from airtact.solvers.fem.solver import FiniteElement
from airtact.transducers.layout import surrounding_box

ROOM = 0.5e-3
"""How far the meshed workspace reaches past the transducers, so that they lie in it [m]."""

BOX = ((-0.07 - ROOM, -0.07 - ROOM, -0.09 - ROOM), (0.07 + ROOM, 0.07 + ROOM, 0.09 + ROOM))
"""The paper's workspace with that room [m]."""


@dataclass(frozen=True)
class Combination:
    """What is solved: polynomial order, wavelength over the edge of the tetrahedra, and domain, "tight" or "box"."""

    order: int
    elements_per_wavelength: float
    domain: str

    def solver(self) -> FiniteElement:
        """Finite elements of this combination, one order everywhere."""
        domain = "box" if self.domain == "box" else "tight"
        return FiniteElement(self.order, self.elements_per_wavelength, domain=domain, box=BOX, graded=False)


@dataclass(frozen=True, eq=False)
class Ran:
    """The result of a combination: pressure received at the transducers [Pa], and its cost.

    The seconds are those of meshing, factorising, solving and evaluating; the bytes are the largest memory of the
    process, libraries included.
    """

    tetrahedra: int
    unknowns: int
    seconds: float
    most_bytes: int
    received: Complex128[np.ndarray, "elements"]

    __repr__ = in_short


@dataclass(frozen=True)
class Row:
    """A combination with its cost, measured where it was run, else predicted.

    ``error`` is the relative error of the beacons' pressure at the transducers, NaN where not run; ``notes`` say why it
    was not run, and are "" where it was.
    """

    combination: Combination
    tetrahedra: float
    unknowns: float
    seconds: float
    most_bytes: float
    error: float
    notes: str


def run_apart(combination: Combination, limit: float) -> Ran | str:
    """Solve in a process of its own, ended after ``limit`` seconds; the result, or the reason why there is none."""
    asked = json.dumps([combination.order, combination.elements_per_wavelength, combination.domain])
    command = [sys.executable, "-m", "airtact.experiments.mesh_run", asked]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=limit, check=False)
    except subprocess.TimeoutExpired:
        return f"ended after {limit:.0f} s"
    if done.returncode != 0:
        lines = done.stderr.strip().splitlines()
        return lines[-1] if lines else f"ended with code {done.returncode}"
    *costs, real, imaginary = json.loads(done.stdout.splitlines()[-1])
    return Ran(*costs, received=np.array(real) + 1j * np.array(imaginary))


def main() -> None:
    """Solve for the paper's beacons, as the command line asks in JSON, and print the fields of ``Ran`` in JSON."""
    combination, fingers, array = Combination(*json.loads(sys.argv[1])), dummies(), surrounding_box()
    scene = fingers.scene
    netgen_libraries()
    ngsolve_library()  # loaded before the clock starts
    begun = time.perf_counter()
    field = combination.solver().radiate(scene, fingers.beacon)
    received = field.at(array.positions)[:, 0]
    costs = field.report.settings["tetrahedra"], field.report.nodes, time.perf_counter() - begun, peak()
    print(json.dumps([*costs, np.real(received).tolist(), np.imag(received).tolist()]))


if __name__ == "__main__":
    main()
