"""Steps of a rendering: beacons, transfer matrix, drive, control and verification."""

import re
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from jaxtyping import Complex128, Float64

import airtact as at
from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.bem.solver import (
    BFLOAT16_ACCURACY,
    OF_THE_DIRECT,
    BoundaryElement,
    SharedPanels,
)
from airtact.acoustics.solvers.problem import FreeField, RadiatedField, Solver, SolveReport
from airtact.acoustics.sources import Monopoles
from airtact.acoustics.target import Target
from airtact.drives.drive import Drive, quantise
from airtact.drives.max_min import Stalled
from airtact.drives.methods import FOR_SAMPLES, method_for
from airtact.drives.transfer import TransferMatrix, open_air_matrix, transfer_to
from airtact.errors import counted, of_kind
from airtact.evaluation.comparison import body_word
from airtact.setup.setup import Setup
from airtact.timing import Clock
from airtact.transducers.levels import Levels

# A drive, or the drives of a focus that runs through several points
Made = TypeVar("Made")

# Largest number of unknowns of a verification on panels of its own
MOST_UNKNOWNS = 19_000


def stored(solver: Solver, store: Path | None) -> Solver:
    """Return a solver that stores its solutions in the folder ``store``, if one is given."""
    return solver if store is None else at.Stored(solver, store)


def solve_beacons(
    setup: Setup,
    clock: Clock,
    store: Path | None = None,
    estimate: bool = True,
    verifier: Solver | None = None,
) -> RadiatedField:
    """Compute the field of a source (beacon) at each focus and suppression point.

    If the setup has an uncertainty, the field is expanded in multipoles where possible, because the
    expansion is faster to evaluate. With ``estimate=False``, boundary elements solve only the
    transposed equation and do not estimate their error; this is enough if a verification follows.
    If ``verifier``, the solver of the verification, has ``SharedPanels``, its panels are used.
    """
    target = setup.target
    solver = setup.solver
    if isinstance(verifier, SharedPanels):
        solver = replace(verifier, drive_only=not estimate)
    elif isinstance(solver, BoundaryElement) and not estimate:
        solver = replace(solver, estimate=False)
    foci = f"focus ({len(target.points)})"
    if len(target.suppression_points):
        count = len(target.suppression_points)
        foci += f" and {counted(count, 'suppression point', 'suppression points')}"
    where = f"around {', '.join(setup.bodies)}" if setup.bodies else "in open air"
    with clock.step("beacons", f"solving for a beacon in each {foci} {where}"):
        beacons = stored(solver, store).radiate(setup.scene, target.beacons(suppression=True))
        # Each sample evaluates the field at a displaced array, which multipoles do far faster. In
        # front of a plane each sample has another field.
        if setup.uncertainty is None or not setup.scene.obstacles or setup.scene.planes:
            return beacons
        return at.multipole_expansion(beacons)


def transfer_to_array(
    setup: Setup, beacons: RadiatedField, clock: Clock
) -> tuple[TransferMatrix, SolveReport]:
    """Compute the transfer matrix from ``beacons``, the field of a source at each focus.

    Returns
    -------
    The transfer matrix (or an ensemble with one matrix per sample), and the report of the solve.
    """
    transducers = counted(len(setup.array), "transducer", "transducers")
    with clock.step("transfer", f"evaluating the beacons at {transducers}"):
        # Turn a warning about an inexact matrix into a sentence of the result.
        with warnings.catch_warnings(record=True) as inexact:
            warnings.simplefilter("always")
            # The setup has already checked the placement of the array.
            transfer = transfer_to(beacons, setup.array)
        # The matrix comes from the transposed solution, so omit warnings about the direct one.
        report = replace(
            beacons.report,
            warnings=(
                *(str(warning.message) for warning in inexact),
                *(text for text in beacons.report.warnings if not text.startswith(OF_THE_DIRECT)),
            ),
        )
    if setup.uncertainty is not None:
        with clock.step(
            "samples", f"evaluating the beacons at {setup.samples} samples of the uncertainty"
        ):
            transfer = at.ensemble(
                beacons,
                setup.array,
                setup.uncertainty,
                setup.samples,
                setup.seed,
                solver=solver_of_samples(setup),
            )
    return transfer, report


def solve_foci(
    setup: Setup, clock: Clock, store: Path | None = None
) -> tuple[TransferMatrix, SolveReport]:
    """Compute the transfer matrix of a setup; return it with the report of the solve."""
    return transfer_to_array(setup, solve_beacons(setup, clock, store), clock)


def solver_of_samples(setup: Setup) -> Solver | None:
    """Return the solver for samples of the uncertainty, or None if they need no solve."""
    if not (setup.scene.planes and isinstance(setup.solver, BoundaryElement)):
        return None
    return replace(setup.solver, estimate=False)


def other_samples(setup: Setup, transfer: TransferMatrix) -> "at.drives.TransferEnsemble":
    """Sample the uncertainty of a setup with a seed that was not used to compute the drive."""
    assert isinstance(transfer, at.drives.TransferEnsemble)
    # In front of a plane, each sample requires its own solve.
    count = 256 if solver_of_samples(setup) is None else 64
    return transfer.resampled(count, setup.seed + 1)


def synthesise(
    method: Callable[[TransferMatrix, Target], Made], transfer: TransferMatrix, target: Target
) -> tuple[Made, tuple[str, ...]]:
    """Compute one or more drives, and collect the warnings of a method that stopped early."""
    # Turn warnings of the method into sentences of the result; pass other warnings on.
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", Stalled)
        drive = method(transfer, target)
    stalled = []
    for warning in caught:
        if isinstance(warning.message, Stalled):
            stalled.append(str(warning.message))
        else:
            warnings.warn_explicit(
                warning.message, warning.category, warning.filename, warning.lineno
            )
    return drive, tuple(stalled)


def emitted_drive(setup: Setup, clock: Clock) -> tuple[Drive, tuple[str, ...]]:
    """Return the drive of a setup, rounded to the levels of the boards, and its warnings."""
    transfer, _ = solve_foci(setup, clock)
    drive, stalled = synthesise(setup.synthesise, transfer, setup.target)
    return quantise(drive, setup.levels).drive(), stalled


def rounding(
    rows: Complex128[np.ndarray, "foci elements"],
    amplitudes: Complex128[np.ndarray, "elements"],
    levels: Levels,
    weights: Float64[np.ndarray, "foci"],
) -> Float64[np.ndarray, "foci"]:
    """Return the factor (F,) by which rounding to levels changes the pressure at each focus.

    The factors are 1 at foci with weight 0, and at all foci if the rounded drive is silent.
    """
    rounded = quantise(Drive(amplitudes), levels).drive().amplitudes
    exact = np.abs(rows @ amplitudes)
    changed = (weights > 0.0) & (exact > 0.0) & rounded.any()
    return np.divide(np.abs(rows @ rounded), exact, out=np.ones(len(rows)), where=changed)


def method_words(setup: Setup) -> str:
    """Return the name of the method; for ``best``, the name of the method that it selects."""
    words = setup.method.replace("_", " ")
    if setup.method != "best":
        return words
    target = setup.target
    if setup.traps:
        from airtact.traps.holding import merged

        target = merged(setup.traps, target)
    return f"{words} ({method_for(target).replace('_', ' ')})"


def drive_names(bodies: Sequence[str]) -> tuple[str, ...]:
    """Return the names of a drive and its control; in open air, only that of the drive."""
    if not bodies:
        return ("drive",)
    word = body_word(bodies)
    return f"{word} considered", f"{word} ignored"


def control_drive(setup: Setup, method: Callable[[TransferMatrix, Target], Made]) -> Made | None:
    """Compute the control drive by ``method`` without the bodies; return None in open air.

    A method that uses samples gets samples of the same uncertainty in open air.
    """
    if not setup.scene.obstacles:
        return None
    open_air = open_air_matrix(setup.scene, setup.array, setup.target)
    if setup.uncertainty is not None and setup.method in FOR_SAMPLES:
        # Without skin, a focus cannot move along it; all other deviations remain.
        beacons = FreeField().radiate(
            replace(setup.scene, obstacles=[]), setup.target.beacons(suppression=True)
        )
        open_air = at.ensemble(
            beacons,
            setup.array,
            replace(setup.uncertainty, along_skin=0.0),
            setup.samples,
            setup.seed,
        )
    return synthesise(method, open_air, setup.target)[0]


def named(sentences: Iterable[str], bodies: Sequence[str]) -> list[str]:
    """Replace the indices of bodies in a solver's sentences with their names."""
    return [
        re.sub(r"\bbody (\d+)\b", lambda match: bodies[int(match[1])], sentence)
        for sentence in sentences
    ]


def verification_solver(setup: Setup) -> Solver:
    """Return a solver for verifying the drive that is more accurate than the setup's.

    If a body is filled with a fluid and the setup's solver is ``FiniteElement``, it is the same
    solver with the next higher order. If the setup's solver is ``SphereSeries``, which is exact,
    it verifies a filled sphere too. For all other scenes with bodies, it is ``BoundaryElement``
    with at least 1.8 times as many unknowns as ``setup.accuracy`` requires. If that is more than
    19,000 unknowns, as for a whole hand, it solves the direct equation on the panels of the drive
    (``SharedPanels``). In both cases its report contains a warning if the estimated error exceeds
    ``setup.accuracy``. For open air, it is ``FreeField``, which is exact.

    Parameters
    ----------
    setup : the setup whose drive is to be verified.

    Returns
    -------
    A ``FreeField``, ``FiniteElement``, ``SphereSeries``, ``BoundaryElement`` or ``SharedPanels``
    solver.

    Raises
    ------
    InvalidInput
        If a ``FiniteElement`` solver already has the highest order, 10.
    """
    if not of_kind(setup, Setup, "the setup", "read_scene(path)").scene.obstacles:
        return FreeField()
    filled = any(obstacle.boundary == "filled" for obstacle in setup.scene.obstacles)
    if filled and isinstance(setup.solver, at.FiniteElement):
        return replace(setup.solver, order=setup.solver.order + 1)
    if filled and isinstance(setup.solver, at.SphereSeries):
        return setup.solver
    finest = 1e-4  # limit of boundary elements
    emitting = Monopoles(setup.array.positions, np.ones(len(setup.array)))

    def unknowns(accuracy: float) -> int:
        return BoundaryElement(accuracy=accuracy).unknowns(setup.scene, emitting)

    # The sources are far from the bodies, so these numbers do not include smaller panels near foci.
    enough = 1.8 * unknowns(setup.accuracy)
    if (
        enough > MOST_UNKNOWNS
        and isinstance(setup.solver, BoundaryElement)
        and not setup.scene.boards
    ):
        solver = replace(setup.solver, estimate=True, enough=setup.accuracy)
        beacons = setup.target.beacons(suppression=True)
        return SharedPanels(solver, beacons.refined_positions)
    # Each trial meshes all bodies, so use as few as possible. The number of unknowns grows like
    # accuracy^(−2/3) or more slowly, so a third of the error is usually right.
    steps = 6 if enough <= MOST_UNKNOWNS else 1
    enough = min(enough, MOST_UNKNOWNS)
    accuracy = max(setup.accuracy / 1.2**steps, finest)
    count = unknowns(accuracy)
    while count < enough and accuracy > finest:
        accuracy = max(accuracy / 1.2, finest)
        count = unknowns(accuracy)
    while count > MOST_UNKNOWNS and accuracy < setup.accuracy / 1.3:
        accuracy *= 1.2
        count = unknowns(accuracy)
    return BoundaryElement(accuracy=accuracy, enough=setup.accuracy)


def unknowns_of(
    solver: BoundaryElement, scene: Scene, points: Float64[np.ndarray, "points 3"]
) -> int:
    """Return the number of unknowns of a solve for sources at points [m].

    Numbers above 50,000 are estimates.
    """
    area = sum(obstacle.surface.area for obstacle in scene.obstacles)
    estimate = round(solver.nodes_per_square_wavelength * area / scene.wavelength**2)
    if estimate > 50_000:  # meshing so many panels would take too long
        return estimate
    return solver.unknowns(scene, Monopoles(points, np.ones(len(points))))


def memory_of_a_solve(unknowns: float, accuracy: float) -> float:
    """Estimate the peak memory that a boundary-element solve for a few foci requires [bytes]."""
    # The matrix is mostly low-rank, so memory grows more slowly than the square of the unknowns.
    # The power law fits 10 solves of the examples, with 2,244 to 23,058 unknowns, within 20 %. In
    # single precision instead of bfloat16, the matrix takes 1.9 times the memory.
    per_unknown = 193.0 if accuracy >= BFLOAT16_ACCURACY else 1.9 * 193.0
    return 1.2e8 + per_unknown * unknowns**1.434
