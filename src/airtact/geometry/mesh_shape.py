"""The shape of a closed mesh at a pose, and its covering by panels of a given size."""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float64

from airtact.errors import InvalidInput, in_short
from airtact.geometry.mesh.arrays import (
    EdgeVectors,
    IndexPairs,
    Pieces,
    PointLengths,
    Points,
    PointVectors,
    QuadraticTriangles,
    Vector3,
)
from airtact.geometry.mesh.edge_limits import (
    MAX_EDGE_TO_WALL,
    bend_sizes,
    is_smooth,
    round_size,
    strip_sizes,
    tip_sizes,
    wall_sizes,
)
from airtact.geometry.mesh.quadratic_triangles import (
    NODE_REFERENCES,
    cut,
    enclosed_volume,
    longest_edges,
    normals_at,
    unit,
)
from airtact.geometry.mesh.remeshing import MIN_EDGE, RidgedMesh, coarsened, remeshed
from airtact.geometry.mesh.topology import are_among, edge_ends
from airtact.geometry.pose import Pose
from airtact.geometry.quadratic_mesh import QuadraticMesh
from airtact.geometry.shape import BEND, Shape


@dataclass(frozen=True, eq=False)
class MeshShape(Shape):
    """A mesh of quadratic triangles at a pose.

    ``cached`` maps settings to the panels that were made with them for the mesh before its motion.
    """

    mesh: QuadraticMesh
    pose: Pose
    cached: dict[tuple[float, float, float], QuadraticTriangles] = field(
        default_factory=dict, compare=False
    )

    __repr__ = in_short

    @property
    def extent(self) -> float:
        return float(np.ptp(self.mesh.vertices[self.mesh.triangles].reshape(-1, 3), axis=0).max())

    @property
    def area(self) -> float:
        return self.mesh.area

    @property
    def volume(self) -> float:
        return self.mesh.volume

    @property
    def crossings(self) -> IndexPairs:
        return self.mesh.crossings

    def nested_piece(self) -> tuple[int, int, float, Vector3] | None:
        points = np.array([piece.vertices[piece.triangles[0, 0]] for piece in self.mesh.pieces])
        if len(points) == 1:
            return None
        for outer, piece in enumerate(self.mesh.pieces):
            depth = piece.depth(points)
            depth[outer] = -np.inf
            inner = int(depth.argmax())
            if depth[inner] > 0.0:
                return inner, outer, float(depth[inner]), self.pose.apply(points[inner])
        return None

    @property
    def quadratic_triangles(self) -> QuadraticTriangles:
        """The triangles of the mesh as panels (T, 6, 3) [m]."""
        return self.pose.apply(self.mesh.quadratic_triangles)

    def edge_middles(self, corners: EdgeVectors) -> EdgeVectors:
        return self.quadratic_triangles[:, 3:]

    def depth(self, points: Points) -> PointLengths:
        return self.mesh.depth(self.pose.inverse().apply(points))

    def project(self, points: Points) -> PointVectors:
        return self.pose.apply(self.mesh.project(self.pose.inverse().apply(points)))

    def project_on_sharp_edges(self, points: Points) -> PointVectors:
        return self.pose.apply(self.mesh.project_on_sharp_edges(self.pose.inverse().apply(points)))

    def fitted(self, panels: QuadraticTriangles) -> QuadraticTriangles:
        return self.pose.apply(self.mesh.fitted(self.pose.inverse().apply(panels)))

    def off_triangles(self, points: Points) -> PointLengths:
        return self.mesh.flat_tree.closest(self.pose.inverse().apply(points))[2]

    def panels(self, edge: float, bend: float = BEND, away: float = math.inf) -> QuadraticTriangles:
        """Cover the mesh with curved panels the size of equilateral triangles of edge ``edge``.

        Where the mesh is smooth, the rms deviation of the panels is at most about ``away`` [m].
        """
        settings = (edge, bend, away)
        if settings not in self.cached:
            self.cached[settings] = np.concatenate(
                [covered(piece, edge, bend, away) for piece in self.mesh.pieces]
            )
        return self.pose.apply(self.cached[settings])

    def extreme_points(self) -> PointVectors:
        return self.quadratic_triangles.reshape(-1, 3)

    def coarse_meshes(self, edge: float) -> list[RidgedMesh]:
        meshes = []
        for piece in self.mesh.pieces:
            split = piece.with_short_edges(edge)
            placed = RidgedMesh(self.pose.apply(split.vertices), split.triangles, split.ridges)
            meshes.append(coarsened(placed, edge / 1.5))
        return meshes

    def moved(self, pose: Pose) -> "MeshShape":
        return replace(self, pose=pose @ self.pose)


# --- new panels -------------------------------------------------------------------------------


def covered(
    mesh: QuadraticMesh, edge: float, bend: float = BEND, away: float = np.inf
) -> QuadraticTriangles:
    """Cover a closed piece with curved panels the size of equilateral triangles of edge ``edge``.

    MMG generates the triangles. Their corners and midpoints are projected onto the surface or its
    sharp edges. Panels that deviate by more than 0.4 % of the edge, or by more than ``away`` [m]
    where the surface is smooth, are divided into four.
    """
    extent = float(np.ptp(mesh.vertices, axis=0).max())
    ridges = edge_ends(mesh.triangles)[mesh.sharp]
    # Longer edges than the body's roundness allows would only make the tolerances coarser.
    limit = round_size(mesh.vertices, mesh.triangles, ridges, bend)
    shorter = min(edge, 0.49 * extent, limit)
    fault = None
    # A part smaller than the edge may vanish. If the volume is wrong, a shorter edge is tried. The
    # first steps are small, so that a coarse accuracy does not need more panels than a fine one.
    for shrink in (0.8, 0.8, 0.5, 0.5, 0.5):
        try:
            panels = _new_panels(mesh, shorter, bend, away)
        except InvalidInput as error:
            fault = error
        else:
            if abs(enclosed_volume(panels) / mesh.volume - 1) < 0.03:
                return panels
        shorter *= shrink
    raise fault or InvalidInput(
        f"panels with edges of {1e3 * edge:.3g} to {2e3 * shorter:.3g} mm do not enclose the "
        f"volume of {1e6 * mesh.volume:.4g} cm³ to within 3 %, because the surface is too rough or "
        "too thin. Simplify it, or make it thicker.",
        code="mesh_faulty",
    )


def _new_panels(mesh: QuadraticMesh, edge: float, bend: float, away: float) -> QuadraticTriangles:
    largest = 1.5 * edge
    fine = mesh.with_short_edges(1.5 * edge)
    # The thickness is zero where two faces meet, so the thinnest 1 % of the vertices are ignored.
    walls = wall_sizes(fine.vertices, fine.triangles, largest)
    thickness = float(np.quantile(walls, 0.01)) / MAX_EDGE_TO_WALL
    wall = max(thickness, MIN_EDGE * edge / MAX_EDGE_TO_WALL)
    wall = wall if MAX_EDGE_TO_WALL * wall < largest else np.inf
    # A smooth mesh needs no coarsening, which would distort its small details.
    fraction = 0.15 if is_smooth(fine.vertices, fine.triangles, fine.ridges) else 0.25
    base = coarsened(fine, edge, wall, fraction)
    # Panels that turn by a radian deviate by 0.00125 of the edge. The deviation is proportional to
    # the third power of the edge.
    bend_share = min(1.0, away / (0.00125 * edge)) ** (1 / 3)
    limits = (
        strip_sizes(base.vertices, base.ridges, largest),
        bend_sizes(base.vertices, base.triangles, base.ridges, largest, bend_share),
        wall_sizes(base.vertices, base.triangles, largest),
        tip_sizes(base.vertices, base.triangles, base.ridges, largest, bend),
    )
    expected = mesh.area / (np.sqrt(3) / 4 * edge**2)
    new = remeshed(base, np.min(limits, axis=0), edge, expected, wall)
    corners, middles = placed_on(mesh, new, edge)
    on_surface = np.concatenate([corners[new.triangles], middles], axis=1)
    return _cut_where_it_helps(mesh, on_surface, edge, away)


def placed_on(
    surface: QuadraticMesh | Shape, new: RidgedMesh, edge: float
) -> tuple[PointVectors, EdgeVectors]:
    """Project the vertices of a mesh onto a nearby surface, and find surface points between them.

    Return the vertices (V, 3) [m] and the points at the middles of edges 01, 12, 20 (T, 3, 3) [m].
    Both ends and the middle of a sharp edge lie on a sharp edge of the surface.
    """
    corners = surface.project(new.vertices)
    on_ridge = np.unique(new.ridges)
    if len(on_ridge):
        corners[on_ridge] = surface.project_on_sharp_edges(new.vertices[on_ridge])
    # A distant projection belongs to another part of the surface and is ignored.
    outlying = np.linalg.norm(corners - new.vertices, axis=1) > 0.3 * edge
    corners[outlying] = new.vertices[outlying]
    edges, inverse = np.unique(
        np.sort(edge_ends(new.triangles).reshape(-1, 2), axis=1), axis=0, return_inverse=True
    )
    straight = corners[edges].mean(axis=1)
    middles = surface.project(straight)
    if len(on_ridge):
        along = are_among(edges, new.ridges)
        middles[along] = surface.project_on_sharp_edges(straight[along])
    return corners, middles[inverse.ravel()].reshape(-1, 3, 3)


def _cut_where_it_helps(
    mesh: QuadraticMesh, on_surface: QuadraticTriangles, edge: float, away: float
) -> Pieces:
    """Divide panels that turn or deviate too much into four, if the pieces deviate less."""
    too_far = 0.004 * edge
    finished = []
    # Neighbours share the nodes of ``on_surface``, so that cut panels leave no holes between them.
    panels, deviation = mesh.levelled(on_surface)
    # Measuring takes as long as the fit, so panels that clearly deviate less are left out.
    doubtful = deviation > 0.5 * min(too_far, away)
    deviation[doubtful] = mesh.deviation(panels[doubtful])
    for _ in range(4):
        steep = (_bending(panels) > 1.4) & (longest_edges(panels) > 0.4 * edge)
        rough = steep | (deviation > min(too_far, away))
        if not rough.any():
            break
        pieces, _ = cut(on_surface[rough], np.full(int(rough.sum()), 2))
        pieces = mesh.project(pieces.reshape(-1, 3)).reshape(-1, 6, 3)
        levelled, _ = mesh.levelled(pieces)
        # Dividing reduces the deviation from a smooth surface to 1/8 or less, but has less effect
        # on a rough one. Divisions are kept if they reduce the deviation to a half for panels that
        # are too far off, and to a fifth for panels that only exceed ``away``.
        enough = np.where(deviation[rough] > too_far, 0.5, 0.2) * deviation[rough]
        of_pieces = mesh.deviation(levelled).reshape(-1, 4)
        better = (np.sqrt(np.mean(of_pieces**2, axis=1)) < enough) | steep[rough]
        finished += [panels[~rough], panels[rough][~better]]
        on_surface = pieces.reshape(-1, 4, 6, 3)[better].reshape(-1, 6, 3)
        panels = levelled.reshape(-1, 4, 6, 3)[better].reshape(-1, 6, 3)
        deviation = of_pieces[better].ravel()
    return np.concatenate([*finished, panels])


def _bending(panels: QuadraticTriangles) -> Float64[np.ndarray, "panels"]:
    normals = [unit(normals_at(panels, corner)) for corner in NODE_REFERENCES[:3]]
    cosine = np.min([np.einsum("td,td->t", normals[i], normals[i - 1]) for i in range(3)], axis=0)
    return np.arccos(np.clip(cosine, -1.0, 1.0))
