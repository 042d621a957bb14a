"""Pressure in planes around the foci and on the surfaces of bodies, for the 3-D viewer."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex128, Float64, Inexact, Int64, Real

from airtact.acoustics.solvers.problem import RadiatedField, SurfaceField
from airtact.evaluation.windows import Box, Window
from airtact.geometry.distances import few_within, nearest
from airtact.geometry.mesh.remeshing import with_short_edges
from airtact.geometry.mesh.triangles import with_middles
from airtact.geometry.surface import Surface

# Largest number of points at which the field is evaluated for all planes together
MAX_POINTS = 36_000

# Thickness of the layer at a hard surface in which the pressure is a parabola [wavelengths]. With
# 0.25, the picture of touch_button is 3.3 % off instead of 1.9 %.
WALL = 0.15


@dataclass(frozen=True, eq=False)
class Slices:
    """Pressure of several excitations in parallel planes, which together fill a box.

    Attributes
    ----------
    axes : (3, 3) unit vectors in rows: right, up, and the normal of the planes, each along an axis
        of the frame.
    steps : (3,) distance between neighbouring points along each axis [m].
    pressures : (planes, rows, columns, S) peak pressure [Pa], extrapolated into hard bodies.
    depth : (planes, rows, columns) depth in a body [m], negative outside.
    any_axis : whether the planes are close enough for sections along all three axes.
    samples : complex pressure [Pa] at the evaluated points, on the same axes as ``pressures`` but
        with fewer points.
    """

    corner: Float64[np.ndarray, "3"]
    axes: Float64[np.ndarray, "3 3"]
    steps: Float64[np.ndarray, "3"]
    pressures: Float64[np.ndarray, "planes rows columns excitations"]
    depth: Float64[np.ndarray, "planes rows columns"]
    any_axis: bool
    samples: Complex128[np.ndarray, "sampled_planes sampled_rows sampled_columns excitations"]

    @property
    def box(self) -> Box:
        """The evaluated points, as a grid along the axes of the frame."""
        counts = np.array(self.samples.shape[2::-1])
        steps = self.steps * (np.array(self.depth.shape[::-1]) - 1) / (counts - 1)
        across, along, deep = (counts @ self.axes).astype(int).tolist()
        return Box(self.corner, steps @ self.axes, (across, along, deep))


def slices_around(
    field: RadiatedField, columns: Sequence[int], foci: Real[np.ndarray, "foci 3"], window: Window
) -> Slices:
    """Evaluate a field in planes perpendicular to the axis closest to a window's normal.

    The complex pressure is evaluated at four to five points per wavelength and interpolated by
    cubic splines. At a sound-hard surface, the normal derivative of the pressure vanishes. Near the
    surface the pressure is therefore approximated by a parabola between the solved pressure on the
    surface and the pressure at a height of ``WALL`` wavelengths. The error is about 2 % on average,
    and at worst 7 % of the largest pressure.

    Parameters
    ----------
    field : field computed by a solver.
    columns : indices of the S excitations to show.
    foci : (F, 3) positions of the foci [m].
    window : grid of points in a plane through the foci.

    Returns
    -------
    Pressure in planes that extend 1.5 wavelengths beyond the foci.
    """
    wavelength = field.scene.wavelength
    normal = int(np.argmax(np.abs(window.normal)))
    up = 1 if normal == 2 else 2
    axes = np.eye(3)[[3 - normal - up, up, normal]]
    lowest = (foci @ axes.T).min(axis=0) - 1.5 * wavelength
    highest = (foci @ axes.T).max(axis=0) + 1.5 * wavelength
    counts, any_axis = _counts((highest - lowest) / wavelength)
    # Planes along the first axis of the array, then rows, then columns.
    coordinates = list(map(np.linspace, lowest, highest, counts))
    grid = np.stack(np.meshgrid(*coordinates[::-1], indexing="ij")[::-1], axis=-1)
    points = grid.reshape(-1, 3) @ axes
    depth = field.scene.depth(points).reshape(grid.shape[:3])
    pressure = _pressure(field, points, depth.ravel())[:, list(columns)]
    pressure = _carried_inside(pressure.reshape(*grid.shape[:3], -1))
    # Points behind a plane are hidden like points inside bodies.
    for plane in field.scene.planes:
        depth = np.maximum(depth, -plane.height(points).reshape(depth.shape))
    fine = grid.shape[:3]
    if len(columns) <= 3:  # limits the size of the page
        planes, rows, across = fine
        fine = (2 * planes - 1 if any_axis else planes, 2 * rows - 1, 2 * across - 1)
    # Interpolate complex values, since magnitudes have kinks at their zeros.
    pressures = np.stack(
        [np.abs(_finer(part, fine)) for part in np.moveaxis(pressure, -1, 0)], axis=-1
    )
    steps = (highest - lowest) / (np.array(pressures.shape[2::-1]) - 1)
    depth = np.real(_finer(np.clip(depth, -wavelength, wavelength), fine))
    return Slices(lowest @ axes, axes, steps, pressures, depth, any_axis, pressure)


def _counts(size: Float64[np.ndarray, "3"]) -> tuple[tuple[int, ...], bool]:
    # Count the points along each axis for a size [wavelengths], and return whether all steps are
    # equal. The count across the planes is odd, so that one plane is in the middle.
    counts = 2 * np.ceil(size * 5.0 / 2.0).astype(int) + 1
    if counts.prod() <= MAX_POINTS:
        return tuple(counts.tolist()), True
    # Too many points for a box: use at most four per wavelength in the planes, and at least nine
    # planes.
    min_planes = 9
    step = max(0.25, float(np.sqrt(size[0] * size[1] * min_planes / MAX_POINTS)))
    across, along = (np.ceil(size[:2] / step).astype(int) + 1).tolist()
    planes = min(int(counts[2]), max(min_planes, MAX_POINTS // (across * along)))
    return (across, along, planes - 1 + planes % 2), False


def _finer(
    values: Inexact[np.ndarray, "planes rows columns"], counts: Sequence[int]
) -> Complex128[np.ndarray, "more_planes more_rows more_columns"]:
    # Interpolate to more points between the first and the last along each axis by cubic splines.
    out = np.asarray(values, dtype=np.complex128)
    for axis, (count, more) in enumerate(zip(values.shape, counts, strict=True)):
        if more > count:
            out = _interpolated(out, axis, np.linspace(0.0, count - 1.0, more))
    return out


def _interpolated(
    values: Inexact[np.ndarray, "..."], axis: int, positions: Float64[np.ndarray, "positions"]
) -> Inexact[np.ndarray, "..."]:
    """Interpolate along an axis by a cubic spline; ``positions`` are in steps of the samples.

    The third derivative is continuous at the second and the last but one sample ("not a knot": C.
    de Boor, A Practical Guide to Splines, Springer 2001, chapter IV). Importing SciPy's splines
    would take longer than interpolating a report.
    """
    count = values.shape[axis]
    identity = np.eye(count)
    # The curvatures c follow from c[i-1] + 4 c[i] + c[i+1] = 6 (v[i-1] - 2 v[i] + v[i+1]).
    neighbours = np.eye(count, k=1) + np.eye(count, k=-1)
    left = neighbours + 4.0 * identity
    right = 6.0 * (neighbours - 2.0 * identity)
    left[0, :3] = left[-1, -3:] = (1.0, -2.0, 1.0)
    right[[0, -1]] = 0.0
    curvatures = np.linalg.solve(left, right)
    first = np.clip(positions.astype(int), 0, count - 2)
    after = (positions - first)[:, None]
    before = 1.0 - after
    weights = (
        before * identity[first]
        + after * identity[first + 1]
        + (before**3 - before) / 6.0 * curvatures[first]
        + (after**3 - after) / 6.0 * curvatures[first + 1]
    )
    return np.moveaxis(np.tensordot(weights, values, (1, axis)), 0, axis)


def box_pressure(
    field: RadiatedField, slices: Slices, excitation: int, box: Box
) -> Complex128[np.ndarray, "points"]:
    """Return the pressure of an excitation at the points of a box, interpolated from slices.

    The samples of the slices are interpolated by cubic splines, except within 0.35 wavelengths of
    bodies and planes, where the field is evaluated. The error is 0.5 to 1.5 % (rms).

    Parameters
    ----------
    field : the field from which the slices were computed.
    slices : pressure of the field in parallel planes.
    excitation : index of the excitation in the field and the slices.
    box : a box inside the slices. It must be ``slices.box`` if ``slices.any_axis`` is False,
        because the planes are then too far apart to interpolate between them.

    Returns
    -------
    (P,) complex pressure [Pa], NaN in bodies and behind planes.
    """

    def at_box(values: np.ndarray) -> np.ndarray:
        for index, direction in enumerate(directions):
            finer = (slices.depth.shape[index] - 1) / (values.shape[index] - 1)
            step = slices.steps[2 - index] * finer
            along = box.origin[direction] + box.step[direction] * np.arange(box.counts[direction])
            values = _interpolated(values, index, (along - slices.corner[direction]) / step)
        return values.transpose(np.argsort(directions)).ravel(order="F")

    # Planes, rows and columns each lie along one axis of the frame.
    directions = slices.axes[::-1].argmax(axis=1)
    pressure = at_box(slices.samples[..., excitation])
    near = at_box(slices.depth) > -0.35 * field.scene.wavelength
    pressure[near] = field.for_pictures.at(box.points[near])[:, excitation]
    return pressure


def window_pressure(
    field: RadiatedField, window: Window, depth: Float64[np.ndarray, "points"]
) -> Complex128[np.ndarray, "points excitations"]:
    """Return the pressure of a field at the points of a window, mostly by interpolation.

    Parameters
    ----------
    field : field computed by a solver.
    window : grid of points in the plane of a picture.
    depth : (P,) depth of the window's points in bodies and behind planes [m], negative outside.

    Returns
    -------
    (P, S) complex pressure [Pa] of each excitation, NaN in bodies and behind planes.
    """
    # Six points per wavelength cause an error of 1 %, and the four of large windows one of 2 %.
    coarser = max(2, round(field.scene.wavelength / 6.0 / window.step))
    hard = all(obstacle.boundary == "sound_hard" for obstacle in field.scene.obstacles)
    if not hard:
        return field.at(window.points)
    coarse = replace(window, step=coarser * window.step)
    points = coarse.points
    pressure = _pressure(field, points, field.scene.depth(points))
    pressure = _carried_inside(pressure.reshape(1, *coarse.shape, -1))
    pressure = np.stack(
        [_finer(part, (1, *window.shape)) for part in np.moveaxis(pressure, -1, 0)], axis=-1
    ).reshape(len(window.points), -1)
    pressure[depth > 0.0] = np.nan
    return pressure


def _pressure(
    field: RadiatedField,
    points: Float64[np.ndarray, "points 3"],
    depth: Float64[np.ndarray, "points"],
) -> Complex128[np.ndarray, "points excitations"]:
    # Return the complex pressure at points, from the parabola near hard walls; NaN deep inside
    # bodies.
    if any(obstacle.boundary != "sound_hard" for obstacle in field.scene.obstacles):
        return field.at(points)
    surface = field.on_surface
    wavelength = field.scene.wavelength
    away = depth <= -WALL * wavelength
    # Splines also need values in bodies, up to a quarter of a wavelength deep.
    near = ~away & (depth < 0.25 * wavelength)
    pressure = np.full((len(points), field.sources.strengths.shape[1]), np.nan, dtype=np.complex128)
    if not near.any():
        pressure[away] = field.at(points[away])
        return pressure
    rim = np.where(depth[near] < 0.0, WALL, 0.25)[:, None] * wavelength
    node = _nearest_nodes(surface, points[near], 0.25 * wavelength, 1)[1][:, 0]
    normals = surface.normals[node]
    height = np.sum((surface.points[node] - points[near]) * normals, axis=1, keepdims=True)
    projections = points[near] + height * normals
    # One call for both sets, so that the solver prepares its evaluation once.
    evaluated = field.at(np.concatenate([points[away], projections + rim * normals]))
    pressure[away] = evaluated[: np.count_nonzero(away)]
    rims = evaluated[np.count_nonzero(away) :]
    walls = pressure_on_surfaces(field, projections)
    # The normal derivative vanishes on the wall, so the parabola in the height has no linear term.
    weight = (depth[near, None] / rim) ** 2
    pressure[near] = walls + weight * (np.where(np.isfinite(rims), rims, walls) - walls)
    return pressure


def _carried_inside(
    pressure: Complex128[np.ndarray, "planes rows columns excitations"],
) -> Complex128[np.ndarray, "planes rows columns excitations"]:
    # Replace NaN by the nearest pressure, because splines would ring at the edge of bodies.
    unknown = np.isnan(pressure[..., 0])
    if not unknown.any() or unknown.all():
        return np.nan_to_num(pressure)
    # The nearest known pressure is beside an unknown one: a step towards the latter is closer.
    edge = np.zeros_like(unknown)
    for axis, shift in itertools.product(range(3), (-1, 1)):
        edge |= np.roll(unknown, shift, axis)
    edge &= ~unknown
    filled = pressure.copy()
    filled[unknown] = pressure[edge][nearest(np.argwhere(unknown), np.argwhere(edge))[1]]
    return filled


def _nearest_nodes(
    surface: SurfaceField, points: Float64[np.ndarray, "points 3"], height: float, count: int
) -> tuple[Float64[np.ndarray, "points count"], Int64[np.ndarray, "points count"]]:
    """Return the distances and indices of the solved points nearest to points near the surface.

    The points are at most ``height`` [m] from the surface. Missing distances are infinite.
    """
    if len(points) * len(surface.points) < 5e7:
        # A circle with this radius contains about 28 solved points.
        reach = height + 3.0 * np.sqrt(surface.areas)
        distance, index = few_within(points, surface.points, reach, count)
        if np.isfinite(distance[:, count // 2]).all():
            return distance, index
    # Search trees are faster for many points, but importing them takes 0.2 s.
    from scipy.spatial import KDTree

    few = min(count, len(surface.points))
    distance, index = KDTree(surface.points).query(points, k=few)
    return np.reshape(distance, (-1, few)), np.reshape(index, (-1, few))


@dataclass(frozen=True, eq=False)
class SurfacePressure:
    """The surfaces of all bodies as triangles, with the pressure on them.

    Attributes
    ----------
    vertices : (V, 3) positions [m].
    triangles : (T, 3) indices of the corners.
    pressures : (V, S) peak pressure of each excitation [Pa].
    """

    vertices: Float64[np.ndarray, "vertices 3"]
    triangles: Int64[np.ndarray, "triangles 3"]
    pressures: Float64[np.ndarray, "vertices excitations"]


def surface_pressure(field: RadiatedField, columns: Sequence[int]) -> SurfacePressure | None:
    """Interpolate the pressure on all surfaces for pictures, or return None in open air.

    Parameters
    ----------
    field : field computed by a solver.
    columns : indices of the S excitations to show.
    """
    if not field.scene.obstacles:
        return None
    vertices = []
    triangles = []
    count = 0
    for obstacle in field.scene.obstacles:
        surface = obstacle.surface
        # Importing Trimesh, which ``fine_meshes`` needs, would take 0.3 s.
        fine = with_short_edges(
            with_middles(surface.corners),
            surface.triangles,
            sharp=np.zeros(surface.triangles.shape, dtype=bool),
            longest=0.3 * field.scene.wavelength,
        )
        vertices.append(fine.vertices)
        triangles.append(fine.triangles + count)
        count += len(fine.vertices)
    points = np.concatenate(vertices)
    pressure = pressure_on_surfaces(field, points)[:, list(columns)]
    return SurfacePressure(points, np.concatenate(triangles), np.abs(pressure))


def fine_meshes(
    surfaces: Sequence[Surface], longest_edge: float
) -> tuple[
    Float64[np.ndarray, "vertices 3"],
    Int64[np.ndarray, "triangles 3"],
    Int64[np.ndarray, "vertices"],
]:
    """Divide the triangles of surfaces until no edge is longer than ``longest_edge`` [m].

    Returns
    -------
    The vertices [m], the triangles and, for each vertex, the index of its surface.
    """
    from trimesh.remesh import subdivide_to_size

    vertices = []
    triangles = []
    count = 0
    for surface in surfaces:
        points, corners, *_ = subdivide_to_size(
            surface.vertices, surface.triangles, max_edge=longest_edge, max_iter=20
        )
        # Merge the corners of the subdivided triangles; otherwise they are shaded as facets.
        points, numbers = np.unique(points.round(9), axis=0, return_inverse=True)
        vertices.append(points)
        triangles.append(numbers.reshape(-1)[corners] + count)
        count += len(points)
    body = np.repeat(np.arange(len(surfaces)), [len(points) for points in vertices])
    return np.concatenate(vertices), np.concatenate(triangles).astype(np.int64), body


def pressure_on_surfaces(
    field: RadiatedField, points: Real[np.ndarray, "points 3"]
) -> Complex128[np.ndarray, "points excitations"]:
    """Interpolate the solved pressure on the surfaces of bodies.

    Parameters
    ----------
    field : field of a scene with at least one body.
    points : (P, 3) points on the surfaces [m].

    Returns
    -------
    (P, S) complex pressure [Pa] of each excitation, interpolated by kriging from the nearest 10
    solved points, with the covariance sin(kr)/kr of a diffuse field.
    """
    surface = field.on_surface
    wavenumber = field.scene.wavenumber.real  # absorption is negligible over a few millimetres
    distances, nodes = _nearest_nodes(surface, points, 0.0, 10)
    normals = surface.normals[nodes]
    # Exclude solved points around an edge or behind a thin wall.
    same_side = np.einsum("pkd,pd->pk", normals, normals[:, 0]) > 0.5
    same_side &= np.isfinite(distances)
    # Phases kr from scalar products, which takes half the time of the differences of all pairs.
    around = wavenumber * (surface.points[nodes] - points[:, None])
    products = around @ around.transpose(0, 2, 1)
    squares = np.einsum("pkk->pk", products)
    phases = np.sqrt(np.abs(squares[:, :, None] + squares[:, None] - 2.0 * products))
    covariance = np.sinc(phases / np.pi) * (same_side[:, :, None] & same_side[:, None])
    # The errors of the solved pressure are assumed to have 1e-4 of its variance.
    diagonal = np.arange(distances.shape[1])
    covariance[:, diagonal, diagonal] = 1.0 + 1e-4
    to_point = np.sinc(np.sqrt(squares) / np.pi) * same_side
    weights = np.linalg.solve(covariance, to_point[..., None])
    return np.einsum("pkn,pks->ps", weights, surface.pressure[nodes])
