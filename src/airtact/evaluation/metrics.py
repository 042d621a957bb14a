"""The pressure at every focus under a drive, evaluated by a solver that did not make the drive."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128, Float64

from airtact.acoustics.scene import Scene, check_outside
from airtact.acoustics.solvers.problem import BOARDS, PLANES, RadiatedField, Solver, SolveReport
from airtact.acoustics.sources import check_off_sources
from airtact.acoustics.target import Target
from airtact.checks import counted, of_kind
from airtact.drives.drive import Drive
from airtact.drives.reach import fraction
from airtact.evaluation.field import check_solver, drive_sources
from airtact.printing import html_table, one_line
from airtact.timing import Progress
from airtact.transducers.layout import PhasedArray
from airtact.transducers.placement import check_placement

NOT_MODELLED = "The array's own boards, the table and the walls do not reflect, and the elements' sensitivity is not calibrated."
"""What a figure of pressure leaves out without a plane (section 3.1 of the paper for the boards)."""

BEYOND_THE_PLANE = (
    "The array's own boards, and tables and walls other than the scene's rigid plane, do not reflect, and the "
    "elements' sensitivity is not calibrated."
)
"""What it leaves out with one."""

BEYOND_THE_BOARDS = (
    "{} do not reflect, the boards have no gaps, and the elements' sensitivity is not calibrated."
)
"""What it leaves out with boards that reflect."""


def not_modelled(report: SolveReport) -> str:
    """Say what figures of pressure leave out that a report belongs to."""
    if BOARDS in report.settings:
        others = "Tables and walls" + " other than the scene's rigid plane" * (
            PLANES in report.settings
        )
        return BEYOND_THE_BOARDS.format(others)
    return BEYOND_THE_PLANE if PLANES in report.settings else NOT_MODELLED


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The pressure at each focus under a drive, and how it compares with what the target asks.

    Attributes
    ----------
    target : the foci and the pressures asked there.
    pressures : (F,) complex pressure at each focus [Pa], peak.
    report : of the solver that evaluated them.
    field : the field of the drive, its one excitation; None where others were solved with it.
    """

    target: Target
    pressures: Complex128[np.ndarray, "foci"]
    report: SolveReport
    field: RadiatedField | None = None

    def __repr__(self) -> str:
        foci = counted(len(self.pressures), "focus", "foci")
        return one_line(
            self, foci, f"weakest {self._in_words(self.worst)}", f"mean {self._in_words(self.mean)}"
        )

    def _repr_html_(self) -> str:
        head = ["focus", "x [mm]", "y [mm]", "z [mm]", "pressure [Pa]", "asked [Pa]", "share"]
        title = f"Evaluation: weakest focus {self._in_words(self.worst)}, mean {self._in_words(self.mean)}"
        return html_table(title, head, self._rows(), [self._source(), *self.report.warnings])

    def _in_words(self, value: float) -> str:
        return (
            f"{value:.0f} Pa"
            if self.target.pressures is None
            else f"{100 * value:.1f} % of what was asked"
        )

    def _rows(self) -> list[list[str]]:
        """Return number, position, pressure, what was asked and its share for each focus, as texts."""
        asked = self.target.pressures
        wanted = (
            ["-"] * len(self.pressures)
            if asked is None
            else [f"{pressure:.1f}" for pressure in asked]
        )
        reached = ["-" if np.isnan(share) else f"{share:.1%}" for share in self.shares]
        points, got = self.target.points * 1e3, self.magnitudes
        return [
            [
                str(index),
                *(f"{coordinate:.2f}" for coordinate in point),
                f"{got[index]:.1f}",
                wanted[index],
                reached[index],
            ]
            for index, point in enumerate(points)
        ]

    @property
    def magnitudes(self) -> Float64[np.ndarray, "foci"]:
        """(F,) peak pressure at each focus [Pa]."""
        return np.abs(self.pressures)

    @property
    def shares(self) -> Float64[np.ndarray, "foci"]:
        """(F,) pressure over the pressure asked, NaN where nothing or 0 Pa was asked."""
        return fraction(self.magnitudes, self.target)

    @property
    def counted(self) -> Float64[np.ndarray, "counted"]:
        """Values of the foci that ask for sound, from which worst, mean and uniformity follow.

        They are shares of the pressure asked where one is; else magnitudes [Pa], each over the
        share asked, if any.
        """
        if self.target.pressures is not None:
            return self.shares[np.isfinite(self.shares)]
        asked = self.target.weights > 0.0
        return self.magnitudes[asked] / self.target.weights[asked]

    @property
    def worst(self) -> float:
        """Smallest share, or smallest pressure [Pa] where none is asked."""
        return float(self.counted.min())

    @property
    def mean(self) -> float:
        """Mean share, or mean pressure [Pa] where none is asked."""
        return float(self.counted.mean())

    @property
    def uniformity(self) -> float:
        """1 − (max − min)/(max + min) over the foci, 1 when all are equal.

        Di Leonardo, Ianni and Ruocco (Optics Express 15, 1913, 2007) define it for intensity; here
        it is that of pressure, or of the share of the pressure asked.
        """
        most, least = self.counted.max(), self.counted.min()
        return float(1.0 - (most - least) / (most + least)) if most > 0.0 else 0.0

    def __str__(self) -> str:
        lines = ["focus   x [mm]    y [mm]    z [mm]   pressure [Pa]   asked [Pa]    share"]
        for index, x, y, z, got, wanted, reached in self._rows():
            lines.append(f"{index:>5}{x:>9} {y:>9} {z:>9} {got:>15} {wanted:>12} {reached:>8}")
        figure = "{:.1f} Pa" if self.target.pressures is None else "{:.1%} of what was asked"
        lines.append(
            f"worst focus {figure.format(self.worst)}, mean {figure.format(self.mean)}, "
            f"uniformity {self.uniformity:.3f}"
        )
        return "\n".join([*lines, self._source(), *self.report.warnings])

    def _source(self) -> str:
        return (
            f"peak pressures by {self.report.solver}, estimated error {self.report.estimated_error:.2g}, residual "
            f"{self.report.residual:.1e}. {not_modelled(self.report)}"
        )


def evaluate(
    scene: Scene,
    array: PhasedArray,
    drive: Drive,
    target: Target,
    *,
    solver: Solver,
    progress: Progress | None = None,
) -> Evaluation:
    """Evaluate the pressure at the foci by one forward solve: all elements emit at once, and the scene scatters.

    Parameters
    ----------
    scene : what is in the air.
    array : the transducers in the obstacles' frame, see ``PhasedArray.seen_from``.
    drive : what they emit.
    target : the F foci and the pressures asked there.
    solver : a different or more accurate solver than the one that made the drive.
    progress : callback that gets the words of each step as it begins, such as ``print``.

    Returns
    -------
    The complex pressures (F,) at the foci [Pa], with the report of the solver.

    Raises
    ------
    InvalidInput
        If the drive is silent or for another number of elements, an element or a focus is inside a body, a focus or a
        body is behind the face of a directional element, a focus is on an element, or something is of the wrong kind.
    """
    field = radiate_drives(scene, array, [drive], target, solver, progress=progress)
    pressure = np.ascontiguousarray(field.at(target.points)[:, 0])
    return Evaluation(target, pressure, field.report_at(target.points), field)


def radiate_drives(
    scene: Scene,
    array: PhasedArray,
    drives: Sequence[Drive],
    target: Target,
    solver: Solver,
    others: Mapping[str, Float64[np.ndarray, "points 3"]] | None = None,
    progress: Progress | None = None,
) -> RadiatedField:
    """Solve for several drives at once, one right-hand side a drive; the errors are those of ``evaluate``.

    It first checks that the foci, and any ``others`` (points by what one is called), are off the
    bodies and sources.
    """
    check_solver(solver)
    of_kind(target, Target, "the target", "Target(points, pressures)")
    sources = drive_sources(array, drives, scene)
    check_placement(scene, array, target.points)
    for what, points in {"focus": target.points, **(others or {})}.items():
        if len(points):
            check_outside(scene, points, what)
            check_off_sources(points, sources)
    return solver.reporting(progress).radiate(scene, sources)
