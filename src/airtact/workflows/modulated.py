"""What makes a run's drive perceptible: the sequence of foci that move, and the level above the threshold."""

from collections.abc import Sequence as Listed
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from airtact.acoustics.target import Target
from airtact.drives.methods import FOR_SAMPLES
from airtact.drives.motion import Motion, moving_foci, moving_target
from airtact.drives.sequence import Sequence
from airtact.drives.transfer import Drive, TransferMatrix
from airtact.evaluation.thresholds import sensation
from airtact.setup.building import Setup
from airtact.setup.steps import FELT, solve_foci, synthesise, with_skin
from airtact.timing import Clock
from airtact.transducers.modulation import AmplitudeModulation


def write_sequence(
    path: Path, setup: Setup, transfer: TransferMatrix, clock: Clock, store: Path | None
) -> tuple[Float64[np.ndarray, "frames"] | None, tuple[str, ...]]:
    """Make and save the sequence of a scene whose foci move.

    Returns
    -------
    The pressure at the weakest focus in each frame [Pa], None where no focus moves; and what the method noted.
    """
    motion = setup.modulation
    if not isinstance(motion, Motion):
        return None, ()
    target, together, paths = setup.target, 1, paths_of(setup)
    turns = motion.turns(paths)
    if not motion.through_points(len(target.points)):
        together, target = len(target.points), moving_target(target, paths)
        doubt = setup.uncertainty if setup.method in FOR_SAMPLES else None
        transfer, _ = solve_foci(replace(setup, target=target, uncertainty=doubt), clock, store)
    notes: list[str] = []

    def method(rows: TransferMatrix, alone: Target) -> Drive:
        drive, found = synthesise(setup.synthesise, rows, alone)
        notes.extend(found)
        return drive

    with clock.step("sequence", f"making the drives of foci at {len(target.points)} positions"):
        sequence = moving_foci(transfer, target, together, turns, method, clock=setup.frequency)
        sequence.save(
            path, setup.array, setup.scene, transfer, target, setup.levels, {"scene": setup.text}
        )
    return _weakest(sequence, transfer, len(target.points), together), tuple(dict.fromkeys(notes))


def paths_of(setup: Setup) -> Float64[np.ndarray, "paths frames 3"]:
    """Return the paths that the foci of a scene run along [m]; none where they stand still."""
    motion, foci = setup.modulation, setup.target.points
    if not isinstance(motion, Motion):
        return np.empty((0, 0, 3))
    if motion.through_points(len(foci)):
        return foci[None]
    return motion.paths(setup.scene, setup.target, setup.array.positions.mean(axis=0))


def _weakest(
    sequence: Sequence, transfer: TransferMatrix, points: int, together: int
) -> Float64[np.ndarray, "frames"]:
    """Return the pressure at the weakest of the foci that are asked for in each frame [Pa]."""
    pressures = np.abs(sequence.pressure(transfer))[:, :points]
    frames = np.arange(len(sequence)) * (points // together) // len(sequence)
    return np.stack(
        [
            row[frame * together : (frame + 1) * together].min()
            for row, frame in zip(pressures, frames, strict=True)
        ]
    )


def sensations(
    setup: Setup, reached: Float64[np.ndarray, "foci"], moving: Float64[np.ndarray, "frames"] | None
) -> Listed[str]:
    """Say how far the foci are above the threshold of detection: still ones, or in the weakest of their frames.

    Foci where no skin is modelled do not count; where all are such, that is said instead.
    """
    skin = with_skin(setup)
    if not skin.any():
        return (
            f"No body is within {1e3 * FELT:g} mm of a focus: nobody is modelled there who could feel it.",
        )
    reached = reached[skin]
    if moving is not None:
        return (
            f"The foci move: {len(moving)} frames, the weakest focus of which gets {moving.min():,.0f} Pa.",
            sensation(float(moving.min()), "spatiotemporal"),
        )
    if isinstance(setup.modulation, AmplitudeModulation):
        return (sensation(float(reached.min()), "amplitude", setup.modulation.depth),)
    return (sensation(float(reached.min()), None),)
