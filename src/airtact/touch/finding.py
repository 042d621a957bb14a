"""Find the points of the skin inside virtual objects, within a millisecond for a whole hand."""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from airtact.errors import of_kind
from airtact.geometry.mesh.triangles import PointLengths
from airtact.touch.objects import VirtualObject
from airtact.touch.skin import Points, Skin

Indices = Int64[np.ndarray, "contacts"]


class ContactArrays(NamedTuple):
    """Properties of C contacts, one array per property, in ``Contacts`` and ``TouchState``.

    A contact is a connected piece of skin that is inside one object and belongs to one part of the
    skin, such as a finger. A piece that spans several parts is divided into one contact per part.
    In ``TouchState.found``, pieces include skin up to the distance ``release`` outside an object,
    where depths are negative. Positions are in the frame of the skin.

    Attributes
    ----------
    points : (C, 3) point of the skin that is deepest in the object, which may lie between the
        points of ``Skin`` [m].
    normals : (C, 3) unit normals of the skin at ``points``, pointing out of the hand.
    depths : (C,) depths of ``points`` in the object [m].
    areas : (C,) area of skin inside the object [m²].
    objects : (C,) index of the touched object in ``Contacts.virtual_objects`` or
        ``TouchState.objects``.
    places : (C,) index in ``Skin.places`` of the part, such as a finger.
    patches : (C,) index of the connected piece of skin; equal for contacts that are parts of one
        piece. The numbers are not consecutive.
    deepest : (C,) index in ``Skin.points`` of the deepest of the contact's skin points.
    members : for each contact, the indices in ``Skin.points`` of its skin points, deepest first.
    member_depths : for each contact, the depths of its skin points in the order of ``members`` [m].
    """

    points: Float64[np.ndarray, "contacts 3"]
    normals: Float64[np.ndarray, "contacts 3"]
    depths: Float64[np.ndarray, "contacts"]
    areas: Float64[np.ndarray, "contacts"]
    objects: Indices
    places: Indices
    patches: Indices
    deepest: Indices
    members: tuple[Int64[np.ndarray, "_"], ...]
    member_depths: tuple[Float64[np.ndarray, "_"], ...]

    def chosen(self, indices: Int64[np.ndarray, "_"]) -> "ContactArrays":
        """Return only the contacts with the given indices."""
        arrays = {name: getattr(self, name)[indices] for name in self._fields[:-2]}
        return self._replace(
            **arrays,
            members=tuple(self.members[index] for index in indices),
            member_depths=tuple(self.member_depths[index] for index in indices),
        )


NO_CONTACTS = ContactArrays(
    points=np.zeros((0, 3)),
    normals=np.zeros((0, 3)),
    depths=np.zeros(0),
    areas=np.zeros(0),
    objects=np.zeros(0, dtype=np.int64),
    places=np.zeros(0, dtype=np.int64),
    patches=np.zeros(0, dtype=np.int64),
    deepest=np.zeros(0, dtype=np.int64),
    members=(),
    member_depths=(),
)


def find(skin: Skin, objects: Sequence[VirtualObject], gap: float = 0.0) -> ContactArrays:
    """Find the contacts of a hand's skin with objects.

    ``contact`` and ``TouchState.update`` call this function.

    Parameters
    ----------
    skin : points of the skin, with their normals, areas and neighbours, as returned by ``skin_of``.
    objects : virtual objects in the frame of the skin, as checked by ``objects_of``.
    gap : distance from an object [m] below which skin outside it is also treated as a contact.

    Returns
    -------
    ``ContactArrays`` with one row per contact, empty if there is none. Outside an object, the depth
    is negative and the area 0.
    """
    of_kind(skin, Skin, "the skin", "skin_of(surfaces)")
    near = _within_reach(skin, objects, gap)
    # One row of depths per object, then one node for each point inside an object.
    depths = np.array([objects[index].depth(skin.points) for index in near])
    depths = depths.reshape(len(near), len(skin.points))
    row, point = np.nonzero(depths > -gap)
    if not len(point):
        return NO_CONTACTS
    patch = _connected(skin, row, point, len(near))
    # Divide a patch that spans several fingers into one contact per finger.
    key = patch * len(skin.places) + skin.place[point]
    depth = depths[row, point]
    # Order the nodes by contact, and within each contact from deepest to shallowest. Depths are
    # far below 10 m, so one key holds both.
    order = np.argsort(key - 0.1 * depth)
    row = row[order]
    point = point[order]
    depth = depth[order]
    key = key[order]
    first = np.flatnonzero(np.append(True, key[1:] != key[:-1]))
    deepest = point[first]
    of_object = near[row[first]]
    # Find the deepest point between skin points; otherwise a focus would jump between them.
    ring = skin.neighbours[deepest]
    if skin.look is None:
        ring_depths = depths[row[first][:, None], ring]
        points, normals, peak = peaks(
            skin.points[deepest],
            skin.normals[deepest],
            depth[first],
            skin.points[ring],
            ring_depths,
        )
    else:
        points, normals, peak = _on_surface(skin, objects, of_object, deepest, ring)
    slices = [slice(*ends) for ends in pairwise([*first.tolist(), len(point)])]
    return ContactArrays(
        points=points,
        normals=normals,
        depths=peak,
        areas=np.add.reduceat(skin.areas[point] * (depth > 0.0), first),
        objects=of_object,
        places=skin.place[deepest],
        patches=key[first] // len(skin.places),
        deepest=deepest,
        members=tuple(point[part] for part in slices),
        member_depths=tuple(depth[part] for part in slices),
    )


def approaching(skin: Skin, objects: Sequence[VirtualObject], gap: float) -> Indices:
    """Return the skin points nearest to objects, one for each part and object within ``gap`` [m].

    The indices are sorted by the distances of the points from the objects.
    """
    points = []
    depths = []
    for index in _within_reach(skin, objects, gap):
        depth = objects[index].depth(skin.points)
        near = np.flatnonzero(depth > -gap)
        near = near[np.argsort(-depth[near])]
        # The first point of each part is its deepest.
        points.append(near[np.unique(skin.place[near], return_index=True)[1]])
        depths.append(depth[points[-1]])
    if not points:
        return np.zeros(0, dtype=np.int64)
    return np.concatenate(points)[np.argsort(-np.concatenate(depths))]


def _within_reach(
    skin: Skin, objects: Sequence[VirtualObject], gap: float
) -> Int64[np.ndarray, "near"]:
    """Return the indices of objects whose bounding ball reaches the box around the skin."""
    if not objects:
        return np.zeros(0, dtype=np.int64)
    along = np.ascontiguousarray(skin.points.T)  # NumPy is slow at reducing short rows
    centres = np.array([thing.ball[0] for thing in objects])
    radii = np.array([thing.ball[1] for thing in objects])
    nearest = np.minimum(np.maximum(centres, along.min(axis=1)), along.max(axis=1))
    return np.flatnonzero(np.sum((nearest - centres) ** 2, axis=1) <= (radii + gap) ** 2)


def _on_surface(
    skin: Skin,
    objects: Sequence[VirtualObject],
    of_object: Indices,
    deepest: Indices,
    ring: Int64[np.ndarray, "contacts most"],
) -> tuple[Points, Points, PointLengths]:
    """Return the deepest points near skin points on the exact surface, with normals and depths.

    Parameters
    ----------
    skin : skin whose points lie on an exact surface.
    objects, of_object : virtual objects, and the index of each contact's object.
    deepest, ring : indices of the deepest skin point of each contact and of its neighbours.
    """
    assert skin.look is not None
    points = skin.points[deepest]
    normals = skin.normals[deepest]
    edges = skin.points[ring] - points[:, None]
    # With circles of half an edge, fingertips at a ball get points 0.1 mm from the deepest.
    reach = 0.5 * np.sqrt(np.einsum("cki,cki->ck", edges, edges).max(axis=1))
    frames = _frames(normals)
    # Fit as in ``peaks``, to eight points of the surface. Moved along the normal of its centre, the
    # circle keeps its tangent coordinates.
    circle = points[:, None] + (reach[:, None, None] * _CIRCLE) @ frames[:, :2]
    distances, slopes = skin.look(circle.reshape(-1, 3))
    upright = np.maximum((slopes.reshape(circle.shape) @ normals[:, :, None])[..., 0], 0.5)
    heights = -distances.reshape(upright.shape) / upright
    around = np.empty((len(points), 9, 3))
    around[:, 0] = points
    around[:, 1:] = circle + heights[..., None] * normals[:, None]
    depths = np.empty(around.shape[:2])
    for index in set(of_object.tolist()):
        own = of_object == index
        depths[own] = objects[index].depth(around[own].reshape(-1, 3)).reshape(-1, 9)
    values = np.empty((len(points), 8, 2))
    values[..., 0] = depths[:, 1:] - depths[:, :1]
    values[..., 1] = heights
    values /= reach[:, None, None]
    return _summits(points, frames, depths[:, 0], reach, _CIRCLE_FIT @ values)


def _connected(
    skin: Skin, row: Int64[np.ndarray, "nodes"], point: Int64[np.ndarray, "nodes"], rows: int
) -> Int64[np.ndarray, "nodes"]:
    """Return for each node the smallest number of a node in the same connected piece of skin."""
    nodes = np.arange(len(point))
    # Node of each point in each object, or -1. Then the neighbours of each node; itself if none.
    slot = np.full(rows * len(skin.points), -1)
    begun = row * len(skin.points)
    slot[begun + point] = nodes
    beside = slot.take(skin.neighbours.take(point, axis=0).T + begun)
    beside = np.where(beside < 0, nodes, beside)
    # Each node takes the lowest label around it, then the label of the node with that number.
    labels = nodes
    while True:
        lowest = np.minimum(labels, labels.take(beside).min(axis=0))  # take is faster than []
        lowest = lowest[lowest]
        if (lowest == labels).all():
            return labels
        labels = lowest


def peaks(
    points: Float64[np.ndarray, "contacts 3"],
    normals: Float64[np.ndarray, "contacts 3"],
    depths: Float64[np.ndarray, "contacts"],
    ring: Float64[np.ndarray, "contacts most 3"],
    ring_depths: Float64[np.ndarray, "contacts most"],
) -> tuple[
    Float64[np.ndarray, "contacts 3"],
    Float64[np.ndarray, "contacts 3"],
    Float64[np.ndarray, "contacts"],
]:
    """Return the deepest points near the given skin points, with the normals and depths there.

    Quadratic functions of the tangent coordinates are fitted to the depth and to the height of the
    skin in a ring around each point. A point is returned unchanged if the fitted depth has no
    maximum near it.
    """
    frames = _frames(normals)
    local = (ring - points[:, None]) @ frames.transpose(0, 2, 1)
    # Coordinates in units of the ring's radius keep the fit well conditioned.
    reach = np.sqrt(np.einsum("cki,cki->ck", local, local).max(axis=1, initial=1e-12))
    local /= reach[:, None, None]
    terms = _terms(local[..., 0], local[..., 1])
    values = np.empty((*local.shape[:2], 2))
    values[..., 0] = (ring_depths - depths[:, None]) / reach[:, None]
    values[..., 1] = local[..., 2]
    # Normal equations. The small diagonal keeps them solvable for rings of fewer than 5 points.
    transposed = terms.transpose(0, 2, 1)
    fit = np.linalg.solve(transposed @ terms + 1e-9 * np.eye(5), transposed @ values)
    return _summits(points, frames, depths, reach, fit)


def _summits(
    points: Points,
    frames: Float64[np.ndarray, "contacts 3 3"],
    depths: PointLengths,
    reach: PointLengths,
    fit: Float64[np.ndarray, "contacts 5 2"],
) -> tuple[Points, Points, PointLengths]:
    """Return the points where fitted depths are largest, with the normals and depths there.

    Parameters
    ----------
    points : centres of the fits [m].
    frames : tangents and normal of the skin at each point.
    depths : depth of the skin at each point [m].
    reach : unit of the coordinates of each fit [m]; no point moves by more than 1.4 units.
    fit : coefficients of ``_terms`` for the depth and for the height of the skin.
    """
    slope_u, slope_v, bend_uu, bend_uv, bend_vv = fit[:, :, 0].T
    determinant = bend_uu * bend_vv - bend_uv * bend_uv
    # At a maximum, the second derivative is negative definite. Reach it with a Newton step.
    is_peak = (bend_uu < 0.0) & (determinant > 1e-9)
    step = np.empty((len(points), 2))
    safe = np.where(is_peak, determinant, 1.0)
    step[:, 0] = (bend_uv * slope_v - bend_vv * slope_u) / safe
    step[:, 1] = (bend_uv * slope_u - bend_uu * slope_v) / safe
    step[~is_peak | (np.einsum("ci,ci->c", step, step) > 2.0)] = 0.0
    u, v = step.T
    rise = (_terms(u, v)[:, None] @ fit)[:, 0]
    moved = np.empty_like(points)
    moved[:, :2] = step
    moved[:, 2] = rise[:, 1]
    moved *= reach[:, None]
    # The normal of the fitted skin z(u, v) is (-dz/du, -dz/dv, 1).
    slope_u, slope_v, bend_uu, bend_uv, bend_vv = fit[:, :, 1].T
    turned = np.ones_like(points)
    turned[:, 0] = -(slope_u + bend_uu * u + bend_uv * v)
    turned[:, 1] = -(slope_v + bend_uv * u + bend_vv * v)
    turned /= np.sqrt(np.einsum("ci,ci->c", turned, turned))[:, None]
    return (
        points + (moved[:, None] @ frames)[:, 0],
        (turned[:, None] @ frames)[:, 0],
        depths + reach * rise[:, 0],
    )


def _frames(normals: Points) -> Float64[np.ndarray, "points 3 3"]:
    """Return an orthonormal frame for each unit normal: two tangents, then the normal, as rows.

    T. Duff et al., Journal of Computer Graphics Techniques 6, 1 (2017). For a few vectors,
    ``np.cross`` takes ten times as long.
    """
    x, y, z = normals.T
    sign = np.where(z < 0.0, -1.0, 1.0)
    a = -1.0 / (sign + z)
    b = x * y * a
    frames = np.empty((len(normals), 3, 3))
    frames[:, 0, 0] = 1.0 + sign * x * x * a
    frames[:, 0, 1] = sign * b
    frames[:, 0, 2] = -sign * x
    frames[:, 1, 0] = b
    frames[:, 1, 1] = sign + y * y * a
    frames[:, 1, 2] = -y
    frames[:, 2] = normals
    return frames


def _terms(
    u: Float64[np.ndarray, "*points"], v: Float64[np.ndarray, "*points"]
) -> Float64[np.ndarray, "*points 5"]:
    """Return the terms of a quadratic function without constant at coordinates u and v."""
    terms = np.empty((*u.shape, 5))
    terms[..., 0] = u
    terms[..., 1] = v
    terms[..., 2] = 0.5 * u * u
    terms[..., 3] = u * v
    terms[..., 4] = 0.5 * v * v
    return terms


# Eight points of a circle of radius 1 in tangent coordinates, and the matrix that fits the terms to
# values there by least squares.
_CIRCLE = np.stack([np.cos(np.pi * np.arange(8) / 4.0), np.sin(np.pi * np.arange(8) / 4.0)], axis=1)
_CIRCLE_FIT = np.linalg.pinv(_terms(*_CIRCLE.T))
