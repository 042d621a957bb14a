"""Covers the curved surface of a mesh with new panels of a wanted size."""

import numpy as np
from jaxtyping import Float64

from airtact.errors import InvalidInput
from airtact.geometry.mesh.quadratic_triangles import (
    NODE_PLACES,
    QuadraticTriangles,
    cut,
    enclosed_volume,
    longest_edges,
    normals_at,
    unit,
)
from airtact.geometry.mesh.remeshing import SMALLEST, RidgedMesh, coarsened, remeshed
from airtact.geometry.mesh.sizing import WALL, bend_sizes, strip_sizes, wall_sizes
from airtact.geometry.mesh.topology import are_among, edge_ends
from airtact.geometry.quadratic_mesh import QuadraticMesh

TOO_FAR = 0.004
"""Root mean square distance of a panel from the surface, over the edge wanted, above which it is cut in four ..."""

HELPS, SMOOTH = 0.5, 0.2
"""... if its pieces lie at most at this share of it; one that is nearer, but not as near as asked, at the second one.

Cutting brings quadratic panels of a smooth surface nearer by a factor of 8 and more, those of a
rough one by less."""

STEEP = 1.4
"""Angle between the normals at its corners above which a panel is cut in four [rad] ..."""

SMALL = 0.4
"""... if it is longer than this share of the edge wanted."""

CUTS = 4
"""How often it may be cut."""

SPLIT = 1.5
"""Longest edge of the triangles that MMG is given, over the edge wanted."""

LARGEST = 1.5
"""Longest edge over the edge wanted."""

LARGEST_SHARE = 0.5
"""Largest edge over the extent of the body."""

ATTEMPTS = 4
"""How many edges are tried, each half as long as the one before."""

VOLUME_OFF = 0.03
"""Share of the volume that the panels may enclose too much or too little."""

KNIFE = 0.01
"""Share of the vertices whose wall may be thinner than what is resolved: where two faces meet, walls end in nothing."""

OUTLYING = 0.3
"""A corner that would move by more than this share of the edge stays where MMG put it."""


PLAIN = 0.00125
"""Distance from the surface, over the edge, that is asked for at an accuracy of 1 %: bends are coarse enough for it."""


def covered(mesh: QuadraticMesh, edge: float, away: float = np.inf) -> QuadraticTriangles:
    """Cover one closed piece with curved panels about as large as equilateral triangles of a given edge [m].

    MMG makes the triangles; their corners and middles are brought onto the surface, those of sharp
    edges onto these; panels that still leave the surface by more than ``TOO_FAR`` of the edge are
    cut in four, and those that leave it by more than ``away`` [m] where it is smooth. Where that
    does not enclose the body's volume, a part of it being smaller than the edge, shorter ones are
    tried.
    """
    extent = float(np.ptp(mesh.vertices, axis=0).max())
    shorter, fault = min(edge, LARGEST_SHARE * extent), None
    for _ in range(ATTEMPTS):
        try:
            panels = _meshed_anew(mesh, shorter, away)
        except InvalidInput as found:
            fault = found
        else:
            if abs(enclosed_volume(panels) / mesh.volume - 1) < VOLUME_OFF:
                return panels
        shorter /= 2
    raise fault or InvalidInput(
        f"panels with an edge of {1e3 * edge:.3g} mm, and of {2e3 * shorter:.3g} mm, do not enclose the "
        f"{1e6 * mesh.volume:.4g} cm³ of the surface to {100 * VOLUME_OFF:g} %; it is too rough or thin somewhere.",
        code="mesh_faulty",
    )


def _meshed_anew(mesh: QuadraticMesh, edge: float, away: float) -> QuadraticTriangles:
    largest = LARGEST * edge
    fine = mesh.with_short_edges(SPLIT * edge)
    thickness = float(np.quantile(wall_sizes(fine.vertices, fine.triangles, largest), KNIFE)) / WALL
    wall = max(thickness, SMALLEST * edge / WALL)
    wall = wall if WALL * wall < largest else np.inf
    given = coarsened(fine, edge, wall)
    bounds = (
        strip_sizes(given.vertices, given.ridges, largest),
        bend_sizes(
            given.vertices,
            given.triangles,
            given.ridges,
            largest,
            min(1.0, away / (PLAIN * edge)) ** (1 / 3),
        ),
        wall_sizes(given.vertices, given.triangles, largest),
    )
    sizes = np.min(bounds, axis=0)
    wanted = mesh.area / (np.sqrt(3) / 4 * edge**2)
    panels = _on_the_surface(mesh, remeshed(given, sizes, edge, wanted, wall), edge)
    return _cut_where_it_helps(mesh, panels, edge, away)


def _on_the_surface(mesh: QuadraticMesh, anew: RidgedMesh, edge: float) -> QuadraticTriangles:
    """Bring new triangles onto the surface."""
    vertices, triangles, ridges = anew.vertices, anew.triangles, anew.ridges
    corners = mesh.project(vertices)
    on_ridge = np.unique(ridges)
    if len(on_ridge):
        corners[on_ridge] = mesh.project_on_sharp_edges(vertices[on_ridge])
    outlying = np.linalg.norm(corners - vertices, axis=1) > OUTLYING * edge
    corners[outlying] = vertices[outlying]
    unique, inverse = np.unique(
        np.sort(edge_ends(triangles).reshape(-1, 2), axis=1), axis=0, return_inverse=True
    )
    straight = corners[unique].mean(axis=1)
    middles = mesh.project(straight)
    if len(on_ridge):
        along = are_among(unique, ridges)
        middles[along] = mesh.project_on_sharp_edges(straight[along])
    panels = np.concatenate(
        [corners[triangles], middles[inverse.ravel()].reshape(-1, 3, 3)], axis=1
    )
    return mesh.levelled(panels)


def _cut_where_it_helps(
    mesh: QuadraticMesh, panels: QuadraticTriangles, edge: float, away: float
) -> Float64[np.ndarray, "pieces 6 3"]:
    """Cut panels in four that bend too far, or leave the surface by too much, unless their pieces leave it as much.

    The latter is so where the surface is rough. ``away`` [m] is asked for where it is smooth.
    """
    done = []
    for _ in range(CUTS):
        leaving = mesh.leaving(panels)
        steep = (_bending(panels) > STEEP) & (longest_edges(panels) > SMALL * edge)
        far = steep | (leaving > min(TOO_FAR * edge, away))
        if not far.any():
            break
        pieces, _ = cut(panels[far], np.full(int(far.sum()), 2))
        pieces = mesh.fitted(pieces)
        enough = np.where(leaving[far] > TOO_FAR * edge, HELPS, SMOOTH) * leaving[far]
        better = np.sqrt(np.mean(mesh.leaving(pieces).reshape(-1, 4) ** 2, axis=1)) < enough
        better |= steep[far]
        done += [panels[~far], panels[far][~better]]
        panels = pieces.reshape(-1, 4, 6, 3)[better].reshape(-1, 6, 3)
    return np.concatenate([*done, panels])


def _bending(panels: QuadraticTriangles) -> Float64[np.ndarray, "panels"]:
    """Largest angle between the normals at the corners of each panel [rad]."""
    normals = [unit(normals_at(panels, corner)) for corner in NODE_PLACES[:3]]
    cosine = np.min([np.einsum("td,td->t", normals[i], normals[i - 1]) for i in range(3)], axis=0)
    return np.arccos(np.clip(cosine, -1.0, 1.0))
