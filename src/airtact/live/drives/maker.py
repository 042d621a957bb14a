"""Drives for a moving hand, from the newest pose and the best available solution."""

import time as clock
from collections.abc import Sequence
from functools import cache

import numpy as np
from jaxtyping import Complex128, Float64
from scipy.special import ndtri

from airtact.acoustics.target import Target
from airtact.drives.gerchberg_saxton import weighted_gerchberg_saxton
from airtact.drives.methods import FOR_SAMPLES, METHODS
from airtact.drives.robust_drives import balanced, improved
from airtact.drives.transfer import TransferMatrix
from airtact.errors import InvalidInput
from airtact.hands.joints import joints_of
from airtact.hands.tracking.frame import HandFrame
from airtact.hands.tracking.prediction import AGILITY, Predictor
from airtact.live.drives.factors import OpenAir
from airtact.live.drives.library import Library, expected_kept, worth_solving
from airtact.live.drives.moving import Rounds, phasors, turned_towards
from airtact.live.drives.solver_process import Request, SolverProcess
from airtact.live.moment import Controls, DriveMaker, Moment, Rule, silent_moment
from airtact.live.scene import Amplitudes, Foci, Joints, LiveScene, Rows, pose_hand


def solved_for(scene: LiveScene) -> list[Rule]:
    """Return the parts to solve, each in its own process: phalanges and hand, or carried hands."""
    # With three foci, or one at the palm, scattering by the other fingers and the palm matters.
    many = len(scene.places) >= 3 or "palm" in scene.places
    return ["carried"] if many and scene.moving is None else ["phalanges", "hand"]


class HandAware(DriveMaker):
    """Maker of drives that account for the hand.

    The transfer matrix is the open-air matrix of the present pose times the factors of the stored
    solution with the largest expected pressure. The open-air matrix alone is used if it is expected
    to give more. The solvers pause while noise makes all solutions useless. A Kalman filter smooths
    and predicts the frames.

    The method ``"best"`` is ``weighted_gerchberg_saxton`` here, which takes less than a millisecond
    and comes within 1 % of it. "robust" and "robust_phase_only" are optimised for 16 samples of the
    positions of the foci, drawn from the uncertainty of the prediction (8 samples for more than 3
    foci).

    Parameters
    ----------
    scene : the fixed part of the scene.
    noise : standard deviation of each coordinate of the tracker's landmarks [m]; estimated from the
        frames by default.
    agility : spectral density of the acceleration of joints, see ``Predictor`` [m²/s³].
    solvers : solvers of hands; by default the processes of ``solved_for``. Without solvers, phases
        are set from path lengths alone.

    Attributes
    ----------
    fault : message of the last pose that could not be solved, or None.
    solutions : number of solutions so far.
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
        self._rounds: Rounds | None = None
        if scene.moving is not None:
            self._rounds = Rounds(scene, scene.moving, self._open_air.rows)
        self._parts = solved_for(scene)
        self._libraries = {part: Library(part, scene) for part in self._parts}
        if solvers is None:
            solvers = [SolverProcess(scene, part) for part in self._parts]
        self._solvers = list(solvers)
        self._newest: HandFrame | None = None
        self._solved: float | None = None  # time of the newest solved pose
        self._previous = np.zeros(len(scene.array), dtype=np.complex128)
        self.fault: str | None = None
        self.solutions = 0

    def take(self, frame: HandFrame) -> None:
        """Take the tracker's newest frame; older frames and those of the other hand are ignored."""
        newest = self._newest
        if frame.side != self._scene.side or (newest is not None and frame.time <= newest.time):
            return
        self._newest = frame
        self._predictor.take(frame)

    def make(self, time: float, controls: Controls) -> Moment:
        """Make the drive for sound that is in the air at a time [s]; zeros if there is no hand.

        The loop applies cap, modulation and ``playing``.
        """
        self._collect()
        if self._newest is None:
            return silent_moment(self._scene, time, time)
        try:
            frame = self._predictor.at(time)
            if frame.landmarks is None:
                return silent_moment(self._scene, time, self._newest.time)
            joints = joints_of(frame.landmarks)
            # Velocities of the joints from the motion of the landmarks within 20 ms.
            later = frame.landmarks + 0.02 * self._predictor.velocities()
            velocities = (joints_of(later, tolerance=1.0) - joints) / 0.02
            if self._solving:
                request = Request(time, joints, velocities, clock.monotonic())
                for solver in self._solvers:
                    solver.ask(request)
            return self._drive(time, self._newest.time, joints, controls)
        except InvalidInput as fault:
            self.fault = str(fault)
            return silent_moment(self._scene, time, self._newest.time)

    def close(self) -> None:
        """End the solvers."""
        for solver in self._solvers:
            solver.close()

    @property
    def _solving(self) -> bool:
        """Whether the solvers work; they pause while noise makes their solutions useless."""
        return worth_solving(self._parts, self._predictor.noise, len(self._scene.places))

    def _collect(self) -> None:
        for solver in self._solvers:
            for solution in solver.solutions():
                if isinstance(solution, str):
                    self.fault = solution
                    continue
                self.solutions += 1
                newest = solution.time if self._solved is None else self._solved
                self._solved = max(newest, solution.time)
                self._libraries[solution.part].add(solution)

    def _drive(self, time: float, frame_time: float, joints: Joints, controls: Controls) -> Moment:
        posed = pose_hand(self._scene, joints, controls.offset)
        # Open air competes with the best solution of each library.
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
        # A jump of the global phase has no effect at the foci, but the boards would click.
        amplitudes = turned_towards(self._made(method, rows, posed.foci, time), self._previous)
        self._previous = amplitudes
        frames = None
        if self._rounds is not None:
            factors = None if solution is None else solution.factors[len(rows) :]
            frames = self._rounds.frames(posed, factors, method)
        behind = None if self._solved is None or not self._solving else time - self._solved
        return Moment(
            time=time,
            frame_time=frame_time,
            joints=joints,
            foci=posed.foci,
            amplitudes=amplitudes,
            pressures=np.abs(self._scene.with_images.folded(rows) @ amplitudes),
            rule="distances" if solution is None else solution.part,
            shape_age=None if solution is None else time - solution.time,
            behind=behind,
            kept=kept,
            frames=frames,
        )

    def _made(self, name: str, rows: Rows, foci: Foci, time: float) -> Amplitudes:
        if name in FOR_SAMPLES:
            spread = self._predictor.spread(time)
            return robust_drive(self._scene, rows, foci, spread, name == "robust_phase_only")
        method = weighted_gerchberg_saxton if name == "best" else METHODS[name]
        folded = self._scene.with_images.folded(rows)
        return method(TransferMatrix(folded, float("nan")), Target(foci)).amplitudes


def off_by(spread: float) -> float:
    """Return the assumed deviation of each focus along each axis [m] for a spread [m]."""
    # Foci deviate relative to each other by a third of the spread (0.27 to 0.39 for 1 and 2 mm of
    # noise, in the box and in front of the flat boards of benchmarks/live.py). Their common
    # deviation is larger, but matters less.
    off = spread / 3.0
    # Foci within 0.2 mm count as certain, and no drive can compensate for more than 1.5 mm.
    return 0.0 if off < 0.2e-3 else min(off, 1.5e-3)


def robust_drive(
    scene: LiveScene, rows: Rows, foci: Foci, spread: float, phase_only: bool
) -> Amplitudes:
    """Return the drive whose weakest focus keeps most pressure in the worst tenth of the poses.

    Parameters
    ----------
    scene : its array, medium and frequency are used.
    rows : (F, R) pressure at the expected foci per unit drive of each element and image [Pa].
    foci : (F, 3) expected foci [m].
    spread : standard deviation of each coordinate of the prediction [m].
    phase_only : whether every element is at full scale; otherwise the drive is optimal at equal
        energy.

    Returns
    -------
    (E,) amplitudes, the largest of magnitude 1; for certain foci the drive that maximises the
    weakest focus.
    """
    folded = scene.with_images.folded
    expected = folded(rows)
    if phase_only:
        transfer = TransferMatrix(expected, float("nan"))
        start = weighted_gerchberg_saxton(transfer, Target(foci)).amplitudes
    else:
        start = balanced(expected, False, 30)
    # Improve ``start`` for samples of the positions of the foci, unless they are certain.
    off = off_by(spread)
    if not off:
        return start / np.abs(start).max()
    samples = folded(displaced(scene, rows, foci, off))
    return improved(samples, start, "phases" if phase_only else "energy")


def displaced(
    scene: LiveScene, rows: Rows, foci: Foci, off: float
) -> Complex128[np.ndarray, "samples foci sources"]:
    """Return samples of the rows of foci that deviate by ``off`` (rms) along each axis [m].

    The effect of the hand moves with the foci. Elements are far away compared with ``off``, so the
    phase changes only by the shift along the direction of the element.
    """
    directions = foci[:, None] - scene.with_images.array.positions
    directions = directions / np.linalg.norm(directions, axis=2, keepdims=True)
    shifts = scene.wavenumber.real * off * _deviations(len(foci))
    delay = np.einsum(
        "sfd,fed->sfe", shifts.astype(np.float32), directions.astype(np.float32), optimize=True
    )
    return rows * phasors(delay)


@cache
def _deviations(foci: int) -> Float64[np.ndarray, "samples foci 3"]:
    """Draw antithetic deviations of unit variance from scrambled Sobol points."""
    from scipy.stats import qmc

    pairs = 8 if foci <= 3 else 4  # 48 rows in total take a millisecond or two
    numbers = qmc.Sobol(3 * foci, scramble=True, rng=np.random.default_rng(0)).random(pairs)
    normal = ndtri(np.clip(numbers, 1e-6, 1.0 - 1e-6))
    return np.concatenate([normal, -normal]).reshape(2 * pairs, foci, 3)
