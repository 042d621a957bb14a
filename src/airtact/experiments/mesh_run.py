"""One combination of order, mesh and domain: its cost, predicted from others, or run in a process of its own."""

import json
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Complex128, Float64
from scipy.optimize import nnls

from airtact.acoustics.solvers.fem.meshing.netgen import netgen_libraries, ngsolve_library
from airtact.acoustics.solvers.fem.solver import MARGIN, FiniteElement
from airtact.acoustics.solvers.fem.weak_form import THICKNESS
from airtact.benching.peers.peak_memory import peak
from airtact.experiments.dummies import AIR, dummies
from airtact.printing import in_short
from airtact.transducers.element import monopole
from airtact.transducers.layout import surrounding_box

ROOM = 0.5e-3
"""How far the meshed workspace reaches past the transducers, so that they lie in it [m]."""

BOX = ((-0.07 - ROOM, -0.07 - ROOM, -0.09 - ROOM), (0.07 + ROOM, 0.07 + ROOM, 0.09 + ROOM))
"""The paper's workspace with that room [m]."""

TETRAHEDRA = 8.0
"""Tetrahedra in a cube whose edge is theirs, until a run has measured it."""

CORNERS, EDGES, FACES = 0.2, 1.2, 2.0
"""Of each over the number of tetrahedra, in a mesh that fills space."""

SLOWEST, HEAVIEST = 5.0 / 3.0, 4.0 / 3.0
"""Powers of the unknowns with which time and memory of a factor grow: nested dissection of a mesh in space has 2 and
4/3 at most."""

SECONDS = np.array([0.1, 1e-4, 5e-7, 1e-7])
"""Seconds to begin with: always, for a tetrahedron, for an entry of its matrix, for the power of the unknowns."""

BYTES = np.array([0.3 * 2.0**30, 1e3, 30.0, 400.0])
"""The same of bytes."""

BELIEVED = 0.1
"""Weight of those beside one run."""


@dataclass(frozen=True)
class Combination:
    """What is solved: polynomial order, wavelength over the edge of the tetrahedra, and domain, "tight" or "box"."""

    order: int
    elements_per_wavelength: float
    domain: str

    def solver(self) -> FiniteElement:
        """Finite elements of this combination, one order everywhere."""
        domain = "box" if self.domain == "box" else "tight"
        return FiniteElement(
            self.order, self.elements_per_wavelength, domain=domain, box=BOX, graded=False
        )


@dataclass(frozen=True, eq=False)
class Ran:
    """The result of a combination: pressure received at the transducers [Pa], and its cost.

    The seconds are those of meshing, factorising, solving and evaluating; the bytes are the largest
    memory of the process, libraries included.
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

    ``error`` is the relative error of the beacons' pressure at the transducers, NaN where not run;
    ``notes`` say why it was not run, and are "" where it was.
    """

    combination: Combination
    tetrahedra: float
    unknowns: float
    seconds: float
    most_bytes: float
    error: float
    notes: str


def tetrahedra(one: Combination, ran: Sequence[Row]) -> float:
    """Predict the tetrahedra of a quarter of the scene: those of the nearest mesh that was run, scaled by volume."""
    cells = TETRAHEDRA * _volume(one.domain) * one.elements_per_wavelength**3
    known = [row for row in ran if row.combination.domain == one.domain]
    if not known:
        return cells
    finer = [
        abs(np.log(row.combination.elements_per_wavelength / one.elements_per_wavelength))
        for row in known
    ]
    nearest = known[int(np.argmin(finer))]
    mesh = nearest.combination
    return (
        cells
        * nearest.tetrahedra
        / (TETRAHEDRA * _volume(mesh.domain) * mesh.elements_per_wavelength**3)
    )


@cache
def _volume(domain: str) -> float:
    """Volume of a quarter of what is meshed, the layer with it [λ³]."""
    length = AIR.wavelength(40e3)
    if domain == "box":
        sides = np.array([BOX[1][0], BOX[1][1], BOX[1][2] - BOX[0][2]]) / length
    else:
        points = np.concatenate([surface.vertices for surface in dummies().surfaces])
        sides = np.ptp(points, axis=0) / length / [2, 2, 1] + MARGIN * np.array([1, 1, 2])
    return float((sides + THICKNESS * np.array([1, 1, 2])).prod())


def shared_unknowns(order: int) -> float:
    """Unknowns for each tetrahedron that it shares with others, which a factor holds.

    >>> shared_unknowns(1), shared_unknowns(3)
    (0.2, 4.6)
    """
    return CORNERS + EDGES * (order - 1) + FACES * (order - 1) * (order - 2) / 2


def predicted(one: Combination, ran: Sequence[Row]) -> tuple[float, float, float]:
    """Predict unknowns, seconds and bytes of a combination.

    Time and memory are taken for sums of four costs: what is always spent, that of each
    tetrahedron, of each entry of its matrix, and a power of the unknowns that the factor holds;
    each is found from the runs by least squares of the relative errors, none below zero.
    """
    cells, order = tetrahedra(one, ran), one.order
    inner = (order - 1) * (order - 2) * (order - 3) / 6
    seconds, size = (
        float(_powers(cells, order, power) @ _fitted(ran, spent, power, start))
        for spent, power, start in (("seconds", SLOWEST, SECONDS), ("most_bytes", HEAVIEST, BYTES))
    )
    return cells * (shared_unknowns(order) + inner), seconds, size


def _powers(cells: float, order: int, power: float) -> Float64[np.ndarray, "4"]:
    local = (order + 1) * (order + 2) * (order + 3) / 6
    return np.array([1.0, cells, cells * local**2, (cells * shared_unknowns(order)) ** power])


def _fitted(
    ran: Sequence[Row], spent: str, power: float, start: Float64[np.ndarray, "4"]
) -> Float64[np.ndarray, "4"]:
    """Fit the four costs to the runs, regularised towards those of the start."""
    rows = [
        _powers(row.tetrahedra, row.combination.order, power) * start / getattr(row, spent)
        for row in ran
    ]
    rows += list(BELIEVED * np.eye(4))
    wanted = np.concatenate([np.ones(len(ran)), np.full(4, BELIEVED)])
    return nnls(np.array(rows), wanted)[0] * start


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
    combination, fingers, array = (
        Combination(*json.loads(sys.argv[1])),
        dummies(),
        surrounding_box(monopole()),
    )
    scene = fingers.scene
    netgen_libraries()
    ngsolve_library()  # loaded before the clock starts
    begun = time.perf_counter()
    field = combination.solver().radiate(scene, fingers.beacon)
    received = field.at(array.positions)[:, 0]
    costs = (
        field.report.settings["tetrahedra"],
        field.report.nodes,
        time.perf_counter() - begun,
        peak(),
    )
    print(json.dumps([*costs, np.real(received).tolist(), np.imag(received).tolist()]))


if __name__ == "__main__":
    main()
