"""Curved triangles on the bodies, and tetrahedra in a box around them and in its absorbing layer.

Netgen meshes the faces of the boxes, to which the triangles of the bodies are added. A deformation
curves the tetrahedra next to the bodies. Lengths are in wavelengths, so that Netgen's tolerances do
not depend on the frequency.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float64, Int64
from scipy.spatial import KDTree

from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.fem.libraries import (
    NetgenMesh,
    heeding_interrupts,
    muted,
    netgen_libraries,
)
from airtact.acoustics.solvers.shared import Barycentric, Indices, Points, Vectors
from airtact.errors import InvalidInput, in_mm
from airtact.geometry.mesh.remeshing import bend_sizes, remeshed, strip_sizes
from airtact.geometry.mesh.triangles import QuadraticTriangles, area_vectors
from airtact.geometry.mesh_shape import placed_on
from airtact.geometry.shape import Shape

# Ratio of the edge length along a bend to the length over which the bend turns by one radian.
BEND_RATIO = 0.6


@dataclass(frozen=True, eq=False, repr=False)
class SurfaceMesh:
    """Curved triangles over the surfaces of all bodies.

    Attributes
    ----------
    vertices : (V, 3) positions [m].
    triangles : (T, 3) vertex indices, anticlockwise when seen from outside the body.
    middles : (T, 3, 3) points on the curved surface at the middles of edges 01, 12 and 20 [m]. Two
        triangles that share an edge have the same middle there.
    body : (T,) index of each triangle's obstacle.
    """

    vertices: Float64[np.ndarray, "vertices 3"]
    triangles: Int64[np.ndarray, "triangles 3"]
    middles: Float64[np.ndarray, "triangles 3 3"]
    body: Int64[np.ndarray, "triangles"]

    @property
    def quadratic_triangles(self) -> QuadraticTriangles:
        """The curved triangles as panels (T, 6, 3) [m]."""
        return np.concatenate([self.vertices[self.triangles], self.middles], axis=1)


def surface_mesh(shapes: Sequence[Shape], edge: float) -> SurfaceMesh:
    """Cover the surfaces of bodies with triangles of a nominal edge length [m], using MMG."""
    largest = 1.5 * edge  # the longest edge
    rough = [shape.coarse_meshes(largest) for shape in shapes]
    vertices, triangles, middles, body = [], [], [], []
    count = 0
    for index, shape in enumerate(shapes):
        neighbours = [
            part.vertices for parts in rough if parts is not rough[index] for part in parts
        ]
        for part in rough[index]:
            bends = bend_sizes(part.vertices, part.triangles, part.ridges, largest / BEND_RATIO)
            sizes = np.minimum(strip_sizes(part.vertices, part.ridges, largest), BEND_RATIO * bends)
            if neighbours:
                # Triangles that face another body have edges of at most 1.5 times the gap, but no
                # tiny edges.
                gap = KDTree(np.concatenate(neighbours)).query(part.vertices)[0]
                sizes = np.minimum(sizes, np.maximum(1.5 * gap, 0.15 * edge))
            area = 0.5 * np.linalg.norm(area_vectors(part.vertices[part.triangles]), axis=1).sum()
            flat = remeshed(part, sizes, edge, area / (np.sqrt(3) / 4 * edge**2))
            on_shape, between = placed_on(shape, flat, edge)
            vertices.append(on_shape)
            triangles.append(flat.triangles + count)
            middles.append(between)
            body.append(np.full(len(flat.triangles), index))
            count += len(on_shape)
    return SurfaceMesh(
        np.concatenate(vertices),
        np.concatenate(triangles),
        np.concatenate(middles),
        np.concatenate(body),
    )


# Netgen's limit for the growth of edges between neighbouring tetrahedra.
GRADING = 0.9

# Smallest allowed ratio of a curved tetrahedron's volume element to that of the straight one.
MIN_STRETCH = 0.02

# Points closer together than this count as identical [λ].
SAME_POINT = 1e-6

AIR = 1
LAYER = 2
# Netgen's numbers of the materials; a filled body b has the number BODY + b.
BODY = 3


# Corners of the six edges of a tetrahedron.
EDGES = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])

# Smallest barycentric coordinate of a point inside a tetrahedron, with an allowance for rounding.
INSIDE = -1e-7


@dataclass(frozen=True, eq=False)
class Box:
    """The box of air around the bodies that ``FiniteElement`` fills with tetrahedra.

    The sides of the box are parallel to the axes of the scene. On all sides, it is surrounded by a
    perfectly matched layer, which absorbs the outgoing waves and is also filled with tetrahedra.

    Attributes
    ----------
    low, high : (3,) corners of the box with the smallest and the largest coordinates, without the
        layer, in the frame of the scene [m].
    layer : thickness of the layer on each side [m].
    """

    low: Float64[np.ndarray, "3"]
    high: Float64[np.ndarray, "3"]
    layer: float

    @property
    def outer_low(self) -> Float64[np.ndarray, "3"]:
        """(3,) lower corner of the perfectly matched layer [m]."""
        return self.low - self.layer

    @property
    def outer_high(self) -> Float64[np.ndarray, "3"]:
        """(3,) upper corner of the perfectly matched layer [m]."""
        return self.high + self.layer


@dataclass(frozen=True, eq=False, repr=False)
class Tetrahedra:
    """Quadratic tetrahedra: corners, and offsets of the edge midpoints from straight edges [λ]."""

    corners: Float64[np.ndarray, "tetrahedra 4 3"]
    bends: Float64[np.ndarray, "tetrahedra 6 3"]

    @cached_property
    def _tree(self) -> KDTree:
        return KDTree(self.corners.mean(axis=1))

    def positions(self, number: Indices, weights: Barycentric) -> Vectors:
        """Return P points [λ] from tetrahedron indices (P,) and barycentric coordinates (P, 4)."""
        products = weights[:, EDGES[:, 0]] * weights[:, EDGES[:, 1]]
        straight = np.einsum("pc,pcd->pd", weights, self.corners[number])
        return straight + 4 * np.einsum("pe,ped->pd", products, self.bends[number])

    def jacobians(self, number: Indices, weights: Barycentric) -> Float64[np.ndarray, "points 3 3"]:
        """Return the derivatives of positions with respect to three barycentric coordinates."""
        along = np.array(self.corners[number])
        for edge, (start, end) in enumerate(EDGES):
            bend = 4 * self.bends[number, edge]
            along[:, start] += weights[:, end, None] * bend
            along[:, end] += weights[:, start, None] * bend
        return (along[:, :3] - along[:, 3:]).transpose(0, 2, 1)

    def smallest_stretch(self) -> tuple[float, int]:
        """Smallest ratio of curved to straight volume at a point, and its tetrahedron's index.

        A tetrahedron with a ratio of 0 or less is folded. The ratio is evaluated at points shifted
        15 % inward from the corners and midpoints. At an edge where two faces of a tetrahedron lie
        on the same smooth surface, a ratio of 0 is harmless.
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
        """Return the tetrahedron that contains each point, and the point's barycentric coordinates.

        The points (P, 3) are in wavelengths. The tetrahedra with the nearest centres are tried in
        turn, until one contains the point. If none does, its index is -1.
        """
        best = np.full(len(points), -1, dtype=np.int64)
        weights = np.zeros((len(points), 4))
        depth = np.full(len(points), -np.inf)
        outside = np.arange(len(points))
        for rank in range(1, min(640, len(self.corners)) + 1):
            outside = outside[depth[outside] < INSIDE]
            if not len(outside):
                break
            nearest = np.asarray(self._tree.query(points[outside], k=rank)[1])
            number = nearest.reshape(len(outside), rank)[:, -1]
            candidate = self._weights(number, points[outside])
            smallest = candidate.min(axis=1)
            deeper = smallest > depth[outside]
            chosen = outside[deeper]
            best[chosen] = number[deeper]
            weights[chosen] = candidate[deeper]
            depth[chosen] = smallest[deeper]
        # The meshed surface deviates by micrometres from the true one, so a point next to a
        # tetrahedron counts as inside it.
        best[depth < -0.05] = -1
        return best, weights

    def _weights(self, number: Indices, points: Points) -> Barycentric:
        """Return barycentric coordinates; Newton's method handles curved tetrahedra."""
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
    """Mesh the filled bodies, the air in a box around all bodies, and the perfectly matched layer.

    The coordinates of Netgen's mesh and of the curved tetrahedra are in units of the wavelength.

    Raises
    ------
    InvalidInput
        If a body cannot be meshed.
    """
    shapes = [obstacle.surface.shape for obstacle in scene.obstacles]
    filled = [obstacle.boundary == "filled" for obstacle in scene.obstacles]
    size = 1 / elements_per_wavelength
    fault = None
    # Smaller triangles are tried until Netgen fills the box and no tetrahedron is folded.
    for shrinking in (0.8, 0.5, 0.3):
        edge = shrinking * size * scene.wavelength
        surface = surface_mesh(shapes, edge)
        with muted(), heeding_interrupts():
            mesh = _tetrahedra(surface, box, filled, scene.wavelength, size)
        if not _fills_box(mesh, box, surface, filled, scene.wavelength):
            fault = InvalidInput(
                "Netgen cannot mesh the box around the bodies with surface triangles of "
                f"{1e3 * edge:.3g} mm: a body is too thin, or two bodies are too close together. "
                "Increase elements_per_wavelength, or use BoundaryElement.",
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
            f"at {in_mm(position)}: one tetrahedron is folded. Increase elements_per_wavelength, "
            "or smooth the body there.",
            position,
            code="mesh_faulty",
        )
    assert fault is not None
    raise fault


def _tetrahedra(
    surface: SurfaceMesh, box: Box, filled: Sequence[bool], wavelength: float, size: float
) -> NetgenMesh:
    """Fill a box with straight tetrahedra with edges up to ``size`` [λ], as a Netgen mesh.

    The boundaries of the bodies are named ``surface0``, ``surface1``, etc., and the materials
    ``air``, ``layer``, ``body0``, ``body1``, etc. If Netgen fails, tetrahedra are missing.
    """
    meshing, occ = netgen_libraries()
    inner, outer = (
        occ.Box(occ.Pnt(*(low / wavelength)), occ.Pnt(*(high / wavelength)))
        for low, high in ((box.low, box.high), (box.outer_low, box.outer_high))
    )
    mesh = occ.OCCGeometry(occ.Glue([inner, outer - inner])).GenerateMesh(
        maxh=size, grading=GRADING, perfstepsend=meshing.MeshingStep.MESHSURFACE
    )
    first = len(mesh.Points())
    faces = len(mesh.FaceDescriptors())
    mesh.AddPoints(surface.vertices / wavelength)
    for body in np.unique(surface.body).tolist():
        index = faces + 1 + body
        inside = BODY + body if filled[body] else 0
        mesh.Add(meshing.FaceDescriptor(surfnr=index, domin=AIR, domout=inside, bc=index))
        mesh.SetBCName(index - 1, f"surface{body}")
        # Seen from the air, the triangles are clockwise.
        triangles = surface.triangles[surface.body == body][:, ::-1]
        data = np.ascontiguousarray(first + triangles, dtype=np.int32)
        mesh.AddElements(dim=2, index=index, data=data, base=0)
    mesh.SetMaterial(AIR, "air")
    mesh.SetMaterial(LAYER, "layer")
    for body, inside in enumerate(filled):
        if inside:
            mesh.SetMaterial(BODY + body, f"body{body}")
    # With faster growth, edges in filled bodies would be twice as long as requested. In several
    # threads, the mesh is the same, but Netgen's threads wait for each other actively, which takes
    # ten times as long if other programs use the processors.
    mesh.GenerateVolumeMesh(
        maxh=size, grading=0.3 if any(filled) else GRADING, parallel_meshing=False
    )
    return mesh


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
    # The key of an edge combines its two vertex indices in a single number.
    keys, first = np.unique(ends[:, 0] * len(vertices) + ends[:, 1], return_index=True)
    straight = 0.5 * (vertices[ends[first, 0]] + vertices[ends[first, 1]])
    bend = surface.middles.reshape(-1, 3)[first] / wavelength - straight
    edges = np.sort(corners[:, EDGES], axis=2) @ [len(vertices), 1]
    index = np.searchsorted(keys, edges.ravel()).reshape(edges.shape)
    index = np.minimum(index, len(keys) - 1)
    return Tetrahedra(
        vertices[corners], np.where((keys[index] == edges)[:, :, None], bend[index], 0.0)
    )


def _fills_box(
    mesh: NetgenMesh, box: Box, surface: SurfaceMesh, filled: Sequence[bool], wavelength: float
) -> bool:
    """Return whether tetrahedra fill the whole box, except bodies that sound does not enter."""
    vertices, corners = _straight(mesh)
    if not len(corners):
        return False
    four = vertices[corners]
    volume = np.abs(np.linalg.det(four[:, 1:] - four[:, :1])).sum() / 6 * wavelength**3
    expected = float((box.outer_high - box.outer_low).prod())
    hollow = ~np.array(filled)[surface.body]
    if hollow.any():
        flat = surface.vertices[surface.triangles[hollow]]
        expected -= float(np.linalg.det(flat).sum()) / 6
    return bool(abs(volume / expected - 1) < 1e-6)
