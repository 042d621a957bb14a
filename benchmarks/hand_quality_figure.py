"""A figure and a table of what wrong hands cost."""

from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from benchmarks.hand_quality import SPEED, Outcome

COLOURS = {"pinch": "C0", "open hand": "C1"}
"""Of the scenes."""


class Column(NamedTuple):
    """Errors that share an axis.

    Attributes
    ----------
    title : of the axis.
    errors : with the style of their lines.
    factor : from sizes to the axis.
    """

    title: str
    errors: dict[str, str]
    factor: float = 1.0


COLUMNS = (
    Column(
        "pads elsewhere by [mm]:\n── whole hand   ╌╌ fingers bent wrongly",
        {"whole hand elsewhere [mm]": "-", "fingers bent wrongly [mm]": "--"},
    ),
    Column(
        "radii wrong by [%]:\n── all alike   ╌╌ each by chance (rms)",
        {"all radii wrong [%]": "-", "each radius wrong [%]": "--"},
    ),
    Column("hand given as triangles\nwith edges of [mm]", {"triangles [mm]": "-"}),
    Column("accuracy asked of the solver [%]", {"panels [accuracy]": "-"}, 100.0),
    Column(f"delay at {SPEED:g} m/s [ms]", {"whole hand elsewhere [mm]": "-"}, 1.0 / SPEED),
)
"""From left to right."""

SMALLER_PANELS = ("triangles [mm]", "panels [accuracy]")
"""Errors relative to a drive on smaller panels."""

NOTHING = Outcome("", "", 0.0, 0, focus=1.0, worst=1.0, side_lobes=1.0, largest=1.0)
"""The outcome of no error."""

FARTHEST = 5.5
"""Larger errors of the pose are drawn as delays only [mm]."""


def focus_of(outcome: Outcome) -> float:
    """Pressure in the foci over that of the right drive.

    Parameters
    ----------
    outcome : of one drive.
    """
    return outcome.focus


def side_lobes_of(outcome: Outcome) -> float:
    """Side lobes on the skin over the foci, over that of the right drive [dB].

    Parameters
    ----------
    outcome : of one drive.
    """
    return 20.0 * float(np.log10(outcome.side_lobes / outcome.focus))


def draw_quality(outcomes: Sequence[Outcome]) -> Figure:
    """Draw what every error costs: pressure in the foci above, side lobes below; bands from least to most.

    Parameters
    ----------
    outcomes : of all scenes.
    """
    figure = Figure(figsize=(17.0, 7.0), layout="constrained")
    grid = figure.subplots(2, len(COLUMNS), sharex="col", sharey="row")
    for place, column in enumerate(COLUMNS):
        above, below = grid[0, place], grid[1, place]
        for axes, value in ((above, focus_of), (below, side_lobes_of)):
            _draw(axes, outcomes, column, value)
            axes.grid(color="0.92")
            axes.set_axisbelow(True)
        above.axhline(1.0, color="0.5", linewidth=0.8)
        below.axhline(0.0, color="0.5", linewidth=0.8)
        below.set_xlabel(column.title)
    blind = {one.scene: one for one in outcomes if one.error == "no hand at all"}
    for scene, one in blind.items():
        for axes, value in ((grid[0], focus_of), (grid[1], side_lobes_of)):
            for part in axes:
                part.axhline(value(one), color=COLOURS[scene], linestyle=":", linewidth=1.2)
    grid[0, 0].set(
        ylabel="pressure in the foci\nover that with the right hand",
        ylim=(0.0, 1.08),
        xlim=(0.0, FARTHEST),
    )
    grid[1, 0].set_ylabel(
        "side lobes on the skin over the foci,\nagainst that with the right hand [dB]"
    )
    keys: list[Line2D | Patch] = [
        Line2D([], [], color=colour, label=scene) for scene, colour in COLOURS.items()
    ]
    keys.append(Line2D([], [], color="0.3", linestyle=":", label="no hand in the model at all"))
    keys.append(Patch(color="0.3", alpha=0.15, label="least to most of all random choices"))
    figure.legend(handles=keys, loc="outside lower center", ncols=4, frameon=False)
    return figure


def _draw(
    axes: Axes, outcomes: Sequence[Outcome], column: Column, value: Callable[[Outcome], float]
) -> None:
    for error, style in column.errors.items():
        for scene, colour in COLOURS.items():
            sizes, spread = spreads(
                [one for one in outcomes if (one.scene, one.error) == (scene, error)], value
            )
            if len(sizes) == 0:
                continue
            if error not in SMALLER_PANELS:  # without an error nothing is lost, by definition
                place, nothing = int(np.searchsorted(sizes, 0.0)), value(NOTHING)
                sizes, spread = (
                    np.insert(sizes, place, 0.0),
                    np.insert(spread, place, nothing, axis=0),
                )
            sizes = column.factor * sizes
            axes.plot(
                sizes, spread[:, 1], style, color=colour, marker="o", markersize=3.5, linewidth=1.4
            )
            axes.fill_between(
                sizes, spread[:, 0], spread[:, 2], color=colour, alpha=0.15, linewidth=0
            )


def spreads(
    outcomes: Sequence[Outcome], value: Callable[[Outcome], float]
) -> tuple[Float64[np.ndarray, "sizes"], Float64[np.ndarray, "sizes 3"]]:
    """Return the least, the median and the most of a value for every size of an error.

    Parameters
    ----------
    outcomes : of one error in one scene.
    value : of an outcome.
    """
    found = defaultdict(list)
    for one in outcomes:
        found[one.size].append(value(one))
    sizes = sorted(found)
    table = [(min(found[size]), float(np.median(found[size])), max(found[size])) for size in sizes]
    return np.array(sizes, dtype=np.float64), np.array(table, dtype=np.float64).reshape(-1, 3)


def answers(outcomes: Sequence[Outcome]) -> list[str]:
    """Return the rows of a Markdown table of what every error costs: the median, and the least to the most.

    Parameters
    ----------
    outcomes : of all scenes.
    """
    scenes = [scene for scene in COLOURS if any(one.scene == scene for one in outcomes)]
    names = [f"{scene}: {what}" for scene in scenes for what in ("foci", "side lobes [dB]")]
    lines = [
        "| what is wrong | by | " + " | ".join(names) + " |",
        "| --- | --- |" + " --- |" * len(names),
    ]
    for error in dict.fromkeys(one.error for one in outcomes):
        for size in sorted({one.size for one in outcomes if one.error == error}):
            cells = []
            for scene in scenes:
                ones = [
                    one
                    for one in outcomes
                    if (one.scene, one.error, one.size) == (scene, error, size)
                ]
                cells += [_cell(ones, focus_of, "{:.2f}"), _cell(ones, side_lobes_of, "{:+.1f}")]
            lines.append(f"| {error} | {size:.3g} | " + " | ".join(cells) + " |")
    return lines


def _cell(outcomes: Sequence[Outcome], value: Callable[[Outcome], float], form: str) -> str:
    if not outcomes:
        return ""
    least, middle, most = (form.format(number) for number in spreads(outcomes, value)[1][0])
    return middle if len(outcomes) == 1 else f"{middle} ({least} to {most})"
