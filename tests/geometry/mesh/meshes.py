"""Meshes that several tests of the scene need."""

import numpy as np

from airtact.geometry.mesh_shape import QuadraticMesh


def box_mesh(low=(0.0, 0.0, 0.0), high=(0.02, 0.03, 0.04)) -> tuple[np.ndarray, np.ndarray]:
    """Twelve outward triangles of an upright box."""
    bits = np.array([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)])
    quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
    triangles = np.array([t for a, b, c, d in quads for t in ([a, b, c], [a, c, d])])
    return low + bits * np.subtract(high, low), triangles


def torus_mesh(
    large: float, small: float, around: int = 24, across: int = 12
) -> tuple[np.ndarray, np.ndarray]:
    """A torus about z; it crosses itself near the axis when the tube is thicker than its ring."""
    u, v = np.meshgrid(np.arange(around), np.arange(across), indexing="ij")
    phi = 2 * np.pi * u / around
    theta = 2 * np.pi * v / across
    ring = large + small * np.cos(theta)
    vertices = np.stack(
        [ring * np.cos(phi), ring * np.sin(phi), small * np.sin(theta)], axis=2
    ).reshape(-1, 3)
    a = u * across + v
    b = (u + 1) % around * across + v
    c = (u + 1) % around * across + (v + 1) % across
    d = u * across + (v + 1) % across
    triangles = np.concatenate([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)])
    return vertices, triangles.reshape(-1, 3)


def flat_mesh(vertices: np.ndarray, triangles: np.ndarray) -> QuadraticMesh:
    """Unchecked flat triangles, whose ``depth`` is the distance to them, positive inside."""
    corners = np.asarray(vertices)[triangles]
    straight = 0.5 * (corners + np.roll(corners, -1, axis=1))
    return QuadraticMesh(
        np.asarray(vertices), triangles, straight, 0.0, np.zeros(triangles.shape, dtype=bool)
    )
