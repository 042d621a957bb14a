"""Prediction of the cost of a combination of order, mesh and domain from those that were run before it."""

from collections.abc import Sequence
from functools import cache

import numpy as np
from jaxtyping import Float64
from scipy.optimize import nnls

from airtact.experiments.dummies import AIR, dummies
from airtact.experiments.mesh_run import BOX, Combination, Row
from airtact.solvers.fem.pml import THICKNESS
from airtact.solvers.fem.solver import MARGIN

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


def tetrahedra(one: Combination, ran: Sequence[Row]) -> float:
    """Predict the tetrahedra of a quarter of the scene: those of the nearest mesh that was run, scaled by volume."""
    cells = TETRAHEDRA * _volume(one.domain) * one.elements_per_wavelength**3
    known = [row for row in ran if row.combination.domain == one.domain]
    if not known:
        return cells
    finer = [abs(np.log(row.combination.elements_per_wavelength / one.elements_per_wavelength)) for row in known]
    nearest = known[int(np.argmin(finer))]
    mesh = nearest.combination
    return cells * nearest.tetrahedra / (TETRAHEDRA * _volume(mesh.domain) * mesh.elements_per_wavelength**3)


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

    Time and memory are taken for sums of four costs: what is always spent, that of each tetrahedron, of each entry of
    its matrix, and a power of the unknowns that the factor holds; each is found from the runs by least squares of the
    relative errors, none below zero.
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


def _fitted(ran: Sequence[Row], spent: str, power: float, start: Float64[np.ndarray, "4"]) -> Float64[np.ndarray, "4"]:
    """Fit the four costs to the runs, regularised towards those of the start."""
    rows = [_powers(row.tetrahedra, row.combination.order, power) * start / getattr(row, spent) for row in ran]
    rows += list(BELIEVED * np.eye(4))
    wanted = np.concatenate([np.ones(len(ran)), np.full(4, BELIEVED)])
    return nnls(np.array(rows), wanted)[0] * start
