"""How the triangles of a mesh hang together, and whether they can be a body, on plain arrays."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float64, Int, Int64, Real
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

from airtact.checks import counted, in_mm
from airtact.errors import InvalidInput
from airtact.geometry.mesh.quadratic_triangles import Corners, longest_edges

Vertices = Float64[np.ndarray, "vertices 3"]
"""(V, 3) [m]."""
Triangles = Int64[np.ndarray, "triangles 3"]
"""(T, 3) vertex indices."""
Twins = Int64[np.ndarray, "triangles 3"]
"""(T, 3) what ``edge_twins`` finds."""
Numbers = Int64[np.ndarray, "n"]
"""(N,) numbers of things."""

THINNEST = 1e-6
"""A triangle whose height is below this share of its longest edge counts as degenerate."""
LARGEST = 2.0
"""Largest extent of a body [m]."""
SMALLEST = 0.5e-3
"""Smallest extent of a body [m]."""


def edge_twins(triangles: Int[np.ndarray, "triangles 3"]) -> Twins:
    """Find for each directed edge (01, 12, 20) the flat index 3 t + e of the same edge run the other way.

    It is -1 where there is none, -2 where the directed edge itself stands more than once.
    """
    start = triangles.astype(np.int64)
    end = np.roll(start, -1, axis=1)
    count = int(triangles.max()) + 1 if triangles.size else 1
    forward = (start * count + end).ravel()
    backward = (end * count + start).ravel()
    order = np.argsort(forward, kind="stable")
    ranked = forward[order]
    found = np.minimum(np.searchsorted(ranked, backward), len(ranked) - 1)
    twins = np.where(ranked[found] == backward, order[found], -1)
    again = np.zeros(len(ranked), dtype=bool)
    again[1:] |= ranked[1:] == ranked[:-1]
    again[:-1] |= ranked[1:] == ranked[:-1]
    twins[order[again]] = -2
    return twins.reshape(-1, 3)


def edge_keys(triangles: Int[np.ndarray, "triangles 3"]) -> Triangles:
    """Give the edges 01, 12, 20 of each triangle a number, low * count + high, that is alike in both directions."""
    start = triangles.astype(np.int64)
    end = np.roll(start, -1, axis=1)
    count = int(triangles.max()) + 1 if triangles.size else 1
    return np.minimum(start, end) * count + np.maximum(start, end)


def shells(
    triangles: Int[np.ndarray, "triangles 3"], twins: Twins | None = None
) -> Int64[np.ndarray, "triangles"]:
    """Label the connected pieces of a closed mesh (T,), in the order of their first triangles."""
    twins = edge_twins(triangles) if twins is None else twins
    count = len(twins)
    graph = csr_array(
        (np.ones(3 * count, dtype=bool), twins.ravel() // 3, np.arange(0, 3 * count + 1, 3))
    )
    return connected_components(graph, connection="strong")[1].astype(
        np.int64
    )  # strong is faster; all ties are mutual


def components(
    one: Int[np.ndarray, "links"], two: Int[np.ndarray, "links"], count: int
) -> Int64[np.ndarray, "members"]:
    """Label which of ``count`` things hang together, by links between the one and the other."""
    links = coo_array((np.ones(len(one), dtype=bool), (one, two)), shape=(count, count))
    return connected_components(links, directed=False)[1].astype(np.int64)


def smooth_patches(
    twins: Twins, apart: Bool[np.ndarray, "triangles 3"]
) -> Int64[np.ndarray, "triangles"]:
    """Label the triangles of a closed mesh that hang together across edges which do not part them."""
    triangle, edge = np.nonzero(~apart)
    return components(triangle, twins[triangle, edge] // 3, len(twins))


def with_fans(
    triangles: Triangles, through: Mapping[int, Sequence[int]]
) -> Int64[np.ndarray, "more 3"]:
    """Replace triangles by fans from the corner opposite an edge 3 t + e, one of a triangle, to vertices along it."""
    fans = []
    for edge, vertices in through.items():
        start, end, apex = np.roll(triangles[edge // 3], -(edge % 3))
        chain = np.array([start, *vertices, end])
        fans.append(np.stack([chain[:-1], chain[1:], np.full(len(chain) - 1, apex)], axis=1))
    whole = np.ones(len(triangles), dtype=bool)
    whole[np.array(list(through)) // 3] = False
    return np.concatenate([triangles[whole], *fans])


def edge_ends(triangles: Int[np.ndarray, "triangles 3"]) -> Int[np.ndarray, "triangles 3 2"]:
    """Start and end of edges 01, 12, 20 of each triangle."""
    return np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2)


def are_among(
    pairs: Int[np.ndarray, "*some 2"], others: Int[np.ndarray, "*others 2"]
) -> Bool[np.ndarray, "*some"]:
    """Whether pairs of vertices are among others, whichever of the two comes first."""
    count = max(int(pairs.max(initial=0)), int(others.max(initial=0))) + 1
    return np.isin(np.sort(pairs, axis=-1) @ [count, 1], np.sort(others, axis=-1) @ [count, 1])


def cone_volumes(corners: Corners) -> Float64[np.ndarray, "triangles"]:
    """Signed volume between each flat triangle and the centre of all corners [m³]; their sum is that of the body."""
    a, b, c = np.moveaxis(corners - corners.mean(axis=(0, 1)), 1, 0)
    return np.einsum("ti,ti->t", a, np.cross(b, c)) / 6.0


def check_size(extent: float) -> None:
    """Raise ``InvalidInput`` for an extent [m] so large or small that it must be in another unit."""
    if extent > LARGEST * (1.0 + 1e-9):
        raise InvalidInput(
            f"the surface spans {extent:.4g} m, more than {LARGEST:g} m: is this in millimetres? Give metres, or "
            "scale it by 1e-3.",
            code="too_many",
        )
    if extent < SMALLEST * (1.0 - 1e-9):
        raise InvalidInput(
            f"the surface spans {extent * 1e3:.4g} mm, less than {SMALLEST * 1e3:g} mm: is this in millimetres "
            "that were brought to metres twice? Check the scale.",
            code="out_of_range",
        )


def check_indices(count: int, triangles: Int[np.ndarray, "triangles 3"]) -> None:
    """Raise ``InvalidInput`` for triangles that name other vertices than 0 to ``count`` - 1."""
    wrong = (triangles < 0) | (triangles >= count)
    if wrong.any():
        first = np.argwhere(wrong)[0]
        raise InvalidInput(
            f"{counted(int(wrong.any(axis=1).sum()), 'triangle names', 'triangles name')} vertices that do not exist: "
            f"triangle {int(first[0])} names {int(triangles[tuple(first)])}, but indices run from 0 to {count - 1}.",
            code="out_of_range",
        )


def check_not_degenerate(
    vertices: Real[np.ndarray, "vertices 3"], triangles: Int[np.ndarray, "triangles 3"]
) -> None:
    """Raise ``InvalidInput`` for triangles without an area: how many are thinner than ``THINNEST`` and where."""
    corners = vertices[triangles]
    edges = np.roll(corners, -1, axis=1) - corners
    twice_area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    thin = np.flatnonzero(twice_area <= THINNEST * longest_edges(corners) ** 2)
    if len(thin):
        many = counted(len(thin), "triangle is", "triangles are")
        where = corners[thin[0]].mean(axis=0)
        raise InvalidInput(
            f"{many} degenerate (no area), the first is triangle {int(thin[0])} near "
            f"{in_mm(where)}; remove them or merge their vertices.",
            where,
            code="mesh_faulty",
        )


def check_closed(
    vertices: Real[np.ndarray, "vertices 3"], triangles: Int[np.ndarray, "triangles 3"]
) -> Twins:
    """Find the ``edge_twins``; raise where edges do not have exactly one neighbour that runs the other way."""
    twins = edge_twins(triangles)
    twice = (
        "run in one direction by more than one triangle (neighbours turned opposite ways, or a fin)"
    )
    once = "a triangle on one side only, so the surface is open"
    for mark, (one, many), fault, code in (
        (-2, ("is", "are"), twice, "mesh_not_oriented"),
        (-1, ("has", "have"), once, "mesh_open"),
    ):
        found = np.argwhere(twins == mark)
        if len(found):
            ends = edge_ends(triangles)[tuple(found.T)]
            count = len(np.unique(np.sort(ends, axis=1), axis=0))
            where = vertices[ends[0]].mean(axis=0)
            edges = counted(count, f"edge {one}", f"edges {many}")
            raise InvalidInput(
                f"{edges} {fault}; the first is near {in_mm(where)}: repair the mesh.",
                where,
                code=code,
            )
    return twins


def check_orientation(
    vertices: Real[np.ndarray, "vertices 3"],
    triangles: Int[np.ndarray, "triangles 3"],
    twins: Twins | None = None,
) -> None:
    """Raise ``InvalidInput`` for closed pieces whose normals look inward: how many enclose no volume above zero."""
    corners = vertices[triangles]
    piece = shells(triangles, twins)
    volumes = np.bincount(piece, weights=cone_volumes(corners))
    inward = np.flatnonzero(volumes <= 0.0)
    if len(inward):
        first = int(np.flatnonzero(piece == inward[0])[0])
        number = int(np.isin(piece, inward).sum())
        where = corners[first].mean(axis=0)
        encloses = f"encloses {volumes[inward[0]] * 1e6:.4g} cm³, near {in_mm(where)}"
        if len(volumes) == 1:
            sentence = (
                f"the surface is inside out (it {encloses}); turn its {number} triangles round."
            )
        else:
            sentence = (
                f"{len(inward)} of {len(volumes)} closed pieces {'is' if len(inward) == 1 else 'are'} inside out (the "
                f"first {encloses}); turn their {number} triangles round."
            )
        raise InvalidInput(sentence, where, code="mesh_faulty")
