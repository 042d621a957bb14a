"""Where a closed mesh is thinner than a length: where a ball of that diameter, laid against it inside, comes through.

The thickness at a point of the surface is the diameter of the largest ball inside that touches the
surface there, as far as surface bounds it that looks the other way: the sides of a wedge may meet.
A triangle moved inwards by half a length holds the centres of the balls of that diameter that touch
it; where another triangle is nearer to it than half the length, the body is thinner.
"""

from collections.abc import Callable
from itertools import product

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.spatial import KDTree

from airtact.geometry.mesh.intersections import Group, pairs_of_groups, same_corners
from airtact.geometry.mesh.mesh_distance import closest_on_triangles, triangle_to_triangle
from airtact.geometry.mesh.quadratic_triangles import Corners, Nearby, area_vectors, longest_edges
from airtact.geometry.mesh.topology import Triangles

Vectors = Float64[np.ndarray, "triangles 3"]
Sizes = Float64[np.ndarray, "triangles"]
Levels = Int64[np.ndarray, "triangles"]

Depth = Callable[[Float64[np.ndarray, "points 3"]], Float64[np.ndarray, "points"]]
"""How deep points (P, 3) [m] lie in a body (P,) [m], negative outside."""

WEDGE_DEGREES = 20.0
"""Surfaces bound a thickness where they are nearer to parallel than this."""

_SMALL = 0.5  # share of the length: smaller triangles are touched in their centres only
_CELL = 0.3  # edge, over the length, of cells in which one of the small triangles that look the same way will do
_CENTRE = 1e-3  # what is left there of their size
_SIDE = np.array(
    [0.48, 0.6, 0.64]
)  # balls are laid against that of two surfaces which looks this way
_LEANING = np.sin(np.radians(WEDGE_DEGREES))
_DIRECTIONS = np.array([way for way in product((-1.0, 0.0, 1.0), repeat=3) if any(way)])
_DIRECTIONS /= np.linalg.norm(_DIRECTIONS, axis=1, keepdims=True)
_PASS = 4096  # pairs of triangles that are measured at a time
_SHARES = (
    0.0,
    0.02,
    0.1,
    0.3,
    0.6,
    1.0,
)  # of the way from the nearest points of two triangles to their centres
_TRIED = 64  # balls that are looked at at a time
_INSIDE = 0.9  # share of its radius that a ball must be in: balls that touch beside an edge may leave the body there


def thin_position(
    corners: Corners, triangles: Triangles, depth: Depth, thinnest: float, short: float
) -> tuple[float, Float64[np.ndarray, "3"]] | None:
    """Find about where a closed mesh is thinnest below a length: how thick it is [m] and the middle (3,) of it [m].

    Thin parts narrower than a third of ``thinnest`` [m] may be missed. They count where the body is
    not thick enough anywhere within the distance ``short`` [m]: 0 for all, more to let bumps and
    ribs pass that are no higher than it.
    """
    area = area_vectors(corners)
    twice = np.linalg.norm(area, axis=1)
    normals = area / twice[:, None]
    out = corners - corners.mean(axis=1, keepdims=True)
    reach = np.linalg.norm(out, axis=2).max(axis=1)
    level = np.floor(np.log2(np.maximum(reach / (_SMALL * thinnest), 0.5))).astype(np.int64)
    touched = np.where((level < 0)[:, None, None], corners - (1.0 - _CENTRE) * out, corners)
    inner = touched - 0.5 * thinnest * normals[:, None]
    pairs = _opposite(corners.mean(axis=1), normals, reach, level, thinnest)
    heights = np.einsum(
        "nki,ni->nk", corners[pairs[:, 1]] - inner[pairs[:, 0], :1], normals[pairs[:, 0]]
    )
    near = (heights.min(axis=1) < 0.5 * thinnest) & (heights.max(axis=1) > -0.5 * thinnest)
    pairs = pairs[near][np.argsort(-heights[near].max(axis=1))]
    slim = twice < thinnest * longest_edges(corners)
    pairs = pairs[~(same_corners(triangles, pairs).any(axis=(1, 2)) & slim[pairs].any(axis=1))]
    for start in range(0, len(pairs), _PASS):
        one, two = pairs[start : start + _PASS].T
        thin = triangle_to_triangle(inner[one], corners[two])[0] < 0.5 * thinnest * (1.0 - 1e-9)
        if thin.any():
            one, two = one[thin], two[thin]
            found = _thinnest_ball(touched[one], corners[two], normals[one], depth, thinnest, short)
            if found is not None:
                return found
    return None


def _thinnest_ball(
    touched: Nearby,
    bounding: Nearby,
    outward: Float64[np.ndarray, "n 3"],
    depth: Depth,
    thinnest: float,
    short: float,
) -> tuple[float, Float64[np.ndarray, "3"]] | None:
    """Find the smallest ball below a length that lies inside between two triangles of a pair: diameter and centre."""
    _, here, there = triangle_to_triangle(touched, bounding)
    ways = [(here, touched.mean(axis=1)), (there, bounding.mean(axis=1))]
    points = np.concatenate(
        [start + share * (end - start) for start, end in ways for share in _SHARES]
    )
    which = np.tile(np.arange(len(touched)), len(ways) * len(_SHARES))
    touched, bounding, outward = touched[which], bounding[which], outward[which]
    touch = closest_on_triangles(points, touched)
    way = touch - closest_on_triangles(touch - 0.5 * thinnest * outward, bounding)
    square, height = (way**2).sum(axis=1), np.einsum("ni,ni->n", way, outward)
    diameter = np.divide(
        square, height, out=np.where(square > 0.0, np.inf, 0.0), where=height > 0.0
    )
    found = np.argsort(diameter)[: np.count_nonzero(diameter < thinnest * (1.0 - 1e-9))]
    centres = touch[found] - 0.5 * diameter[found, None] * outward[found]
    firsts = _first_in_cells(centres, _CELL * thinnest)
    found, centres = found[firsts], centres[firsts]
    for start in range(0, len(found), _TRIED):
        some = slice(start, start + _TRIED)
        inside = np.flatnonzero(depth(centres[some]) >= 0.5 * _INSIDE * diameter[found[some]])
        alone = inside[_stands_alone(centres[some][inside], depth, thinnest, short)]
        if len(alone) > 0:
            first = start + int(alone[0])
            return float(diameter[found[first]]), centres[first]
    return None


def _stands_alone(
    centres: Float64[np.ndarray, "n 3"], depth: Depth, thinnest: float, short: float
) -> Bool[np.ndarray, "n"]:
    """Whether no ball as thick as wanted has its centre within some distance of others' centres."""
    if short == 0.0:
        return np.ones(len(centres), dtype=bool)
    around = np.concatenate([share * short * _DIRECTIONS for share in (0.4, 0.7, 1.0)])
    deepest = depth((centres[:, None] + around).reshape(-1, 3)).reshape(-1, len(around)).max(axis=1)
    return deepest < 0.5 * thinnest


def _opposite(
    centres: Vectors, normals: Vectors, reach: Sizes, level: Levels, thinnest: float
) -> Int64[np.ndarray, "pairs 2"]:
    """Pairs of triangles that look opposite ways, the second within reach of balls that touch the first inside."""
    upper = normals @ _SIDE > -_LEANING
    small = np.flatnonzero(upper & (level < 0))
    octant = (normals[small] > 0.0) @ np.array([1, 2, 4])
    upper[small] = False
    upper[small[_first_in_cells(centres[small], _CELL * thinnest, octant)]] = True
    inner = np.hstack([centres - 0.5 * thinnest * normals, -0.5 * thinnest * normals])
    outer = np.hstack([centres, 0.5 * thinnest * normals])
    turned = thinnest * np.sin(
        np.radians(WEDGE_DEGREES / 2.0)
    )  # how far normals part in these coordinates
    first = _groups(inner, upper, level, np.where(level < 0, 0.0, reach))
    second = _groups(outer, normals @ _SIDE < _LEANING, level, reach)
    found = [np.zeros((0, 2), dtype=np.int64)]
    for one, two in product(first, second):
        pairs = pairs_of_groups(
            one, two, float(np.hypot(0.5 * thinnest + one.reach + two.reach, turned))
        )
        cosine = np.einsum("ni,ni->n", normals[pairs[:, 0]], normals[pairs[:, 1]])
        found.append(pairs[cosine < -np.cos(np.radians(WEDGE_DEGREES))])
    return np.concatenate(found)


def _groups(
    points: Float64[np.ndarray, "triangles 6"],
    chosen: Bool[np.ndarray, "triangles"],
    level: Levels,
    reach: Sizes,
) -> list[Group]:
    parts = [np.flatnonzero(chosen & (level == one)) for one in np.unique(level[chosen])]
    return [
        Group(part, KDTree(points[part], balanced_tree=False), float(reach[part].max()))
        for part in parts
    ]


def _first_in_cells(
    points: Float64[np.ndarray, "n 3"], cell: float, kind: Int64[np.ndarray, "n"] | None = None
) -> Int64[np.ndarray, "chosen"]:
    """Choose the first of the points of a kind in each cell of a grid."""
    boxes = np.floor((points - points.min(axis=0, initial=np.inf)) / cell).astype(np.int64)
    size = boxes.max(axis=0, initial=0) + 1
    key = boxes @ np.array([1, size[0], size[0] * size[1]])
    if kind is not None:
        key = key * 8 + kind
    return np.sort(np.unique(key, return_index=True)[1])
