"""Meshes to be damaged, and how a repaired one is held against them."""

import numpy as np
import trimesh

import airtact as at
from airtact.geometry.checks import check_surface
from airtact.geometry.mesh.repair import RepairedMesh, repaired
from airtact.geometry.mesh.triangles import cone_volumes
from geometry.mesh.meshes import flat_mesh

Mesh = tuple[np.ndarray, np.ndarray]


def ball(subdivisions: int = 4, radius: float = 0.008) -> Mesh:
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=1.0)
    return radius * np.asarray(mesh.vertices), np.array(mesh.faces)


def fine_box(edge: float = 1.0, size=(10.0, 12.0, 14.0)) -> Mesh:
    mesh = trimesh.creation.box(size).subdivide_to_size(edge)
    mesh.merge_vertices()
    return 1e-3 * np.asarray(mesh.vertices), np.array(mesh.faces)


def tube(radius: float, length: float, sections: int = 24, rings: int = 30) -> Mesh:
    """The side of a cylinder about z, open at both ends."""
    angle = 2 * np.pi * np.arange(sections) / sections
    rim = radius * np.stack([np.cos(angle), np.sin(angle), np.zeros(sections)], axis=1)
    vertices = np.concatenate([rim + [0.0, 0.0, z] for z in np.linspace(0.0, length, rings)])
    i, j = np.meshgrid(np.arange(rings - 1), np.arange(sections), indexing="ij")
    a = i * sections + j
    b = i * sections + (j + 1) % sections
    triangles = np.stack([a, b, b + sections, a, b + sections, a + sections], axis=2).reshape(-1, 3)
    return vertices, triangles


def joined(one: Mesh, two: Mesh) -> Mesh:
    return np.vstack([one[0], two[0]]), np.vstack([one[1], two[1] + len(one[0])])


def volume(vertices: np.ndarray, triangles: np.ndarray) -> float:
    return float(cone_volumes(vertices[triangles]).sum())


def accepted(vertices: np.ndarray, triangles: np.ndarray, **settings) -> RepairedMesh:
    result = repaired(vertices, triangles, **settings)
    check_surface(at.Surface(result.vertices, result.triangles, repairs=result.notes))
    return result


def distance(one: Mesh, other: Mesh) -> float:
    """Farthest that a vertex or middle of a triangle of one mesh lies off the other [m]."""
    points = np.concatenate([one[0][np.unique(one[1])], one[0][one[1]].mean(axis=1)])
    return float(np.abs(flat_mesh(other[0], other[1]).depth(points)).max())


def apart(one: Mesh, other: Mesh) -> float:
    return max(distance(one, other), distance(other, one))


def near(vertices: np.ndarray, triangles: np.ndarray, point) -> np.ndarray:
    """Triangles in the order of how near their middle is to a point."""
    return np.argsort(np.linalg.norm(vertices[triangles].mean(axis=1) - point, axis=1))
