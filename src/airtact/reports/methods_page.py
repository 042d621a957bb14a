"""The page that compares ways to make a drive: a table, bars against the bound, and each field on one scale."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from airtact.acoustics.solvers.problem import SolveReport
from airtact.acoustics.target import Target
from airtact.checks import counted
from airtact.drives.transfer import Drive, TransferMatrix
from airtact.evaluation.metrics import not_modelled
from airtact.files.atomic import whole_file
from airtact.reports.field_figure import Cut, draw_field
from airtact.reports.page import page_from, picture
from airtact.reports.plots import draw_bars
from airtact.reports.viewer import SceneView, viewer_values


@dataclass(frozen=True, eq=False)
class Contender:
    """One way to make a drive, and what came of it.

    Attributes
    ----------
    name : of the method.
    drive : what it gave.
    emitted : the same in the scene's levels, which is what is verified.
    pressures : (F,) peak pressure at the foci, by the verification solve [Pa].
    suppression_points : (Q,) peak pressure at the suppression points [Pa].
    seconds : how long it took [s].
    kept : what the worst focus gets 9 of 10 times with what is in doubt [Pa]; None where nothing
        is.
    """

    name: str
    drive: Drive
    emitted: Drive
    pressures: Float64[np.ndarray, "foci"]
    suppression_points: Float64[np.ndarray, "suppressed"]
    seconds: float
    kept: float | None = None

    @property
    def energy(self) -> float:
        """Mean of |d|² over the elements: 1 when all are at full scale."""
        return float(np.mean(np.abs(self.drive.amplitudes) ** 2))

    @property
    def suppression_level(self) -> float:
        """Mean of p² in the suppression points against that in the foci [dB]; NaN without suppression points."""
        if not len(self.suppression_points):
            return float("nan")
        return float(
            10.0 * np.log10(np.mean(self.suppression_points**2) / np.mean(self.pressures**2))
        )


@dataclass(frozen=True, eq=False)
class Ranked:
    """What each method reached.

    Attributes
    ----------
    title : name of the scene.
    text : the scene file.
    target : the foci.
    foci : a name for each.
    bodies : a name for each body.
    default : the method that a drive is made by where the scene names none.
    contenders : the methods that made a drive, and the control last.
    notes : warnings of the scene, of methods that made no drive or stalled, and of the verification
        solve.
    transfer : what the drives were made from.
    bound : no drive of amplitudes up to 1 gives every focus more than this times its weight [Pa].
    report : how the verification solve came to the pressures.
    seconds : wall time by step [s].
    """

    title: str
    text: str
    target: Target
    foci: Sequence[str]
    bodies: Sequence[str]
    default: str
    contenders: Sequence[Contender]
    notes: Sequence[str]
    transfer: TransferMatrix
    bound: float
    report: SolveReport
    seconds: Mapping[str, float]

    def worst(self, one: Contender) -> float:
        """Least pressure over weight of a method, over the foci that ask for any [Pa]."""
        asked = self.target.weights > 0.0
        return float((one.pressures[asked] / self.target.weights[asked]).min())

    def of_the_bound(self, one: Contender) -> float:
        """Divide what a method's worst focus would get at full scale by the bound."""
        return self.worst(one) / float(np.abs(one.emitted.amplitudes).max()) / self.bound

    def label(self, one: Contender) -> str:
        """Name a method, and mark the default."""
        return f"{one.name} (default)" if one.name == self.default else one.name

    @property
    def best(self) -> Contender:
        """The method whose worst focus gets most at full scale."""
        return max(self.contenders, key=self.of_the_bound)


@dataclass(frozen=True, eq=False)
class Contest(Ranked):
    """All that the page shows.

    Attributes
    ----------
    cut : the field of each drive in one plane.
    view : the scene in space, with the field of each drive.
    """

    cut: Cut
    view: SceneView


def write_methods_page(path: Path, contest: Contest) -> None:
    """Write the comparison as one HTML file that needs nothing else; it appears only once it is complete."""
    values = {**_summary(contest), **_tables(contest), **_pictures(contest)}
    values["space"] = viewer_values(
        contest.view,
        contest.title,
        (contest.contenders.index(contest.best), len(contest.contenders) - 1),
    )
    title = f"airtact: methods for {contest.title}"
    with whole_file(path) as partial:
        partial.write_text(
            page_from("methods.html.j2", title=title, contest=contest, **values), "utf-8"
        )


def _summary(contest: Contest) -> dict[str, Any]:
    best = contest.best
    return {
        "drives": counted(len(contest.contenders), "drive", "drives"),
        "foci": counted(len(contest.foci), "focus", "foci"),
        "facts": [
            (best.name, "gives its worst focus most"),
            (_digits(contest.worst(best)), f"{_unit(contest)} at that focus"),
            (
                f"{contest.of_the_bound(best):.0%}",
                "of a bound that no drive exceeds, at full scale",
            ),
            (f"{1e3 * best.seconds:.3g} ms", "to make that drive"),
        ],
        "warnings": contest.notes,
        "not_modelled": not_modelled(contest.report),
        "steps": [[name, f"{seconds:.2f} s"] for name, seconds in contest.seconds.items()],
    }


def _unit(contest: Contest) -> str:
    """Name the unit of a pressure over its weight."""
    if contest.target.pressures is not None:
        return "times the pressure asked"
    return "Pa" if contest.target.shares is None else "Pa over the share asked"


def _digits(pressure: float) -> str:
    """Write a pressure over its weight with four digits."""
    return f"{pressure:,.0f}" if pressure >= 1e3 else f"{pressure:.4g}"


def _tables(contest: Contest) -> dict[str, Any]:
    rows = []
    for one in sorted(contest.contenders, key=contest.of_the_bound, reverse=True):
        exact, rounded = (
            np.abs(contest.transfer.pressure(drive))[: len(contest.foci)]
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
    suppressed = ["suppression points [dB]"] if len(contest.target.suppression_points) else []
    doubted = (
        ["9 of 10 times, with what is in doubt [Pa]"]
        if contest.contenders[0].kept is not None
        else []
    )
    first = ["method", f"worst focus [{_unit(contest)}]", "at full scale, of the bound"]
    return {
        "header": [*first, *columns, *suppressed, *doubted],
        "rows": rows,
        "focus_header": ["peak pressure [Pa]", *contest.foci],
        "focus_rows": [
            [one.name, *(f"{pressure:,.0f}" for pressure in one.pressures)]
            for one in contest.contenders
        ],
    }


def _pictures(contest: Contest) -> dict[str, Any]:
    names = [one.name for one in contest.contenders]
    strengths = np.array([contest.of_the_bound(one) * contest.bound for one in contest.contenders])
    bars = picture(
        draw_bars(names, strengths, contest.bound, f"worst focus at full scale [{_unit(contest)}]"),
        "What the worst focus gets by each method with its strongest transducer at full scale, against the bound.",
        f"Bars of the pressure at the worst focus for each method, from {_digits(strengths.min())} to "
        f"{_digits(strengths.max())}, and a line at the bound of {_digits(contest.bound)}",
    )
    most, points = contest.view.most, contest.target.points
    fields = [
        picture(
            draw_field(contest.cut, one.name, most, points),
            one.name,
            f"Map of pressure by {one.name}: {one.pressures.min():,.0f} to {one.pressures.max():,.0f} Pa at the foci",
        )
        for one in sorted(contest.contenders, key=contest.of_the_bound, reverse=True)
    ]
    return {"bars": bars, "fields": fields}
