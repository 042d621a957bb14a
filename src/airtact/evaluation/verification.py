"""Verification of a drive in every respect, from one forward solution by a solver that did not make it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Real
from scipy.spatial import KDTree

from airtact.acoustics.planes import before_planes
from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.problem import RadiatedField, Solver
from airtact.acoustics.target import Target
from airtact.checks import counted, in_mm, of_kind, points_of
from airtact.drives.drive import Drive, quantise
from airtact.drives.reach import check_foci
from airtact.drives.transfer import TransferMatrix, transfer_matrix
from airtact.errors import InvalidInput, Vector
from airtact.evaluation.head_level import NO_SAFETY_ASSESSMENT, sound_pressure_level
from airtact.evaluation.metrics import Evaluation, radiate_drives
from airtact.evaluation.radiation import PAD_RADIUS, Pad, RadiationMap, radiation_of
from airtact.evaluation.tactile_thresholds import thresholds_of
from airtact.printing import one_line
from airtact.timing import Progress, no_progress
from airtact.transducers.layout import PhasedArray
from airtact.transducers.levels import EIGHT_BITS, Levels

FOCUS_RADIUS = 1.0
"""Sound within this many wavelengths of a focus belongs to the focus, farther away to side lobes."""

BOX_MARGIN = 2.0
"""The box round the foci reaches this many wavelengths beyond them."""

BOX_SPACING = 1.0 / 6.0
"""Spacing of the points in the box, in wavelengths."""

MOST_POINTS = 20_000
"""Points that the box has at most; a larger box gets them farther apart."""

CANDIDATES = 40
"""Round this many of the strongest points the field is evaluated again at a third of the spacing."""


def attainable(
    transfer: TransferMatrix, energy: float | None = None
) -> Float64[np.ndarray, "foci"]:
    """Return the largest pressure that each focus could get if the array served it alone [Pa], peak.

    With every element at most at full scale that is Σ_e |H_fe|: all arrive in phase. With a given
    energy Σ|d|² it is √energy · (Σ_e |H_fe|²)^½, by Cauchy-Schwarz, and never more than the first.

    Parameters
    ----------
    transfer : the (F, E) transfer matrix.
    energy : Σ|d|² allowed, or None for full scale.

    Returns
    -------
    (F,) pressures [Pa], one for every row of the matrix.

    Raises
    ------
    InvalidInput
        If the energy is negative or not finite.

    Examples
    --------
    >>> transfer = TransferMatrix(np.array([[3.0 + 0j, 4j]]), 0.0)
    >>> attainable(transfer).tolist(), attainable(transfer, energy=1.0).tolist()
    ([7.0], [5.0])
    """
    of_kind(transfer, TransferMatrix, "the transfer matrix", "transfer_matrix(beacons, array)")
    magnitudes = np.abs(transfer.matrix)
    full = magnitudes.sum(axis=1)
    if energy is None:
        return full
    if not (np.isfinite(energy) and energy >= 0.0):
        raise InvalidInput(
            f"the energy is {energy:g}, but Σ|d|² is finite and not negative.", code="out_of_range"
        )
    return np.minimum(full, np.sqrt(energy) * np.linalg.norm(magnitudes, axis=1))


@dataclass(frozen=True, eq=False)
class SideLobe:
    """The strongest sound away from the foci.

    Attributes
    ----------
    pressure : [Pa], peak.
    point : (3,) its position [m].
    """

    pressure: float
    point: Float64[np.ndarray, "3"]


@dataclass(frozen=True, eq=False)
class Verification:
    """What a drive gives and what it costs; ``print`` it for all figures in sentences.

    Attributes
    ----------
    evaluation : the pressure at each of the F foci.
    quantised : the same when the drive is rounded to levels.
    levels : those levels.
    attainable : (F,) what each focus could get at full scale if the array served it alone [Pa].
    attainable_at_energy : (F,) the same with the energy of the drive [Pa].
    energy : Σ|d|².
    elements : number of elements.
    skin : sound on the surfaces of the bodies, None in open air.
    side_lobe_on_surface : strongest sound on a surface more than a wavelength from every focus,
        None in open air.
    side_lobe_in_box : strongest sound in the air more than a wavelength from every focus, in a box
        two wavelengths wider than the foci.
    suppression_points : (Q,) complex pressure at the target's suppression points [Pa].
    head : (N,) level at the points of a head [dB SPL].
    """

    evaluation: Evaluation
    quantised: Evaluation
    levels: Levels
    attainable: Float64[np.ndarray, "foci"]
    attainable_at_energy: Float64[np.ndarray, "foci"]
    energy: float
    elements: int
    skin: RadiationMap | None
    side_lobe_on_surface: SideLobe | None
    side_lobe_in_box: SideLobe | None
    suppression_points: Complex128[np.ndarray, "suppressed"]
    head: Float64[np.ndarray, "head"]

    def __repr__(self) -> str:
        alone = f"{_range(100 * self.attained, '.0f')} % of what a focus gets alone"
        head = f"at most {self.head.max():.0f} dB SPL at the head" if len(self.head) else ""
        foci = counted(len(self.attained), "focus", "foci")
        return one_line(
            self, f"weakest of {foci} {self.evaluation.magnitudes.min():.0f} Pa", alone, head
        )

    @property
    def attained(self) -> Float64[np.ndarray, "foci"]:
        """(F,) pressure of each focus over what it could get alone at full scale."""
        return self.evaluation.magnitudes / self.attainable

    @property
    def quantisation_loss(self) -> float:
        """Largest change of a focus's pressure by rounding, over its pressure."""
        exact = self.evaluation.magnitudes
        change = np.abs(self.quantised.magnitudes - exact)[exact > 0.0] / exact[exact > 0.0]
        return float(change.max(initial=0.0))

    def contrast(self, lobe: SideLobe | None) -> float:
        """Level of the weakest focus that asks for sound above one of the side lobes [dB]; NaN without one."""
        asked = self.evaluation.target.weights > 0.0
        weakest = float(self.evaluation.magnitudes[asked].min())
        if lobe is None or not (lobe.pressure > 0.0 and weakest > 0.0):
            return float("nan")
        return float(20.0 * np.log10(weakest / lobe.pressure))

    @property
    def suppression_level(self) -> float:
        """Mean of p² at the suppression points over that at the foci [dB]; NaN without suppression points."""
        foci = float(np.mean(self.evaluation.magnitudes**2))
        if not (len(self.suppression_points) and foci > 0.0):
            return float("nan")
        return float(10.0 * np.log10(np.mean(np.abs(self.suppression_points) ** 2) / foci))

    def pads(self, radius: float = PAD_RADIUS) -> tuple[Pad | None, ...]:
        """Return the piece of skin round each focus with the force on it, None where the skin is more than 2 mm away.

        Parameters and errors are those of ``RadiationMap.pad``.
        """
        return tuple(
            None if self.skin is None else self.skin.pad(at, radius)
            for at in self.evaluation.target.points
        )

    def over_thresholds(self, modulation: str = "amplitude") -> str:
        """Return a sentence for each tactile threshold of a modulation: how far the foci are above it.

        Parameters
        ----------
        modulation : "amplitude" (at 200 Hz) or "spatiotemporal".

        Raises
        ------
        InvalidInput
            If no threshold is known for the modulation.
        """
        forces = np.array([pad.force for pad in self.pads() if pad is not None])
        lines = []
        for threshold in thresholds_of(modulation):
            by_force = threshold.quantity == "force"
            values = forces if by_force else self.evaluation.magnitudes
            if len(values):
                levels = np.array([threshold.level(float(value)) for value in values])
                amount = f"{1e3 * threshold.value:g} mN" if by_force else f"{threshold.value:g} Pa"
                above = (
                    f"{_range(levels, '+.1f')} dB above"
                    if np.isfinite(levels).all()
                    else "far below"
                )
                lines.append(
                    f"{above} the threshold of {threshold.quantity}, {amount}, with "
                    f"{threshold.modulation} modulation ({threshold.source})"
                )
        return "\n".join(lines)

    def __str__(self) -> str:
        at_energy = self.evaluation.magnitudes / np.where(
            self.attainable_at_energy > 0, self.attainable_at_energy, 1
        )
        lines = [
            str(self.evaluation),
            f"of what a focus could get alone: {_range(self.attained, '.1%')} at full scale, "
            f"{_range(at_energy, '.1%')} with the energy of this drive",
            f"energy Σ|d|² {self.energy:.1f}, at full scale {self.elements}; rounding to "
            f"{len(self.levels.amplitudes)} levels of amplitude and {self.levels.phases} of phase changes a focus by "
            f"{self.quantisation_loss:.2%} at most",
            *self._side_lobe_lines(),
        ]
        pads = [pad for pad in self.pads() if pad is not None]
        if pads:
            forces, areas = (
                np.array([pad.force for pad in pads]),
                np.array([pad.area for pad in pads]),
            )
            lines.append(
                f"sound presses with {_range(1e3 * forces, '.3g')} mN on the {_range(1e4 * areas, '.2f')} cm² of skin "
                f"round {len(pads)} of {counted(len(self.evaluation.target.points), 'focus', 'foci')}"
            )
        lines.append(self.over_thresholds())
        if len(self.head):
            lines.append(
                f"at the head at most {self.head.max():.1f} dB SPL. {NO_SAFETY_ASSESSMENT}"
            )
        return "\n".join(lines)

    def _side_lobe_lines(self) -> list[str]:
        lobes = {
            "on the skin": self.side_lobe_on_surface,
            "in the box round the foci": self.side_lobe_in_box,
        }
        lines = [
            f"strongest side lobe {where} {lobe.pressure:.1f} Pa at {in_mm(lobe.point)}: the weakest focus is "
            f"{self.contrast(lobe):+.1f} dB above it"
            for where, lobe in lobes.items()
            if lobe is not None
        ]
        if len(self.suppression_points):
            lines.append(
                f"mean p² of {len(self.suppression_points)} suppression points {self.suppression_level:+.1f} dB on foci"
            )
        return lines


def _range(values: Float64[np.ndarray, "values"], form: str) -> str:
    """Write the smallest and the largest of some values."""
    low, high = format(float(values.min()), form), format(float(values.max()), form)
    return low if low == high else f"{low} to {high}"


def verify(
    scene: Scene,
    array: PhasedArray,
    drive: Drive,
    target: Target,
    *,
    solver: Solver,
    transfer: TransferMatrix | None = None,
    head: Vector | Real[np.ndarray, "head 3"] | None = None,
    levels: Levels = EIGHT_BITS,
    progress: Progress | None = None,
) -> Verification:
    """Verify a drive in every respect: foci, attainable maximum, side lobes, skin, tactile thresholds, rounding, head.

    Parameters
    ----------
    scene, array, drive, solver, progress : as in ``evaluate``.
    target : the foci and suppression points.
    transfer : of the foci, for what is attainable; None to compute it by ``solver``.
    head : (3,) or (N, 3) points of a head [m] at which the level is evaluated.
    levels : what a board can emit; the solve is for the drive and for the drive rounded to them.

    Returns
    -------
    All figures of the drive.

    Raises
    ------
    InvalidInput
        As ``evaluate``; a suppression or head point in a body or on an element, or a body that is not sound-hard.
    """
    of_kind(target, Target, "the target", "Target(points, pressures)")
    ears = points_of(
        np.empty((0, 3)) if head is None else np.atleast_2d(head), "points of the head", least=0
    )
    if transfer is not None:
        check_foci(transfer, target)
    others = {"suppression point": target.suppression_points, "point of the head": ears}
    solver = solver.reporting(progress)
    field = radiate_drives(scene, array, [drive, _rounded(drive, levels)], target, solver, others)
    transfer = transfer or transfer_matrix(solver.radiate(scene, target.beacons()), array)
    energy = float(np.sum(np.abs(drive.amplitudes) ** 2))
    foci, end = len(target.points), len(target.points) + len(target.suppression_points)
    (progress or no_progress)("evaluating the field at the foci and on the surfaces")
    points = np.concatenate([target.points, target.suppression_points, ears])
    exact, quantised = np.ascontiguousarray(field.at(points).T)
    skin, report = (
        radiation_of(field, 0) if field.scene.obstacles else None,
        field.report_at(points),
    )
    (progress or no_progress)("looking for side lobes")
    return Verification(
        evaluation=Evaluation(target, exact[:foci], report),
        levels=levels,
        quantised=Evaluation(target, quantised[:foci], report),
        attainable=attainable(transfer)[:foci],
        attainable_at_energy=attainable(transfer, energy)[:foci],
        energy=energy,
        elements=len(array),
        skin=skin,
        side_lobe_on_surface=skin and _side_lobe_on_surface(skin, scene, target),
        side_lobe_in_box=_side_lobe_in_box(field, array, target),
        suppression_points=exact[foci:end],
        head=sound_pressure_level(exact[end:]),
    )


def _rounded(drive: Drive, levels: Levels) -> Drive:
    """Round a drive to levels, unless nothing would be left of it."""
    rounded = quantise(drive, levels).drive()
    return rounded if rounded.amplitudes.any() else drive


def _farther(
    points: Float64[np.ndarray, "points 3"],
    others: Float64[np.ndarray, "others 3"],
    distance: float,
) -> Bool[np.ndarray, "points"]:
    """Whether points are farther than a distance [m] from all others."""
    return np.asarray(KDTree(others).query(points)[0]) > distance


def _strongest(
    points: Float64[np.ndarray, "points 3"], pressure: Complex128[np.ndarray, "points"]
) -> SideLobe | None:
    """Return the strongest sound at some points, None where no pressure is finite."""
    if not np.isfinite(pressure).any():
        return None
    magnitudes = np.where(np.isfinite(pressure), np.abs(pressure), -1.0)
    return SideLobe(float(magnitudes.max()), points[magnitudes.argmax()])


def _side_lobe_on_surface(skin: RadiationMap, scene: Scene, target: Target) -> SideLobe | None:
    """Return the strongest sound on the surfaces, off the foci."""
    off = _farther(skin.points, target.points, FOCUS_RADIUS * scene.wavelength)
    return _strongest(skin.points, np.where(off, skin.pressure, np.nan))


def _side_lobe_in_box(field: RadiatedField, array: PhasedArray, target: Target) -> SideLobe | None:
    """Return the strongest sound in the box round the foci, off them, off the bodies and off the elements."""
    margin = BOX_MARGIN * field.scene.wavelength
    lowest, highest = target.points.min(axis=0) - margin, target.points.max(axis=0) + margin
    spacing = max(
        BOX_SPACING * field.scene.wavelength,
        float(np.cbrt(np.prod(highest - lowest) / MOST_POINTS)),
    )
    axes = [
        np.linspace(low, high, int((high - low) / spacing) + 1)
        for low, high in zip(lowest, highest, strict=True)
    ]
    points, pressure = _pressure_away(field, array, target, _grid(axes))
    strongest = points[np.argsort(-np.abs(pressure))[:CANDIDATES]]
    around = strongest[:, None] + _grid([np.array([-1.0, 0.0, 1.0]) * spacing / 3.0] * 3)
    return _strongest(
        *_pressure_away(field, array, target, np.clip(around.reshape(-1, 3), lowest, highest))
    )


def _grid(axes: list[Float64[np.ndarray, "_"]]) -> Float64[np.ndarray, "points 3"]:
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def _pressure_away(
    field: RadiatedField,
    array: PhasedArray,
    target: Target,
    points: Float64[np.ndarray, "points 3"],
) -> tuple[Float64[np.ndarray, "chosen 3"], Complex128[np.ndarray, "chosen"]]:
    """Return those of some points that are off the foci, the elements and the bodies, and the pressure there."""
    wavelength = field.scene.wavelength
    away = _farther(points, target.points, FOCUS_RADIUS * wavelength)
    points = points[away & _farther(points, array.positions, 0.5 * wavelength)]
    points = points[(field.scene.depth(points) < 0.0) & before_planes(field.scene.planes, points)]
    return points, field.at(points)[:, 0]
