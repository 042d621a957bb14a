"""Fifty closed meshes as people bring them: primitives of a mesher, what booleans leave, rough ones and the hand."""

from collections.abc import Iterator

import numpy as np
import trimesh
from trimesh import boolean, creation

from references.damaged_meshes import hand

Mesh = tuple[np.ndarray, np.ndarray]


def assorted() -> Iterator[tuple[str, Mesh]]:
    """Names, vertices [m] and triangles."""
    for name, mesh in [*_round(), *_sharp(), *_combined()]:
        yield name, (1e-3 * np.asarray(mesh.vertices), np.array(mesh.faces, dtype=np.int64))
    yield "hand", hand()
    yield "hand in small triangles", _subdivided(*hand())


def _subdivided(vertices: np.ndarray, triangles: np.ndarray) -> Mesh:
    mesh = trimesh.Trimesh(vertices, triangles, process=False).subdivide()
    return np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int64)


def _stretched(mesh: trimesh.Trimesh, *factors: float) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices * factors, mesh.faces, process=False)


def _moved(
    mesh: trimesh.Trimesh, x: float, y: float, z: float, turn: float = 0.0
) -> trimesh.Trimesh:
    mesh = mesh.copy()
    mesh.apply_transform(trimesh.transformations.rotation_matrix(turn, [1.0, 0.3, 0.0]))
    mesh.apply_translation([x, y, z])
    return mesh


def _round() -> Iterator[tuple[str, trimesh.Trimesh]]:
    for level in (2, 3, 4):
        yield f"ball {level}", creation.icosphere(level, radius=10.0)
    yield "globe", creation.uv_sphere(radius=10.0, count=[40, 40])
    yield "bead", creation.icosphere(3, radius=0.5)
    yield "ellipsoid", _stretched(creation.icosphere(3), 15.0, 10.0, 7.0)
    yield "cigar", _stretched(creation.icosphere(4), 4.0, 4.0, 30.0)
    yield "lens", _stretched(creation.icosphere(4), 15.0, 15.0, 3.0)
    yield "capsule", creation.capsule(30.0, 8.0, count=[16, 16])
    yield "thin capsule", creation.capsule(40.0, 2.0, count=[24, 24])
    yield "torus", creation.torus(15.0, 5.0, 48, 24)
    yield "thin torus", creation.torus(20.0, 1.0, 120, 24)
    rough = creation.icosphere(5, radius=10.0)
    noise = np.random.default_rng(5).normal(scale=0.02, size=rough.vertices.shape)
    yield "rough ball", trimesh.Trimesh(rough.vertices + noise, rough.faces, process=False)
    waves = 1 + 0.1 * np.sin(4 * creation.icosphere(4).vertices).sum(axis=1)
    yield (
        "bumpy ball",
        trimesh.Trimesh(
            9.0 * waves[:, None] * creation.icosphere(4).vertices, creation.icosphere(4).faces
        ),
    )


def _sharp() -> Iterator[tuple[str, trimesh.Trimesh]]:
    yield "cube", creation.box((15.0, 15.0, 15.0))
    yield "brick", creation.box((30.0, 10.0, 5.0))
    yield "plate", creation.box((20.0, 20.0, 0.6))
    yield "long plate", creation.box((60.0, 10.0, 1.0))
    yield "stick", creation.box((1.0, 1.0, 40.0))
    for sections in (6, 12, 24, 64):
        yield f"cylinder {sections}", creation.cylinder(8.0, 20.0, sections=sections)
    yield "disc", creation.cylinder(15.0, 0.8, sections=48)
    yield "needle", creation.cylinder(0.5, 40.0, sections=16)
    yield "cone", creation.cone(8.0, 20.0, sections=32)
    yield "flat cone", creation.cone(15.0, 4.0, sections=32)
    yield "ring", creation.annulus(8.0, 15.0, 10.0, sections=48)
    yield "tube", creation.annulus(14.0, 15.0, 20.0, sections=48)
    facets = creation.icosahedron()
    facets.apply_scale(12.0)
    yield "icosahedron", facets
    corner = 10.0 * np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0], [0, 0, 2]])
    yield "tetrahedron", trimesh.Trimesh(corner, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    ends = 10.0 * np.array([[0, 0, 0], [3, 0, 0], [0, 2, 0], [3, 2, 0], [0, 0, 1], [3, 0, 1]])
    sides = [[0, 2, 1], [1, 2, 3], [0, 1, 4], [1, 5, 4], [0, 4, 2], [1, 3, 5], [2, 4, 5], [2, 5, 3]]
    yield "wedge", trimesh.Trimesh(ends, sides)


def _combined() -> Iterator[tuple[str, trimesh.Trimesh]]:
    ball, cube = creation.icosphere(3, radius=10.0), creation.box((15.0, 15.0, 15.0))
    rod = _moved(creation.cylinder(4.0, 40.0, sections=32), 0.0, 0.0, 0.0, turn=0.4)
    for name, operation in (
        ("and", boolean.union),
        ("less", boolean.difference),
        ("within", boolean.intersection),
    ):
        yield f"cube {name} ball", operation([cube, _moved(ball, 5.0, 3.0, 2.0)])
        yield f"cube {name} rod", operation([cube, rod])
        yield f"ball {name} rod", operation([ball, rod])
    yield "two balls", boolean.union([ball, _moved(ball, 14.0, 0.0, 0.0)])
    outer, inner = (
        creation.cylinder(15.0, 30.0, sections=48),
        creation.cylinder(13.0, 30.0, sections=48),
    )
    yield "mug", boolean.difference([outer, _moved(inner, 0.0, 0.0, 3.0)])
    drill = creation.cylinder(3.0, 10.0, sections=24)
    drills = [_moved(drill, x, y, 0.0) for x in (-8.0, 8.0) for y in (-8.0, 8.0)]
    yield "plate with holes", boolean.difference([creation.box((30.0, 30.0, 3.0)), *drills])
    yield (
        "cross",
        boolean.union([creation.box(size) for size in ((30, 6, 6), (6, 30, 6), (6, 6, 30))]),
    )
    yield (
        "cube with a fin",
        boolean.union([cube, _moved(creation.box((0.5, 10.0, 20.0)), 0.0, 0.0, 12.0)]),
    )
    rng = np.random.default_rng(0)
    yield (
        "heap",
        boolean.union(
            [_moved(creation.icosphere(3, 6.0), *rng.normal(scale=8.0, size=3)) for _ in range(6)]
        ),
    )
    stairs = [
        _moved(creation.box((5.0, 20.0, 5.0 * i)), 5.0 * i, 0.0, 2.5 * i) for i in range(1, 5)
    ]
    yield "stairs", boolean.union(stairs)
