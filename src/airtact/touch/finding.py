"""Find the skin points inside virtual objects, in a millisecond for a whole hand."""

from collections.abc import Sequence
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
    """Connected parts of the skin inside objects, one for each finger or other part.

    Attributes
    ----------
    points : (C, 3) deepest point of each contact, on the skin [m].
    normals : (C, 3) outward unit normals there.
    depths : (C,) depths of these points in the object [m].
    areas : (C,) area of the skin inside the object [m²].
    objects : (C,) index of the object.
    places : (C,) index of the part of the skin.
    patches : (C,) index of the connected piece of skin, which may span several parts.
    deepest : (C,) index of the skin point nearest to the deepest one.
    members : (C,) indices of the skin points of each contact.
    member_depths : (C,) their depths [m].
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
    """Find the contacts of a skin with objects.

    Parameters
    ----------
    skin : points, normals, areas and neighbours.
    objects : the objects, checked.
    gap : distance outside an object up to which skin counts as a contact [m].
    """
    along = np.ascontiguousarray(skin.points.T)  # NumPy reduces short rows slowly
    low = along.min(axis=1)
    high = along.max(axis=1)
    near = []
    for index, thing in enumerate(objects):
        # Depths are skipped for objects whose ball does not reach the box around the skin.
        centre, radius = thing.ball
        if np.linalg.norm(np.clip(centre, low, high) - centre) <= radius + gap:
            near.append(index)
    # One row of depths for each object, then one node for each point inside an object.
    depths = np.array([objects[index].depth(skin.points) for index in near])
    depths = depths.reshape(len(near), len(skin.points))
    row, point = np.nonzero(depths > -gap)
    labels = _connected(skin, row, point, len(near))
    # A patch that spans several fingers is one contact for each.
    place = skin.place[point]
    keys, contact = np.unique(labels * len(skin.places) + place, return_inverse=True)
    depth = depths[row, point]
    # Nodes contact by contact, in each the deepest first.
    order = np.lexsort((-depth, contact))
    starts = np.searchsorted(contact[order], np.arange(len(keys)))
    first = order[starts]
    deepest = point[first]
    # The deepest point lies between skin points; without this step a focus would jump between them.
    ring = skin.neighbours[deepest]
    points, normals, peak = peaks(
        skin.points[deepest],
        skin.normals[deepest],
        depth[first],
        skin.points[ring],
        depths[row[first][:, None], ring],
    )
    of_object = np.array(near, dtype=np.int64)[row[first]]
    if skin.look is not None and len(keys):
        points, normals, peak = _on_surface(skin.look, objects, of_object, points)
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
        members=tuple(np.split(point[order], starts[1:])) if len(keys) else (),
        member_depths=tuple(np.split(depth[order], starts[1:])) if len(keys) else (),
    )


def _on_surface(
    look: Look, objects: Sequence[VirtualObject], of_object: Indices, points: Points
) -> tuple[Points, Points, PointLengths]:
    """Move points of contacts to the deepest points of the true surface near them.

    Returns
    -------
    The points, and the normals and depths there.
    """
    turns = 2.0 * np.pi * np.arange(8) / 8.0
    circle = 1e-3 * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    # The fit of ``peaks`` in a circle of points on the surface, smaller than the triangles.
    distances, normals = look(points)
    points = points - distances[:, None] * normals
    axis = np.eye(3)[np.abs(normals).argmin(axis=1)]
    first = np.cross(normals, axis)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    ring = points[:, None] + circle @ np.stack([first, np.cross(normals, first)], axis=1)
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
    """Return the index of the connected piece of skin that each node belongs to."""
    nodes = np.arange(len(point))
    # The node of each point in each object, or -1; then each node's neighbours, itself if none.
    slot = np.full(rows * len(skin.points), -1)
    slot[row * len(skin.points) + point] = nodes
    beside = slot[(row * len(skin.points))[:, None] + skin.neighbours[point]]
    beside = np.where(beside < 0, nodes[:, None], beside)
    ends = beside.shape[1] * np.arange(len(nodes) + 1)
    graph = csr_array((np.ones(beside.size), beside.ravel(), ends), shape=(len(nodes),) * 2)
    # Every edge has a reverse, so strong components equal connected ones and are found faster.
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

    Quadratics of the tangent coordinates are fitted to the depth and to the height of the skin in
    a ring around each point. If the depth has no maximum within the ring, the point stays in place.
    """
    axis = np.eye(3)[np.abs(normals).argmin(axis=1)]
    first = np.cross(normals, axis)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    frames = np.stack([first, np.cross(normals, first), normals], axis=1)
    local = np.einsum("cij,ckj->cki", frames, ring - points[:, None])
    # Coordinates in units of the ring's radius keep the fit well conditioned.
    reach = np.sqrt((local**2).sum(axis=2).max(axis=1, initial=1e-12))
    u, v, height = np.moveaxis(local / reach[:, None, None], 2, 0)
    terms = np.stack([u, v, 0.5 * u * u, u * v, 0.5 * v * v], axis=2)
    values = np.stack([(ring_depths - depths[:, None]) / reach[:, None], height], axis=2)
    # Normal equations; the small diagonal keeps them solvable for rings of fewer than five points.
    square = np.einsum("cki,ckj->cij", terms, terms) + 1e-9 * np.eye(5)
    fit = np.linalg.solve(square, np.einsum("cki,ckj->cij", terms, values))
    slope = fit[:, :2, 0]
    bend = fit[:, [[2, 3], [3, 4]], 0]
    determinant = bend[:, 0, 0] * bend[:, 1, 1] - bend[:, 0, 1] ** 2
    # A maximum has a negative definite second derivative.
    is_peak = (bend[:, 0, 0] < 0.0) & (determinant > 1e-9)
    bend[~is_peak] = -np.eye(2)
    step = np.linalg.solve(bend, -slope[:, :, None])[:, :, 0]
    length = np.linalg.norm(step, axis=1)
    step[~is_peak | (length > 1.0)] = 0.0
    u, v = step.T
    terms = np.stack([u, v, 0.5 * u * u, u * v, 0.5 * v * v], axis=1)
    rise = np.einsum("ci,cij->cj", terms, fit)
    moved = reach[:, None] * np.column_stack([step, rise[:, 1]])
    # The normal of the fitted skin z(u, v) is (-dz/du, -dz/dv, 1).
    tilt = fit[:, :2, 1] + np.einsum("cij,cj->ci", fit[:, [[2, 3], [3, 4]], 1], step)
    turned = np.column_stack([-tilt, np.ones(len(tilt))])
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    return (
        points + np.einsum("cji,cj->ci", frames, moved),
        np.einsum("cji,cj->ci", frames, turned),
        depths + reach * rise[:, 0],
    )
