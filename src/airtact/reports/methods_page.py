"""The page that compares ways to make a drive: a table, bars against the bound, and each field on one scale."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from airtact.checks import counted
from airtact.evaluation.metrics import not_modelled
from airtact.files.atomic import whole_file
from airtact.reports.field_figure import Cut, draw_field
from airtact.reports.page import page_from, picture
from airtact.reports.plots import draw_bars
from airtact.reports.viewer import SceneView, viewer_values
from airtact.setup.comparing import MethodComparison


def write_methods_page(
    path: Path,
    contest: MethodComparison,
    cut: Cut,
    view: SceneView,
    seconds: Mapping[str, float],
) -> None:
    """Write the comparison of all methods as one self-contained HTML file.

    Parameters
    ----------
    cut : field of each drive in the plane of the foci.
    view : the scene in space, with the field of each drive.
    seconds : wall time by step [s].
    """
    shown = contest.contenders.index(contest.best), len(contest.contenders) - 1
    values = {
        **_summary(contest, seconds),
        **_tables(contest),
        **_pictures(contest, cut, view),
        "space": viewer_values(view, contest.setup.title, shown),
    }
    title = f"airtact: methods for {contest.setup.title}"
    with whole_file(path) as partial:
        partial.write_text(
            page_from("methods.html.j2", title=title, contest=contest, **values), "utf-8"
        )


def _summary(contest: MethodComparison, seconds: Mapping[str, float]) -> dict[str, Any]:
    best = contest.best
    return {
        "drives": counted(len(contest.contenders), "drive", "drives"),
        "foci": counted(len(contest.setup.foci), "focus", "foci"),
        "facts": [
            (best.name, "gives its worst focus most"),
            (_digits(contest.worst(best)), f"{_unit(contest)} at that focus"),
            (
                f"{contest.of_the_bound(best):.0%}",
                "of a bound that no drive exceeds, at full scale",
            ),
            (f"{1e3 * best.seconds:.3g} ms", "to make that drive"),
        ],
        "warnings": contest.warnings,
        "not_modelled": not_modelled(contest.report),
        "steps": [[name, f"{time:.2f} s"] for name, time in seconds.items()],
    }


def _unit(contest: MethodComparison) -> str:
    """Name the unit of a pressure over its weight."""
    if contest.setup.target.pressures is not None:
        return "times the pressure asked"
    return "Pa" if contest.setup.target.shares is None else "Pa over the share asked"


def _digits(pressure: float) -> str:
    """Write a pressure over its weight with four digits."""
    return f"{pressure:,.0f}" if pressure >= 1e3 else f"{pressure:.4g}"


def _tables(contest: MethodComparison) -> dict[str, Any]:
    rows = []
    for one in contest.ranked:
        exact, rounded = (
            np.abs(contest.transfer.pressure(drive))[: len(contest.setup.foci)]
            for drive in (one.drive, one.emitted)
        )
        rows.append(
            [
                contest.label(one),
                _digits(contest.worst(one)),
                f"{contest.of_the_bound(one):.0%}",
                f"{one.pressures.mean():,.0f}",
                f"{one.pressures.min() / one.pressures.max():.2f}",
                f"{one.energy:.2f}",
                f"{np.abs(rounded / exact - 1).max():.2%}",
                f"{1e3 * one.seconds:.3g}",
                *([f"{one.suppression_level:+.1f}"] if len(one.suppression_points) else []),
                *([] if one.kept is None else [f"{one.kept:,.0f}"]),
            ]
        )
    columns = ["mean [Pa]", "weakest / strongest", "energy", "rounding", "time [ms]"]
    suppressed = ["suppression points [dB]"] if len(contest.setup.target.suppression_points) else []
    doubted = (
        ["9 of 10 times, with what is in doubt [Pa]"]
        if contest.contenders[0].kept is not None
        else []
    )
    first = ["method", f"worst focus [{_unit(contest)}]", "at full scale, of the bound"]
    return {
        "header": [*first, *columns, *suppressed, *doubted],
        "rows": rows,
        "focus_header": ["peak pressure [Pa]", *contest.setup.foci],
        "focus_rows": [
            [one.name, *(f"{pressure:,.0f}" for pressure in one.pressures)]
            for one in contest.contenders
        ],
    }


def _pictures(contest: MethodComparison, cut: Cut, view: SceneView) -> dict[str, Any]:
    names = [one.name for one in contest.contenders]
    strengths = np.array([contest.of_the_bound(one) * contest.bound for one in contest.contenders])
    bars = picture(
        draw_bars(names, strengths, contest.bound, f"worst focus at full scale [{_unit(contest)}]"),
        "What the worst focus gets by each method with its strongest transducer at full scale, against the bound.",
        f"Bars of the pressure at the worst focus for each method, from {_digits(strengths.min())} to "
        f"{_digits(strengths.max())}, and a line at the bound of {_digits(contest.bound)}",
    )
    most = view.most
    points = contest.setup.target.points
    fields = [
        picture(
            draw_field(cut, one.name, most, points),
            one.name,
            f"Map of pressure by {one.name}: {one.pressures.min():,.0f} to {one.pressures.max():,.0f} Pa at the foci",
        )
        for one in contest.ranked
    ]
    return {"bars": bars, "fields": fields}
