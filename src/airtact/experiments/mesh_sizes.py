"""The paper's future work 1: error against time and memory over order and mesh size, in both domains."""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
from jaxtyping import Complex128
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter

from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.experiments.dummies import dummies
from airtact.experiments.mesh_run import Combination, Ran, Row, predicted, run_apart, tetrahedra
from airtact.experiments.part import Part, write_columns
from airtact.experiments.settings import Settings
from airtact.reports.page import paragraph, picture, table
from airtact.timing import Clock
from airtact.transducers.element import monopole
from airtact.transducers.layout import surrounding_box

GOOD = 0.02
"""Error that suffices for a drive and for the prediction of its pressure."""

WAITS, OVER_LIMIT, NO_TIME = "waits for its turn", "predicted over the limit", "no time left for it"
"""Why a combination was not run."""

OVERDUE, STARTING = 2.0, 30.0
"""A combination is stopped after so many times its limit of seconds, plus the seconds for its process to start."""

MARKERS = {"tight": "o", "box": "s"}
"""Of the domains."""

WORST = 3.0
"""Errors above this are drawn at it."""

BEYOND = 30.0
"""Costs of more than so many times the limit are drawn there, as an arrow."""


def mesh_sizes(settings: Settings, folder: Path, clock: Clock) -> Part:
    """Run what is cheap enough and predict the rest."""
    words = f"solving by boundary elements to {100 * settings.reference:g} %, the reference of the study"
    with clock.step("reference", words):
        reference, uncertain = _reference(settings.reference)
    rows = study(settings, reference, clock, run_apart, lambda found: _write(found, folder))
    _write(rows, folder)
    ran = [row for row in rows if not row.notes]
    best, facts = _best(ran)
    pieces = (
        paragraph(
            "The paper takes a mesh of λ/6 to λ/10 from a rule and asks which mesh, model and solver are best. "
            f"{how_many(rows, settings)} The error is that of the beacons' pressure at the {len(reference)} "
            f"transducers, against boundary elements (which are known to about {100 * uncertain:.1f} %, so errors "
            "below that are not resolved). Domain tight: a box round the fingers, read by the surface integral; box: "
            "the whole workspace, read off the mesh as the paper does. Memory is that of the whole process. Each "
            "combination has one order everywhere; FiniteElement itself grades the order by the size of each "
            "tetrahedron, which costs less (the parts above)."
        ),
        paragraph(best),
        picture(
            draw_costs(rows, settings),
            "Below, what was run: error against time, against memory, and against the mesh; above, what was predicted "
            "and not run, a row for each order. The grey band is the paper's rule of λ/6 to λ/10. data/mesh_sizes",
            "error over cost for orders and meshes",
        ),
        table(
            ["domain", "order", "mesh", "unknowns", "time", "memory", "error"],
            [_cells(row) for row in rows],
            "Every combination; ~ marks what was predicted and not run.",
        ),
    )
    return Part("Mesh and order (future work 1)", pieces, facts)


def how_many(rows: Sequence[Row], settings: Settings) -> str:
    """Write how many were run, and why the others were not."""
    ran, over, cut = (
        sum(row.notes == words for row in rows) for words in ("", OVER_LIMIT, NO_TIME)
    )
    sentences = [
        f"{ran} of {len(rows)} combinations of order, mesh and domain were run, each in its own process, the cheapest "
        "first; from what they took the next are predicted.",
        f"{over} are predicted to take more than {settings.study_seconds:g} s or "
        f"{settings.study_bytes / 2**30:g} GiB and were not run.",
    ]
    if cut:
        sentences.append(
            f"{cut} within those limits were not run because the study as a whole is given "
            f"{settings.study_budget:g} s: an idle machine runs more of them."
        )
    if ran + over + cut < len(rows):
        sentences.append(
            f"{len(rows) - ran - over - cut} begun did not end well; the table says why."
        )
    return " ".join([*sentences, "What was not run is drawn hollow, at its predicted cost."])


def _best(ran: Sequence[Row]) -> tuple[str, tuple[tuple[str, str], ...]]:
    """Return the sentence and the fact about the fastest run to 2 %, or else the most accurate one."""
    good = [row for row in ran if row.error <= GOOD] or sorted(ran, key=lambda row: row.error)[:1]
    if not good:
        return "None ran: the table says why.", ()
    best = min(good, key=lambda row: row.seconds)
    one, error = best.combination, f"{100 * best.error:.2g} %"
    sentence = (
        f"The fastest to {100 * GOOD:g} % (or the most accurate, where none is): order {one.order} at "
        f"λ/{one.elements_per_wavelength:g}, domain {one.domain}: {error} in {best.seconds:.1f} s and "
        f"{best.most_bytes / 2**30:.2f} GiB."
    )
    return sentence, ((f"{best.seconds:.1f} s", f"finite elements to {error}, order {one.order}"),)


def _reference(accuracy: float) -> tuple[Complex128[np.ndarray, "elements"], float]:
    """Pressure of the beacons at the transducers (E,), and its relative distance from a coarser solution."""
    fingers, positions = dummies(), surrounding_box(monopole()).positions
    received = [
        BoundaryElement(accuracy=one).radiate(fingers.scene, fingers.beacon).at(positions)[:, 0]
        for one in (accuracy, 2 * accuracy)
    ]
    return received[0], relative_error(received[1], received[0])


def relative_error(
    found: Complex128[np.ndarray, "elements"], true: Complex128[np.ndarray, "elements"]
) -> float:
    """‖found − true‖ / ‖true‖."""
    return float(np.linalg.norm(found - true) / np.linalg.norm(true))


def study(
    settings: Settings,
    reference: Complex128[np.ndarray, "elements"],
    clock: Clock,
    run: Callable[[Combination, float], Ran | str],
    keep: Callable[[list[Row]], None] = lambda rows: None,
) -> list[Row]:
    """Run the cheapest combination that is left, update the predictions, and continue while one is within the limits.

    ``run`` stops a combination after so many seconds; ``keep`` gets all rows after each run.
    """
    left = [
        Combination(order, size, domain)
        for domain, order, size in product(
            ("tight", "box"), settings.study_orders, settings.study_sizes
        )
    ]
    begun, rows = time.perf_counter(), []
    while left:
        ran = [row for row in rows if not row.notes]
        spent = time.perf_counter() - begun if rows else 0.0  # at least one is tried
        waiting = [_unrun(one, ran, spent, settings) for one in left]
        keep(_in_order([*rows, *waiting]))
        fitting = [row for row in waiting if row.notes == WAITS]
        if not fitting:
            rows += waiting
            break
        next_one = min(fitting, key=lambda row: row.seconds)
        left.remove(next_one.combination)
        rows.append(_run(next_one, reference, clock, settings, run))
    return _in_order(rows)


def _in_order(rows: Sequence[Row]) -> list[Row]:
    return sorted(
        rows, key=lambda row: (row.combination.domain, row.combination.order, row.unknowns)
    )


def _unrun(one: Combination, ran: Sequence[Row], spent: float, settings: Settings) -> Row:
    """Predict a combination, and note what it waits for."""
    unknowns, seconds, most = predicted(one, ran)
    notes = WAITS
    if seconds > settings.study_seconds or most > settings.study_bytes:
        notes = OVER_LIMIT
    elif spent and spent + seconds > settings.study_budget:
        notes = NO_TIME
    return Row(one, tetrahedra(one, ran), unknowns, seconds, most, float("nan"), notes)


def _run(
    expected: Row,
    reference: Complex128[np.ndarray, "elements"],
    clock: Clock,
    settings: Settings,
    run: Callable[[Combination, float], Ran | str],
) -> Row:
    one = expected.combination
    words = f"order {one.order} at λ/{one.elements_per_wavelength:g}, {one.domain} domain"
    with clock.step(words, f"finite elements of {words} (about {expected.seconds:.0f} s)"):
        ran = run(one, OVERDUE * settings.study_seconds + STARTING)
    if isinstance(ran, str):
        return replace(expected, notes=ran)
    error = relative_error(ran.received, reference)
    return Row(one, ran.tetrahedra, ran.unknowns, ran.seconds, ran.most_bytes, error, "")


def _cells(row: Row) -> list[str]:
    sign = "~" if row.notes else ""
    one = row.combination
    return [
        one.domain,
        str(one.order),
        f"λ/{one.elements_per_wavelength:g}",
        f"{sign}{row.unknowns:,.0f}",
        f"{sign}{row.seconds:.3g} s",
        f"{sign}{row.most_bytes / 2**30:.2g} GiB",
        f"not run: {row.notes}" if row.notes else f"{100 * row.error:.2f} %",
    ]


def _write(rows: Sequence[Row], folder: Path) -> None:
    columns = {
        "domain": ("", [row.combination.domain for row in rows]),
        "order": ("", [row.combination.order for row in rows]),
        "elements_per_wavelength": ("", [row.combination.elements_per_wavelength for row in rows]),
        "tetrahedra": ("", [float(row.tetrahedra) for row in rows]),
        "unknowns": ("", [float(row.unknowns) for row in rows]),
        "time": ("s", [row.seconds for row in rows]),
        "memory": ("B", [float(row.most_bytes) for row in rows]),
        "error": ("", [row.error for row in rows]),
        "notes": ("", [row.notes or "run" for row in rows]),
    }
    write_columns(folder, "mesh_sizes", columns)


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
        line = [
            row
            for row in rows
            if (row.combination.domain, row.combination.order) == (domain, order)
        ]
        _draw_line(below, [row for row in line if not row.notes], colour[order], domain)
    _furnish(above, below, settings)
    keys = [Line2D([], [], color=colour[order], label=f"order {order}") for order in orders]
    keys += [
        Line2D([], [], color="0.3", marker="o", label="domain tight"),
        Line2D([], [], color="0.3", marker="s", linestyle="--", label="domain box (the paper's)"),
        Line2D(
            [], [], color="0.3", marker="o", mfc="none", linestyle="", label="predicted, not run"
        ),
        Line2D(
            [],
            [],
            color="0.3",
            marker=">",
            mfc="none",
            linestyle="",
            label=f"over {BEYOND:g} times the limit",
        ),
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
