"""One body of several that overlap, touch or nearly touch."""

from collections.abc import Iterable, Sequence
from itertools import combinations
from operator import itemgetter

import numpy as np
from jaxtyping import Float64

from airtact.checks import in_mm, of_kind, within
from airtact.errors import InvalidInput
from airtact.geometry.bridges import Filling, balls, filling
from airtact.geometry.checks import (
    NEAREST,
    THINNEST,
    TOUCH,
    approach,
    check_not_crossed,
    check_surface,
    thin_part,
)
from airtact.geometry.flattening import AWAY, corners_of, flattened
from airtact.geometry.mesh.intersections import crossings_between
from airtact.geometry.mesh.quadratic_triangles import longest_edges
from airtact.geometry.mesh.repair.slivers import without_slivers
from airtact.geometry.mesh.topology import (
    Triangles,
    Vertices,
    components,
    cone_volumes,
    edge_twins,
    shells,
)
from airtact.geometry.primitives import Capsule
from airtact.geometry.shape import FlatMesh
from airtact.geometry.surface import Surface

NARROWEST, WIDEST = 0.1e-3, 2e-3
"""Gaps that may be asked to be bridged [m]."""

THICK = 0.3e-3
"""Radius of the balls that make bridges which are too thin, or 0.6 gaps if that is more [m]."""

SHARP_DEGREES = 45.0
"""Edges of merged bodies stay sharp above this angle: where they are round their triangles turn less."""

FLAT = 0.1
"""Middles of edges are moved by less than this share of the heights of their triangles."""

SIMPLE = (4e-6, 1e-6, 0.0)
"""Farthest that triangles are moved to have fewer small ones [m]: the first that leaves none crossing is taken."""

ROUGHLY = 8e-6
"""The same for the bridges by themselves [m]."""

PASSES = 2
"""How often that is done with the whole."""


Link = tuple[int, int, Float64[np.ndarray, "3"]]
"""Two bodies no farther apart than the gap, by their numbers, and a position (3,) between them [m]."""


def merged(surfaces: Sequence[Surface], gap: float = NEAREST) -> Surface:
    """Make one body of several that overlap, touch or stand nearer than a gap.

    Material fills the air between two bodies where the distances to both add up to at most the gap,
    as far as their surfaces face each other: wholly within 17 degrees, less and less up to 53, so
    furrows in which bodies meet at a wider angle stay as they are. Where a bridge would be thinner
    than 0.5 mm, all are made of balls of 0.6 mm (1.2 gaps if that is more) with their centres
    there. Air that is closed in is filled. Elsewhere the surface stays, within 10 micrometres.

    Parameters
    ----------
    surfaces : the bodies, in any order; one that lies wholly in another adds nothing.
    gap : distance of surfaces up to which they are bridged [m], 0.1 to 2 mm.

    Returns
    -------
    The merged body; one body alone comes back as it is. Its triangles are flat on bridges and follow the surfaces of
    the bodies elsewhere.

    Raises
    ------
    InvalidInput
        When there is no body, a body crosses itself, bodies stay farther apart than the gap (the two nearest and how
        far), or the merged body is thinner than 0.5 mm somewhere.

    Examples
    --------
    >>> from airtact.geometry.primitives import sphere
    >>> balls = [sphere(radius=2e-3, edge=1e-3, centre=(x, 0, 0)) for x in (0, 3e-3)]
    >>> round(sum(ball.volume for ball in balls) * 1e9, 1), round(float(merged(balls).volume) * 1e9, 1)
    (67.0, 64.1)
    """
    bodies = [
        of_kind(body, Surface, f"body {index}", "a Surface") for index, body in enumerate(surfaces)
    ]
    gap = within(
        gap, NARROWEST, WIDEST, "the gap to be bridged", "m", "is it in millimetres? Give metres."
    )
    if not bodies:
        raise InvalidInput("there are 0 bodies to merge; give one or more.", code="empty")
    for body in bodies:
        check_not_crossed(body)
    meshes = {index: flattened(body) for index, body in enumerate(bodies)}
    for index in reversed(range(len(bodies))):
        if any(_lies_in(bodies, meshes, index, other) for other in meshes if other != index):
            del meshes[index]
    if len(meshes) == 1:
        return bodies[next(iter(meshes))]
    found = _bridged(bodies, meshes, _links(bodies, list(meshes), gap), gap)
    check_surface(found)
    return found


def _bridged(
    bodies: Sequence[Surface], meshes: dict[int, FlatMesh], links: Sequence[Link], gap: float
) -> Surface:
    """Make one body with bridges as wide as the gap, or thicker ones where these are too thin."""
    left = [bodies[index] for index in meshes]
    pieces = (
        sum(int(shells(triangles).max()) + 1 for _, triangles in meshes.values()) - len(meshes) + 1
    )
    repairs = tuple(sentence for body in left for sentence in body.repairs)
    found = left[0]
    for radius in (0.0, max(THICK, 0.6 * gap)):
        bridges = [
            bridge for link in links for bridge in _bridges(bodies, meshes, link, gap, radius)
        ]
        if radius == 0.0 and any(
            np.ptp(vertices, axis=0).max() < 2.0 * THICK for vertices, _ in bridges
        ):
            continue
        for simple in SIMPLE:
            vertices, triangles = _united(meshes.values(), bridges, simple)
            middles = _middles(left, vertices, triangles)
            found = Surface(
                vertices, triangles, middles, sharp_degrees=SHARP_DEGREES, repairs=repairs
            )
            if len(found.crossings) == 0:
                break
        if shells(found.triangles).max() < pieces and thin_part(found, THINNEST, short=0.0) is None:
            break
    return found


def _lies_in(
    bodies: Sequence[Surface], meshes: dict[int, FlatMesh], inner: int, outer: int
) -> bool:
    """Whether a body lies wholly in another, or is the same."""
    one, two = bodies[inner], bodies[outer]
    match one.shape, two.shape:
        case Capsule() as rod, Capsule() as round_it:  # the balls at both of its ends are in
            return bool((round_it.depth(rod.axis) >= rod.radius - TOUCH).all())
    if np.array_equal(meshes[inner][0], meshes[outer][0]) and np.array_equal(
        meshes[inner][1], meshes[outer][1]
    ):
        return True
    corners = corners_of(meshes[inner])
    seeds = corners[np.unique(shells(meshes[inner][1]), return_index=True)[1], 0]
    return (
        bool((two.depth(seeds) > 0.0).all())
        and len(crossings_between(corners, corners_of(meshes[outer]))) == 0
    )


def _links(bodies: Sequence[Surface], chosen: list[int], gap: float) -> list[Link]:
    """Find pairs of bodies no farther apart than the gap; raise ``InvalidInput`` where not all hang together."""
    links = []
    for one, two in combinations(chosen, 2):
        near = approach(bodies[one], bodies[two], gap * (1.0 + 1e-9))
        if near is not None:
            links.append((one, two, near.position))
    ends = np.array([(one, two) for one, two, _ in links], dtype=np.int64).reshape(-1, 2)
    part = components(ends[:, 0], ends[:, 1], len(bodies))
    away = []
    for one, two in combinations(chosen, 2):
        if part[one] != part[two] and (near := approach(bodies[one], bodies[two])) is not None:
            away.append((near.distance, one, two, near.position))
    if away:
        distance, one, two, where = min(away, key=itemgetter(0))
        raise InvalidInput(
            f"bodies {one} and {two} are {distance * 1e3:.3g} mm apart near {in_mm(where)}, the nearest of those that "
            f"do not hang together, but only {gap * 1e3:.3g} mm are bridged; move them together, leave one out, or "
            "give a larger gap.",
            where,
            code="misplaced",
        )
    return links


def _bridges(
    bodies: Sequence[Surface], meshes: dict[int, FlatMesh], link: Link, gap: float, radius: float
) -> list[FlatMesh]:
    """Mesh what fills the air between two bodies, made of balls where a radius is given."""
    one, two, position = link
    low = np.maximum(meshes[one][0].min(axis=0), meshes[two][0].min(axis=0)) - 2.0 * gap
    high = np.minimum(meshes[one][0].max(axis=0), meshes[two][0].max(axis=0)) + 2.0 * gap
    found = filling(Filling(bodies[one].depth, bodies[two].depth, low, high, gap), radius)
    always = balls(position[None], radius) if radius > 0.0 else None
    return [mesh for mesh in (found, always) if mesh is not None]


def _middles(
    bodies: Sequence[Surface], vertices: Vertices, triangles: Triangles
) -> Float64[np.ndarray, "_ 3 3"]:
    """Middles of the edges, brought to the surfaces of the bodies where these are so near that no triangle folds."""
    corners = vertices[triangles]
    along = np.roll(corners, -1, axis=1) - corners
    twice = np.linalg.norm(np.cross(along[:, 0], along[:, 1]), axis=1)
    height = (twice / longest_edges(corners))[:, None]
    twins = edge_twins(triangles)
    allowed = np.minimum(2.0 * AWAY, FLAT * np.minimum(height, height.ravel()[twins // 3])).ravel()
    once = np.flatnonzero(np.arange(twins.size) < twins.ravel())
    middles = ((corners + 0.5 * along).reshape(-1, 3))[once]
    placed, nearest = middles.copy(), allowed[once]
    for body in bodies:
        depth = np.abs(body.depth(middles))
        near = np.flatnonzero(depth < nearest)
        placed[near], nearest[near] = body.shape.project(middles[near]), depth[near]
    result = np.empty((twins.size, 3))
    result[once] = result[twins.ravel()[once]] = placed
    return result.reshape(-1, 3, 3)


def _united(
    bodies: Iterable[FlatMesh], bridges: Iterable[FlatMesh], simple: float
) -> tuple[Vertices, Triangles]:
    """Unite closed meshes into one, without slivers and without the air that is closed in."""
    from manifold3d import Error, Manifold, Mesh64, OpType

    def solid(mesh: FlatMesh) -> Manifold:
        return Manifold(
            Mesh64(mesh[0].copy(), mesh[1].astype(np.uint64))
        )  # it takes no read-only ones

    solids = [solid(body) for body in bodies] + [
        solid(bridge).simplify(ROUGHLY) for bridge in bridges
    ]
    whole = Manifold.batch_boolean(solids, OpType.Add)
    for _ in range(PASSES):
        whole = whole.as_original().simplify(
            simple
        )  # as if it had never been of several, where it keeps their borders
    assert whole.status() == Error.NoError  # closed meshes that do not cross themselves
    mesh = whole.to_mesh64()
    vertices, triangles = (
        mesh.vert_properties[:, :3].astype(np.float64),
        mesh.tri_verts.astype(np.int64),
    )
    piece = shells(triangles)
    filled = np.bincount(piece, weights=cone_volumes(vertices[triangles])) > 0.0
    triangles = without_slivers(vertices, triangles[filled[piece]], [])
    used, triangles = np.unique(triangles, return_inverse=True)
    return vertices[used], triangles.reshape(-1, 3)
