"""Drives for foci of different strengths, some of which may be off or out of reach."""

import numpy as np
from jaxtyping import Float64
from scipy.spatial.distance import cdist

from airtact.acoustics.target import Target
from airtact.drives.gerchberg_saxton import best_sources, phase, starting_sources
from airtact.drives.methods import METHODS
from airtact.drives.transfer import TransferMatrix
from airtact.live.scene import Amplitudes, Foci, LiveScene, Rows


def balanced(
    scene: LiveScene,
    method: str,
    rows: Rows,
    foci: Foci,
    strengths: Float64[np.ndarray, "foci"],
) -> Amplitudes:
    """Compute a drive whose pressures at the foci are proportional to their strengths.

    Parameters
    ----------
    scene : scene of the live loop.
    method : name of the method; "best" stands for weighted Gerchberg-Saxton, which takes less than
        1 ms and reaches a pressure within 1 % of that of the slower function ``best``.
    rows : (F, R) pressure at each focus per unit drive of each source [Pa].
    foci : (F, 3) positions of the foci [m].
    strengths : (F,) strengths of the foci, from 0 to 1.

    Returns
    -------
    (E,) amplitudes; the largest equals the strength of the strongest focus. A focus is omitted if a
    stronger one is within a quarter of a wavelength. It is also omitted if the largest pressure
    that the array can produce there is less than 5 % of the median over the foci.
    """
    folded = scene.with_images.folded(rows)
    attainable = np.abs(folded).sum(axis=1)
    # A weaker focus cannot be felt, but would reduce the pressure at the others.
    on = np.flatnonzero(strengths > 0.01)
    if not len(on):
        return np.zeros(folded.shape[1], dtype=np.complex128)
    shadowed = attainable < 0.05 * np.median(attainable[on])
    close = cdist(foci, foci) < 0.25 * scene.medium.wavelength(scene.frequency)
    chosen: list[int] = []
    for index in on[np.argsort(-strengths[on], kind="stable")].tolist():
        if not (shadowed[index] or close[index, chosen].any()):
            chosen.append(index)
    if not chosen or not attainable[chosen].all():
        return np.zeros(folded.shape[1], dtype=np.complex128)
    shares = strengths[chosen]
    folded = folded[chosen]
    if method != "best":
        transfer = TransferMatrix(folded, float("nan"))
        made = METHODS[method](transfer, Target(foci[chosen], shares=shares)).amplitudes
    elif len(chosen) == 1:
        made = phase(folded[0]).conj()  # exact solution for a single focus
    else:
        # ``weighted_gerchberg_saxton`` would repeat the checks above.
        start = starting_sources(folded, shares)
        made = phase(folded.conj().T @ best_sources(folded, shares, start, iterations=50))
    return float(shares.max()) * made
