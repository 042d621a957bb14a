"""The fields that regular waves make on and under the surfaces of bodies: few patterns of the waves make all of them.

Waves of high order fill a ball, and bodies are a part of it: most patterns of waves hardly reach them. The patterns
that do are the eigenvectors of the mean square pressure of waves on the surfaces and under them. Points under them see
what vanishes on the surface alone, as at an interior resonance.
"""

import numpy as np
import scipy.linalg
from jaxtyping import Float32, Float64

from airtact.mesh.quadratic_triangles import panel_areas, points_at, unit
from airtact.scene.scene import Scene
from airtact.sensing.waves import regular_waves, wave_count

DENSITY = 30
"""Points on the surfaces, per square wavelength."""

UNDER = 0.2
"""Depth of the points under the surfaces, in wavelengths."""

AT_ONCE = 4096
"""Points at which waves are computed at once."""

WORTHWHILE = 0.8
"""Patterns over waves from which on they save no work."""


def reaching_patterns(
    scene: Scene, centre: Float64[np.ndarray, "3"], order: int, least: float
) -> Float64[np.ndarray, "waves patterns"] | None:
    """Orthonormal patterns of regular waves about a centre that reach the bodies; None where nearly all of them do.

    All others make less than ``least`` of the rms pressure of the strongest on and under the surfaces.
    """
    points = _points(scene) - centre
    squares = np.zeros((wave_count(order), wave_count(order)), dtype=np.float32)
    for first in range(0, len(points), AT_ONCE):
        waves = regular_waves(order, points[first : first + AT_ONCE], scene.wavenumber.real).astype(np.float32)
        squares += waves @ waves.T
    values, patterns = _eigenvectors(squares)
    kept = int(np.count_nonzero(values > least**2 * values[-1]))
    return patterns[:, -kept:].astype(np.float64) if kept < WORTHWHILE * len(values) else None


def _eigenvectors(
    squares: Float32[np.ndarray, "waves waves"],
) -> tuple[Float32[np.ndarray, "waves"], Float32[np.ndarray, "waves waves"]]:
    values, patterns = scipy.linalg.eigh(squares, overwrite_a=True, check_finite=False, driver="evd")
    return values, patterns


def _points(scene: Scene) -> Float64[np.ndarray, "points 3"]:
    """Points at random, evenly on the surfaces, and as many under them [m]."""
    random = np.random.default_rng(0)
    surfaces = [one.surface for one in scene.obstacles]
    curved = np.concatenate(
        [np.concatenate([one.corners, one.shape.edge_middles(one.corners)], axis=1) for one in surfaces]
    )
    areas = np.cumsum(panel_areas(curved))
    count = int(np.ceil(DENSITY * areas[-1] / scene.wavelength**2))
    chosen = np.searchsorted(areas, (np.arange(count) + random.random(count)) / count * areas[-1], side="right")
    places = random.random((count, 2))
    places = np.where(places.sum(axis=1, keepdims=True) > 1.0, 1.0 - places, places)
    points, normals = points_at(curved[np.minimum(chosen, len(areas) - 1)], places)
    return np.concatenate([points, points - UNDER * scene.wavelength * unit(normals)])
