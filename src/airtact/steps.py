"""What the ways through a scene file share: steps, the transfer matrix, and a finer solution that judges."""

import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from airtact.scene.sources import Monopoles
from airtact.scene.target import Target
from airtact.scene_file.building import Setup
from airtact.solvers.bem.solver import BoundaryElement
from airtact.solvers.fem.solver import FiniteElement
from airtact.solvers.free_field import FreeField
from airtact.solvers.problem import Solver, SolveReport
from airtact.store.stored import Stored
from airtact.synthesis.stalling import Stalled
from airtact.transfer import Drive, TransferMatrix, transfer_matrix
from airtact.validation import counted

REFINEMENT = 1.8
"""How many times the unknowns of the scene's own accuracy the solution that judges gets, where memory allows."""

MOST_UNKNOWNS = 19_000
"""Where the judging solution stops to be finer by that much: its matrix would pass 3 GB."""

FINEST = 1e-4
"""The best accuracy that the solver takes."""


class Clock:
    """Tells each step as it begins and keeps how long it took.

    Attributes
    ----------
    seconds : wall time by step [s].
    """

    def __init__(self, report_step: Callable[[str], None]) -> None:
        self.seconds: dict[str, float] = {}
        self._tell = report_step

    @contextmanager
    def step(self, name: str, words: str) -> Iterator[None]:
        """Tell a step in words and time what happens inside under a name."""
        self._tell(words)
        begun = time.perf_counter()
        yield
        self.seconds[name] = time.perf_counter() - begun


def finer(setup: Setup) -> Solver:
    """Choose a solver that is finer than a drive's own, to judge it.

    Sound-hard bodies are judged by boundary elements, others by finite elements of the next order, open air in closed
    form.

    Parameters
    ----------
    setup : the scene.
    """
    if not setup.scene.obstacles:
        return FreeField()
    if isinstance(setup.solver, FiniteElement) and any(one.boundary != "sound_hard" for one in setup.scene.obstacles):
        return replace(setup.solver, order=setup.solver.order + 1)
    return BoundaryElement(accuracy=_judging_accuracy(setup))


def _judging_accuracy(setup: Setup) -> float:
    """Find an accuracy that brings ``REFINEMENT`` times the unknowns that the scene's own has, or as many as fit.

    Panels beside foci do not count: the judge hears foci, and the transducers speak from afar.
    """
    speakers = Monopoles(setup.array.positions, np.ones(len(setup.array)))
    own = BoundaryElement(accuracy=setup.accuracy).unknowns(setup.scene, speakers)
    fitting = finer = setup.accuracy / 1.2
    while finer > FINEST:
        count = BoundaryElement(accuracy=finer).unknowns(setup.scene, speakers)
        if count > MOST_UNKNOWNS:
            break
        fitting = finer
        if count >= REFINEMENT * own:
            break
        finer /= 1.2
    return fitting


def kept(solver: Solver, store: Path | None) -> Solver:
    """Let a solver keep what it solves in a folder, if there is one.

    Parameters
    ----------
    solver : any.
    store : the folder, or None to keep nothing.
    """
    return solver if store is None else Stored(solver, store)


def solve_foci(setup: Setup, clock: Clock, store: Path | None = None) -> tuple[TransferMatrix, SolveReport]:
    """Solve for beacons in all foci and suppression points, and hear them at the transducers.

    Parameters
    ----------
    setup : the scene.
    clock : times the steps.
    store : folder of solved fields, if they are kept.
    """
    target = setup.target
    count = len(target.points)
    quiet = (
        f" and {counted(len(target.suppression_points), 'suppression point', 'suppression points')}"
        if len(target.suppression_points)
        else ""
    )
    words = f"solving for a beacon in each focus ({count}){quiet} around {', '.join(setup.bodies) or 'nothing'}"
    with clock.step("beacons", words):
        beacons = kept(setup.solver, store).radiate(setup.scene, target.beacons(suppression=True))
    with clock.step("transfer", f"hearing them at {counted(len(setup.array), 'transducer', 'transducers')}"):
        return transfer_matrix(beacons, setup.array), beacons.report


def synthesised(
    method: Callable[[TransferMatrix, Target], Drive], transfer: TransferMatrix, target: Target
) -> tuple[Drive, tuple[str, ...]]:
    """Make a drive, and collect what the method says of having stopped early.

    Parameters
    ----------
    method : one of ``METHODS``.
    transfer : the transfer matrix.
    target : the foci.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", Stalled)
        drive = method(transfer, target)
    for other in caught:
        if not isinstance(other.message, Stalled):
            warnings.warn_explicit(other.message, other.category, other.filename, other.lineno)
    return drive, tuple(str(one.message) for one in caught if isinstance(one.message, Stalled))
