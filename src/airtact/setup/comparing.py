"""Comparison of drives, or of all methods for a setup, with a single solve."""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import overload

import numpy as np
from jaxtyping import Float64

from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.problem import RadiatedField, Solver, SolveReport
from airtact.acoustics.target import Target
from airtact.drives.drive import Drive, quantise
from airtact.drives.max_min import upper_bound
from airtact.drives.methods import FOR_SAMPLES, METHODS, method_for
from airtact.drives.nearest import nearest_drive
from airtact.drives.transfer import TransferMatrix
from airtact.errors import InvalidInput, counted, of_kind, one_line
from airtact.evaluation.comparison import Comparison
from airtact.evaluation.comparison import compare as compare_drives
from airtact.evaluation.metrics import in_real_air, radiate_drives
from airtact.evaluation.steepening import steepening
from airtact.files.atomic import whole_file, writable_folder
from airtact.setup.rendering import save_drive
from airtact.setup.sentences import all_at_once, reach_cautions
from airtact.setup.setup import Setup
from airtact.setup.solving import (
    control_drive,
    drive_names,
    named,
    other_samples,
    solve_beacons,
    stored,
    synthesise,
    transfer_to_array,
    verification_solver,
)
from airtact.timing import Clock, Progress
from airtact.transducers.layout import PhasedArray


@dataclass(frozen=True, eq=False)
class Contender:
    """A method and the drive that it computed, as one entry of a ``MethodComparison``.

    Attributes
    ----------
    name : name of the method, such as "max min"; the name of a drive from a file, or of its
        corrected version; or a name such as "hand ignored" for the drive computed without the
        bodies (the control).
    drive : drive computed by the method.
    emitted : the drive rounded to the amplitude and phase levels ``setup.levels``.
    pressures : (F,) peak pressure of ``emitted`` at each focus, with the bodies in place [Pa].
    suppression_points : (Q,) peak pressure of ``emitted`` at each suppression point [Pa].
    seconds : computing time of the method, without the solve for the transfer matrix [s].
    kept : pressure that the weakest focus exceeds in 9 out of 10 samples of the setup's
        ``uncertainty``, computed from ``emitted`` [Pa]; None if the setup has no uncertainty.
    """

    name: str
    drive: Drive
    emitted: Drive
    pressures: Float64[np.ndarray, "foci"]
    suppression_points: Float64[np.ndarray, "suppressed"]
    seconds: float
    kept: float | None = None

    @property
    def energy(self) -> float:
        """Mean of |d|² over the elements; 1 if all elements are at full scale."""
        return self.drive.energy / len(self.drive)

    @property
    def suppression_level(self) -> float:
        """Mean p² at the suppression points relative to the foci [dB]; NaN if there is no point."""
        if not len(self.suppression_points):
            return float("nan")
        ratio = np.mean(self.suppression_points**2) / np.mean(self.pressures**2)
        return float(10.0 * np.log10(ratio))


@dataclass(frozen=True, eq=False, repr=False)
class MethodComparison:
    """Drives of all methods for a setup, from one transfer matrix, as returned by ``compare``.

    All drives are verified at the foci by a single second solve. The attribute ``best``
    contains the best method and its drive.

    Attributes
    ----------
    setup : the scene, array and target.
    default : name of the method that ``method = "best"`` selects for this setup; it is ranked first
        among methods that are equally good.
    contenders : one ``Contender`` for each method that returned a drive, with its pressures at the
        foci; then the drives that were passed to ``compare`` and their corrected versions; then the
        control, a drive computed without the bodies. In open air, there is no control.
    warnings : warnings about the setup, about methods that returned no drive or stopped early, and
        about the verification.
    transfer : transfer matrix from which the drives were computed.
    beacons : report of the solve for the transfer matrix, whose sources are beacons at the foci.
    bound : upper bound [Pa] on the smallest ratio of pressure to weight that any drive up to full
        scale can reach. The weight of a focus is its requested pressure, its share (relative
        pressure), or 1.
    field : field of the verification solve, with one excitation for each contender.
    seconds : wall time of each step [s].
    """

    setup: Setup
    default: str
    contenders: Sequence[Contender]
    warnings: Sequence[str]
    transfer: TransferMatrix
    beacons: SolveReport
    bound: float
    field: RadiatedField
    seconds: Mapping[str, float]

    def __repr__(self) -> str:
        best = self.best
        pressure = best.pressures[self.setup.target.weakest(best.pressures)]
        return one_line(self, *self.setup.bodies, f"best {best.name}, {pressure:,.0f} Pa")

    @property
    def report(self) -> SolveReport:
        """Report of the verification solve."""
        return self.field.report

    @property
    def tolerance(self) -> float:
        """Relative difference of pressures up to which methods are considered equally good.

        The tolerance is the estimated error of the verification, but at least 1 %.
        """
        return max(self.report.estimated_error, 0.01)

    @property
    def equally_good(self) -> list[Contender]:
        """Methods whose pressure at the weakest focus is at most ``tolerance`` below the best."""
        largest = max(map(self.of_the_bound, self.contenders))
        return [
            contender
            for contender in self.contenders
            if self.of_the_bound(contender) >= (1.0 - self.tolerance) * largest
        ]

    @property
    def best(self) -> Contender:
        """Method with the highest pressure at the weakest focus; among equals, the default one."""
        return self.ranked[0]

    @property
    def ranked(self) -> list[Contender]:
        """The contenders from best to worst; among equals, the default method comes first."""
        equal = self.equally_good

        def rank(contender: Contender) -> tuple[bool, bool, float]:
            default = contender in equal and contender.name == self.default
            return contender not in equal, not default, -self.of_the_bound(contender)

        return sorted(self.contenders, key=rank)

    def worst(self, contender: Contender) -> float:
        """Return a method's smallest ratio of pressure to weight [Pa]; weights of 0 are ignored."""
        weights = self.setup.target.weights
        requested = weights > 0.0
        return float((contender.pressures[requested] / weights[requested]).min())

    def of_the_bound(self, contender: Contender) -> float:
        """Return the pressure at the weakest focus at full scale, divided by its upper bound."""
        return self.worst(contender) / contender.emitted.peak / self.bound

    def label(self, contender: Contender) -> str:
        """Return the name of a method, marked if it is the default."""
        return f"{contender.name} (default)" if contender.name == self.default else contender.name

    def save(self, folder: str | Path) -> Path:
        """Write methods.csv and the drives (.h5) to a folder; return the path of methods.csv.

        Existing files are replaced.
        """
        folder = Path(folder)
        drives = writable_folder(folder / "drives")
        for contender in self.contenders:
            file = drives / f"{contender.name.replace(', ', '_').replace(' ', '_')}.h5"
            save_drive(file, contender.drive, self.setup, self.transfer, self.beacons)
        table = folder / "methods.csv"
        with whole_file(table) as partial, partial.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(["method", "focus", "pressure_Pa", "weight", "energy", "seconds"])
            for contender in self.contenders:
                for focus, pressure, weight in zip(
                    self.setup.foci, contender.pressures, self.setup.target.weights, strict=True
                ):
                    writer.writerow(
                        [
                            contender.name,
                            focus,
                            f"{pressure:.6g}",
                            f"{weight:.6g}",
                            f"{contender.energy:.6g}",
                            f"{contender.seconds:.3g}",
                        ]
                    )
        return table


@overload
def compare(
    scene: Setup,
    *,
    drives: Mapping[str, Drive] | None = None,
    store: str | Path | None = None,
    progress: Progress | None = None,
) -> MethodComparison: ...


@overload
def compare(
    scene: Scene,
    array: PhasedArray,
    drives: Mapping[str, Drive],
    target: Target,
    *,
    solver: Solver,
    progress: Progress | None = None,
) -> Comparison: ...


def compare(
    scene: Setup | Scene,
    array: PhasedArray | None = None,
    drives: Mapping[str, Drive] | None = None,
    target: Target | None = None,
    *,
    solver: Solver | None = None,
    store: str | Path | None = None,
    progress: Progress | None = None,
) -> MethodComparison | Comparison:
    """Compare all methods for a setup, or compare given drives.

    The arguments select one of three modes:

    - A setup: every method computes a drive from the same transfer matrix. The method chosen in the
      setup is ignored. A method that fails is skipped, and a warning in the result states why.
    - A setup and ``drives``, for example from another program: they are compared with the drive of
      the method "best", and each with a corrected version of itself. The phases of this version
      differ as little as possible, but its weakest focus reaches 95 % of the upper bound for drives
      with the same amplitudes (see ``nearest_drive``). A drive that already reaches this pressure
      has no corrected version. If these amplitudes keep the focus below 94 % of the bound for
      drives with the same largest amplitude, for example because elements are silent, all elements
      of the corrected version emit at full scale.
    - A ``Scene``, ``array``, ``drives``, ``target`` and ``solver``: the drives are compared as they
      are, by ``evaluation.compare``.

    With a setup that contains bodies, a drive computed without them is added. All drives of a setup
    are rounded to its levels, and a second solve computes their pressures.

    Parameters
    ----------
    scene : the ``Setup``, such as one from ``read_scene``, or the ``Scene``, for which the drives
        are compared.
    array, target, solver : the E transducers and the foci in the frame of the scene, and the solver
        for the pressures; required with a scene, and ignored with a setup.
    drives : dict from names to drives of E elements; required with a scene, optional with a setup.
    store : folder in which solved fields of a setup are stored and reused; by default, they are not
        stored. Ignored with a scene.
    progress : function called with a description of each step as it begins.

    Returns
    -------
    For a setup, a ``MethodComparison`` with the drives and their pressures at the foci. For a
    scene, a ``Comparison`` with the pressures for three normalisations of the drives.

    Raises
    ------
    InvalidInput
        If all methods fail, if two foci of a setup are less than a tenth of a wavelength apart, if
        a drive is silent or does not have as many elements as the array, or if a focus or an
        element is inside a body. For a scene, the error is also raised if ``array``, ``drives``,
        ``target`` or ``solver`` is missing.
    NotConverged
        If a solver stopped before it converged.
    """
    if isinstance(scene, Setup):
        return _compare_methods(
            scene, None if store is None else Path(store), Clock(progress), drives or {}
        )
    return compare_drives(scene, array, drives, target, solver=solver, progress=progress)  # pyright: ignore[reportArgumentType]


def _compare_methods(
    setup: Setup, store: Path | None, clock: Clock, given: Mapping[str, Drive]
) -> MethodComparison:
    for name, drive in given.items():
        of_kind(drive, Drive, f"the drive {name!r}", "a Drive, such as one returned by load_drive")
        if len(drive) != len(setup.array):
            raise InvalidInput(
                f"{name} has {len(drive)} elements, but the array of the scene has "
                f"{len(setup.array)}; use the array for which the drive was computed.",
                code="sizes_differ",
            )
        if drive.peak == 0.0:
            raise InvalidInput(f"{name} is silent: all amplitudes are 0. Omit it.", code="all_zero")
    verifier = verification_solver(setup)
    beacons = solve_beacons(setup, clock, store, verifier=verifier)
    transfer, report = transfer_to_array(setup, beacons, clock)
    # "best" just selects another method. Methods for samples require an uncertainty.
    methods = [
        name
        for name in METHODS
        if name != "best" and (name not in FOR_SAMPLES or setup.uncertainty is not None)
    ]
    if given:
        methods = [method_for(setup.target)]
    drives: dict[str, Drive] = {}
    warnings: list[str] = []
    times = Clock()
    with clock.step(
        "drives", f"computing the drive by {counted(len(methods), 'method', 'methods')}"
    ):
        bound = upper_bound(transfer, setup.target).worst
        for method in methods:
            words = method.replace("_", " ")
            try:
                with times.step(words):
                    drives[words], stalled = synthesise(setup.maker(method), transfer, setup.target)
                warnings += stalled
            # If a method fails, for instance because foci are too close, continue with the rest.
            except InvalidInput as fault:
                warnings.append(f"{words} returned no drive: {fault}")
        for name, drive in given.items():
            with times.step(name):
                drives[name] = drive
            with times.step(f"{name}, corrected"):
                corrected = nearest_drive(transfer, setup.target, drive)
                # Silent elements can keep all drives with these amplitudes below the share.
                share = _weakest(transfer, setup.target, corrected) / (bound * drive.peak)
                if share < 0.94 and drive.magnitudes.min() < 0.999 * drive.peak:
                    corrected = nearest_drive(
                        transfer, setup.target, Drive(np.exp(1j * drive.phases))
                    )
            if corrected is not drive:
                drives[f"{name}, corrected"] = corrected
            pressures = [
                _weakest(transfer, setup.target, signed)
                for signed in (drive, Drive(np.conj(drive.amplitudes)))
            ]
            if pressures[1] >= 2.0 * pressures[0] > 0.0:
                warnings.append(
                    f"with the opposite sign of all phases, {name} would produce "
                    f"{pressures[1] / pressures[0]:.2g} times the pressure at its weakest focus. "
                    "The program that wrote it may use e^(+jωt): conjugate the amplitudes."
                )
        if not drives:
            raise InvalidInput(f"no method returned a drive; {warnings[0]}", code="empty")
        name = drive_names(setup.bodies)[-1]
        # The control is the best drive that ignores the bodies.
        with times.step(name):
            control = control_drive(setup, setup.maker("best"))
        if control is not None:
            drives[name] = control
    # Boards emit rounded drives, so verify and compare those.
    emitted = {name: quantise(drive, setup.levels).drive() for name, drive in drives.items()}
    with clock.step(
        "verify",
        f"verifying {len(drives)} drives by a solve with all transducers as sources",
    ):
        field = radiate_drives(
            setup.scene,
            setup.array,
            list(emitted.values()),
            stored(verifier, store),
            foci=setup.target.points,
        )
        at_foci = np.abs(field.at(setup.target.points).T)
        strongest = int(at_foci.max(axis=1).argmax())
        steepened = steepening(
            setup.scene, field.sources, setup.target.points, at_foci[strongest], strongest
        )
        suppressed = np.abs(field.at(setup.target.suppression_points).T)
    kept: dict[str, float] = {}
    if setup.uncertainty is not None:
        weights = setup.target.weights
        requested = np.flatnonzero(weights > 0.0)
        with clock.step("doubt", "evaluating the drives on other samples of the uncertainty"):
            samples = other_samples(setup, transfer)
            for (name, drive), pressures in zip(emitted.items(), at_foci, strict=True):
                ratios = np.abs(samples.pressures(drive)[:, requested]) / weights[requested]
                kept[name] = float(
                    np.quantile(ratios.min(axis=1), 0.1) * weights[setup.target.weakest(pressures)]
                )
    return MethodComparison(
        setup=setup,
        default=method_for(setup.target).replace("_", " "),
        contenders=[
            Contender(
                name,
                drives[name],
                emitted[name],
                pressures,
                suppression_points,
                times.seconds[name],
                kept.get(name),
            )
            for name, pressures, suppression_points in zip(
                emitted, at_foci, suppressed, strict=True
            )
        ],
        warnings=[
            *reach_cautions(setup),
            *all_at_once(setup),
            *warnings,
            *in_real_air(at_foci[strongest], setup.target, steepened, setup.foci),
            *named(field.report.warnings, setup.bodies),
        ],
        transfer=transfer,
        beacons=report,
        bound=bound,
        field=field,
        seconds=clock.seconds,
    )


def _weakest(transfer: TransferMatrix, target: Target, drive: Drive) -> float:
    """Return the smallest ratio of pressure to weight [Pa] at foci with positive weight."""
    asked = target.weights > 0.0
    pressures = np.abs(transfer.pressure(drive)[: len(asked)][asked])
    return float((pressures / target.weights[asked]).min())
