"""The paper's future work 1: error against time and memory over order and mesh size, in both domains."""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
from jaxtyping import Complex128

from airtact.experiments.dummies import dummies
from airtact.experiments.mesh_costs import predicted, tetrahedra
from airtact.experiments.mesh_figure import draw_costs
from airtact.experiments.mesh_run import Combination, Ran, Row, run_apart
from airtact.experiments.part import Part, write_columns
from airtact.experiments.settings import Settings
from airtact.pages.page import paragraph, picture, table
from airtact.solvers.bem.solver import BoundaryElement
from airtact.timing import Clock
from airtact.transducers.layout import surrounding_box

GOOD = 0.02
"""Error that suffices for a drive and for the prediction of its pressure."""

WAITS, OVER_LIMIT, NO_TIME = "waits for its turn", "predicted over the limit", "no time left for it"
"""Why a combination was not run."""

OVERDUE, STARTING = 2.0, 30.0
"""A combination is stopped after so many times its limit of seconds, plus the seconds for its process to start."""


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
    ran, over, cut = (sum(row.notes == words for row in rows) for words in ("", OVER_LIMIT, NO_TIME))
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
        sentences.append(f"{len(rows) - ran - over - cut} begun did not end well; the table says why.")
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
    fingers, positions = dummies(), surrounding_box().positions
    received = [
        BoundaryElement(accuracy=one).radiate(fingers.scene, fingers.beacon).at(positions)[:, 0]
        for one in (accuracy, 2 * accuracy)
    ]
    return received[0], relative_error(received[1], received[0])


def relative_error(found: Complex128[np.ndarray, "elements"], true: Complex128[np.ndarray, "elements"]) -> float:
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
        for domain, order, size in product(("tight", "box"), settings.study_orders, settings.study_sizes)
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
    return sorted(rows, key=lambda row: (row.combination.domain, row.combination.order, row.unknowns))


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
