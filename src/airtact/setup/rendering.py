"""Render a setup: solve for the field, compute the drive, verify and save it."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Complex128, Float64, Real

import airtact as at
from airtact.acoustics.medium import Medium
from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.problem import RadiatedField, Solver, SolveReport
from airtact.acoustics.target import PerFocus, Target
from airtact.drives.drive import Drive, quantise
from airtact.drives.drive_file import SEQUENCE_FILE
from airtact.drives.frame import Frame
from airtact.drives.methods import FOR_SAMPLES
from airtact.drives.transfer import TransferMatrix, fraction
from airtact.errors import Vector, of_kind, one_line, path_of, point_of
from airtact.evaluation.comparison import Comparison, body_word, headline, shortfalls
from airtact.evaluation.comparison import compare as compare_drives
from airtact.evaluation.metrics import Evaluation, at_weakest, in_real_air
from airtact.evaluation.steepening import Steepening
from airtact.files.atomic import writable_folder
from airtact.setup.sentences import (
    disagreement,
    facing_away,
    reach_cautions,
    sensations,
    shadows,
    share_of_bound,
    too_strong,
    touches,
    trap_sentences,
)
from airtact.setup.setup import Setup
from airtact.setup.solving import (
    control_drive,
    drive_names,
    method_words,
    named,
    other_samples,
    rounding,
    solve_beacons,
    stored,
    synthesise,
    transfer_to_array,
    verification_solver,
)
from airtact.timing import Clock, Progress
from airtact.transducers.layout import PhasedArray
from airtact.transducers.levels import AmplitudeModulation


@dataclass(frozen=True, eq=False, repr=False)
class Rendering:
    """The drive of a setup, verified by a second solve, as returned by ``render``.

    "The weakest focus" is the one with the smallest ratio of pressure to request.

    Attributes
    ----------
    setup : scene, array, target and settings.
    transfer : transfer matrix from which the drive was computed.
    beacons : report of the solve for ``transfer``, which has a source (beacon) at each focus. If
        the solver did not estimate its error, ``beacons.estimated_error`` is the largest relative
        difference, at any focus, between this solve and the verification, or the estimated error of
        the verification if that is larger.
    drive : complex amplitude of each transducer, not rounded to levels.
    pressures : (F,) verified peak pressure at each focus [Pa]. If one focus runs through the points
        in turn, each value applies while the focus is at that point; such values come from the
        transfer matrix and are not verified.
    steepening : effect of nonlinear steepening on ``pressures``, which do not include it.
    verification : pressures of ``drive`` and of the control, computed by the verification solve.
        The control is the drive that the same method computes without the bodies; in open air there
        is none.
    felt : the same as ``verification``, unless one focus runs through the points in turn. In that
        case, it contains the pressure at each point while the focus is there.
    drives : dict from names to ``drive`` and the control drive, each scaled so that its strongest
        element is at full scale.
    sequence : drives for moving foci; None if the foci do not move.
    robustness : pressures of the drive for samples of the setup's ``uncertainty`` that were not
        used to compute the drive; None if the setup has no uncertainty.
    traps : ``Verdict`` on the equilibrium nearest to each trap, or on the trap itself if there is
        no equilibrium within half a wavelength; empty if there are no traps.
    headline : sentence that states the pressures that ``drive`` and the control drive produce at
        the weakest focus.
    remarks : sentences about requests that were not met, and about the fraction of the upper
        bound that the drive reaches.
    sensation : sentences that compare the foci with the tactile threshold.
    warnings : warnings about the setup, the method and both solves, one sentence each.
    seconds : wall time of each step by name [s].
    """

    setup: Setup
    transfer: TransferMatrix
    beacons: SolveReport
    drive: Drive
    pressures: Float64[np.ndarray, "foci"]
    steepening: Steepening
    verification: Comparison
    felt: Comparison
    drives: Mapping[str, Drive]
    sequence: "at.setup.MovingDrive | None"
    robustness: "at.evaluation.HeldOut | None"
    traps: "tuple[at.traps.Verdict, ...]"
    headline: str
    remarks: tuple[str, ...]
    sensation: tuple[str, ...]
    warnings: tuple[str, ...]
    seconds: Mapping[str, float]

    def __repr__(self) -> str:
        return one_line(
            self,
            f"weakest focus {self.pressures[self.setup.target.weakest(self.pressures)]:,.0f} Pa",
            f"estimated error {self.estimated_error:.2g}",
        )

    @property
    def method(self) -> str:
        """Name of the method; for ``best``, the name of the method that it selects."""
        return method_words(self.setup)

    @property
    def frame(self) -> Frame:
        """The drive rounded to the amplitude and phase levels of the setup."""
        return quantise(self.drive, self.setup.levels)

    @property
    def estimated_error(self) -> float:
        """Relative error of the pressures, as estimated by the verification solve."""
        return self.verification.report.estimated_error

    @cached_property
    def evaluation(self) -> Evaluation:
        """Evaluation of the drive or sequence at the foci; it does not contain the field."""
        phases = np.exp(1j * np.angle(self.felt.at_foci[:, 0]))
        return Evaluation(
            self.setup.target,
            self.pressures * phases,
            self.verification.report,
            steepening=self.steepening,
        )

    @property
    def control_pressures(self) -> Float64[np.ndarray, "foci"] | None:
        """(F,) peak pressure [Pa] of the control at each focus, at the same energy as the drive.

        The value is None in open air.
        """
        if len(self.drives) == 1:
            return None
        drive, control = self.felt.pressures["equal energy"]
        return control * (self.pressures.max() / drive.max())

    def save(self, folder: str | Path) -> tuple[Path, ...]:
        """Write drive.csv, drive.h5 and, for moving foci, sequence.h5; return their paths.

        Existing files are replaced.
        """
        return save_files(self, path_of(folder, "the folder"))


@dataclass(frozen=True, eq=False)
class ComputedDrive:
    """A drive before its verification.

    Attributes
    ----------
    setup, drive : the setup, and the drive computed for it.
    transfer, beacons : transfer matrix from which the drive was computed, and the report of the
        solve for this matrix.
    sequence : drives for moving foci; None if the foci do not move.
    field : field of a source (beacon) at each focus and suppression point.
    notes : warnings issued by the method that computed the drive.
    verifier : solver for the verification.
    """

    setup: Setup
    field: RadiatedField
    transfer: TransferMatrix
    beacons: SolveReport
    drive: Drive
    sequence: "at.setup.MovingDrive | None"
    notes: tuple[str, ...]
    verifier: Solver


def save_files(run: ComputedDrive | Rendering, folder: Path) -> tuple[Path, ...]:
    """Write drive.csv, drive.h5 and, for moving foci, sequence.h5; return their paths."""
    folder = writable_folder(folder)
    files = [folder / name for name in ("drive.csv", "drive.h5")]
    for file in files:
        save_drive(file, run.drive, run.setup, run.transfer, run.beacons)
    sequence = folder / SEQUENCE_FILE
    if run.sequence is not None:
        run.sequence.save(sequence, run.setup)
        files.append(sequence)
    else:
        sequence.unlink(missing_ok=True)  # from an older run
    return tuple(files)


def save_drive(
    file: Path, drive: Drive, setup: Setup, transfer: TransferMatrix, report: SolveReport
) -> None:
    """Write a drive with the scene, the solver's report, and all other data needed to emit it."""
    modulation = setup.modulation
    drive.save(
        file,
        setup.array,
        setup.scene,
        transfer,
        setup.target,
        levels=setup.levels,
        modulation=modulation if isinstance(modulation, AmplitudeModulation) else None,
        texts={"scene": setup.text, "report": msgspec.json.encode(report).decode()},
    )


def focus(
    array: PhasedArray,
    points: Real[np.ndarray, "foci 3"] | Vector,
    hand: "at.Hand | at.Surface | list[at.Hand | at.Surface] | None" = None,
    *,
    pressures: PerFocus | None = None,
    medium: Medium | None = None,
) -> Rendering:
    """Focus an array on points in open air, or near a hand or another rigid body.

    The function computes the drive with the method ``best`` at 40 kHz. It is the shortest way to a
    drive; for other settings, call ``render`` with a ``Setup``.

    Parameters
    ----------
    array : the E transducers.
    points : (F, 3) foci in the array's frame [m], or (3,) for a single focus.
    hand : a ``Hand``, the ``Surface`` of another body, or a list of them, in the same frame; None,
        the default, for open air.
    pressures : (F,) requested peak pressures [Pa], or one number for all foci; by default, as high
        as possible. Complex numbers also request phases.
    medium : fluid around the bodies; by default, air at 20 °C.

    Returns
    -------
    A ``Rendering``. Its attribute ``drive`` is the drive, and ``pressures`` (F,) are the peak
    pressures at the foci [Pa], verified by a second solve.

    Raises
    ------
    InvalidInput
        If an argument has the wrong type or shape, a focus is inside a body or behind all elements,
        an element overlaps a body, or the method returns no drive, for example because two foci are
        less than a tenth of a wavelength apart.
    NotConverged
        If a solver stops before it converges.

    Examples
    --------
    >>> import airtact as at
    >>> result = focus(at.autd3_board(), (0.09, 0.07, 0.15))
    >>> result.drive.phases.shape, result.pressures.round(-2).tolist()
    ((249,), [5500.0])
    """
    parts = hand if isinstance(hand, list) else [] if hand is None else [hand]
    bodies = [at.sound_hard(p.surface if isinstance(p, at.Hand) else p) for p in parts]
    scene = Scene(medium or at.air(celsius=20.0), bodies)
    names = tuple("hand" if isinstance(part, at.Hand) else "body" for part in parts)
    return render(Setup(scene, array, Target(points, pressures), bodies=names))


def render(
    setup: Setup, *, store: str | Path | None = None, progress: Progress | None = None
) -> Rendering:
    """Compute the drive of a setup, and verify it with a second solve.

    The drive is computed by the setup's method from the transfer matrix of its solver. The
    verification solves for the field of the drive with ``verification_solver``.

    Parameters
    ----------
    setup : scene, array, target and settings, for example from ``read_scene``.
    store : folder in which solved fields are stored and reused; by default, fields are not stored.
    progress : function called with a description of each step as it begins.

    Returns
    -------
    A ``Rendering`` with the drive, its verified pressures at the foci and, for comparison, the
    drive computed without the bodies.

    Raises
    ------
    InvalidInput
        If the method returns no drive for the setup, or the solver does not support the setup.
    NotConverged
        If a solver stopped before it converged.

    Examples
    --------
    >>> import airtact as at
    >>> target = at.Target(np.array([[0.0, 0.0, 0.15]]))
    >>> result = render(at.Setup(at.Scene(at.air(), []), at.autd3_board(), target))
    >>> result.headline
    'Drive: 3.76 kPa at the weakest focus.'
    """
    of_kind(setup, Setup, "the setup", "read_scene(path) or Setup(scene, array, target)")
    clock = Clock(progress)
    store = None if store is None else Path(store)
    return verify(compute(setup, clock, store), clock, store)


def compute(setup: Setup, clock: Clock, store: Path | None = None) -> ComputedDrive:
    """Compute the drive of a setup without verifying it."""
    verifier = verification_solver(setup)
    field = solve_beacons(setup, clock, store, estimate=False, verifier=verifier)
    transfer, beacons = transfer_to_array(setup, field, clock)
    with clock.step("drive", f"computing the drive by {method_words(setup)}"):
        drive, notes = synthesise(setup.synthesise, transfer, setup.target)
    if setup.traps:
        drive = drive.at_full_scale()
    sequence = None
    if setup.motion is not None:
        from airtact.setup.sequences import moving_drive

        sequence = moving_drive(setup, setup.motion, transfer, clock, store)
        notes += sequence.warnings
    return ComputedDrive(setup, field, transfer, beacons, drive, sequence, notes, verifier)


def verify(computed: ComputedDrive, clock: Clock, store: Path | None = None) -> Rendering:
    """Verify a drive: compute its pressures by a solve with all elements as sources.

    ``render`` calls ``compute``, then this function; call both to use the drive before it is
    verified. If the target requests pressures, the setup has no traps, and the strongest element is
    below full scale, the drive is scaled so that the focus with the smallest ratio of verified
    pressure to request gets its requested pressure; no amplitude becomes larger than full scale.
    Otherwise the drive does not change.

    Parameters
    ----------
    computed : drive and setup, as returned by ``compute``.
    clock : the ``Clock`` that was passed to ``compute``. It also records the time of each step of
        the verification, and its times become ``Rendering.seconds``.
    store : folder in which solved fields are stored and reused; by default, fields are not stored.

    Returns
    -------
    A ``Rendering`` with the drive, its verified pressures and their estimated error.

    Raises
    ------
    InvalidInput
        If the solver cannot solve the scene, for example because there is not enough memory.
    NotConverged
        If the solver stops before it converges.
    """
    from airtact.setup.safe_emission import default_level

    setup = computed.setup
    transfer = computed.transfer
    drive = computed.drive
    names = drive_names(setup.bodies)
    drives = {names[0]: drive}
    control = control_drive(setup, setup.synthesise)
    if control is not None:
        drives[names[1]] = control
    with clock.step("verify", "verifying the drive by a solve with all transducers as sources"):
        comparison = compare_drives(
            setup.scene,
            setup.array,
            drives,
            setup.target,
            solver=stored(computed.verifier, store),
        )
    # The verification compares drives at full scale, but requested pressures may require less.
    at_full_scale = comparison.pressures["equal peak"][0]
    peak = drive.peak
    if peak < 1.0 and setup.target.pressures is not None and not setup.traps:
        # Scale the drive so that the weakest focus reaches its requested pressure, up to full scale
        share = float(np.nanmin(fraction(peak * at_full_scale, setup.target)))
        drive = Drive(drive.amplitudes / max(share, peak))
    traps = ()
    if setup.traps:
        from airtact.traps.gorkov import settled

        traps = tuple(
            settled(comparison.field, point_of(trap.point, "a trap"), trap.bead(setup.scene))
            for trap in setup.traps
        )
    pressures = drive.peak * at_full_scale
    steepening = comparison.steepening(names[0]).scaled(drive.peak)
    warnings = (
        *reach_cautions(setup),
        *computed.notes,
        *(tuple(shadows(setup, transfer)) or facing_away(setup)),
        *disagreement(setup, transfer, drive, pressures),
        *named(comparison.report.warnings, setup.bodies),
    )
    felt = comparison
    # The drive with the largest amplitude, which shows whether the sequence is at full scale.
    loudest = drive
    changes = rounding(
        transfer.matrix[: len(pressures)], drive.amplitudes, setup.levels, setup.target.weights
    )
    standing = share_of_bound(setup, transfer, drive)
    if setup.in_turn:
        assert computed.sequence is not None
        at_once = at_weakest(pressures, setup.target, setup.foci)
        standing = f"All foci at once (drive.h5): {at_once}."
        pressures = computed.sequence.pressures
        steepening = computed.sequence.steepening
        changes = computed.sequence.rounding
        frames = computed.sequence.drives
        felt = _felt_in_turn(setup, transfer, frames, comparison)
        loudest = Drive(max(frames, key=lambda frame: np.abs(frame).max()))

    first = headline(felt, loudest, body_word(setup.bodies), setup.foci)
    if abs(changes[setup.target.weakest(pressures)] - 1.0) > 0.1:
        words = at_weakest(changes * pressures, setup.target, setup.foci)
        first += f" As emitted, rounded to the boards' levels: {words}."
        # Methods other than ``best`` may exceed a request even without rounding.
        warnings += too_strong(setup, changes * pressures)

    robustness = None
    remarks = shortfalls(setup.target, setup.foci, pressures, loudest)
    if setup.uncertainty is not None:
        from airtact.evaluation.comparison import held_out

        with clock.step("doubt", "evaluating the drive on other samples of the uncertainty"):
            compared = {setup.method.replace("_", " "): drive}
            # Compare the drive with the method for samples and with the simplest method.
            if setup.method not in FOR_SAMPLES:
                compared["robust"] = at.robust(transfer, setup.target)
            if setup.method != "time_reversal":
                compared["time reversal"] = at.time_reversal(transfer, setup.target)
            robustness = held_out(other_samples(setup, transfer), setup.target, compared)
        words = "All foci at once: " if setup.in_turn else ""
        remarks = (*remarks, words + robustness.sentence())
    beacons = computed.beacons
    if not np.isfinite(beacons.estimated_error):
        verified = comparison.at_foci[:, 0]
        difference = transfer.pressure(computed.drive.at_full_scale())[: len(verified)] - verified
        asked = setup.target.weights > 0.0
        apart = float(np.max(np.abs(difference[asked] / verified[asked])))
        # If both have the same panels, their errors are similar, and may cancel in the difference.
        least = comparison.report.estimated_error
        beacons = replace(beacons, estimated_error=max(apart, least))
    return Rendering(
        setup=setup,
        transfer=transfer,
        beacons=beacons,
        drive=drive,
        pressures=pressures,
        steepening=steepening,
        verification=comparison,
        felt=felt,
        drives={name: emitted.at_full_scale() for name, emitted in drives.items()},
        sequence=computed.sequence,
        robustness=robustness,
        traps=traps,
        headline=first,
        remarks=(
            *touches(setup),
            *trap_sentences(setup, traps),
            *remarks,
            standing,
            # The sentences of a sequence state the effect of real air on it.
            *(
                ()
                if setup.in_turn
                else in_real_air(pressures, setup.target, steepening, setup.foci)
            ),
        ),
        # The steepening estimate is only invalid far above the threshold, where it is not needed.
        sensation=sensations(
            setup,
            changes * np.fmin(pressures, pressures * steepening.kept),
            computed.sequence,
            default_level(setup, drive, transfer, computed.sequence),
        ),
        warnings=warnings,
        seconds=clock.seconds,
    )


def _felt_in_turn(
    setup: Setup,
    transfer: TransferMatrix,
    drives: Complex128[np.ndarray, "foci elements"],
    comparison: Comparison,
) -> Comparison:
    """Return the comparison for a focus that runs through the points one by one."""
    from airtact.setup.sequences import drives_at_foci, pressures_of

    compared = [drives]
    control = control_drive(setup, partial(drives_at_foci, setup))
    if control is not None:
        compared.append(control)
    at_foci = np.einsum("fe,fe->f", transfer.matrix[: len(drives)], drives)
    pressures = pressures_of(transfer, compared)
    return replace(comparison, pressures=pressures, at_foci=at_foci[:, None])
