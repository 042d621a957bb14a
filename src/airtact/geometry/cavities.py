"""Smaller panels where flat faces hold the sound: in corners, and between faces that look at each other.

Sound that goes to and fro meets the same error at each reflection, and most of that in the corners:
there a face is next to the panels that it hears, so their errors do not cancel out as they do
farther away.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from airtact.geometry.mesh.quadratic_triangles import (
    QuadraticTriangles,
    cut,
    longest_edges,
    middles_of,
    unit,
)

SomePanels = Float64[np.ndarray, "_ 6 3"]
"""Panels of which one body or covering has more than another."""

FLAT = 0.002
"""Distance of the middles of a panel's edges from the plane of its corners, over its longest edge, if it is flat."""

FACED = 0.4 ** (1 / 3)
"""Edge of the panels of faces that look at each other, over that of others: for 0.4 of the error."""

MET = 1e-9
"""Distance of the middles of two edges below which they are the same edge [m]."""

IN_PLANE, ALIKE = 1e-6, 1e-4
"""Distance of panels from a plane below which they lie in it [m], if their normals differ by less than the second."""

RISING = 0.5
"""Sine of the angle by which a face rises over the one beside it, above which both make a corner that holds sound."""

FACING = -0.5
"""Cosine between the normals of two faces below which they look at each other."""


def are_flat(panels: QuadraticTriangles) -> Bool[np.ndarray, "panels"]:
    """Whether the middles of the edges of panels lie in the plane of their corners."""
    normals = unit(np.cross(panels[:, 1] - panels[:, 0], panels[:, 2] - panels[:, 0]))
    off = np.einsum("pmd,pd->pm", panels[:, 3:] - panels[:, :1], normals)
    return np.abs(off).max(axis=1) < FLAT * longest_edges(panels)


def halved_in_corners(panels: QuadraticTriangles) -> Float64[np.ndarray, "pieces 6 3"]:
    """Cut flat panels of a body in four that meet another in a corner which opens towards the sound."""
    flat = np.flatnonzero(are_flat(panels))
    if not len(flat):
        return panels.copy()  # what is returned may be changed in place
    middles = panels[flat, 3:].reshape(-1, 3)
    edge = np.unique(np.round(middles / MET), axis=0, return_inverse=True)[1].ravel()
    order = np.argsort(edge, kind="stable")
    first = np.flatnonzero(edge[order][:-1] == edge[order][1:])
    one, other = order[first], order[first + 1]
    centres, normals = middles_of(panels[flat])
    rising = (
        np.einsum("ed,ed->e", unit(centres[other // 3] - middles[one]), normals[one // 3]) > RISING
    )
    parts = np.ones(len(panels), dtype=np.int64)
    parts[flat[np.concatenate([one[rising], other[rising]]) // 3]] = 2
    return cut(panels, parts)[0]


def finer_where_faced(
    bodies: Sequence[SomePanels], finer: Sequence[Callable[[], QuadraticTriangles]]
) -> list[SomePanels]:
    """Take smaller panels of some bodies for their flat faces that look at one of the others, or of their own.

    ``finer`` covers each body with them; it is called for bodies with such a face only.
    """
    faces = _faces(np.concatenate(bodies)) if len(bodies) else []
    faced = [
        one for one in faces if any(one.looks_at(other) and other.looks_at(one) for other in faces)
    ]
    chosen = []
    for coarse, cover in zip(bodies, finer, strict=True):
        replaced = _in_faces(coarse, faced)
        if replaced.any():
            fine = cover()
            coarse = np.concatenate([coarse[~replaced], fine[_in_faces(fine, faced)]])
        chosen.append(coarse)
    return chosen


@dataclass(frozen=True, eq=False)
class _Face:
    """Flat panels in one plane: its unit normal, its distance from the origin along that, and their middles [m]."""

    normal: Float64[np.ndarray, "3"]
    distance: float
    middles: Float64[np.ndarray, "panels 3"]

    def looks_at(self, other: "_Face") -> bool:
        """Whether another face is turned towards this one, and some of it lies in front of this one."""
        ahead = other.middles @ self.normal - self.distance > IN_PLANE
        return bool(self.normal @ other.normal < FACING and ahead.any())


def _faces(panels: QuadraticTriangles) -> list[_Face]:
    """Sort flat panels by the planes that they lie in."""
    middles, normals = middles_of(panels[are_flat(panels)])
    faces = []
    while len(middles):
        normal, distance = normals[0], float(middles[0] @ normals[0])
        within = _in_plane(middles, normals, normal, distance)
        faces.append(_Face(normal, distance, middles[within]))
        middles, normals = middles[~within], normals[~within]
    return faces


def _in_faces(panels: QuadraticTriangles, faces: Sequence[_Face]) -> Bool[np.ndarray, "panels"]:
    """Which panels are flat and lie in the plane of one of some faces."""
    middles, normals = middles_of(panels)
    within = [_in_plane(middles, normals, one.normal, one.distance) for one in faces]
    return are_flat(panels) & np.any(within, axis=0)


def _in_plane(
    middles: Float64[np.ndarray, "panels 3"],
    normals: Float64[np.ndarray, "panels 3"],
    normal: Float64[np.ndarray, "3"],
    distance: float,
) -> Bool[np.ndarray, "panels"]:
    alike = np.abs(normals - normal).max(axis=1) < ALIKE
    return alike & (np.abs(middles @ normal - distance) < IN_PLANE)
