"""Times of a moving hand, from pose to drive, each in a row with its error: two fingers, and an open hand.

Everything goes through the public names; the reference is fundamental solutions, for the open hand
a more accurate solution.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from jaxtyping import Complex128, Float64, Real

from airtact.acoustics.medium import air
from airtact.acoustics.scene import Scene, sound_hard
from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.acoustics.solvers.problem import RadiatedField, Solver, SolveReport
from airtact.acoustics.solvers.spherical.multipole_field import multipole_expansion
from airtact.acoustics.sources import Monopoles
from airtact.acoustics.target import Target
from airtact.drives.drive import Drive
from airtact.drives.linear_methods import time_reversal
from airtact.drives.transfer import TransferMatrix, transfer_matrix
from airtact.errors import in_short
from airtact.evaluation.metrics import drive_sources
from airtact.hands.files import load_hand
from airtact.hands.hand import Hand, hand_from_joints
from airtact.live.drives.factors import (
    HandFactors,
    OpenAir,
    PartSolver,
    beacon_points,
    factors_of,
    part_of,
)
from airtact.live.scene import LiveScene, pose_hand
from airtact.setup.examples import example
from airtact.transducers.element import monopole
from airtact.transducers.layout import PhasedArray, flat_boards, surrounding_box
from benchmarks.common import (
    Bodies,
    Reference,
    Timed,
    cached_reference,
    correlation,
    deformed,
    moved_each,
    moved_foci,
    reference_pressure,
    relative_error,
    timed,
    two_fingers,
    whole_motion,
)

CODES = 16
"""Coded transmissions, whose echoes are solved for at once."""

CHECKED = 3
"""Frames with a reference, which takes up to a minute each; all frames are timed."""

AREA = 325e-4
"""Area of the open hand's skin [m²]."""

DRIVE_ACCURACY = 0.08
"""Accuracy of two fingers where only the drive is wanted."""

HAND_DRIVE_ACCURACY, HAND_ACCURACY = 0.06, 0.03

FINE, COARSER = 0.0015, 0.003
"""Accuracies of the reference for the open hand, and of the solution that its error is estimated from."""

ACCURACIES = (0.01, 0.02, 0.05, 0.12, 0.2)
"""Accuracies besides those for a pressure and for a drive."""


@dataclass(frozen=True)
class Row:
    """One measured figure, its goal, what was measured in words, times of the steps, and the numbers by name."""

    what: str
    asked: str
    measured: str
    error: str
    profile: str = ""
    numbers: Mapping[str, float | int | tuple[float, ...]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Made:
    """A drive, its transfer matrix and the report of its solve."""

    report: SolveReport
    transfer: TransferMatrix
    drive: Drive

    __repr__ = in_short


def to_drive(solver: Solver, bodies: Bodies, array: PhasedArray) -> Made:
    """Make a drive from the bodies of a pose, all steps: scene, solve, transfer matrix, time reversal."""
    target = bodies.target
    beacons = solver.radiate(bodies.scene, target.beacons())
    transfer = transfer_matrix(beacons, array)
    return Made(beacons.report, transfer, time_reversal(transfer, target))


@dataclass(frozen=True)
class RealTime:
    """The rows of two fingers, measured anew at each call; the folder is the cache of references."""

    folder: Path
    runs: int
    accuracy: float = 0.03

    @cached_property
    def array(self) -> PhasedArray:
        """The paper's 996 transducers."""
        return surrounding_box(monopole())

    @cached_property
    def rest(self) -> Bodies:
        """Two fingers before they move."""
        return two_fingers()

    @cached_property
    def factorised(self) -> Solver:
        """Two fingers at rest, each factorised alone."""
        return self.quick.factorised(self.rest.scene, refined=self.rest.foci)

    @property
    def quick(self) -> BoundaryElement:
        """Boundary elements without an estimate of the error."""
        return BoundaryElement(accuracy=self.accuracy, estimate=False)

    def jobs(self) -> dict[str, Callable[[], Row]]:
        """Return the job of every row by its name."""
        deforming = partial(
            self._deformed, "new pose to drive, 2 foci", "18 ms, 3 %", self.accuracy
        )
        return {
            "deformed": deforming,
            "each": partial(
                self._factorised,
                "two fingers, each moved rigidly, to drive",
                "5 ms, 3 %",
                moved_each,
            ),
            "drive": partial(
                self._deformed, "drive only", "10 ms, correlation 0.995", DRIVE_ACCURACY
            ),
            "whole": self.whole_moved,
            "focus": partial(
                self._factorised, "new foci on a solved shape, to drive", "2.5 ms", moved_foci
            ),
            "codes": self.coded,
            "slice": self.slice_beside,
        }

    def at_accuracies(self) -> list[Row]:
        """Time two fingers that change their shape at every frame, at other accuracies."""
        return [self._deformed(f"accuracy = {accuracy}", "", accuracy) for accuracy in ACCURACIES]

    def _deformed(self, what: str, asked: str, accuracy: float) -> Row:
        frames = [deformed(frame) for frame in range(self.runs + 1)]
        solver = BoundaryElement(accuracy=accuracy, estimate=False)
        return self._frames(f"two fingers deformed, {what}", asked, solver, frames)

    def _factorised(self, what: str, asked: str, moved: Callable[[Bodies, int], Bodies]) -> Row:
        frames = [moved(self.rest, frame) for frame in range(self.runs + 1)]
        return self._frames(what, asked, self.factorised, frames)

    def whole_moved(self) -> Row:
        """Time a solved shape that moves as a whole: transfer matrix and drive again, no solve.

        The scattered field comes from a multipole expansion, computed once; the surface integral is
        timed beside it.
        """
        bodies = self.rest
        beacons = self.quick.radiate(bodies.scene, bodies.target.beacons())
        waves = multipole_expansion(beacons)

        def again(field: RadiatedField, frame: int) -> Made:
            transfer = transfer_matrix(field, self.array.seen_from(whole_motion(frame)))
            return Made(field.report, transfer, time_reversal(transfer, bodies.target))

        by_sum, _ = timed([partial(again, beacons, frame) for frame in range(self.runs + 1)])
        took, made = timed([partial(again, waves, frame) for frame in range(self.runs + 1)])
        seen = [self.array.seen_from(whole_motion(frame)) for frame in range(1, CHECKED)]
        errors = [self._errors(bodies, array, one) for array, one in zip(seen, made, strict=False)]
        row = self._row(
            "whole pinch moved rigidly, to drive", "2 ms for 2000 unknowns", took, made, errors
        )
        found, off = (
            waves.report.seconds["expansion"],
            float(waves.report.settings["expansion_error"]),
        )
        profile = f"{row.profile}; by the surface integral {by_sum}; expansion computed once in {1e3 * found:.3g} ms"
        return replace(row, error=f"{row.error}; expansion {off:.1e} off", profile=profile)

    def coded(self) -> Row:
        """Time the solve of two fingers for coded transmissions of the whole array, over that for two foci."""
        bodies, random = self.rest, np.random.default_rng(1)
        codes = Monopoles(
            self.array.positions, np.exp(2j * np.pi * random.random((len(self.array), CODES)))
        )
        foci, coded = (
            timed([partial(self.quick.radiate, bodies.scene, sources)] * (self.runs + 1))[0]
            for sources in (bodies.target.beacons(), codes)
        )
        return Row(
            f"two fingers, {CODES} coded transmissions of {len(self.array)} elements, solve only",
            "2.5 times two foci",
            f"{coded.median / foci.median:.2f} times: {coded}",
            "",
            f"two foci {foci}",
            {"seconds": coded.seconds, "ratio": coded.median / foci.median},
        )

    def slice_beside(self) -> Row:
        """Time the field of a drive on 200 x 200 points between and beside two fingers."""
        made = to_drive(self.quick, self.rest, self.array)
        scene, sources = self.rest.scene, drive_sources(self.array, [made.drive])
        field = BoundaryElement(accuracy=self.accuracy).radiate(scene, sources)
        points = slice_points()
        took, pressure = timed([partial(field.at, points)] * (self.runs + 1))
        outside = np.flatnonzero((scene.depth(points) < 0) & (np.arange(len(points)) % 37 == 0))
        reference = reference_pressure(self.rest, sources.positions, points[outside], self.folder)
        error = relative_error(pressure[0][outside].T, (reference.pressure @ sources.strengths).T)
        return Row(
            "field on 200 x 200 points beside two fingers",
            "40 ms, 3 %",
            f"{took}",
            f"{error:.2%} at {len(outside)} of the points (reference itself {reference.own_error:.2%})",
            f"{field.report.nodes} unknowns",
            {"seconds": took.seconds, "error": error, "unknowns": field.report.nodes},
        )

    def _frames(self, what: str, asked: str, solver: Solver, frames: Sequence[Bodies]) -> Row:
        took, made = timed([partial(to_drive, solver, bodies, self.array) for bodies in frames])
        checked = zip(frames[1 : CHECKED + 1], made, strict=False)
        return self._row(
            what,
            asked,
            took,
            made,
            [self._errors(bodies, self.array, one) for bodies, one in checked],
        )

    def _errors(self, bodies: Bodies, array: PhasedArray, made: Made) -> tuple[float, float, float]:
        """Error of the transfer matrix, correlation of the drive, and the reference's own error."""
        reference = reference_pressure(bodies, array.positions, bodies.foci, self.folder)
        return (
            *errors_of(made, array.element.sensitivity * reference.pressure, bodies),
            reference.own_error,
        )

    def _row(
        self,
        what: str,
        asked: str,
        took: Timed,
        made: Sequence[Made],
        errors: Sequence[tuple[float, float, float]],
    ) -> Row:
        worst, alike, own = (
            max(e[0] for e in errors),
            min(e[1] for e in errors),
            max(e[2] for e in errors),
        )
        return row_of(what, asked, took, made, (worst, alike), f"reference itself {own:.2%}")


def errors_of(
    made: Made, matrix: Complex128[np.ndarray, "foci elements"], bodies: Bodies
) -> tuple[float, float]:
    """Relative error of a transfer matrix, and correlation of its drive with that of the reference matrix."""
    exact = time_reversal(TransferMatrix(matrix, 0.0), bodies.target)
    return relative_error(made.transfer.matrix, matrix), correlation(
        made.drive.amplitudes, exact.amplitudes
    )


def row_of(
    what: str,
    asked: str,
    took: Timed,
    made: Sequence[Made],
    errors: tuple[float, float],
    against: str,
) -> Row:
    """Write a row from the error of the transfer matrix and the correlation of the drive."""
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
    """Write the median milliseconds of each step of the solves."""
    names = made[0].report.seconds
    laps = {name: np.median([one.report.seconds.get(name, 0.0) for one in made]) for name in names}
    return ", ".join(f"{name} {1e3 * lap:.1f}" for name, lap in laps.items()) + " ms"


def slice_points(side: int = 200, width: float = 60e-3) -> Real[np.ndarray, "points 3"]:
    """Points of a square in the plane of both fingers, their tips in its upper half (side², 3) [m]."""
    along = np.linspace(-0.5 * width, 0.5 * width, side)
    across, up = np.meshgrid(along, along - 0.3 * width)
    return np.stack([across.ravel(), np.full(side * side, 1e-4), up.ravel()], axis=1)


def scaled(hand: Hand, area: float = AREA) -> Hand:
    """Scale a hand to another area of skin [m²]."""
    for _ in range(3):  # the fillets between fingers do not scale with the joints alone
        size = np.sqrt(area / hand.surface.area)
        hand = hand_from_joints(hand.joints * size, hand.radii * size)
    return hand


@dataclass(frozen=True)
class OpenHand:
    """The rows of an open hand of any size in front of four boards; the folder is the cache of the reference."""

    hand: Hand
    folder: Path
    runs: int

    @cached_property
    def array(self) -> PhasedArray:
        """996 transducers around the hand, 1.6 times as far away as in the paper's box."""
        box, vertices = surrounding_box(monopole()), self.bodies.surfaces[0].vertices
        centre = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
        return PhasedArray(1.6 * box.positions + centre, box.normals, box.element)

    @cached_property
    def bodies(self) -> Bodies:
        """The hand with foci in front of the pads of index and middle finger."""
        hand = scaled(self.hand)
        pads = [hand.place(name) for name in ("index.pad", "middle.pad")]
        return Bodies(
            (hand.surface,), np.array([position + 0.5e-3 * normal for position, normal in pads])
        )

    @cached_property
    def reference(self) -> Reference:
        """Transfer matrix of an accurate solution, and the distance of a coarser one from it."""

        def compute() -> Reference:
            solvers = [BoundaryElement(accuracy=accuracy) for accuracy in (FINE, COARSER)]
            fine, coarser = (
                to_drive(solver, self.bodies, self.array).transfer.matrix for solver in solvers
            )
            return Reference(fine, relative_error(coarser, fine))

        shape = self.hand.joints, self.hand.radii
        return cached_reference(self.folder, f"open-hand-{FINE}-{COARSER}", shape, compute)

    def drive_only(self) -> Row:
        """Time the hand where only the drive is wanted."""
        return self._row(
            "open hand of 325 cm², drive only", "0.12 s, correlation 0.995", HAND_DRIVE_ACCURACY
        )

    def pressures(self) -> Row:
        """Time the hand where the pressures are wanted too."""
        return self._row("open hand of 325 cm²", "0.35 s, 3 %", HAND_ACCURACY)

    def _row(self, what: str, asked: str, accuracy: float) -> Row:
        job = partial(
            to_drive, BoundaryElement(accuracy=accuracy, estimate=False), self.bodies, self.array
        )
        took, made = timed([job] * (self.runs + 1))
        errors = errors_of(made[-1], self.reference.pressure, self.bodies)
        against = (
            f"against {FINE:.2%} asked, itself {self.reference.own_error:.2%} from {COARSER:.2%}"
        )
        return row_of(what, asked, took, made, errors, against)


GAPS = 6e-3, 20e-3
"""Gaps between thumb and index finger that the poses run through [m]."""

DISTANCE = 0.2
"""From the boards to the pads [m]."""

REFERENCE_ACCURACY = 0.01
"""Accuracy of the solution that rows are compared with."""

EVERY = 7
"""Of so many poses one is compared."""

Solve = Callable[[Float64[np.ndarray, "25 3"]], HandFactors]


@dataclass(frozen=True)
class Phalanges:
    """The rows of the packaged pinch before four boards; its poses open the fingers from one gap to another."""

    runs: int

    @cached_property
    def hand(self) -> Hand:
        """The hand between both gaps."""
        return load_hand(example("pinch.json")).open_to(float(np.mean(GAPS)))

    @cached_property
    def scene(self) -> LiveScene:
        """Foci 1 mm off both pads, 2 x 2 boards before them."""
        pads = self.hand.pads[:2].mean(axis=0)
        array = flat_boards(2, 2).facing(tuple(pads), (1.0, 0.0, 0.0), DISTANCE)
        places, offsets = ("thumb.pad", "index.pad"), np.full(2, 1e-3)
        return LiveScene(
            air(celsius=22), 40e3, array, self.hand.side, self.hand.radii, places, offsets
        )

    @cached_property
    def open_air(self) -> OpenAir:
        """What the elements bring to the foci without the hand."""
        return OpenAir(self.scene)

    def rigid(self) -> Row:
        """Time them as rigid bodies, each factorised once."""
        solver = PartSolver(self.scene)
        asked = "8 ms, correlation 0.995"
        return self._row(
            "factorised once", asked, lambda joints: solver.solved(joints, "phalanges", 0.0)
        )

    def meshed_anew(self) -> Row:
        """Time them as one body, whose panels are moved from a similar pose if there was one, which is what the live loop does for fingers that touch."""
        solver = PartSolver(self.scene)
        how = "as one body, on panels of a similar pose"
        asked = "8 ms, correlation 0.995"
        return self._row(how, asked, lambda joints: solver.meshed(joints, "phalanges", 0.0))

    def _poses(self) -> Sequence[Float64[np.ndarray, "25 3"]]:
        gaps = [GAPS[1], *np.linspace(*GAPS, self.runs)]  # the first one warms up
        return [self.hand.open_to(float(gap)).joints for gap in gaps]

    def _row(self, how: str, asked: str, solve: Solve) -> Row:
        def to_rows(joints: Float64[np.ndarray, "25 3"]) -> Complex128[np.ndarray, "foci elements"]:
            found = solve(joints)
            matrix = self.open_air.rows(found.foci) * found.factors
            time_reversal(TransferMatrix(matrix, 0.0), Target(found.foci))
            return matrix

        poses = self._poses()
        took, matrices = timed([partial(to_rows, joints) for joints in poses])
        compared = list(zip(poses[1:], matrices, strict=True))[::EVERY]
        alike = min(self._likeness(joints, matrix) for joints, matrix in compared)
        return Row(
            f"two last phalanges in a new pose, to the drive, {how}",
            asked,
            f"{took}",
            f"worst row of the transfer matrix: correlation {alike:.4f} (against {REFERENCE_ACCURACY:.0%})",
            numbers={"seconds": took.seconds, "correlation": alike},
        )

    def _likeness(
        self, joints: Float64[np.ndarray, "25 3"], matrix: Complex128[np.ndarray, "foci elements"]
    ) -> float:
        """Least correlation of a row with that of the same phalanges, solved more accurately as one body."""
        scene, posed = self.scene, pose_hand(self.scene, joints)
        body = Scene(
            scene.medium,
            [sound_hard(part_of(posed.hand, "phalanges", scene.places))],
            frequency=scene.frequency,
        )
        beacons = Target(beacon_points(scene, posed)).beacons()
        field = BoundaryElement(accuracy=REFERENCE_ACCURACY, estimate=False).radiate(body, beacons)
        fine = factors_of(scene, posed, "phalanges", 0.0, field.at(scene.array.positions)).factors
        exact = self.open_air.rows(posed.foci) * fine
        return min(correlation(one, other) for one, other in zip(matrix, exact, strict=True))
