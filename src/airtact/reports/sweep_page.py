"""The page of a sweep: what was varied, what the foci got, which points failed and why."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from airtact.checks import counted
from airtact.evaluation.metrics import NOT_MODELLED
from airtact.files.atomic import whole_file
from airtact.reports.page import (
    folded,
    heading,
    key_numbers,
    page_from,
    paragraph,
    picture,
    section,
    table,
)
from airtact.reports.plots import draw_varied

Row = dict[str, str | float | int | bool | None]

MOST_ROWS = 200
"""Rows that the page lists; the table of the sweep has all."""

SHOWN = {
    "weakest_Pa": "peak pressure of the weakest focus [Pa]",
    "gain": "weakest focus, over a drive that ignores the bodies",
}


@dataclass(frozen=True, eq=False)
class Swept:
    """What a sweep found.

    Attributes
    ----------
    title : name of the scene.
    text : the scene file.
    varied : columns of the points.
    rows : of the points in their order, values and results.
    """

    title: str
    text: str
    varied: tuple[str, ...]
    rows: Sequence[Row]

    @property
    def failed(self) -> list[Row]:
        """Rows of points that failed."""
        return [row for row in self.rows if row["error"]]

    def numbers(self, column: str) -> Float64[np.ndarray, "points"]:
        """Return a column; NaN where a row has no number there."""
        values = [row.get(column) for row in self.rows]
        return np.array([float(one) if isinstance(one, int | float) else np.nan for one in values])


def write_sweep_page(path: Path, found: Swept) -> None:
    """Write the page; it appears only once it is finished."""
    with whole_file(path) as partial:
        title = f"airtact: sweep of {found.title}"
        partial.write_text(
            page_from("page.html.j2", title=title, pieces=list(_pieces(found))), "utf-8"
        )


def _pieces(found: Swept) -> list[Any]:
    weakest = found.numbers("weakest_Pa")
    gain = found.numbers("gain")
    facts = [(f"{len(found.rows):,}", "points"), (f"{len(found.failed):,}", "of them failed")]
    if np.isfinite(weakest).any():
        facts.append((f"{np.nanmedian(weakest):,.0f} Pa", "at the weakest focus, median"))
    if np.isfinite(gain).any():
        facts.append((f"{np.nanmedian(gain):.2f}", "times a drive that ignores the bodies, median"))
    return [
        heading(f"{found.title}: sweep"),
        paragraph(f"Varied: {', '.join(found.varied)}.", "lead"),
        key_numbers(facts),
        *_pictures(found),
        *_faults(found),
        section("The points"),
        _listed(found),
        section("How this was computed"),
        paragraph(
            "Pressures are those of the solution that each drive is made from, with its own estimate of the error; "
            f"airtact render verifies a drive by another solution. {NOT_MODELLED}"
        ),
        folded("The scene file", found.text),
    ]


def _pictures(found: Swept) -> list[Any]:
    pieces = []
    for column, words in SHOWN.items():
        values = found.numbers(column)
        axes = {name: found.numbers(name) for name in found.varied}
        axes = {
            name: one
            for name, one in axes.items()
            if np.isfinite(one).any() and np.nanmin(one) < np.nanmax(one)
        }
        if axes and np.isfinite(values).any():
            words_of_axes = ", ".join(axes)
            drawn = draw_varied(axes, values, words)
            caption = f"The {words} against {words_of_axes}; the line is the median of points with the same value."
            spread = f"{words} from {np.nanmin(values):.4g} to {np.nanmax(values):.4g} against {words_of_axes}"
            pieces.append(picture(drawn, caption, spread, wide=len(axes) > 2))
    return pieces


def _faults(found: Swept) -> list[Any]:
    if not found.failed:
        return []
    counts = Counter(str(row["error"]) for row in found.failed)
    first = {str(row["error"]): str(row["sentence"]) for row in reversed(found.failed)}
    rows = [[code, str(number), first[code]] for code, number in counts.most_common()]
    return [
        section("What failed"),
        table(["code", "points", "the first sentence"], rows, text=True),
    ]


def _listed(found: Swept) -> Any:
    columns = dict.fromkeys(
        name for row in found.rows for name in row if name not in ("sentence", "warnings")
    )
    rows = [[_words(row.get(name)) for name in columns] for row in found.rows[:MOST_ROWS]]
    more = len(found.rows) - MOST_ROWS
    caption = (
        f"The first {MOST_ROWS}; sweep.csv has {counted(more, 'more', 'more')}." if more > 0 else ""
    )
    return table(list(columns), rows, caption)


def _words(value: str | float | None) -> str:
    if value is None:
        return ""
    return f"{value:.5g}" if isinstance(value, float) else str(value)
