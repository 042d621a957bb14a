"""Removal of the small details of a body, such as the bores, ribs and letters of a printed part.

Details much smaller than the wavelength need many panels, and parts thinner than 0.5 mm cannot be
solved. A closing fills gaps and bores, and an opening removes ribs and thin walls (J. Serra, "Image
analysis and mathematical morphology", 1982, chapter 2). Both use distances on a grid.
"""

import numpy as np
from jaxtyping import Float, Float32

from airtact.errors import InvalidInput, counted, extra
from airtact.geometry.mesh.arrays import FlatMesh, Triangles, Vertices
from airtact.geometry.mesh.panel_tree import panel_tree
from airtact.geometry.mesh.quadratic_triangles import area_vectors, with_middles
from airtact.geometry.mesh.repair import flat_mesh_of
from airtact.geometry.mesh.topology import cone_volumes, edge_twins
from airtact.geometry.mesh.union import distance_grid


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
