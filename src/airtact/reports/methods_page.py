"""The page that compares all methods: a table, bars with the bound, and pictures of the fields."""

from pathlib import Path
from typing import Any

import numpy as np

from airtact.errors import counted
from airtact.evaluation.metrics import not_modelled
from airtact.evaluation.slices import window_pressure
from airtact.evaluation.windows import plane_of_scene
from airtact.reports.field_figure import Cut, draw_field, solid_depth
from airtact.reports.page import picture, write_page
from airtact.reports.plots import draw_bars
from airtact.reports.viewer import scene_view, viewer_values
from airtact.setup.comparing import MethodComparison
from airtact.timing import Clock, Progress, duration


def write_methods_page(
    contest: MethodComparison, folder: Path, progress: Progress
) -> tuple[Path, ...]:
    """Write methods.html, which compares all methods, to a folder."""
    clock = Clock(progress)
    setup = contest.setup
    emitted = {contender.name: contender.emitted for contender in contest.contenders}
    page = folder / "methods.html"
    with clock.step("cuts", "computing the fields in the pictures"):
        window = plane_of_scene(setup.scene, setup.target.points)
        depth = solid_depth(setup.scene, window.points)
        pictured = window_pressure(contest.field.for_pictures, window, depth)
        cut = Cut(window, dict(zip(emitted, pictured.T, strict=True)), depth)
    with clock.step("3-D scene", "computing the fields in the 3-D scene"):
        view = scene_view(
            setup,
            contest.field,
            contest.field.at(setup.target.points),
            emitted,
            scales=[1.0] * len(emitted),
            window=window,
            held_equal="the levels that they emit",
        )
    progress("drawing the page")
    best = contest.best
    names = [contender.name for contender in contest.equally_good]
    equal = ", ".join(name for name in names if name != best.name)
    standing = "produces the highest pressure at the weakest focus"
    if equal:
        standing = (
            f"and {equal} reach the highest share of the upper bound, equal to within "
            f"{contest.tolerance:.1%}"
        )
    unit = "Pa" if setup.target.shares is None else "Pa / requested share"
    if setup.target.pressures is not None:
        unit = "times the requested pressure"
    write_page(
        page,
        "methods.html.j2",
        title=f"airtact: methods for {setup.title}",
        contest=contest,
        drives=counted(len(contest.contenders), "drive", "drives"),
        foci=counted(len(setup.foci), "focus", "foci"),
        facts=[
            (best.name, standing),
            (_digits(contest.worst(best)), f"{unit} at the weakest focus"),
            (f"{contest.of_the_bound(best):.0%}", "of the upper bound, at full scale"),
            (duration(best.seconds), "to compute this drive"),
        ],
        warnings=contest.warnings,
        not_modelled=not_modelled(contest.report),
        steps=[
            [name, f"{time:.2f} s"] for name, time in {**contest.seconds, **clock.seconds}.items()
        ],
        **_tables(contest, unit),
        **_pictures(contest, unit, cut, view.peak, equal),
        # First compare the best drive with the control, which is the last one.
        space=viewer_values(view, (contest.contenders.index(best), len(emitted) - 1)),
    )
    return (page,)


def _digits(pressure: float) -> str:
    return f"{pressure:,.0f}" if pressure >= 1e3 else f"{pressure:.4g}"


def _tables(contest: MethodComparison, unit: str) -> dict[str, Any]:
    foci = contest.setup.foci
    requested = contest.setup.target.weights > 0.0
    rows = []
    for contender in contest.ranked:
        exact = np.abs(contest.transfer.pressure(contender.drive))[: len(foci)]
        rounded = np.abs(contest.transfer.pressure(contender.emitted))[: len(foci)]
        asked = contender.pressures[requested]
        row = [
            contest.label(contender),
            _digits(contest.worst(contender)),
            f"{contest.of_the_bound(contender):.0%}",
            f"{asked.mean():,.0f}",
            f"{asked.min() / asked.max():.2f}",
            f"{contender.energy:.2f}",
            f"{np.abs(rounded / exact - 1)[requested].max():.2%}",
            f"{1e3 * contender.seconds:.1f}",
        ]
        if len(contender.suppression_points):
            row.append(f"{contender.suppression_level:+z.1f}")
        if contender.kept is not None:
            row.append(f"{contender.kept:,.0f}")
        rows.append(row)
    header = ["method", f"weakest focus [{unit}]", "relative to the bound, at full scale"]
    header += ["mean [Pa]", "weakest / strongest", "energy", "rounding", "time [ms]"]
    if len(contest.setup.target.suppression_points):
        header.append("suppression points [dB]")
    if contest.contenders[0].kept is not None:
        header.append("reached in 9 of 10 uncertain cases [Pa]")
    return {
        "header": header,
        "rows": rows,
        "focus_header": ["peak pressure [Pa]", *foci],
        "focus_rows": [
            [contender.name, *(f"{pressure:,.0f}" for pressure in contender.pressures)]
            for contender in contest.ranked
        ],
    }


def _pictures(
    contest: MethodComparison, unit: str, cut: Cut, peak: float, equal: str
) -> dict[str, Any]:
    names = [contender.name for contender in contest.ranked]
    shares = np.array([contest.of_the_bound(contender) for contender in contest.ranked])
    strengths = shares * contest.bound
    bars = picture(
        draw_bars(names, strengths, contest.bound, f"weakest focus at full scale [{unit}]"),
        "Pressure at the weakest focus for each method, with the strongest transducer at full "
        "scale, and the upper bound.",
        f"Bar chart of the pressure at the weakest focus for each method, "
        f"{_digits(strengths.min())} to {_digits(strengths.max())}, with a line at the bound of "
        f"{_digits(contest.bound)}",
    )
    # Equally good methods produce nearly the same field, so they share one picture.
    drawn = [contest.best, *contest.ranked[len(contest.equally_good) :]]
    fields = [
        picture(
            draw_field(
                cut, contender.name, peak, contest.setup.target.points, contest.setup.labels
            ),
            f"{contender.name} (nearly the same: {equal})"
            if contender is contest.best and equal
            else contender.name,
            f"Pressure map for {contender.name}: {contender.pressures.min():,.0f} to "
            f"{contender.pressures.max():,.0f} Pa at the foci",
        )
        for contender in drawn
    ]
    return {"bars": bars, "fields": fields}
