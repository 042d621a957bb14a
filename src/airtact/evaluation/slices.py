"""Pressure in planes around the foci and on the surfaces of bodies, for a scene that a reader turns."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128, Float64, Inexact, Int64, Real

from airtact.acoustics.solvers.problem import RadiatedField
from airtact.evaluation.windows import Window
from airtact.printing import in_short

MOST_POINTS = 36_000
"""Points at which the field is evaluated for all planes together."""

MOST_FINE = 3
"""With more excitations the points in between are left out, or the page would grow large."""

MARGIN = 1.5
"""How far the planes reach past the outermost foci, in wavelengths."""

STEPS = 1.0 / 5.0, 1.0 / 4.0
"""Distance of the points in wavelengths: in a box that is cut along any axis, and in a stack of planes."""

LEAST_PLANES = 9
"""Planes of a stack."""

SURFACE_EDGE = 0.3
"""Longest edge of the triangles that carry the pressure on surfaces, in wavelengths."""

WALL = 0.25
"""Within this many wavelengths of a hard surface the pressure follows from that on the surface and that at its rim."""

RIDGE = 1e-4
"""Share of the variance that is taken as errors of the solved pressure."""

NEIGHBOURS = 16
"""Solved points of a surface from which the pressure between them follows."""


@dataclass(frozen=True, eq=False)
class Slices:
    """Pressure of several excitations in parallel planes, or in a box.

    Attributes
    ----------
    corner : (3,) the first point [m].
    axes : (3, 3) unit vectors in rows: right, up, and the normal of the planes, each an axis of the
        frame.
    steps : (3,) distance of neighbouring points along each of the axes [m].
    pressures : (planes, rows, columns, S) peak pressure [Pa], carried into hard bodies by at most a
        few points.
    depth : (planes, rows, columns) depth in a body [m], negative outside.
    any_axis : whether the planes stand so close that sections along all three axes show the field.
    """

    corner: Float64[np.ndarray, "3"]
    axes: Float64[np.ndarray, "3 3"]
    steps: Float64[np.ndarray, "3"]
    pressures: Float64[np.ndarray, "planes rows columns sounds"]
    depth: Float64[np.ndarray, "planes rows columns"]
    any_axis: bool

    __repr__ = in_short


def slices_around(
    field: RadiatedField, columns: Sequence[int], foci: Real[np.ndarray, "foci 3"], window: Window
) -> Slices:
    """Evaluate a field in planes across the axis of the frame that a window faces most.

    The complex pressure is evaluated at four to five points a wavelength and interpolated by cubic
    splines. Near a sound-hard surface, where its slope along the normal vanishes, it is a parabola
    between the solved pressure on the surface and that at a height of ``WALL`` wavelengths, off by
    some 2 % in the mean and 7 % of the largest at worst.

    Parameters
    ----------
    field : as a solver returns it.
    columns : the S excitations to show.
    foci : (F, 3) [m].
    window : through the foci.

    Returns
    -------
    Pressure in planes that extend ``MARGIN`` wavelengths past the foci.
    """
    wavelength = field.scene.wavelength
    normal = int(np.argmax(np.abs(window.normal)))
    up = 1 if normal == 2 else 2
    axes = np.eye(3)[[3 - normal - up, up, normal]]
    lowest, highest = (foci @ axes.T).min(axis=0), (foci @ axes.T).max(axis=0)
    lowest, highest = lowest - MARGIN * wavelength, highest + MARGIN * wavelength
    counts, any_axis = _counts((highest - lowest) / wavelength)
    sides = [
        np.linspace(low, high, count)
        for low, high, count in zip(lowest, highest, counts, strict=True)
    ]
    grid = np.stack(np.meshgrid(*sides[::-1], indexing="ij")[::-1], axis=-1)
    points = grid.reshape(-1, 3) @ axes
    depth = field.scene.depth(points).reshape(grid.shape[:3])
    pressure = _pressure(field, points, depth.ravel())[:, list(columns)].reshape(
        *grid.shape[:3], -1
    )
    pressure = _carried_inside(pressure)
    for plane in field.scene.planes:
        depth = np.maximum(depth, -plane.height(points).reshape(depth.shape))
    fine = (1, 1, 1) if len(columns) > MOST_FINE else (2, 2, 2) if any_axis else (1, 2, 2)
    pressures = np.stack(
        [np.abs(_finer(one, fine)) for one in np.moveaxis(pressure, -1, 0)], axis=-1
    )
    steps = (highest - lowest) / (np.array(pressures.shape[2::-1]) - 1)
    depth = np.real(_finer(np.clip(depth, -wavelength, wavelength), fine))
    return Slices(lowest @ axes, axes, steps, pressures, depth, any_axis)


def _counts(sides: Float64[np.ndarray, "3"]) -> tuple[tuple[int, ...], bool]:
    """Points along the sides [wavelengths], and whether they stand equally close along all."""
    counts = (
        2 * np.ceil(sides / STEPS[0] / 2.0).astype(int) + 1
    )  # odd, so that one plane lies in the middle
    if counts.prod() <= MOST_POINTS:
        return tuple(counts.tolist()), True
    step = max(STEPS[1], float(np.sqrt(sides[0] * sides[1] * LEAST_PLANES / MOST_POINTS)))
    across, along = (np.ceil(sides[:2] / step).astype(int) + 1).tolist()
    planes = min(int(counts[2]), max(LEAST_PLANES, MOST_POINTS // (across * along)))
    return (across, along, planes - 1 + planes % 2), False


def _finer(
    values: Inexact[np.ndarray, "planes rows columns"], times: tuple[int, int, int]
) -> Complex128[np.ndarray, "more_planes more_rows more_columns"]:
    """Put ``times`` − 1 values between neighbours along each axis by cubic splines."""
    from scipy.interpolate import make_interp_spline

    out = np.asarray(values, dtype=np.complex128)
    for axis, (count, factor) in enumerate(zip(values.shape, times, strict=True)):
        if factor > 1:
            spline = make_interp_spline(np.arange(count), out, k=3, axis=axis)
            out = spline(np.linspace(0.0, count - 1.0, factor * (count - 1) + 1))
    return out


def _pressure(
    field: RadiatedField,
    points: Float64[np.ndarray, "points 3"],
    depth: Float64[np.ndarray, "points"],
) -> Complex128[np.ndarray, "points sounds"]:
    """Complex pressure at points, by the parabola near hard walls; NaN deep inside bodies."""
    if any(one.boundary != "sound_hard" for one in field.scene.obstacles):
        return field.at(points)
    surface, rim = field.on_surface, WALL * field.scene.wavelength
    near, away = np.abs(depth) < rim, depth <= -rim
    out = np.full((len(points), field.sources.strengths.shape[1]), np.nan, dtype=np.complex128)
    if not near.any():
        out[away] = field.at(points[away])
        return out
    from scipy.spatial import KDTree

    nearest = KDTree(surface.points).query(points[near])[1]
    normals = surface.normals[nearest]
    projections = (
        points[near]
        + np.sum((surface.points[nearest] - points[near]) * normals, axis=1, keepdims=True)
        * normals
    )
    evaluated = field.at(np.concatenate([points[away], projections + rim * normals]))
    out[away], rims = evaluated[: np.count_nonzero(away)], evaluated[np.count_nonzero(away) :]
    walls = pressure_on_surfaces(field, projections)
    weight = (depth[near] / rim)[:, None] ** 2
    out[near] = walls + weight * (np.where(np.isfinite(rims), rims, walls) - walls)
    return out


def _carried_inside(
    pressure: Complex128[np.ndarray, "planes rows columns sounds"],
) -> Complex128[np.ndarray, "planes rows columns sounds"]:
    """Replace NaN by the nearest pressure there is, or splines would ring at the edge of what is known."""
    from scipy.ndimage import distance_transform_edt

    unknown = np.isnan(pressure[..., 0])
    if not unknown.any() or unknown.all():
        return np.nan_to_num(pressure)
    nearest = distance_transform_edt(unknown, return_distances=False, return_indices=True)
    return pressure[tuple(np.asarray(nearest))]


@dataclass(frozen=True, eq=False)
class SurfacePressure:
    """The surfaces of all bodies as triangles, with the pressure on them.

    Attributes
    ----------
    vertices : (V, 3) [m].
    triangles : (T, 3) their corners.
    pressures : (V, S) peak pressure of each excitation [Pa].
    """

    vertices: Float64[np.ndarray, "vertices 3"]
    triangles: Int64[np.ndarray, "triangles 3"]
    pressures: Float64[np.ndarray, "vertices sounds"]

    __repr__ = in_short


def surface_pressure(field: RadiatedField, columns: Sequence[int]) -> SurfacePressure | None:
    """Interpolate the solved pressure on the surfaces of all bodies, for pictures; None in open air.

    Parameters
    ----------
    field : as a solver returns it.
    columns : the S excitations to show.
    """
    from trimesh.remesh import subdivide_to_size

    if not field.scene.obstacles:
        return None
    vertices, triangles, count = [], [], 0
    for obstacle in field.scene.obstacles:
        surface = obstacle.surface
        points, corners, *_ = subdivide_to_size(
            surface.vertices,
            surface.triangles,
            max_edge=SURFACE_EDGE * field.scene.wavelength,
            max_iter=20,
        )
        # The cut triangles have corners of their own, and would be lit as facets.
        points, numbers = np.unique(points.round(9), axis=0, return_inverse=True)
        vertices.append(points)
        triangles.append(numbers.reshape(-1)[corners] + count)
        count += len(points)
    points = np.concatenate(vertices)
    pressure = pressure_on_surfaces(field, points)[:, list(columns)]
    return SurfacePressure(points, np.concatenate(triangles).astype(np.int64), np.abs(pressure))


def pressure_on_surfaces(
    field: RadiatedField, points: Real[np.ndarray, "points 3"]
) -> Complex128[np.ndarray, "points sounds"]:
    """Interpolate the solved pressure on the surfaces of bodies.

    Parameters
    ----------
    field : with at least one body.
    points : (P, 3) on the surfaces [m].

    Returns
    -------
    (P, S) complex pressure [Pa] for each excitation, by kriging from the nearest solved points with the covariance
    sin(kr)/kr of a diffuse field.
    """
    from scipy.spatial import KDTree

    surface, wavenumber = field.on_surface, field.scene.wavenumber
    distances, nearest = KDTree(surface.points).query(
        points, k=min(NEIGHBOURS, len(surface.points))
    )
    normals, around = surface.normals[nearest], surface.points[nearest]
    same_side = (
        np.einsum("pkd,pd->pk", normals, normals[:, 0]) > 0.5
    )  # not round an edge, nor behind a thin wall
    between = np.linalg.norm(around[:, :, None] - around[:, None], axis=-1)
    covariance = np.sinc(wavenumber * between / np.pi) * same_side[:, :, None] * same_side[:, None]
    diagonal = np.arange(covariance.shape[1])
    covariance[:, diagonal, diagonal] = 1.0 + RIDGE
    weights = np.linalg.solve(
        covariance, (np.sinc(wavenumber * distances / np.pi) * same_side)[..., None]
    )
    return np.einsum("pkn,pks->ps", weights, surface.pressure[nearest])
