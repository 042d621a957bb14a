"""Pictures of transducers, in 3-D or with faces side by side."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

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

from airtact.acoustics.scene import Plane
from airtact.evaluation.windows import AXES
from airtact.geometry.distances import nearest_pair
from airtact.geometry.surface import Surface
from airtact.reports.solids import (
    FOCI,
    View,
    add_solid,
    draw_sheets,
    frame,
    space_axes,
    towards_viewer,
)

# Colour of transducers without a drive
UNDRIVEN = 0.62, 0.70, 0.78, 1.0


@dataclass(frozen=True, eq=False)
class Face:
    """The elements of an array that lie in one plane and radiate along the same ``normal``.

    ``seen`` contains the positions [m] as seen from the side to which the face radiates. They are
    coordinates along the rows of ``axes``, two unit vectors that point right and up.
    """

    elements: Int[np.ndarray, "elements"]
    seen: Float64[np.ndarray, "elements 2"]
    axes: Float64[np.ndarray, "2 3"]
    normal: Float64[np.ndarray, "3"]


def unfold(
    positions: Real[np.ndarray, "elements 3"], normals: Real[np.ndarray, "elements 3"]
) -> list[Face]:
    """Split an array into its flat faces; more than eight faces are treated as one or two bowls.

    Faces around a vertical axis are sorted clockwise as seen from above, the order in which a
    viewer inside sees them when turning right.
    """
    # Elements of one face share the normal and, to 0.1 mm, the distance of the plane to the origin.
    keys = np.round(np.column_stack([normals, (positions * normals).sum(axis=1) / 1e-4]), 3)
    keys[:, 3] = np.round(keys[:, 3])
    # Adding 0.0 turns −0 into 0, so that both give the same key.
    _, number = np.unique(keys + 0.0, axis=0, return_inverse=True)
    groups = [np.flatnonzero(number == face) for face in range(number.max() + 1)]
    # A curved array would have as many faces as elements.
    if len(groups) > 8:
        groups = [np.arange(len(positions))]
        # Two bowls that face each other, as in a levitator
        if np.linalg.norm(normals.mean(axis=0)) < 0.3:
            _, _, ways = np.linalg.svd(normals, full_matrices=False)
            first = normals @ ways[0] > 0.0
            groups = [np.flatnonzero(first), np.flatnonzero(~first)]
    # Use the axis of the frame that is most parallel to all faces; z takes precedence over y and x.
    upright = min(
        (AXES[name] for name in "zyx"),
        key=lambda axis: round(float(np.abs(normals @ axis).max()), 6),
    )
    faces = []
    for group in groups:
        normal = normals[group].mean(axis=0)
        normal = normal / max(float(np.linalg.norm(normal)), 1e-9)
        up = upright - upright @ normal * normal
        up = up / np.linalg.norm(up)
        # The viewer is in front of the face and looks along −normal.
        axes = np.stack([np.cross(up, normal), up])
        faces.append(Face(group, positions[group] @ axes.T, axes, normal))
    east = np.roll(upright, 1)
    north = np.cross(upright, east)
    # Sort by the viewer's direction, clockwise as seen from above.
    return sorted(
        faces,
        key=lambda face: round(float(-np.arctan2(-face.normal @ north, -face.normal @ east)), 6),
    )


def draw_phases(
    positions: Real[np.ndarray, "elements 3"],
    normals: Real[np.ndarray, "elements 3"],
    amplitudes: Complex[np.ndarray, "elements"],
) -> Figure:
    """Draw the phase and amplitude of every transducer as a disc at its position [m].

    Amplitudes are not drawn if they are uniform (see ``is_uniform``).
    """
    shown = ("phase",) if is_uniform(amplitudes) else ("phase", "amplitude")
    rows, columns, width, height = _panels(positions, normals, len(shown))
    across = columns * (width + 0.9)
    up = rows * (height + 1.6)
    figure = Figure(figsize=(across, up))
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, show in zip(panels, shown, strict=True):
        draw_faces(axes, positions, normals, amplitudes, show)
    # Fixed margins for the labels, because Matplotlib's layouts take longer than drawing.
    for index, (axes, bar) in enumerate(zip(panels, figure.axes[len(panels) :], strict=True)):
        row, column = divmod(index, columns)
        wide, high = np.ptp(axes.get_xlim()), np.ptp(axes.get_ylim())
        inches = min(width / wide, height / high)
        left = column * (width + 0.9) + 0.72 + (width - inches * wide) / 2.0
        bottom = (rows - 1 - row) * (height + 1.6)
        extent = inches * wide / across
        axes.set_position((left / across, (bottom + 1.15) / up, extent, inches * high / up))
        bar.set_position((left / across, (bottom + 0.46) / up, extent, 0.16 / up))
    return figure


def is_uniform(amplitudes: Complex[np.ndarray, "elements"]) -> bool:
    """Return whether all amplitudes are equal to within half a per cent."""
    magnitudes = np.abs(amplitudes)
    return bool(np.ptp(magnitudes) <= 5e-3 * magnitudes.max())


def _panels(
    positions: Real[np.ndarray, "elements 3"], normals: Real[np.ndarray, "elements 3"], count: int
) -> tuple[int, int, float, float]:
    # Return the numbers of rows and columns for ``count`` pictures of all faces, and the width and
    # height of each picture [inches].
    spans = np.array([np.ptp(face.seen, axis=0) + 0.03 for face in unfold(positions, normals)])
    width = spans[:, 0].sum()
    height = spans[:, 1].max()
    beside = len(spans) == 1
    rows, columns = (1, count) if beside else (count, 1)
    # Fit the pictures to the width of a page and the height of a screen.
    inches = min(9.4 / (columns * width), (4.6 if beside else 6.6) / (rows * height))
    return rows, columns, width * inches, height * inches


def _label(axis: Axis, direction: Float64[np.ndarray, "3"], fallback: str) -> None:
    for name, unit in AXES.items():
        if abs(direction @ unit) > 1 - 1e-6:
            axis.set_label_text(f"{name} [mm]")
            # If the axis is opposite to that of the frame, the numbers decrease along it.
            if direction @ unit < 0:
                axis.set_major_formatter(lambda value, _: f"{-value:g}".replace("-", "−"))
            return
    axis.set_label_text(fallback)


def draw_receivers(
    positions: Real[np.ndarray, "elements 3"],
    normals: Real[np.ndarray, "elements 3"],
    values: Mapping[str, Float64[np.ndarray, "elements"]],
    label: str,
) -> Figure:
    """Draw positive values of all transducers on a logarithmic scale, one picture per name."""
    rows, columns, width, height = _panels(positions, normals, len(values))
    size = columns * (width + 0.9) + 0.9, rows * (height + 1.0)
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    finite = np.concatenate([column[np.isfinite(column)] for column in values.values()])
    largest = float(finite.max())
    smallest = float(np.clip(finite.min(), 1e-3 * largest, 0.5 * largest))
    scale = ScalarMappable(LogNorm(smallest, largest), "viridis")
    for axes, (name, column) in zip(panels, values.items(), strict=True):
        drawn = scale.to_rgba(np.nan_to_num(column, nan=largest))
        colours = np.where(np.isfinite(column)[:, None], drawn, UNDRIVEN)
        _lay_out(axes, positions, normals, colours)
        axes.set_title(name, fontsize=11, pad=30 if rows > 1 else None)
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
    """Draw the phase or amplitude of all transducers into axes, face by face, with a colour bar."""
    if show == "phase":
        scale = _phase_colours()
        values = np.angle(amplitudes)
        label = "phase [rad]"
    else:
        values = np.abs(amplitudes)
        scale = ScalarMappable(Normalize(0, values.max()), "viridis")
        label = "amplitude [fraction of full scale]"
    faces = _lay_out(axes, positions, normals, scale.to_rgba(values))
    # Next to these axes, the label would seem to belong to the neighbouring axes.
    place: dict[str, Any] = {"location": "bottom", "pad": 0.02, "aspect": 60 if faces > 1 else 30}
    bar = axes.figure.colorbar(scale, ax=axes, label=label, **place)
    if show == "phase":
        _tick_phases(bar)


def _lay_out(
    axes: Axes,
    positions: Real[np.ndarray, "elements 3"],
    normals: Real[np.ndarray, "elements 3"],
    colours: Real[np.ndarray, "elements 4"],
) -> int:
    # Draw the transducers as coloured discs, face by face; return the number of faces.
    faces = unfold(positions, normals)
    size = 1e3 * min(spacing(positions[face.elements]) for face in faces) * 0.94
    left = 0.0
    top = max(1e3 * face.seen[:, 1].max() for face in faces) + size
    places = np.empty((len(positions), 2))
    for face in faces:
        seen = 1e3 * face.seen
        width = float(np.ptp(seen[:, 0]))
        places[face.elements] = seen
        if len(faces) > 1:
            places[face.elements, 0] += left - seen[:, 0].min()
            title = _title(face, positions).replace(", ", "\n")
            axes.text(left + width / 2.0, top, title, ha="center", va="bottom", fontsize=9)
        left += width + 3 * size
    sizes = np.full(len(places), size)
    discs = EllipseCollection(
        sizes, sizes, np.zeros(len(sizes)), units="xy", offsets=places, transOffset=axes.transData
    )
    discs.set(facecolor=colours, edgecolor="0.55", linewidth=0.3)
    axes.add_collection(discs)
    lowest = places.min(axis=0) - size
    highest = places.max(axis=0) + size
    axes.set(xlim=(lowest[0], highest[0]), ylim=(lowest[1], highest[1]), aspect="equal")
    _label(axes.yaxis, faces[0].axes[1], "up [mm]")
    if len(faces) == 1:
        _label(axes.xaxis, faces[0].axes[0], "along the face [mm]")
        axes.set_title(_title(faces[0], positions))
    else:
        axes.set_xlabel("along the faces, side by side [mm]")
    return len(faces)


def _phase_colours() -> ScalarMappable:
    return ScalarMappable(Normalize(-np.pi, np.pi), "twilight")


def _tick_phases(bar: Colorbar) -> None:
    bar.set_ticks(
        [-np.pi, -np.pi / 2, 0.0, np.pi / 2, np.pi], labels=["−π", "−π/2", "0", "π/2", "π"]
    )


def spacing(positions: Real[np.ndarray, "elements 3"]) -> float:
    """Return the distance [m] between the two closest elements, or 10 mm for a single element."""
    return nearest_pair(positions)[2] if len(positions) > 1 else 10e-3


def _title(face: Face, positions: Real[np.ndarray, "elements 3"]) -> str:
    middle = 1e3 * positions[face.elements].mean(axis=0)
    for name, axis in AXES.items():
        if abs(face.normal @ axis) > 1 - 1e-6:
            sign = "+" if face.normal @ axis > 0 else "−"
            return f"at {name} = {middle @ axis:z.0f} mm, facing {sign}{name}".replace("-", "−")
    return "facing ({:z.2f}, {:z.2f}, {:z.2f})".format(*face.normal).replace("-", "−")


def draw_scene(
    positions: Real[np.ndarray, "elements 3"],
    normals: Real[np.ndarray, "elements 3"],
    amplitudes: Complex[np.ndarray, "elements"],
    bodies: Sequence[Surface],
    foci: Real[np.ndarray, "foci 3"],
    planes: Sequence[Plane] = (),
) -> Figure:
    """Draw transducers as discs coloured by phase, bodies in grey, foci as dots, planes as sheets.

    Transducers that face away from the viewer are drawn as faint rings.
    """
    figure = Figure(figsize=(10.4, 8.0))
    axes = space_axes(figure, view_of(normals))
    draw_in_space(axes, positions, normals, np.angle(amplitudes), bodies, foci, planes)
    # Matplotlib's constrained layout finds these places, but takes longer than drawing.
    axes.set_position((0.081, 0.005, 0.761, 0.99))
    figure.axes[1].set_position((0.909, 0.193, 0.02, 0.614))
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
    """Draw the picture of ``draw_scene`` into axes; discs are grey if ``phases`` [rad] is None.

    Transducers, bodies and foci are all optional.
    """
    viewer = towards_viewer(axes.azim, axes.elev)
    discs = np.empty((0, 14, 3))
    if len(positions):
        discs = _add_discs(axes, positions, normals, phases, viewer)
    # Draw from back to front, because matplotlib does not sort whole collections.
    for body in sorted(bodies, key=lambda body: float(body.vertices.mean(axis=0) @ viewer)):
        add_solid(
            axes, 1e3 * body.corners, np.tile((0.9, 0.873, 0.846, 1.0), (len(body.triangles), 1))
        )
    axes.scatter(*(1e3 * foci.T), s=34, **FOCI)
    drawn = np.concatenate(
        [discs.reshape(-1, 3), *(1e3 * body.vertices for body in bodies), 1e3 * foci]
    )
    frame(axes, np.concatenate([drawn, draw_sheets(axes, planes, 1e-3 * drawn)]))
    if phases is not None:
        bar = axes.figure.colorbar(_phase_colours(), ax=axes, shrink=0.62, pad=0.08, aspect=24)
        bar.set_label("phase of the transducers [rad]")
        _tick_phases(bar)


def _add_discs(
    axes: Axes3D,
    positions: np.ndarray,
    normals: np.ndarray,
    phases: np.ndarray | None,
    viewer: np.ndarray,
) -> Float64[np.ndarray, "elements corners 3"]:
    radius = 0.47 * min(spacing(positions[face.elements]) for face in unfold(positions, normals))
    # Draw polygons with 14 corners instead of circles. The helper must not be parallel to a normal.
    helper = np.where(np.abs(normals[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    across = np.cross(normals, helper)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    angles = np.linspace(0, 2 * np.pi, 14, endpoint=False)[None, :, None]
    circle = np.cos(angles) * across[:, None] + np.sin(angles) * np.cross(normals, across)[:, None]
    discs = 1e3 * (positions[:, None] + radius * circle)
    colours = np.tile(UNDRIVEN, (len(discs), 1))
    if phases is not None:
        colours = _phase_colours().to_rgba(phases)
    away = normals @ viewer < -1e-6
    style: dict[str, Any] = {
        "facecolors": colours[~away],
        "edgecolors": "0.55",
        "linewidths": 0.25,
        "zorder": 1,
    }
    axes.add_collection3d(Poly3DCollection(discs[~away], **style))
    if away.any():
        # Faint rings in the colour of the phase keep the array visible.
        faint = colours[away] * [1, 1, 1, 0.18]
        style = {"facecolors": "none", "edgecolors": faint, "linewidths": 0.5, "zorder": 2}
        axes.add_collection3d(Poly3DCollection(discs[away], **style))
    return discs


def view_of(normals: Real[np.ndarray, "elements 3"]) -> View:
    """Return a view into an array that surrounds a hand, or an oblique view of any other."""
    mean = normals.mean(axis=0)
    if np.linalg.norm(mean) < 0.3:
        return -58.0, 26.0
    if abs(mean[2]) > 0.9:
        return -58.0, 22.0
    return float(np.degrees(np.arctan2(mean[1], mean[0])) - 52.0), 20.0
