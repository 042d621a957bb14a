"""The page and the figures of a bench: the text of docs/performance.md, error against time, growth of the cost."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from airtact.benching.contest import Solved, faster
from airtact.benching.growth import Grown, power
from airtact.benching.real_time import Row

COLOURS = ("#1b6ca8", "#5fb0d8", "#d1495b", "#8a6f2a")
MARKS = ("o", "v", "s", "^")

HEAD = """# Performance

The speed of airtact, with the error beside every time. Made by

```sh
airtact bench --out out/bench --acoustools PYTHON --bempp PYTHON --hand relaxed.json
```

where each PYTHON is the interpreter of an environment with that package; what is not given is left out. Times are
medians, with the least and the most in brackets.
"""

CONTEST = """## Beside other packages

Two capsules of 16 mm x 60 mm, 12 mm apart, a focus 2 mm off each pad, 996 elements as monopoles. Each package runs in
an interpreter of its own, one after the other, warmed up, from bodies in memory to the transfer matrix: airtact and
bempp-cl solve for a beacon in each focus, AcousTools for all elements, as it is made; airtact once with its estimate of
the error, which is a second solve, and once without. AcousTools is given points
inside the bodies (CHIEF), without which it does not converge; bempp-cl runs Galerkin with linear elements, Burton-
Miller and OpenCL on the processor. Their flat triangles are even and hold the exact volume. The error is that of the
worse focus over all elements, against fundamental solutions, which share no code with any of them and are themselves
{own:.2%} off. Memory is the peak above what the process held after a small run.
"""


@dataclass(frozen=True)
class Bench:
    """All that was measured: the machine, runs of all packages on one scene, rows of real time, growth of the cost.

    ``own_error`` is that of the reference of the runs; ``notes`` give what was left out, and why.
    """

    machine: str
    contest: Sequence[Solved]
    own_error: float
    rows: Sequence[Row]
    unknowns: Sequence[Grown]
    elements: Sequence[Grown]
    notes: Sequence[str]


def page_of(found: Bench) -> str:
    """Return the page in Markdown."""
    parts = [
        HEAD,
        f"Machine: {found.machine}.\n",
        CONTEST.format(own=found.own_error),
        _contest(found),
        _rows(found),
    ]
    parts.append(_growth(found))
    if found.notes:
        parts.append(
            "## Left out\n\n" + "\n".join(f"- {sentence}" for sentence in found.notes) + "\n"
        )
    return "\n".join(parts)


def _contest(found: Bench) -> str:
    mine = [one for one in found.contest if one.package.startswith("airtact")]
    lines = [
        "| package | setting | unknowns | time | error | memory | airtact at equal or smaller error |"
    ]
    lines.append("|---|---|---|---|---|---|---|")
    for one in found.contest:
        numbers = f"{one.unknowns} | {one.timed} | {one.error:.2%} | {one.peak / 1e6:.0f} MB"
        ratio = "" if one in mine else _ratio(mine, one)
        lines.append(f"| {one.package} | {one.setting} | {numbers} | {ratio} |")
    return "\n".join([*lines, "", "![Error against time](error_against_time.svg)\n"])


def _ratio(mine: list[Solved], one: Solved) -> str:
    found = faster(mine, one)
    if found is None:
        return "none of these runs is as accurate"
    times, best = found
    return f"{times:.0f} times faster ({best.timed}, {best.error:.2%})"


def _rows(found: Bench) -> str:
    lines = ["## A hand that moves\n", "| what | asked | measured | error | where the time went |"]
    lines.append("|---|---|---|---|---|")
    lines += [
        f"| {one.what} | {one.asked} | {one.measured} | {one.error} | {one.profile} |"
        for one in found.rows
    ]
    return "\n".join([*lines, ""])


def _growth(found: Bench) -> str:
    lines = ["## How the cost grows\n"]
    for name, what, grown in (
        ("unknowns", "a solve of two fingers, 2 foci", found.unknowns),
        ("elements", "transfer matrix and drive of a solved shape", found.elements),
    ):
        lines += [f"| {name} | {what} |", "|---|---|"]
        lines += [f"| {one.size} | {one.timed} |" for one in grown]
        if len(grown) > 1:
            lines.append(
                f"\nOver the larger half it grows as the power {power(list(grown)):.1f} of the {name}."
            )
        lines.append("")
    return "\n".join([*lines, "![How the cost grows](growth.svg)\n"])


def draw_contest(folder: Path, contest: Sequence[Solved], own_error: float) -> None:
    """Draw error against time, one line a package, least to most of the runs as bars."""
    figure = Figure(figsize=(7.0, 4.5), layout="constrained")
    axes = figure.add_subplot(xscale="log", yscale="log")
    packages = list(dict.fromkeys(one.package for one in contest))
    for package, colour, mark in zip(packages, COLOURS, MARKS, strict=False):
        runs = [one for one in contest if one.package == package]
        middle = [one.timed.median for one in runs]
        low = [one.timed.median - min(one.timed.seconds) for one in runs]
        high = [max(one.timed.seconds) - one.timed.median for one in runs]
        errors = [100 * one.error for one in runs]
        axes.errorbar(
            middle, errors, xerr=(low, high), color=colour, marker=mark, capsize=3, label=package
        )
    axes.axhline(100 * own_error, color="0.6", linestyle=":", label="the reference's own error")
    axes.set(xlabel="time from bodies to transfer matrix, 996 elements, 2 foci [s]")
    axes.set(ylabel="error of the transfer matrix [%]")
    axes.grid(which="both", color="0.92")
    axes.legend(frameon=False)
    _save(figure, folder / "error_against_time")


def draw_growth(folder: Path, unknowns: Sequence[Grown], elements: Sequence[Grown]) -> None:
    """Draw the time against unknowns and against elements."""
    figure = Figure(figsize=(8.0, 3.6), layout="constrained")
    pair = figure.subplots(1, 2, subplot_kw={"xscale": "log", "yscale": "log"})
    says = "time of a solve [s]", "time to the drive of a solved shape [s]"
    for axes, size, label, grown in zip(
        pair, ("unknowns", "elements"), says, (unknowns, elements), strict=True
    ):
        axes.plot(
            [one.size for one in grown],
            [one.timed.median for one in grown],
            color=COLOURS[0],
            marker="o",
        )
        axes.set(xlabel=size, ylabel=label)
        axes.grid(which="both", color="0.92")
        if len(grown) > 1:
            axes.set_title(f"grows as the power {power(list(grown)):.1f}", fontsize="medium")
    _save(figure, folder / "growth")


def _save(figure: Figure, path: Path) -> None:
    figure.savefig(path.with_suffix(".png"), dpi=150)
    figure.savefig(path.with_suffix(".svg"))
