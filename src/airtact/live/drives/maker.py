"""Drives for a moving hand from the best solution at hand: the newest pose, and what was solved of poses like it."""

import time as clock
from collections.abc import Sequence
from itertools import chain

import numpy as np
from jaxtyping import Complex128, Float64

from airtact.acoustics.target import Target
from airtact.drives.gerchberg_saxton import weighted_gerchberg_saxton
from airtact.drives.methods import FOR_SAMPLES, METHODS
from airtact.drives.transfer import TransferMatrix
from airtact.errors import InvalidInput
from airtact.hands.joints import joints_of
from airtact.hands.tracking.frame import HandFrame
from airtact.hands.tracking.prediction import AGILITY, Predictor
from airtact.live.drives.doubt import robust_drive
from airtact.live.drives.factors import HandFactors, OpenAir
from airtact.live.drives.library import PARTS, Library, expected_kept, worth_solving
from airtact.live.drives.moving import Rounds, turned_towards
from airtact.live.drives.riding import Riding, ride
from airtact.live.drives.solver_process import Asked, ShapeSolver, SolverProcess
from airtact.live.parts import Controls, DriveMaker, LiveScene, Moment, Rule

STEP = 0.02
"""Time over which the velocity of the joints is taken from that of the landmarks [s]."""


MANY = 3
"""Foci from which on the whole hand is solved and carried along: the palm's or a neighbour's part is too large then."""


def solved_for(scene: LiveScene) -> list[tuple[Rule, ...]]:
    """Choose what processes solve: one for phalanges and one for the whole hand, or one that does the latter often."""
    many = len(scene.places) >= MANY or "palm" in scene.places
    return [("carried",)] if many and scene.moving is None else [("phalanges",), ("hand",)]


class HandAware(DriveMaker):
    """Makes drives that know the hand.

    The transfer matrix of now is the open air matrix of now times the factors of the solution that
    is expected to keep most of the attainable pressure, out of all that were kept; or the open air
    matrix alone where that keeps more. Where noise lets no solution keep more, the solvers rest. A
    frame is smoothed and predicted by a Kalman filter. The method ``"best"`` is
    ``weighted_gerchberg_saxton`` here, which takes less than a millisecond and ends within a
    hundredth of it. "robust" and "robust_phase_only" are best for 16 samples of where the foci may
    be, as the filter doubts its prediction (8 where there are over 3 foci).

    Parameters
    ----------
    scene : what stays the same.
    noise : standard deviation of each coordinate of the tracker's landmarks [m]; found from the
        frames unless given.
    agility : how suddenly joints change their velocity, see ``Predictor`` [m²/s³].
    solvers : what solves hands; processes unless given, those of ``solved_for``.

    Attributes
    ----------
    fault : the last sentence of what could not be solved, or None.
    solutions : how many came so far.
    """

    def __init__(
        self,
        scene: LiveScene,
        noise: float | None = None,
        agility: float = AGILITY,
        solvers: Sequence[ShapeSolver] | None = None,
    ) -> None:
        self._scene = scene
        self._predictor = Predictor(0.0, noise, agility)
        self._open_air = OpenAir(scene)
        self._rounds = (
            None if scene.moving is None else Rounds(scene, scene.moving, self._open_air.rows)
        )
        self._libraries = [Library(part, scene) for part in PARTS]
        self._parts: list[Rule] = [part for parts in solved_for(scene) for part in parts]
        self._solvers = (
            [SolverProcess(scene, parts) for parts in solved_for(scene)]
            if solvers is None
            else list(solvers)
        )
        self._newest: HandFrame | None = None
        self._solved: float | None = None
        self._before = np.zeros(len(scene.array), dtype=np.complex128)
        self.fault: str | None = None
        self.solutions = 0

    def take(self, frame: HandFrame) -> None:
        """Take the tracker's newest frame; one that is not later than the one before, or of the other hand, is left."""
        newest = self._newest
        if frame.side != self._scene.side or (newest is not None and frame.time <= newest.time):
            return
        self._newest = frame
        self._predictor.take(frame)

    def make(self, time: float, controls: Controls) -> Moment:
        """Make the drive for sound that is in the air at a time [s]; zeros where there is no hand.

        Cap, modulation and ``playing`` are left to what emits.
        """
        self._learn()
        if self._newest is None:
            return self._silent(time, time)
        try:
            joints, velocities = self._predicted(time)
            if joints is None:
                return self._silent(time, self._newest.time)
            asked = Asked(time, joints, velocities, clock.monotonic())
            for solver in self._solvers if self._solves else ():
                solver.ask(asked)
            return self._drive(time, joints, controls)
        except InvalidInput as fault:
            self.fault = str(fault)
            return self._silent(time, self._newest.time)

    def close(self) -> None:
        """End the solvers."""
        for solver in self._solvers:
            solver.close()

    @property
    def _solves(self) -> bool:
        """Whether the solvers are asked; they rest where noise spoils what they find, as they make frames older."""
        return worth_solving(self._parts, self._predictor.noise, len(self._scene.places))

    def _learn(self) -> None:
        for one in chain.from_iterable(solver.found() for solver in self._solvers):
            if isinstance(one, str):
                self.fault = one
            else:
                self.solutions += 1
                self._solved = one.time if self._solved is None else max(self._solved, one.time)
                self._libraries[PARTS.index(one.part)].add(one)

    def _predicted(
        self, time: float
    ) -> tuple[Float64[np.ndarray, "25 3"] | None, Float64[np.ndarray, "25 3"]]:
        """Predict joints and their velocities."""
        frame = self._predictor.at(time)
        if frame.landmarks is None:
            return None, np.zeros((25, 3))
        joints = joints_of(frame.landmarks)
        later = joints_of(frame.landmarks + STEP * self._predictor.velocities(), tolerance=1.0)
        return joints, (later - joints) / STEP

    def _drive(
        self, time: float, joints: Float64[np.ndarray, "25 3"], controls: Controls
    ) -> Moment:
        riding = ride(self._scene, joints, controls.offset)
        noise = self._predictor.noise
        kept, solution = float(expected_kept("distances", np.zeros(1), np.zeros(1), noise)[0]), None
        if not controls.ignore_hand:
            chances = [library.best(riding, noise) for library in self._libraries]
            kept, solution = max([(kept, solution), *chances], key=lambda chance: chance[0])
        rows = self._rows(riding, solution)
        method = controls.method or self._scene.method
        self._before = amplitudes = turned_towards(
            self._made(method, rows, riding.foci, time), self._before
        )
        frames = None
        if self._rounds is not None:
            frames = self._rounds.frames(riding, solution and solution.factors[len(rows) :], method)
        rule, age = (
            ("distances", None) if solution is None else (solution.part, time - solution.time)
        )
        frame_time = time if self._newest is None else self._newest.time
        pressures = np.abs(self._scene.sounding.folded(rows) @ amplitudes)
        moment = (time, frame_time, joints, riding.foci, amplitudes, pressures)
        behind = None if self._solved is None or not self._solves else time - self._solved
        return Moment(*moment, rule=rule, shape_age=age, behind=behind, kept=kept, frames=frames)

    def _rows(
        self, riding: Riding, solution: HandFactors | None
    ) -> Complex128[np.ndarray, "foci sounding"]:
        """Pressure at the foci per unit drive of each element and each image in a plane [Pa]."""
        rows = self._open_air.rows(riding.foci)
        return rows if solution is None else rows * solution.at(self._scene, riding)

    def _made(
        self,
        name: str,
        rows: Complex128[np.ndarray, "foci sounding"],
        foci: Float64[np.ndarray, "foci 3"],
        time: float,
    ) -> Complex128[np.ndarray, "elements"]:
        """Make the amplitudes of the elements by a method; those for samples get the predictor's doubt."""
        if name in FOR_SAMPLES:
            spread = self._predictor.spread(time)
            return robust_drive(self._scene, rows, foci, spread, phases=name == "robust_phase_only")
        method = weighted_gerchberg_saxton if name == "best" else METHODS[name]
        folded = self._scene.sounding.folded(rows)
        return method(TransferMatrix(folded, float("nan")), Target(foci)).amplitudes

    def _silent(self, time: float, frame_time: float) -> Moment:
        return Moment(
            time,
            frame_time,
            None,
            None,
            np.zeros(len(self._scene.array), np.complex128),
            state="waiting",
        )
