"""Merging of bodies that overlap, touch or nearly touch.

Narrow gaps between two bodies are filled with balls. A ball is placed where the sum of the
distances to both bodies is at most the gap and their surfaces face each other. Furrows with a wide
angle remain.
"""

from collections.abc import Iterable, Sequence
from itertools import combinations, product

import numpy as np
from scipy.ndimage import distance_transform_edt

from airtact.errors import (
    InvalidInput,
    extra,
    in_mm,
    of_kind,
    within,
)
from airtact.geometry.checks import NEAREST, Approach, approach, check_not_crossed, check_surface
from airtact.geometry.mesh.remeshing import near_surface
from airtact.geometry.mesh.repair import flat_mesh_of, solid_of, without_slivers
from airtact.geometry.mesh.triangles import (
    FlatMesh,
    PointLengths,
    Points,
    components,
    cone_volumes,
    shells,
)
from airtact.geometry.primitives import Capsule
from airtact.geometry.surface import Surface

# Largest distance of the flat triangles of a merged body from the bodies [m].
FLAT_TOLERANCE = 10e-6


def merged(surfaces: Sequence[Surface], gap: float = NEAREST) -> Surface:
    """Merge bodies that overlap, touch or are at most ``gap`` apart into one body.

    The air between two bodies is filled with balls wherever the distances to both bodies add up
    to at most the gap and their surfaces face each other. The diameter of the balls is 0.6 mm,
    or 1.2 times the gap if that is larger. The gap is filled completely if the surfaces are
    within 17 degrees of parallel, and partly up to 53 degrees. Furrows with a wider angle
    remain. Enclosed air is filled. Elsewhere the surface is unchanged to within 10 micrometres.

    Parameters
    ----------
    surfaces : the bodies, in any order. A body that lies entirely inside another is ignored.
    gap : largest distance between surfaces that is bridged [m], 0.0001 to 0.002; by default 0.0003,
        the smallest distance that ``Scene`` allows between bodies.

    Returns
    -------
    The merged body, a ``Surface`` of triangles. If only one body remains, it is returned unchanged.

    Raises
    ------
    InvalidInput
        If there are no bodies, if a body has self-intersections, if bodies are farther apart than
        the gap, or if a part of the merged body is thinner than 0.5 mm.

    Examples
    --------
    >>> from airtact.geometry.primitives import sphere
    >>> balls = [sphere(radius=2e-3, edge=1e-3, centre=(x, 0, 0)) for x in (0, 3e-3)]
    >>> volumes = sum(ball.volume for ball in balls), float(merged(balls).volume)
    >>> [round(volume * 1e9, 1) for volume in volumes]
    [67.0, 64.2]
    """
    from manifold3d import Manifold, OpType

    bodies = [
        of_kind(body, Surface, f"body {index}", "a Surface")
        for index, body in enumerate(
            of_kind(surfaces, Iterable, "the surfaces", "a list of Surface")
        )
    ]
    gap = within(gap, 0.1e-3, 2e-3, "the gap to be bridged", "m")
    if not bodies:
        raise InvalidInput("there are no bodies to merge; pass one or more.", code="empty")
    for body in bodies:
        check_not_crossed(body)
    solids = {index: solid_of(*_flattened(body)) for index, body in enumerate(bodies)}
    for index in reversed(range(len(bodies))):
        rest = [solid for number, solid in solids.items() if number != index]
        volume = solids[index].volume()
        if any((solids[index] - solid).volume() < 1e-9 * volume for solid in rest):
            del solids[index]
    if len(solids) == 1:
        return bodies[next(iter(solids))]
    parts = list(solids.values())
    for (first, second), near in _links(bodies, list(solids), gap).items():
        parts.append(solid_of(*_bridge(bodies[first], bodies[second], near, gap)).simplify(8e-6))
    union = Manifold.batch_boolean(parts, OpType.Add)
    for _ in range(2):
        # A mesh declared as original can be simplified across the borders of its parts.
        union = union.as_original().simplify(1e-6)
    vertices, triangles = flat_mesh_of(union)
    piece = shells(triangles)
    solid_piece = np.bincount(piece, weights=cone_volumes(vertices[triangles])) > 0.0
    vertices, triangles = without_slivers(vertices, triangles[solid_piece[piece]], [])
    used, triangles = np.unique(triangles, return_inverse=True)
    result = Surface(
        vertices[used],
        triangles.reshape(-1, 3),
        sharp_degrees=45.0,  # edges on round parts of merged bodies turn by less
        repairs=tuple(sentence for index in solids for sentence in bodies[index].repairs),
    )
    check_surface(result)
    return result


def _flattened(body: Surface) -> FlatMesh:
    if isinstance(body.shape, Capsule):
        return body.shape.flat_mesh(FLAT_TOLERANCE)
    return near_surface(body.quadratic_triangles, body.triangles, FLAT_TOLERANCE)


def _links(
    bodies: Sequence[Surface], chosen: list[int], gap: float
) -> dict[tuple[int, int], Approach]:
    """Return pairs of bodies at most a gap apart; raise ``InvalidInput`` if some are not linked."""
    near = {}
    for first, second in combinations(chosen, 2):
        distance = approach(bodies[first], bodies[second])
        if distance is not None:
            near[first, second] = distance
    links = {pair: close for pair, close in near.items() if close.gap <= gap * (1.0 + 1e-9)}
    ends = np.array(list(links), dtype=np.int64).reshape(-1, 2)
    part = components(ends[:, 0], ends[:, 1], len(bodies))
    apart = [pair for pair in near if part[pair[0]] != part[pair[1]]]
    if apart:
        first, second = min(apart, key=lambda pair: near[pair].gap)
        distance, where = near[first, second]
        raise InvalidInput(
            f"bodies {first} and {second} are {distance * 1e3:.3g} mm apart near {in_mm(where)}, "
            f"but only gaps of up to {gap * 1e3:.3g} mm are bridged. Move them closer, remove one, "
            "or use a larger gap.",
            where,
            code="misplaced",
        )
    return links


def _bridge(first: Surface, second: Surface, near: Approach, gap: float) -> FlatMesh:
    with extra("mesh", "merging bodies needs scikit-image"):
        from skimage.measure import marching_cubes

    edge = gap / 2.0
    radius = max(0.3e-3, 0.6 * gap)
    # The balls are centred on a grid.
    centres = np.concatenate([_filling(first, second, near, gap), near.position[None]])
    low = centres.min(axis=0)
    steps = np.round((centres - low) / edge).astype(np.int64)
    margin = int(np.ceil(radius / edge)) + 2
    shape = steps.max(axis=0) + 2 * margin + 1
    _check_count(int(np.prod(shape)), near)
    empty = np.ones(shape, dtype=bool)
    empty[tuple((steps + margin).T)] = False
    level = edge * np.asarray(distance_transform_edt(empty)) - radius
    level[np.abs(level) < 0.05 * edge] = 0.05 * edge  # avoids slivers at grid points
    vertices, triangles, _, _ = marching_cubes(
        level, 0.0, spacing=(edge,) * 3, gradient_direction="descent"
    )
    return vertices + low - margin * edge, triangles.astype(np.int64)


def _filling(first: Surface, second: Surface, near: Approach, gap: float) -> Points:
    """Return the points to fill between facing bodies, on a grid with a spacing of half a gap."""
    edge = gap / 2.0
    low = np.maximum(first.vertices.min(axis=0), second.vertices.min(axis=0)) - 2.0 * gap
    high = np.minimum(first.vertices.max(axis=0), second.vertices.max(axis=0)) + 2.0 * gap

    def depths(points: Points) -> tuple[PointLengths, PointLengths]:
        return first.shape.depth(points), second.shape.depth(points)

    # The search starts with about eight cubes along the box and halves those that may be filled.
    size = edge * 2.0 ** max(0, round(np.log2((high - low).max() / (8.0 * edge))))
    counts = np.maximum(np.ceil((high - low) / size), 1)
    cubes = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=3).reshape(-1, 3)
    corners = np.array(list(product((0.0, 1.0), repeat=3)))
    while True:
        points = low + size * (cubes + 0.5)
        first_depth, second_depth = depths(points)
        radius = np.sqrt(0.75) * size if size > edge else 0.0
        outside = np.maximum(first_depth, second_depth) < edge + radius
        cubes = cubes[outside & (-first_depth - second_depth < gap + 2.0 * radius)]
        _check_count(20 * len(cubes), near)
        if size <= edge:
            break
        cubes = (2 * cubes[:, None] + corners).reshape(-1, 3)
        size = size / 2.0
    points = low + size * (cubes + 0.5)
    # The gradient of the sum of distances is the sum of two outward normals. Its length is 0 if the
    # surfaces face each other, and 1.41 at a right angle. The filled width decreases above a length
    # of 0.3, and nothing is filled above 0.9.
    gradient = []
    for step in edge * np.eye(3):
        ahead = np.sum(depths(points + step), axis=0)
        gradient.append((ahead - np.sum(depths(points - step), axis=0)) / (2.0 * edge))
    facing = np.clip(1.5 * (1.0 - np.linalg.norm(gradient, axis=0) / 0.9), -1.0, 1.0)
    return points[-np.sum(depths(points), axis=0) < gap * facing]


def _check_count(count: int, near: Approach) -> None:
    if count > 20_000_000:
        raise InvalidInput(
            f"the gap between the bodies is too large to fill ({count:,} grid points); move the "
            "bodies apart, or merge them in a CAD program.",
            near.position,
            code="too_many",
        )
