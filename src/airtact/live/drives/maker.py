"""Drives for a moving hand from the best solution at hand: the newest pose, and what was solved of poses like it."""

import time as clock
from collections.abc import Sequence
from itertools import chain

import numpy as np
from jaxtyping import Complex128, Float64

from airtact.conventions import InvalidInput
from airtact.hand.joints import joints_of
from airtact.live.drives.factors import HandFactors, OpenAir
from airtact.live.drives.library import PARTS, Library, expected_kept
from airtact.live.drives.riding import Riding, ride
from airtact.live.drives.solver_process import NICE, Asked, ShapeSolver, SolverProcess
from airtact.live.parts import Controls, DriveMaker, LiveScene, Moment
from airtact.scene.target import Target
from airtact.synthesis.gerchberg_saxton import weighted_gerchberg_saxton
from airtact.synthesis.methods import METHODS
from airtact.tracking.frame import HandFrame
from airtact.tracking.prediction import AGILITY, NOISE, Predictor
from airtact.transfer import Drive, TransferMatrix

STEP = 0.02
"""Time over which the velocity of the joints is taken from that of the landmarks [s]."""


class HandAware(DriveMaker):
    """Makes drives that know the hand.

    The transfer matrix of now is the open air matrix of now times the factors of the solution that is expected to keep
    most of the attainable pressure, out of all that were kept; or the open air matrix alone where that keeps more. A
    frame is smoothed and predicted by a Kalman filter. The method ``"best"`` is ``weighted_gerchberg_saxton`` here,
    which takes less than a millisecond and ends within a hundredth of it.

    Parameters
    ----------
    scene : what stays the same.
    noise : standard deviation of each coordinate of the tracker's landmarks [m].
    agility : how suddenly joints change their velocity, see ``Predictor`` [m²/s³].
    solvers : what solves hands; two processes unless given, one for the phalanges of the foci, one for the whole hand.

    Attributes
    ----------
    fault : the last sentence of what could not be solved, or None.
    solutions : how many came so far.
    """

    def __init__(
        self,
        scene: LiveScene,
        noise: float = NOISE,
        agility: float = AGILITY,
        solvers: Sequence[ShapeSolver] | None = None,
    ) -> None:
        self._scene, self._noise = scene, noise
        self._predictor = Predictor(0.0, noise, agility)
        self._open_air = OpenAir(scene)
        self._libraries = [Library(part) for part in PARTS]
        self._solvers = [SolverProcess(scene, parts) for parts in NICE] if solvers is None else list(solvers)
        self._newest: HandFrame | None = None
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
            for solver in self._solvers:
                solver.ask(asked)
            return self._drive(time, joints, controls)
        except InvalidInput as fault:
            self.fault = str(fault)
            return self._silent(time, self._newest.time)

    def close(self) -> None:
        """End the solvers."""
        for solver in self._solvers:
            solver.close()

    def _learn(self) -> None:
        for one in chain.from_iterable(solver.found() for solver in self._solvers):
            if isinstance(one, str):
                self.fault = one
            else:
                self.solutions += 1
                self._libraries[PARTS.index(one.part)].add(one)

    def _predicted(self, time: float) -> tuple[Float64[np.ndarray, "25 3"] | None, Float64[np.ndarray, "25 3"]]:
        """Predict joints and their velocities."""
        frame = self._predictor.at(time)
        if frame.landmarks is None:
            return None, np.zeros((25, 3))
        joints = joints_of(frame.landmarks)
        later = joints_of(frame.landmarks + STEP * self._predictor.velocities(), rough=1.0)
        return joints, (later - joints) / STEP

    def _drive(self, time: float, joints: Float64[np.ndarray, "25 3"], controls: Controls) -> Moment:
        riding = ride(self._scene, joints, controls.offset)
        kept, solution = float(expected_kept("distances", np.zeros(1), np.zeros(1), self._noise)[0]), None
        if not controls.ignore_hand:
            chances = [library.best(riding, self._noise) for library in self._libraries]
            kept, solution = max([(kept, solution), *chances], key=lambda chance: chance[0])
        rows = self._rows(riding, solution)
        transfer, target = TransferMatrix(rows, float("nan")), Target(riding.foci)
        amplitudes = self._method(controls.method or self._scene.method, transfer, target).amplitudes
        rule, age = ("distances", None) if solution is None else (solution.part, time - solution.time)
        frame_time = time if self._newest is None else self._newest.time
        moment = (time, frame_time, joints, riding.foci, amplitudes, np.abs(rows @ amplitudes))
        return Moment(*moment, rule=rule, shape_age=age, kept=kept)

    def _rows(self, riding: Riding, solution: HandFactors | None) -> Complex128[np.ndarray, "foci elements"]:
        """Pressure at the foci per unit drive of each element [Pa]."""
        rows = self._open_air.rows(riding.foci)
        return rows if solution is None else rows * solution.factors

    def _method(self, name: str, transfer: TransferMatrix, target: Target) -> Drive:
        if name == "best":
            return weighted_gerchberg_saxton(transfer, target)
        return METHODS[name](transfer, target)

    def _silent(self, time: float, frame_time: float) -> Moment:
        return Moment(time, frame_time, None, None, np.zeros(len(self._scene.array), np.complex128), state="waiting")
