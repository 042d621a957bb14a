"""Comparison of drives at equal peak, at equal energy and with their phases alone."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Complex128, Float64, Real

from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.problem import RadiatedField, Solver, SolveReport
from airtact.acoustics.target import Target
from airtact.drives.drive import Drive, check_drive
from airtact.errors import InvalidInput, as_sentence, counted, of_kind, one_line
from airtact.evaluation.field import radiate_drives
from airtact.evaluation.metrics import in_real_air, not_modelled
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
    """The pressure at each focus for several drives, relative to the first drive.

    Attributes
    ----------
    names : names of the D drives; the first is the reference.
    target : the foci.
    pressures : for each normalisation of ``HELD_EQUAL``, (D, F) peak pressure of each drive at each
        focus [Pa].
    field : field with one excitation per drive, scaled so that its strongest element is at full
        scale. For each drive with unequal amplitudes, a further excitation has the same phases and
        every element at full scale.
    phase_columns : for each drive, the index of its phase-only version among the excitations of
        ``field``.
    at_foci : (F, S) complex pressure of each excitation of ``field`` at the foci [Pa].
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
        # Full scale is the limit of the hardware, so equal peak decides.
        weakest = self.weakest("equal peak")
        best = int(np.argmax(weakest))
        return float(weakest[best]), self.names[best]

    @cached_property
    def report(self) -> SolveReport:
        """Report of the solver, with the error estimated at the foci."""
        return self.field.report_at(self.target.points)

    def steepening(self, name: str) -> Steepening:
        """Effect of real air at the foci for a drive with its strongest element at full scale."""
        column = self.column(name)
        field = self.field
        pressures = self.at_foci[:, column]
        return steepening(field.scene, field.sources, self.target.points, pressures, column)

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
        """Evaluate each drive at points (P, 3), with its strongest element at full scale.

        Returns
        -------
        A dict from the name of each drive to its complex total pressure (P,) [Pa]; NaN inside
        bodies.
        """
        pressures = self.field.at(points)
        return {name: pressures[:, self.column(name)] for name in self.names}

    def under(self, held_equal: str) -> Float64[np.ndarray, "drives foci"]:
        """Return the pressure (D, F) of each drive at each focus for one normalisation [Pa].

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
            focus = int(np.argmin(pressures[0]))
            raise InvalidInput(
                f"{self.names[0]!r} produces 0 Pa at focus {focus}. List another drive first.",
                code="all_zero",
            )
        return pressures / pressures[0]

    def weakest(self, held_equal: str) -> Float64[np.ndarray, "drives"]:
        """Return the pressure (D,) of each drive at its weakest focus for one normalisation [Pa].

        Foci without a request are ignored.

        Raises
        ------
        InvalidInput
            If the normalisation is unknown.
        """
        return self.under(held_equal)[:, self.target.weights > 0.0].min(axis=1)

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
        foci = counted(len(self.target.points), "focus", "foci")
        rows = [[f"weakest of {foci} [Pa]", *self.pressures], *([name] for name in self.names)]
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
                self.pressures["equal peak"][self.names.index(name)], self.steepening(name)
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
    """Compare the pressures of several drives at the foci by one solve.

    The pressures are stated at equal peak, at equal energy, and for the phase-only version of each
    drive.

    Parameters
    ----------
    scene : the air and the bodies in it.
    array : the transducers in the obstacles' frame; see ``PhasedArray.seen_from``.
    drives : drives by name; the first is the reference for the ratios. The results do not
        depend on the scale of a drive.
    target : the F foci; their requested pressures are ignored.
    solver : solver for the field. Use a more accurate solver than the one for the drives'
        transfer matrix, or another method.
    progress : function, such as ``print``, that is called with a description of each step as it
        begins.

    Returns
    -------
    The pressure of each drive at each focus for each normalisation of ``HELD_EQUAL``. The
    choice of normalisation can reverse a conclusion: a drive that leaves most elements nearly
    silent is strong at equal energy but weak at equal peak.

    Raises
    ------
    InvalidInput
        If there is no drive, if a drive is silent or does not have as many elements as the array,
        or if the array, the scene and the foci do not fit together (see ``evaluate``).
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
    pressures = {
        "equal peak": equal_peak,
        "equal energy": equal_peak * factors[:, None],
        "phase only": magnitudes[phase_columns],
    }
    return Comparison(tuple(drives), target, pressures, field, tuple(phase_columns), at_foci)
