"""The steps that several workflows share: the transfer matrix, the drive, and the solver that verifies it."""

import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Bool

from airtact.acoustics.solvers.bem.solver import OF_THE_DIRECT, BoundaryElement
from airtact.acoustics.solvers.fem.solver import FiniteElement
from airtact.acoustics.solvers.free_field import FreeField
from airtact.acoustics.solvers.problem import RadiatedField, Solver, SolveReport
from airtact.acoustics.solvers.spherical.multipole_field import multipole_expansion
from airtact.acoustics.sources import Monopoles
from airtact.acoustics.store.stored import Stored
from airtact.acoustics.target import Target
from airtact.checks import counted
from airtact.drives.default_method import method_for
from airtact.drives.methods import FOR_SAMPLES
from airtact.drives.motion import Motion
from airtact.drives.reach import NEAREST, nearest_foci
from airtact.drives.sampling.ensemble import TransferEnsemble, ensemble
from airtact.drives.transfer import Drive, TransferMatrix, open_air_matrix, transfer_matrix
from airtact.drives.weakest_focus import Stalled
from airtact.evaluation.headline import body_word
from airtact.evaluation.held_out import SAMPLES, SOLVED_SAMPLES
from airtact.evaluation.windows import Window, plane_of_scene
from airtact.geometry.surface import Surface
from airtact.setup.building import Setup
from airtact.timing import Clock
from airtact.transducers.modulation import AmplitudeModulation
from airtact.transducers.reach import open_air_bound, strongest_open_air

REFINEMENT = 1.8
"""Unknowns of the verification solve over those of the scene's own accuracy, where memory allows."""

MOST_UNKNOWNS = 19_000
"""Unknowns above which the verification solve is refined no further: its matrix would pass 3 GB."""

FELT = 10e-3
"""Distance from the nearest body, beyond which no skin feels a focus: a wavelength and more [m]."""

LEAST_REACH = 0.1
"""Least share of the array's strongest pressure at a focus: a tenth of the pressure is a hundredth of the force."""

FINEST = 1e-4
"""The best accuracy that boundary elements take."""

LIKELY = 5
"""Index of the trial accuracy that usually has ``REFINEMENT`` times the unknowns: accuracy^(−2/3) of them, or fewer."""


def verification_solver(setup: Setup) -> Solver:
    """Choose a solver of higher accuracy than the one that makes the drive, to verify the drive.

    Filled bodies get finite elements of the next order, other bodies boundary elements, open air
    the closed form. It warns where the error exceeds what the scene asks.
    """
    if not setup.scene.obstacles:
        return FreeField()
    if isinstance(setup.solver, FiniteElement) and any(
        one.boundary == "filled" for one in setup.scene.obstacles
    ):
        return replace(setup.solver, order=setup.solver.order + 1)
    return BoundaryElement(accuracy=_verification_accuracy(setup), enough=setup.accuracy)


def _verification_accuracy(setup: Setup) -> float:
    """Find the accuracy that has ``REFINEMENT`` times the unknowns of the scene's own, or as many as fit.

    Panels beside foci do not count: in the verification solve the transducers emit, which are far
    from the bodies. Each count makes the panels of all bodies, so that as few accuracies as
    possible are tried.
    """
    emitting = Monopoles(setup.array.positions, np.ones(len(setup.array)))

    @cache
    def unknowns(accuracy: float) -> int:
        return BoundaryElement(accuracy=accuracy).unknowns(setup.scene, emitting)

    trials = [max(setup.accuracy / 1.2, FINEST)]
    while trials[-1] / 1.2 > FINEST:
        trials.append(trials[-1] / 1.2)
    own = unknowns(setup.accuracy)
    if own > MOST_UNKNOWNS:
        return trials[0]
    enough = min(REFINEMENT * own, MOST_UNKNOWNS + 1)
    index = min(LIKELY, len(trials) - 1)
    while index > 0 and unknowns(trials[index - 1]) >= enough:
        index -= 1
    while index < len(trials) - 1 and unknowns(trials[index]) < enough:
        index += 1
    return trials[max(index - 1, 0)] if unknowns(trials[index]) > MOST_UNKNOWNS else trials[index]


def with_skin(setup: Setup) -> Bool[np.ndarray, "foci"]:
    """Whether a body is within ``FELT`` of each focus, so that skin is modelled there; in open air it may be."""
    if not setup.bodies:
        return np.ones(len(setup.target.points), dtype=bool)
    return np.asarray(-setup.scene.depth(setup.target.points) <= FELT)


def reach_cautions(setup: Setup) -> tuple[str, ...]:
    """Name foci hard to reach or to separate or far from skin, pressures beyond full scale, paths that leave bodies.

    Nothing is solved for that.

    A focus is out of reach where all elements in phase bring less than ``LEAST_REACH`` of their
    strongest pressure to it in open air. A hard surface doubles the pressure of a plane wave, so a
    pressure beyond twice the open-air bound (once without bodies) cannot be expected; between
    reflecting boards there is no such bound.
    """
    wavenumber, target = setup.scene.wavenumber.real, setup.target
    bounds = open_air_bound(setup.array, target.points, wavenumber)
    strongest = strongest_open_air(setup.array, wavenumber)
    most = (2.0 if setup.bodies else 1.0) * (2.0 if setup.scene.planes else 1.0)
    most = np.inf if setup.scene.boards else most
    asked = np.zeros(len(bounds)) if target.pressures is None else np.abs(target.pressures)
    found = list(_path_cautions(setup))
    bare = ~with_skin(setup)
    if bare.any():
        away, others = -setup.scene.depth(target.points), int(np.count_nonzero(bare)) - 1
        beside = (
            f", and {counted(others, 'other focus', 'other foci')} over {1e3 * FELT:g} mm"
            if others
            else ""
        )
        found.append(
            f"{setup.foci[int(away.argmax())]} is {1e3 * away.max():.2g} mm from the nearest body{beside}: no skin is "
            "modelled there, so that how far it is above a threshold of touch says nothing."
        )
    if len(target.points) > 1:
        one, other, apart = nearest_foci(target.points)
        if apart < NEAREST * setup.scene.wavelength:
            found.append(
                f"{setup.foci[one]} and {setup.foci[other]} are {1e3 * apart:.2g} mm apart, under a tenth of the "
                "wavelength: most methods cannot separate them and make no drive; leave one out."
            )
    for name, bound, pressure in zip(setup.foci, bounds, asked, strict=True):
        if bound < LEAST_REACH * strongest:
            found.append(
                f"{name} is out of the array's reach: it gets {bound / strongest:.1%} of the {strongest:,.0f} Pa that "
                f"the elements bring to their strongest point in open air, under {LEAST_REACH:.0%}; move the focus or "
                "the array."
            )
        if pressure > most * bound:
            words = {1.0: "", 2.0: ", and at most about twice that on a hard surface"}.get(
                most, ", and at most about four times that on a hard surface beside a plane"
            )
            found.append(
                f"{name} asks for {pressure:,.0f} Pa, and all elements at full scale bring {bound:,.0f} Pa to it in "
                f"open air{words}: ask for less, or take more boards."
            )
    return tuple(found)


def _path_cautions(setup: Setup) -> Iterator[str]:
    """Name the foci whose paths leave the bodies."""
    motion = setup.modulation
    if not isinstance(motion, Motion) or motion.through_points(len(setup.foci)):
        return
    strayed = motion.strayed(setup.scene, setup.target, setup.array.positions.mean(axis=0))
    for name, off in zip(setup.foci, strayed, strict=True):
        count = int((off > setup.scene.wavelength / 2.0).sum())
        if count:
            yield (
                f"the path around {name} leaves the body: {count} of {len(off)} positions lie up to "
                f"{1e3 * off.max():.2g} mm farther from it than the focus, over half a wavelength; give a smaller "
                "radius or length."
            )


def stored(solver: Solver, store: Path | None) -> Solver:
    """Let a solver store what it solves in a folder; without a folder return the solver as it is."""
    return solver if store is None else Stored(solver, store)


def solve_foci(
    setup: Setup, clock: Clock, store: Path | None = None
) -> tuple[TransferMatrix, SolveReport]:
    """Solve for a beacon in each focus and suppression point, and evaluate the fields at the transducers.

    Where something is in doubt the matrix is an ensemble, with the samples that drives are made
    for.
    """
    return seen_by_array(setup, solve_beacons(setup, clock, store), clock)


def seen_by_array(
    setup: Setup, beacons: RadiatedField, clock: Clock
) -> tuple[TransferMatrix, SolveReport]:
    """Evaluate the fields of ``solve_beacons`` at the transducers, as ``solve_foci`` does."""
    transducers = counted(len(setup.array), "transducer", "transducers")
    with clock.step("transfer", f"evaluating the beacons at {transducers}"):
        transfer = transfer_matrix(beacons, setup.array)
        # The matrix is evaluated by the transposed solution alone.
        warned = tuple(one for one in beacons.report.warnings if not one.startswith(OF_THE_DIRECT))
        report = replace(beacons.report, warnings=warned)
    if setup.uncertainty is None:
        return transfer, report
    with clock.step("samples", f"evaluating them at {setup.samples} samples of what is in doubt"):
        given = setup.array, setup.uncertainty, setup.samples, setup.seed
        return ensemble(beacons, *given, solver=solver_of_samples(setup)), report


def solver_of_samples(setup: Setup) -> Solver | None:
    """Return what solves the samples of what is in doubt: before a plane each is another scene, elsewhere none is."""
    if not (setup.scene.planes and isinstance(setup.solver, BoundaryElement)):
        return None
    return replace(setup.solver, estimate=False)


def other_samples(setup: Setup, beacons: RadiatedField) -> TransferEnsemble:
    """Sample what is in doubt once more, for hands that no drive of the scene was made for."""
    assert setup.uncertainty is not None
    solver = solver_of_samples(setup)
    count = SAMPLES if solver is None else SOLVED_SAMPLES
    return ensemble(beacons, setup.array, setup.uncertainty, count, setup.seed + 1, solver=solver)


def solve_beacons(setup: Setup, clock: Clock, store: Path | None = None) -> RadiatedField:
    """Solve for a beacon in each focus and suppression point; as a multipole expansion where something is in doubt."""
    target = setup.target
    foci = f"focus ({len(target.points)})"
    if len(target.suppression_points):
        foci += f" and {counted(len(target.suppression_points), 'suppression point', 'suppression points')}"
    words = f"solving for a beacon in each {foci} around {', '.join(setup.bodies) or 'nothing'}"
    with clock.step("beacons", words):
        beacons = stored(setup.solver, store).radiate(setup.scene, target.beacons(suppression=True))
        return (
            multipole_expansion(beacons)
            if setup.uncertainty is not None and setup.bodies
            else beacons
        )


def synthesise(
    method: Callable[[TransferMatrix, Target], Drive], transfer: TransferMatrix, target: Target
) -> tuple[Drive, tuple[str, ...]]:
    """Make a drive by one of ``METHODS``, and collect its warnings of having stopped early."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", Stalled)
        drive = method(transfer, target)
    for other in caught:
        if not isinstance(other.message, Stalled):
            warnings.warn_explicit(other.message, other.category, other.filename, other.lineno)
    return drive, tuple(str(one.message) for one in caught if isinstance(one.message, Stalled))


def method_words(setup: Setup) -> str:
    """Name the method of a scene in words, and what the default chose."""
    words = setup.method.replace("_", " ")
    return (
        f"{words} ({method_for(setup.target).__name__.replace('_', ' ')})"
        if setup.method == "best"
        else words
    )


def drive_names(bodies: Sequence[str]) -> tuple[str, ...]:
    """Return what the drive of a run and its control are called; in open air there is no control."""
    word = body_word(bodies)
    return (f"{word}-aware", f"without the {word}") if bodies else ("drive",)


def with_control(
    setup: Setup, method: Callable[[TransferMatrix, Target], Drive], drive: Drive | None = None
) -> dict[str, Drive]:
    """Return a drive, if given, and its control by name: the same method on a matrix without the bodies.

    A method for samples gets those of the same uncertainty in open air.
    """
    names = drive_names(setup.bodies)
    drives = {} if drive is None else {names[0]: drive}
    if setup.bodies:
        open_air = open_air_matrix(setup.scene, setup.array, setup.target)
        if setup.uncertainty is not None and setup.method in FOR_SAMPLES:
            empty = replace(setup.scene, obstacles=[])
            beacons = FreeField().radiate(empty, setup.target.beacons(suppression=True))
            doubt = replace(setup.uncertainty, along_skin=0.0)
            open_air = ensemble(beacons, setup.array, doubt, setup.samples, setup.seed)
        drives[names[1]] = synthesise(method, open_air, setup.target)[0]
    return drives


def named(sentences: Iterable[str], bodies: Sequence[str]) -> list[str]:
    """Put the names of bodies into a solver's sentences, which know their numbers only."""
    return [
        re.sub(r"\bbody (\d+)\b", lambda found: bodies[int(found[1])], one) for one in sentences
    ]


def save_drives(
    drives: Mapping[Path, Drive], setup: Setup, transfer: TransferMatrix, report: SolveReport
) -> None:
    """Save drives to their files, with all that emitting them needs and what they were made from."""
    texts = {"scene": setup.text, "report": msgspec.json.encode(report).decode()}
    for file, drive in drives.items():
        known = (setup.array, setup.scene, transfer, setup.target, setup.levels, texts)
        drive.save(
            file,
            *known,
            setup.modulation if isinstance(setup.modulation, AmplitudeModulation) else None,
        )


def plane_of_foci(setup: Setup) -> tuple[Window, list[Surface]]:
    """Find the plane through the foci in which fields are pictured, and the surfaces that let no sound through."""
    window = plane_of_scene(setup.scene, setup.target.points)
    return window, [one.surface for one in setup.scene.obstacles if one.boundary != "filled"]
