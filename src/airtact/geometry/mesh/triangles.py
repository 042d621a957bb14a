"""Triangles of meshes: array types, neighbours, pieces, checks, and curved (six-node) triangles.

Axes with the same name in a signature have the same length. The nodes of a curved triangle are
corners 0, 1, 2 and the mid-edge points of edges 01, 12, 20. A tree of boxes around curved triangles
finds the one closest to a point.
"""

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from jaxtyping import Bool, Float64, Int, Int64, Real

from airtact import _kernels
from airtact.errors import InvalidInput, counted, in_mm

Points = Real[np.ndarray, "points 3"]
PointVectors = Float64[np.ndarray, "points 3"]
PointLengths = Float64[np.ndarray, "points"]
Vector3 = Float64[np.ndarray, "3"]

Vertices = Float64[np.ndarray, "vertices 3"]
VertexSizes = Float64[np.ndarray, "vertices"]

# Indices of the three vertices of each triangle.
Triangles = Int64[np.ndarray, "triangles 3"]

# Triangles of a result, whose number differs from that of the arguments.
NewTriangles = Int64[np.ndarray, "_ 3"]

# Positions of the corners of each triangle [m].
Corners = Real[np.ndarray, "triangles 3 3"]

# Index of the same edge in the neighbour, for each edge 01, 12, 20; see ``edge_twins``.
Twins = Int64[np.ndarray, "triangles 3"]

# Whether each of the edges 01, 12, 20 is in a set.
EdgeMask = Bool[np.ndarray, "triangles 3"]

# A vector for each edge or corner of each triangle.
EdgeVectors = Float64[np.ndarray, "triangles 3 3"]
TriangleVectors = Float64[np.ndarray, "triangles 3"]

# The two ends of each sharp edge.
Ridges = Int64[np.ndarray, "ridges 2"]

# Curved panels: corners 0, 1, 2 and points of the surface at the middles of edges 01, 12, 20 [m].
QuadraticTriangles = Float64[np.ndarray, "panels 6 3"]
Pieces = Float64[np.ndarray, "_ 6 3"]

# One triangle for each pair that is compared [m].
PairedCorners = Real[np.ndarray, "n 3 3"]
PairMask = Bool[np.ndarray, "n"]

# Indices of the two triangles of each pair.
IndexPairs = Int64[np.ndarray, "_ 2"]
Indices = Int64[np.ndarray, "n"]

# Vertices [m] and triangles of a mesh of flat triangles.
FlatMesh = tuple[Float64[np.ndarray, "_ 3"], NewTriangles]

NodeWeights = Float64[np.ndarray, "points 6"]
PanelVectors = Float64[np.ndarray, "panels 3"]
PanelSizes = Float64[np.ndarray, "panels"]

# Reference coordinates of the six nodes.
NODE_REFERENCES = np.array([[0, 0], [1, 0], [0, 1], [0.5, 0], [0.5, 0.5], [0, 0.5]])


def shape_functions(points: Real[np.ndarray, "points 2"]) -> NodeWeights:
    """Return the quadratic shape functions of the six nodes at reference points (P, 2)."""
    u, v = points.T
    w = 1 - u - v
    return np.stack(
        [w * (2 * w - 1), u * (2 * u - 1), v * (2 * v - 1), 4 * w * u, 4 * u * v, 4 * v * w], axis=1
    )


def shape_gradients(points: Real[np.ndarray, "points 2"]) -> tuple[NodeWeights, NodeWeights]:
    """Return the u- and v-derivatives of the shape functions at reference points (P, 2)."""
    u, v = points.T
    w = 1 - u - v
    zero = np.zeros_like(u)
    along_u = np.stack([1 - 4 * w, 4 * u - 1, zero, 4 * (w - u), 4 * v, -4 * v], axis=1)
    along_v = np.stack([1 - 4 * w, zero, 4 * v - 1, -4 * u, 4 * u, 4 * (w - v)], axis=1)
    return along_u, along_v


def points_at(
    panels: QuadraticTriangles, references: Real[np.ndarray, "panels 2"]
) -> tuple[PanelVectors, PanelVectors]:
    """Return a point of each panel [m] and an outward normal vector there.

    The length of the vector is the Jacobian, which is twice the area of a flat panel [m²].
    """
    along_u, along_v = (
        np.einsum("tn,tnd->td", gradient, panels) for gradient in shape_gradients(references)
    )
    position = np.einsum("tn,tnd->td", shape_functions(references), panels)
    return position, np.cross(along_u, along_v)


def middles_of(panels: QuadraticTriangles) -> tuple[PanelVectors, PanelVectors]:
    """Return the middle of each panel [m] and the outward unit normal there."""
    middles, normals = points_at(panels, np.full((len(panels), 2), 1 / 3))
    return middles, unit(normals)


def normals_at(
    panels: QuadraticTriangles, references: Real[np.ndarray, "points 2"]
) -> Float64[np.ndarray, "panels points 3"]:
    """Return outward normal vectors of each panel at reference points, the same in all panels.

    The lengths of the vectors are Jacobians, as in ``points_at``.
    """
    along_u, along_v = (gradient @ panels for gradient in shape_gradients(references))
    return np.cross(along_u, along_v)


def with_middles(
    corners: Float64[np.ndarray, "triangles 3 axes"],
) -> Float64[np.ndarray, "triangles 6 axes"]:
    """Append the middles of edges 01, 12, 20 to the corners of flat triangles."""
    return np.concatenate([corners, 0.5 * (corners + corners[:, [1, 2, 0]])], axis=1)


def area_vectors(corners: Corners) -> TriangleVectors:
    """Return the outward normals of flat triangles; their length is twice the area [m²]."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def unit(vectors: Float64[np.ndarray, "*axes 3"]) -> Float64[np.ndarray, "*axes 3"]:
    """Scale vectors to unit length, except zero vectors, which stay zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)


def edge_lengths(panels: Real[np.ndarray, "panels nodes 3"]) -> Float64[np.ndarray, "panels 3"]:
    """Return the straight-line lengths [m] of edges 01, 12, 20 of flat or curved triangles."""
    along = panels[:, [1, 2, 0]] - panels[:, :3]
    return np.sqrt(np.einsum("tki,tki->tk", along, along))


def longest_edges(panels: Real[np.ndarray, "panels nodes 3"]) -> PanelSizes:
    """Return the largest distance [m] between two corners of each flat or curved triangle."""
    return edge_lengths(panels).max(axis=1)


def corner_angles(
    along: Float64[np.ndarray, "triangles 3 3"],
) -> TriangleVectors:
    """Return the angles [rad] at corners 0, 1, 2 from unit vectors along edges 01, 12, 20."""
    cosines = -np.einsum("tki,tki->tk", along, np.roll(along, 1, axis=1))
    return np.arccos(np.clip(cosines, -1.0, 1.0))


def smallest_angles(panels: QuadraticTriangles) -> PanelSizes:
    """Return the smallest angle [degrees] between the straight edges of each panel."""
    along = np.roll(panels[:, :3], -1, axis=1) - panels[:, :3]
    return np.degrees(corner_angles(along / np.linalg.norm(along, axis=2, keepdims=True))).min(
        axis=1
    )


def cut(
    panels: QuadraticTriangles, parts: Int[np.ndarray, "panels"]
) -> tuple[Pieces, Int64[np.ndarray, "_"]]:
    """Divide each panel into ``parts``² pieces; return them and the index of each piece's panel."""
    parents = np.repeat(np.arange(len(parts)), parts * parts)
    pieces = panels[parents]
    for count in np.flatnonzero(np.bincount(parts)).tolist():
        if count > 1:
            chosen = parts == count
            shape = _piece_shapes(count).reshape(-1, 6)
            pieces[chosen[parents]] = (shape @ panels[chosen]).reshape(-1, 6, 3)
    return pieces, parents


@cache
def _piece_shapes(count: int) -> Float64[np.ndarray, "pieces 6 6"]:
    corners = []
    for i in range(count):
        for j in range(count - i):
            corners.append([(i, j), (i + 1, j), (i, j + 1)])
            if i + j < count - 1:
                corners.append([(i + 1, j + 1), (i, j + 1), (i + 1, j)])
    references = with_middles(np.array(corners, dtype=np.float64) / count)
    return shape_functions(references.reshape(-1, 2)).reshape(-1, 6, 6)


@cache
def gauss_square(
    points: int,
) -> tuple[Float64[np.ndarray, "points 2"], Float64[np.ndarray, "points"]]:
    """Return points and weights of a collapsed Gauss rule with ``points``² nodes on a triangle."""
    x, weights = np.polynomial.legendre.leggauss(points)
    u, v = (grid.ravel() for grid in np.meshgrid(0.5 * (x + 1), 0.5 * (x + 1)))
    return np.stack([u, v * (1 - u)], axis=1), np.outer(weights, weights).ravel() / 4 * (1 - u)


def enclosed_volume(panels: QuadraticTriangles) -> float:
    """Return the volume inside closed panels [m³], which is exact for the quadratic surface."""
    # By the divergence theorem, the integral of position times normal is three volumes. One matrix
    # product evaluates positions and both derivatives at all quadrature points.
    nodes = panels.transpose(2, 1, 0).reshape(3, 6, -1)
    values = _volume_rule() @ (nodes - nodes[:, :1, :1])
    position, along_u, along_v = np.split(values, 3, axis=1)
    normals = along_u[[1, 2, 0]] * along_v[[2, 0, 1]] - along_u[[2, 0, 1]] * along_v[[1, 2, 0]]
    return float(gauss_square(3)[1] @ (position * normals).sum(axis=(0, 2)) / 3)


@cache
def _volume_rule() -> Float64[np.ndarray, "functions 6"]:
    """Return the shape functions at the points of a Gauss rule, then their u- and v-derivatives."""
    references, _ = gauss_square(3)
    return np.concatenate([shape_functions(references), *shape_gradients(references)])


def panel_areas(panels: QuadraticTriangles) -> PanelSizes:
    """Return the area of each panel [m²], which is exact for flat panels."""
    references, weights = gauss_square(3)
    return np.linalg.norm(normals_at(panels, references), axis=2) @ weights


AnyTriangles = Int[np.ndarray, "triangles 3"]
AnyVertices = Real[np.ndarray, "vertices 3"]

# Edges stay sharp if the normals of their triangles differ by more than this [degrees].
SHARP_DEGREES = 75.0


def edge_twins(triangles: AnyTriangles) -> Twins:
    """Return the index of the reverse edge of each directed edge 01, 12 and 20 of each triangle.

    Index 3 t + e refers to edge e of triangle t. The index is -1 if there is no reverse edge, and
    -2 if the directed edge itself occurs more than once.
    """
    start = triangles.astype(np.int64)
    end = np.roll(start, -1, axis=1)
    count = int(triangles.max()) + 1 if triangles.size else 1
    forward = (start * count + end).ravel()
    backward = (end * count + start).ravel()
    order = np.argsort(forward, kind="stable")
    ranked = forward[order]
    match = np.minimum(np.searchsorted(ranked, backward), len(ranked) - 1)
    twins = np.where(ranked[match] == backward, order[match], -1)
    repeated = np.zeros(len(ranked), dtype=bool)
    repeated[1:] |= ranked[1:] == ranked[:-1]
    repeated[:-1] |= ranked[1:] == ranked[:-1]
    twins[order[repeated]] = -2
    return twins.reshape(-1, 3)


def edge_keys(triangles: AnyTriangles) -> Triangles:
    """Return a number for each edge 01, 12, 20 that identifies its vertices in either order."""
    start = triangles.astype(np.int64)
    end = np.roll(start, -1, axis=1)
    count = int(triangles.max()) + 1 if triangles.size else 1
    return np.minimum(start, end) * count + np.maximum(start, end)


def edge_ends(triangles: AnyTriangles) -> Int[np.ndarray, "triangles 3 2"]:
    """Return the start and end of edges 01, 12, 20 of each triangle."""
    return np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2)


def are_among(
    edges: Int[np.ndarray, "*edges 2"], listed: Int[np.ndarray, "*listed 2"]
) -> Bool[np.ndarray, "*edges"]:
    """Return a mask of the edges in ``listed``, regardless of the order of their vertices."""
    count = max(int(edges.max(initial=0)), int(listed.max(initial=0))) + 1
    return np.isin(np.sort(edges, axis=-1) @ [count, 1], np.sort(listed, axis=-1) @ [count, 1])


def shells(triangles: AnyTriangles, twins: Twins | None = None) -> Int64[np.ndarray, "triangles"]:
    """Return the index (T,) of the connected piece to which each triangle of a mesh belongs.

    The pieces of the closed mesh are numbered in the order of their first triangles.
    """
    from scipy.sparse import csr_array  # importing it takes 0.2 s
    from scipy.sparse.csgraph import connected_components

    twins = edge_twins(triangles) if twins is None else twins
    count = len(twins)
    graph = csr_array(
        (np.ones(3 * count, dtype=bool), twins.ravel() // 3, np.arange(0, 3 * count + 1, 3))
    )
    # All links are mutual, so strong connection gives the same labels and is faster.
    return connected_components(graph, connection="strong")[1].astype(np.int64)


def components(
    start: Int[np.ndarray, "links"], end: Int[np.ndarray, "links"], count: int
) -> Int64[np.ndarray, "members"]:
    """Return the index of the connected component to which each of ``count`` nodes belongs."""
    from scipy.sparse import coo_array  # importing it takes 0.2 s
    from scipy.sparse.csgraph import connected_components

    links = coo_array((np.ones(len(start), dtype=bool), (start, end)), shape=(count, count))
    return connected_components(links, directed=False)[1].astype(np.int64)


def smooth_patches(twins: Twins, borders: EdgeMask) -> Int64[np.ndarray, "triangles"]:
    """Return the index of the patch of each triangle, where border edges separate patches."""
    triangle, edge = np.nonzero(~borders)
    return components(triangle, twins[triangle, edge] // 3, len(twins))


def cone_volumes(corners: Corners) -> Float64[np.ndarray, "triangles"]:
    """Return the signed volume [m³] of the tetrahedron from the mean vertex to each triangle.

    The volumes add up to the volume of the body.
    """
    a, b, c = np.moveaxis(corners - corners.mean(axis=(0, 1)), 1, 0)
    return np.einsum("ti,ti->t", a, np.cross(b, c)) / 6.0


def check_size(extent: float) -> None:
    """Raise ``InvalidInput`` unless an extent is between 0.5 mm and 2 m, as expected in metres."""
    largest = 2.0
    smallest = 0.5e-3
    if extent > largest * (1.0 + 1e-9):
        raise InvalidInput(
            f"the surface spans {extent:.4g} m, but at most {largest:g} m is allowed: is it in "
            "millimetres? Use metres, or scale it by 1e-3.",
            code="not_in_metres",
        )
    if extent < smallest * (1.0 - 1e-9):
        raise InvalidInput(
            f"the surface spans {extent * 1e3:.4g} mm, but at least {smallest * 1e3:g} mm is "
            "required: was it converted from millimetres twice? Check the scale.",
            code="not_in_metres",
        )


def check_indices(count: int, triangles: AnyTriangles) -> None:
    """Raise ``InvalidInput`` unless all vertex indices are from 0 to ``count`` - 1."""
    wrong = (triangles < 0) | (triangles >= count)
    if wrong.any():
        triangle, corner = np.argwhere(wrong)[0]
        named = counted(int(wrong.any(axis=1).sum()), "triangle contains", "triangles contain")
        raise InvalidInput(
            f"{named} vertices that do not exist: triangle {triangle} contains vertex "
            f"{triangles[triangle, corner]}, but indices are from 0 to {count - 1}.",
            code="out_of_range",
        )


def check_not_degenerate(vertices: AnyVertices, triangles: AnyTriangles) -> None:
    """Raise ``InvalidInput`` for triangles whose height is below 1e-6 times their longest edge."""
    corners = vertices[triangles]
    edges = np.roll(corners, -1, axis=1) - corners
    twice_area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    thin = np.flatnonzero(twice_area <= 1e-6 * longest_edges(corners) ** 2)
    if len(thin):
        where = corners[thin[0]].mean(axis=0)
        raise InvalidInput(
            f"{counted(len(thin), 'triangle is', 'triangles are')} degenerate (no area); the first "
            f"is triangle {thin[0]} near {in_mm(where)}. Remove them or merge their vertices.",
            where,
            code="mesh_faulty",
        )


def check_closed(vertices: AnyVertices, triangles: AnyTriangles) -> Twins:
    """Check that each edge has exactly one reverse edge, and return ``edge_twins``."""
    twins = edge_twins(triangles)
    for mark, singular, plural, fault, code in (
        (
            -2,
            "edge is",
            "edges are",
            "traversed in the same direction by more than one triangle (neighbours with opposite "
            "orientations, a fin, or parts that share an edge, which union=True joins)",
            "mesh_not_oriented",
        ),
        (
            -1,
            "edge has",
            "edges have",
            "a triangle on one side only, so the surface is open",
            "mesh_open",
        ),
    ):
        marked = np.argwhere(twins == mark)
        if len(marked):
            ends = edge_ends(triangles)[tuple(marked.T)]
            count = len(np.unique(np.sort(ends, axis=1), axis=0))
            where = vertices[ends[0]].mean(axis=0)
            raise InvalidInput(
                f"{counted(count, singular, plural)} {fault}; the first is near {in_mm(where)}: "
                "repair the mesh.",
                where,
                code=code,
            )
    return twins


def check_orientation(
    vertices: AnyVertices, triangles: AnyTriangles, twins: Twins | None = None
) -> None:
    """Raise ``InvalidInput`` for closed pieces whose normals point inward."""
    corners = vertices[triangles]
    piece = shells(triangles, twins)
    volumes = np.bincount(piece, weights=cone_volumes(corners))
    inward = np.flatnonzero(volumes <= 0.0)
    if len(inward):
        where = corners[np.flatnonzero(piece == inward[0])[0]].mean(axis=0)
        number = int(np.isin(piece, inward).sum())
        are = f"{len(inward)} of {len(volumes)} closed pieces {'is' if len(inward) == 1 else 'are'}"
        raise InvalidInput(
            f"{'the surface is' if len(volumes) == 1 else are} inside out, near "
            f"{in_mm(where)}: reverse the order of the vertices of these {number} triangles.",
            where,
            code="mesh_faulty",
        )


@dataclass(frozen=True, eq=False)
class PanelTree:
    """A binary tree of boxes around curved panels.

    The corners of the boxes, ``lower`` and ``upper`` [m], are stored as a heap: box 1 contains all
    panels, and box b contains boxes 2 b and 2 b + 1. Each box of the last level contains the panel
    in ``order``, or is empty and lies at infinity. Each panel of the last level lies behind three
    planes along its edges, in ``sides``: outward unit normal, and distance from the origin [m].
    """

    quadratic_triangles: QuadraticTriangles
    order: Int64[np.ndarray, "leaves"]
    lower: Float64[np.ndarray, "boxes 3"]
    upper: Float64[np.ndarray, "boxes 3"]
    sides: Float64[np.ndarray, "leaves 3 4"]

    @cached_property
    def _near(self) -> float:
        """Radius [m] of the first search for the closest panel: 1/20 of the median leaf size."""
        sizes = (self.upper - self.lower)[len(self.order) :].max(axis=1)
        return 0.05 * float(np.median(sizes[sizes >= 0]))

    def closest(
        self, points: Points, within: PointLengths | None = None
    ) -> tuple[Int64[np.ndarray, "points"], Float64[np.ndarray, "points 2"], PointLengths]:
        """Return the panel closest to each point (P, 3), the closest point on it, and its distance.

        The closest point is in reference coordinates, and the distance in metres. If no panel is
        closer than ``within`` [m], the panel is arbitrary and the distance infinite.
        """
        tree = (self.quadratic_triangles, self.order, self.lower, self.upper, self.sides)
        if within is not None:
            return _kernels.closest_on_panels(points, *tree, within)
        # Most points are near the surface. A search in a small radius takes half the time, because
        # it visits no distant panels before the closest one.
        panel, reference, distance = _kernels.closest_on_panels(
            points, *tree, np.full(len(points), self._near)
        )
        rest = np.flatnonzero(np.isinf(distance))
        if len(rest):
            panel[rest], reference[rest], distance[rest] = _kernels.closest_on_panels(
                np.ascontiguousarray(points[rest]), *tree, None
            )
        return panel, reference, distance


def panel_tree(panels: QuadraticTriangles) -> PanelTree:
    """Sort panels (T, 6, 3) by position, and build boxes around them by repeated halving."""
    from scipy.spatial import KDTree  # importing it takes 0.2 s

    panels = np.ascontiguousarray(panels)
    corners = panels[:, :3]
    # A quadratic panel lies in the convex hull of its Bézier control points.
    control_points = 2 * panels[:, 3:] - 0.5 * (corners + np.roll(corners, -1, axis=1))
    hull = np.concatenate([corners, control_points], axis=1)
    # The k-d tree halves the panels down to single ones. The boxes must follow the same halves, or
    # they overlap and a search visits twice as many. A half of one panel leaves the other empty.
    by_place = KDTree(panels.mean(axis=1), leafsize=1).indices.astype(np.int64)
    starts = np.array([0, len(panels)])
    while (np.diff(starts) > 1).any():
        middles = (starts[:-1] + starts[1:]) // 2
        starts = np.append(np.stack([starts[:-1], middles], axis=1), starts[-1])
    filled = np.diff(starts) > 0
    leaves = len(filled)
    order = np.zeros(leaves, dtype=np.int64)
    order[filled] = by_place
    lower = np.full((2 * leaves, 3), np.inf)
    upper = np.full((2 * leaves, 3), -np.inf)
    lower[leaves:][filled] = hull.min(axis=1)[by_place]
    upper[leaves:][filled] = hull.max(axis=1)[by_place]
    while leaves > 1:
        children = slice(leaves, 2 * leaves)
        leaves //= 2
        parents = slice(leaves, 2 * leaves)
        lower[parents] = lower[children].reshape(leaves, 2, 3).min(axis=1)
        upper[parents] = upper[children].reshape(leaves, 2, 3).max(axis=1)
    # Boxes of neighbours overlap, but the planes along their edges separate them.
    edges = np.roll(corners, -1, axis=1) - corners
    outward = unit(np.cross(edges, area_vectors(corners)[:, None]))
    distance = (hull @ outward.transpose(0, 2, 1)).max(axis=1)
    sides = np.zeros((len(order), 3, 4))
    sides[filled] = np.concatenate([outward, distance[:, :, None]], axis=2)[by_place]
    return PanelTree(panels, order, lower, upper, sides)
