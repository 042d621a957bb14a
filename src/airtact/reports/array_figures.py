"""What each transducer emits: the array's faces side by side (the paper's Fig. 5), and all in space with bodies."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Complex, Float64, Int, Real
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.cm import ScalarMappable
from matplotlib.collections import EllipseCollection
from matplotlib.colorbar import Colorbar
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from airtact.acoustics.planes import Plane
from airtact.evaluation.windows import AXES
from airtact.geometry.surface import Surface
from airtact.reports.solids import View, draw_sheets, frame, solid, space_axes

GREY = 0.9, 0.873, 0.846, 1.0
"""Colour of bodies."""

UNDRIVEN = 0.62, 0.70, 0.78, 1.0
"""Colour of transducers without a drive."""

PHASE_TICKS = {-np.pi: "−π", -np.pi / 2: "−π/2", 0.0: "0", np.pi / 2: "π/2", np.pi: "π"}


@dataclass(frozen=True, eq=False)
class Face:
    """The elements of an array that lie in one plane and radiate the same way, along ``normal``.

    ``seen`` are their positions as seen from the side they radiate to, upright [m]: along the unit
    vectors in the rows of ``sides``, right and up.
    """

    elements: Int[np.ndarray, "elements"]
    seen: Float64[np.ndarray, "elements 2"]
    sides: Float64[np.ndarray, "2 3"]
    normal: Float64[np.ndarray, "3"]


def unfold(
    positions: Real[np.ndarray, "elements 3"], normals: Real[np.ndarray, "elements 3"]
) -> list[Face]:
    """Split an array into its flat faces and lay each one flat; more than eight are taken as one.

    Those around an upright axis come in the order in which a viewer inside who turns to the right
    sees them.
    """
    keys = np.round(np.column_stack([normals, (positions * normals).sum(axis=1) / 1e-4]), 3)
    keys[:, 3] = np.round(keys[:, 3])
    _, number = np.unique(keys + 0.0, axis=0, return_inverse=True)
    groups = [np.flatnonzero(number == face) for face in range(number.max() + 1)]
    if len(groups) > 8:
        groups = [np.arange(len(positions))]
    # The axis of the frame that lies most in all the faces, z before y before x where they tie.
    upright = min(
        (AXES[name] for name in "zyx"),
        key=lambda axis: round(float(np.abs(normals @ axis).max()), 6),
    )
    faces = [_face(positions, normals, group, upright) for group in groups]
    return sorted(faces, key=lambda face: _bearing(face.normal, upright))


def _face(
    positions: np.ndarray, normals: np.ndarray, group: np.ndarray, upright: np.ndarray
) -> Face:
    normal = normals[group].mean(axis=0)
    normal = normal / max(float(np.linalg.norm(normal)), 1e-9)
    up = upright - upright @ normal * normal
    up = up / np.linalg.norm(up)
    # The viewer stands where the face radiates to and looks along -normal.
    sides = np.stack([np.cross(up, normal), up])
    return Face(group, positions[group] @ sides.T, sides, normal)


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
    rows, columns, width, height = _panels(positions, normals, 2)
    size = columns * (width + 1.5), rows * (height + 1.2) - 0.6 * (rows == 1)
    figure = Figure(figsize=size, layout="constrained")
    for axes, show in zip(figure.subplots(rows, columns), ("phase", "amplitude"), strict=True):
        draw_faces(axes, positions, normals, amplitudes, show)
    return figure


def _panels(
    positions: Real[np.ndarray, "elements 3"], normals: Real[np.ndarray, "elements 3"], count: int
) -> tuple[int, int, float, float]:
    """Rows and columns of so many pictures of all faces side by side, and width and height of one [inches]."""
    spans = np.array([np.ptp(face.seen, axis=0) + 0.03 for face in unfold(positions, normals)])
    width = spans[:, 0].sum()
    height = spans[:, 1].max()
    beside = len(spans) == 1
    rows, columns = (1, count) if beside else (count, 1)
    inches = min(9.4 / (columns * width), (4.6 if beside else 6.6) / (rows * height))
    return rows, columns, width * inches, height * inches


def _name(axis: Axis, direction: Float64[np.ndarray, "3"], other: str) -> None:
    """Label an axis as that of the frame that it follows, which may fall where it rises, or by another word."""
    for name, unit in AXES.items():
        if abs(direction @ unit) > 1 - 1e-6:
            axis.set_label_text(f"{name} [mm]")
            if direction @ unit < 0:
                axis.set_major_formatter(lambda value, _: f"{-value:g}".replace("-", "−"))
            return
    axis.set_label_text(other)


def draw_receivers(
    positions: Real[np.ndarray, "elements 3"],
    normals: Real[np.ndarray, "elements 3"],
    values: Mapping[str, Float64[np.ndarray, "elements"]],
    label: str,
) -> Figure:
    """Draw values above zero of every transducer, by name, as discs on one logarithmic scale; grey where one is NaN."""
    rows, columns, width, height = _panels(positions, normals, len(values))
    size = columns * (width + 0.9) + 0.9, rows * (height + 1.0)
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    known = np.concatenate([one[np.isfinite(one)] for one in values.values()])
    most = float(known.max())
    scale = ScalarMappable(
        LogNorm(float(np.clip(known.min(), 1e-3 * most, 0.5 * most)), most), "viridis"
    )
    for axes, (name, one) in zip(panels, values.items(), strict=True):
        colours = np.where(
            np.isfinite(one)[:, None], scale.to_rgba(np.nan_to_num(one, nan=most)), UNDRIVEN
        )
        _lay_out(axes, positions, normals, colours)
        axes.set_title(name, fontsize=11, pad=30 if columns == 1 and rows > 1 else None)
    ticks = LogLocator(subs=(1.0, 2.0, 5.0))
    bar = figure.colorbar(
        scale, ax=list(panels), label=label, aspect=30, ticks=ticks, format="{x:g}"
    )
    bar.minorticks_off()
    return figure


def draw_faces(
    axes: Axes,
    positions: Real[np.ndarray, "elements 3"],
    normals: Real[np.ndarray, "elements 3"],
    amplitudes: Complex[np.ndarray, "elements"],
    show: Literal["phase", "amplitude"],
) -> None:
    """Draw phase or amplitude of every transducer into axes, the faces of the array side by side, with a bar."""
    magnitudes = np.abs(amplitudes)
    scale = (
        _phase_colours()
        if show == "phase"
        else ScalarMappable(Normalize(0, magnitudes.max()), "viridis")
    )
    colours = scale.to_rgba(np.angle(amplitudes) if show == "phase" else magnitudes)
    faces = _lay_out(axes, positions, normals, colours)
    label = "phase [rad]" if show == "phase" else "amplitude [of full scale]"
    if len(faces) == 1:
        bar = axes.figure.colorbar(scale, ax=axes, pad=0.02, aspect=25)
        bar.ax.set_title(
            label, fontsize=9, loc="right"
        )  # beside the bar it would read as that of the next axes
    else:
        bar = axes.figure.colorbar(
            scale, ax=axes, label=label, location="bottom", pad=0.02, aspect=60
        )
    if show == "phase":
        _tick_phases(bar)


def _lay_out(
    axes: Axes,
    positions: Real[np.ndarray, "elements 3"],
    normals: Real[np.ndarray, "elements 3"],
    colours: Real[np.ndarray, "elements 4"],
) -> list[Face]:
    """Draw every transducer as a disc of its colour, the faces of the array side by side; return the faces."""
    faces = unfold(positions, normals)
    size = 1e3 * min(spacing(positions[face.elements]) for face in faces) * 0.94
    left = 0.0
    top = max(1e3 * face.seen[:, 1].max() for face in faces) + size
    placed = []
    for face in faces:
        seen = 1e3 * face.seen
        shift = 0.0 if len(faces) == 1 else left - seen[:, 0].min()
        placed.append(seen + [shift, 0.0])
        if len(faces) > 1:
            middle = float(np.ptp(seen[:, 0])) / 2.0 + left
            axes.text(
                middle,
                top,
                _where(face, positions).replace(", ", "\n"),
                ha="center",
                va="bottom",
                fontsize=9,
            )
        left += float(np.ptp(seen[:, 0])) + 3 * size
    order = np.concatenate([face.elements for face in faces])
    _draw_discs(axes, np.concatenate(placed), colours[order], size)
    _name(axes.yaxis, faces[0].sides[1], "up [mm]")
    if len(faces) == 1:
        _name(axes.xaxis, faces[0].sides[0], "along the face [mm]")
        axes.set_title(_where(faces[0], positions))
    else:
        axes.set_xlabel("along the faces, side by side [mm]")
    return faces


def _phase_colours() -> ScalarMappable:
    return ScalarMappable(Normalize(-np.pi, np.pi), "twilight")


def _tick_phases(bar: Colorbar) -> None:
    bar.set_ticks(list(PHASE_TICKS), labels=list(PHASE_TICKS.values()))


def spacing(positions: Real[np.ndarray, "elements 3"]) -> float:
    """Distance of the two closest elements [m], 10 mm for one alone."""
    from scipy.spatial import KDTree

    if len(positions) < 2:
        return 10e-3
    return float(KDTree(positions).query(positions, k=2)[0][:, 1].min())


def _draw_discs(
    axes: Axes,
    seen: Float64[np.ndarray, "elements 2"],
    colours: Real[np.ndarray, "elements 4"],
    size: float,
) -> None:
    sizes = np.full(len(seen), size)
    discs = EllipseCollection(
        sizes, sizes, np.zeros(len(seen)), units="xy", offsets=seen, transOffset=axes.transData
    )
    discs.set(facecolor=colours, edgecolor="0.55", linewidth=0.3)
    axes.add_collection(discs)
    lowest = seen.min(axis=0) - size
    highest = seen.max(axis=0) + size
    axes.set(xlim=(lowest[0], highest[0]), ylim=(lowest[1], highest[1]), aspect="equal")


def _where(face: Face, positions: Real[np.ndarray, "elements 3"]) -> str:
    """Name the plane that a face lies in and the way it radiates."""
    middle = 1e3 * positions[face.elements].mean(axis=0)
    for name, axis in AXES.items():
        if abs(face.normal @ axis) > 1 - 1e-6:
            way = "+" if face.normal @ axis > 0 else "−"
            return f"at {name} = {middle @ axis:.0f} mm, facing {way}{name}".replace("-", "−")
    return "facing ({:.2f}, {:.2f}, {:.2f})".format(*face.normal).replace("-", "−")


def draw_scene(
    positions: Real[np.ndarray, "elements 3"],
    normals: Real[np.ndarray, "elements 3"],
    amplitudes: Complex[np.ndarray, "elements"],
    bodies: Sequence[Surface],
    foci: Real[np.ndarray, "foci 3"],
    planes: Sequence[Plane] = (),
) -> Figure:
    """Draw the transducers as discs coloured by phase, the bodies shaded in grey, the foci as dots, planes as sheets.

    Discs that turn their back to the viewer are faint rings below the rest, so that near walls hide
    nothing.
    """
    figure = Figure(figsize=(10.4, 8.0), layout="constrained")
    axes = space_axes(figure, view_of(normals))
    draw_in_space(axes, positions, normals, np.angle(amplitudes), bodies, foci, planes)
    return figure


def draw_in_space(
    axes: Axes3D,
    positions: Real[np.ndarray, "elements 3"],
    normals: Real[np.ndarray, "elements 3"],
    phases: Real[np.ndarray, "elements"] | None,
    bodies: Sequence[Surface],
    foci: Real[np.ndarray, "foci 3"],
    planes: Sequence[Plane] = (),
) -> None:
    """Draw into axes in space what ``draw_scene`` draws, the discs grey where no phases [rad] are given.

    There may be no transducers, no bodies or no foci.
    """
    view = View(axes.azim, axes.elev)
    discs = np.empty((0, 14, 3))
    if len(positions):
        discs = _add_discs(axes, positions, normals, phases, view.towards_viewer)
    for body in sorted(
        bodies, key=lambda body: float(body.vertices.mean(axis=0) @ view.towards_viewer)
    ):
        shaded = solid(1e3 * body.corners, np.tile(GREY, (len(body.triangles), 1)), [], view)
        shaded.set_zorder(3)
        axes.add_collection3d(shaded)
    axes.scatter(
        *(1e3 * foci.T),
        s=34,
        c="#e8590c",
        edgecolors="white",
        linewidths=0.8,
        depthshade=False,
        zorder=4,
    )
    drawn = np.concatenate(
        [discs.reshape(-1, 3), *(1e3 * body.vertices for body in bodies), 1e3 * foci]
    )
    frame(axes, np.concatenate([drawn, draw_sheets(axes, planes, 1e-3 * drawn)]))
    if phases is not None:
        label = "phase of the transducers [rad]"
        bar = axes.figure.colorbar(
            _phase_colours(), ax=axes, label=label, shrink=0.62, pad=0.08, aspect=24
        )
        _tick_phases(bar)


def _add_discs(
    axes: Axes3D,
    positions: np.ndarray,
    normals: np.ndarray,
    phases: np.ndarray | None,
    viewer: np.ndarray,
) -> Float64[np.ndarray, "elements corners 3"]:
    """Add a disc for each transducer, and return them [mm]."""
    turned_away = normals @ viewer < -1e-6
    size = min(spacing(positions[face.elements]) for face in unfold(positions, normals))
    discs = _discs(positions, normals, 0.47 * size)
    colours = (
        np.tile(UNDRIVEN, (len(discs), 1)) if phases is None else _phase_colours().to_rgba(phases)
    )
    shown = {
        "facecolors": colours[~turned_away],
        "edgecolors": "0.55",
        "linewidths": 0.25,
        "zorder": 1,
    }
    axes.add_collection3d(Poly3DCollection(discs[~turned_away], **shown))
    if turned_away.any():
        faint = colours[turned_away] * [1, 1, 1, 0.18]
        shown = {"facecolors": "none", "edgecolors": faint, "linewidths": 0.5, "zorder": 2}
        axes.add_collection3d(Poly3DCollection(discs[turned_away], **shown))
    return discs


def view_of(normals: Real[np.ndarray, "elements 3"]) -> View:
    """Look into an array that surrounds, past the edge of one that looks one way."""
    mean = normals.mean(axis=0)
    if np.linalg.norm(mean) < 0.3:
        return View(-58.0, 26.0)
    if abs(mean[2]) > 0.9:
        return View(-58.0, 22.0)
    return View(float(np.degrees(np.arctan2(mean[1], mean[0])) - 52.0), 20.0)


def _discs(
    positions: np.ndarray, normals: np.ndarray, radius: float
) -> Float64[np.ndarray, "elements corners 3"]:
    """Polygons of 14 corners instead of circles [mm]."""
    helper = np.where(np.abs(normals[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    across = np.cross(normals, helper)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    along = np.cross(normals, across)
    angles = np.linspace(0, 2 * np.pi, 14, endpoint=False)
    circle = (
        np.cos(angles)[None, :, None] * across[:, None]
        + np.sin(angles)[None, :, None] * along[:, None]
    )
    return 1e3 * (positions[:, None] + radius * circle)
