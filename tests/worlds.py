"""Scenes, sources and points that tests of several packages share."""

import numpy as np

import airtact as at

AIR = at.Medium(sound_speed=343.1, density=1.293)
"""The paper's air."""

WAVELENGTH = 343.1 / 40e3


def directions(count: int, seed: int) -> np.ndarray:
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]


def sphere_rule(latitudes: int) -> tuple[np.ndarray, np.ndarray]:
    """Directions and their solid angles: Gauss-Legendre latitudes, twice as many longitudes."""
    cosine, weight = np.polynomial.legendre.leggauss(latitudes)
    turn = np.pi * np.arange(2 * latitudes) / latitudes
    across = np.sqrt(1 - cosine**2)[:, None] * np.exp(1j * turn)
    up = np.broadcast_to(cosine[:, None], across.shape)
    ways = np.stack([across.real, across.imag, up], axis=-1).reshape(-1, 3)
    return ways, np.repeat(weight, 2 * latitudes) * np.pi / latitudes


def far_points(count: int = 60, seed: int = 7) -> np.ndarray:
    """Points 60 to 100 mm from the origin."""
    radius = np.random.default_rng(seed).uniform(0.06, 0.1, size=(count, 1))
    return directions(count, seed + 1) * radius


def one_each(positions: np.ndarray) -> at.Monopoles:
    return at.Monopoles(positions, np.eye(len(positions)))


def hard(*surfaces: at.Surface, frequency: float = 40e3) -> at.Scene:
    return at.Scene(AIR, [at.sound_hard(surface) for surface in surfaces], frequency=frequency)


def ball(radius: float, frequency: float = 40e3) -> at.Scene:
    return hard(at.sphere(radius, radius / 2), frequency=frequency)


def two_fingers(radius: float, tilt: float, gap: float, length: float = 0.044) -> at.Scene:
    """Two capsules whose tips face each other, hanging down and leaning out by a tilt [degrees]."""
    lean = np.radians(tilt)
    fingers = []
    for side in (-1.0, 1.0):
        tip = np.array([side * (0.5 * gap + radius), 0.0, 0.0])
        root = tip + length * np.array([side * np.sin(lean), 0.0, -np.cos(lean)])
        fingers.append(at.capsule(tuple(tip), tuple(root), radius, edge=radius / 2))
    return hard(*fingers)


def finger_sources(scene: at.Scene, offset: float, count: int = 8) -> np.ndarray:
    """Points at an offset from two fingers' tips, in random directions, outside both."""
    capsules = [obstacle.surface.primitive for obstacle in scene.obstacles]
    tips = [capsule.axis[[np.abs(capsule.axis[:, 0]).argmin()]] for capsule in capsules]
    pick = np.random.default_rng(3)
    points: list[np.ndarray] = []
    while len(points) < count:
        way = directions(1, int(pick.integers(1 << 30)))
        point = tips[len(points) % 2] + way * (capsules[0].radius + offset)
        if scene.depth(point)[0] <= -0.999 * offset:
            points.append(point[0])
    return np.array(points)


def outer_points(scene: at.Scene, count: int = 40, seed: int = 11) -> np.ndarray:
    """Points 40 to 60 mm outside the ball around the bodies."""
    corners = np.concatenate([obstacle.surface.vertices for obstacle in scene.obstacles])
    centre = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    extent = np.linalg.norm(corners - centre, axis=1).max()
    distance = extent + np.random.default_rng(seed).uniform(0.04, 0.06, size=(count, 1))
    return centre + distance * directions(count, seed)
