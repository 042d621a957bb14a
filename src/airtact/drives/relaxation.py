"""Drives that may share their time: the relaxation in which each element emits a vector, and the way back to one drive.

Inoue, Makino and Shinoda (IEEE World Haptics 2015) relax the choice of drive to a semidefinite
matrix X = V Vᴴ. Row V_e of the factor, of length at most 1, has what element e emits in each of R
time intervals, and the pressure of a focus is the root of its mean square. Alternating projections
as in weighted Gerchberg-Saxton, with vectors in place of numbers, converge to the optimum, and the
weights on the way are those of its dual, which bounds every drive.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex128, Float64

FULL_RANK = 32
"""A larger rank R is not needed: the optimum has less with that many foci."""

SHRINK = 0.7
"""Factor from one rank to the next smaller one, on the way to rank one."""

ITERATIONS_EACH = 10
"""Iterations at each rank on that way."""


@dataclass(frozen=True, eq=False)
class Relaxed:
    """The state of the alternating projections with vectors.

    Directions are unit vectors: amplitude and phase of each focus over the R time intervals.
    Weights add up to F. Norms are lengths of Σ_f conj(H_fe) weight_f direction_f before scaling to
    1. Pressures are over what each focus asks.
    """

    directions: Complex128[np.ndarray, "foci rank"]
    weights: Float64[np.ndarray, "foci"]
    norms: Float64[np.ndarray, "elements"]
    pressures: Float64[np.ndarray, "foci"]


def starting_point(matrix: Complex128[np.ndarray, "foci elements"]) -> Relaxed:
    """Give each focus a time interval of its own; ``matrix`` has rows over what each focus asks."""
    foci, elements = matrix.shape
    directions = np.eye(foci, dtype=np.complex128)
    if foci > FULL_RANK:
        random = np.random.default_rng(0).normal(size=(2, foci, FULL_RANK))
        directions = _unit(random[0] + 1j * random[1])
    return Relaxed(directions, np.ones(foci), np.ones(elements), np.zeros(foci))


def iterated(
    matrix: Complex128[np.ndarray, "foci elements"], start: Relaxed, iterations: int
) -> Relaxed:
    """Alternate between elements and foci, giving foci that lag more weight."""
    back = np.ascontiguousarray(matrix.conj().T)
    directions, weights, norms, pressures = (
        start.directions,
        start.weights,
        start.norms,
        start.pressures,
    )
    for _ in range(iterations):
        sent = back @ (weights[:, None] * directions)
        norms = np.linalg.norm(sent, axis=1)
        received = matrix @ (sent / np.maximum(norms, np.finfo(float).tiny)[:, None])
        pressures = np.linalg.norm(received, axis=1)
        directions = received / pressures[:, None]
        weights = weights * pressures.mean() / pressures
        weights = weights / weights.mean()
    return Relaxed(directions, weights, norms, pressures)


def to_rank_one(
    matrix: Complex128[np.ndarray, "foci elements"], relaxed: Relaxed
) -> Complex128[np.ndarray, "foci"]:
    """Drop the weakest directions, a few at a time with iterations in between; return sources of the one left."""
    rank = relaxed.directions.shape[1]
    while rank > 1:
        rank = max(1, min(rank - 1, int(rank * SHRINK)))
        # The principal directions over the foci, each counted by its weight.
        left, strengths, _ = np.linalg.svd(
            np.sqrt(relaxed.weights)[:, None] * relaxed.directions, full_matrices=False
        )
        strongest = _unit(left[:, :rank] * strengths[:rank])
        relaxed = iterated(matrix, replace(relaxed, directions=strongest), ITERATIONS_EACH)
    return relaxed.weights * relaxed.directions[:, 0]


def _unit(vectors: Complex128[np.ndarray, "foci rank"]) -> Complex128[np.ndarray, "foci rank"]:
    return vectors / np.maximum(
        np.linalg.norm(vectors, axis=1, keepdims=True), np.finfo(float).tiny
    )
