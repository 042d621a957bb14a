"""Which way triangles run: neighbours alike, closed pieces outward, on plain arrays."""

import numpy as np
from jaxtyping import Bool

from airtact.checks import counted, in_mm
from airtact.errors import InvalidInput
from airtact.geometry.mesh.topology import (
    Numbers,
    Triangles,
    Twins,
    Vertices,
    components,
    cone_volumes,
    edge_ends,
    edge_keys,
    shells,
)


def wound_alike(vertices: Vertices, triangles: Triangles, notes: list[str]) -> Triangles:
    """Turn triangles round so that neighbours run alike, as few as possible in each piece.

    Every triangle stands twice in a graph, as it is and turned round, and is tied to those copies
    of its neighbours that run as it does. A piece that can be wound alike falls into two mirrored
    parts; a one-sided one stays one, which is an error, as are edges of more than two triangles.
    """
    here, there, alike = _neighbours(vertices, triangles)
    count = len(triangles)
    mirrored = np.where(alike, there, there + count)
    ends = (
        np.concatenate([here, here + count]),
        np.concatenate([mirrored, (mirrored + count) % (2 * count)]),
    )
    label = components(ends[0], ends[1], 2 * count)
    plain, turned = label[:count], label[count:]
    one_sided = np.flatnonzero(plain == turned)
    if len(one_sided):
        where = vertices[triangles[one_sided[0]]].mean(axis=0)
        raise InvalidInput(
            f"{counted(len(one_sided), 'triangle belongs', 'triangles belong')} to a one-sided piece, as a Moebius "
            f"strip is, the first near {in_mm(where)}: it has no inside; remove it.",
            where,
            code="mesh_faulty",
        )
    as_given = np.bincount(plain, minlength=2 * count)
    flip = (as_given[plain] < as_given[turned]) | (
        (as_given[plain] == as_given[turned]) & (plain > turned)
    )
    if not flip.any():
        return triangles
    one, many = (
        "triangle ran against its neighbours and was",
        "triangles ran against their neighbours and were",
    )
    ran = counted(int(flip.sum()), one, many)
    notes.append(
        f"{ran} turned, the first near {in_mm(vertices[triangles[flip.argmax()]].mean(axis=0))}."
    )
    return np.where(flip[:, None], triangles[:, ::-1], triangles)


def _neighbours(
    vertices: Vertices, triangles: Triangles
) -> tuple[Numbers, Numbers, Bool[np.ndarray, "n"]]:
    """Pairs of triangles over an edge, and whether they run alike (through the edge in opposite directions)."""
    keys = edge_keys(triangles).ravel()
    order = np.argsort(keys, kind="stable")
    _, starts, sizes = np.unique(keys[order], return_index=True, return_counts=True)
    crowded = np.flatnonzero(sizes > 2)
    if len(crowded):
        first = order[starts[crowded]].min()
        where = vertices[edge_ends(triangles).reshape(-1, 2)[first]].mean(axis=0)
        edges = counted(len(crowded), "edge has", "edges have")
        raise InvalidInput(
            f"{edges} more than two triangles, the first {int(sizes[(order[starts] == first).argmax()])} of them near "
            f"{in_mm(where)}: bodies meet there or a fin stands out; part them or remove it.",
            where,
            code="mesh_faulty",
        )
    twice = starts[sizes == 2]
    one, two = order[twice], order[twice + 1]
    alike = triangles.ravel()[one] != triangles.ravel()[two]
    return one // 3, two // 3, alike


def turned_outward(
    vertices: Vertices, triangles: Triangles, twins: Twins, notes: list[str]
) -> Triangles:
    """Turn the closed pieces round that enclose a volume below zero; raise where one encloses nothing."""
    piece = shells(triangles, twins)
    volumes = np.bincount(piece, weights=cone_volumes(vertices[triangles]))
    flat = np.flatnonzero(volumes == 0.0)
    if len(flat):
        where = vertices[triangles[(piece == flat[0]).argmax()]].mean(axis=0)
        raise InvalidInput(
            f"{counted(len(flat), 'closed piece encloses', 'closed pieces enclose')} 0 cm³, the first near "
            f"{in_mm(where)}; remove it or give it a thickness.",
            where,
            code="mesh_faulty",
        )
    inward = np.flatnonzero(volumes < 0.0)
    if len(inward) == 0:
        return triangles
    flip = (volumes < 0.0)[piece]
    were = counted(len(inward), "closed piece was", "closed pieces were")
    notes.append(
        f"{were} inside out and turned round, the first of {int((piece == inward[0]).sum())} triangles near "
        f"{in_mm(vertices[triangles[flip.argmax()]].mean(axis=0))}."
    )
    return np.where(flip[:, None], triangles[:, ::-1], triangles)


def check_no_bow_ties(vertices: Vertices, triangles: Triangles, twins: Twins) -> None:
    """Check that no parts of a closed mesh hang together by one vertex alone."""
    after = (3 * (twins // 3) + (twins + 1) % 3).ravel()  # the next corner round the same vertex
    least, jump = np.arange(len(after)), after
    while True:  # the least corner of each ring, by jumps of doubled length
        further = np.minimum(least, least[jump])
        if np.array_equal(further, least):
            break
        least, jump = further, jump[jump]
    rings = np.bincount(triangles.ravel()[least == np.arange(len(least))], minlength=len(vertices))
    tied = np.flatnonzero(rings > 1)
    if len(tied):
        hang = counted(len(tied), "vertex joins", "vertices join")
        raise InvalidInput(
            f"{hang} parts of the surface that touch nowhere else, the first near {in_mm(vertices[tied[0]])}: a body "
            "cannot hang by a point; move the parts apart or join them.",
            vertices[tied[0]],
            code="mesh_faulty",
        )
