"""The paper's future work 1: error against time and memory over order and mesh size, in both domains."""

import time
from collections.abc import Callable, Sequence
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
from jaxtyping import Complex128, Float64

from airtact.experiments.dummies import AIR, dummies
from airtact.experiments.mesh_figure import draw_costs
from airtact.experiments.mesh_run import BOX, Combination, Ran, Row, run_apart
from airtact.experiments.part import Part, write_columns
from airtact.experiments.settings import Settings
from airtact.judging import Clock
from airtact.report.page import paragraph, picture, table
from airtact.solvers.boundary_element import BoundaryElement
from airtact.solvers.finite_element import LAYER, MARGIN
from airtact.transducers.layout import surrounding_box

GOOD = 0.02
"""Error that is good enough for a drive and for the pressure it is predicted to make."""

TETRAHEDRA = 8.0
"""Tetrahedra in a cube whose edge is theirs, until a run has told."""

SLOWEST = 1.7
"""Power of the unknowns with which time is taken to grow: nested dissection of a mesh in space has 2 at most."""

HEAVIEST = 4.0 / 3.0
"""The same of memory."""

LIBRARIES = 0.35 * 2.0**30
"""Bytes that a process takes before it solves."""

FIRST = (2.5e5, 60.0, 6 * 2.0**30)
"""Unknowns, seconds and bytes from which the first runs are predicted."""


def mesh_sizes(settings: Settings, folder: Path, clock: Clock) -> Part:
    """Run what is cheap enough and predict the rest.

    Parameters
    ----------
    settings : what is studied, and its limits.
    folder : where the numbers go.
    clock : is told each step.
    """
    with clock.step("truth", f"solving by boundary elements to {100 * settings.truth:g} %, the truth of the study"):
        truth, uncertain = _truth(settings.truth)
    rows = study(settings, truth, clock, run_apart)
    _write(rows, folder)
    ran = [row for row in rows if not row.said]
    best, facts = _best(ran)
    pieces = (
        paragraph(
            f"The paper takes a mesh of λ/6 to λ/10 from a rule and asks which mesh, model and solver are best. "
            f"{len(ran)} of {len(rows)} combinations of order, mesh and domain were predicted to take less than "
            f"{settings.study_seconds:g} s and {settings.study_bytes / 2**30:g} GiB and were run, each in its own "
            f"process; the others are drawn hollow, at their predicted cost, and were not run. The error is that of "
            f"the beacons' pressure at the {len(truth)} transducers, against boundary elements (which are known to "
            f"about {100 * uncertain:.1f} %, so errors below that are not told apart)."
        ),
        paragraph(best),
        picture(
            draw_costs(rows, settings),
            "Error against time, against memory, and against the mesh; the grey band is the paper's rule of λ/6 to "
            "λ/10. Filled: run; hollow, on the upper edge: predicted, not run.",
            "error over cost for orders and meshes",
        ),
        table(
            ["domain", "order", "mesh", "unknowns", "time", "memory", "error"],
            [_cells(row) for row in rows],
            "Every combination; ~ marks what was predicted and not run.",
        ),
    )
    return Part("Mesh and order (future work 1)", pieces, facts)


def _best(ran: Sequence[Row]) -> tuple[str, tuple[tuple[str, str], ...]]:
    """Sentence and tile about the quickest run to 2 %, or else the most exact one."""
    good = [row for row in ran if row.error <= GOOD] or sorted(ran, key=lambda row: row.error)[:1]
    if not good:
        return "None ran: the table says why.", ()
    best = min(good, key=lambda row: row.seconds)
    one, error = best.combination, f"{100 * best.error:.2g} %"
    sentence = (
        f"The quickest to {100 * GOOD:g} % (or the most exact, where none is): order {one.order} at "
        f"λ/{one.elements_per_wavelength:g}, domain {one.domain}: {error} in {best.seconds:.1f} s and "
        f"{best.most_bytes / 2**30:.2f} GiB."
    )
    return sentence, ((f"{best.seconds:.1f} s", f"finite elements to {error}, order {one.order}"),)


def _truth(accuracy: float) -> tuple[Complex128[np.ndarray, "elements"], float]:
    """Beacons' pressure at the transducers, and how far a coarser solution lies from it."""
    fingers, positions = dummies(), surrounding_box().positions
    heard = [
        BoundaryElement(accuracy=one).radiate(fingers.rigid, fingers.beacon).at(positions)[:, 0]
        for one in (accuracy, 2 * accuracy)
    ]
    return heard[0], relative_error(heard[1], heard[0])


def relative_error(found: Complex128[np.ndarray, "elements"], true: Complex128[np.ndarray, "elements"]) -> float:
    """‖found − true‖ / ‖true‖."""
    return float(np.linalg.norm(found - true) / np.linalg.norm(true))


def study(
    settings: Settings,
    truth: Complex128[np.ndarray, "elements"],
    clock: Clock,
    run: Callable[[Combination, float], Ran | str],
) -> list[Row]:
    """Go through the combinations from the cheapest on, run those within the limits, and learn from each run.

    Parameters
    ----------
    settings : what is studied, and its limits.
    truth : (E,) pressure at the transducers [Pa].
    clock : is told each step.
    run : runs one.
    """
    combinations = [
        Combination(order, size, domain)
        for domain, order, size in product(("tight", "box"), settings.study_orders, settings.study_sizes)
    ]
    begun, rows = time.perf_counter(), []
    for one in sorted(combinations, key=expected_unknowns):
        unknowns, seconds, most = predicted(one, [row for row in rows if not row.said])
        said = ""
        quickest = min((row.seconds for row in rows if not row.said), default=0.0)
        if seconds - quickest > settings.study_seconds or most > settings.study_bytes:
            said = "predicted over the limit"
        elif any(not row.said for row in rows) and time.perf_counter() - begun > settings.study_budget:
            said = "no time left for it"
        else:
            words = f"order {one.order} at λ/{one.elements_per_wavelength:g}, {one.domain} domain"
            with clock.step(words, f"finite elements of {words} (about {seconds:.0f} s)"):
                ran = run(one, 5 * settings.study_seconds + 60)
            if isinstance(ran, Ran):
                error = relative_error(ran.heard, truth)
                rows.append(Row(one, ran.unknowns, ran.seconds, ran.most_bytes, error, ""))
                continue
            said = ran
        rows.append(Row(one, unknowns, seconds, most, float("nan"), said))
    return sorted(rows, key=lambda row: (row.combination.domain, row.combination.order, row.unknowns))


def expected_unknowns(one: Combination) -> float:
    """Unknowns that a quarter of the scene has, from its volume.

    Parameters
    ----------
    one : what is asked.
    """
    return TETRAHEDRA * _volume(one.domain) * (one.elements_per_wavelength * one.order) ** 3 / 6


@cache
def _volume(domain: str) -> float:
    """Volume of a quarter of what is meshed, the layer with it [λ³]."""
    length = AIR.wavelength(40e3)
    if domain == "box":
        sides = np.array([BOX[1][0], BOX[1][1], BOX[1][2] - BOX[0][2]]) / length
    else:
        points = np.concatenate([surface.vertices for surface in dummies().surfaces])
        sides = np.ptp(points, axis=0) / length / [2, 2, 1] + MARGIN * np.array([1, 1, 2])
    return float((sides + LAYER * np.array([1, 1, 2])).prod())


def predicted(one: Combination, ran: Sequence[Row]) -> tuple[float, float, float]:
    """Unknowns, seconds and bytes of a combination, from the largest run of its order, or else of its mesh.

    Parameters
    ----------
    one : what is asked.
    ran : what was run; the time and memory of the smallest are taken to be spent whatever the mesh.
    """
    expected = expected_unknowns(one)
    always = min((row.seconds for row in ran), default=0.0)
    libraries = min((row.most_bytes for row in ran), default=LIBRARIES)
    alike = [row for row in ran if row.combination.order == one.order and row.combination.domain == one.domain]
    same_mesh = (one.elements_per_wavelength, one.domain)
    alike = alike or [
        row for row in ran if (row.combination.elements_per_wavelength, row.combination.domain) == same_mesh
    ]
    unknowns, seconds, most = FIRST
    if alike:
        largest = max(alike, key=lambda row: row.unknowns)
        expected *= largest.unknowns / expected_unknowns(largest.combination)
        if largest.unknowns > 0.02 * expected:  # a run of a moment tells nothing of one of minutes
            unknowns, seconds, most = largest.unknowns, max(largest.seconds, 1.2 * always), largest.most_bytes
    growth = expected / unknowns
    return (
        expected,
        always + max(seconds - always, 0.0) * growth**SLOWEST,
        libraries + max(most - libraries, 0.0) * growth**HEAVIEST,
    )


def _cells(row: Row) -> list[str]:
    sign = "~" if row.said else ""
    one = row.combination
    return [
        one.domain,
        str(one.order),
        f"λ/{one.elements_per_wavelength:g}",
        f"{sign}{row.unknowns:,.0f}",
        f"{sign}{row.seconds:.3g} s",
        f"{sign}{row.most_bytes / 2**30:.2g} GiB",
        f"not run: {row.said}" if row.said else f"{100 * row.error:.2f} %",
    ]


def _write(rows: Sequence[Row], folder: Path) -> None:
    def column(values: list[float]) -> Float64[np.ndarray, "rows"]:
        return np.array(values, dtype=np.float64)

    write_columns(
        folder,
        "mesh_sizes",
        {
            "domain": ("", [row.combination.domain for row in rows]),
            "order": ("", np.array([row.combination.order for row in rows], dtype=np.int64)),
            "elements_per_wavelength": ("", column([row.combination.elements_per_wavelength for row in rows])),
            "unknowns": ("", column([row.unknowns for row in rows])),
            "time": ("s", column([row.seconds for row in rows])),
            "memory": ("B", column([row.most_bytes for row in rows])),
            "error": ("", column([row.error for row in rows])),
            "said": ("", [row.said or "run" for row in rows]),
        },
    )
