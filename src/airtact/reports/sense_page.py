"""The page of a hand that was located by echoes: its pose, what knowing it brings, and what is left unexplained."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Real
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, PathPatch
from matplotlib.path import Path as Outline

from airtact.checks import counted
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

FOUND = "the pose found"


def write_sense_page(path: Path, sensed: Sensed) -> None:
    """Write the page as one HTML file that needs nothing else; it appears only once it is complete."""
    title = f"airtact: where the hand of {_name(sensed)} is"
    with whole_file(path) as partial:
        partial.write_text(document(title, _pieces(sensed)), "utf-8")


def _name(sensed: Sensed) -> str:
    return sensed.setup.title


def _pieces(sensed: Sensed) -> list[Markup]:
    located = sensed.located
    echoes = sensed.echoes
    off, turn = sensed.off
    elements, transmissions = echoes.codes.shape
    sure, sure_turn = located.deviation
    made = "Simulated echoes" if sensed.true is not None else "Measured echoes"
    doubt = (
        f"{1e3 * sure:.2g} mm, {np.degrees(sure_turn):.2g}°",
        "standard deviation of the pose found",
    )
    return [
        heading(f"{_name(sensed)}: where the hand is"),
        paragraph(
            f"{made} of {counted(transmissions, 'coded transmission', 'coded transmissions')} by {elements:,} "
            f"elements, received by {len(echoes.pressures):,} of them.",
            "lead",
        ),
        key_numbers(
            [
                (f"{1e3 * off:.2f} mm, {np.degrees(turn):.2f}°", "off the scene's pose"),
                doubt,
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
        paragraph(_method(sensed)),
        table(
            ["step", "time"],
            [[name, f"{seconds:.2f} s"] for name, seconds in sensed.seconds.items()],
        ),
        folded("The scene file", sensed.setup.text),
    ]


def _pose_table(sensed: Sensed) -> Markup:
    """List each coordinate of the pose with its doubt."""
    located = sensed.located
    sure, least = (np.sqrt(np.diag(one)) for one in (located.covariance, located.bound))
    shifts = sensed.shifts()
    rows = []
    for index in range(6):
        factor, unit = (1e3, "mm") if index < 3 else (180.0 / np.pi, "°")
        what = f"{'moved along' if index < 3 else 'turned about'} {'xyz'[index % 3]}"
        digits = [f"{factor * one[index]:+.4f} {unit}".replace("-", "−") for one in shifts]
        doubts = [
            f"{factor * one[index]:.4f} {unit}" if np.isfinite(one[index]) else ""
            for one in (sure, least)
        ]
        rows.append([what, digits[0], *doubts, *digits[1:]])
    if located.opening is not None and sensed.gap is not None:
        change = [located.opening - one for one in (sensed.gap, sensed.true_gap) if one is not None]
        digits = [f"{1e3 * one:+.4f} mm".replace("-", "−") for one in change]
        doubts = [f"{1e3 * one[6]:.4f} mm" if np.isfinite(one[6]) else "" for one in (sure, least)]
        rows.append(
            [f"gap, {1e3 * sensed.gap:.2f} mm in the scene", digits[0], *doubts, *digits[1:]]
        )
    header = ["", "from the scene's pose", "standard deviation", "least that the noise allows"]
    true = ["off the simulated truth"] if len(shifts) > 1 else []
    caption = (
        "Of the middle of the bodies, along the axes of the array. The standard deviation counts all that is left "
        "unexplained; the least is the Cramér-Rao bound"
        + (
            "."
            if np.isfinite(least).all()
            else ", which is not known where the noise was not measured."
        )
    )
    return table([*header, *true], rows, caption)


def _foci_table(sensed: Sensed) -> Markup:
    rows = [
        [name, f"{before:,.0f}", f"{after:,.0f}", f"{after / before:.2f}"]
        for name, before, after in zip(sensed.setup.foci, sensed.before, sensed.after, strict=True)
    ]
    header = ["focus", "drive for the scene's pose [Pa]", "drive for the pose found [Pa]", "times"]
    where = "the simulated hand" if sensed.true is not None else "the hand at the pose found"
    return table(header, rows, f"Peak pressure at the foci of {where}.")


def _moved(sensed: Sensed) -> Markup:
    """Picture the hand before and after, beside the foci."""
    setup = sensed.setup
    pose = sensed.located.pose
    off, turn = sensed.off
    before, after = (
        [one.surface for one in some.scene.obstacles] for some in (setup, sensed.found)
    )
    foci = np.stack([setup.target.points, pose.apply(sensed.found.target.points)])
    # 3.0: the bodies are cut in a window smaller than a field's by so many wavelengths, to show
    # motions of a millimetre.
    window = plane_of_scene(setup.scene, setup.target.points)
    less = 3.0 * setup.scene.wavelength
    window = replace(window, width=window.width - less, height=window.height - less)
    figure = draw_moved(window, before, [one.moved(pose) for one in after], foci)
    caption = (
        "The bodies where the scene file has them, dashed, and where the echoes have them, grey, cut by two planes "
        "through the middle of the scene's foci. Foci that lie off a plane are drawn as they stand before it."
    )
    words = f"Cuts of the bodies before and after a motion by {1e3 * off:.2f} mm and {np.degrees(turn):.2f} degrees"
    return picture(figure, caption, words, wide=True)


def _residuals(sensed: Sensed) -> list[Markup]:
    echoes = sensed.echoes
    array = sensed.setup.array
    left_out = sensed.located.left_out
    values = np.full((2, len(array)), np.nan)
    values[:, echoes.receiving] = sensed.unexplained
    values[:, left_out] = np.nan
    label = "not explained, over the rms of the echoes"
    figure = draw_receivers(
        array.positions,
        array.normals,
        dict(zip(("start: the scene's pose", FOUND), values, strict=True)),
        label,
    )
    known = values[:, np.isfinite(values[0])]
    whole = np.sqrt(np.mean(known**2, axis=1))
    rest = "" if len(known.T) == len(array) else " Grey elements did not receive, or were left out."
    caption = (
        "What each receiver gets that the model does not explain, noise included: root mean square over the "
        f"transmissions. Both on one scale.{rest}"
    )
    words = f"Maps of the residual at each element: {whole[0]:.2f} for the start and {whole[1]:.2f} for the pose found"
    pieces = [
        paragraph(
            f"Of the echoes {whole[0]:.0%} (rms) are unexplained at the scene's pose, {whole[1]:.1%} at the one found. "
            "Noise leaves the same everywhere; a wrong shape, a body that the scene lacks, or a board that stands "
            "elsewhere leaves a pattern.".replace("%", " %")
        )
    ]
    if len(left_out):
        pieces.append(
            paragraph(
                f"Receivers that fit nothing were left out: {', '.join(str(one) for one in left_out)}.",
                "warning",
            )
        )
    return [*pieces, picture(figure, caption, words, wide=True)]


def _method(sensed: Sensed) -> str:
    made = (
        "The pose is the one whose echoes are nearest to those received, by least squares from the "
        "scene's own."
    )
    if sensed.true is not None:
        made += " The echoes were simulated with smaller panels than the model's, and noise."
    return f"{made} No board that airtact drives today can receive. {NOT_MODELLED}"


BEFORE, FOUND = "#0072b2", "#e8590c"
"""Colours of the start and of the foci that were found."""


def draw_moved(
    window: Window,
    before: Sequence[Surface],
    after: Sequence[Surface],
    foci: Real[np.ndarray, "2 foci 3"],
) -> Figure:
    """Draw cuts of bodies before and after a correction, and the foci of both, seen from the front and from above.

    The second plane stands upright on the window, through its middle. Foci [m] are drawn as they
    lie before the planes.
    """
    figure = Figure(figsize=(11.0, 5.2), layout="constrained")
    for axes, plane in zip(figure.subplots(1, 2), (window, _across(window)), strict=True):
        _fill(axes, plane, after)
        for loop in cut_bodies(plane, before):
            axes.plot(
                *plane.seen(np.concatenate([loop, loop[:1]])).T, "--", color=BEFORE, linewidth=1.2
            )
        was, now = (plane.seen(some) for some in foci)
        axes.plot(
            *was.T,
            "o",
            markersize=8,
            markerfacecolor="none",
            markeredgecolor=BEFORE,
            markeredgewidth=1.4,
        )
        axes.plot(*now.T, "o", markersize=6, color=FOUND, markeredgecolor="white")
        left, right, bottom, top = plane.extent
        axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
        axes.set(xlabel=plane.labels[0], ylabel=plane.labels[1], title=_where(plane))
    figure.legend(handles=_legend(), loc="outside lower center", ncols=4, frameon=False)
    return figure


def _across(window: Window) -> Window:
    """Return the plane upright on a window, through its middle and along its right."""
    up = window.normal * np.sign(window.normal[np.argmax(np.abs(window.normal))])
    return replace(window, up=np.where(np.abs(up) < 1e-12, 0.0, up), height=window.width)


def _fill(axes: Axes, plane: Window, bodies: Sequence[Surface]) -> None:
    loops: list[Float64[np.ndarray, "_ 3"]] = cut_bodies(plane, bodies)
    if loops:
        paths = [
            Outline(plane.seen(np.concatenate([loop, loop[:1]])), closed=True) for loop in loops
        ]
        axes.add_patch(
            PathPatch(
                Outline.make_compound_path(*paths), facecolor=BODY, edgecolor="0.25", linewidth=0.8
            )
        )


def _where(plane: Window) -> str:
    """Name the plane by the axis of the frame that it stands upright on, if on any."""
    axis = int(np.argmax(np.abs(plane.normal)))
    if abs(plane.normal[axis]) < 1.0 - 1e-9:
        return "through the middle of the foci"
    return f"{'xyz'[axis]} = {1e3 * plane.centre[axis]:.1f} mm".replace("-", "−")


def _legend() -> list[Patch | Line2D]:
    was = Line2D(
        [], [], marker="o", linestyle="none", markerfacecolor="none", markeredgecolor=BEFORE
    )
    now = Line2D([], [], marker="o", linestyle="none", color=FOUND, markeredgecolor="white")
    was.set_label("focus at the start")
    now.set_label("focus found")
    before = Line2D([], [], color=BEFORE, linestyle="--", label="body at the start")
    return [before, was, Patch(facecolor=BODY, edgecolor="0.25", label="body found"), now]
