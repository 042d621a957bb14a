"""Drives for a hand that the predictor is not sure of: the sound is to reach each focus wherever it may be."""

from functools import cache

import numpy as np
from jaxtyping import Complex128, Float64
from scipy.special import ndtri

from airtact.acoustics.target import Target
from airtact.drives.gerchberg_saxton import weighted_gerchberg_saxton
from airtact.drives.samples.robust import balanced, improved
from airtact.drives.transfer import TransferMatrix
from airtact.live.parts import LiveScene

SHARE = 1.0 / 3.0
"""Share of the predictor's spread by which foci are off against each other: 0.27 to 0.39 for 1 and 2 mm of noise, in
the box and before flat boards of ``benchmarks/live.py``. All foci together are off by more, which
counts for less."""

SURE, MOST = 0.2e-3, 1.5e-3
"""Foci that are off by less are taken as sure; no drive makes up for more [m]."""

MOST_ROWS = 48
"""Samples times foci at most: so many are a millisecond or two."""

STEPS = 30
"""Steps that balance the foci of the nominal matrix."""


def off_by(spread: float) -> float:
    """Return by how much each focus is taken to be off along each axis [m] where the predictor's spread is so large."""
    off = SHARE * spread
    return 0.0 if off < SURE else min(off, MOST)


def robust_drive(
    scene: LiveScene,
    rows: Complex128[np.ndarray, "foci sounding"],
    foci: Float64[np.ndarray, "foci 3"],
    spread: float,
    phases: bool,
) -> Complex128[np.ndarray, "elements"]:
    """Make the drive whose weakest focus keeps most in the lowest tenth of what may be.

    Parameters
    ----------
    scene : its array, medium and frequency count.
    rows : (F, R) pressure at the foci per unit drive of each element and image, where they are
        expected [Pa].
    foci : (F, 3) where they are expected [m].
    spread : standard deviation of each coordinate of the prediction [m].
    phases : whether every element is at full scale; otherwise the energy of the drive is what it
        costs.

    Returns
    -------
    (E,) amplitudes, the largest of magnitude 1; where the foci are sure, those of the strongest weakest focus.
    """
    expected, fold = scene.sounding.folded(rows), scene.sounding.folded
    start = balanced(expected, False, STEPS)
    if phases:
        start = weighted_gerchberg_saxton(
            TransferMatrix(expected, float("nan")), Target(foci)
        ).amplitudes
    off = off_by(spread)
    if not off:
        return start / np.abs(start).max()
    return improved(
        fold(displaced(scene, rows, foci, off)), start, "phases" if phases else "energy"
    )


def displaced(
    scene: LiveScene,
    rows: Complex128[np.ndarray, "foci elements"],
    foci: Float64[np.ndarray, "foci 3"],
    off: float,
) -> Complex128[np.ndarray, "samples foci elements"]:
    """Return the rows of foci that are each off by so much along each axis [m]: what the hand does moves with them.

    An element is far away against ``off``: the phase of its sound changes by the shift along its
    direction.
    """
    ways = foci[:, None] - scene.sounding.array.positions
    ways = ways / np.linalg.norm(ways, axis=2, keepdims=True)
    wavenumber = scene.medium.wavenumber(scene.frequency).real
    shifts = wavenumber * off * _deviations(len(foci))
    delay = np.einsum(
        "sfd,fed->sfe", shifts.astype(np.float32), ways.astype(np.float32), optimize=True
    )
    turn = np.empty(delay.shape, dtype=np.complex64)
    turn.real, turn.imag = np.cos(delay), np.sin(delay)
    return rows * turn


@cache
def _deviations(foci: int) -> Float64[np.ndarray, "samples foci 3"]:
    """Draw antithetic deviations of unit variance from scrambled Sobol points."""
    from scipy.stats import qmc

    pairs = 8 if 16 * foci <= MOST_ROWS else 4
    numbers = qmc.Sobol(3 * foci, scramble=True, rng=np.random.default_rng(0)).random(pairs)
    normal = ndtri(np.clip(numbers, 1e-6, 1.0 - 1e-6))
    return np.concatenate([normal, -normal]).reshape(2 * pairs, foci, 3)
