"""A sequence of drives for moving foci."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from airtact.acoustics.target import Target
from airtact.drives.drive import Drive
from airtact.drives.methods import FOR_SAMPLES
from airtact.drives.motion import Motion, moving_foci, moving_target
from airtact.drives.sequence import Sequence
from airtact.drives.transfer import TransferMatrix
from airtact.setup.setup import Setup
from airtact.setup.solving import solve_foci, synthesise
from airtact.timing import Clock


@dataclass(frozen=True, eq=False)
class MovingDrive:
    """A sequence of drives for moving foci.

    Attributes
    ----------
    sequence : the sequence of drives.
    transfer, target : transfer matrix and target for all positions of the foci.
    weakest : (frames,) pressure at the weakest focus in each frame [Pa].
    warnings : warnings of methods that stopped early.
    """

    sequence: Sequence
    transfer: TransferMatrix
    target: Target
    weakest: Float64[np.ndarray, "frames"]
    warnings: tuple[str, ...]

    def save(self, path: Path, setup: Setup) -> None:
        """Write the sequence together with all data required to emit it."""
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
    if not motion.through_points(len(target.points)):
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
    pressures = np.abs(sequence.pressure(transfer))[:, :points]
    # The foci at one position are `together` adjacent columns.
    positions = np.arange(len(sequence)) * (points // together) // len(sequence)
    weakest = [
        row[position * together : (position + 1) * together].min()
        for row, position in zip(pressures, positions, strict=True)
    ]
    return MovingDrive(
        sequence,
        transfer,
        target,
        np.array(weakest),
        tuple(dict.fromkeys(stalled)),
    )


def paths_of(setup: Setup) -> Float64[np.ndarray, "paths frames 3"]:
    """Return the paths of the moving foci [m]; an empty list if they do not move."""
    motion = setup.motion
    foci = setup.target.points
    if motion is None:
        return np.empty((0, 0, 3))
    if motion.through_points(len(foci)):
        return foci[None]
    return motion.paths(setup.scene, setup.target, setup.array.positions.mean(axis=0))
