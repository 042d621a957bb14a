"""From a scene to a volume mesh, and from Netgen's failures to sentences that name the body."""

import numpy as np
from jaxtyping import Float64, Int64
from scipy.spatial import KDTree

from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.arrays import Points
from airtact.acoustics.solvers.fem.meshing.netgen import NetgenMesh, heeding_interrupts, muted
from airtact.acoustics.solvers.fem.meshing.surface_mesh import SurfaceMesh, surface_mesh
from airtact.acoustics.solvers.fem.meshing.volume import Box, tetrahedra
from airtact.acoustics.solvers.tetrahedra import EDGES, Tetrahedra
from airtact.checks import in_mm
from airtact.errors import InvalidInput
from airtact.geometry.mesh.intersections import self_crossings

SHRINKING = (0.8, 0.5, 0.3)
"""Edges on the surfaces over the edge wanted, tried one after the other until the mesh is whole."""

FOLDED = 0.02
"""Fraction of its straight volume that a curved tetrahedron must keep everywhere."""

VOLUME_OFF = 1e-6
"""Fraction of the box's volume that the tetrahedra may miss."""


def meshed(
    scene: Scene, box: Box, elements_per_wavelength: float, refined: Points
) -> tuple[NetgenMesh, SurfaceMesh, Tetrahedra]:
    """Mesh the air in a box round the bodies, the filled bodies, and the perfectly matched layer.

    Netgen's mesh and the curved tetrahedra are in wavelengths; the bodies' triangles are smaller
    near ``refined`` [m].

    Raises
    ------
    InvalidInput
        When a body cannot be meshed: which, and where.
    """
    shapes = [obstacle.surface.shape for obstacle in scene.obstacles]
    filled = [obstacle.boundary == "filled" for obstacle in scene.obstacles]
    length, size = scene.wavelength, 1 / elements_per_wavelength
    fault = None
    for shrunk in SHRINKING:
        surface = surface_mesh(shapes, shrunk * size * length, box.mirrors, refined)
        with muted(), heeding_interrupts():
            mesh = tetrahedra(surface, box, filled, length, size)
        if not _whole(mesh, box, surface, filled, length):
            fault = _crossing(surface, shrunk * size * length)
            continue
        curved = curved_tetrahedra(mesh, surface, length)
        stretch, number = curved.smallest_stretch()
        if stretch > FOLDED:
            return mesh, surface, curved
        position = curved.corners[number].mean(axis=0) * length
        fault = InvalidInput(
            f"body {_nearest(scene, position)} bends too much for tetrahedra of {1e3 * shrunk * size * length:.3g} mm "
            f"at {in_mm(position)}: one is folded; ask for more elements_per_wavelength, or smooth the body there.",
            position,
            code="mesh_faulty",
        )
    assert fault is not None
    raise fault


def curved_tetrahedra(mesh: NetgenMesh, surface: SurfaceMesh, wavelength: float) -> Tetrahedra:
    """Take the tetrahedra out of a mesh of Netgen's, and bend those beside the bodies to their surfaces."""
    vertices, corners = _straight(mesh)
    own = np.asarray(KDTree(vertices).query(surface.vertices / wavelength)[1])
    triangles = own[surface.triangles]
    ends = np.sort(
        np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2), axis=1
    )
    keys, first = np.unique(ends[:, 0] * len(vertices) + ends[:, 1], return_index=True)
    straight = 0.5 * (vertices[ends[first, 0]] + vertices[ends[first, 1]])
    bend = surface.middles.reshape(-1, 3)[first] / wavelength - straight
    wanted = np.sort(corners[:, EDGES], axis=2) @ [len(vertices), 1]
    found = np.minimum(np.searchsorted(keys, wanted.ravel()), len(keys) - 1).reshape(wanted.shape)
    bends = np.where((keys[found] == wanted)[:, :, None], bend[found], 0.0)
    return Tetrahedra(vertices[corners], bends)


def _straight(
    mesh: NetgenMesh,
) -> tuple[Float64[np.ndarray, "vertices 3"], Int64[np.ndarray, "tetrahedra 4"]]:
    """Vertices and corners of the tetrahedra of a mesh of Netgen's."""
    corners = mesh.Elements3D().NumPy()["nodes"][:, :4].astype(np.int64) - 1
    return np.array(mesh.Coordinates(), dtype=np.float64), corners


def _whole(
    mesh: NetgenMesh, box: Box, surface: SurfaceMesh, filled: list[bool], length: float
) -> bool:
    """Whether tetrahedra fill the box but for the bodies that no sound enters."""
    vertices, corners = _straight(mesh)
    if not len(corners):
        return False
    four = vertices[corners]
    found = np.abs(np.linalg.det(four[:, 1:] - four[:, :1])).sum() / 6
    wanted = float((box.outer_high - box.outer_low).prod())
    shut = ~np.array(filled)[surface.body]
    if shut.any():
        middle = np.array(box.low)  # on all mirrors, so that the cuts there count nothing
        flat = surface.vertices[surface.triangles[shut]] - middle
        wanted -= float(np.linalg.det(flat).sum()) / 6
    return bool(abs(found * length**3 / wanted - 1) < VOLUME_OFF)


def _crossing(surface: SurfaceMesh, edge: float) -> InvalidInput:
    pairs = self_crossings(surface.vertices[surface.triangles], surface.triangles)
    if not len(pairs):
        return InvalidInput(
            f"Netgen cannot fill the box round the bodies with tetrahedra, their surfaces having "
            f"{len(surface.triangles)} triangles of {1e3 * edge:.3g} mm; give smoother or thicker bodies, or take "
            "BoundaryElement.",
            code="mesh_faulty",
        )
    one, other = surface.body[pairs[0]]
    position = surface.vertices[surface.triangles[pairs[0]]].mean(axis=(0, 1))
    whom = f"body {one} crosses itself" if one == other else f"bodies {one} and {other} cross"
    return InvalidInput(
        f"{whom} at {in_mm(position)} when meshed with triangles of {1e3 * edge:.3g} mm ({len(pairs)} pairs of them): "
        "too thin or too near for these; ask for more elements_per_wavelength, thicken the body or move it away.",
        position,
        code="bodies_overlap",
    )


def _nearest(scene: Scene, position: np.ndarray) -> int:
    return int(
        np.argmax([obstacle.surface.depth(position[None])[0] for obstacle in scene.obstacles])
    )
