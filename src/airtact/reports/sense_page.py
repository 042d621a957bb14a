"""The page of a hand located by echoes: its pose, the gain of correcting it, and the residuals."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Real
from markupsafe import Markup
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, PathPatch
from matplotlib.path import Path as Outline

from airtact.errors import counted
from airtact.evaluation.metrics import NOT_MODELLED
from airtact.evaluation.windows import Window, plane_of_scene
from airtact.files.atomic import whole_file
from airtact.geometry.surface import Surface
from airtact.reports.array_figures import draw_receivers
from airtact.reports.field_figure import BODY, cut_bodies
from airtact.reports.page import (
    document,
    folded,
    heading,
    key_numbers,
    paragraph,
    picture,
    section,
    table,
)
from airtact.setup.sensing import Sensed

BEFORE = "#0072b2"
AFTER = "#e8590c"


def write_sense_page(path: Path, sensed: Sensed) -> None:
    """Write the page as one self-contained HTML file, which appears only once it is complete."""
    title = f"airtact: where the hand of {sensed.setup.title} is"
    with whole_file(path) as partial:
        partial.write_text(document(title, _pieces(sensed)), "utf-8")


def _pieces(sensed: Sensed) -> list[Markup]:
    located = sensed.located
    echoes = sensed.echoes
    off, turn = sensed.off
    elements, transmissions = echoes.codes.shape
    shift_deviation, turn_deviation = located.deviation
    kind = "Simulated" if sensed.true is not None else "Measured"
    count = counted(transmissions, "coded transmission", "coded transmissions")
    made = "The pose is found by least squares of the received echoes, from the scene's pose."
    if sensed.true is not None:
        made += " The echoes were simulated with smaller panels than the model's, and noise."
    return [
        heading(f"{sensed.setup.title}: where the hand is"),
        paragraph(
            f"{kind} echoes of {count} by {elements:,} elements, received by "
            f"{len(echoes.pressures):,} of them.",
            "lead",
        ),
        key_numbers(
            [
                (f"{1e3 * off:.2f} mm, {np.degrees(turn):.2f}°", "off the scene's pose"),
                (
                    f"{1e3 * shift_deviation:.2g} mm, {np.degrees(turn_deviation):.2g}°",
                    "standard deviation of the pose found",
                ),
                (
                    f"{sensed.corrected / sensed.uncorrected:.2f} times",
                    "at the weakest focus, by correcting it",
                ),
                (
                    f"{located.misfit:.1%}".replace("%", " %"),
                    "of the echoes not explained beyond noise",
                ),
            ]
        ),
        section("The pose"),
        _pose_table(sensed),
        section("What correcting it brings"),
        _foci_table(sensed),
        _moved(sensed),
        section("What the model does not explain"),
        *_residuals(sensed),
        section("How this was computed"),
        paragraph(f"{made} No board that airtact drives today can receive. {NOT_MODELLED}"),
        table(
            ["step", "time"],
            [[name, f"{seconds:.2f} s"] for name, seconds in sensed.seconds.items()],
        ),
        folded("The scene file", sensed.setup.text),
    ]


def _pose_table(sensed: Sensed) -> Markup:
    """List each coordinate of the pose with its standard deviation and bound."""
    located = sensed.located
    deviations = [np.sqrt(np.diag(located.covariance)), np.sqrt(np.diag(located.bound))]
    shifts = sensed.shifts()
    rows = []

    def add(name: str, index: int, changes: list[float], factor: float, unit: str) -> None:
        first, *truth = [f"{factor * change:+.4f} {unit}".replace("-", "−") for change in changes]
        doubts = [
            f"{factor * deviation[index]:.4f} {unit}" if np.isfinite(deviation[index]) else ""
            for deviation in deviations
        ]
        rows.append([name, first, *doubts, *truth])

    for index, axis in enumerate("xyz"):
        add(f"moved along {axis}", index, [shift[index] for shift in shifts], 1e3, "mm")
    for index, axis in enumerate("xyz", 3):
        degrees = 180.0 / np.pi
        add(f"turned about {axis}", index, [shift[index] for shift in shifts], degrees, "°")
    if located.opening is not None and sensed.gap is not None:
        gaps = [gap for gap in (sensed.gap, sensed.true_gap) if gap is not None]
        name = f"gap, {1e3 * sensed.gap:.2f} mm in the scene"
        add(name, 6, [located.opening - gap for gap in gaps], 1e3, "mm")
    header = ["", "from the scene's pose", "standard deviation", "least that the noise allows"]
    if len(shifts) > 1:
        header.append("off the simulated truth")
    bound = "the least is the Cramér-Rao bound"
    if not np.isfinite(deviations[1]).all():
        bound += ", which is not known where the noise was not measured"
    caption = (
        "Of the middle of the bodies, along the axes of the array. The standard deviation includes "
        f"everything that is left unexplained; {bound}."
    )
    return table(header, rows, caption)


def _foci_table(sensed: Sensed) -> Markup:
    rows = [
        [name, f"{before:,.0f}", f"{after:,.0f}", f"{after / before:.2f}"]
        for name, before, after in zip(sensed.setup.foci, sensed.before, sensed.after, strict=True)
    ]
    header = ["focus", "drive for the scene's pose [Pa]", "drive for the pose found [Pa]", "times"]
    hand = "the simulated hand" if sensed.true is not None else "the hand at the pose found"
    return table(header, rows, f"Peak pressure at the foci of {hand}.")


def _moved(sensed: Sensed) -> Markup:
    """Picture the hand before and after, beside the foci."""
    setup = sensed.setup
    pose = sensed.located.pose
    off, turn = sensed.off
    before = [body.surface for body in setup.scene.obstacles]
    after = [body.surface.moved(pose) for body in sensed.fitted.scene.obstacles]
    foci = np.stack([setup.target.points, pose.apply(sensed.fitted.target.points)])
    # The window of a field, less 3 wavelengths, shows motions of a millimetre.
    window = plane_of_scene(setup.scene, setup.target.points)
    less = 3.0 * setup.scene.wavelength
    window = replace(window, width=window.width - less, height=window.height - less)
    return picture(
        draw_moved(window, before, after, foci),
        "The bodies as in the scene file, dashed, and as located by the echoes, grey, cut by two "
        "planes through the middle of the scene's foci. Foci off a plane are projected onto it.",
        f"Cuts of the bodies before and after a motion by {1e3 * off:.2f} mm and "
        f"{np.degrees(turn):.2f} degrees",
        wide=True,
    )


def _residuals(sensed: Sensed) -> list[Markup]:
    echoes = sensed.echoes
    array = sensed.setup.array
    left_out = sensed.located.left_out
    # NaN where an element did not receive.
    values = np.full((2, len(array)), np.nan)
    values[:, echoes.receiving] = sensed.unexplained
    values[:, left_out] = np.nan
    start, end = values
    figure = draw_receivers(
        array.positions,
        array.normals,
        {"start: the scene's pose": start, "the pose found": end},
        "not explained, over the rms of the echoes",
    )
    finite = values[:, np.isfinite(start)]
    before, after = np.sqrt(np.mean(finite**2, axis=1))
    caption = (
        "Echoes at each receiver that the model does not explain, noise included: root mean square "
        "over the transmissions. Both maps have one scale."
    )
    if len(finite.T) < len(array):
        caption += " Grey elements did not receive, or were left out."
    pieces = [
        paragraph(
            f"Of the echoes {before:.0%} (rms) are unexplained at the scene's pose, {after:.1%} at "
            "the pose found. Noise leaves the same everywhere; a wrong shape, a body that the "
            "scene lacks, or a displaced board leaves a pattern.".replace("%", " %")
        )
    ]
    if len(left_out):
        names = ", ".join(str(receiver) for receiver in left_out)
        pieces.append(paragraph(f"Receivers that fit nothing were left out: {names}.", "warning"))
    alternative = (
        f"Maps of the residual at each element: {before:.2f} for the start and {after:.2f} for the "
        "pose found"
    )
    return [*pieces, picture(figure, caption, alternative, wide=True)]


def draw_moved(
    window: Window,
    before: Sequence[Surface],
    after: Sequence[Surface],
    foci: Real[np.ndarray, "2 foci 3"],
) -> Figure:
    """Draw cuts of bodies and the foci before and after a correction, in two planes.

    The second plane is upright on the window, through its middle. Foci [m] are projected onto the
    planes.
    """
    figure = Figure(figsize=(11.0, 5.2), layout="constrained")
    up = window.normal * np.sign(window.normal[np.argmax(np.abs(window.normal))])
    up = np.where(np.abs(up) < 1e-12, 0.0, up)
    upright = replace(window, up=up, height=window.width)
    ring: dict[str, Any] = {"marker": "o", "linestyle": "none", "markeredgecolor": BEFORE}
    ring["markerfacecolor"] = "none"
    dot: dict[str, Any] = {
        "marker": "o",
        "linestyle": "none",
        "color": AFTER,
        "markeredgecolor": "white",
    }
    grey: dict[str, Any] = {"facecolor": BODY, "edgecolor": "0.25"}
    for axes, plane in zip(figure.subplots(1, 2), (window, upright), strict=True):
        loops = cut_bodies(plane, after)
        if loops:
            paths = [
                Outline(plane.seen(np.concatenate([loop, loop[:1]])), closed=True) for loop in loops
            ]
            axes.add_patch(PathPatch(Outline.make_compound_path(*paths), linewidth=0.8, **grey))
        for loop in cut_bodies(plane, before):
            closed = plane.seen(np.concatenate([loop, loop[:1]]))
            axes.plot(*closed.T, "--", color=BEFORE, linewidth=1.2)
        axes.plot(*plane.seen(foci[0]).T, markersize=8, markeredgewidth=1.4, **ring)
        axes.plot(*plane.seen(foci[1]).T, markersize=6, **dot)
        left, right, bottom, top = plane.extent
        axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
        axes.set(xlabel=plane.labels[0], ylabel=plane.labels[1], title=_title(plane))
    handles = [
        Line2D([], [], color=BEFORE, linestyle="--", label="body at the start"),
        Line2D([], [], label="focus at the start", **ring),
        Patch(label="body found", **grey),
        Line2D([], [], label="focus found", **dot),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False)
    return figure


def _title(plane: Window) -> str:
    axis = int(np.argmax(np.abs(plane.normal)))
    if abs(plane.normal[axis]) < 1.0 - 1e-9:
        return "through the middle of the foci"
    return f"{'xyz'[axis]} = {1e3 * plane.centre[axis]:.1f} mm".replace("-", "−")
