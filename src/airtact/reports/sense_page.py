"""The page of a hand located from echoes: its pose, the effect of the correction, the residuals."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Real
from markupsafe import Markup
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from airtact.acoustics.scene import Scene
from airtact.errors import counted
from airtact.evaluation.metrics import NOT_MODELLED
from airtact.evaluation.windows import Window, plane_of_scene
from airtact.reports.array_figures import draw_receivers
from airtact.reports.field_figure import BODY, draw_solid, grid_axes
from airtact.reports.page import picture, write_page
from airtact.setup.sensing import Sensed

BEFORE = "#0072b2"


def write_sense_page(path: Path, sensed: Sensed) -> None:
    """Write an HTML page about the estimated pose of a hand, replacing an existing file."""
    elements, transmissions = sensed.echoes.codes.shape
    left_out = sensed.located.left_out
    # The residual is NaN for elements that did not receive.
    values = np.full((2, len(sensed.setup.array)), np.nan)
    values[:, sensed.echoes.receiving] = sensed.unexplained
    values[:, left_out] = np.nan
    before, after = np.sqrt(np.nanmean(values**2, axis=1))
    warnings = []
    if len(left_out):
        names = ", ".join(str(receiver) for receiver in left_out)
        warnings.append(f"Receivers without a usable signal were ignored: {names}.")
    off, turn = sensed.sizes[0]
    shift_deviation, turn_deviation = sensed.located.deviation
    caption = (
        "Residual of the echoes at each receiver, including noise (root mean square over the "
        "transmissions). Both maps use the same colour scale."
    )
    if not np.isfinite(values[0]).all():
        caption += " Grey elements did not receive or were ignored."
    write_page(
        path,
        "sense.html.j2",
        title=f"airtact: pose of the hand in {sensed.setup.title}",
        sensed=sensed,
        simulated=len(sensed.shifts) > 1,
        transmissions=counted(transmissions, "coded transmission", "coded transmissions"),
        elements=f"{elements:,}",
        receivers=f"{len(sensed.echoes.pressures):,}",
        facts=[
            (
                f"{1e3 * off:.2f} mm, {np.degrees(turn):.2f}°",
                "displacement from the pose in the scene",
            ),
            (
                f"{1e3 * shift_deviation:.2g} mm, {np.degrees(turn_deviation):.2g}°",
                "standard deviation of the estimated pose",
            ),
            (
                f"{sensed.after.min() / sensed.before.min():.2f} times",
                "the uncorrected pressure at the weakest focus, after the correction",
            ),
            (
                f"{sensed.located.misfit:.1%}".replace("%", " %"),
                "of the echoes explained neither by the model nor by noise",
            ),
        ],
        **_pose(sensed),
        focus_rows=[
            [name, f"{old:,.0f}", f"{new:,.0f}", f"{new / old:.2f}"]
            for name, old, new in zip(sensed.setup.foci, sensed.before, sensed.after, strict=True)
        ],
        moved=_moved(sensed),
        before=f"{before:.0%}".replace("%", " %"),
        after=f"{after:.1%}".replace("%", " %"),
        warnings=warnings,
        residuals=picture(
            draw_receivers(
                sensed.setup.array.positions,
                sensed.setup.array.normals,
                {"pose in the scene": values[0], "estimated pose": values[1]},
                "residual / rms of the echoes",
            ),
            caption,
            f"Maps of the residual at each element: {before:.2f} for the pose in the scene and "
            f"{after:.2f} for the estimated pose",
            wide=True,
        ),
        not_modelled=NOT_MODELLED,
        steps=[[name, f"{seconds:.2f} s"] for name, seconds in sensed.seconds.items()],
    )


def _pose(sensed: Sensed) -> dict[str, Any]:
    located = sensed.located
    deviations = [np.sqrt(np.diag(located.covariance)), np.sqrt(np.diag(located.bound))]
    changes = sensed.shifts
    quantities = [(f"moved along {axis}", 1e3, "mm") for axis in "xyz"]
    quantities += [(f"turned about {axis}", 180.0 / np.pi, "°") for axis in "xyz"]
    if located.opening is not None and sensed.gap is not None:
        gaps = [gap for gap in (sensed.gap, sensed.true_gap) if gap is not None]
        changes = np.column_stack([changes, located.opening - np.array(gaps)])
        quantities.append((f"gap, {1e3 * sensed.gap:.2f} mm in the scene", 1e3, "mm"))
    rows = []
    for index, (name, factor, unit) in enumerate(quantities):
        doubts = [factor * deviation[index] for deviation in deviations]
        first, *truth = [f"{factor * change:+z.4f} {unit}" for change in changes[:, index]]
        cells = [f"{doubt:.4f} {unit}" if np.isfinite(doubt) else "" for doubt in doubts]
        rows.append([name, *(text.replace("-", "−") for text in (first, *cells, *truth))])
    header = ["", "relative to the scene", "standard deviation", "Cramér-Rao bound"]
    if len(changes) > 1:
        header.append("error (simulated hand)")
    bound = "The Cramér-Rao bound is the smallest standard deviation that the noise allows"
    if not np.isfinite(deviations[1]).all():
        bound += "; it is unknown, because the noise was not measured"
    return {"pose_header": header, "pose_rows": rows, "bound": bound}


def _moved(sensed: Sensed) -> Markup:
    setup = sensed.setup
    fitted = sensed.fitted
    pose = sensed.located.pose
    off, turn = sensed.sizes[0]
    moved_bodies = [
        replace(body, surface=body.surface.moved(pose)) for body in fitted.scene.obstacles
    ]
    scenes = (setup.scene, replace(fitted.scene, obstacles=moved_bodies))
    foci = np.stack([setup.target.points, pose.apply(fitted.target.points)])
    # A smaller window than for fields makes motions of a millimetre visible.
    window = plane_of_scene(setup.scene, setup.target.points)
    less = 3.0 * setup.scene.wavelength
    window = replace(window, width=window.width - less, height=window.height - less)
    return picture(
        draw_moved(window, scenes, foci),
        "Cross-sections of the bodies in the scene file (dashed) and as located from the echoes "
        "(grey), in two planes through the middle of the foci. Foci are projected onto the planes.",
        f"Cross-sections of the bodies before and after a motion by {1e3 * off:.2f} mm and "
        f"{np.degrees(turn):.2f} degrees",
        wide=True,
    )


def draw_moved(
    window: Window,
    scenes: tuple[Scene, Scene],
    foci: Real[np.ndarray, "2 foci 3"],
) -> Figure:
    """Draw cross-sections of the bodies of two scenes, before and after a correction.

    The first plane is that of ``window``; the second is perpendicular and passes through its
    centre. Foci are projected onto the planes.
    """
    figure = Figure(figsize=(11.0, 5.2), layout="constrained")
    up = window.normal * np.sign(window.normal[np.argmax(np.abs(window.normal))])
    up = np.where(np.abs(up) < 1e-12, 0.0, up)
    upright = replace(window, up=up, height=window.width)
    ring: dict[str, Any] = {
        "marker": "o",
        "linestyle": "none",
        "markeredgecolor": BEFORE,
        "markerfacecolor": "none",
    }
    dot: dict[str, Any] = {
        "marker": "o",
        "linestyle": "none",
        "color": "#e8590c",
        "markeredgecolor": "white",
    }
    for axes, plane in zip(figure.subplots(1, 2), (window, upright), strict=True):
        before, after = (scene.depth(plane.points) for scene in scenes)
        draw_solid(axes, plane, after)
        grid = (*grid_axes(plane), before.reshape(plane.shape))
        axes.contour(*grid, levels=[0.0], colors=BEFORE, linestyles="--", linewidths=1.2)
        axes.plot(*plane.seen(foci[0]).T, markersize=8, markeredgewidth=1.4, **ring)
        axes.plot(*plane.seen(foci[1]).T, markersize=6, **dot)
        left, right, bottom, top = plane.extent
        axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
        axes.set(xlabel=plane.labels[0], ylabel=plane.labels[1])
    handles = [
        Line2D([], [], color=BEFORE, linestyle="--", label="body in the scene"),
        Line2D([], [], label="focus in the scene", **ring),
        Patch(label="located body", facecolor=BODY, edgecolor="0.25"),
        Line2D([], [], label="located focus", **dot),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False)
    return figure
