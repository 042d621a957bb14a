"""From a scene to a volume mesh, and from Netgen's failures to sentences that name the body."""

import numpy as np

from airtact.conventions import InvalidInput
from airtact.mesh.intersections import self_crossings
from airtact.scene.scene import Scene
from airtact.solvers.fem.meshing.netgen import NetgenMesh, heeding_interrupts, muted
from airtact.solvers.fem.meshing.skin import SkinMesh, skin_mesh
from airtact.solvers.fem.meshing.tetrahedra import curved_tetrahedra
from airtact.solvers.fem.meshing.volume import Box, flat_faces, tetrahedra
from airtact.solvers.tetrahedra import Tetrahedra
from airtact.validation import in_mm

FINER = (0.8, 0.5, 0.3)
"""Edges on the skins over the edge wanted, tried one after the other until the mesh is whole."""

FOLDED = 0.02
"""Share of its straight volume that a curved tetrahedron must keep everywhere."""

VOLUME_OFF = 1e-6
"""Share of the box's volume that the tetrahedra may miss."""


def meshed(scene: Scene, box: Box, elements_per_wavelength: float) -> tuple[NetgenMesh, SkinMesh, Tetrahedra]:
    """Mesh the air in a box round the bodies, the filled bodies, and the matched layer.

    Parameters
    ----------
    scene : the bodies.
    box : what is meshed.
    elements_per_wavelength : wavelength over the edge wanted.

    Returns
    -------
    Netgen's mesh in wavelengths, the bodies' triangles, and the curved tetrahedra.

    Raises
    ------
    InvalidInput
        When a body cannot be meshed: which, and where.
    """
    shapes = [obstacle.surface.shape for obstacle in scene.obstacles]
    filled = [obstacle.boundary == "filled" for obstacle in scene.obstacles]
    length, size = scene.wavelength, 1 / elements_per_wavelength
    fault = None
    for finer in FINER:
        skin = skin_mesh(shapes, finer * size * length, box.mirrors)
        planes = flat_faces(skin, box, filled, length, size)
        with muted(), heeding_interrupts():
            mesh = tetrahedra(skin, planes, filled, length, size)
        if not _whole(mesh, box, skin, filled, length):
            fault = _crossing(skin, finer * size * length)
            continue
        curved = curved_tetrahedra(mesh, skin, length)
        stretch, number = curved.smallest_stretch()
        if stretch > FOLDED:
            return mesh, skin, curved
        spot = curved.corners[number].mean(axis=0) * length
        fault = InvalidInput(
            f"body {_nearest(scene, spot)} bends too much for tetrahedra of {1e3 * finer * size * length:.3g} mm at "
            f"{in_mm(spot)}: one is folded; ask for more elements_per_wavelength, or smooth the body there.",
            spot,
        )
    assert fault is not None
    raise fault


def _whole(mesh: NetgenMesh, box: Box, skin: SkinMesh, filled: list[bool], length: float) -> bool:
    """Whether tetrahedra fill the box but for the bodies that no sound enters."""
    corners = np.array(mesh.Coordinates(), dtype=np.float64)
    elements = mesh.Elements3D().NumPy()
    if not len(elements):
        return False
    four = corners[elements["nodes"][:, :4].astype(np.int64) - 1]
    found = np.abs(np.linalg.det(four[:, 1:] - four[:, :1])).sum() / 6
    wanted = float((box.outer_high - box.outer_low).prod())
    shut = ~np.array(filled)[skin.body]
    if shut.any():
        middle = np.array(box.low)  # on all mirrors, so that the cuts there count nothing
        flat = skin.vertices[skin.triangles[shut]] - middle
        wanted -= float(np.linalg.det(flat).sum()) / 6
    return bool(abs(found * length**3 / wanted - 1) < VOLUME_OFF)


def _crossing(skin: SkinMesh, edge: float) -> InvalidInput:
    pairs = self_crossings(skin.vertices[skin.triangles], skin.triangles)
    if not len(pairs):
        return InvalidInput(
            f"Netgen cannot fill the box round the bodies with tetrahedra, their skins having {len(skin.triangles)} "
            f"triangles of {1e3 * edge:.3g} mm; give smoother or thicker bodies, or take BoundaryElement."
        )
    one, other = skin.body[pairs[0]]
    spot = skin.vertices[skin.triangles[pairs[0]]].mean(axis=(0, 1))
    whom = f"body {one} crosses itself" if one == other else f"bodies {one} and {other} cross"
    return InvalidInput(
        f"{whom} at {in_mm(spot)} when meshed with triangles of {1e3 * edge:.3g} mm ({len(pairs)} pairs of them): too "
        "thin or too near for these; ask for more elements_per_wavelength, thicken the body or move it away.",
        spot,
    )


def _nearest(scene: Scene, spot: np.ndarray) -> int:
    return int(np.argmax([obstacle.surface.depth(spot[None])[0] for obstacle in scene.obstacles]))
