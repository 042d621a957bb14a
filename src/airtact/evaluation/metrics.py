"""The field of a drive from an independent solver, the pressure at its foci, and sentences."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Complex128, Float64, Num, Real

from airtact.acoustics.scene import Scene, check_outside
from airtact.acoustics.solvers.problem import BOARDS, PLANES, RadiatedField, Solver, SolveReport
from airtact.acoustics.sources import Monopoles, check_off_sources
from airtact.acoustics.target import Target
from airtact.drives.drive import Drive, check_drive
from airtact.drives.transfer import fraction
from airtact.errors import InvalidInput, as_sentence, counted, of_kind, one_line, points_of
from airtact.evaluation.steepening import Steepening, steepening
from airtact.timing import Progress, no_progress
from airtact.transducers.layout import PhasedArray
from airtact.transducers.placement import check_placement, strength_in


def drive_sources(
    array: PhasedArray, drives: Sequence[Drive], scene: Scene | None = None
) -> Monopoles:
    """Return the points on the faces of all elements as monopoles with one excitation per drive.

    ``Solver.radiate`` computes the field of these monopoles.

    Parameters
    ----------
    array : the transducers: E elements with Q face points each, in the frame of the scene.
    drives : S drives of E elements each.
    scene : the scene; required if it contains reflecting boards or a plane. The strength of an
        element in the face of a board, or of a directional element flush with the plane, is halved,
        because its sensitivity already includes the reflection.

    Returns
    -------
    ``Monopoles`` with E·Q positions, ordered by element, and strengths (E·Q, S). For each drive,
    the strength at point j of the face of element e is sensitivity · w_j · g_e · d_e [Pa·m], where
    w_j is the weight of the point, g_e the gain of the element and d_e its drive.

    Raises
    ------
    InvalidInput
        If there is no drive, or if a drive is silent (all amplitudes are 0 or belong to dead
        elements), does not have as many elements as the array or is not a ``Drive``. If the scene
        contains boards, but an element does not lie in the face of any board.
    """
    of_kind(array, PhasedArray, "the array", "one such as surrounding_box()")
    of_kind(drives, Collection, "the drives", "a list of drives")
    if len(drives) == 0:
        raise InvalidInput("there is no drive; pass at least one.", code="too_few")
    for index, drive in enumerate(drives):
        name = f"drive {index}" if len(drives) > 1 else "the drive"
        check_drive(drive, name, "array", len(array))
        # Dead elements have a gain of 0, so a drive that uses only those is silent as well.
        if not (array.gains * drive.amplitudes).any():
            raise InvalidInput(
                f"{name} is silent: all amplitudes are 0 or belong to dead elements. Use a "
                "drive that emits sound.",
                code="all_zero",
            )
    # (E, 1) gains times (E, S) amplitudes, then (1, Q, 1) weights: element by element, as
    # ``face_points`` are.
    amplitudes = array.gains[:, None] * np.stack([drive.amplitudes for drive in drives], axis=1)
    if scene is not None:
        amplitudes = amplitudes * strength_in(scene, array)[:, None]
    strengths = (
        array.element.sensitivity * array.element.weights[None, :, None] * amplitudes[:, None, :]
    )
    return Monopoles(array.face_points.reshape(-1, 3), strengths.reshape(-1, len(drives)))


def radiate_drives(
    scene: Scene,
    array: PhasedArray,
    drives: Sequence[Drive],
    solver: Solver,
    *,
    foci: Real[np.ndarray, "foci 3"] | None = None,
    points: Mapping[str, Float64[np.ndarray, "points 3"]] | None = None,
    progress: Progress | None = None,
) -> RadiatedField:
    """Solve for the fields of several drives at once, with one right-hand side per drive.

    The function also checks the placement: the foci and other ``points`` must lie outside the
    bodies and away from the elements. In messages, a misplaced point is named by its key in
    ``points``. The function raises ``InvalidInput`` if a point is misplaced, if the array is too
    close to a body or faces away from it, or if a drive is silent or does not have as many elements
    as the array.
    """
    # Users often pass the class instead of an instance; the message then names that class.
    kind = solver.__name__ if isinstance(solver, type) else "BoundaryElement"
    of_kind(solver, Solver, "the solver", f"an instance such as {kind}()")
    sources = drive_sources(array, drives, scene)
    check_placement(scene, array, foci)
    # Foci first, so that the message names a focus if several points are misplaced.
    checked = dict(points or {}) if foci is None else {"focus": foci, **(points or {})}
    for word, positions in checked.items():
        if len(positions):
            check_outside(scene, positions, word)
            check_off_sources(positions, sources)
    return solver.reporting(progress).radiate(scene, sources)


def field_map(
    scene: Scene,
    array: PhasedArray,
    drive: Drive,
    points: Real[np.ndarray, "points 3"],
    *,
    solver: Solver,
    progress: Progress | None = None,
) -> Complex128[np.ndarray, "points"]:
    """Return the complex pressure of a drive at any points, including scattering by all bodies.

    The function performs a single solve, whose sources are the points on the faces of all elements.
    No transfer matrix is used, so the result can verify a drive that was computed from a transfer
    matrix.

    Parameters
    ----------
    scene : the air and the bodies in it.
    array : the transducers in the scene's frame; see ``PhasedArray.seen_from``.
    drive : the drive of the array.
    points : (P, 3) points at which the pressure is evaluated [m]. Behind the faces of directional
        elements the result is meaningless, because real elements are shielded there.
    solver : solver for the field. To verify a drive, use a more accurate solver than the one
        used for its transfer matrix, or a solver based on another method.
    progress : function, such as ``print``, that is called with a description of each step as it
        begins.

    Returns
    -------
    (P,) complex peak value of the total pressure [Pa], NaN inside bodies (except filled ones) and
    behind a rigid plane.

    Raises
    ------
    InvalidInput
        If the drive is silent or does not have as many elements as the array, if an element is
        inside a body, if a body is behind the face of a directional element, if a point is NaN,
        infinite or within 1 nm of a source, if the solver does not support the bodies, or if an
        argument has the wrong type.
    NotConverged
        If the solver stops before it converges.
    """
    points = points_of(points, "points", least=0)
    # Check before the solve, because that may take a minute.
    check_off_sources(points, drive_sources(array, [drive], scene))
    field = radiate_drives(scene, array, [drive], solver, progress=progress)
    (progress or no_progress)(f"evaluating the field at {counted(len(points), 'point', 'points')}")
    return field.at(points)[:, 0]


# Limits of a computed pressure without planes or reflecting boards (Inoue, Makino and Shinoda,
# 2014, section 3.1)
NOT_MODELLED = (
    "The array's own boards, the table and the walls do not reflect, and the elements' sensitivity "
    "is not calibrated."
)


def not_modelled(report: SolveReport) -> str:
    """Return a sentence that lists the effects that a solver's pressures do not include."""
    # Solvers record planes and boards in their settings, which are stored with a field.
    planes = PLANES in report.settings
    if BOARDS in report.settings:
        walls = "Tables and walls"
        if planes:
            walls += " other than the scene's rigid plane"
        return (
            f"{walls} do not reflect, the boards have no gaps, and the elements' sensitivity is "
            "not calibrated."
        )
    if planes:
        return (
            "The array's own boards, and tables and walls other than the scene's rigid plane, do "
            "not reflect, and the elements' sensitivity is not calibrated."
        )
    return NOT_MODELLED


def pascals(pressure: float) -> str:
    """Format a pressure [Pa] with three digits, in kPa from 1 kPa upwards."""
    # Round first: 999.8 Pa becomes 1.00 kPa.
    rounded = float(f"{pressure:.3g}")
    if rounded < 1e3:
        return f"{rounded:.3g} Pa"
    return f"{rounded / 1e3:.{max(0, 2 - int(np.log10(rounded / 1e3)))}f} kPa"


def weakest_focus(
    pressures: Float64[np.ndarray, "foci"], target: Target, foci: Sequence[str] = ()
) -> tuple[str, str]:
    """Return the pressure at the focus that is weakest relative to its request, and its name.

    Parameters
    ----------
    pressures : (F,) peak pressure at each focus [Pa].
    target : the foci and their requests.
    foci : a name for each focus, or for each focus of one frame if the foci move.

    Returns
    -------
    The pressure as text, and the name. The name is empty if all foci have the same request.
    """
    index = target.weakest(pressures)
    requests = target.weights[target.weights > 0.0]
    name = ""
    if not np.allclose(requests, requests[0]):
        name = foci[index % len(foci)] if foci else f"focus {index + 1}"
    return pascals(float(pressures[index])), name


def at_weakest(
    pressures: Float64[np.ndarray, "foci"], target: Target, foci: Sequence[str] = ()
) -> str:
    """Return a phrase with the pressure at the weakest focus (see ``weakest_focus``)."""
    amount, name = weakest_focus(pressures, target, foci)
    where = f"{name}, the weakest relative to its request" if name else "the weakest focus"
    return f"{amount} at {where}"


def in_real_air(
    pressures: Num[np.ndarray, "foci"],
    target: Target,
    steepening: Steepening | None,
    foci: Sequence[str] = (),
) -> tuple[str, ...]:
    """Return a sentence on the focus with the strongest nonlinear steepening, if it is noticeable.

    Parameters
    ----------
    pressures : (F,) pressures computed by linear acoustics [Pa].
    target : the F foci; those whose requested pressure or share is 0 are ignored.
    steepening : nonlinear steepening at the F foci; None if it was not estimated. foci : a name for
        each focus. If there are several foci, the sentence names the one with the strongest
        steepening, which is often not the weakest.
    """
    if steepening is None:
        return ()
    known = np.nan_to_num(steepening.second)
    focus = int(np.where(target.weights > 0.0, known, -1.0).argmax())
    # A second harmonic of 10 % is 20 dB lower and takes at most 0.5 % from the fundamental.
    if known[focus] < 0.1:
        return ()
    computed = pascals(float(np.abs(pressures[focus])))
    cause = "nonlinear steepening in air"
    if len(known) > 1:
        # Tables without names number the foci from 0.
        name = foci[focus] if foci else f"focus {focus}"
        computed = f"Nonlinear steepening in air is strongest at {name}: {computed}"
        cause = "it"
    kept = float(steepening.kept[focus])
    if np.isnan(kept):
        return (
            f"{computed} computed, but shocks caused by {cause} limit the pressure: "
            "the real pressure is lower by an unknown amount.",
        )
    return (
        f"{computed} computed, {pascals(kept * float(np.abs(pressures[focus])))} expected with "
        f"{cause} (second harmonic {100 * steepening.second_harmonic[focus]:.0f} %).",
    )


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The pressure at each focus for a drive, in pascals and relative to the request.

    ``evaluate`` returns it. The attribute ``magnitudes`` contains the peak pressures [Pa], and
    ``shares`` their ratios to the requested pressures. Printing it shows a table of the foci.

    Attributes
    ----------
    target : the ``Target`` with F foci and their requested pressures.
    pressures : (F,) complex peak pressure at each focus in the order of the target, by linear
        acoustics [Pa].
    report : ``SolveReport`` of the solver that computed the pressures, with the error estimated at
        the foci.
    field : ``RadiatedField`` of the drive, which can be evaluated at points other than the foci;
        None if several drives were solved together, as by ``verify``.
    steepening : ``Steepening`` at the foci, from which ``expected`` follows; None if it was not
        estimated.
    """

    target: Target
    pressures: Complex128[np.ndarray, "foci"]
    report: SolveReport
    field: RadiatedField | None = None
    steepening: Steepening | None = None

    def __repr__(self) -> str:
        return one_line(self, counted(len(self.pressures), "focus", "foci"), *self._summary(".0f"))

    def _summary(self, form: str) -> tuple[str, str]:
        if self.target.pressures is None:
            weakest = self.target.weakest(self.magnitudes)
            _, name = weakest_focus(self.magnitudes, self.target)
            # The table numbers the foci from 0.
            words = (
                f"focus {weakest}, the weakest relative to its share," if name else "weakest focus"
            )
            mean = self.magnitudes[self.target.weights > 0.0].mean()
            return f"{words} {self.magnitudes[weakest]:{form}} Pa", f"mean {mean:{form}} Pa"
        return f"weakest focus {self.worst:.1%} of the request", f"mean {self.mean:.1%}"

    @property
    def magnitudes(self) -> Float64[np.ndarray, "foci"]:
        """(F,) peak pressure at each focus [Pa]."""
        return np.abs(self.pressures)

    @property
    def expected(self) -> Float64[np.ndarray, "foci"]:
        """(F,) peak pressure [Pa], reduced by nonlinear steepening in air; NaN where unknown."""
        return self.magnitudes * (self.steepening.kept if self.steepening else np.nan)

    @property
    def second_harmonic(self) -> Float64[np.ndarray, "foci"]:
        """(F,) ratio of the second harmonic to ``expected``; NaN where unknown."""
        if self.steepening is None:
            return np.full(len(self.pressures), np.nan)
        return self.steepening.second_harmonic

    @property
    def shares(self) -> Float64[np.ndarray, "foci"]:
        """(F,) ratio of pressure to requested pressure; NaN where 0 Pa or nothing is requested."""
        return fraction(self.magnitudes, self.target)

    @property
    def counted(self) -> Float64[np.ndarray, "counted"]:
        """Values from which ``worst``, ``mean`` and ``uniformity`` are computed.

        Foci whose requested pressure or share is 0 are left out. The values are fractions of the
        requested pressures if pressures are requested. Otherwise they are pressures [Pa], divided
        by the requested shares if there are any.
        """
        # Foci without a request have no share and must not be treated as the worst.
        if self.target.pressures is not None:
            return self.shares[np.isfinite(self.shares)]
        asked = self.target.weights > 0.0
        return self.magnitudes[asked] / self.target.weights[asked]

    @property
    def worst(self) -> float:
        """Smallest value in ``counted``: a ratio to the requested pressure, or a pressure [Pa]."""
        return float(self.counted.min())

    @property
    def mean(self) -> float:
        """Mean of ``counted``: a ratio to the requested pressure, or a pressure [Pa]."""
        return float(self.counted.mean())

    @property
    def uniformity(self) -> float:
        """Uniformity of the values in ``counted``, defined as 1 − (max − min)/(max + min).

        Di Leonardo, Ianni and Ruocco (Optics Express 15, 1913, 2007) define this measure for
        intensities.
        """
        # If all foci are silent, return 0 instead of dividing 0 by 0.
        high = self.counted.max()
        low = self.counted.min()
        return float(1.0 - (high - low) / (high + low)) if high > 0.0 else 0.0

    def __str__(self) -> str:
        lines = ["focus   x [mm]    y [mm]    z [mm]   pressure [Pa] request [Pa]    share"]
        asked = self.target.pressures
        columns = zip(1e3 * self.target.points, self.magnitudes, self.shares, strict=True)
        for index, ((x, y, z), magnitude, share) in enumerate(columns):
            request = "-" if asked is None else f"{asked[index]:.1f}"
            reached = "-" if np.isnan(share) else f"{share:.1%}"
            lines.append(
                f"{index:>5}{x:>9.2f} {y:>9.2f} {z:>9.2f} {magnitude:>15.1f} {request:>12} "
                f"{reached:>8}"
            )
        report = self.report
        return "\n".join(
            [
                *lines,
                f"{', '.join(self._summary('.1f'))}, uniformity {self.uniformity:.3f}",
                f"peak pressures by {report.solver}, estimated error {report.estimated_error:.2g}, "
                f"residual {report.residual:.1e}. {not_modelled(report)}",
                *in_real_air(self.pressures, self.target, self.steepening),
                *map(as_sentence, report.warnings),
            ]
        )


def evaluate(
    scene: Scene,
    array: PhasedArray,
    drive: Drive,
    target: Target,
    *,
    solver: Solver,
    progress: Progress | None = None,
) -> Evaluation:
    """Compute the pressure of a drive at the foci, with a single solve for the whole array.

    The sources of the solve are the points on the faces of all elements. It does not use a transfer
    matrix, so the result can verify a drive that was computed from one.

    Parameters
    ----------
    scene : the air and the bodies in it. Its frame is called the obstacles' frame.
    array : the E transducers in the obstacles' frame; see ``PhasedArray.seen_from``.
    drive : the drive of the array, with E complex amplitudes as fractions of full scale.
    target : the F foci in the obstacles' frame, and their requested pressures. The requests only
        affect the summary; suppression points are ignored.
    solver : solver for the field. To verify a drive, use a more accurate solver than the one
        used for its transfer matrix, or a solver based on another method.
    progress : function, such as ``print``, that is called with a description of each step as it
        begins.

    Returns
    -------
    An ``Evaluation`` with the complex pressures (F,) at the foci [Pa] and the report of the solver.
    These pressures are linear in the drive; ``expected`` contains the pressures reduced by
    nonlinear steepening in air.

    Raises
    ------
    InvalidInput
        If the drive is silent or does not have as many elements as the array, if elements overlap,
        if an element or a focus is inside a body or behind a plane, if a focus or a body is behind
        the face of a directional element, if a focus is on an element, or if an argument has the
        wrong type.
    NotConverged
        If the solver stops before it converges.
    """
    of_kind(target, Target, "the target", "Target(points, pressures)")
    field = radiate_drives(scene, array, [drive], solver, foci=target.points, progress=progress)
    # Contiguous, because the array is shared and stored.
    pressures = np.ascontiguousarray(field.at(target.points)[:, 0])
    return Evaluation(
        target,
        pressures,
        field.report_at(target.points),
        field,
        steepening(scene, field.sources, target.points, pressures),
    )


Modulation = Literal["amplitude", "spatiotemporal"]

# Smallest perceptible peak pressure [Pa], for amplitude modulation at 200 Hz or a moving focus.
# From T. Howard et al. 2019.
THRESHOLDS: dict[str, float] = {"amplitude": 557.0, "spatiotemporal": 334.0}


def constant_force_note(fastest: float = np.inf) -> str:
    """Return a note that recommends modulation at 200 Hz, or at ``fastest`` [Hz] if that is lower.

    Examples
    --------
    >>> constant_force_note(44.1).partition(": ")[2]
    'set kind = "am" and frequency = 44 in [drive.modulation] of the scene file, or play the ...
    """
    frequency = min(int(fastest), 200) if np.isfinite(fastest) else 200
    keys = 'kind = "am"' if frequency == 200 else f'kind = "am" and frequency = {frequency}'
    return (
        f"The skin hardly feels a constant force: set {keys} in [drive.modulation] of the "
        f"scene file, or play the drive with --modulate am:{frequency}."
    )


def sensation(
    pressure: float,
    modulation: Modulation | None,
    depth: float = 1.0,
    fastest: float = np.inf,
    speed: float | None = None,
) -> str:
    """Return a sentence that compares the weakest focus with the threshold of perception.

    Parameters
    ----------
    pressure : peak pressure at the weakest focus [Pa].
    modulation : kind of modulation; None for a constant drive.
    depth : modulation depth of the force.
    fastest : highest modulation frequency of the boards [Hz].
    speed : speed of the focus along its path [m/s]; None if it does not move along a path.

    Examples
    --------
    >>> sensation(5570.0, "amplitude").partition(" with ")[0]
    'The weakest focus is 20 dB above the threshold of detection'
    """
    if modulation is None:
        return constant_force_note(fastest)
    words = (
        f"The weakest focus is {level_above_threshold(pressure, modulation, depth)} the "
        f"threshold of detection with {modulation} modulation, {THRESHOLDS[modulation]:g} Pa "
        "(T. Howard et al. 2019, measured with an Ultraleap STRATOS and cited from a secondary "
        "source that states neither peak nor rms; thresholds vary between people and places on "
        "the skin by several decibels)."
    )
    if speed is not None and not 5.0 <= speed <= 8.0:
        words += (
            f" The focus moves at {speed:.2g} m/s, but feels strongest at 5 to 8 m/s (W. Frier et "
            "al. 2018). The source of the threshold does not state its speed, so at this speed the "
            "focus may be hardly felt."
        )
    return words


def level_above_threshold(pressure: float, modulation: Modulation, depth: float = 1.0) -> str:
    """Format the level of a pressure [Pa] relative to the threshold, such as "20 dB above"."""
    # The depth refers to the force, which is proportional to the square of the pressure.
    felt = max(pressure * np.sqrt(depth), np.finfo(float).tiny)
    # Nine digits hide the rounding of the logarithm.
    level = round(20.0 * float(np.log10(felt / THRESHOLDS[modulation])), 9)
    return f"{abs(level):.0f} dB {'above' if level >= 0 else 'below'}"
