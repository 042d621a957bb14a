"""The union of the overlapping parts of a mesh, and the removal of small details, on a grid.

CAD programs export unions whose parts still cross each other, and edges that three triangles share.
The topology of such a mesh does not define its inside, but the winding number does: it counts how
many times the surface encloses a point. The body is the region where this number is positive.

Details much smaller than the wavelength, such as bores, ribs and letters of a printed part, need
many panels, and parts thinner than 0.5 mm cannot be solved. A closing fills gaps and bores, and an
opening removes ribs and thin walls (J. Serra, "Image analysis and mathematical morphology", 1982,
chapter 2). Both use distances on a grid.
"""

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int, Int64

from airtact.errors import InvalidInput, counted, extra
from airtact.geometry.mesh.repair import flat_mesh_of
from airtact.geometry.mesh.triangles import (
    FlatMesh,
    Triangles,
    Vertices,
    area_vectors,
    cone_volumes,
    edge_twins,
    panel_tree,
    with_middles,
)


def united_parts(
    vertices: Vertices, triangles: Triangles
) -> tuple[Float64[np.ndarray, "nodes 3"], Int64[np.ndarray, "faces 3"], str]:
    """Return the surface of the union of all parts of a mesh, and a note on its precision.

    The winding number is computed along the lines of a grid in three directions, and the majority
    of the three results is used at each node. A hole, or an edge shared by three triangles,
    therefore affects only single lines. Faces keep their position, but edges are rounded on the
    scale of a grid cell, and walls thinner than two cells disappear.

    Parameters
    ----------
    vertices : (V, 3) positions [m].
    triangles : (T, 3) vertex indices, with normals that point out of each part.
    """
    # Imported here because few files need the union.
    from manifold3d import Manifold, Mesh
    from skimage.measure import marching_cubes

    # A cap of 110 mm is divided into cells of 0.43 mm, 1/20 of the wavelength at 40 kHz.
    cell = float(np.ptp(vertices, axis=0).max()) / 256
    distance, origin = distance_grid(vertices, triangles, cell)
    nodes, faces, _, _ = marching_cubes(distance, 0.0)
    # A tolerance of 3 % of a cell joins the coplanar triangles of flat faces.
    solid = Manifold(Mesh(nodes.astype(np.float32), faces.astype(np.uint32)))
    solid = solid.simplify(0.03).to_mesh()
    note = (
        f"The parts were united on a grid of {1e3 * cell:.2g} mm: "
        f"{counted(len(triangles), 'triangle', 'triangles')} became {len(solid.tri_verts)}, and "
        "edges are rounded on the scale of the grid."
    )
    joined = solid.vert_properties.astype(float) * cell + origin
    return joined, solid.tri_verts.astype(np.int64), note


def distance_grid(
    vertices: Vertices, triangles: Triangles, cell: float
) -> tuple[Float[np.ndarray, "x y z"], Float64[np.ndarray, "3"]]:
    """Return signed distances [cells] on a grid around all parts, and its first node (3,) [m].

    Distances are negative inside. They are exact next to flat faces, and -1 or 1 at nodes that are
    not next to the surface.
    """
    from scipy.ndimage import binary_opening

    low = vertices.min(axis=0)
    extent = vertices.max(axis=0) - low
    # A margin of two cells closes the surface; the odd fraction keeps nodes off faces and edges.
    origin = low - 2.3819 * cell
    shape = tuple(np.ceil(extent / cell).astype(int) + 6)
    corners = ((vertices - origin) / cell)[triangles]
    votes = np.zeros(shape, np.int8)
    hits = []
    for axis in range(3):
        order = [(axis + 1) % 3, (axis + 2) % 3, axis]
        points, upward, owner = _crossings(corners[:, :, order])
        steps = np.zeros([shape[i] for i in order], np.int16)
        above = np.ceil(points).astype(int)
        nodes = (points[:, 0].astype(int), points[:, 1].astype(int), above[:, 2])
        np.add.at(steps, nodes, -upward)
        winding = np.cumsum(steps, axis=2, dtype=np.int16)
        votes += np.transpose(winding > 0, np.argsort(order))
        hits.append((points[:, np.argsort(order)], owner, axis))
    inside = votes >= 2
    # Walls of one or two cells cannot be resolved. They are removed because fins and needles would
    # remain otherwise.
    inside = binary_opening(inside)

    # Only crossings between inside and outside are on the boundary of the union.
    bounding = []
    owners = []
    for points, owner, axis in hits:
        below = np.rint(points).astype(int)
        below[:, axis] = np.floor(points[:, axis])
        above = below + np.eye(3, dtype=int)[axis]
        bounds = inside[tuple(below.T)] != inside[tuple(above.T)]
        bounding.append(points[bounds])
        owners.append(owner[bounds])
    distance = _distances(inside, np.concatenate(bounding), corners[np.concatenate(owners)])
    return distance, origin


def _crossings(
    corners: Float[np.ndarray, "triangles 3 3"],
) -> tuple[Float[np.ndarray, "hits 3"], Int[np.ndarray, "hits"], Int[np.ndarray, "hits"]]:
    """Return the points where vertical lines through integer (x, y) meet triangles.

    The second result is the sign of each crossing, and the third is the index of the triangle.
    """
    flat = corners[:, :, :2]
    first = np.ceil(flat.min(axis=1)).astype(int)
    sides = np.maximum(np.floor(flat.max(axis=1)).astype(int) - first + 1, 0)
    counts = sides[:, 0] * sides[:, 1]
    owner = np.repeat(np.arange(len(corners)), counts)
    within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    lines = first[owner] + np.stack(np.divmod(within, sides[owner, 1]), axis=1)
    a, b, c = (flat[:, corner] for corner in range(3))
    area = _area(b - a, c - a)
    upright = np.abs(area) < 1e-12
    scale = np.where(upright, 1.0, area)[owner]
    # Barycentric coordinates of the line in its triangle.
    u = _area(lines - a[owner], (c - a)[owner]) / scale
    v = _area((b - a)[owner], lines - a[owner]) / scale
    hit = (u >= 0) & (v >= 0) & (u + v < 1) & ~upright[owner]
    owner = owner[hit]
    z = corners[owner, :, 2]
    height = z[:, 0] + u[hit] * (z[:, 1] - z[:, 0]) + v[hit] * (z[:, 2] - z[:, 0])
    points = np.column_stack([lines[hit].astype(float), height])
    return points, np.sign(area[owner]).astype(np.int16), owner


def _area(
    first: Float[np.ndarray, "n 2"], second: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n"]:
    return first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]


def _distances(
    inside: Bool[np.ndarray, "x y z"],
    points: Float[np.ndarray, "points 3"],
    corners: Float[np.ndarray, "points 3 3"],
) -> Float[np.ndarray, "x y z"]:
    """Return each node's signed distance [cells], exact next to flat faces and 1 farther away."""
    from scipy.ndimage import binary_dilation, binary_erosion
    from scipy.spatial import KDTree

    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    near = np.argwhere(binary_dilation(inside) != binary_erosion(inside))
    _, nearest = KDTree(points).query(near)
    height = np.einsum("ij,ij->i", near - points[nearest], normals[nearest])
    distance = np.where(inside, -1.0, 1.0)
    # The sign is that of the winding number; 0.05 avoids needles.
    distance[tuple(near.T)] *= np.clip(np.abs(height), 0.05, 1.0)
    return distance


def without_details(
    vertices: Vertices, triangles: Triangles, smallest: float
) -> tuple[FlatMesh, str]:
    """Return the surface of a body without small details, and a note on the change.

    Overlapping parts are united, and enclosed cavities are filled.

    Parameters
    ----------
    vertices : (V, 3) positions [m].
    triangles : (T, 3) vertex indices, with normals that point out of each part.
    smallest : width [m] below which gaps and bores are filled, and walls and ribs are removed.

    Raises
    ------
    InvalidInput
        If ``smallest`` is under 1/64 of the body's length, or the whole body is thinner than this
        width.
    """
    with extra("mesh", "removing details needs scikit-image"):
        from skimage.measure import marching_cubes
    from manifold3d import Manifold, Mesh
    from scipy.ndimage import binary_fill_holes, gaussian_filter

    extent = float(np.ptp(vertices, axis=0).max())
    if smallest < extent / 64:
        raise InvalidInput(
            f"smallest is {1e3 * smallest:.3g} mm, too small for a body of {1e3 * extent:.3g} mm: "
            f"set smallest to {np.ceil(1e4 * extent / 64) / 1e4:g} m or more.",
            code="out_of_range",
        )
    cell = max(extent / 256, smallest / 8)
    radius = 0.5 * smallest / cell
    distance, origin = distance_grid(vertices, triangles, cell)
    volume_before = np.count_nonzero(distance < 0.0) * cell**3
    margin = int(np.ceil(radius)) + 3  # for the growth by a radius
    distance = np.pad(distance, margin, constant_values=1.0)

    # The body grows by the radius, and what is then deeper than the radius is the closed body.
    closed = radius - _distance_to(radius - _distance_to(distance))
    filled = np.asarray(binary_fill_holes(closed < 0.0))
    closed[filled & (closed >= 0.0)] = -radius
    if (closed >= -radius).all():
        raise InvalidInput(
            f"the whole body is thinner than {1e3 * smallest:.3g} mm: set smallest to a smaller "
            "value.",
            code="out_of_range",
        )
    # What is deeper than the radius grows again. It grows by 1.5 radii within the closed body,
    # because growing by one radius would round all edges.
    opened = np.maximum(closed, _distance_to(closed + radius) - 1.5 * radius)
    # Smoothing by a cell removes the steps of the grid.
    smooth = gaussian_filter(np.clip(opened, -2.0, 2.0), 1.0)
    nodes, faces, _, _ = marching_cubes(smooth, 0.0)
    # A tolerance of a tenth of a cell joins the triangles of flat faces.
    solid = Manifold(Mesh(nodes.astype(np.float32), faces.astype(np.uint32)))
    nodes, faces = flat_mesh_of(solid.simplify(0.1))
    nodes, faces = _coarse((nodes - margin) * cell + origin, faces, smallest)

    corners = nodes[faces]
    volume = cone_volumes(corners).sum()
    points = np.concatenate([nodes, corners.mean(axis=1)])
    away = panel_tree(with_middles(vertices[triangles])).closest(points)[2]
    note = (
        f"Details under {1e3 * smallest:.3g} mm were filled or removed: "
        f"{counted(len(triangles), 'triangle', 'triangles')} became {len(faces)}, which deviate by "
        f"up to {1e3 * away.max():.2g} mm ({1e3 * away.mean():.2g} mm on average), and "
        f"{1e6 * volume_before:.4g} cm³ became {1e6 * volume:.4g} cm³."
    )
    return (nodes, faces), note


def _distance_to(field: Float[np.ndarray, "x y z"]) -> Float32[np.ndarray, "x y z"]:
    """Return the distance [cells] of each node from the region where ``field`` is negative."""
    from scipy.ndimage import distance_transform_edt

    outside = field >= 0.0
    steps_and_nearest = distance_transform_edt(outside, return_indices=True)
    assert steps_and_nearest is not None  # SciPy's types allow None, for results written elsewhere
    steps, nearest = steps_and_nearest
    # The region ends as far beyond its outermost node as the node is deep.
    return np.where(outside, steps + field[tuple(nearest)], 0.0).astype(np.float32)


def _coarse(nodes: Vertices, faces: Triangles, smallest: float) -> FlatMesh:
    """Return the coarsest triangles that stay within half of ``smallest`` of the nodes."""
    with extra("mesh", "removing details needs fast-simplification"):
        from fast_simplification import simplify

    # Finer triangles follow the remaining roughness and need more panels.
    area = np.linalg.norm(area_vectors(nodes[faces]), axis=1).sum() / 2.0
    count = int(area / (7.0 * smallest**2))
    while count < len(faces):
        # In units of ``smallest``, because the library is written for lengths of about 1.
        simplified = simplify(nodes / smallest, faces, target_count=count)
        corners = simplified[0].astype(float) * smallest
        triangles = simplified[1].astype(np.int64)
        if edge_twins(triangles).min() >= 0:
            tree = panel_tree(with_middles(corners[triangles]))
            if tree.closest(nodes)[2].max() < 0.5 * smallest:
                return corners, triangles
        count = int(1.4 * count)
    return nodes, faces
