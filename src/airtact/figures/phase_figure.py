"""What each transducer emits, the array's faces unfolded side by side (the paper's Fig. 5)."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float64, Int, Real
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import EllipseCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from airtact.evaluation.windows import AXES

PHASE_TICKS = {-np.pi: "−π", -np.pi / 2: "−π/2", 0.0: "0", np.pi / 2: "π/2", np.pi: "π"}


@dataclass(frozen=True, eq=False)
class Face:
    """The elements of an array that lie in one plane and radiate the same way.

    Attributes
    ----------
    elements : (N,) their indices.
    seen : (N, 2) where they are as seen from the side they radiate to, upright [m].
    normal : (3,) where they radiate to.
    """

    elements: Int[np.ndarray, "elements"]
    seen: Float64[np.ndarray, "elements 2"]
    normal: Float64[np.ndarray, "3"]


def unfold(positions: Real[np.ndarray, "elements 3"], normals: Real[np.ndarray, "elements 3"]) -> list[Face]:
    """Split an array into its flat faces and lay each one flat.

    Returns
    -------
    The faces, those around an upright axis in the order in which a viewer inside who turns to the right sees them.
    More than eight faces are taken as one, seen along the mean normal.
    """
    keys = np.round(np.column_stack([normals, (positions * normals).sum(axis=1) / 1e-4]), 3)
    keys[:, 3] = np.round(keys[:, 3])
    _, number = np.unique(keys + 0.0, axis=0, return_inverse=True)
    groups = [np.flatnonzero(number == face) for face in range(number.max() + 1)]
    if len(groups) > 8:
        groups = [np.arange(len(positions))]
    upright = _upright_axis(normals)
    faces = [_face(positions, normals, group, upright) for group in groups]
    return sorted(faces, key=lambda face: _bearing(face.normal, upright))


def _upright_axis(normals: Real[np.ndarray, "elements 3"]) -> np.ndarray:
    """Find the axis of the frame that lies most in all the faces, z before y before x where they tie."""
    return min((AXES[name] for name in "zyx"), key=lambda axis: round(float(np.abs(normals @ axis).max()), 6))


def _face(positions: np.ndarray, normals: np.ndarray, group: np.ndarray, upright: np.ndarray) -> Face:
    normal = normals[group].mean(axis=0)
    normal = normal / max(float(np.linalg.norm(normal)), 1e-9)
    up = upright - upright @ normal * normal
    up = up / np.linalg.norm(up)
    # The viewer stands where the face radiates to and looks along -normal.
    right = np.cross(up, normal)
    return Face(group, positions[group] @ np.stack([right, up], axis=1), normal)


def _bearing(normal: np.ndarray, upright: np.ndarray) -> float:
    """Angle, clockwise seen from above, of the direction in which the viewer looks at a face."""
    east = np.roll(upright, 1)
    north = np.cross(upright, east)
    return float(np.round(-np.arctan2(-normal @ north, -normal @ east), 6))


def draw_phases(
    positions: Real[np.ndarray, "elements 3"],
    normals: Real[np.ndarray, "elements 3"],
    amplitudes: Complex[np.ndarray, "elements"],
) -> Figure:
    """Draw phase and amplitude of every transducer as discs at their true positions [m]."""
    faces = unfold(positions, normals)
    spans = np.array([np.ptp(face.seen, axis=0) + 0.02 for face in faces])
    beside = len(faces) == 1
    widths = [*spans[:, 0]] * (2 if beside else 1)
    heights = [spans[:, 1].max()] * (1 if beside else 2)
    inches = min(10.5 / sum(widths), 8.4 / sum(heights))
    figure = Figure(
        figsize=(sum(widths) * inches + (3.4 if beside else 2.0), sum(heights) * inches + 1.2), layout="constrained"
    )
    axes = figure.subplots(len(heights), len(widths), squeeze=False, sharex="col", sharey="row", width_ratios=widths)
    rows = axes.T if beside else axes
    size = min(spacing(positions[face.elements]) for face in faces) * 0.94
    magnitudes = np.abs(amplitudes)
    emitted = (
        (np.angle(amplitudes), ScalarMappable(Normalize(-np.pi, np.pi), "twilight"), "phase [rad]"),
        (magnitudes, ScalarMappable(Normalize(0, magnitudes.max()), "viridis"), "amplitude [of full scale]"),
    )
    for row, (values, scale, label) in zip(rows, emitted, strict=True):
        for panel, face in zip(row, faces, strict=True):
            _draw_discs(panel, 1e3 * face.seen, values[face.elements], 1e3 * size, scale)
        bar = figure.colorbar(scale, ax=list(row), label=label, pad=0.01, aspect=25)
        if scale.get_cmap().name == "twilight":
            bar.set_ticks(list(PHASE_TICKS), labels=list(PHASE_TICKS.values()))
    for panel, face in zip(axes[0], faces * (2 if beside else 1), strict=True):
        panel.set_title(_where(face, positions), fontsize=10)
    for panel in axes[-1]:
        panel.set_xlabel("along the face [mm]")
    for panel in axes[:, 0]:
        panel.set_ylabel("up [mm]")
    return figure


def spacing(positions: Real[np.ndarray, "elements 3"]) -> float:
    """Distance of the two closest elements [m], 10 mm for one alone."""
    from scipy.spatial import KDTree

    if len(positions) < 2:
        return 10e-3
    return float(KDTree(positions).query(positions, k=2)[0][:, 1].min())


def _draw_discs(
    axes: Axes,
    seen: Float64[np.ndarray, "elements 2"],
    values: Real[np.ndarray, "elements"],
    size: float,
    scale: ScalarMappable,
) -> None:
    sizes = np.full(len(seen), size)
    discs = EllipseCollection(sizes, sizes, np.zeros(len(seen)), units="xy", offsets=seen, transOffset=axes.transData)
    discs.set(facecolor=scale.to_rgba(values), edgecolor="0.55", linewidth=0.3)
    axes.add_collection(discs)
    lowest, highest = seen.min(axis=0) - size, seen.max(axis=0) + size
    axes.set(xlim=(lowest[0], highest[0]), ylim=(lowest[1], highest[1]), aspect="equal")


def _where(face: Face, positions: Real[np.ndarray, "elements 3"]) -> str:
    """Name the plane that a face lies in and the way it radiates."""
    middle = 1e3 * positions[face.elements].mean(axis=0)
    for name, axis in AXES.items():
        if abs(face.normal @ axis) > 1 - 1e-6:
            way = "+" if face.normal @ axis > 0 else "−"
            return f"at {name} = {middle @ axis:.0f} mm, facing {way}{name}".replace("-", "−")
    return "facing ({:.2f}, {:.2f}, {:.2f})".format(*face.normal).replace("-", "−")
