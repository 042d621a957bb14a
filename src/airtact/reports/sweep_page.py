"""The page of a sweep: varied values, pressures at the foci, and failed points."""

import re
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

LENGTHS = (
    *("gap", "offset", "radius", "translation", "centre", "point", "start", "end", "edge"),
    *("spacing", "height", "width", "scale", "largest_hole", "piston_radius", "size"),
    *("position", "own_position", "board_position", "along_skin"),
)
"""Keys of a scene file that hold a length; the page shows them in millimetres."""

UNITS = {
    **dict.fromkeys(("degrees", "sharp_degrees", "within", "phase"), "°"),
    **dict.fromkeys(("rotation", "own_rotation", "board_rotation"), "°"),
    **dict.fromkeys(("celsius", "temperature"), "°C"),
    **dict.fromkeys(("pressure", "pressures"), "Pa"),
    "frequency": "Hz",
    "sound_speed": "m/s",
    "velocity": "m/s",
    "density": "kg/m³",
    "absorption": "Np/m",
    "age": "s",
    "sensitivity": "Pa·m",
}
"""Units of other keys. Keys without a unit hold a share or a number."""


GAIN = "pressure at the weakest focus, relative to a drive that ignores the bodies"


@dataclass(frozen=True, eq=False)
class Swept:
    """The result of a sweep.

    Attributes
    ----------
    title : name of the scene.
    text : text of the scene file.
    varied : columns that were varied.
    rows : values and results of the points in order.
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
        """Return a column; NaN where a row has no number."""
        values = [row.get(column) for row in self.rows]
        return np.array([v if isinstance(v, int | float) else np.nan for v in values], dtype=float)

    def unit(self, column: str) -> str:
        """Return the unit of a column on the page; empty if it has none."""
        if column == "estimated_error":
            return "%"
        if column not in self.varied:
            return "Pa" if column.endswith("_Pa") else ""
        key = re.sub(r"[\[\]\d]+$", "", column.split(".")[-1])
        return "mm" if key in LENGTHS else UNITS.get(key, "")

    def label(self, column: str) -> str:
        """Return the name of a column with its unit."""
        unit = self.unit(column)
        name = column.removesuffix("_Pa").replace("_", " ") if column not in self.varied else column
        return f"{name} [{unit}]" if unit else name

    def factor(self, column: str) -> float:
        """Return the factor from the values of a column to its unit on the page."""
        return {"mm": 1e3, "%": 100.0}.get(self.unit(column), 1.0)


def write_sweep_page(path: Path, swept: Swept) -> None:
    """Write the page; the file appears only when it is complete."""
    weakest = swept.numbers("weakest_Pa")
    gain = swept.numbers("gain")
    facts = [(f"{len(swept.rows):,}", "points"), (f"{len(swept.failed):,}", "of them failed")]
    if np.isfinite(weakest).any():
        facts.append((f"{np.nanmedian(weakest):,.0f} Pa", "at the weakest focus, median"))
    if np.isfinite(gain).any():
        facts.append((f"{np.nanmedian(gain):.2f}", f"{GAIN}, median"))
    counts = Counter(str(row["error"]) for row in swept.failed)
    # Reversed, so that the first sentence of each code is kept.
    first = {str(row["error"]): str(row["sentence"]) for row in reversed(swept.failed)}
    hidden = {"sentence", "warnings", *(() if swept.failed else ("error",))}
    columns = dict.fromkeys(name for row in swept.rows for name in row if name not in hidden)
    # sweep.csv has all points.
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
        cells=[[_words(row.get(name), swept.factor(name)) for name in columns] for row in listed],
        caption=f"The first {len(listed)} points. sweep.csv has {more:,} more." if more else "",
        not_modelled=NOT_MODELLED,
    )


def _pictures(swept: Swept, values: Float64[np.ndarray, "points"], quantity: str) -> list[Markup]:
    """Draw a quantity against the columns that differ between points."""
    columns = {swept.label(name): swept.factor(name) * swept.numbers(name) for name in swept.varied}
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


def _words(value: str | float | None, factor: float) -> str:
    if value is None:
        return ""
    return f"{factor * value:.5g}" if isinstance(value, float) else str(value)
