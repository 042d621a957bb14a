"""Drives for a moving hand, computed from the newest pose and the best available solution."""

import time as clock
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

import airtact as at
from airtact.errors import InvalidInput
from airtact.hands.joints import completed
from airtact.hands.tracking.frame import HandFrame
from airtact.hands.tracking.prediction import AGILITY, Predictor
from airtact.live.drives.factors import OpenAir
from airtact.live.drives.library import Library, expected_kept, worth_solving
from airtact.live.drives.moving import Rounds, turned_towards
from airtact.live.drives.solver_process import Request, SolverProcess
from airtact.live.drives.strengths import balanced
from airtact.live.moment import Controls, DriveMaker, Moment, Rule, silent_moment
from airtact.live.scene import Joints, LiveScene, pose_hand


def solved_for(scene: LiveScene) -> list[Rule]:
    """Return the parts of the hand for which separate processes compute the scattering."""
    # With three foci, or with one at the palm, scattering by other fingers and the palm matters.
    many = len(scene.places) >= 3 or "palm" in scene.places
    return ["carried"] if many and scene.moving is None else ["phalanges", "hand"]


def predicted_joints(predictor: Predictor, time: float) -> tuple[Joints, Joints] | None:
    """Return the joints (25, 3) [m] and their velocities (25, 3) [m/s] predicted for ``time`` [s].

    None is returned if no hand is seen. Whether the joints form a hand is not checked.
    """
    landmarks = predictor.at(time).landmarks
    if landmarks is None:
        return None
    return completed(landmarks), completed(predictor.velocities(time))


class SolvingMaker(DriveMaker):
    """Base class for drive makers that compute the scattering from hands in separate processes."""

    def __init__(self, solvers: Sequence[SolverProcess]) -> None:
        self._solvers = list(solvers)
        self.fault: str | None = None
        self.solutions = 0

    def collected(self) -> Iterator[Any]:
        """Yield all solutions that have arrived since the last call; ``fault`` records faults."""
        for solver in self._solvers:
            for solution in solver.solutions():
                if isinstance(solution, str):
                    self.fault = solution
                else:
                    self.solutions += 1
                    yield solution

    def revive(self) -> int:
        """Restart solvers that have ended; return the number of restarts so far."""
        return sum(solver.revive() for solver in self._solvers)

    def close(self) -> None:
        """End the solvers."""
        for solver in self._solvers:
            solver.close()


class HandAware(SolvingMaker):
    """Compute drives for foci at fixed places of a hand, including scattering by the hand.

    This is the ``DriveMaker`` that ``run`` uses for one hand without virtual objects. The live loop
    passes each frame of the tracker to ``take`` and requests each drive from ``make``; ``follow``
    calls ``close`` at the end. A Kalman filter predicts the hand for the time at which the sound
    arrives.

    Solver processes continuously compute the scattering for the newest poses. Each solution is
    stored as factors: the ratio of each entry of the transfer matrix with the hand to that in open
    air. For a drive, the open-air matrix of the predicted pose is multiplied by the factors of the
    stored pose that is most similar to it. If all stored poses are so different that the open-air
    matrix alone is expected to produce a larger pressure, the factors are omitted. The solvers
    pause while the tracker's noise is so large that no solution can increase the pressure.

    If the scene's method is "best", ``weighted_gerchberg_saxton`` is used instead. It takes less
    than 1 ms, and reaches a pressure within 1 % of that of the function ``best``.

    Parameters
    ----------
    scene : the parts of the scene that stay fixed during the run, as returned by ``live_scene``.
    noise : standard deviation of each coordinate of the tracker's landmarks [m], above 0; by
        default, it is estimated from the frames.
    agility : standard deviation of the acceleration of the palm [m/s²], above 0; see ``Predictor``.
    solvers : solver processes; by default, one for the whole hand and, for one or two foci on
        fingers, another for the last phalanges. If the sequence is empty, only the open-air
        matrix is used. ``close`` ends them.

    Attributes
    ----------
    fault : message about the last pose for which no solution or no drive could be computed, even if
        later poses had no fault; None if there was no such pose.
    solutions : number of solutions that have been computed since the start.

    Raises
    ------
    InvalidInput
        If ``noise`` or ``agility`` is not above zero.
    """

    def __init__(
        self,
        scene: LiveScene,
        noise: float | None = None,
        agility: float = AGILITY,
        solvers: Sequence[SolverProcess] | None = None,
    ) -> None:
        self._scene = scene
        self._predictor = Predictor(0.0, noise, agility)
        self._open_air = OpenAir(scene)
        moving = scene.moving
        self._rounds = None if moving is None else Rounds(scene, moving, self._open_air.rows)
        self._parts = solved_for(scene)
        self._libraries = {part: Library(part, scene) for part in self._parts}
        if solvers is None:
            solvers = [SolverProcess(scene, part) for part in self._parts]
        super().__init__(solvers)
        self._newest: HandFrame | None = None
        self._previous = np.zeros(len(scene.array), dtype=np.complex128)
        self._rejected: dict[str, str] = {}

    def take(self, frame: HandFrame) -> None:
        """Process the tracker's newest frame; frames of the other hand are ignored.

        Raises
        ------
        InvalidInput
            If the frame is not later than the previous one.
        """
        if frame.side != self._scene.side or frame.landmarks is None:
            return
        self._predictor.take(frame)
        self._newest = frame

    def feel(
        self, objects: "Sequence[at.VirtualObject]", foci: "Sequence[at.live.WantedFocus]"
    ) -> None:
        """Reject all requested foci, because this maker uses the foci of the scene."""
        reason = "the scene has fixed [[foci]]: remove them, or add [[objects]]."
        self._rejected = {focus.name: reason for focus in foci}

    def make(self, time: float, controls: Controls) -> Moment:
        """Compute the drive whose sound will be in the air at ``time`` [s].

        All amplitudes are 0 if no hand is seen. The live loop then applies the cap and
        the modulation, and silences the drive unless ``controls.playing`` is True.
        """
        for solution in self.collected():
            self._libraries[solution.part].add(solution)
        if self._newest is None:
            return silent_moment(self._scene, time, time)
        try:
            predicted = predicted_joints(self._predictor, time)
            if predicted is None:
                return silent_moment(self._scene, time, self._newest.time)
            joints, velocities = predicted
            # Pause the solvers while noise makes their solutions useless.
            places = len(self._scene.places)
            noise = self._predictor.noise
            if not controls.ignore_hand and worth_solving(self._parts, noise, places):
                request = Request(time, joints, velocities, clock.monotonic())
                for solver in self._solvers:
                    solver.ask(request)
            return self._drive(time, self._newest.time, joints, controls)
        except InvalidInput as fault:
            self.fault = str(fault)
            return silent_moment(self._scene, time, self._newest.time)

    def _drive(self, time: float, frame_time: float, joints: Joints, controls: Controls) -> Moment:
        posed = pose_hand(self._scene, joints, controls.offset)
        # Open air competes with the best solution from each library.
        noise = self._predictor.noise
        kept = float(expected_kept("distances", np.zeros(1), np.zeros(1), noise)[0])
        solution = None
        if not controls.ignore_hand:
            for library in self._libraries.values():
                share, candidate = library.best(posed, noise)
                if share > kept:
                    kept = share
                    solution = candidate
        rows = self._open_air.rows(posed.foci)
        if solution is not None:
            rows = rows * solution.at(self._scene, posed)
        method = controls.method or self._scene.method
        # A jump of the global phase has no effect at the foci, but makes the boards click.
        strengths = np.array([controls.levels.get(place, 1.0) for place in self._scene.places])
        made = balanced(self._scene, method, rows, posed.foci, strengths)
        amplitudes = turned_towards(made, self._previous)
        self._previous = amplitudes
        frames = None
        if self._rounds is not None:
            factors = None if solution is None else solution.factors[len(rows) :]
            frames = self._rounds.frames(posed, factors, method)
        return Moment(
            time=time,
            frame_time=frame_time,
            joints=joints,
            foci=posed.foci,
            amplitudes=amplitudes,
            pressures=np.abs(self._scene.with_images.folded(rows) @ amplitudes),
            rule="distances" if solution is None else solution.part,
            shape_age=None if solution is None else time - solution.time,
            kept=kept,
            frames=frames,
            rate=0.0 if self._scene.moving is None else self._scene.moving.rate,
            names=self._scene.places,
            strengths=strengths,
            rejected=self._rejected,
        )
