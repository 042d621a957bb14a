"""The page of a sweep: varied values, pressures at the foci, and failed points."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64
from markupsafe import Markup

from airtact.errors import as_sentence
from airtact.evaluation.metrics import NOT_MODELLED
from airtact.reports.page import picture, write_page
from airtact.reports.plots import draw_varied

Row = dict[str, str | float | int | bool | None]

GAIN = "pressure at the weakest focus, relative to a drive that ignores the bodies"


@dataclass(frozen=True, eq=False)
class Swept:
    """Results of a sweep of values in a scene file.

    Attributes
    ----------
    title : name of the scene.
    text : text of the scene file.
    varied : names of the columns that were varied.
    rows : values and results of all points, in order.
    """

    title: str
    text: str
    varied: tuple[str, ...]
    rows: Sequence[Row]

    @property
    def failed(self) -> list[Row]:
        """Rows of the points that failed."""
        return [row for row in self.rows if row["error"]]

    def numbers(self, column: str) -> Float64[np.ndarray, "points"]:
        """Return the numbers in a column, with NaN for rows without a number."""
        values = [row.get(column) for row in self.rows]
        return np.array([v if isinstance(v, int | float) else np.nan for v in values], dtype=float)

    def label(self, column: str) -> str:
        """Return the label of a column on the page; varied keys are shown with their path."""
        if column in self.varied:
            return column
        name = column.removesuffix("_Pa").replace("_", " ")
        return f"{name} [Pa]" if column.endswith("_Pa") else name


def write_sweep_page(path: Path, swept: Swept) -> None:
    """Write the page of a sweep, replacing an existing file."""
    weakest = swept.numbers("weakest_Pa")
    gain = swept.numbers("gain")
    facts = [(f"{len(swept.rows):,}", "points"), (f"{len(swept.failed):,}", "failed points")]
    if np.isfinite(weakest).any():
        facts.append((f"{np.nanmedian(weakest):,.0f} Pa", "median pressure at the weakest focus"))
    if np.isfinite(gain).any():
        facts.append((f"{np.nanmedian(gain):.2f}", f"median {GAIN}"))
    counts = Counter(str(row["error"]) for row in swept.failed)
    # Go through the rows in reverse, so that the first sentence for each code is kept.
    first = {str(row["error"]): str(row["sentence"]) for row in reversed(swept.failed)}
    hidden = {"sentence", "warnings", *(() if swept.failed else ("error",))}
    columns = dict.fromkeys(name for row in swept.rows for name in row if name not in hidden)
    # List 200 points; sweep.csv contains all of them.
    listed = swept.rows[:200]
    more = len(swept.rows) - len(listed)
    write_page(
        path,
        "sweep.html.j2",
        title=f"airtact: sweep of {swept.title}",
        swept=swept,
        facts=facts,
        pictures=[
            *_pictures(swept, weakest, "peak pressure at the weakest focus [Pa]"),
            *_pictures(swept, gain, GAIN),
        ],
        faults=[[code, str(number), first[code]] for code, number in counts.most_common()],
        columns=[swept.label(name) for name in columns],
        cells=[[_words(row.get(name)) for name in columns] for row in listed],
        caption=f"The first {len(listed)} points; sweep.csv has {more:,} more." if more else "",
        not_modelled=NOT_MODELLED,
    )


def _pictures(swept: Swept, values: Float64[np.ndarray, "points"], quantity: str) -> list[Markup]:
    columns = {name: swept.numbers(name) for name in swept.varied}
    axes = {
        name: numbers
        for name, numbers in columns.items()
        if np.isfinite(numbers).any() and np.nanmin(numbers) < np.nanmax(numbers)
    }
    if not axes or not np.isfinite(values).any():
        return []
    names = ", ".join(axes)
    return [
        picture(
            draw_varied(axes, values, quantity),
            f"{as_sentence(f'{quantity} against {names}')} The line is the median of the points "
            "with the same value.",
            f"{quantity} from {np.nanmin(values):.4g} to {np.nanmax(values):.4g} against {names}",
            wide=len(axes) > 2,
        )
    ]


def _words(value: str | float | None) -> str:
    if value is None:
        return ""
    return f"{value:.5g}" if isinstance(value, float) else str(value)
