"""One part of an experiment: what the page shows of it, and the numbers behind each figure as files."""

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int64

from airtact.atomic import whole_file

Column = Float64[np.ndarray, "rows"] | Int64[np.ndarray, "rows"] | list[str]
"""Numbers or words, one for each row."""


@dataclass(frozen=True)
class Part:
    """What a part of the experiment adds to the page.

    Attributes
    ----------
    title : its heading.
    pieces : HTML made by ``pages.page``.
    facts : (number, what it is), for the head of the page.
    """

    title: str
    pieces: tuple[str, ...]
    facts: tuple[tuple[str, str], ...] = ()


def write_columns(folder: Path, name: str, columns: Mapping[str, tuple[str, Column]]) -> None:
    """Write columns of one length as ``name.csv`` and ``name.h5``."""
    import h5py

    heads = [f"{column}_{unit}" if unit else column for column, (unit, _) in columns.items()]
    with whole_file(folder / f"{name}.csv") as partial, partial.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(heads)
        for row in zip(*(values for _, values in columns.values()), strict=True):
            writer.writerow([cell if isinstance(cell, str) else f"{cell:.7g}" for cell in row])
    with whole_file(folder / f"{name}.h5") as partial, h5py.File(partial, "w") as file:
        for column, (unit, values) in columns.items():
            file.create_dataset(column, data=values).attrs["unit"] = unit


def places(points: Float64[np.ndarray, "rows 3"]) -> dict[str, tuple[str, Column]]:
    """Columns x, y and z of points (P, 3) [m]."""
    return {axis: ("m", np.ascontiguousarray(points[:, index])) for index, axis in enumerate("xyz")}
