"""One part of an experiment: its pieces of the page, the numbers of its figures as files, and pictures of planes."""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int64, Real
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from airtact.evaluation.windows import Window
from airtact.files.atomic import whole_file
from airtact.reports.field_figure import draw_values

Column = Float64[np.ndarray, "rows"] | Int64[np.ndarray, "rows"] | Sequence[str | float]
"""Numbers or words, one for each row."""


@dataclass(frozen=True)
class Part:
    """The heading and the pieces of one part, HTML made by ``pages.page``, and (number, label) for the page's head."""

    title: str
    pieces: tuple[str, ...]
    facts: tuple[tuple[str, str], ...] = ()


def write_columns(folder: Path, name: str, columns: Mapping[str, tuple[str, Column]]) -> None:
    """Write columns of one length, each a unit ("" for none) and values, as ``name.csv`` and ``name.h5``."""
    import h5py

    heads = [f"{column}_{unit}" if unit else column for column, (unit, _) in columns.items()]
    with (
        whole_file(folder / f"{name}.csv") as partial,
        partial.open("w", newline="", encoding="utf-8") as stream,
    ):
        writer = csv.writer(stream)
        writer.writerow(heads)
        for row in zip(*(values for _, values in columns.values()), strict=True):
            writer.writerow([cell if isinstance(cell, str) else f"{cell:.7g}" for cell in row])
    with whole_file(folder / f"{name}.h5") as partial, h5py.File(partial, "w") as file:
        for column, (unit, values) in columns.items():
            file.create_dataset(column, data=values).attrs["unit"] = unit


def coordinates(points: Float64[np.ndarray, "rows 3"]) -> dict[str, tuple[str, Column]]:
    """Columns x, y and z of points (P, 3) [m]."""
    return {axis: ("m", points[:, index]) for index, axis in enumerate("xyz")}


def corners(points: Float64[np.ndarray, "rows corners 3"]) -> dict[str, tuple[str, Column]]:
    """Columns x0, y0, z0, x1 and so on of the corners of cells (T, N, 3) [m]."""
    every = range(points.shape[1])
    return {
        f"{axis}{n}": ("m", points[:, n, index]) for n in every for index, axis in enumerate("xyz")
    }


def draw_planes(
    window: Window,
    values: Mapping[str, Real[np.ndarray, "points"]],
    outlines: Sequence[Float64[np.ndarray, "_ 3"]],
    marks: Real[np.ndarray, "marks 3"],
    scale: tuple[str, float, float, str],
) -> Figure:
    """Draw values (P,) at the points of a window, one picture for each title, NaN left blank.

    Outlines (N, 3) [m] of bodies are filled and marks (M, 3) [m] ringed; the scale has the name of
    the colours, the lowest and the highest value, and a label.
    """
    colours, lowest, highest, label = scale
    left, right, bottom, top = window.extent
    size = min(10.0 / len(values) / (right - left), 5.0 / (top - bottom), 5.0 / (right - left))
    wide, tall = (right - left) * size, (top - bottom) * size
    figure = Figure(figsize=(len(values) * (wide + 0.3) + 1.6, tall + 1.0), layout="constrained")
    axes = figure.subplots(1, len(values), squeeze=False, sharex=True, sharey=True)[0]
    shades = ScalarMappable(Normalize(lowest, highest), colours)
    for one, (title, shown) in zip(axes, values.items(), strict=True):
        draw_values(one, window, shown, shades, outlines)
        for colour, width in (("black", 2.6), ("white", 1.3)):
            one.plot(
                *window.seen(marks).T,
                "o",
                markersize=8,
                mfc="none",
                markeredgecolor=colour,
                mew=width,
            )
        one.set_title(title, fontsize=11)
        one.set_xlabel(window.labels[0])
    axes[0].set_ylabel(window.labels[1])
    figure.colorbar(shades, ax=list(axes), label=label, pad=0.015, aspect=28)
    return figure
