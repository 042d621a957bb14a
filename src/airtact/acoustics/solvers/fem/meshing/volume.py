"""Tetrahedra in a box round the bodies, and in the perfectly matched layer round the box, by Netgen.

Netgen meshes the flat faces; the bodies' own triangles are added to them, and the tetrahedra beside
the bodies are curved by a deformation. Lengths are in wavelengths here, so that no tolerance of
Netgen's depends on the frequency.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64, Real
from scipy.spatial import KDTree

from airtact.acoustics.solvers.arrays import Mask, Points
from airtact.acoustics.solvers.fem.meshing.netgen import NetgenMesh, netgen_libraries
from airtact.acoustics.solvers.fem.meshing.surface_mesh import SurfaceMesh
from airtact.acoustics.solvers.fem.meshing.symmetry import Mirror

GRADING = 0.9
"""How fast Netgen's edges may grow over the faces."""

INNER_GRADING = 0.3
"""And where bodies are filled: with faster growth, tetrahedra in them reach twice the edge wanted."""

SAME = 1e-6
"""Points nearer than this are one [λ]."""

AIR, LAYER, BODY = 1, 2, 3
"""Numbers of the first three materials; body b that is filled is ``BODY`` + b."""

_Faces = tuple[
    Float64[np.ndarray, "vertices 3"],
    Int64[np.ndarray, "triangles 3"],
    Int64[np.ndarray, "triangles 3"],
]
"""Netgen's triangles on the flat faces: vertices [λ], triangles, and the materials on both sides and number of each."""


@dataclass(frozen=True, eq=False)
class Box:
    """The box that is meshed.

    Attributes
    ----------
    low, high : (3,) corners of the air [m]; on a mirror the box ends there.
    layer : thickness of the perfectly matched layer round it, on the sides that are no mirrors [m].
    mirrors : planes at which the lower side of the box lies.
    """

    low: Float64[np.ndarray, "3"]
    high: Float64[np.ndarray, "3"]
    layer: float
    mirrors: tuple[Mirror, ...]

    @property
    def outer_low(self) -> Float64[np.ndarray, "3"]:
        """(3,) lower corner of the perfectly matched layer [m]."""
        closed = [axis in [mirror.axis for mirror in self.mirrors] for axis in range(3)]
        return np.where(closed, self.low, self.low - self.layer)

    @property
    def outer_high(self) -> Float64[np.ndarray, "3"]:
        """(3,) upper corner of the perfectly matched layer [m]."""
        return self.high + self.layer

    def holds(self, points: Points) -> Mask:
        """Whether points (P, 3) [m] lie in the air of the box."""
        return np.all((points >= self.low) & (points <= self.high), axis=1)


def _outlines(surface: SurfaceMesh, mirror: Mirror) -> list[Int64[np.ndarray, "vertices"]]:
    """Chains of vertices along which the surfaces are cut at a mirror, each body's in order."""
    triangles, vertices = surface.triangles, surface.vertices
    ends = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2)
    keys = np.sort(ends, axis=1) @ [len(vertices), 1]
    _, inverse, count = np.unique(keys, return_inverse=True, return_counts=True)
    on = (vertices[ends][:, :, mirror.axis] == mirror.position).all(axis=1)
    following = dict(ends[(count[inverse] == 1) & on].tolist())
    chains = []
    while following:
        starts = set(following) - set(following.values())
        chain = [next(iter(starts or following))]
        while chain[-1] in following:
            chain.append(following.pop(chain[-1]))
        chains.append(np.array(chain))
    return chains


def _flat_faces(
    surface: SurfaceMesh, box: Box, filled: Sequence[bool], wavelength: float, size: float
) -> _Faces:
    """Mesh the faces of the box, of the perfectly matched layer and of the mirrors less the cuts of hollow bodies."""
    meshing, occ = netgen_libraries()
    faces, cuts, closed = [], [np.empty((0, 3))], [mirror.axis for mirror in box.mirrors]
    air = box.low / wavelength, box.high / wavelength, (AIR, LAYER)
    layer = box.outer_low / wavelength, box.outer_high / wavelength, (LAYER, 0)
    for axis, side in product(range(3), (0, 1)):
        if side == 1 or axis not in closed:
            for low, high, materials in (air, layer):
                faces.append(
                    _named(
                        _rectangle(axis, (low, high)[side][axis], low, high), *materials, side, axis
                    )
                )
    for mirror in box.mirrors:
        inner, outer = (
            _rectangle(mirror.axis, mirror.position / wavelength, *ends[:2])
            for ends in (air, layer)
        )
        faces.append(_named(outer - inner, LAYER, 0, 0, mirror.axis))
        for chain in _outlines(surface, mirror):
            corners = _loop(surface.vertices[chain], mirror, box.mirrors) / wavelength
            cuts.append(0.5 * (corners + np.roll(corners, -1, axis=0))[: len(chain) - 1])
            section = _polygon(corners)
            inner = inner - section
            body = int(surface.body[(surface.triangles == chain[0]).any(axis=1)][0])
            if filled[body]:
                faces.append(_named(section, BODY + body, 0, 0, mirror.axis))
        faces.append(_named(inner, AIR, 0, 0, mirror.axis))
    glued, middles = occ.Glue(faces), KDTree(np.concatenate(cuts)) if len(cuts) > 1 else None
    for edge in glued.edges:
        if (
            middles is not None
            and middles.query(np.array([edge.center.x, edge.center.y, edge.center.z]))[0] < SAME
        ):
            edge.partition = np.empty(
                0
            )  # or Netgen would split what the body's triangles have whole
    until = meshing.MeshingStep.MESHSURFACE
    return _triangles_of(
        occ.OCCGeometry(glued).GenerateMesh(maxh=size, grading=GRADING, perfstepsend=until)
    )


def _named(face: Any, inside: int, outside: int, side: int, axis: int) -> Any:
    face.faces.name = f"{inside} {outside} {side} {axis}"
    return face


def _rectangle(
    axis: int, plane: float, low: Real[np.ndarray, "3"], high: Real[np.ndarray, "3"]
) -> Any:
    one, other = (index for index in range(3) if index != axis)
    corners = np.full((4, 3), plane)
    corners[:, one] = np.array([low, high, high, low])[:, one]
    corners[:, other] = np.array([low, low, high, high])[:, other]
    return _polygon(corners)


def _polygon(corners: Real[np.ndarray, "corners 3"]) -> Any:
    _, occ = netgen_libraries()
    points = [occ.Pnt(*corner) for corner in corners]
    edges = [
        occ.Segment(one, other) for one, other in zip(points, points[1:] + points[:1], strict=True)
    ]
    return occ.Face(occ.Wire(edges))


def _loop(
    chain: Real[np.ndarray, "vertices 3"], mirror: Mirror, mirrors: Sequence[Mirror]
) -> Float64[np.ndarray, "corners 3"]:
    """Close a chain that ends at other mirrors; a closed one ends where it began, which is left out."""
    if np.array_equal(chain[0], chain[-1]):
        return chain[:-1]
    crossed = [
        {other for other in mirrors if other is not mirror and end[other.axis] == other.position}
        for end in (chain[0], chain[-1])
    ]
    if crossed[0] & crossed[1]:
        return chain
    corner = chain[0].copy()
    for other in crossed[0] | crossed[1]:
        corner[other.axis] = other.position
    return np.concatenate([chain, corner[None]])


def _triangles_of(mesh: Any) -> _Faces:
    """Take the faces of a mesh of Netgen's out of it, turned outwards."""
    vertices = np.array(mesh.Coordinates(), dtype=np.float64)
    elements = mesh.Elements2D().NumPy()
    triangles = elements["nodes"].astype(np.int64) - 1
    names = np.array(
        [[int(word) for word in face.bcname.split()] for face in mesh.FaceDescriptors()],
        dtype=np.int64,
    )
    inside, outside, side, axis = names[elements["index"] - 1].T
    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    wrong = (normals[np.arange(len(axis)), axis] > 0) != (side == 1)
    triangles[wrong] = triangles[wrong][:, ::-1]
    return vertices, triangles, np.stack([inside, outside, 2 * axis + side], axis=1)


def tetrahedra(
    surface: SurfaceMesh, box: Box, filled: Sequence[bool], wavelength: float, size: float
) -> NetgenMesh:
    """Fill a box with tetrahedra of edges up to ``size`` [λ]: Netgen's mesh in wavelengths, before it is curved.

    The boundaries are named ``surface0``, ``surface1`` ... for the bodies and ``wall0``, ``wall2``,
    ``wall4`` for mirrors across x, y, z; the materials ``air``, ``layer`` and ``body0``, ``body1``
    ... Where Netgen fails, tetrahedra are missing.
    """
    meshing, _ = netgen_libraries()
    vertices, flat, sides = _flat_faces(surface, box, filled, wavelength, size)
    own = surface.vertices / wavelength
    distance, nearest = KDTree(vertices).query(own)
    same = distance < SAME
    number = np.where(same, nearest, len(vertices) + np.cumsum(~same) - 1)
    mesh = meshing.Mesh()
    mesh.AddPoints(np.concatenate([vertices, own[~same]]))
    groups = []
    for inside, outside, face in np.unique(sides, axis=0).tolist():
        name = f"between{face}" if outside else f"wall{face}"
        groups.append(
            ((inside, outside), name, flat[(sides == [inside, outside, face]).all(axis=1)])
        )
    corners = number[surface.triangles]
    for body in np.unique(surface.body):
        inner = BODY + int(body) if filled[body] else 0
        groups.append(((AIR, inner), f"surface{body}", corners[surface.body == body][:, ::-1]))
    for index, ((inside, outside), name, triangles) in enumerate(groups, start=1):
        mesh.Add(meshing.FaceDescriptor(surfnr=index, domin=inside, domout=outside, bc=index))
        mesh.SetBCName(index - 1, name)
        mesh.AddElements(
            dim=2, index=index, data=np.ascontiguousarray(triangles, dtype=np.int32), base=0
        )
    mesh.SetMaterial(AIR, "air")
    mesh.SetMaterial(LAYER, "layer")
    for body, inside in enumerate(filled):
        if inside:
            mesh.SetMaterial(BODY + body, f"body{body}")
    mesh.GenerateVolumeMesh(maxh=size, grading=INNER_GRADING if any(filled) else GRADING)
    return mesh
