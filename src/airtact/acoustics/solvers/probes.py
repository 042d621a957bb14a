"""Points around the bodies where two solutions are compared."""

import numpy as np
from jaxtyping import Float64

from airtact.acoustics.scene import Scene


def surrounding_points(
    scene: Scene, points: Float64[np.ndarray, "nodes 3"]
) -> Float64[np.ndarray, "around 3"]:
    """Return 128 points spread over a sphere 8 λ outside the bodies, where the array would be."""
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    radius = np.linalg.norm(points - centre, axis=1).max() + 8 * scene.wavelength
    index = np.arange(128) + 0.5
    polar, azimuth = np.arccos(1 - index / 64), np.pi * (1 + np.sqrt(5)) * index
    directions = np.stack(
        [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=1
    )
    return centre + radius * directions
