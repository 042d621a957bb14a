"""Bodies where they were believed to be and where they were found, in two planes through the foci."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64, Real
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, PathPatch
from matplotlib.path import Path

from airtact.evaluation.windows import Window
from airtact.geometry.surface import Surface
from airtact.reports.field_figure import BODY, cut_bodies

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
        paths = [Path(plane.seen(np.concatenate([loop, loop[:1]])), closed=True) for loop in loops]
        axes.add_patch(
            PathPatch(
                Path.make_compound_path(*paths), facecolor=BODY, edgecolor="0.25", linewidth=0.8
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
