"""Closed meshes, damaged at random as files are: what ``repaired`` must put right or reject."""

from collections.abc import Callable
from functools import cache

import numpy as np
import trimesh

import airtact as at

Mesh = tuple[np.ndarray, np.ndarray]
HAND = at.example("generic-hand-right.glb")


# --- bodies, in metres ----------------------------------------------------------------------------------------------


@cache
def hand() -> Mesh:
    mesh = trimesh.load_scene(HAND, process=False).to_mesh()
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    return np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int64)


def _refined(mesh: trimesh.Trimesh, edge: float) -> trimesh.Trimesh:
    mesh = mesh.subdivide_to_size(edge)
    mesh.merge_vertices()
    return mesh


def _bumpy(rng: np.random.Generator) -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(subdivisions=4)
    waves = rng.normal(size=(6, 3)) * 2.0
    height = 1.0 + 0.05 * np.cos(mesh.vertices @ waves.T).sum(axis=1)
    return trimesh.Trimesh(mesh.vertices * height[:, None] * 9.0, mesh.faces, process=False)


def _bitten(rng: np.random.Generator) -> trimesh.Trimesh:
    while True:
        ball = trimesh.creation.icosphere(subdivisions=3, radius=6.0)
        ball.apply_translation(rng.uniform(-8.0, 8.0, 3))
        bitten = trimesh.boolean.difference([trimesh.creation.box((14.0, 12.0, 10.0)), ball])
        if (
            bitten.area_faces.min() > 1e-6
        ):  # where the ball grazes an edge, the cut itself leaves slivers
            return bitten


def _pair(rng: np.random.Generator) -> trimesh.Trimesh:
    ball, rod = (
        trimesh.creation.icosphere(3, 5.0),
        trimesh.creation.capsule(20.0, 4.0, count=[16, 16]),
    )
    rod.apply_translation([15.0 + 5.0 * rng.random(), 0.0, 0.0])
    return trimesh.util.concatenate([ball, rod])


BODIES: dict[str, Callable[[np.random.Generator], trimesh.Trimesh]] = {
    "coarse ball": lambda rng: trimesh.creation.icosphere(
        subdivisions=2, radius=rng.uniform(2.0, 12.0)
    ),
    "ball": lambda rng: trimesh.creation.icosphere(subdivisions=4, radius=rng.uniform(3.0, 12.0)),
    "globe": lambda rng: trimesh.creation.uv_sphere(radius=rng.uniform(3.0, 10.0), count=[24, 48]),
    "bead": lambda rng: trimesh.creation.icosphere(subdivisions=3, radius=rng.uniform(0.3, 1.0)),
    "coarse box": lambda rng: trimesh.creation.box(rng.uniform(4.0, 20.0, 3)),
    "box": lambda rng: _refined(trimesh.creation.box(rng.uniform(8.0, 15.0, 3)), 1.2),
    "plate": lambda rng: _refined(trimesh.creation.box((20.0, 20.0, 0.6)), 1.5),
    "capsule": lambda rng: trimesh.creation.capsule(30.0, rng.uniform(2.0, 8.0), count=[24, 24]),
    "rod": lambda rng: _refined(
        trimesh.creation.cylinder(rng.uniform(0.7, 4.0), 20.0, sections=24), 2.0
    ),
    "cone": lambda rng: _refined(trimesh.creation.cone(6.0, 15.0, sections=32), 2.0),
    "ring": lambda rng: trimesh.creation.torus(10.0, rng.uniform(2.0, 5.0), 48, 24),
    "washer": lambda rng: _refined(trimesh.creation.annulus(5.0, 10.0, 3.0, sections=32), 2.0),
    "bumpy ball": _bumpy,
    "bitten box": _bitten,
    "pair": _pair,
}
"""By name, in millimetres: trimesh makes vertices one that are nearer than 1e-8 of its unit."""


def body(rng: np.random.Generator) -> tuple[str, Mesh]:
    """Take one of the bodies, or the hand, turned and shifted at random half of the time."""
    name = str(rng.choice([*BODIES, "hand"]))
    if name == "hand":
        vertices, triangles = hand()
    else:
        mesh = BODIES[name](rng)
        vertices, triangles = 1e-3 * np.asarray(mesh.vertices), np.array(mesh.faces, dtype=np.int64)
    if rng.random() < 0.5:
        turn = trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3]
        vertices = vertices @ turn.T + rng.uniform(-0.05, 0.05, 3)
    return name, (vertices, triangles)


# --- damages --------------------------------------------------------------------------------------------------------


def _grown(rng: np.random.Generator, triangles: np.ndarray, number: int) -> np.ndarray:
    """Indices of about so many triangles round a random one."""
    inside = np.zeros(len(triangles), dtype=bool)
    inside[rng.integers(len(triangles))] = True
    while inside.sum() < number:
        near = np.isin(triangles, triangles[inside]).any(axis=1) & ~inside
        if not near.any():
            break
        added = rng.permutation(np.flatnonzero(near))[: number - int(inside.sum())]
        inside[added] = True
    return np.flatnonzero(inside)


def holes(rng: np.random.Generator, v: np.ndarray, t: np.ndarray) -> Mesh:
    for _ in range(rng.integers(1, 4)):
        if len(t) > 4:
            t = np.delete(t, _grown(rng, t, int(np.exp(rng.uniform(0.0, np.log(50.0))))), axis=0)
    return v, t


def tattered(rng: np.random.Generator, v: np.ndarray, t: np.ndarray) -> Mesh:
    """Remove scattered triangles of one region, so that holes touch in vertices."""
    region = _grown(rng, t, 30)
    return v, np.delete(t, rng.permutation(region)[: rng.integers(2, 15)], axis=0)


def flipped_triangles(rng: np.random.Generator, v: np.ndarray, t: np.ndarray) -> Mesh:
    some = rng.permutation(len(t))[: rng.integers(1, 1 + max(1, len(t) // 5))]
    t = t.copy()
    t[some] = t[some, ::-1]
    return v, t


def flipped_patch(rng: np.random.Generator, v: np.ndarray, t: np.ndarray) -> Mesh:
    some = _grown(rng, t, int(rng.integers(1, max(2, len(t) // 2))))
    t = t.copy()
    t[some] = t[some, ::-1]
    return v, t


def inside_out(rng: np.random.Generator, v: np.ndarray, t: np.ndarray) -> Mesh:
    return v, t[:, ::-1].copy()


def needles(rng: np.random.Generator, v: np.ndarray, t: np.ndarray) -> Mesh:
    """Split edges, in both of their triangles, close to one end."""
    for _ in range(rng.integers(1, 6)):
        v, t = _split_edge(rng, v, t, 10.0 ** rng.uniform(-7.0, -2.0), both=True)
    return v, t


def caps(rng: np.random.Generator, v: np.ndarray, t: np.ndarray) -> Mesh:
    """Put vertices into triangles, close to an edge."""
    for _ in range(rng.integers(1, 6)):
        which = int(rng.integers(len(t)))
        a, b, c = np.roll(t[which], int(rng.integers(3)))
        share, height = rng.uniform(0.2, 0.8), 10.0 ** rng.uniform(-9.0, -3.0)
        new = (1.0 - height) * ((1.0 - share) * v[a] + share * v[b]) + height * v[c]
        n = len(v)
        v = np.vstack([v, new])
        t = np.vstack([np.delete(t, which, axis=0), [[a, b, n], [b, c, n], [c, a, n]]])
    return v, t


def t_junctions(rng: np.random.Generator, v: np.ndarray, t: np.ndarray) -> Mesh:
    """Split edges in one of their triangles only."""
    for _ in range(rng.integers(1, 4)):
        v, t = _split_edge(rng, v, t, rng.uniform(0.2, 0.8), both=False)
    return v, t


def _split_edge(
    rng: np.random.Generator, v: np.ndarray, t: np.ndarray, share: float, both: bool
) -> Mesh:
    which = int(rng.integers(len(t)))
    a, b, _ = np.roll(t[which], int(rng.integers(3)))
    over = (
        np.flatnonzero((t == a).any(axis=1) & (t == b).any(axis=1)) if both else np.array([which])
    )
    n = len(v)
    v = np.vstack([v, v[a] + share * (v[b] - v[a])])
    one, two = t[over].copy(), t[over].copy()
    one[one == a], two[two == b] = n, n
    return v, np.vstack([np.delete(t, over, axis=0), one, two])


def not_a_number(rng: np.random.Generator, v: np.ndarray, t: np.ndarray) -> Mesh:
    v = v.copy()
    v[rng.choice(t.ravel(), rng.integers(1, 4)), rng.integers(3)] = rng.choice(
        [np.nan, np.inf, -np.inf]
    )
    return v, t


def idle_vertices(rng: np.random.Generator, v: np.ndarray, t: np.ndarray) -> Mesh:
    extra = rng.normal(size=(rng.integers(1, 20), 3))
    extra[rng.random(len(extra)) < 0.5] = np.nan
    return np.vstack([extra, v]), t + len(extra)


def doubled_triangles(rng: np.random.Generator, v: np.ndarray, t: np.ndarray) -> Mesh:
    some = t[rng.permutation(len(t))[: rng.integers(1, len(t))]]
    turned = np.where(rng.random((len(some), 1)) < 0.5, some[:, ::-1], np.roll(some, 1, axis=1))
    return v, np.vstack([t, turned])


def doubled_part(rng: np.random.Generator, v: np.ndarray, t: np.ndarray) -> Mesh:
    return np.vstack([v, v]), np.vstack([t, t + len(v)])


def doubled_vertices(rng: np.random.Generator, v: np.ndarray, t: np.ndarray) -> Mesh:
    """Give some corners vertices of their own, at the same place or a fraction of a micrometre off."""
    own = np.flatnonzero(rng.random(t.size) < 0.3)
    off = rng.choice([0.0, 1e-7]) * np.ptp(v, axis=0).max()
    flat = t.ravel().copy()
    copies = v[flat[own]] + off * rng.uniform(-1.0, 1.0, (len(own), 3))
    flat[own] = len(v) + np.arange(len(own))
    return np.vstack([v, copies]), flat.reshape(-1, 3)


def soup(rng: np.random.Generator, v: np.ndarray, t: np.ndarray) -> Mesh:
    return v[t].reshape(-1, 3), np.arange(t.size).reshape(-1, 3)


def seam(rng: np.random.Generator, v: np.ndarray, t: np.ndarray) -> Mesh:
    """Tear a region off by a hair."""
    some = _grown(rng, t, int(rng.integers(1, 1 + min(30, len(t) // 2))))
    moved = np.unique(t[some])
    new = np.zeros(len(v), dtype=np.int64)
    new[moved] = len(v) + np.arange(len(moved))
    t = t.copy()
    t[some] = new[t[some]]
    return np.vstack([v, v[moved] + 10.0 ** rng.uniform(-8.0, -4.0) * rng.normal(size=3)]), t


def moved_copy(rng: np.random.Generator, v: np.ndarray, t: np.ndarray) -> Mesh:
    """Add the same body, shifted by less than it is thick."""
    a, b, c = v[t[:, 0]], v[t[:, 1]], v[t[:, 2]]
    across = np.cross(b - a, c - a)
    thickness = (
        2.0
        * abs(np.einsum("ti,ti->", a - v.mean(axis=0), across) / 6.0)
        / np.linalg.norm(across, axis=1).sum()
    )
    shift = rng.normal(size=3)
    return np.vstack(
        [v, v + rng.uniform(0.05, 0.8) * thickness * shift / np.linalg.norm(shift)]
    ), np.vstack([t, t + len(v)])


def inner_copy(rng: np.random.Generator, v: np.ndarray, t: np.ndarray) -> Mesh:
    """Put a small body at a point under the surface."""
    which = int(rng.integers(len(t)))
    a, b, c = v[t[which]]
    inward = -np.cross(b - a, c - a)
    inward /= np.linalg.norm(inward)
    reach = 0.05e-3
    small = trimesh.creation.icosphere(subdivisions=1, radius=reach)
    centre = (a + b + c) / 3.0 + 3.0 * reach * inward
    return np.vstack([v, np.asarray(small.vertices) + centre]), np.vstack(
        [t, np.asarray(small.faces) + len(v)]
    )


def spiked(rng: np.random.Generator, v: np.ndarray, t: np.ndarray) -> Mesh:
    """Push one vertex through another triangle, in a direction steep to it."""
    which = rng.choice(t.ravel())
    others = t[(t != which).all(axis=1)]
    a, b, c = np.moveaxis(v[others], 1, 0)
    middle, across = (a + b + c) / 3.0, np.cross(b - a, c - a)
    way = middle - v[which]
    steep = np.abs(np.einsum("ti,ti->t", way, across)) > 0.3 * np.linalg.norm(
        way, axis=1
    ) * np.linalg.norm(across, axis=1)
    if not steep.any():
        return v, np.vstack([t, t[:, ::-1]])
    v = v.copy()
    v[which] += 1.3 * way[rng.choice(np.flatnonzero(steep))]
    return v, t


def wrong_index(rng: np.random.Generator, v: np.ndarray, t: np.ndarray) -> Mesh:
    t = t.copy()
    t[rng.integers(len(t)), rng.integers(3)] = rng.choice([-1, len(v), len(v) + 1000])
    return v, t


def swapped_index(rng: np.random.Generator, v: np.ndarray, t: np.ndarray) -> Mesh:
    t = t.copy()
    t[rng.integers(len(t)), rng.integers(3)] = rng.integers(len(v))
    return v, t


def vertex_removed(rng: np.random.Generator, v: np.ndarray, t: np.ndarray) -> Mesh:
    """Remove a vertex with its triangles."""
    gone = rng.choice(t.ravel())
    return v, t[(t != gone).all(axis=1)]


def row_removed(rng: np.random.Generator, v: np.ndarray, t: np.ndarray) -> Mesh:
    """Remove a vertex and leave the triangles' numbers as they are."""
    return np.delete(v, rng.integers(len(v)), axis=0), t


def fin(rng: np.random.Generator, v: np.ndarray, t: np.ndarray) -> Mesh:
    a, b, _ = t[rng.integers(len(t))]
    out = v[a] - v.mean(axis=0)
    return np.vstack([v, v[a] + 0.1 * out]), np.vstack([t, [a, b, len(v)]])


def loose_triangle(rng: np.random.Generator, v: np.ndarray, t: np.ndarray) -> Mesh:
    corners = v.max(axis=0) + 1e-3 * rng.random((3, 3))
    return np.vstack([v, corners]), np.vstack([t, len(v) + np.arange(3)])


def hung_on_a_vertex(rng: np.random.Generator, v: np.ndarray, t: np.ndarray) -> Mesh:
    """Hang the mirrored body on its outermost vertex, at the same place or by the same number."""
    which = int(t.ravel()[(v[t.ravel()] @ rng.normal(size=3)).argmax()])
    return np.vstack([v, 2.0 * v[which] - v]), np.vstack([t, t[:, ::-1] + len(v)])


DAMAGES: dict[str, Callable[[np.random.Generator, np.ndarray, np.ndarray], Mesh]] = {
    function.__name__.replace("_", " "): function
    for function in (
        moved_copy, inner_copy, spiked, fin, loose_triangle, hung_on_a_vertex, holes, tattered, vertex_removed,
        flipped_triangles, flipped_patch, inside_out, needles, caps, t_junctions, seam, idle_vertices,
        doubled_triangles, doubled_part, doubled_vertices, soup, not_a_number, swapped_index, wrong_index, row_removed,
    )
}  # fmt: skip
"""By name. Those that need a sound body to know its inside come first, those that leave nothing to work on last."""

COMMON = [
    *DAMAGES,
    *(["holes"] * 4),
    *(["tattered"] * 2),
    "needles",
    "caps",
    "flipped patch",
    "moved copy",
]
"""What is drawn from: the commonest damages several times."""


def damaged(rng: np.random.Generator) -> tuple[str, Mesh, Mesh]:
    """Damage a body once, or twice in every fourth case.

    Returns
    -------
    What was done to what, for the name of a test; vertices [m] and triangles of the body; those of the damaged one.
    """
    name, whole = body(rng)
    kinds = [str(kind) for kind in rng.choice(COMMON, 2 if rng.random() < 0.25 else 1)]
    v, t = whole
    kinds.sort(key=list(DAMAGES).index)
    for kind in kinds:
        if (
            len(t) and t.min() >= 0 and t.max() < len(v)
        ):  # else the first damage left nothing that a second could need
            with np.errstate(invalid="ignore"):
                v, t = DAMAGES[kind](rng, v, t)
    return f"{name}: {', '.join(kinds)}", whole, (v, t)
