"""One combination of order, mesh and domain, solved in a process of its own so that its memory can be measured."""

import json
import resource
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Complex128

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
    """What is solved.

    Attributes
    ----------
    order : polynomial order.
    elements_per_wavelength : wavelength over the edge of the tetrahedra.
    domain : "tight" or "box".
    """

    order: int
    elements_per_wavelength: float
    domain: str

    def solver(self) -> FiniteElement:
        """Finite elements of this combination, one order everywhere."""
        domain = "box" if self.domain == "box" else "tight"
        return FiniteElement(self.order, self.elements_per_wavelength, domain=domain, box=BOX, graded=False)


@dataclass(frozen=True, eq=False)
class Ran:
    """The result of a combination.

    Attributes
    ----------
    tetrahedra : of the mesh.
    unknowns : of the system.
    seconds : meshing, factorising, solving and evaluating at the transducers [s].
    most_bytes : largest memory of the process, libraries included.
    received : (E,) pressure at the transducers [Pa].
    """

    tetrahedra: int
    unknowns: int
    seconds: float
    most_bytes: int
    received: Complex128[np.ndarray, "elements"]

    __repr__ = in_short


@dataclass(frozen=True)
class Row:
    """A combination with its cost and error, predicted or measured.

    Attributes
    ----------
    combination : what is solved.
    tetrahedra, unknowns, seconds, most_bytes : measured where it was run, else predicted.
    error : relative error of the beacons' pressure at the transducers, NaN where not run.
    notes : why it was not run, or "" where it was.
    """

    combination: Combination
    tetrahedra: float
    unknowns: float
    seconds: float
    most_bytes: float
    error: float
    notes: str


def run_apart(combination: Combination, limit: float) -> Ran | str:
    """Solve for the paper's beacons in a process of its own, which is ended after ``limit`` seconds.

    Returns
    -------
    The result, or the reason why there is none.
    """
    asked = json.dumps([combination.order, combination.elements_per_wavelength, combination.domain])
    command = [sys.executable, "-m", "airtact.experiments.mesh_run", asked]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=limit, check=False)
    except subprocess.TimeoutExpired:
        return f"ended after {limit:.0f} s"
    if done.returncode != 0:
        lines = done.stderr.strip().splitlines()
        return lines[-1] if lines else f"ended with code {done.returncode}"
    answer = json.loads(done.stdout.splitlines()[-1])
    received = np.array(answer["real"]) + 1j * np.array(answer["imaginary"])
    return Ran(answer["tetrahedra"], answer["unknowns"], answer["seconds"], answer["most_bytes"], received)


def run_here(combination: Combination) -> Ran:
    """Solve for the paper's beacons in this process."""
    fingers, array = dummies(), surrounding_box()
    scene = fingers.rigid
    netgen_libraries()
    ngsolve_library()  # loaded before the clock starts
    begun = time.perf_counter()
    field = combination.solver().radiate(scene, fingers.beacon)
    received = field.at(array.positions)[:, 0]
    seconds = time.perf_counter() - begun
    tetrahedra = int(str(field.report.settings["tetrahedra"]))
    return Ran(tetrahedra, field.report.nodes, seconds, most_memory(), received)


def most_memory() -> int:
    """Largest memory that this process ever took [bytes].

    Linux counts in ``ru_maxrss`` what the parent had when it started this process, but not in ``VmHWM``.
    """
    try:
        lines = Path("/proc/self/status").read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        lines = []
    for line in lines:
        if line.startswith("VmHWM:"):
            return 1024 * int(line.split()[1])
    per_unit = 1 if sys.platform == "darwin" else 1024
    return per_unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def main() -> None:
    """Solve what the command line asks for in JSON and print the result in JSON."""
    order, size, domain = json.loads(sys.argv[1])
    ran = run_here(Combination(order, size, domain))
    answer = {
        "tetrahedra": ran.tetrahedra,
        "unknowns": ran.unknowns,
        "seconds": ran.seconds,
        "most_bytes": ran.most_bytes,
        "real": np.real(ran.received).tolist(),
        "imaginary": np.imag(ran.received).tolist(),
    }
    print(json.dumps(answer))


if __name__ == "__main__":
    main()
