"""A sequence of drives for moving foci."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Complex128, Float64

from airtact.acoustics.target import Target
from airtact.drives.drive import Amplitudes, Drive
from airtact.drives.methods import FOR_SAMPLES
from airtact.drives.motion import Motion, longest_path, moving_foci, moving_target
from airtact.drives.sequence import Sequence
from airtact.drives.transfer import TransferMatrix
from airtact.evaluation.metrics import at_weakest, drive_sources, in_real_air, sensation
from airtact.evaluation.steepening import Steepening, steepening
from airtact.setup.setup import Setup
from airtact.setup.solving import rounding, solve_foci, synthesise
from airtact.timing import Clock


@dataclass(frozen=True, eq=False)
class MovingDrive:
    """A sequence of drives for moving foci, which ``render`` returns in ``Rendering.sequence``.

    Attributes
    ----------
    sequence : the ``Sequence`` of drives, with its frame rate.
    transfer, target : transfer matrix and target for all P positions of the foci: those of all foci
        in the first frame, then those in the next frame, and so on.
    pressures : (P,) peak pressure at each position while a focus is there, by linear acoustics
        [Pa].
    steepening : effect of nonlinear steepening on ``pressures``. The motion of the foci is
        ignored.
    rounding : (P,) factors by which rounding to the setup's levels multiplies ``pressures``.
    warnings : sentences about methods that stopped early.
    speed : mean speed of the fastest focus along its path [m/s]; None for lateral modulation, which
        moves each focus only within its own area.
    """

    sequence: Sequence
    transfer: TransferMatrix
    target: Target
    pressures: Float64[np.ndarray, "positions"]
    steepening: Steepening
    rounding: Float64[np.ndarray, "positions"]
    warnings: tuple[str, ...]
    speed: float | None

    @property
    def expected(self) -> Float64[np.ndarray, "positions"]:
        """(P,) pressure reduced by nonlinear steepening [Pa]; NaN where it is unknown."""
        return self.pressures * self.steepening.kept

    @property
    def drives(self) -> Complex128[np.ndarray, "positions elements"]:
        """(P, E) amplitudes of the elements for each of P positions, if only one focus moves."""
        # Short paths repeat every position.
        return self.sequence.drives[:: len(self.sequence) // len(self.target.points)]

    def sentences(self, foci: tuple[str, ...] = ()) -> tuple[str, ...]:
        """State the pressure at the weakest position, and any noticeable nonlinear steepening."""
        # Where the estimate is invalid, the linear pressure is far above the threshold.
        felt = self.rounding * np.fmin(self.pressures, self.expected)
        words = at_weakest(self.pressures, self.target, foci)
        if abs(self.rounding[self.target.weakest(self.pressures)] - 1.0) > 0.1:
            emitted = at_weakest(self.rounding * self.pressures, self.target, foci)
            words += f"; as emitted, rounded to the boards' levels: {emitted}"
        names = foci
        if foci and len(foci) < len(self.pressures):
            frames = len(self.pressures) // len(foci)
            names = tuple(
                f"{name} in frame {frame + 1}" for frame in range(frames) for name in foci
            )
        return (
            f"The foci move in {len(self.sequence)} frames, with {words}.",
            *in_real_air(self.pressures, self.target, self.steepening, names),
            sensation(
                float(felt[self.target.weights > 0.0].min()), "spatiotemporal", speed=self.speed
            ),
        )

    def save(self, path: Path, setup: Setup) -> None:
        """Write or replace a .h5 file with the sequence and all data required to emit it."""
        self.sequence.save(
            path,
            setup.array,
            setup.scene,
            self.transfer,
            self.target,
            levels=setup.levels,
            texts={"scene": setup.text},
        )


def moving_drive(
    setup: Setup, motion: Motion, transfer: TransferMatrix, clock: Clock, store: Path | None
) -> MovingDrive:
    """Compute the sequence for moving foci; ``transfer`` is the matrix for the foci at rest."""
    # All positions are foci of one transfer matrix, so the whole path requires a single solve.
    target = setup.target
    paths = paths_of(setup)
    turns = motion.turns(paths)
    together = 1
    if not setup.in_turn:
        together = len(target.points)
        target = moving_target(target, paths)
        moved = replace(
            setup,
            target=target,
            uncertainty=setup.uncertainty if setup.method in FOR_SAMPLES else None,
            foci=(),
            riding=(),
        )
        transfer, _ = solve_foci(moved, clock, store)
    stalled: list[str] = []

    def method(rows: TransferMatrix, alone: Target) -> Drive:
        drive, notes = synthesise(setup.synthesise, rows, alone)
        stalled.extend(notes)
        return drive

    points = len(target.points)
    with clock.step("sequence", f"computing the drives of foci at {points} positions"):
        sequence = moving_foci(transfer, target, together, turns, method, clock=setup.frequency)
    with clock.step("air", "estimating nonlinear steepening at the moving foci"):
        pressures = []
        effects = []
        factors = []
        # Short paths repeat every position, and the foci of a frame are adjacent points.
        drives = sequence.drives[:: len(sequence) * together // points]
        for drive, focus in zip(drives, range(0, points, together), strict=True):
            here = slice(focus, focus + together)
            rows = transfer.matrix[here]
            pressures.append(np.abs(rows @ drive))
            factors.append(rounding(rows, drive, setup.levels, target.weights[here]))
            effects.append(_steepening(setup, drive, target.points[here], pressures[-1]))
    return MovingDrive(
        sequence,
        transfer,
        target,
        np.concatenate(pressures),
        Steepening(*np.concatenate(effects, axis=1)),
        np.concatenate(factors),
        tuple(dict.fromkeys(stalled)),
        None if motion.kind == "lm" else turns * longest_path(paths),
    )


def drives_at_foci(
    setup: Setup, transfer: TransferMatrix, target: Target
) -> Complex128[np.ndarray, "foci elements"]:
    """Return, for each focus, the drive that produces it, as an array (F, E).

    The drive is the same for all foci, unless one focus moves through all points.
    """
    if not setup.in_turn:
        return np.tile(setup.synthesise(transfer, target).amplitudes, (len(target.points), 1))
    # Each point is a frame, which may be repeated.
    sequence = moving_foci(transfer, target, 1, 1.0, setup.synthesise)
    return sequence.drives[:: len(sequence) // len(target.points)]


def pressures_of(
    transfer: TransferMatrix, drives: list[Complex128[np.ndarray, "foci elements"]]
) -> dict[str, Float64[np.ndarray, "drives foci"]]:
    """Return the pressures [Pa] at the foci for each normalisation, such as "equal peak".

    Each item of ``drives`` contains one drive per focus (see ``drives_at_foci``). For equal peak or
    equal energy, all drives of an item are scaled by the same factor.
    """
    rows = transfer.matrix[: len(drives[0])]

    def pressures(
        amplitudes: Complex128[np.ndarray, "foci elements"],
    ) -> Float64[np.ndarray, "foci"]:
        return np.abs(np.einsum("fe,fe->f", rows, amplitudes))

    strongest = [amplitudes / np.abs(amplitudes).max() for amplitudes in drives]
    norms = [float(np.linalg.norm(amplitudes)) for amplitudes in strongest]
    phases = [np.exp(1j * np.angle(amplitudes)) * (amplitudes != 0.0) for amplitudes in drives]
    equal_peak = np.stack([pressures(amplitudes) for amplitudes in strongest])
    return {
        "equal peak": equal_peak,
        "equal energy": equal_peak * (min(norms) / np.array(norms))[:, None],
        "phase only": np.stack([pressures(amplitudes) for amplitudes in phases]),
    }


def _steepening(
    setup: Setup,
    drive: Amplitudes,
    points: Float64[np.ndarray, "foci 3"],
    pressures: Float64[np.ndarray, "foci"],
) -> Float64[np.ndarray, "3 foci"]:
    """Return ``second``, ``depletion`` and ``doubt`` at the foci of a drive; 0 if it is silent."""
    if not (setup.array.gains * drive).any():
        return np.zeros((3, len(points)))
    effect = steepening(
        setup.scene, drive_sources(setup.array, [Drive(drive)], setup.scene), points, pressures
    )
    return np.stack([effect.second, effect.depletion, effect.doubt])


def paths_of(setup: Setup) -> Float64[np.ndarray, "paths frames 3"]:
    """Return the paths of the moving foci [m]; an empty array if the foci do not move."""
    motion = setup.motion
    foci = setup.target.points
    if motion is None:
        return np.empty((0, 0, 3))
    if setup.in_turn:
        return foci[None]
    return motion.paths(setup.scene, setup.target, setup.array.positions.mean(axis=0))
