"""The ratio ignored over considered at the foci, over all that the paper leaves open of its fingers."""

from collections.abc import Iterator, Mapping
from itertools import product
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float64
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.drives.conjugation import time_reversal
from airtact.drives.rounding import quantise
from airtact.drives.transfer import focus_by_distance, transfer_matrix
from airtact.evaluation.comparison import HELD_EQUAL, compare
from airtact.experiments.dummies import Dummies, Entering, dummies
from airtact.experiments.part import Part, write_columns
from airtact.experiments.pressures import HELD
from airtact.experiments.settings import Settings
from airtact.reports.page import paragraph, picture, table
from airtact.timing import Clock
from airtact.transducers.element import monopole
from airtact.transducers.layout import PhasedArray, surrounding_box

WANTED = {0.5: "about half (simulated)", 0.6: "0.60 (measured)"}
"""The paper's two numbers."""

STYLES: dict[float, Literal["dashed", "solid"]] = {0.5: "dashed", 0.6: "solid"}
"""Lines of those."""

LOOKS: dict[Entering, tuple[Literal["-", "--", ":"], str]] = {
    "from below": ("-", "o"),
    "from above": ("--", "^"),
    "from the side": (":", "s"),
}
"""Line and marker of each way of entering."""

PAPER_LINES = [
    Line2D([], [], color="0.2", linestyle=style, label=f"the paper's {wanted:.2f}")
    for wanted, style in STYLES.items()
]
"""What explains them."""


class Fingers(NamedTuple):
    """One way to fill in what the paper leaves open: gap and radius [m], tilt [degrees], and where they come from."""

    gap: float
    radius: float
    tilt: float
    entering: Entering

    def __str__(self) -> str:
        return f"gap {1e3 * self.gap:g} mm, radius {1e3 * self.radius:g} mm, tilt {self.tilt:g}°, {self.entering}"


def ratio_of(fingers: Dummies, array: PhasedArray, settings: Settings) -> Float64[np.ndarray, "3"]:
    """Pressure ignored over considered under the normalisations of ``HELD_EQUAL``, mean over the foci."""
    scene, target = fingers.scene, fingers.target
    solver = BoundaryElement(accuracy=settings.sweep_drive)
    transfer = transfer_matrix(solver.radiate(scene, target.beacons()), array)
    drives = {
        "considered": time_reversal(transfer, target),
        "ignored": focus_by_distance(array, target, scene.medium, scene.frequency),
    }
    emitted = {name: quantise(drive).drive() for name, drive in drives.items()}
    compared = compare(
        scene, array, emitted, target, solver=BoundaryElement(accuracy=settings.sweep_verify)
    )
    return np.array([compared.ratios(held)[1].mean() for held in HELD_EQUAL])


def all_fingers(settings: Settings) -> list[Fingers]:
    """All that is swept: gap by radius, and tilt by way of entering at some gaps."""
    found = [
        Fingers(gap, radius, 20.0, "from below")
        for gap, radius in product(settings.gaps, settings.radii)
    ]
    tilted = product(settings.tilt_gaps, settings.tilts, settings.ways)
    return list(
        dict.fromkeys(
            [*found, *(Fingers(gap, 8e-3, tilt, entering) for gap, tilt, entering in tilted)]
        )
    )


def ratios(settings: Settings, folder: Path, clock: Clock) -> Part:
    """Sweep the fingers and show where the paper's numbers lie."""
    array, found = surrounding_box(monopole()), {}
    wanted = all_fingers(settings)
    for index, one in enumerate(wanted, start=1):
        with clock.step(f"fingers {index}", f"fingers {index} of {len(wanted)}: {one}"):
            found[one] = ratio_of(dummies(*one), array, settings)
        _write(found, folder)
    values = np.array(list(found.values()))
    spans = [
        f"{held} {low:.2f} to {high:.2f} (squared {low**2:.2f} to {high**2:.2f})"
        for held, low, high in zip(HELD_EQUAL, values.min(axis=0), values.max(axis=0), strict=True)
    ]
    pieces = (
        paragraph(
            f"The paper does not give the size, the gap or the tilt of its dummies. Over {len(found)} of them the "
            f"ratio ignored over considered at the foci, as pressure, is: {'; '.join(spans)}. Drives are made and "
            f"verified by boundary elements (accuracy {settings.sweep_drive:g} and {settings.sweep_verify:g}), drives "
            "in 256 levels."
        ),
        picture(
            draw_maps(settings, found),
            "Ratio ignored over considered over gap and radius, fingers from below tilted by 20 degrees, as pressure "
            "above and squared below; lines: where the paper's 0.60 (solid) and 0.50 (dashed) lie. data/sweep",
            "maps of the ratio over gap and radius",
        ),
        picture(
            draw_tilts(settings, found),
            "Ratio over the tilt for the gaps and the ways in which the fingers may enter (radius 8 mm); red: the "
            "paper's 0.60 and 0.50 taken as pressure; pale: taken as pressure squared, which is 0.77 and 0.71 in "
            "pressure. data/sweep",
            "curves of the ratio over tilt",
        ),
        table(
            ["paper", "taken as", "held equal", "nearest here", "fingers"],
            list(_nearest(found)),
            "The fingers of the sweep that come nearest to the paper's numbers.",
            text=True,
        ),
    )
    one, ratio = _nearest_to(found, 0.5, list(HELD_EQUAL).index(HELD), 1)
    return Part(
        "What the paper leaves open", pieces, ((f"{ratio:.2f}", f"nearest to half, {HELD}: {one}"),)
    )


def _nearest(found: Mapping[Fingers, Float64[np.ndarray, "3"]]) -> Iterator[list[str]]:
    for wanted, words in WANTED.items():
        for power, name in ((1, "pressure"), (2, "pressure squared")):
            for column, held in enumerate(HELD_EQUAL):
                one, ratio = _nearest_to(found, wanted, column, power)
                yield [words, name, held, f"{ratio:.3f}", str(one)]


def _nearest_to(
    found: Mapping[Fingers, Float64[np.ndarray, "3"]], wanted: float, column: int, power: int
) -> tuple[Fingers, float]:
    """Fingers whose ratio, under one normalisation and to a power, is nearest to a number; and that ratio."""
    one = min(found, key=lambda it: abs(found[it][column] ** power - wanted))
    return one, float(found[one][column] ** power)


def _write(found: Mapping[Fingers, Float64[np.ndarray, "3"]], folder: Path) -> None:
    units = {"gap": "m", "radius": "m", "tilt": "degrees", "entering": ""}
    columns = {name: (unit, [getattr(one, name) for one in found]) for name, unit in units.items()}
    values = np.array(list(found.values()))
    ratio = {
        held.replace(" ", "_"): ("", values[:, index]) for index, held in enumerate(HELD_EQUAL)
    }
    write_columns(folder, "sweep", columns | ratio)


def draw_maps(settings: Settings, found: Mapping[Fingers, Float64[np.ndarray, "3"]]) -> Figure:
    """Draw the ratio over gap and radius, as pressure above and squared below."""
    wanted = [
        [Fingers(gap, radius, 20.0, "from below") for gap in settings.gaps]
        for radius in settings.radii
    ]
    grid = np.array([[found[one] for one in row] for row in wanted])
    figure = Figure(figsize=(11.0, 6.2), layout="constrained")
    rows = figure.subplots(2, len(HELD_EQUAL), sharex=True, sharey=True)
    across, along = 1e3 * np.array(settings.gaps), 1e3 * np.array(settings.radii)
    for power, row in zip((1, 2), rows, strict=True):
        values = grid**power
        for column, (held, axes) in enumerate(zip(HELD_EQUAL, row, strict=True)):
            shown = axes.contourf(across, along, values[:, :, column], levels=14, cmap="viridis")
            figure.colorbar(shown, ax=axes, aspect=20, format="%.2f")
            _mark(axes, across, along, values[:, :, column])
            axes.set_title(f"{held}, {'pressure' if power == 1 else 'squared'}", fontsize=10)
            axes.set(xlabel="gap [mm]", ylabel="radius [mm]")
            axes.label_outer()
    figure.legend(
        handles=PAPER_LINES, loc="outside lower center", ncols=2, frameon=False, fontsize=9
    )
    return figure


def _mark(
    axes: Axes,
    across: Float64[np.ndarray, "gaps"],
    along: Float64[np.ndarray, "radii"],
    values: Float64[np.ndarray, "radii gaps"],
) -> None:
    """Draw where the paper's numbers lie, or say that they do not occur."""
    missing = []
    for wanted, style in STYLES.items():
        if values.min() < wanted < values.max():
            for colour, width in (("black", 3.0), ("white", 1.5)):
                axes.contour(
                    across,
                    along,
                    values,
                    levels=[wanted],
                    colors=colour,
                    linestyles=style,
                    linewidths=width,
                )
        else:
            missing.append(f"{wanted:.2f}")
    if missing:
        words = f"no {' or '.join(missing)} here"
        box = {"facecolor": "white", "alpha": 0.75, "edgecolor": "none", "pad": 2}
        axes.text(0.97, 0.04, words, transform=axes.transAxes, ha="right", fontsize=8, bbox=box)


def draw_tilts(settings: Settings, found: Mapping[Fingers, Float64[np.ndarray, "3"]]) -> Figure:
    """Draw the ratio over the tilt, a line for each gap and way of entering."""
    figure = Figure(figsize=(12.0, 4.8), layout="constrained")
    row = figure.subplots(1, len(HELD_EQUAL), sharey=True)
    shades = colormaps["viridis"](np.linspace(0, 0.88, len(settings.tilt_gaps)))
    for column, (held, axes) in enumerate(zip(HELD_EQUAL, row, strict=True)):
        for shade, gap in zip(shades, settings.tilt_gaps, strict=True):
            for entering in settings.ways:
                style, marker = LOOKS[entering]
                line = [
                    found[Fingers(gap, 8e-3, tilt, entering)][column] for tilt in settings.tilts
                ]
                axes.plot(settings.tilts, line, style, color=shade, marker=marker, markersize=4)
        for wanted, style in STYLES.items():
            axes.axhline(wanted, color="#b3202a", linewidth=1.1, linestyle=style)
            axes.axhline(np.sqrt(wanted), color="#e8a0a5", linewidth=1.1, linestyle=style)
        axes.set(xlabel="tilt [degrees]", title=held, xticks=settings.tilts)
    row[0].set_ylabel("pressure, ignored / considered")
    keys = [
        Line2D([], [], color=shade, label=f"gap {1e3 * gap:g} mm")
        for shade, gap in zip(shades, settings.tilt_gaps, strict=True)
    ]
    keys += [
        Line2D([], [], color="0.3", linestyle=style, marker=marker, markersize=4, label=entering)
        for entering, (style, marker) in ((way, LOOKS[way]) for way in settings.ways)
    ]
    for colour, words in (("#b3202a", "as pressure"), ("#e8a0a5", "as squared")):
        keys += [
            Line2D([], [], color=colour, linestyle=style, label=f"{wanted:.2f} {words}")
            for wanted, style in STYLES.items()
        ]
    figure.legend(handles=keys, loc="outside right", fontsize=8, frameon=False)  # pyright: ignore[reportArgumentType, reportCallIssue]
    return figure
