"""How sure it is what echoes say, from derivatives of the echoes and from what is left unexplained."""

import numpy as np
from jaxtyping import Complex, Float64
from scipy.cluster.vq import kmeans2

from airtact.sensing.echo_model import Received

GROUPS = 16
"""Groups of neighbouring receivers that are compared for how sure a pose is."""


def power(pressures: Received) -> float:
    """Sum of squares [Pa²]."""
    return float(np.sum(np.abs(pressures) ** 2, dtype=np.float64))


def information_of(
    by: Complex[np.ndarray, "unknowns receivers transmissions"],
) -> Float64[np.ndarray, "unknowns unknowns"]:
    """Real part of the products of derivatives."""
    parts = np.ascontiguousarray(by).reshape(len(by), -1).view(np.real(by).dtype)
    return (parts @ parts.T).astype(np.float64)


def disagreement(
    by: Complex[np.ndarray, "unknowns receivers transmissions"],
    residual: Received,
    inverse: Float64[np.ndarray, "unknowns unknowns"],
    places: Float64[np.ndarray, "receivers 3"],
) -> float:
    """How much more receivers in different places disagree about the pose than noise would make them; about 1 for that.

    What a wrong shape leaves unexplained is alike at neighbouring receivers, so that many of them
    make the pose no surer. Groups of neighbours are taken as the independent data, as in K.-Y.
    Liang and S. L. Zeger, Biometrika 73, 13 (1986): the mean over all unknowns of the variance by
    groups over that of independent receivers.
    """
    count = min(GROUPS, len(places) // 4)
    if count < 2:
        return 1.0
    groups = kmeans2(places, count, rng=0, minit="++")[1]
    scores = np.real(by.conj() * residual).sum(axis=2, dtype=np.float64)
    summed = np.stack([np.bincount(groups, one, count) for one in scores])
    mean = power(residual) / max(np.count_nonzero(residual), 1) / 2.0
    return float(np.sum(summed * (inverse @ summed))) * count / (count - 1) / (mean * len(by))
