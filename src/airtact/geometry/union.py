"""Merges bodies that overlap, touch or nearly touch into one.

The air between two bodies is filled where the distances to both add up to at most a gap and their
surfaces face each other; a furrow in which they meet at a wide angle stays. The surface of the
filling is found on a grid of cubes, refined only there, each cut into six tetrahedra in which the
level is linear. The level set of manifold3d evaluates one point at a time over a whole box and has
no vectorised form, so it cannot be used.

Source: A. Doi, A. Koide, "An efficient method of triangulating equi-valued surfaces by using
tetrahedral cells", IEICE Trans. E74, 214 (1991).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np
from jaxtyping import Float64, Int64
from scipy.spatial import KDTree

from airtact.errors import InvalidInput, in_mm, of_kind, within
from airtact.geometry.checks import (
    FLAT_TOLERANCE,
    NEAREST,
    THINNEST,
    TOUCH,
    approach,
    check_not_crossed,
    check_surface,
    corners_of,
    flattened,
    thin_part,
)
from airtact.geometry.mesh.arrays import FlatMesh, Triangles, Vector3, Vertices
from airtact.geometry.mesh.intersections import crossings_between
from airtact.geometry.mesh.quadratic_triangles import longest_edges
from airtact.geometry.mesh.slivers import without_slivers
from airtact.geometry.mesh.thickness import Depth
from airtact.geometry.mesh.topology import components, cone_volumes, edge_twins, shells
from airtact.geometry.primitives import Capsule
from airtact.geometry.surface import Surface

BALL_RADIUS = 0.3e-3
"""Radius of the balls that thin bridges are made of, or 0.6 gaps if that is more [m]."""


@dataclass(frozen=True, eq=False)
class Link:
    """Two bodies no farther apart than the gap, by index, and a position (3,) between them [m]."""

    first: int
    second: int
    position: Vector3


def merged(surfaces: Sequence[Surface], gap: float = NEAREST) -> Surface:
    """Merge bodies that overlap, touch or are nearer than a gap into one.

    Material fills the air between two bodies where the distances to both add up to at most the gap
    and their surfaces face each other: fully within 17 degrees, less and less up to 53. Furrows in
    which bodies meet at a wider angle stay. Where a bridge would be thinner than 0.5 mm, all
    bridges are made of balls of 0.6 mm (1.2 gaps if that is more) with their centres there.
    Enclosed air is filled. Elsewhere the surface stays, within 10 micrometres.

    Parameters
    ----------
    surfaces : the bodies, in any order; one that lies wholly in another adds nothing.
    gap : largest distance of surfaces that are bridged [m], 0.1 to 2 mm.

    Returns
    -------
    The merged body, with flat triangles on bridges. A single body is returned unchanged.

    Raises
    ------
    InvalidInput
        If there is no body, a body crosses itself, bodies are farther apart than the gap, or the
        merged body is thinner than 0.5 mm somewhere.

    Examples
    --------
    >>> from airtact.geometry.primitives import sphere
    >>> balls = [sphere(radius=2e-3, edge=1e-3, centre=(x, 0, 0)) for x in (0, 3e-3)]
    >>> volumes = sum(ball.volume for ball in balls), float(merged(balls).volume)
    >>> [round(volume * 1e9, 1) for volume in volumes]
    [67.0, 64.1]
    """
    bodies = [
        of_kind(body, Surface, f"body {index}", "a Surface") for index, body in enumerate(surfaces)
    ]
    gap = within(gap, 0.1e-3, 2e-3, "the gap to be bridged", "m", "is it in millimetres?")
    if not bodies:
        raise InvalidInput("there are no bodies to merge; give one or more.", code="empty")
    for body in bodies:
        check_not_crossed(body)
    meshes = {index: flattened(body) for index, body in enumerate(bodies)}
    for index in reversed(range(len(bodies))):
        if any(
            _lies_in(bodies, meshes, index, container) for container in meshes if container != index
        ):
            del meshes[index]
    if len(meshes) == 1:
        return bodies[next(iter(meshes))]
    result = _bridged(bodies, meshes, _links(bodies, list(meshes), gap), gap)
    check_surface(result)
    return result


def _bridged(
    bodies: Sequence[Surface], meshes: dict[int, FlatMesh], links: Sequence[Link], gap: float
) -> Surface:
    """Merge bodies by bridges as wide as the gap, or by thicker ones where these are too thin."""
    remaining = [bodies[index] for index in meshes]
    cavities = sum(int(shells(triangles).max()) for _, triangles in meshes.values())
    repairs = tuple(sentence for body in remaining for sentence in body.repairs)
    result = remaining[0]
    for radius in (0.0, max(BALL_RADIUS, 0.6 * gap)):
        bridges = []
        for link in links:
            bridges += _bridges(bodies, meshes, link, gap, radius)
        sizes = [np.ptp(vertices, axis=0).max() for vertices, _ in bridges]
        if radius == 0.0 and any(size < 2.0 * BALL_RADIUS for size in sizes):
            continue
        # The farthest that triangles may move to have fewer small ones [m]. The first tolerance
        # that leaves none crossing is taken.
        for tolerance in (4e-6, 1e-6, 0.0):
            vertices, triangles = _united(meshes.values(), bridges, tolerance)
            result = Surface(
                vertices,
                triangles,
                _middles(remaining, vertices, triangles),
                sharp_degrees=45.0,  # round parts of merged bodies turn less
                repairs=repairs,
            )
            if len(result.crossings) == 0:
                break
        joined = shells(result.triangles).max() <= cavities
        if joined and thin_part(result, THINNEST, short=0.0) is None:
            break
    return result


def _lies_in(
    bodies: Sequence[Surface], meshes: dict[int, FlatMesh], inner: int, outer: int
) -> bool:
    """Whether a body lies wholly in another, or equals it."""
    match bodies[inner].shape, bodies[outer].shape:
        case Capsule() as capsule, Capsule() as around:  # the balls at both of its ends are inside
            return bool((around.depth(capsule.axis) >= capsule.radius - TOUCH).all())
    vertices, triangles = meshes[inner]
    other_vertices, other_triangles = meshes[outer]
    if np.array_equal(vertices, other_vertices) and np.array_equal(triangles, other_triangles):
        return True
    corners = vertices[triangles]
    points = corners[np.unique(shells(triangles), return_index=True)[1], 0]
    inside = bool((bodies[outer].depth(points) > 0.0).all())
    return inside and len(crossings_between(corners, corners_of(meshes[outer]))) == 0


def _links(bodies: Sequence[Surface], chosen: list[int], gap: float) -> list[Link]:
    """Pairs of bodies no farther apart than the gap; raise ``InvalidInput`` if not all connect."""
    links = []
    for first, second in combinations(chosen, 2):
        near = approach(bodies[first], bodies[second], gap * (1.0 + 1e-9))
        if near is not None:
            links.append(Link(first, second, near.position))
    ends = np.array([(link.first, link.second) for link in links], dtype=np.int64).reshape(-1, 2)
    part = components(ends[:, 0], ends[:, 1], len(bodies))
    apart = []
    for first, second in combinations(chosen, 2):
        near = approach(bodies[first], bodies[second]) if part[first] != part[second] else None
        if near is not None:
            apart.append((near.distance, first, second, near.position))
    if apart:
        distance, first, second, where = min(apart, key=lambda pair: pair[0])
        raise InvalidInput(
            f"bodies {first} and {second} are {distance * 1e3:.3g} mm apart near {in_mm(where)}, "
            f"the nearest that are not connected, but only {gap * 1e3:.3g} mm are bridged; move "
            "them together, leave one out, or give a larger gap.",
            where,
            code="misplaced",
        )
    return links


def _bridges(
    bodies: Sequence[Surface], meshes: dict[int, FlatMesh], link: Link, gap: float, radius: float
) -> list[FlatMesh]:
    """Meshes that fill the air between two bodies, made of balls if a radius is given."""
    vertices = meshes[link.first][0]
    other_vertices = meshes[link.second][0]
    filling = Filling(
        bodies[link.first].depth,
        bodies[link.second].depth,
        low=np.maximum(vertices.min(axis=0), other_vertices.min(axis=0)) - 2.0 * gap,
        high=np.minimum(vertices.max(axis=0), other_vertices.max(axis=0)) + 2.0 * gap,
        width=gap,
    )
    mesh = filling.mesh(radius)
    meshes_of_link = [] if mesh is None else [mesh]
    if radius > 0.0:
        meshes_of_link.append(_balls(link.position[None], radius))
    return meshes_of_link


def _middles(
    bodies: Sequence[Surface], vertices: Vertices, triangles: Triangles
) -> Float64[np.ndarray, "_ 3 3"]:
    """Edge middles, projected onto the bodies where these are so near that no triangle folds."""
    corners = vertices[triangles]
    along = np.roll(corners, -1, axis=1) - corners
    twice_area = np.linalg.norm(np.cross(along[:, 0], along[:, 1]), axis=1)
    height = (twice_area / longest_edges(corners))[:, None]
    twins = edge_twins(triangles)
    lowest = np.minimum(height, height.ravel()[twins // 3])
    allowed = np.minimum(2.0 * FLAT_TOLERANCE, 0.1 * lowest).ravel()
    once = np.flatnonzero(np.arange(twins.size) < twins.ravel())
    middles = (corners + 0.5 * along).reshape(-1, 3)[once]
    projected = middles.copy()
    nearest = allowed[once]
    for body in bodies:
        depth = np.abs(body.depth(middles))
        near = np.flatnonzero(depth < nearest)
        projected[near] = body.shape.project(middles[near])
        nearest[near] = depth[near]
    result = np.empty((twins.size, 3))
    result[once] = projected
    result[twins.ravel()[once]] = projected
    return result.reshape(-1, 3, 3)


def _united(bodies: Iterable[FlatMesh], bridges: Iterable[FlatMesh], tolerance: float) -> FlatMesh:
    """Boolean union of closed meshes, without slivers and enclosed air."""
    from manifold3d import Error, Manifold, Mesh64, OpType

    def solid(mesh: FlatMesh) -> Manifold:
        vertices, triangles = mesh
        return Manifold(Mesh64(vertices.copy(), triangles.astype(np.uint64)))  # not read-only

    solids = [solid(body) for body in bodies]
    solids += [solid(bridge).simplify(8e-6) for bridge in bridges]
    union = Manifold.batch_boolean(solids, OpType.Add)
    for _ in range(2):
        # As an original mesh, it may be simplified across the borders of its former parts.
        union = union.as_original().simplify(tolerance)
    assert union.status() == Error.NoError  # closed meshes that do not cross themselves
    mesh = union.to_mesh64()
    vertices = mesh.vert_properties[:, :3].astype(np.float64)
    triangles = mesh.tri_verts.astype(np.int64)
    piece = shells(triangles)
    solid_piece = np.bincount(piece, weights=cone_volumes(vertices[triangles])) > 0.0
    triangles = without_slivers(vertices, triangles[solid_piece[piece]], [])
    used, triangles = np.unique(triangles, return_inverse=True)
    return vertices[used], triangles.reshape(-1, 3)


# --- the filling between two bodies -----------------------------------------------------------

_CORNERS = np.array([[corner >> axis & 1 for axis in range(3)] for corner in range(8)])
# The corners of a cube; bit i of a corner's index is its coordinate along axis i.


@dataclass(frozen=True, eq=False)
class Filling:
    """The filling between two bodies, given by their depths, in the box ``low`` to ``high`` [m].

    ``width`` is the largest sum of the distances to the bodies [m].
    """

    first: Depth
    second: Depth
    low: Vector3
    high: Vector3
    width: float

    def mesh(self, radius: float = 0.0) -> FlatMesh | None:
        """Mesh the filling, closed and outward, in one or more pieces; None if it is empty.

        With a ``radius`` [m], it consists of all balls of that radius with centres in the filling
        outside the bodies, and is nowhere thinner than these.
        """
        edge = self.width / 2.0
        cubes = self._cubes(edge)
        if len(cubes) == 0:
            return None
        grid = _grid(cubes, self.low, edge)
        level, outside = self._levels(grid)
        if not (level < 0.0).any():
            return None
        if radius == 0.0:
            return _level_set(grid, level)
        return _balls(grid.points[(level < 0.0) & (outside > -edge)], radius)

    def _distances(
        self, points: Float64[np.ndarray, "points 3"]
    ) -> tuple[Float64[np.ndarray, "points"], Float64[np.ndarray, "points"]]:
        """Distance of points (P, 3) [m] from each body [m], negative inside."""
        return -self.first(points), -self.second(points)

    @property
    def _reach(self) -> float:
        """How far the filling reaches into the bodies [m]."""
        return 0.6 * self.width

    def _cubes(self, edge: float) -> Int64[np.ndarray, "cubes 3"]:
        """Find the cubes of the grid that the surface of the filling may pass."""
        # Start with about eight cubes along the box and halve those that may hold filling.
        size = edge * 2.0 ** max(0, round(np.log2((self.high - self.low).max() / (8.0 * edge))))
        counts = np.maximum(np.ceil((self.high - self.low) / size).astype(np.int64), 1)
        cubes = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=3).reshape(-1, 3)
        while True:
            first, second = self._distances(self.low + size * (cubes + 0.5))
            radius = np.sqrt(0.75) * size
            cubes = cubes[
                (np.minimum(first, second) > -self._reach - radius)
                & (first + second < self.width + 2.0 * radius)
            ]
            if len(cubes) > 1e6:
                raise InvalidInput(
                    f"the bodies are so close over so large an area that the filling takes more "
                    f"than a million cubes of {size * 1e3:.3g} mm; move them apart, or make one "
                    "body of them before.",
                    0.5 * (self.low + self.high),
                    code="too_many",
                )
            if size <= edge * 1.5:
                return cubes
            cubes = (2 * cubes[:, None] + _CORNERS).reshape(-1, 3)
            size = size / 2.0

    def _levels(
        self, grid: "_Grid"
    ) -> tuple[Float64[np.ndarray, "points"], Float64[np.ndarray, "points"]]:
        """Level of grid points, negative in the filling, and distance from both bodies [m]."""
        first, second = self._distances(grid.points)
        total = first + second
        outside = np.minimum(first, second)
        # The gradient of the sum of distances is the sum of two outward normals: 0 where surfaces
        # face each other, of length 1.41 at a right angle. From 0.3 on the width decreases, at 0.9
        # nothing is filled, and beyond the filling keeps off a furrow.
        around = grid.keys[:, None] + grid.strides * np.array([1, -1])[:, None, None]
        match = np.minimum(np.searchsorted(grid.keys, around), len(grid.keys) - 1)
        ahead, behind = total[match]
        steepness = np.linalg.norm(ahead - behind, axis=1) / (2.0 * grid.edge)
        facing = np.clip(1.5 * (1.0 - steepness / 0.9), -1.0, 1.0)
        # Where a neighbouring grid point is missing, the filling ends.
        facing[(grid.keys[match] != around).any(axis=(0, 2))] = -1.0
        level = np.maximum(total - self.width * facing, -outside - self._reach)
        return _snapped(level, grid.edge), outside


def _balls(centres: Float64[np.ndarray, "points 3"], radius: float) -> FlatMesh:
    """Mesh all points within a radius [m] of centres (P, 3) [m]."""
    edge = radius / 3.0
    low = centres.min(axis=0) - 2.0 * radius
    cubes = np.floor((centres - low) / edge).astype(np.int64)
    for _ in range(4):  # one cube more on each side than the radius
        for axis in np.eye(3, dtype=np.int64):
            cubes = np.unique(np.concatenate([cubes - axis, cubes, cubes + axis]), axis=0)
    grid = _grid(cubes, low, edge)
    return _level_set(grid, _snapped(KDTree(centres).query(grid.points)[0] - radius, edge))


@dataclass(frozen=True, eq=False)
class _Grid:
    """Cubes of an edge [m] and the points at their corners [m].

    Points have ascending keys that differ by ``strides`` between neighbours along the axes.
    """

    edge: float
    points: Float64[np.ndarray, "points 3"]
    keys: Int64[np.ndarray, "points"]
    strides: Int64[np.ndarray, "3"]
    corners: Int64[np.ndarray, "cubes 8"]


def _grid(cubes: Int64[np.ndarray, "cubes 3"], low: Vector3, edge: float) -> _Grid:
    corners = cubes[:, None] + _CORNERS
    strides = np.array([1, *np.cumprod(corners.max(axis=(0, 1))[:2] + 2)])
    keys, inverse = np.unique(corners @ strides, return_inverse=True)
    points = np.empty((len(keys), 3))
    points[inverse.ravel()] = low + edge * corners.reshape(-1, 3)
    return _Grid(edge, points, keys, strides, inverse.reshape(-1, 8))


def _snapped(level: Float64[np.ndarray, "points"], edge: float) -> Float64[np.ndarray, "points"]:
    """Keep levels off zero, so that the surface makes no slivers at grid points."""
    smallest = 0.05 * edge
    return np.where(level < 0.0, np.minimum(level, -smallest), np.maximum(level, smallest))


def _level_set(grid: _Grid, level: Float64[np.ndarray, "points"]) -> FlatMesh:
    """Mesh the zero level by marching tetrahedra, with the negative side inside."""
    # Six right-handed tetrahedra around a diagonal of the cube, from corner 0 to corner 7.
    paths = []
    for step, next_step, _ in permutations((1, 2, 4)):
        path = [0, step, step + next_step, 7]
        right_handed = np.linalg.det(_CORNERS[path[1:]]) > 0.0
        paths.append(path if right_handed else [0, step + next_step, step, 7])
    tetrahedra = grid.corners[:, np.array(paths)].reshape(-1, 4)
    # Triangles between inside and outside, for each set of inside corners (bits). A corner of a
    # triangle is given by the two ends of the edge that it lies on.
    tables = {}
    for a, b, c, d in permutations(range(4)):
        if np.linalg.det(np.eye(4)[[a, b, c, d]]) > 0.0:
            tables[1 << a] = np.array([[[a, b], [a, c], [a, d]]])
            tables[15 - (1 << a)] = tables[1 << a][:, ::-1]
            tables[1 << a | 1 << b] = np.array([[[a, c], [a, d], [b, d]], [[a, c], [b, d], [b, c]]])
    pattern = (level[tetrahedra] < 0.0) @ np.array([1, 2, 4, 8])
    ends = [np.zeros((0, 3, 2), dtype=np.int64)]
    for bits, table in tables.items():
        ends.append(tetrahedra[pattern == bits][:, table].reshape(-1, 3, 2))
    keys = np.sort(np.concatenate(ends).reshape(-1, 2), axis=1) @ np.array([len(level), 1])
    edges, triangles = np.unique(keys, return_inverse=True)
    start, end = np.divmod(edges, len(level))
    share = (level[start] / (level[start] - level[end]))[:, None]
    vertices = grid.points[start] * (1.0 - share) + grid.points[end] * share
    return vertices, triangles.reshape(-1, 3).astype(np.int64)
