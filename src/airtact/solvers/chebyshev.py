"""Interpolation between Chebyshev's points."""

import numpy as np
from jaxtyping import Float, Float32


def chebyshev_weights(places: Float[np.ndarray, "points"], count: int) -> Float32[np.ndarray, "points count"]:
    """Weights of the points cos(π (j + 1/2)/count) for places in [-1, 1], in the precision that the places have.

    By the barycentric formula (J.-P. Berrut, L. N. Trefethen, SIAM Review 46 (2004) 501).
    """
    angles = np.pi * (np.arange(count) + 0.5) / count
    off = places[:, None] - np.cos(angles).astype(places.dtype)
    off[off == 0] = 1e-30
    weights = ((-1.0) ** np.arange(count) * np.sin(angles)).astype(places.dtype) / off
    return (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32, copy=False)
