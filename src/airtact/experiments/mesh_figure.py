"""Error against time, memory and mesh, over orders and both domains."""

from collections.abc import Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from airtact.experiments.mesh_run import Row
from airtact.experiments.settings import Settings

MARKERS = {"tight": "o", "box": "s"}
"""Of the domains."""

NOT_RUN = 3.0
"""Error at which combinations that were not run are drawn."""


def draw_costs(rows: Sequence[Row], settings: Settings) -> Figure:
    """Draw every combination three times.

    Parameters
    ----------
    rows : what was run and what was not.
    settings : the limits.
    """
    figure = Figure(figsize=(12.0, 5.2), layout="constrained")
    by_time, by_memory, by_mesh = figure.subplots(1, 3, sharey=True)
    colour = dict(
        zip(settings.study_orders, colormaps["viridis"](np.linspace(0, 0.92, len(settings.study_orders))), strict=True)
    )
    for domain, order in ((domain, order) for domain in MARKERS for order in settings.study_orders):
        line = [row for row in rows if row.combination.domain == domain and row.combination.order == order]
        for axes, cost in (
            (by_time, [row.seconds for row in line]),
            (by_memory, [row.most_bytes / 2**30 for row in line]),
            (by_mesh, [row.combination.elements_per_wavelength for row in line]),
        ):
            _draw_line(axes, cost, line, colour[order], domain)
    by_time.axvline(settings.study_seconds, color="0.4", linestyle=":")
    by_memory.axvline(settings.study_bytes / 2**30, color="0.4", linestyle=":")
    by_mesh.axvspan(6, 10, color="0.88", zorder=0)
    by_mesh.text(7.75, 0.02, "the paper's\nrule", transform=by_mesh.get_xaxis_transform(), ha="center", fontsize=9)
    by_time.set(xscale="log", yscale="log", xlabel="time [s]", ylabel="error at the transducers")
    by_memory.set(xscale="log", xlabel="memory of the process [GiB]")
    by_mesh.set(xscale="log", xlabel="elements per wavelength")
    by_mesh.set_xticks(settings.study_sizes, [f"{size:g}" for size in settings.study_sizes])
    by_mesh.minorticks_off()
    keys = [Line2D([], [], color=colour[order], label=f"order {order}") for order in settings.study_orders]
    keys += [Line2D([], [], color="0.3", marker=sign, label=f"domain {name}") for name, sign in MARKERS.items()]
    keys.append(Line2D([], [], color="0.3", marker="o", mfc="none", linestyle="", label="predicted, not run"))
    figure.legend(handles=keys, loc="outside lower center", ncols=len(keys) // 2 + 1, frameon=False, fontsize=9)
    return figure


def _draw_line(axes: Axes, cost: list[float], line: Sequence[Row], colour: object, domain: str) -> None:
    ran = [not row.said for row in line]
    pairs = sorted((spent, row.error) for spent, row, done in zip(cost, line, ran, strict=True) if done)
    style = {"color": colour, "marker": MARKERS[domain], "markersize": 4.5}
    if pairs:
        axes.plot(*zip(*pairs, strict=True), linestyle="-" if domain == "tight" else "--", linewidth=1, **style)
    left = [spent for spent, done in zip(cost, ran, strict=True) if not done]
    height = NOT_RUN if domain == "tight" else 1.35 * NOT_RUN
    axes.plot(left, [height] * len(left), linestyle="", mfc="none", **style)
