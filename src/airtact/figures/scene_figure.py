"""The array, the bodies and the foci in space."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Complex, Float64, Real
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from airtact.figures.phase_figure import PHASE_TICKS, spacing, unfold
from airtact.figures.space_axes import LIGHT, View, frame, space_axes
from airtact.surfaces.surface import Surface


def draw_scene(
    positions: Real[np.ndarray, "elements 3"],
    normals: Real[np.ndarray, "elements 3"],
    amplitudes: Complex[np.ndarray, "elements"],
    bodies: Sequence[Surface],
    foci: Real[np.ndarray, "foci 3"],
) -> Figure:
    """Draw the transducers as discs coloured by phase, the bodies shaded in grey and the foci as dots.

    Discs that turn their back to the viewer are faint rings below the rest, so that near walls hide nothing.
    """
    figure = Figure(figsize=(10.4, 8.0), layout="constrained")
    view = _view_of(normals)
    axes, viewer = space_axes(figure, view), view.towards_viewer
    turned_away = normals @ viewer < -1e-6
    size = min(spacing(positions[face.elements]) for face in unfold(positions, normals))
    discs = _discs(positions, normals, 0.47 * size)
    colours = colormaps["twilight"]((np.angle(amplitudes) + np.pi) / (2 * np.pi))
    axes.add_collection3d(
        Poly3DCollection(
            discs[~turned_away], facecolors=colours[~turned_away], edgecolors="0.55", linewidths=0.25, zorder=1
        )
    )
    for body in sorted(bodies, key=lambda body: float(body.vertices.mean(axis=0) @ viewer)):
        axes.add_collection3d(_shaded(body, viewer))
    axes.scatter(*(1e3 * foci.T), s=34, c="#e8590c", edgecolors="white", linewidths=0.8, depthshade=False, zorder=4)
    if turned_away.any():
        faint = colours[turned_away] * [1, 1, 1, 0.18]
        axes.add_collection3d(
            Poly3DCollection(discs[turned_away], facecolors="none", edgecolors=faint, linewidths=0.5, zorder=2)
        )
    frame(axes, [discs.reshape(-1, 3), *(1e3 * body.vertices for body in bodies), 1e3 * foci])
    _phase_bar(figure, axes)
    return figure


def _view_of(normals: Real[np.ndarray, "elements 3"]) -> View:
    """Look into an array that surrounds, past the edge of one that looks one way."""
    mean = normals.mean(axis=0)
    if np.linalg.norm(mean) < 0.3:
        return View(-58.0, 26.0)
    azimuth = np.degrees(np.arctan2(mean[1], mean[0]))
    if abs(mean[2]) > 0.9:
        return View(-58.0, 22.0)
    return View(float(azimuth - 52.0), 20.0)


def _discs(positions: np.ndarray, normals: np.ndarray, radius: float) -> Float64[np.ndarray, "elements corners 3"]:
    """Polygons of 14 corners instead of circles [mm]."""
    helper = np.where(np.abs(normals[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    across = np.cross(normals, helper)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    along = np.cross(normals, across)
    angles = np.linspace(0, 2 * np.pi, 14, endpoint=False)
    circle = np.cos(angles)[None, :, None] * across[:, None] + np.sin(angles)[None, :, None] * along[:, None]
    return 1e3 * (positions[:, None] + radius * circle)


def _shaded(body: Surface, viewer: np.ndarray) -> Poly3DCollection:
    corners = body.vertices[body.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    seen = normals @ viewer > 0
    grey = 0.45 + 0.45 * np.clip(normals[seen] @ LIGHT, 0, 1)
    colours = np.stack([grey, grey * 0.97, grey * 0.94, np.ones_like(grey)], axis=1)
    return Poly3DCollection(1e3 * corners[seen], facecolors=colours, edgecolors=colours, linewidths=0.5, zorder=3)


def _phase_bar(figure: Figure, axes: Axes3D) -> None:
    colours = ScalarMappable(Normalize(-np.pi, np.pi), "twilight")
    bar = figure.colorbar(colours, ax=axes, label="phase of the transducers [rad]", shrink=0.62, pad=0.08, aspect=24)
    bar.set_ticks(list(PHASE_TICKS), labels=list(PHASE_TICKS.values()))
