"""Fig. 6 and 7 of the paper: the pressure with the fingers considered and ignored, by the other solver."""

from pathlib import Path

import numpy as np
from jaxtyping import Float64

from airtact.evaluation.comparison import HELD_EQUAL
from airtact.evaluation.windows import plane_through
from airtact.experiments.part import Part, coordinates, draw_planes, write_columns
from airtact.experiments.solved import CONSIDERED, IGNORED, Solved
from airtact.reports.field_figure import COLOURS, cut_bodies, past_the_surface
from airtact.reports.page import paragraph, picture, table
from airtact.timing import Clock

HELD = "equal energy"
"""Normalisation of the pictures."""

PAPER = {"simulated": "about half", "measured": "0.60"}
"""The paper's ratios ignored over considered."""


def equal_energy_factors(made: Solved) -> Float64[np.ndarray, "excitations"]:
    """Factors (4,) that bring the verified drives to equal energy; the last two are of phases alone."""
    factors = (
        made.compared.pressures["equal energy"][:, 0] / made.compared.pressures["equal peak"][:, 0]
    )
    return np.concatenate([factors, np.ones(2)])


def pressures(made: Solved, folder: Path, clock: Clock) -> Part:
    """Show both fields on one scale, and the pressure at each focus."""
    fingers = made.dummies
    vertices = np.concatenate([surface.vertices for surface in fingers.surfaces])
    window = plane_through(fingers.foci, vertices, made.scene.wavelength)
    with clock.step("fields", "computing the pressure with the fingers considered and ignored"):
        at_peak = made.compared.at(window.points)
        magnitudes = np.abs(
            np.stack([at_peak[CONSIDERED], at_peak[IGNORED]], axis=1)
            * equal_energy_factors(made)[:2]
        )
    strongest = float(np.nanmax(magnitudes))
    normalised: dict[str, np.ndarray] = dict(
        zip((CONSIDERED, IGNORED), (magnitudes / strongest).T, strict=True)
    )
    drawn = {name: past_the_surface(window, values, 2) for name, values in normalised.items()}
    columns = {"considered": ("Pa", magnitudes[:, 0]), "ignored": ("Pa", magnitudes[:, 1])}
    write_columns(folder, "pressures", coordinates(window.points) | columns)
    scale = (COLOURS, 0.0, 1.0, f"pressure over the largest of both, {HELD}")
    drive = made.drives[CONSIDERED].amplitudes
    predicted = (
        made.array.element.sensitivity * (made.received @ drive) / len(fingers.foci)
    )  # by reciprocity
    off = float(abs(made.compared.at(fingers.foci)[CONSIDERED].mean() - predicted) / abs(predicted))
    pieces = (
        paragraph(
            "The drives were made by finite elements and are verified by boundary elements, which share no code with "
            f"them. At the foci the pressure by boundary elements differs by {100 * off:.2f} % from that which the "
            "finite elements predict (estimated error of the boundary elements: "
            f"{100 * made.compared.report.estimated_error:.1f} %)."
        ),
        picture(
            draw_planes(window, drawn, cut_bodies(window, fingers.surfaces), fingers.foci, scale),
            f"Fig. 6 (left) and Fig. 7 (right) of the paper, on one scale, both drives at {HELD}: {HELD_EQUAL[HELD]}. "
            "The circles are the foci. data/pressures",
            "pressure between two fingers under two drives",
        ),
        table(
            ["held equal", "pressure", "pressure squared", "paper, simulated", "paper, measured"],
            _rows(made),
            "Ignored over considered at the foci, drives in 256 levels. The paper calls the pressure of its plots "
            "intensity and does not say what it holds equal. data/foci",
        ),
        *(paragraph(words, "warning") for words in made.compared.report.warnings),
    )
    ratios = made.compared.ratios(HELD)[1].mean()
    facts = (
        (f"{ratios:.2f}", f"ignored / considered, pressure at {HELD}"),
        (f"{100 * off:.2f} %", "between solvers"),
    )
    _write_ratios(made, folder)
    return Part("Considered and ignored (Fig. 6 and 7)", pieces, facts)


def _rows(made: Solved) -> list[list[str]]:
    rows = []
    for held in HELD_EQUAL:
        ratio = made.compared.ratios(held)[1]
        squared = made.compared.squared_ratios(held)[1]
        rows.append([held, f"{ratio.mean():.3f}", f"{squared.mean():.3f}", *PAPER.values()])
    return rows


def _write_ratios(made: Solved, folder: Path) -> None:
    rows = [
        (held, name, focus, float(pressure))
        for held, both in made.compared.pressures.items()
        for name, foci in zip(made.compared.names, both, strict=True)
        for focus, pressure in enumerate(foci)
    ]
    held, name, focus, pressure = (list(column) for column in zip(*rows, strict=True))
    columns = {
        "held_equal": ("", held),
        "drive": ("", name),
        "focus": ("", focus),
        "pressure": ("Pa", pressure),
    }
    write_columns(folder, "foci", columns)
