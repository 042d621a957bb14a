"""A closed mesh of quadratic triangles, its shape in a given pose, and its cover of panels."""

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Float64
from scipy.spatial import KDTree

from airtact import _kernels
from airtact.errors import InvalidInput
from airtact.geometry.mesh.curving import curved
from airtact.geometry.mesh.evening import evened, turn_sizes
from airtact.geometry.mesh.intersections import self_crossings
from airtact.geometry.mesh.remeshing import (
    MAX_EDGE_TO_WALL,
    MIN_EDGE,
    RidgedMesh,
    bend_sizes,
    coarsened,
    is_smooth,
    remeshed,
    round_size,
    strip_sizes,
    tip_sizes,
    wall_sizes,
    with_short_edges,
)
from airtact.geometry.mesh.triangles import (
    NODE_REFERENCES,
    SHARP_DEGREES,
    EdgeMask,
    EdgeVectors,
    IndexPairs,
    Indices,
    PanelTree,
    Pieces,
    PointLengths,
    Points,
    PointVectors,
    QuadraticTriangles,
    Triangles,
    Twins,
    Vector3,
    Vertices,
    are_among,
    area_vectors,
    cut,
    edge_ends,
    edge_twins,
    enclosed_volume,
    gauss_square,
    longest_edges,
    normals_at,
    panel_areas,
    panel_tree,
    points_at,
    shape_functions,
    shells,
    unit,
    with_middles,
)
from airtact.geometry.pose import Pose
from airtact.geometry.shape import BEND, Shape

_RULE_POINTS, _RULE_WEIGHTS = gauss_square(4)
_RULE_SHAPE = shape_functions(_RULE_POINTS)
_WEIGHTED_SHAPE = _RULE_SHAPE.T * _RULE_WEIGHTS
# (6, 16) matrix from values at the quadrature points to the nodes of the nearest quadratic.
_RULE_FIT = np.linalg.solve(_WEIGHTED_SHAPE @ _RULE_SHAPE, _WEIGHTED_SHAPE)


@dataclass(frozen=True, eq=False)
class QuadraticMesh:
    """A closed mesh of quadratic triangles in the body's own frame.

    ``midpoints`` are points of the surface at the middles of edges 01, 12, 20 [m]. By default, they
    are computed from the normals of the mesh when they are first needed. By default ``sharp_edges``
    are the edges that bend by more than ``sharp_degrees``.
    """

    vertices: Vertices
    triangles: Triangles
    midpoints: EdgeVectors | None = None
    sharp_degrees: float = SHARP_DEGREES
    sharp_edges: EdgeMask | None = None

    @cached_property
    def _curved(self) -> tuple[EdgeVectors, EdgeMask]:
        if self.midpoints is not None and self.sharp_edges is not None:
            return self.midpoints, self.sharp_edges
        middles, sharp = curved(self.vertices, self.triangles, self.sharp_degrees)
        return middles if self.midpoints is None else self.midpoints, sharp

    @cached_property
    def quadratic_triangles(self) -> QuadraticTriangles:
        """The triangles as curved panels (T, 6, 3) [m] that share corners and midpoints."""
        return np.concatenate([self.vertices[self.triangles], self._curved[0]], axis=1)

    @property
    def sharp(self) -> EdgeMask:
        """(T, 3) whether each of the edges 01, 12, 20 is sharp."""
        return self._curved[1]

    @cached_property
    def crossings(self) -> IndexPairs:
        """(K, 2) pairs of flat triangles that cross or touch beyond their shared corners."""
        return self_crossings(self.vertices[self.triangles], self.triangles)

    @cached_property
    def tree(self) -> PanelTree:
        """A tree of boxes around the panels."""
        return panel_tree(self.quadratic_triangles)

    @cached_property
    def flat_tree(self) -> PanelTree:
        """A tree of boxes around the flat triangles between the corners of the panels."""
        return panel_tree(with_middles(self.quadratic_triangles[:, :3]))

    @cached_property
    def _twins(self) -> Twins:
        return edge_twins(self.triangles)

    @cached_property
    def ridges(self) -> Float64[np.ndarray, "ridges 3 3"]:
        """(K, 3, 3) start, middle and end [m] of each sharp edge, with each edge listed once."""
        triangle, edge = np.nonzero(self.sharp)
        once = 3 * triangle + edge < self._twins[triangle, edge]
        triangle = triangle[once]
        edge = edge[once]
        nodes = self.quadratic_triangles
        return np.stack(
            [nodes[triangle, edge], nodes[triangle, 3 + edge], nodes[triangle, (edge + 1) % 3]],
            axis=1,
        )

    @cached_property
    def _vertex_normals(self) -> Vertices:
        """Sum of the normals of the panels around each vertex, weighted by their corner angles."""
        nodes = self.quadratic_triangles
        total = np.zeros((int(self.triangles.max()) + 1, 3))
        normals = unit(normals_at(nodes, NODE_REFERENCES[:3]))
        for corner in range(3):
            # These are the tangents of the two curved edges at the corner.
            following = (corner + 1) % 3
            before = (corner + 2) % 3
            out = 4 * nodes[:, 3 + corner] - 3 * nodes[:, corner] - nodes[:, following]
            back = 4 * nodes[:, 3 + before] - 3 * nodes[:, corner] - nodes[:, before]
            cosine = np.einsum("td,td->t", unit(out), unit(back))
            angle = np.arccos(np.clip(cosine, -1.0, 1.0))
            np.add.at(total, self.triangles[:, corner], angle[:, None] * normals[:, corner])
        return total

    def depth(self, points: Points) -> PointLengths:
        """Return the depth [m] of points (P, 3) below the surface, negative outside.

        The sign follows from the normal at the closest point. On edges and corners, it follows from
        the angle-weighted mean normal (J. A. Bærentzen, H. Aanæs, IEEE Trans. Vis. Comput. Graph.
        11, 243 (2005)).
        """
        panel, reference, distance = self.tree.closest(points)
        position, normal = points_at(self.quadratic_triangles[panel], reference)
        weights = np.stack([1 - reference.sum(axis=1), reference[:, 0], reference[:, 1]], axis=1)
        zero = weights < 1e-9
        on_edge = np.flatnonzero(zero.sum(axis=1) == 1)
        edge = (zero[on_edge].argmax(axis=1) + 1) % 3  # corner c is opposite edge c + 1
        normal[on_edge] = self._edge_normals(panel[on_edge], edge, weights[on_edge])
        on_corner = np.flatnonzero(zero.sum(axis=1) > 1)
        corner = weights[on_corner].argmax(axis=1)
        normal[on_corner] = self._vertex_normals[self.triangles[panel[on_corner], corner]]
        inward = np.einsum("pd,pd->p", position - points, normal)
        return np.copysign(distance, np.where(inward == 0.0, 1.0, inward))

    def _edge_normals(
        self, panel: Indices, edge: Indices, weights: Float64[np.ndarray, "n 3"]
    ) -> Float64[np.ndarray, "n 3"]:
        rows = np.arange(len(panel))
        normal = unit(points_at(self.quadratic_triangles[panel], weights[:, 1:])[1])
        neighbour, across = np.divmod(self._twins[panel, edge], 3)
        mirrored = np.zeros_like(weights)
        mirrored[rows, across] = weights[rows, (edge + 1) % 3]
        mirrored[rows, (across + 1) % 3] = weights[rows, edge]
        return normal + unit(points_at(self.quadratic_triangles[neighbour], mirrored[:, 1:])[1])

    def project(self, points: Points) -> PointVectors:
        """Return the points of the surface [m] that are nearest to points (P, 3)."""
        panel, reference, _ = self.tree.closest(points)
        return np.einsum("pn,pnd->pd", shape_functions(reference), self.quadratic_triangles[panel])

    def project_on_sharp_edges(self, points: Points) -> PointVectors:
        """Return the points of the sharp edges [m] that are nearest to points (P, 3)."""
        steps = np.arange(9) / 8
        shape, _ = _along_ridge(steps)
        samples = np.einsum("sn,knd->ksd", shape, self.ridges).reshape(-1, 3)
        # The nearest eight samples may lie on different edges, and each is refined.
        nearest = KDTree(samples).query(points, k=min(8, len(samples)))[1].reshape(len(points), -1)
        ridge, step = np.divmod(nearest, len(steps))
        nodes = self.ridges[ridge]
        share = steps[step]
        for _ in range(6):  # Gauss-Newton steps from a start within an eighth of the edge
            shape, gradient = _along_ridge(share)
            gap = points[:, None] - np.einsum("pkn,pknd->pkd", shape, nodes)
            along = np.einsum("pkn,pknd->pkd", gradient, nodes)
            share = np.clip(share + (gap * along).sum(axis=2) / (along * along).sum(axis=2), 0, 1)
        candidates = np.einsum("pkn,pknd->pkd", _along_ridge(share)[0], nodes)
        best = np.linalg.norm(candidates - points[:, None], axis=2).argmin(axis=1)
        return candidates[np.arange(len(points)), best]

    @cached_property
    def pieces(self) -> "tuple[QuadraticMesh, ...]":
        """Return the closed pieces of the mesh as separate meshes."""
        label = shells(self.triangles)
        if label.max() == 0:
            return (self,)
        pieces = []
        for number in range(label.max() + 1):
            chosen = label == number
            used, triangles = np.unique(self.triangles[chosen], return_inverse=True)
            middles, sharp = (part[chosen] for part in self._curved)
            pieces.append(
                QuadraticMesh(
                    self.vertices[used],
                    triangles.reshape(-1, 3),
                    middles,
                    self.sharp_degrees,
                    sharp,
                )
            )
        return tuple(pieces)

    def with_short_edges(self, longest: float) -> RidgedMesh:
        """Split the triangles along the surface until no edge exceeds ``longest`` [m]."""
        return with_short_edges(self.quadratic_triangles, self.triangles, self.sharp, longest)

    def deviation(self, panels: QuadraticTriangles) -> Float64[np.ndarray, "panels"]:
        """Return the root mean square distance (P,) of panels (P, 6, 3) from the surface [m]."""
        points = (_RULE_SHAPE @ panels).reshape(-1, 3)
        distance = self.tree.closest(points)[2].reshape(-1, len(_RULE_POINTS))
        return np.sqrt(distance**2 @ (2 * _RULE_WEIGHTS))

    def fitted(self, panels: QuadraticTriangles) -> QuadraticTriangles:
        """Fit panels (P, 6, 3) [m] to the surface by least squares."""
        return self.levelled(self.project(panels.reshape(-1, 3)).reshape(-1, 6, 3))[0]

    def levelled(
        self, panels: QuadraticTriangles
    ) -> tuple[QuadraticTriangles, Float64[np.ndarray, "panels"]]:
        """Fit panels (P, 6, 3) [m] to the surface by moving their nodes along the normals.

        The mean square distance from the surface is minimised. The second result is an estimate of
        the remaining root mean square distance (P,) [m], which mostly agrees with ``deviation``
        within 10 %.

        A panel with all nodes on a round surface lies inside the surface. On a scan, such a panel
        follows the roughness at its nodes. A least-squares fit avoids both errors.
        """
        points = (_RULE_SHAPE @ panels).reshape(-1, 3)
        depth = self.depth(points).reshape(-1, len(_RULE_POINTS))
        rise = depth @ _RULE_FIT.T
        remaining = np.sqrt((depth - rise @ _RULE_SHAPE.T) ** 2 @ (2 * _RULE_WEIGHTS))
        normals = unit(normals_at(panels, NODE_REFERENCES))
        return panels + rise[:, :, None] * normals, remaining

    @cached_property
    def area(self) -> float:
        """Area of the surface [m²]."""
        return float(panel_areas(self.quadratic_triangles).sum())

    @cached_property
    def volume(self) -> float:
        """Enclosed volume [m³]."""
        return enclosed_volume(self.quadratic_triangles)


def _along_ridge(
    share: Float64[np.ndarray, "*points"],
) -> tuple[Float64[np.ndarray, "*points 3"], Float64[np.ndarray, "*points 3"]]:
    shape = np.stack(
        [(1 - share) * (1 - 2 * share), 4 * share * (1 - share), share * (2 * share - 1)], axis=-1
    )
    return shape, np.stack([4 * share - 3, 4 - 8 * share, 4 * share - 1], axis=-1)


@dataclass(frozen=True, eq=False)
class MeshShape(Shape):
    """A mesh of quadratic triangles in a given pose.

    ``cached`` contains panels of the mesh before its motion; the keys are the settings of the
    panels.
    """

    mesh: QuadraticMesh
    pose: Pose
    cached: dict[tuple[float, float, float], QuadraticTriangles] = field(
        default_factory=dict, compare=False
    )

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
        """Cover the mesh with curved panels as large as equilateral triangles of side ``edge``.

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


# --- new panels -------------------------------------------------------------------------------


def covered(
    mesh: QuadraticMesh, edge: float, bend: float = BEND, away: float = np.inf
) -> QuadraticTriangles:
    """Cover a closed piece with curved panels as large as equilateral triangles of side ``edge``.

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
    smooth = is_smooth(fine.vertices, fine.triangles, fine.ridges)
    base = coarsened(fine, edge, wall, 0.15 if smooth else 0.25)
    # Panels that turn by a radian deviate by 0.00125 of the edge. The deviation is proportional to
    # the third power of the edge.
    bend_share = min(1.0, away / (0.00125 * edge)) ** (1 / 3)
    strips = strip_sizes(base.vertices, base.ridges, largest)
    bends = bend_sizes(base.vertices, base.triangles, base.ridges, largest, bend_share)
    walls = wall_sizes(base.vertices, base.triangles, largest)
    tips = tip_sizes(base.vertices, base.triangles, base.ridges, largest, bend)
    limits = np.min([strips, bends, walls, tips], axis=0)
    new = remeshed(base, limits, edge, mesh.area / (np.sqrt(3) / 4 * edge**2), wall)
    if not smooth and wall == np.inf:
        # MMG's edges are on average 1/1.35 of their limits. A panel may turn by 0.8 rad at any
        # accuracy. Edges of 0.9 of the size compensate for the kinks of the mesh.
        turns = turn_sizes(base, edge, 0.8 * edge, max(bend, 0.8))
        sizes = 0.9 * np.min([turns, 1.35 * strips, 1.35 * walls, 1.35 * tips], axis=0)
        _kernels.grade_sizes(base.vertices, base.triangles, 0.5, 10, sizes)
        areas = 0.5 * np.linalg.norm(area_vectors(base.vertices[base.triangles]), axis=1)
        needed = areas @ (4 / np.sqrt(3) / sizes[base.triangles].mean(axis=1) ** 2)
        if len(new.triangles) > 1.05 * needed:
            tree = KDTree(base.vertices)
            new = evened(new, lambda points: sizes[tree.query(points)[1]], mesh.project)
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
    normals = unit(normals_at(panels, NODE_REFERENCES[:3]))
    cosine = np.einsum("tnd,tnd->tn", normals, np.roll(normals, 1, axis=1)).min(axis=1)
    return np.arccos(np.clip(cosine, -1.0, 1.0))
