"""Error against time, memory and mesh, over orders and both domains."""

from collections.abc import Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter

from airtact.experiments.mesh_run import Row
from airtact.experiments.settings import Settings

MARKERS = {"tight": "o", "box": "s"}
"""Of the domains."""

WORST = 3.0
"""Errors above this are drawn at it."""

BEYOND = 30.0
"""Costs of more than so many times the limit are drawn there, as an arrow."""


def draw_costs(rows: Sequence[Row], settings: Settings) -> Figure:
    """Draw every combination three times: those run by their error, and above them the others by their order."""
    figure = Figure(figsize=(12.0, 7.6), layout="constrained")
    grid = figure.subplots(2, 3, sharex="col", sharey="row", height_ratios=(1.0, 2.2))
    above, below = list(grid[0]), list(grid[1])
    orders = settings.study_orders
    colour = dict(zip(orders, colormaps["viridis"](np.linspace(0, 0.92, len(orders))), strict=True))
    limits = (BEYOND * settings.study_seconds, BEYOND * settings.study_bytes / 2**30, np.inf)
    for row in rows:
        one = row.combination
        style = {"color": colour[one.order], "linestyle": "", "markersize": 5.0, "mfc": "none"}
        for axes, cost, limit in zip(above, _costs(row), limits, strict=True):
            if row.notes:
                marker = MARKERS[one.domain] if cost < limit else ">"
                axes.plot(min(cost, limit), one.order + _lift(one.domain), marker=marker, **style)
    for domain, order in ((domain, order) for domain in MARKERS for order in orders):
        line = [row for row in rows if (row.combination.domain, row.combination.order) == (domain, order)]
        _draw_line(below, [row for row in line if not row.notes], colour[order], domain)
    _furnish(above, below, settings)
    keys = [Line2D([], [], color=colour[order], label=f"order {order}") for order in orders]
    keys += [
        Line2D([], [], color="0.3", marker="o", label="domain tight"),
        Line2D([], [], color="0.3", marker="s", linestyle="--", label="domain box (the paper's)"),
        Line2D([], [], color="0.3", marker="o", mfc="none", linestyle="", label="predicted, not run"),
        Line2D([], [], color="0.3", marker=">", mfc="none", linestyle="", label=f"over {BEYOND:g} times the limit"),
        Line2D([], [], color="0.4", linestyle=":", label="limit"),
    ]
    figure.legend(handles=keys, loc="outside lower center", ncols=6, frameon=False, fontsize=9)
    return figure


def _lift(domain: str) -> float:
    return 0.17 if domain == "box" else -0.17


def _furnish(above: Sequence[Axes], below: Sequence[Axes], settings: Settings) -> None:
    by_time, by_memory, by_mesh = below
    for axes in (above[0], by_time):
        axes.axvline(settings.study_seconds, color="0.4", linestyle=":")
    for axes in (above[1], by_memory):
        axes.axvline(settings.study_bytes / 2**30, color="0.4", linestyle=":")
    for axes in (above[2], by_mesh):
        axes.axvspan(6, 10, color="0.88", zorder=0)
    words, place = "the paper's\nλ/6 to λ/10", by_mesh.get_xaxis_transform()
    by_mesh.text(7.75, 0.98, words, transform=place, ha="center", va="top", fontsize=9)
    by_time.set(xscale="log", yscale="log", xlabel="time [s]", ylabel="error at the transducers")
    by_time.set_yticks([0.003, 0.01, 0.03, 0.1, 0.3, 1.0])
    by_time.yaxis.set_major_formatter(FuncFormatter(lambda error, _: f"{100 * error:g} %"))
    for axes in below:
        axes.grid(axis="y", color="0.92")
        axes.set_axisbelow(True)
    by_memory.set(xscale="log", xlabel="memory of the process [GiB]")
    by_mesh.set(xscale="log", xlabel="elements per wavelength")
    by_mesh.set_xticks(settings.study_sizes, [f"{size:g}" for size in settings.study_sizes])
    by_mesh.minorticks_off()
    above[0].set(ylabel="not run:\norder", yticks=settings.study_orders)


def _draw_line(columns: Sequence[Axes], line: Sequence[Row], colour: object, domain: str) -> None:
    line = sorted(line, key=lambda row: row.combination.elements_per_wavelength)
    error = [min(row.error, WORST) for row in line]
    style = {"color": colour, "marker": MARKERS[domain], "markersize": 4.5, "linewidth": 1}
    for axes, cost in zip(columns, zip(*map(_costs, line), strict=True), strict=False):
        axes.plot(cost, error, linestyle="-" if domain == "tight" else "--", **style)


def _costs(row: Row) -> tuple[float, float, float]:
    """Seconds, GiB, and elements per wavelength."""
    return row.seconds, row.most_bytes / 2**30, row.combination.elements_per_wavelength
