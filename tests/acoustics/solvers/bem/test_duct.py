"""Sound between walls that face each other, against the sum over all images of the source, where air absorbs."""

import numpy as np
import pytest
from manifold3d import Manifold

import airtact as at

DULL = at.Medium(sound_speed=343.1, density=1.293, absorption=40.0)
"""Air in which hardly any sound comes back from the ends of the duct."""

WIDE, LONG, WALL = 24e-3, 80e-3, 5e-3
SOURCE = np.array([[3e-3, -2e-3, 1e-3]])


def duct() -> at.Surface:
    """Make a square duct about the z axis, open at both ends."""
    outside = Manifold.cube([WIDE + 2 * WALL, WIDE + 2 * WALL, LONG], True)
    mesh = (outside - Manifold.cube([WIDE, WIDE, 2 * LONG], True)).to_mesh64()
    return at.Surface(
        np.asarray(mesh.vert_properties)[:, :3], np.asarray(mesh.tri_verts).astype(np.int64)
    )


def by_images(points: np.ndarray, wavenumber: complex) -> np.ndarray:
    """Pressure in a duct without ends: the source is mirrored in both pairs of walls."""
    orders = np.arange(-60, 61)
    x, y = (orders * WIDE + (-1.0) ** orders * start for start in SOURCE[0, :2])
    images = np.stack(np.broadcast_arrays(x[:, None], y[None, :], SOURCE[0, 2]), axis=-1).reshape(
        -1, 3
    )
    distance = np.linalg.norm(points[:, None] - images, axis=2)
    return (np.exp(1j * wavenumber * distance) / distance).sum(axis=1)


@pytest.mark.parametrize("estimate", [True, False])
def test_facing_walls_hold_the_sound_as_images_say(estimate):
    """Panels that suit a body in the open are 8 % off here."""
    scene = at.Scene(DULL, [at.acoustics.Obstacle(duct(), "sound_hard", board=True)])
    random = np.random.default_rng(0)
    within = np.column_stack(
        [random.uniform(-9e-3, 9e-3, (40, 2)), random.uniform(-12e-3, 12e-3, 40)]
    )
    within = within[np.linalg.norm(within - SOURCE, axis=1) > 3e-3]
    on_wall = within * [0.0, 1.0, 1.0] + [0.5 * WIDE, 0.0, 0.0]
    field = at.BoundaryElement(0.05, estimate=estimate).radiate(
        scene, at.Monopoles(SOURCE, np.ones(1))
    )
    errors = []
    for points in (within, on_wall):
        exact = by_images(points, scene.wavenumber)
        errors.append(np.linalg.norm(field.at(points)[:, 0] - exact) / np.linalg.norm(exact))
    assert max(errors) < 0.02
    estimated = field.report.estimated_error
    assert 0.5 * max(errors) < estimated < 3 * max(errors) if estimate else np.isnan(estimated)
