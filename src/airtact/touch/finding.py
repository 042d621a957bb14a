"""Find the points of the skin inside virtual objects, within a millisecond for a whole hand."""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from airtact.geometry.mesh.arrays import PointLengths
from airtact.touch.objects import VirtualObject
from airtact.touch.skin import Look, Points, Skin

Indices = Int64[np.ndarray, "contacts"]


class ContactArrays(NamedTuple):
    """Contacts: connected pieces of skin inside an object, divided by finger or other part.

    Attributes
    ----------
    points : (C, 3) deepest point of each contact on the skin [m].
    normals : (C, 3) outward unit normals at these points.
    depths : (C,) depths of these points in the object [m].
    areas : (C,) area of skin inside the object [m²].
    objects : (C,) index of the touched object.
    places : (C,) index of the part of the skin, such as a finger.
    patches : (C,) index of the connected piece of skin, which may span several
        parts.
    deepest : (C,) index of the skin point nearest to the deepest point.
    members : for each contact, the indices of its skin points.
    member_depths : for each contact, the depths of its skin points [m].
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
        """Return the contacts with these indices."""
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

    Parameters
    ----------
    skin : points of the skin, with their normals, areas and neighbours.
    objects : virtual objects, already checked.
    gap : distance outside an object up to which skin still counts as a contact [m].
    """
    along = np.ascontiguousarray(skin.points.T)  # NumPy is slow at reducing short rows
    low = along.min(axis=1)
    high = along.max(axis=1)
    near = []
    for index, thing in enumerate(objects):
        # Skip objects whose bounding ball does not reach the box around the skin.
        centre, radius = thing.ball
        if np.linalg.norm(np.clip(centre, low, high) - centre) <= radius + gap:
            near.append(index)
    # One row of depths per object, then one node for each point inside an object.
    depths = np.array([objects[index].depth(skin.points) for index in near])
    depths = depths.reshape(len(near), len(skin.points))
    row, point = np.nonzero(depths > -gap)
    if not len(point):
        return NO_CONTACTS
    labels = _connected(skin, row, point, len(near))
    # Divide a patch that spans several fingers into one contact per finger.
    place = skin.place[point]
    keys, contact = np.unique(labels * len(skin.places) + place, return_inverse=True)
    depth = depths[row, point]
    # Order the nodes by contact, and within each contact from deepest to shallowest.
    order = np.lexsort((-depth, contact))
    starts = np.searchsorted(contact[order], np.arange(len(keys)))
    first = order[starts]
    deepest = point[first]
    # Interpolate the deepest point between skin points; otherwise a focus would jump between them.
    ring = skin.neighbours[deepest]
    points, normals, peak = peaks(
        skin.points[deepest],
        skin.normals[deepest],
        depth[first],
        skin.points[ring],
        depths[row[first][:, None], ring],
    )
    of_object = np.array(near, dtype=np.int64)[row[first]]
    if skin.look is not None:
        points, normals, peak = _on_surface(skin.look, objects, of_object, points)
    point_in_order = point[order]
    depth_in_order = depth[order]
    slices = [slice(*ends) for ends in pairwise([*starts.tolist(), len(order)])]
    areas = np.bincount(contact, skin.areas[point] * (depth > 0.0), len(keys))
    return ContactArrays(
        points=points,
        normals=normals,
        depths=peak,
        areas=areas,
        objects=of_object,
        places=place[first],
        patches=np.unique(labels[first], return_inverse=True)[1],
        deepest=deepest,
        members=tuple(point_in_order[part] for part in slices),
        member_depths=tuple(depth_in_order[part] for part in slices),
    )


def _on_surface(
    look: Look, objects: Sequence[VirtualObject], of_object: Indices, points: Points
) -> tuple[Points, Points, PointLengths]:
    """Move points of contacts to the deepest points nearby on the exact surface.

    Returns
    -------
    The new points, and the normals and depths there.
    """
    turns = 2.0 * np.pi * np.arange(8) / 8.0
    circle = 1e-3 * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    # Fit as in ``peaks``, to a circle of surface points that is smaller than the triangles.
    distances, normals = look(points)
    points = points - distances[:, None] * normals
    ring = points[:, None] + circle @ _frames(normals)[:, :2]
    distances, slopes = look(ring.reshape(-1, 3))
    ring -= (distances[:, None] * slopes).reshape(ring.shape)
    around = np.concatenate([points[:, None], ring], axis=1)
    depths = np.zeros(around.shape[:2])
    for index in set(of_object.tolist()):
        own = of_object == index
        depths[own] = objects[index].depth(around[own].reshape(-1, 3)).reshape(-1, 9)
    return peaks(points, normals, depths[:, 0], ring, depths[:, 1:])


def _connected(
    skin: Skin, row: Int64[np.ndarray, "nodes"], point: Int64[np.ndarray, "nodes"], rows: int
) -> Int64[np.ndarray, "nodes"]:
    """Return for each node the index of the connected piece of skin to which it belongs."""
    nodes = np.arange(len(point))
    # Node of each point in each object, or -1. Then the neighbours of each node; itself if none.
    slot = np.full(rows * len(skin.points), -1)
    slot[row * len(skin.points) + point] = nodes
    beside = slot[(row * len(skin.points))[:, None] + skin.neighbours[point]]
    beside = np.where(beside < 0, nodes[:, None], beside)
    ends = beside.shape[1] * np.arange(len(nodes) + 1)
    graph = csr_array((np.ones(beside.size), beside.ravel(), ends), shape=(len(nodes),) * 2)
    # Every edge has a reverse, so strong components equal connected ones, and are found faster.
    return connected_components(graph, connection="strong")[1].astype(np.int64)


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

    Quadratic functions of the tangent coordinates are fitted to the depth and to the height of
    the skin in a ring around each point. A point does not move if the depth has no maximum within
    the ring.
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
    slope_u, slope_v, bend_uu, bend_uv, bend_vv = fit[:, :, 0].T
    determinant = bend_uu * bend_vv - bend_uv * bend_uv
    # At a maximum, the second derivative is negative definite. Reach it with a Newton step.
    is_peak = (bend_uu < 0.0) & (determinant > 1e-9)
    step = np.empty((len(points), 2))
    safe = np.where(is_peak, determinant, 1.0)
    step[:, 0] = (bend_uv * slope_v - bend_vv * slope_u) / safe
    step[:, 1] = (bend_uv * slope_u - bend_uu * slope_v) / safe
    step[~is_peak | (np.einsum("ci,ci->c", step, step) > 1.0)] = 0.0
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
