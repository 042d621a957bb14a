"""Tetrahedra from Netgen, in a box around the bodies and in the perfectly matched layer around it.

Netgen meshes the flat faces, to which the triangles of the bodies are added. A deformation curves
the tetrahedra next to the bodies. Lengths are in wavelengths, so that Netgen's tolerances do not
depend on the frequency.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64, Real
from scipy.spatial import KDTree

from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.arrays import Barycentric, Indices, Points, Vectors
from airtact.acoustics.solvers.fem.libraries import (
    NetgenMesh,
    heeding_interrupts,
    muted,
    netgen_libraries,
)
from airtact.acoustics.solvers.fem.surface_mesh import SurfaceMesh, surface_mesh
from airtact.acoustics.solvers.fem.symmetry import Mirror
from airtact.errors import InvalidInput, in_mm

# Netgen's limit on the growth of edges
GRADING = 0.9

# Smallest allowed ratio of a curved tetrahedron's volume element to the straight one's
MIN_STRETCH = 0.02

# Points closer together than this coincide [λ]
SAME_POINT = 1e-6

AIR = 1
LAYER = 2
# Netgen's numbers of the materials; a filled body b has number BODY + b
BODY = 3


# Corners of the six edges of a tetrahedron
EDGES = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])

# Smallest barycentric coordinate of a point inside a tetrahedron, with an allowance for rounding
INSIDE = -1e-7


@dataclass(frozen=True, eq=False)
class Box:
    """The box that is meshed.

    Attributes
    ----------
    low, high : (3,) corners of the air [m]; the box ends at mirrors.
    layer : thickness of the perfectly matched layer around it, except at mirrors [m].
    mirrors : planes of the lower sides of the box.
    """

    low: Float64[np.ndarray, "3"]
    high: Float64[np.ndarray, "3"]
    layer: float
    mirrors: tuple[Mirror, ...]

    @property
    def outer_low(self) -> Float64[np.ndarray, "3"]:
        """(3,) lower corner of the perfectly matched layer [m]."""
        low = self.low - self.layer
        for mirror in self.mirrors:
            low[mirror.axis] = self.low[mirror.axis]
        return low

    @property
    def outer_high(self) -> Float64[np.ndarray, "3"]:
        """(3,) upper corner of the perfectly matched layer [m]."""
        return self.high + self.layer


@dataclass(frozen=True, eq=False, repr=False)
class Tetrahedra:
    """Quadratic tetrahedra: corners, and offsets of the midpoints of the edges [λ]."""

    corners: Float64[np.ndarray, "tetrahedra 4 3"]
    bends: Float64[np.ndarray, "tetrahedra 6 3"]

    @cached_property
    def _tree(self) -> KDTree:
        return KDTree(self.corners.mean(axis=1))

    def positions(self, number: Indices, weights: Barycentric) -> Vectors:
        """Points with barycentric coordinates (P, 4) of tetrahedra (P,) [λ]."""
        products = weights[:, EDGES[:, 0]] * weights[:, EDGES[:, 1]]
        straight = np.einsum("pc,pcd->pd", weights, self.corners[number])
        return straight + 4 * np.einsum("pe,ped->pd", products, self.bends[number])

    def jacobians(self, number: Indices, weights: Barycentric) -> Float64[np.ndarray, "points 3 3"]:
        """Differentiate the position along the first three barycentric coordinates, as columns."""
        along = np.array(self.corners[number])
        for edge, (start, end) in enumerate(EDGES):
            bend = 4 * self.bends[number, edge]
            along[:, start] += weights[:, end, None] * bend
            along[:, end] += weights[:, start, None] * bend
        return (along[:, :3] - along[:, 3:]).transpose(0, 2, 1)

    def smallest_stretch(self) -> tuple[float, int]:
        """Smallest ratio of a volume element to that of the straight tetrahedron, and its index.

        A tetrahedron with a ratio of 0 or less is folded. Samples lie 15 % inwards from corners and
        midpoints, because the ratio may be 0 between two faces on a smooth surface. This does no
        harm.
        """
        midpoints = 0.5 * (np.eye(4)[EDGES[:, 0]] + np.eye(4)[EDGES[:, 1]])
        samples = 0.85 * np.concatenate([np.eye(4), midpoints]) + 0.15 / 4
        every = np.arange(len(self.corners))
        flat = np.linalg.det((self.corners[:, :3] - self.corners[:, 3:]).transpose(0, 2, 1))
        smallest = np.full(len(every), np.inf)
        for sample in samples:
            weights = np.broadcast_to(sample, (len(every), 4))
            smallest = np.minimum(smallest, np.linalg.det(self.jacobians(every, weights)) / flat)
        return float(smallest.min()), int(smallest.argmin())

    def holding(self, points: Points) -> tuple[Indices, Barycentric]:
        """Tetrahedron of each point (P, 3) [λ], -1 for none, and barycentric coordinates.

        The tetrahedra with the nearest centres are tried first, then more for the points that are
        outside all of them.
        """
        best = np.full(len(points), -1, dtype=np.int64)
        weights = np.zeros((len(points), 4))
        depth = np.full(len(points), -np.inf)
        tried = 0
        for candidates in (4, 12, 40, 160, 640):
            count = min(candidates, len(self.corners))
            outside = np.flatnonzero(depth < INSIDE)
            if not len(outside) or tried == count:
                break
            nearest = np.asarray(self._tree.query(points[outside], k=count)[1])
            for column in nearest.reshape(len(outside), count).T[tried:]:
                still = depth[outside] < INSIDE
                index = outside[still]
                number = column[still]
                candidate = self._weights(number, points[index])
                smallest = candidate.min(axis=1)
                deeper = smallest > depth[index]
                chosen = index[deeper]
                best[chosen] = number[deeper]
                weights[chosen] = candidate[deeper]
                depth[chosen] = smallest[deeper]
            tried = count
        # The meshed surface deviates by micrometres from the true one, so a point next to a
        # tetrahedron belongs to it.
        best[depth < -0.05] = -1
        return best, weights

    def _weights(self, number: Indices, points: Points) -> Barycentric:
        """Barycentric coordinates, by Newton's method in curved tetrahedra."""
        weights = np.full((len(points), 4), 0.25)
        bent = np.arange(len(points))
        for _ in range(6):
            off = points[bent] - self.positions(number[bent], weights[bent])
            jacobians = self.jacobians(number[bent], weights[bent])
            # One step is exact in a straight tetrahedron.
            step = np.linalg.solve(jacobians, off[:, :, None])[:, :, 0]
            weights[bent, :3] += np.clip(step, -1e3, 1e3)
            weights[bent, 3] = 1 - weights[bent, :3].sum(axis=1)
            moving = (np.abs(step).max(axis=1) > 1e-12) & (np.abs(weights[bent]).max(axis=1) < 5)
            bent = bent[moving & (self.bends[number[bent]] != 0).any(axis=(1, 2))]
            if not len(bent):
                break
        return weights


def meshed(
    scene: Scene, box: Box, elements_per_wavelength: float
) -> tuple[NetgenMesh, SurfaceMesh, Tetrahedra]:
    """Mesh the air in a box around the bodies, the filled bodies, and the perfectly matched layer.

    Netgen's mesh and the curved tetrahedra are in wavelengths.

    Raises
    ------
    InvalidInput
        A body cannot be meshed.
    """
    shapes = [obstacle.surface.shape for obstacle in scene.obstacles]
    filled = [obstacle.boundary == "filled" for obstacle in scene.obstacles]
    size = 1 / elements_per_wavelength
    fault = None
    # Retry with smaller triangles until Netgen fills the box and no tetrahedron is folded.
    for shrinking in (0.8, 0.5, 0.3):
        edge = shrinking * size * scene.wavelength
        surface = surface_mesh(shapes, edge, box.mirrors)
        sides = surface.vertices[surface.triangles]
        lengths = np.linalg.norm(sides - np.roll(sides, 1, axis=1), axis=2)
        if lengths.min() < SAME_POINT * scene.wavelength:
            # Netgen crashes if two vertices coincide at two mirrors.
            fault = InvalidInput(
                f"triangles of {1e3 * edge:.3g} mm collapse where mirrors cut a body; increase "
                "elements_per_wavelength.",
                code="mesh_faulty",
            )
            continue
        with muted(), heeding_interrupts():
            mesh = _tetrahedra(surface, box, filled, scene.wavelength, size)
        if not _fills_box(mesh, box, surface, filled, scene.wavelength):
            fault = InvalidInput(
                "Netgen cannot fill the box around the bodies with tetrahedra on triangles of "
                f"{1e3 * edge:.3g} mm: a body is too thin, or two are too close together; "
                "increase elements_per_wavelength, or use BoundaryElement.",
                code="mesh_faulty",
            )
            continue
        curved = _curved(mesh, surface, scene.wavelength)
        stretch, number = curved.smallest_stretch()
        if stretch > MIN_STRETCH:
            return mesh, surface, curved
        position = curved.corners[number].mean(axis=0) * scene.wavelength
        depths = [obstacle.surface.depth(position[None])[0] for obstacle in scene.obstacles]
        fault = InvalidInput(
            f"body {int(np.argmax(depths))} bends too much for tetrahedra of {1e3 * edge:.3g} mm "
            f"at {in_mm(position)}: one is folded; increase elements_per_wavelength, or smooth the "
            "body there.",
            position,
            code="mesh_faulty",
        )
    assert fault is not None
    raise fault


def _tetrahedra(
    surface: SurfaceMesh, box: Box, filled: Sequence[bool], wavelength: float, size: float
) -> NetgenMesh:
    """Fill a box with straight tetrahedra of edges up to ``size`` [λ], as Netgen's mesh.

    The boundaries are named ``surface0``, ``surface1`` ... for the bodies and ``wall0``, ``wall2``,
    ``wall4`` for mirrors across x, y, z; the materials ``air``, ``layer`` and ``body0``, ``body1``
    ... Tetrahedra are missing if Netgen fails.
    """
    meshing, _ = netgen_libraries()
    vertices, flat, regions = _flat_faces(surface, box, filled, wavelength, size)
    added = surface.vertices / wavelength
    # Along a cut both meshes have the same vertices, which must be merged.
    distance, nearest = KDTree(vertices).query(added)
    same = distance < SAME_POINT
    number = np.where(same, nearest, len(vertices) + np.cumsum(~same) - 1)
    mesh = meshing.Mesh()
    mesh.AddPoints(np.concatenate([vertices, added[~same]]))
    groups = []
    for inside, outside, face in np.unique(regions, axis=0).tolist():
        name = f"between{face}" if outside else f"wall{face}"
        triangles = flat[(regions == [inside, outside, face]).all(axis=1)]
        groups.append((inside, outside, name, triangles))
    corners = number[surface.triangles]
    for body in np.unique(surface.body):
        inner = BODY + int(body) if filled[body] else 0
        groups.append((AIR, inner, f"surface{body}", corners[surface.body == body][:, ::-1]))
    for index, (inside, outside, name, triangles) in enumerate(groups, start=1):
        mesh.Add(meshing.FaceDescriptor(surfnr=index, domin=inside, domout=outside, bc=index))
        mesh.SetBCName(index - 1, name)
        data = np.ascontiguousarray(triangles, dtype=np.int32)
        mesh.AddElements(dim=2, index=index, data=data, base=0)
    mesh.SetMaterial(AIR, "air")
    mesh.SetMaterial(LAYER, "layer")
    for body, inside in enumerate(filled):
        if inside:
            mesh.SetMaterial(BODY + body, f"body{body}")
    # With faster growth, tetrahedra in filled bodies would reach twice the edge.
    mesh.GenerateVolumeMesh(maxh=size, grading=0.3 if any(filled) else GRADING)
    return mesh


def _flat_faces(
    surface: SurfaceMesh, box: Box, filled: Sequence[bool], wavelength: float, size: float
) -> tuple[
    Float64[np.ndarray, "vertices 3"],
    Int64[np.ndarray, "triangles 3"],
    Int64[np.ndarray, "triangles 3"],
]:
    """Mesh the faces of box, layer and mirrors, without the cuts of hollow bodies.

    Return vertices [λ], outward triangles, and for each triangle both materials and its face.
    """
    meshing, occ = netgen_libraries()
    low = box.low / wavelength
    high = box.high / wavelength
    outer_low = box.outer_low / wavelength
    outer_high = box.outer_high / wavelength
    closed = [mirror.axis for mirror in box.mirrors]
    faces = []
    for axis, side in product(range(3), (0, 1)):
        if side == 1 or axis not in closed:
            plane = (low, high)[side][axis]
            outer_plane = (outer_low, outer_high)[side][axis]
            inner = _rectangle(axis, plane, low, high)
            outer = _rectangle(axis, outer_plane, outer_low, outer_high)
            faces.append(_named(inner, AIR, LAYER, side, axis))
            faces.append(_named(outer, LAYER, 0, side, axis))
    cut_middles = []
    for mirror in box.mirrors:
        plane = mirror.position / wavelength
        inner = _rectangle(mirror.axis, plane, low, high)
        outer = _rectangle(mirror.axis, plane, outer_low, outer_high)
        faces.append(_named(outer - inner, LAYER, 0, 0, mirror.axis))
        for chain in _outlines(surface, mirror):
            corners = _loop(surface.vertices[chain], mirror, box.mirrors) / wavelength
            middles = 0.5 * (corners + np.roll(corners, -1, axis=0))
            cut_middles.append(middles[: len(chain) - 1])
            section = _polygon(corners)
            inner = inner - section
            body = int(surface.body[(surface.triangles == chain[0]).any(axis=1)][0])
            if filled[body]:
                faces.append(_named(section, BODY + body, 0, 0, mirror.axis))
        faces.append(_named(inner, AIR, 0, 0, mirror.axis))
    glued = occ.Glue(faces)
    if cut_middles:
        # Netgen must not split the edges along the cuts, which the triangles of bodies share.
        cuts = KDTree(np.concatenate(cut_middles))
        for edge in glued.edges:
            if cuts.query([edge.center.x, edge.center.y, edge.center.z])[0] < SAME_POINT:
                edge.partition = np.empty(0)
    mesh = occ.OCCGeometry(glued).GenerateMesh(
        maxh=size, grading=GRADING, perfstepsend=meshing.MeshingStep.MESHSURFACE
    )
    vertices = np.array(mesh.Coordinates(), dtype=np.float64)
    elements = mesh.Elements2D().NumPy()
    triangles = elements["nodes"].astype(np.int64) - 1
    names = [[int(word) for word in face.bcname.split()] for face in mesh.FaceDescriptors()]
    inside, outside, side, axis = np.array(names, dtype=np.int64)[elements["index"] - 1].T
    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # Netgen may orient a face inwards or outwards.
    wrong = (normals[np.arange(len(axis)), axis] > 0) != (side == 1)
    triangles[wrong] = triangles[wrong][:, ::-1]
    return vertices, triangles, np.stack([inside, outside, 2 * axis + side], axis=1)


def _named(face: Any, inside: int, outside: int, side: int, axis: int) -> Any:
    face.faces.name = f"{inside} {outside} {side} {axis}"
    return face


def _rectangle(
    axis: int, plane: float, low: Real[np.ndarray, "3"], high: Real[np.ndarray, "3"]
) -> Any:
    first, second = (index for index in range(3) if index != axis)
    corners = np.full((4, 3), plane)
    corners[:, first] = np.array([low, high, high, low])[:, first]
    corners[:, second] = np.array([low, low, high, high])[:, second]
    return _polygon(corners)


def _polygon(corners: Real[np.ndarray, "corners 3"]) -> Any:
    _, occ = netgen_libraries()
    points = [occ.Pnt(*corner) for corner in corners]
    ends = zip(points, points[1:] + points[:1], strict=True)
    return occ.Face(occ.Wire([occ.Segment(start, end) for start, end in ends]))


def _outlines(surface: SurfaceMesh, mirror: Mirror) -> list[Int64[np.ndarray, "vertices"]]:
    """Chains of vertices along which the surfaces are cut at a mirror, each body's in order."""
    triangles = surface.triangles
    vertices = surface.vertices
    ends = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2)
    keys = np.sort(ends, axis=1) @ [len(vertices), 1]
    _, inverse, count = np.unique(keys, return_inverse=True, return_counts=True)
    # The border of the cut surface has one triangle at each edge.
    on_mirror = (vertices[ends][:, :, mirror.axis] == mirror.position).all(axis=1)
    following = dict(ends[(count[inverse] == 1) & on_mirror].tolist())
    chains = []
    while following:
        starts = set(following) - set(following.values())
        chain = [next(iter(starts or following))]
        while chain[-1] in following:
            chain.append(following.pop(chain[-1]))
        chains.append(np.array(chain))
    return chains


def _loop(
    chain: Real[np.ndarray, "vertices 3"], mirror: Mirror, mirrors: Sequence[Mirror]
) -> Float64[np.ndarray, "corners 3"]:
    """Close a chain that ends at other mirrors, without the repeated vertex of a closed chain."""
    if np.array_equal(chain[0], chain[-1]):
        return chain[:-1]
    first, last = (
        {
            crossed
            for crossed in mirrors
            if crossed is not mirror and end[crossed.axis] == crossed.position
        }
        for end in (chain[0], chain[-1])
    )
    if first & last:
        return chain
    # Two mirrors cut the body: the outline turns at the line that they share.
    corner = chain[0].copy()
    for crossed in first | last:
        corner[crossed.axis] = crossed.position
    return np.concatenate([chain, corner[None]])


def _straight(
    mesh: NetgenMesh,
) -> tuple[Float64[np.ndarray, "vertices 3"], Int64[np.ndarray, "tetrahedra 4"]]:
    corners = mesh.Elements3D().NumPy()["nodes"][:, :4].astype(np.int64) - 1
    return np.array(mesh.Coordinates(), dtype=np.float64), corners


def _curved(mesh: NetgenMesh, surface: SurfaceMesh, wavelength: float) -> Tetrahedra:
    vertices, corners = _straight(mesh)
    on_surface = np.asarray(KDTree(vertices).query(surface.vertices / wavelength)[1])
    triangles = on_surface[surface.triangles]
    ends = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2)
    ends = np.sort(ends, axis=1)
    # The key of an edge combines its two vertex indices in one number.
    keys, first = np.unique(ends[:, 0] * len(vertices) + ends[:, 1], return_index=True)
    straight = 0.5 * (vertices[ends[first, 0]] + vertices[ends[first, 1]])
    bend = surface.middles.reshape(-1, 3)[first] / wavelength - straight
    edges = np.sort(corners[:, EDGES], axis=2) @ [len(vertices), 1]
    index = np.searchsorted(keys, edges.ravel()).reshape(edges.shape)
    index = np.minimum(index, len(keys) - 1)
    bends = np.where((keys[index] == edges)[:, :, None], bend[index], 0.0)
    return Tetrahedra(vertices[corners], bends)


def _fills_box(
    mesh: NetgenMesh, box: Box, surface: SurfaceMesh, filled: Sequence[bool], wavelength: float
) -> bool:
    """Whether tetrahedra fill the box, except bodies that no sound enters."""
    vertices, corners = _straight(mesh)
    if not len(corners):
        return False
    four = vertices[corners]
    volume = np.abs(np.linalg.det(four[:, 1:] - four[:, :1])).sum() / 6 * wavelength**3
    expected = float((box.outer_high - box.outer_low).prod())
    hollow = ~np.array(filled)[surface.body]
    if hollow.any():
        # Relative to a point on all mirrors, the cuts at mirrors add no volume.
        flat = surface.vertices[surface.triangles[hollow]] - box.low
        expected -= float(np.linalg.det(flat).sum()) / 6
    return bool(abs(volume / expected - 1) < 1e-6)
