"""Drives that may share their time: every element plays a vector in place of a number, and the best can be found.

Inoue, Makino and Shinoda (IEEE World Haptics 2015) relax the choice of drive to a semidefinite matrix X = V Vᴴ. Its
rows V_e, of length at most 1, are what the elements play, one column a time slot, and a focus gets the root of its mean
square. Going to and fro as in weighted Gerchberg-Saxton, with vectors for numbers, climbs to its optimum, and the
weights met on the way are those of its dual, which bounds every drive.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128, Float64

FULL_RANK = 32
"""More slots than this are not needed: the optimum has fewer where there are that many foci."""

SHRINK = 0.7
"""From a number of slots to the next smaller one, on the way to one."""

TURNS_EACH = 10
"""How often to go to and fro with each number of slots."""


@dataclass(frozen=True, eq=False)
class Slots:
    """Where going to and fro with vectors stands.

    Attributes
    ----------
    directions : (F, R) unit vectors, the phases of each focus over the slots.
    weights : (F,) of the foci, adding up to F.
    loudness : (E,) length of Σ_f conj(H_fe) weight_f direction_f, before it was brought to 1.
    shares : (F,) what each focus got.
    """

    directions: Complex128[np.ndarray, "foci slots"]
    weights: Float64[np.ndarray, "foci"]
    loudness: Float64[np.ndarray, "elements"]
    shares: Float64[np.ndarray, "foci"]


def first_slots(matrix: Complex128[np.ndarray, "foci elements"]) -> Slots:
    """Return the start: each focus in a slot of its own.

    Parameters
    ----------
    matrix : (F, E) rows over what each focus asks.
    """
    foci, elements = matrix.shape
    directions = np.eye(foci, dtype=np.complex128)
    if foci > FULL_RANK:
        random = np.random.default_rng(0).normal(size=(2, foci, FULL_RANK))
        directions = _unit(random[0] + 1j * random[1])
    return Slots(directions, np.ones(foci), np.ones(elements), np.zeros(foci))


def turned(matrix: Complex128[np.ndarray, "foci elements"], slots: Slots, turns: int) -> Slots:
    """Go to and fro, giving foci that lag more weight.

    Parameters
    ----------
    matrix : (F, E) rows over what each focus asks.
    slots : where to start.
    turns : how often.
    """
    back = np.ascontiguousarray(matrix.conj().T)
    directions, weights = slots.directions, slots.weights
    loudness, shares = slots.loudness, slots.shares
    for _ in range(turns):
        sent = back @ (weights[:, None] * directions)
        loudness = np.linalg.norm(sent, axis=1)
        heard = matrix @ (sent / np.maximum(loudness, np.finfo(float).tiny)[:, None])
        shares = np.linalg.norm(heard, axis=1)
        directions = heard / shares[:, None]
        weights = weights * shares.mean() / shares
        weights = weights / weights.mean()
    return Slots(directions, weights, loudness, shares)


def to_one_slot(matrix: Complex128[np.ndarray, "foci elements"], slots: Slots) -> Complex128[np.ndarray, "foci"]:
    """Drop the weakest slots, a few at a time, going to and fro in between, until one is left.

    Parameters
    ----------
    matrix : (F, E) rows over what each focus asks.
    slots : the relaxation's optimum.

    Returns
    -------
    (F,) sources to start weighted Gerchberg-Saxton from.
    """
    rank = slots.directions.shape[1]
    while rank > 1:
        rank = max(1, min(rank - 1, int(rank * SHRINK)))
        # Slots are told apart by how loud they are over the foci, each counted by its weight.
        left, strengths, _ = np.linalg.svd(np.sqrt(slots.weights)[:, None] * slots.directions, full_matrices=False)
        kept = _unit(left[:, :rank] * strengths[:rank])
        slots = turned(matrix, Slots(kept, slots.weights, slots.loudness, slots.shares), TURNS_EACH)
    return slots.weights * slots.directions[:, 0]


def _unit(vectors: Complex128[np.ndarray, "foci slots"]) -> Complex128[np.ndarray, "foci slots"]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), np.finfo(float).tiny)
