"""How far points of a cloud are from the skin of a hand, and how that changes as joints and radii do.

The distance of a point x to a hull of balls is the least of |x - c(w)| - r(w) over the weights w of its balls; w being
where it is least, the derivatives by the centres are -w n and those by the radii -w, n the direction from c(w) to x
(A. Tkach, M. Pauly, A. Tagliasacchi, ACM Trans. Graph. 35, 222 (2016)). A point that a camera has seen belongs to skin
that faces it: where the nearest skin of a hull faces away, the point is held against the front or the rim, section 4.2
there.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64

from airtact.scene.hand_hulls import Hulls

NEAREST = 3
"""Hulls that are looked at for each point."""

FACING = -0.05
"""Cosine to the line of sight below which skin faces away from the camera."""

TINY = 1e-12
"""Lengths below this have no direction [m]."""


class Feet(NamedTuple):
    """Where points (N,) touch a hull.

    Attributes
    ----------
    distance : (N,) to its skin, negative inside [m].
    normal : (N, 3) out of it.
    weights : (N, 3) of its balls, whose mean ball is touched.
    """

    distance: Float64[np.ndarray, "points"]
    normal: Float64[np.ndarray, "points 3"]
    weights: Float64[np.ndarray, "points 3"]


class Gaps(NamedTuple):
    """Signed distances of points (N,) to the skin that they belong to, and their derivatives.

    Attributes
    ----------
    distance : (N,) [m].
    slopes : (N, 4 B) derivatives by centre and radius of each ball.
    hull : (N,) the hull that each belongs to.
    """

    distance: Float64[np.ndarray, "points"]
    slopes: Float64[np.ndarray, "points unknowns"]
    hull: Int64[np.ndarray, "points"]


def feet_on(
    points: Float64[np.ndarray, "points 3"], balls: Float64[np.ndarray, "balls 4"], parts: Int64[np.ndarray, "points 3"]
) -> Feet:
    """Find where points touch one hull each.

    Parameters
    ----------
    points : (N, 3) [m].
    balls : (B, 4) centres and radii [m].
    parts : (N, 3) the balls of each point's hull; the third is -1 where there are two.
    """
    one, two = balls[parts[:, 0]], balls[parts[:, 1]]
    distance, normal, share = _rod(points, one, two)
    weights = np.column_stack([1.0 - share, share, np.zeros(len(share))])
    wide = np.flatnonzero(parts[:, 2] >= 0)
    if len(wide):
        three = balls[parts[wide, 2]]
        corners = np.stack([one[wide], two[wide], three], axis=1)
        found = _wide(points[wide], corners, Feet(distance[wide], normal[wide], weights[wide]))
        distance[wide], normal[wide], weights[wide] = found
    return Feet(distance, normal, weights)


def gaps_to(
    points: Float64[np.ndarray, "points 3"], hulls: Hulls, camera: Float64[np.ndarray, "3"] | None = None
) -> Gaps:
    """Find the distances of points to the skin of a body, creases filled, and how they change with its balls.

    Parameters
    ----------
    points : (N, 3) [m].
    hulls : the body.
    camera : (3,) that saw the points [m]: they are held against skin that faces it. None for any skin.
    """
    each = hulls.each(points)
    near = np.argpartition(each, NEAREST, axis=1)[:, :NEAREST]
    near = np.take_along_axis(near, np.argsort(np.take_along_axis(each, near, axis=1), axis=1), axis=1)
    many = np.repeat(points, NEAREST, axis=0)
    parts = hulls.parts[near.ravel()]
    feet = feet_on(many, hulls.balls, parts)
    rows = NEAREST * np.arange(len(points))
    chosen = rows
    if camera is not None:
        seen = _facing(many, hulls.balls, parts, feet, camera)
        best = np.abs(seen.distance.reshape(-1, NEAREST)).argmin(axis=1)
        turned = np.einsum("pi,pi->p", feet.normal[rows], _towards(points, camera)) < FACING
        chosen = rows + np.where(turned, best, 0)
        feet = seen
    share, other, distance = _filled(hulls, near, feet, chosen, rows)
    slopes = np.zeros((len(points), len(hulls.balls), 4))
    for row, weight in ((chosen, 1.0 - share), (other, share)):
        slope = -np.column_stack([feet.normal[row], np.ones(len(row))])
        for corner in range(3):
            part = weight * feet.weights[row, corner]
            slopes[np.arange(len(points)), parts[row, corner]] += part[:, None] * slope
    return Gaps(distance, slopes.reshape(len(points), -1), near.ravel()[chosen])


def _filled(
    hulls: Hulls,
    near: Int64[np.ndarray, "points nearest"],
    feet: Feet,
    chosen: Int64[np.ndarray, "points"],
    rows: Int64[np.ndarray, "points"],
) -> tuple[Float64[np.ndarray, "points"], Int64[np.ndarray, "points"], Float64[np.ndarray, "points"]]:
    """Distances where creases are filled, as ``Hulls`` says: the other hull's share, its row, and the distance."""
    flat = near.ravel()
    share, other, distance = np.zeros(len(rows)), chosen.copy(), feet.distance[chosen].copy()
    for beside in range(NEAREST):
        row = rows + beside
        full = np.where(row == chosen, 0.0, hulls.blend[flat[chosen], flat[row]])
        width = full * 0.5 * (1.0 - np.einsum("pi,pi->p", feet.normal[chosen], feet.normal[row]))
        step = feet.distance[row] - feet.distance[chosen]
        over = width - np.abs(step)
        safe = np.where(width > TINY, width, 1.0)
        joined = np.minimum(feet.distance[row], feet.distance[chosen]) - over**2 / (4.0 * safe)
        better = (over > 0.0) & (width > TINY) & (joined < distance)
        part = np.where(step >= 0.0, 0.5 * over / safe, 1.0 - 0.5 * over / safe)
        share, other = np.where(better, part, share), np.where(better, row, other)
        distance = np.where(better, joined, distance)
    return share, other, distance


def _towards(
    points: Float64[np.ndarray, "points 3"], camera: Float64[np.ndarray, "3"]
) -> Float64[np.ndarray, "points 3"]:
    away = camera - points
    return away / np.linalg.norm(away, axis=1, keepdims=True)


def _facing(
    points: Float64[np.ndarray, "points 3"],
    balls: Float64[np.ndarray, "balls 4"],
    parts: Int64[np.ndarray, "points 3"],
    feet: Feet,
    camera: Float64[np.ndarray, "3"],
) -> Feet:
    """Hold points that touch skin which faces away against the front of the same ball, or its rim beside it."""
    sight = _towards(points, camera)
    away = np.flatnonzero(np.einsum("pi,pi->p", feet.normal, sight) < FACING)
    ball = np.einsum("pc,pci->pi", feet.weights[away], balls[parts[away]])
    out, sight = points[away] - ball[:, :3], sight[away]
    along = np.einsum("pi,pi->p", out, sight)
    across = out - along[:, None] * sight
    wide = np.linalg.norm(across, axis=1)
    radius = ball[:, 3]
    rise = np.sqrt(np.maximum(radius**2 - wide**2, 0.0))
    front = (across + rise[:, None] * sight) / np.maximum(radius, TINY)[:, None]
    rim = across / np.maximum(wide, TINY)[:, None]
    before = wide < radius
    normal, distance = feet.normal.copy(), feet.distance.copy()
    normal[away] = np.where(before[:, None], front, rim)
    distance[away] = np.where(before, np.einsum("pi,pi->p", normal[away], out) - radius, wide - radius)
    return Feet(distance, normal, feet.weights)


def _rod(
    points: Float64[np.ndarray, "points 3"], one: Float64[np.ndarray, "points 4"], two: Float64[np.ndarray, "points 4"]
) -> tuple[Float64[np.ndarray, "points"], Float64[np.ndarray, "points 3"], Float64[np.ndarray, "points"]]:
    """Distance, normal and share of the second ball on hulls of two."""
    axis = two[:, :3] - one[:, :3]
    length = np.maximum(np.linalg.norm(axis, axis=1), TINY)
    axis = axis / length[:, None]
    out = points - one[:, :3]
    along = np.einsum("pi,pi->p", out, axis)
    away = np.sqrt(np.maximum(np.einsum("pi,pi->p", out, out) - along**2, 0.0))
    slope = (one[:, 3] - two[:, 3]) / length
    within = np.abs(slope) < 1.0
    tangent = slope / np.sqrt(np.where(within, 1.0 - slope**2, 1.0))
    place = np.where(within, along - away * tangent, np.where(slope > 0.0, 0.0, length))
    place = np.clip(place, 0.0, length)
    spoke = out - place[:, None] * axis
    far = np.linalg.norm(spoke, axis=1)
    return far - (one[:, 3] - slope * place), spoke / np.maximum(far, TINY)[:, None], place / length


def _wide(points: Float64[np.ndarray, "points 3"], corners: Float64[np.ndarray, "points 3 4"], first: Feet) -> Feet:
    """Feet on hulls of three balls, whose first rod is known: on a flat face, or on one of the other rods."""
    distance, normal, weights = first
    for one, two in ((1, 2), (2, 0)):
        other, way, share = _rod(points, corners[:, one], corners[:, two])
        better = other < distance
        own = np.zeros((len(points), 3))
        own[:, one], own[:, two] = 1.0 - share, share
        distance = np.where(better, other, distance)
        normal, weights = np.where(better[:, None], way, normal), np.where(better[:, None], own, weights)
    on, flat = _flat_face(points, corners)
    return Feet(
        np.where(on, flat.distance, distance),
        np.where(on[:, None], flat.normal, normal),
        np.where(on[:, None], flat.weights, weights),
    )


def _flat_face(
    points: Float64[np.ndarray, "points 3"], corners: Float64[np.ndarray, "points 3 4"]
) -> tuple[Bool[np.ndarray, "points"], Feet]:
    """Feet on the plane that touches all three balls, and whether they lie between these."""
    u, v = corners[:, 1, :3] - corners[:, 0, :3], corners[:, 2, :3] - corners[:, 0, :3]
    p, q = corners[:, 0, 3] - corners[:, 1, 3], corners[:, 0, 3] - corners[:, 2, 3]
    uu, uv, vv = (np.einsum("pi,pi->p", a, b) for a, b in ((u, u), (u, v), (v, v)))
    determinant = uu * vv - uv * uv
    some = determinant > 1e-9 * uu * vv
    determinant = np.where(some, determinant, 1.0)
    lean = ((p * vv - q * uv) / determinant)[:, None] * u + ((q * uu - p * uv) / determinant)[:, None] * v
    square = np.einsum("pi,pi->p", lean, lean)
    some &= square < 1.0
    rise = np.sqrt(np.where(some, 1.0 - square, 1.0))
    up = np.cross(u, v)
    up = up / np.maximum(np.linalg.norm(up, axis=1, keepdims=True), TINY**2)
    out = points - corners[:, 0, :3]
    height = np.einsum("pi,pi->p", out, up)
    normal = lean + np.where(height < 0.0, -rise, rise)[:, None] * up
    far = np.abs(height) / rise
    centre = out - far[:, None] * normal
    a, b = np.einsum("pi,pi->p", centre, u), np.einsum("pi,pi->p", centre, v)
    s, t = (a * vv - b * uv) / determinant, (b * uu - a * uv) / determinant
    weights = np.column_stack([1.0 - s - t, s, t])
    radius = np.einsum("pc,pc->p", weights, corners[:, :, 3])
    return some & (weights >= 0.0).all(axis=1), Feet(far - radius, normal, weights)
