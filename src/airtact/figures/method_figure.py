"""Bars that hold methods against a bound."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64
from matplotlib.figure import Figure

BAR, BOUND = "#5a2a83", "#c2410c"


def draw_bars(names: Sequence[str], heights: Float64[np.ndarray, "names"], bound: float, label: str) -> Figure:
    """Draw one bar for each name, the longest on top, and a line at the bound.

    Parameters
    ----------
    names : what the bars are called.
    heights : (N,) how long they are, in the unit of the bound.
    bound : what none can pass.
    label : what is shown, with its unit.
    """
    order = np.argsort(heights)
    figure = Figure(figsize=(8.0, 0.34 * len(names) + 1.2), layout="constrained")
    axes = figure.subplots()
    bars = axes.barh([names[index] for index in order], heights[order], color=BAR, height=0.62)
    axes.bar_label(bars, [f"{heights[index] / bound:.0%}" for index in order], padding=4, fontsize=9)
    axes.axvline(bound, color=BOUND, linewidth=2, label="bound")
    axes.set(xlabel=label, xlim=(0.0, 1.12 * max(bound, float(heights.max()))))
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(loc="lower right", frameon=False)
    return figure
