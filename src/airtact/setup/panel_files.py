"""Panels as files: curved ones for ParaView, flat triangles for everything else."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int64, Real
from scipy.spatial import KDTree

from airtact.errors import InvalidInput
from airtact.files.atomic import whole_file
from airtact.geometry.mesh.arrays import QuadraticTriangles, Triangles, Vertices
from airtact.geometry.mesh.quadratic_triangles import edge_lengths
from airtact.geometry.mesh.topology import are_among, components, edge_ends, edge_twins, with_fans
from airtact.geometry.panels import Panels
from airtact.setup.vtkhdf import write_panels_vtkhdf

CURVED = ".vtkhdf"
# File name endings that are written, in metres
FLAT = (".stl", ".ply", ".glb")


def check_output(path: Path, *sources: Path) -> None:
    """Raise where panels cannot be written to a file, or would overwrite their source."""
    if path.suffix.lower() not in (CURVED, *FLAT):
        raise InvalidInput(
            f"{path.name} ends in {path.suffix!r}, but panels are written to "
            f"{', '.join((CURVED, *FLAT))}.",
            code="unknown_format",
        )
    for source in sources:
        if path.resolve() == source.resolve():
            raise InvalidInput(
                f"the output would overwrite {source.name}, which it is made from: give another "
                "file.",
                code="would_overwrite",
            )


def write_panels(path: Path, panels: Panels) -> int:
    """Write the panels of bodies as ``write_triangles`` does.

    A .vtkhdf also holds body and deviation of each.
    """
    return write_triangles(
        path, panels.quadratic_triangles, {"deviation": panels.deviation, "body": panels.body}
    )


def write_triangles(
    path: Path,
    quadratic_triangles: QuadraticTriangles,
    cells: Mapping[str, Real[np.ndarray, "panels"]] | None = None,
) -> int:
    """Write quadratic triangles [m] in the format of the ending; .vtkhdf also holds ``cells``.

    Return how many edges of the flat triangles have no neighbour; 0 for curved panels, which need
    not meet.
    """
    check_output(path)
    if path.suffix.lower() == CURVED:
        write_panels_vtkhdf(path, quadratic_triangles, cells or {})
        return 0
    import trimesh  # takes as long to import as all the rest of airtact

    vertices, triangles = flat_triangles(quadratic_triangles)
    content = trimesh.Trimesh(vertices, triangles, process=False).export(
        file_type=path.suffix.lower()[1:]
    )
    with whole_file(path) as partial:
        partial.write_bytes(content if isinstance(content, bytes) else str(content).encode())
    return int((edge_twins(triangles) < 0).sum())


def flat_triangles(quadratic_triangles: QuadraticTriangles) -> tuple[Vertices, Triangles]:
    """Cut each panel into four flat triangles, or more beside smaller ones, and join neighbours.

    Each panel is projected onto the surface by itself, so neighbours are micrometres apart; and a
    panel that was cut in four has nodes on the edge of an uncut neighbour, which that neighbour
    lacks. Both are joined as far as they differ from gaps.
    """
    points = quadratic_triangles.reshape(-1, 3)
    shortest = np.repeat(edge_lengths(quadratic_triangles).min(axis=1), 6)
    node = np.arange(len(points))
    vertices = points
    sizes = shortest
    corners = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])
    triangles = node.reshape(-1, 6)[:, corners].reshape(-1, 3)
    # Shares of the shortest edge of the smaller panel by which joined nodes are apart, the nearest
    # first. The nodes of one panel are half an edge apart.
    for share in (1e-6, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5):
        node = _joined(vertices, triangles, share * sizes)[node]
        vertices = np.stack([np.bincount(node, weights=axis) for axis in points.T], axis=1)
        vertices /= np.bincount(node)[:, None]
        sizes = np.full(len(vertices), np.inf)
        np.minimum.at(sizes, node, shortest)
        triangles = node.reshape(-1, 6)[:, corners].reshape(-1, 3)
    for _ in range(8):  # each round splits one edge of a triangle beside smaller neighbours
        bypasses = _bypasses(vertices, triangles)
        if not bypasses:
            break
        triangles = with_fans(triangles, bypasses)
    return vertices, triangles


def _joined(
    vertices: Vertices, triangles: Triangles, near: Float64[np.ndarray, "vertices"]
) -> Int64[np.ndarray, "vertices"]:
    """Return new numbers of the vertices, the same for those that face each other over a gap."""
    # Only edges without a twin face a gap, so only their vertices are searched.
    ends = edge_ends(triangles)
    rim = np.unique(ends[edge_twins(triangles) == -1])
    if len(rim) == 0:
        return np.arange(len(vertices))
    pairs = rim[KDTree(vertices[rim]).query_pairs(float(near[rim].max()), output_type="ndarray")]
    # Vertices of one triangle never join, or it would vanish.
    gap = np.linalg.norm(vertices[pairs[:, 0]] - vertices[pairs[:, 1]], axis=1)
    fit = ~are_among(pairs, ends) & (gap <= near[pairs].min(axis=1))
    pairs = pairs[fit]
    gap = gap[fit]
    nearest = np.full(len(vertices), np.inf)
    np.minimum.at(nearest, pairs.ravel(), np.repeat(gap, 2))
    touching = 1e-6 * near[pairs].min(axis=1)
    # A vertex joins those that are not much farther than its nearest.
    pairs = pairs[gap <= np.maximum(1.5 * nearest[pairs].min(axis=1), touching)]
    return components(pairs[:, 0], pairs[:, 1], len(vertices))


def _bypasses(vertices: Vertices, triangles: Triangles) -> dict[int, list[int]]:
    """Return lone edges 3 t + e with the vertices of shorter lone edges that run back."""
    lone = np.flatnonzero(edge_twins(triangles).ravel() == -1)
    starts, ends = edge_ends(triangles).reshape(-1, 2)[lone].T
    lengths = np.linalg.norm(vertices[ends] - vertices[starts], axis=1)
    edges = list(zip(lone.tolist(), starts.tolist(), ends.tolist(), lengths.tolist(), strict=True))
    following: dict[int, list[tuple[int, float]]] = {}
    for _, start, end, length in edges:
        following.setdefault(start, []).append((end, length))
    bypasses: dict[int, list[int]] = {}
    bypassed: set[int] = set()
    for edge, start, end, length in edges:
        # The way over the nodes of smaller neighbours is hardly longer than the edge.
        way = _way(following, end, start, 1.3 * length, length)
        # Splitting two edges of a triangle at once would need another pattern: the next round does.
        if way and edge // 3 not in bypassed:
            bypassed.add(edge // 3)
            bypasses[edge] = way[:0:-1]
    return bypasses


def _way(
    following: dict[int, list[tuple[int, float]]], here: int, goal: int, left: float, longest: float
) -> list[int]:
    """Return the vertices from here to before a goal along short edges, or none."""
    for vertex, length in following.get(here, ()):
        if length >= min(longest, left):
            continue
        if vertex == goal:
            return [here]
        way = _way(following, vertex, goal, left - length, longest)
        if way:
            return [here, *way]
    return []
