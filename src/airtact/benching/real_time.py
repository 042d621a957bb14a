"""What a hand that moves asks of the solver: a row for each figure of real time, with its error beside it.

Everything goes through the public names; the truth is fundamental solutions, for a hand a finer solution.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from jaxtyping import Complex128, Real

from airtact.benching.scenes import Bodies, deformed, moved_each, moved_foci, two_fingers, whole_motion
from airtact.benching.timing import Timed, correlation, relative_error, timed
from airtact.benching.truth import true_pressure
from airtact.evaluation.field import drive_sources
from airtact.printing import in_short
from airtact.solvers.bem.solver import BoundaryElement
from airtact.solvers.problem import RadiatedField, Solver, SolveReport
from airtact.solvers.spherical.multipole_field import multipole_expansion
from airtact.synthesis.time_reversal import time_reversal
from airtact.transducers.layout import PhasedArray, surrounding_box
from airtact.transfer import Drive, TransferMatrix, transfer_matrix

CHECKED = 3
"""Frames of which the truth is known, for a fit takes up to a minute; all frames are timed."""

ACCURACIES = (0.01, 0.02, 0.05, 0.12, 0.2)
"""Asked for besides those of a pressure and of a drive, to see what each is worth."""


@dataclass(frozen=True)
class Row:
    """One figure.

    Attributes
    ----------
    what : is measured.
    asked : the figure that the issue asks for.
    measured : in words.
    error : in words, against what.
    profile : where the time went.
    numbers : the same by name: seconds, errors, unknowns.
    """

    what: str
    asked: str
    measured: str
    error: str
    profile: str = ""
    numbers: Mapping[str, float | int | tuple[float, ...]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Made:
    """A drive and what it came from.

    Attributes
    ----------
    report : of the solve.
    transfer, drive : what it was made for.
    """

    report: SolveReport
    transfer: TransferMatrix
    drive: Drive

    __repr__ = in_short


def to_drive(solver: Solver, bodies: Bodies, array: PhasedArray) -> Made:
    """From the skins of a pose to the drive, all steps: scene, solve, transfer matrix, time reversal.

    Parameters
    ----------
    solver, bodies, array : as usual.
    """
    target = bodies.target
    beacons = solver.radiate(bodies.scene, target.beacons())
    transfer = transfer_matrix(beacons, array)
    return Made(beacons.report, transfer, time_reversal(transfer, target))


@dataclass(frozen=True)
class RealTime:
    """The rows, measured anew at each call.

    Attributes
    ----------
    folder : where truths are kept.
    runs : timed runs of each job.
    accuracy : that two fingers are solved to.
    drive_accuracy : the same where only the drive is wanted.
    """

    folder: Path
    runs: int = 7
    accuracy: float = 0.03
    drive_accuracy: float = 0.08

    @cached_property
    def array(self) -> PhasedArray:
        """The paper's 996 transducers."""
        return surrounding_box()

    @cached_property
    def rest(self) -> Bodies:
        """Two fingers as they are before they move."""
        return two_fingers()

    @cached_property
    def kept(self) -> Solver:
        """Two fingers at rest, each solved by itself."""
        return self._quick(self.accuracy).factorised(self.rest.scene, beside=self.rest.foci)

    def _quick(self, accuracy: float) -> BoundaryElement:
        return BoundaryElement(accuracy=accuracy, estimate=False)

    def deformed_to_drive(self) -> Row:
        """Time two fingers that change their shape at every frame."""
        frames = [deformed(frame) for frame in range(self.runs + 1)]
        what = "two fingers deformed, new pose to drive, 2 foci"
        return self._frames(what, "25 ms (goal 15), 3 %", self._quick(self.accuracy), frames)

    def moved_each_to_drive(self) -> Row:
        """Time two fingers that keep their shapes and move against each other."""
        frames = [moved_each(self.rest, frame) for frame in range(self.runs + 1)]
        what = "two fingers, each moved rigidly, to drive"
        return self._frames(what, "5 ms, 3 %", self.kept, frames)

    def drive_only(self) -> Row:
        """Time two fingers that change their shape, solved just well enough for a drive."""
        frames = [deformed(frame) for frame in range(self.runs + 1)]
        what = "two fingers deformed, drive only"
        asked = "12 ms, correlation 0.995"
        return self._frames(what, asked, self._quick(self.drive_accuracy), frames)

    def at_accuracies(self) -> list[Row]:
        """Time the same at other accuracies: what a drive needs is less than what a pressure needs."""
        frames = [deformed(frame) for frame in range(self.runs + 1)]
        return [
            self._frames(f"two fingers deformed, accuracy = {accuracy}", "", self._quick(accuracy), frames)
            for accuracy in ACCURACIES
        ]

    def whole_moved(self) -> Row:
        """Time a solved shape that moves as a whole: transfer matrix and drive again, no solve.

        The scattered sound is read off spherical waves, found once; the sum over the skin is told beside it.
        """
        bodies = self.rest
        beacons = self._quick(self.accuracy).radiate(bodies.scene, bodies.target.beacons())
        waves = multipole_expansion(beacons)

        def again(field: RadiatedField, frame: int) -> Made:
            transfer = transfer_matrix(field, self.array.seen_from(whole_motion(frame)))
            return Made(field.report, transfer, time_reversal(transfer, bodies.target))

        by_sum, _ = timed([partial(again, beacons, frame) for frame in range(self.runs + 1)])
        took, made = timed([partial(again, waves, frame) for frame in range(self.runs + 1)])
        checked = range(1, CHECKED)
        seen = [self.array.seen_from(whole_motion(frame)) for frame in checked]
        errors = [self._errors(bodies, array, made[frame - 1]) for frame, array in zip(checked, seen, strict=True)]
        asked = "2 ms for 2000 unknowns"
        row = self._row("whole pinch moved rigidly, to drive", asked, took, made, errors)
        found, off = waves.report.seconds["waves"], float(waves.report.settings["waves_error"])
        error = f"{row.error}; waves {off:.1e} off"
        profile = f"{row.profile}; by the sum over the skin {by_sum}; waves found once in {1e3 * found:.3g} ms"
        return Row(row.what, asked, row.measured, error, profile, row.numbers)

    def new_focus(self) -> Row:
        """Time other foci beside the same bodies, each of which was solved by itself."""
        frames = [moved_foci(self.rest, frame) for frame in range(self.runs + 1)]
        what = "new foci on a solved shape, to drive"
        return self._frames(what, "3 ms", self.kept, frames)

    def slice_beside(self) -> Row:
        """Time the field of a drive on 200 x 200 points between and beside two fingers."""
        made = to_drive(self._quick(self.accuracy), self.rest, self.array)
        scene, playing = self.rest.scene, drive_sources(self.array, [made.drive])
        played = BoundaryElement(accuracy=self.accuracy).radiate(scene, playing)
        points = slice_points()
        took, heard = timed([partial(played.at, points)] * (self.runs + 1))
        outside = np.flatnonzero((scene.depth(points) < 0) & (np.arange(len(points)) % 37 == 0))
        truth = true_pressure(
            self.rest, playing.positions, points[outside], self.folder, playing.strengths.astype(np.complex128)
        )
        error = relative_error(heard[0][outside].T, truth.pressure.T)
        return Row(
            "field on 200 x 200 points beside two fingers",
            "40 ms, 3 %",
            f"{took}",
            f"{error:.2%} at {len(outside)} of the points (truth itself {truth.own_error:.2%})",
            f"{played.report.nodes} unknowns",
            {"seconds": took.seconds, "error": error, "unknowns": played.report.nodes},
        )

    def _frames(self, what: str, asked: str, solver: Solver, frames: Sequence[Bodies]) -> Row:
        took, made = timed([partial(to_drive, solver, bodies, self.array) for bodies in frames])
        checked = zip(frames[1 : CHECKED + 1], made, strict=False)
        return self._row(what, asked, took, made, [self._errors(bodies, self.array, one) for bodies, one in checked])

    def _errors(self, bodies: Bodies, array: PhasedArray, made: Made) -> tuple[float, float, float]:
        """Error of the transfer matrix, correlation of the drive, and the truth's own error."""
        truth = true_pressure(bodies, array.positions, bodies.foci, self.folder)
        return (*judged(made, array.element.sensitivity * truth.pressure, bodies), truth.own_error)

    def _row(
        self, what: str, asked: str, took: Timed, made: Sequence[Made], errors: Sequence[tuple[float, float, float]]
    ) -> Row:
        worst, alike, own = max(e[0] for e in errors), min(e[1] for e in errors), max(e[2] for e in errors)
        return told(what, asked, took, made, (worst, alike), f"truth itself {own:.2%}")


def judged(made: Made, matrix: Complex128[np.ndarray, "foci elements"], bodies: Bodies) -> tuple[float, float]:
    """Relative error of a transfer matrix, and correlation of the drive with that of the true matrix.

    Parameters
    ----------
    made : what is judged.
    matrix : the true transfer matrix.
    bodies : whose foci they are.
    """
    exact = time_reversal(TransferMatrix(matrix, 0.0), bodies.target)
    return relative_error(made.transfer.matrix, matrix), correlation(made.drive.amplitudes, exact.amplitudes)


def told(what: str, asked: str, took: Timed, made: Sequence[Made], errors: tuple[float, float], against: str) -> Row:
    """Put a row in words.

    Parameters
    ----------
    what, asked : of the row.
    took, made : of the runs.
    errors : of the transfer matrix, and correlation of the drive.
    against : what the truth was.
    """
    nodes = int(np.median([one.report.nodes for one in made]))
    return Row(
        what,
        asked,
        f"{took}",
        f"{errors[0]:.2%}, drive {errors[1]:.4f} ({against})",
        f"{nodes} unknowns, {made[0].report.iterations} iterations; " + steps(made),
        {"seconds": took.seconds, "error": errors[0], "correlation": errors[1], "unknowns": nodes},
    )


def steps(made: Sequence[Made]) -> str:
    """Median milliseconds of each step of the solves."""
    names = made[0].report.seconds
    laps = {name: np.median([one.report.seconds.get(name, 0.0) for one in made]) for name in names}
    return ", ".join(f"{name} {1e3 * lap:.1f}" for name, lap in laps.items()) + " ms"


def slice_points(side: int = 200, width: float = 60e-3) -> Real[np.ndarray, "points 3"]:
    """Points of a square in the plane of both fingers, their tips in its upper half (side², 3) [m]."""
    along = np.linspace(-0.5 * width, 0.5 * width, side)
    across, up = np.meshgrid(along, along - 0.3 * width)
    return np.stack([across.ravel(), np.full(side * side, 1e-4), up.ravel()], axis=1)
