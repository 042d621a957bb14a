"""Comparison of drives at equal peak, at equal energy, by their phases alone, and on samples."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Complex128, Float64, Real

import airtact as at
from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.problem import RadiatedField, Solver, SolveReport
from airtact.acoustics.target import Target
from airtact.drives.drive import Drive, check_drive
from airtact.errors import InvalidInput, as_sentence, counted, in_short, of_kind, one_line
from airtact.evaluation.metrics import (
    at_weakest,
    in_real_air,
    not_modelled,
    pascals,
    radiate_drives,
    weakest_focus,
)
from airtact.evaluation.steepening import Steepening, steepening
from airtact.timing import Progress
from airtact.transducers.layout import PhasedArray

# The normalisations of a comparison, and what each holds equal
HELD_EQUAL = {
    "equal peak": "the strongest element of every drive is at full scale",
    "equal energy": "Σ|d|² is the largest value that every drive can reach within full scale",
    "phase only": "every drive keeps its phases, and every active element is at full scale",
}


@dataclass(frozen=True, eq=False)
class Comparison:
    """The pressure at each of F foci for D drives, as returned by ``compare``.

    Printing it shows the pressure at the weakest focus of each drive, followed by its ratio to that
    of the first drive in brackets. ``weakest``, ``ratios`` and ``table`` return these numbers.

    Attributes
    ----------
    names : names of the drives; the first is the reference.
    target : the ``Target`` with the foci.
    pressures : dict from each normalisation to the peak pressure (D, F) of each drive at each focus
        [Pa]. The normalisations are "equal peak", with the strongest element of each drive at full
        scale; "equal energy", with the largest Σ|d|² that all drives can reach within full scale;
        and "phase only", with the drive's phases and every active element at full scale.
    field : ``RadiatedField`` with S excitations. The first D excitations are the drives at equal
        peak. They are followed by the phase-only version of each drive whose amplitudes are
        unequal.
    phase_columns : for each drive, the index of its phase-only version among the excitations of
        ``field``; the drive's own index if its amplitudes are equal.
    at_foci : (F, S) complex peak pressure of each excitation of ``field`` at the foci [Pa].
    """

    names: tuple[str, ...]
    target: Target
    pressures: Mapping[str, Float64[np.ndarray, "drives foci"]]
    field: RadiatedField
    phase_columns: tuple[int, ...]
    at_foci: Complex128[np.ndarray, "foci excitations"]

    def __repr__(self) -> str:
        pressure, name = self._strongest()
        return one_line(
            self,
            counted(len(self.names), "drive", "drives"),
            counted(len(self.target.points), "focus", "foci"),
            f"highest pressure at the weakest focus {pressure:.0f} Pa at equal peak, with {name!r}",
        )

    def _strongest(self) -> tuple[float, str]:
        # Full scale is the limit of the hardware, so equal peak decides. Pressures at different
        # foci are only comparable relative to their requests.
        best = int(np.argmax(_counted(self, "equal peak").min(axis=1)))
        return float(self.weakest("equal peak")[best]), self.names[best]

    @cached_property
    def report(self) -> SolveReport:
        """Report of the solver, with the error estimated at the foci."""
        return self.field.report_at(self.target.points)

    def steepening(self, name: str) -> Steepening:
        """Nonlinear steepening at the foci for a drive whose strongest element is at full scale."""
        column = self.column(name)
        return steepening(
            self.field.scene,
            self.field.sources,
            self.target.points,
            self.at_foci[:, column],
            column,
        )

    def column(self, name: str, phase_only: bool = False) -> int:
        """Return the index in ``field`` of a drive's excitation or of its phase-only version.

        The method raises ``InvalidInput`` if no drive has that name.
        """
        if name not in self.names:
            raise InvalidInput(
                f"there is no drive {name!r}. Use one of {', '.join(self.names)}.",
                code="unknown_name",
            )
        index = self.names.index(name)
        return self.phase_columns[index] if phase_only else index

    def at(
        self, points: Real[np.ndarray, "points 3"]
    ) -> dict[str, Complex128[np.ndarray, "points"]]:
        """Return each drive's pressure at points (P, 3), with its strongest element at full scale.

        Returns
        -------
        A dict from the name of each drive to its complex total pressure (P,) [Pa], which is NaN
        inside bodies.
        """
        pressures = self.field.at(points)
        return {name: pressures[:, self.column(name)] for name in self.names}

    def under(self, held_equal: str) -> Float64[np.ndarray, "drives foci"]:
        """Return the pressure (D, F) [Pa] of each drive at each focus for one normalisation.

        ``held_equal`` is the normalisation: "equal peak", "equal energy" or "phase only".

        Raises
        ------
        InvalidInput
            If the normalisation is unknown.
        """
        if held_equal not in self.pressures:
            raise InvalidInput(
                f"the normalisation {held_equal!r} is not one of {', '.join(self.pressures)}.",
                code="unknown_name",
            )
        return self.pressures[held_equal]

    def ratios(self, held_equal: str) -> Float64[np.ndarray, "drives foci"]:
        """Return the ratio (D, F) of each drive's pressure to that of the first drive.

        Parameters
        ----------
        held_equal : normalisation: "equal peak", "equal energy" or "phase only".

        Raises
        ------
        InvalidInput
            If the normalisation is unknown, or the first drive produces no pressure at a focus.
        """
        pressures = self.under(held_equal)
        if not pressures[0].all():
            raise InvalidInput(
                f"the reference {self.names[0]!r} produces 0 Pa at focus "
                f"{int(np.argmin(pressures[0]))}. List another drive first.",
                code="all_zero",
            )
        return pressures / pressures[0]

    def weakest(self, held_equal: str) -> Float64[np.ndarray, "drives"]:
        """Return the pressure (D,) [Pa] of each drive at its weakest focus for one normalisation.

        The weakest focus has the lowest pressure relative to its request or share; see
        ``Target.weakest``. ``held_equal`` is the normalisation: "equal peak", "equal energy" or
        "phase only".

        Raises
        ------
        InvalidInput
            If the normalisation is unknown.
        """
        return np.array([row[self.target.weakest(row)] for row in self.under(held_equal)])

    def table(self) -> list[dict[str, str | int | float]]:
        """Return one row for each normalisation, drive and focus, ready for ``pandas.DataFrame``.

        Returns
        -------
        Rows with ``held_equal``, ``drive``, ``focus``, its position ``x``, ``y``, ``z`` [m],
        ``pressure`` [Pa] and ``ratio``, the ratio to the first drive's pressure at this
        focus (NaN if the first drive's pressure is 0 Pa).
        """
        # NaN where ``ratios`` would raise, so that the other rows remain usable.
        return [
            {
                "held_equal": held_equal,
                "drive": name,
                "focus": focus,
                "x": x,
                "y": y,
                "z": z,
                "pressure": float(pressures[drive, focus]),
                "ratio": float(pressures[drive, focus] / pressures[0, focus])
                if pressures[0, focus] > 0.0
                else np.nan,
            }
            for held_equal, pressures in self.pressures.items()
            for drive, name in enumerate(self.names)
            for focus, (x, y, z) in enumerate(self.target.points.tolist())
        ]

    def __str__(self) -> str:
        rows = [
            [
                f"weakest of {counted(len(self.target.points), 'focus', 'foci')} [Pa]",
                *self.pressures,
            ],
            *([name] for name in self.names),
        ]
        for held_equal in self.pressures:
            weakest = self.weakest(held_equal)
            reference = weakest[0] if weakest[0] > 0.0 else np.nan
            for row, pressure in zip(rows[1:], weakest, strict=True):
                row.append(f"{pressure:.0f} ({pressure / reference:.2f})")
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = [
            "  ".join([name.ljust(widths[0]), *map(str.rjust, texts, widths[1:])])
            for name, *texts in rows
        ]
        pressure, name = self._strongest()
        report = self.report
        lines += [
            f"At equal peak (the limit of the hardware), {name!r} is the strongest drive, with "
            f"{pressure:.0f} Pa at the weakest focus.",
            "Numbers in brackets are ratios to the first drive. table() lists every focus.",
            *(f"{held_equal}: {meaning}" for held_equal, meaning in HELD_EQUAL.items()),
            f"peak pressures by {report.solver}, estimated error {report.estimated_error:.2g}. "
            f"{not_modelled(report)}",
            *in_real_air(
                self.pressures["equal peak"][self.names.index(name)],
                self.target,
                self.steepening(name),
            ),
            *map(as_sentence, report.warnings),
        ]
        return "\n".join(lines)


def compare(
    scene: Scene,
    array: PhasedArray,
    drives: Mapping[str, Drive],
    target: Target,
    *,
    solver: Solver,
    progress: Progress | None = None,
) -> Comparison:
    """Compare the pressures that several drives produce at the foci, with a single solve.

    The drives are compared with three normalisations. With "equal peak", the strongest element of
    each drive is at full scale. With "equal energy", all drives have the same sum of squared
    amplitudes, as large as full scale allows for all of them. With "phase only", every active
    element is at full scale, with the phase of the drive.

    Parameters
    ----------
    scene : the air and the bodies in it. Its frame is called the obstacles' frame.
    array : the E transducers in the obstacles' frame; see ``PhasedArray.seen_from``.
    drives : dict from names to drives of E amplitudes each; the first is the reference for the
        ratios that the result prints. The results do not depend on the scale of a drive.
    target : the F foci in the obstacles' frame. Their requests only determine which focus is the
        weakest.
    solver : solver for the field. Use a more accurate solver than the one used for the
        drives' transfer matrix, or a solver based on another method.
    progress : function, such as ``print``, that is called with a description of each step as it
        begins.

    Returns
    -------
    A ``Comparison`` with the pressure of each drive at each focus for each normalisation. The
    choice of normalisation can reverse a conclusion: a drive that leaves most elements nearly
    silent is strong at equal energy but weak at equal peak.

    Raises
    ------
    InvalidInput
        If there is no drive, if a drive is silent or does not have as many elements as the array,
        if elements overlap, if an element or a focus is inside a body or behind a plane, if a focus
        or a body is behind the face of a directional element, if a focus is on an element, or if an
        argument has the wrong type.
    NotConverged
        If the solver stops before it converges.
    """
    of_kind(drives, Mapping, "the drives", 'a dict of drives by name, {"hand considered": drive}')
    of_kind(target, Target, "the target", "Target(points, pressures)")
    for name, drive in drives.items():
        check_drive(drive, f"drive {name!r}")
        if drive.peak == 0.0:
            raise InvalidInput(
                f"drive {name!r} is silent: all amplitudes are 0. Omit it.", code="all_zero"
            )
    strongest = [drive.at_full_scale() for drive in drives.values()]
    excitations = list(strongest)
    phase_columns = []
    for index, drive in enumerate(strongest):
        phases = drive.phase_only()
        # A drive whose elements all emit at full scale is solved only once.
        if np.allclose(drive.amplitudes, phases.amplitudes, rtol=0.0, atol=1e-9):
            phase_columns.append(index)
        else:
            phase_columns.append(len(excitations))
            excitations.append(phases)
    field = radiate_drives(scene, array, excitations, solver, foci=target.points, progress=progress)
    # Drives on the first axis, so that each drive's pressures are contiguous.
    at_foci = field.at(target.points)
    magnitudes = np.abs(np.ascontiguousarray(at_foci.T))
    equal_peak = magnitudes[: len(drives)]
    # The drive of lowest energy sets the energy that all drives can reach without exceeding full
    # scale. The field is linear in the drive, so equal energy needs no further solve.
    least_energetic = min(strongest, key=lambda drive: drive.energy)
    factors = np.array([drive.factor_to_match(least_energetic) for drive in strongest])
    return Comparison(
        tuple(drives),
        target,
        {
            "equal peak": equal_peak,
            "equal energy": equal_peak * factors[:, None],
            "phase only": magnitudes[phase_columns],
        },
        field,
        tuple(phase_columns),
        at_foci,
    )


@dataclass(frozen=True, eq=False)
class HeldOut:
    """The pressure at the weakest focus for several drives, under random deviations.

    The deviations of the hand, the air and the transducers are samples of an ``Uncertainty`` that
    were not used to compute the drives. ``Rendering.robustness`` contains such a result.

    Attributes
    ----------
    names : names of the D drives. The others are scaled to the energy Σ|d|² of the first, where
        d are its amplitudes.
    pressures : (D, S) peak pressure at the weakest focus in each of S samples [Pa]. If the target
        requests different pressures or shares at its foci, the weakest focus is the one with the
        smallest ratio of pressure to request (or share). This ratio is then multiplied by the
        request (or share) of the focus that is weakest for the first drive without deviations.
    expected : (D,) the same pressure without deviations [Pa].
    left_out : number of further samples skipped because they are impossible, such as a hand that
        overlaps a transducer.
    """

    names: tuple[str, ...]
    pressures: Float64[np.ndarray, "drives samples"]
    expected: Float64[np.ndarray, "drives"]
    left_out: int

    __repr__ = in_short

    @property
    def lowest_tenth(self) -> Float64[np.ndarray, "drives"]:
        """(D,) pressure [Pa] that the weakest focus exceeds in 9 of 10 samples."""
        return np.quantile(self.pressures, 0.1, axis=1)

    def sentence(self) -> str:
        """State, in a sentence, the pressure that the weakest focus exceeds in 9 of 10 samples."""
        first, *rest = self.lowest_tenth
        words = [f"{name}: {pascals(low)}" for name, low in zip(self.names[1:], rest, strict=True)]
        compared = f" ({', '.join(words)} at equal energy)" if words else ""
        skipped = counted(self.left_out, "impossible sample was", "impossible samples were")
        left_out = f"; {skipped} skipped" if self.left_out else ""
        return (
            "With the given uncertainty, the pressure at the weakest focus is at least "
            f"{pascals(first)} in 9 of 10 cases{compared}, and {pascals(self.expected[0])} without "
            f"deviations{left_out}."
        )


def held_out(
    samples: "at.drives.TransferEnsemble", target: Target, drives: Mapping[str, Drive]
) -> HeldOut:
    """Compute the pressure at the weakest focus in each sample, for drives of equal energy.

    Every drive is scaled to the energy of the first drive.

    Parameters
    ----------
    samples : samples of the transfer matrix, drawn with a different seed than the samples from
        which the drives were computed.
    target : the foci; those whose requested pressure or share is 0 are ignored.
    drives : drives to compare, by name.

    Raises
    ------
    InvalidInput
        If a drive does not have as many elements as the samples.
    """
    # The rows of the foci come first; suppression points follow and are ignored.
    weights = target.weights
    asked = np.flatnonzero(weights > 0.0)
    first = next(iter(drives.values()))
    factors = np.array([drive.factor_to_match(first) for drive in drives.values()])
    # Pressures at foci of different requests are converted to those at the weakest focus.
    weakest = target.weakest(np.abs(samples.pressure(first)[: len(weights)]))
    ratios = weights[asked] / weights[weakest]
    sampled = [
        (np.abs(samples.pressures(drive)[:, asked]) / ratios).min(axis=1)
        for drive in drives.values()
    ]
    nominal = [(np.abs(samples.pressure(drive)[asked]) / ratios).min() for drive in drives.values()]
    return HeldOut(
        names=tuple(drives),
        pressures=factors[:, None] * np.stack(sampled),
        expected=factors * np.array(nominal),
        left_out=samples.left_out,
    )


def body_word(bodies: Sequence[str]) -> str:
    """Return the word "hand" or "object", depending on the names of the bodies."""
    parts = ("hand", "finger", "thumb", "palm")
    return "hand" if any(part in name.lower() for name in bodies for part in parts) else "object"


def headline(
    comparison: Comparison, drive: Drive, word: str = "hand", foci: Sequence[str] = ()
) -> str:
    """State the pressure at the weakest focus, and the gain from modelling the bodies.

    Parameters
    ----------
    comparison : comparison whose first drive was computed with the bodies. It may contain a second
        drive, computed by the same method without the bodies.
    drive : the emitted drive, which was computed with the bodies. If it is at full scale, the
        drives of the comparison are compared at equal peak, and otherwise at equal energy.
    word : word that the sentence uses for the bodies, such as "hand".
    foci : a name for each focus. The sentence names the focus whose pressure decreases most and, if
        the requests differ, the weakest focus.
    """
    # Below full scale the hardware does not limit the peak, so compare the drives by energy.
    held_equal = "equal peak" if drive.is_full_scale else "equal energy"
    values = _counted(comparison, held_equal)
    # The comparison holds every drive at full scale, but the drive is emitted at its own peak.
    emitted = drive.peak * comparison.pressures["equal peak"][0]
    sentence = f"{_capital(comparison.names[0])}: {at_weakest(emitted, comparison.target, foci)}."
    if len(values) == 1:
        return sentence
    gain = values[0].min() / values[1].min() - 1.0
    reference, control = comparison.pressures[held_equal]
    control = control * (emitted.max() / reference.max())
    amount, name = weakest_focus(control, comparison.target, foci)
    where = f" at {name}, then the weakest" if name else ""
    sentence += f" {_capital(comparison.names[1])}: {amount}{where}."
    error = comparison.report.estimated_error
    # Never claim a difference below 1 %, even if the estimated error is smaller.
    if abs(gain) <= max(error, 0.01):
        if error > 0.03:
            return (
                f"{sentence} The effect of the {word} is unknown, because the estimated error of "
                f"the pressures is {_per_cent(error)}. Set a smaller value of accuracy."
            )
        same = _per_cent(max(error, 0.01))
        return (
            f"{sentence} Whether or not the drive considers the {word}, the result is the same to "
            f"within {same}."
        )
    same = "hardware" if drive.is_full_scale else "energy"
    sentence += f" Same {same}: {_signed(gain)}"
    if values.shape[1] == 1:
        return f"{sentence}."
    mean = values[0].mean() / values[1].mean() - 1.0
    # Pressures at two different foci are only comparable relative to their requests.
    relative = " relative to its request" if name else ""
    sentence += f" at the weakest focus{relative}, {_signed(mean)} on average"
    losses = 1.0 - values[0] / values[1]
    worst = int(losses.argmax())
    if foci and losses[worst] > max(error, 0.02):
        asked = np.flatnonzero(comparison.target.weights > 0.0)
        sentence += f"; {foci[asked[worst]]} loses {_per_cent(losses[worst])}"
    return f"{sentence}."


def shortfalls(
    target: Target, foci: Sequence[str], reached: Float64[np.ndarray, "foci"], drive: Drive
) -> tuple[str, ...]:
    """Return a sentence that names the foci below 98 % of their requested pressure, if any.

    Parameters
    ----------
    target : the requested pressures.
    foci : a name for each focus.
    reached : (F,) peak pressure at the foci [Pa].
    drive : the emitted drive.
    """
    if target.pressures is None:
        return ()
    # The default accuracy is 1 %, so a deficit below 2 % is not worth a sentence.
    short = [
        f"{name} {pascals(got)} of {pascals(asked)}"
        for name, got, asked in zip(foci, reached, target.pressures, strict=True)
        if got < 0.98 * asked
    ]
    if not short:
        return ()
    full = ": the transducers are at full scale" if drive.is_full_scale else ""
    return (f"Requested but not reached: {', '.join(short)}{full}.",)


def _counted(comparison: Comparison, held_equal: str) -> Float64[np.ndarray, "drives counted"]:
    weights = comparison.target.weights
    asked = weights > 0.0
    return comparison.pressures[held_equal][:, asked] / weights[asked]


def _per_cent(share: float) -> str:
    # Write a share in per cent, with a space before the sign (ISO 80000-1).
    return f"{100 * share:.2g} %" if share < 0.1 else f"{100 * share:.0f} %"


def _signed(share: float) -> str:
    return f"{100 * share:+z.0f} %".replace("-", "\u2212")


def _capital(words: str) -> str:
    return words[:1].upper() + words[1:]
