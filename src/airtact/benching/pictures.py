"""Figures of a bench: error against time of all packages, and how the cost grows."""

from collections.abc import Sequence
from pathlib import Path

from airtact.benching.contest import Solved
from airtact.benching.growth import Grown, power

COLOURS = ("#1b6ca8", "#5fb0d8", "#d1495b", "#8a6f2a")
MARKS = ("o", "v", "s", "^")


def draw_contest(folder: Path, contest: Sequence[Solved], own_error: float) -> None:
    """Draw error against time, one line a package, least to most of the runs as bars.

    Parameters
    ----------
    folder : where ``error_against_time.png`` and ``.svg`` go.
    contest : all runs.
    own_error : of the truth, drawn as the floor.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 4.5), layout="constrained")
    axes = figure.add_subplot(xscale="log", yscale="log")
    packages = list(dict.fromkeys(one.package for one in contest))
    for package, colour, mark in zip(packages, COLOURS, MARKS, strict=False):
        runs = [one for one in contest if one.package == package]
        middle = [one.timed.median for one in runs]
        low = [one.timed.median - min(one.timed.seconds) for one in runs]
        high = [max(one.timed.seconds) - one.timed.median for one in runs]
        errors = [100 * one.error for one in runs]
        axes.errorbar(middle, errors, xerr=(low, high), color=colour, marker=mark, capsize=3, label=package)
    axes.axhline(100 * own_error, color="0.6", linestyle=":", label="the truth's own error")
    axes.set_xlabel("time from bodies to transfer matrix, 996 elements, 2 foci [s]")
    axes.set_ylabel("error of the transfer matrix [%]")
    axes.grid(which="both", color="0.92")
    axes.legend(frameon=False)
    _save(figure, folder / "error_against_time")


def draw_growth(folder: Path, unknowns: Sequence[Grown], elements: Sequence[Grown]) -> None:
    """Draw the time against unknowns and against elements.

    Parameters
    ----------
    folder : where ``growth.png`` and ``.svg`` go.
    unknowns, elements : the sizes.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 3.6), layout="constrained")
    panels = (
        ("unknowns", "time of a solve [s]", unknowns),
        ("elements", "time to the drive of a solved shape [s]", elements),
    )
    for place, (size, says, grown) in enumerate(panels, start=1):
        axes = figure.add_subplot(1, 2, place, xscale="log", yscale="log")
        axes.plot([one.size for one in grown], [one.timed.median for one in grown], color=COLOURS[0], marker="o")
        axes.set_xlabel(size)
        axes.set_ylabel(says)
        axes.grid(which="both", color="0.92")
        if len(grown) > 1:
            axes.set_title(f"grows as the power {power(list(grown)):.1f}", fontsize="medium")
    _save(figure, folder / "growth")


def _save(figure: "object", path: Path) -> None:
    for ending, settings in ((".png", {"dpi": 150}), (".svg", {})):
        figure.savefig(path.with_suffix(ending), **settings)  # pyright: ignore[reportAttributeAccessIssue]
