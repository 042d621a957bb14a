"""Cracks a few micrometres wide, on plain arrays.

On one side of such a crack lie other vertices than on the other: each a few micrometres from its
partner, or with no partner at all on an edge of the other side (a T-junction).
"""

import numpy as np
from jaxtyping import Int64
from scipy.spatial import KDTree

from airtact.checks import counted, in_mm
from airtact.geometry.mesh.mesh_distance import pairs_near
from airtact.geometry.mesh.topology import (
    Numbers,
    Triangles,
    Vertices,
    are_among,
    components,
    edge_ends,
    edge_keys,
    with_fans,
)

CRACK = 5e-6
"""Border vertices nearer than this to each other, or to a border edge, are the two sides of a crack [m] ..."""
FLATTEST = 1e-2
"""... if they are also nearer than this share of the edge's length."""
MOST = 3_000_000
"""With more vertices near edges than this, the mesh consists of loose triangles and is left alone."""
ROUNDS = 8
"""Each round splits one edge of a triangle; later rounds find what was split on the other side of the crack."""


def without_cracks(
    vertices: Vertices, triangles: Triangles, notes: list[str]
) -> Int64[np.ndarray, "whole 3"]:
    """Join the border vertices that face each other over a crack, and split the border edges on which others lie."""
    triangles = _joined(vertices, triangles, notes)
    split: list[int] = []
    for _ in range(ROUNDS):
        edges, on = _vertices_on_edges(vertices, triangles)
        if len(on) == 0:
            break
        split.extend(on.tolist())
        through: dict[int, list[int]] = {}
        for edge, vertex in zip(edges.tolist(), on.tolist(), strict=True):
            through.setdefault(edge, []).append(vertex)
        triangles = with_fans(triangles, through)
    if split:
        one, many = (
            "vertex lay on an edge of a neighbour, which was",
            "vertices lay on edges of neighbours, which were",
        )
        lay = counted(len(split), one, many)
        notes.append(
            f"{lay} split there to close the crack, the first near {in_mm(vertices[split[0]])}."
        )
    return triangles


def _border(triangles: Triangles) -> tuple[Numbers, Int64[np.ndarray, "n 2"]]:
    """Edges 3 t + e of one triangle only, and their ends."""
    _, where, count = np.unique(edge_keys(triangles), return_inverse=True, return_counts=True)
    border = np.flatnonzero(count[where.ravel()] == 1)
    return border, edge_ends(triangles).reshape(-1, 2)[border]


def _joined(vertices: Vertices, triangles: Triangles, notes: list[str]) -> Triangles:
    """Make border vertices one that nearly meet and belong to no common triangle."""
    rim = np.unique(_border(triangles)[1])
    if len(rim) == 0:
        return triangles
    pairs = rim[KDTree(vertices[rim]).query_pairs(CRACK, output_type="ndarray")]
    pairs = pairs[~are_among(pairs, edge_ends(triangles))]
    cluster = components(pairs[:, 0], pairs[:, 1], len(vertices))
    first = np.unique(cluster, return_index=True)[1][cluster]
    folded = (first[triangles] == np.roll(first[triangles], 1, axis=1)).any(axis=1)
    spared = np.isin(cluster, cluster[triangles[folded]])
    first[spared] = np.flatnonzero(spared)
    joined = np.flatnonzero(first != np.arange(len(vertices)))
    if len(joined) == 0:
        return triangles
    gap = float(np.linalg.norm(vertices[joined] - vertices[first[joined]], axis=1).max())
    across = counted(
        len(joined),
        "vertex was joined with another across a crack",
        "vertices were joined across cracks",
    )
    notes.append(
        f"{across} of up to {gap * 1e6:.2g} micrometres, the first near {in_mm(vertices[joined[0]])}."
    )
    return first[triangles]


def _vertices_on_edges(vertices: Vertices, triangles: Triangles) -> tuple[Numbers, Numbers]:
    """Border edges 3 t + e, one of a triangle, and the border vertices that lie on them."""
    border, ends = _border(triangles)
    rim = np.unique(ends)
    none = np.zeros(0, dtype=np.int64)
    if len(border) == 0:
        return none, none
    start, along = vertices[ends[:, 0]], vertices[ends[:, 1]] - vertices[ends[:, 0]]
    length = np.linalg.norm(along, axis=1)
    tree, middle = KDTree(vertices[rim]), start + along / 2.0
    if tree.query_ball_point(middle, length / 2.0, return_length=True).sum() > MOST:
        return none, none
    edge, vertex = pairs_near(tree, middle, length / 2.0)
    vertex = rim[vertex]
    from_start = vertices[vertex] - start[edge]
    reach = np.einsum("ni,ni->n", from_start, along[edge]) / length[edge]
    away = np.linalg.norm(from_start - reach[:, None] * along[edge] / length[edge, None], axis=1)
    on = (
        (away <= np.minimum(CRACK, FLATTEST * length[edge]))
        & (reach > CRACK)
        & (reach < length[edge] - CRACK)
    )
    on &= (triangles[border[edge] // 3] != vertex[:, None]).all(axis=1)
    edge, vertex = border[edge[on]], vertex[on]
    order = np.lexsort((reach[on], edge))
    edge, vertex = edge[order], vertex[order]
    chosen = np.isin(
        edge, edge[np.unique(edge // 3, return_index=True)[1]]
    )  # one edge of a triangle in a round
    return edge[chosen], vertex[chosen]
