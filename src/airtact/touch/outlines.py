"""Curves on the skin where it meets the surface of a virtual object."""

import numpy as np
from jaxtyping import Float64, Int64

from airtact.geometry.mesh.triangles import edge_ends
from airtact.touch.objects import VirtualObject
from airtact.touch.skin import Skin

Curve = Float64[np.ndarray, "_ 3"]


def outline_of(
    skin: Skin, thing: VirtualObject, members: Int64[np.ndarray, "members"]
) -> tuple[Curve, ...]:
    """Return the curves that separate the skin points inside an object from those outside.

    Parameters
    ----------
    skin : points of the skin and their triangles.
    thing : the virtual object.
    members : indices of the skin points inside the object.

    Returns
    -------
    Curves (P, 3) [m] through the points on the triangle edges where the linearly interpolated depth
    is 0. The points are projected onto the exact surface of the skin. The last point of a closed
    curve equals its first.
    """
    depths = thing.depth(skin.points)
    inner = np.zeros(len(skin.points), dtype=bool)
    inner[members] = depths[members] > 0.0
    # The curve crosses edges from inner to outer points, two in each triangle that it passes.
    ends = edge_ends(skin.triangles)
    crossed = (inner[ends].sum(axis=2) == 1) & ((depths[ends] > 0.0).sum(axis=2) == 1)
    crossed[crossed.sum(axis=1) != 2] = False
    piece = ends[crossed].reshape(-1, 2, 2)
    if not len(piece):
        return ()
    edges, number = np.unique(np.sort(piece.reshape(-1, 2), axis=1), axis=0, return_inverse=True)
    first, second = depths[edges].T
    share = (first / (first - second))[:, None]
    points = (1.0 - share) * skin.points[edges[:, 0]] + share * skin.points[edges[:, 1]]
    if skin.bodies is not None:
        points = skin.bodies[skin.place[members[0]]].shape.project(points)
    return tuple(points[chain] for chain in _chains(number.reshape(-1, 2)))


def _chains(pieces: Int64[np.ndarray, "pieces 2"]) -> list[list[int]]:
    """Join pairs of points into open and closed chains."""
    beside: dict[int, list[int]] = {}
    for start, end in pieces.tolist():
        beside.setdefault(start, []).append(end)
        beside.setdefault(end, []).append(start)
    chains = []
    # Open chains must start at one of their ends, so process points with one neighbour first.
    for start in sorted(beside, key=lambda point: len(beside[point])):
        if not beside[start]:
            continue
        chain = [start]
        while beside[chain[-1]]:
            following = beside[chain[-1]].pop()
            beside[following].remove(chain[-1])
            chain.append(following)
        chains.append(chain)
    return chains


def spaced_along(curve: Curve, spacing: float) -> Curve:
    """Return evenly spaced points (P, 3) [m] on a curve, at most ``spacing`` [m] apart.

    The last point of a closed curve is omitted, because it equals the first point.
    """
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
    closed = bool(np.all(curve[0] == curve[-1]))
    count = max(3, int(np.ceil(lengths[-1] / spacing)))
    stations = np.linspace(0.0, lengths[-1], count + 1)[: count if closed else count + 1]
    return np.stack([np.interp(stations, lengths, axis) for axis in curve.T], axis=1)
