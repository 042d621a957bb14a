"""A sphere before a rigid plane: by the multipoles of two spheres, itself and its image, with images of the sources."""

import numpy as np

import airtact as at
from references import two_spheres


def sphere_pressure(
    scene: at.Scene, sources: np.ndarray, receivers: np.ndarray
) -> tuple[np.ndarray, float]:
    """Total pressure of unit monopoles before the plane and the one sphere of a scene.

    Returns
    -------
    (P, N) pressure [Pa] and the own error, as of ``two_spheres.pressure_at``.
    """
    (plane,), ball = scene.planes, scene.obstacles[0].surface.primitive
    centre = ball.axis[:1]
    image = at.sphere(ball.radius, ball.radius, centre=tuple(_mirrored(plane, centre)[0])).primitive
    both = np.concatenate([sources, _mirrored(plane, sources)])
    ratio = scene.obstacles[0].ratio
    admittances = 2 * (0.0 if ratio is None else 1.0 / ratio,)
    pressure, own = two_spheres.pressure_at(
        [ball, image], scene.wavenumber, both, receivers, admittances=admittances
    )
    return pressure[:, : len(sources)] + pressure[:, len(sources) :], own


def _mirrored(plane, points: np.ndarray) -> np.ndarray:
    across = np.eye(3) - 2 * np.outer(plane.normal, plane.normal)
    return (points - plane.point) @ across + plane.point
