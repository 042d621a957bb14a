"""Interpolation between Chebyshev points."""

import numpy as np
from jaxtyping import Float, Float32


def chebyshev_weights(
    coordinates: Float[np.ndarray, "points"], count: int
) -> Float32[np.ndarray, "points count"]:
    """Return the weights of the points cos(π (j + 1/2)/count) for coordinates in [-1, 1].

    The barycentric formula is that of J.-P. Berrut, L. N. Trefethen, SIAM Review 46 (2004) 501.
    """
    angles = np.pi * (np.arange(count) + 0.5) / count
    off = coordinates[:, None] - np.cos(angles).astype(coordinates.dtype)
    off[off == 0] = 1e-30
    weights = ((-1.0) ** np.arange(count) * np.sin(angles)).astype(coordinates.dtype) / off
    return (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32, copy=False)
