"""All that can be said of a drive, from one forward solution of a solver that did not make it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Real
from scipy.spatial import KDTree

from airtact.conventions import Vector
from airtact.evaluation.attainable import attainable
from airtact.evaluation.field import check_solver, drive_sources
from airtact.evaluation.metrics import Evaluation
from airtact.evaluation.radiation import PAD_RADIUS, Pad, RadiationMap, skin_of
from airtact.evaluation.thresholds import NO_SAFETY_ASSESSMENT, Threshold, sound_pressure_level, thresholds_of
from airtact.printing import in_short
from airtact.scene.scene import Scene, check_outside
from airtact.scene.sources import check_off_sources
from airtact.scene.target import Target
from airtact.solvers.problem import RadiatedField, Solver
from airtact.synthesis.quantise import quantise
from airtact.transducers.layout import PhasedArray
from airtact.transducers.placement import check_placement
from airtact.transfer import Drive, TransferMatrix, transfer_matrix
from airtact.validation import in_mm, of_kind, points_of

OWN = 1.0
"""Within this many wavelengths of a focus sound counts as the focus's own, farther away as stray."""

BOX_MARGIN = 2.0
"""The box round the foci reaches this many wavelengths beyond them."""

BOX_SPACING = 1.0 / 6.0
"""Spacing of the points in the box, in wavelengths."""

MOST_POINTS = 20_000
"""Points that the box has at most; a larger box gets them farther apart."""

CANDIDATES = 40
"""Round this many of the loudest of them it is heard again at a third of the spacing."""


@dataclass(frozen=True, eq=False)
class SideLobe:
    """The strongest sound where none was asked for.

    Attributes
    ----------
    pressure : [Pa], peak.
    point : (3,) where [m].
    """

    pressure: float
    point: Float64[np.ndarray, "3"]


@dataclass(frozen=True, eq=False)
class Verification:
    """What a drive gives and what it costs.

    Attributes
    ----------
    evaluation : the pressure at every focus.
    quantised : the same when the drive is rounded to 256 amplitudes and 256 phases.
    attainable : (F,) what each focus could get at full scale if the array served it alone [Pa].
    attainable_at_energy : (F,) the same with the energy of the drive [Pa].
    energy : Σ|d|².
    elements : how many there are.
    skin : sound on the skin, None in open air.
    pads : (F) the piece of skin round each focus, None where the skin is more than 2 mm away.
    side_lobe_on_surface : strongest sound on the skin more than a wavelength from every focus, None in open air.
    side_lobe_in_box : strongest in the air more than a wavelength from every focus, in a box two wavelengths wider
        than the foci.
    suppression_points : (Q,) pressure at the target's suppression points [Pa].
    head : (N,) level at the points of a head [dB SPL].
    modulation : how the drive is meant to be modulated, for the thresholds.
    """

    evaluation: Evaluation
    quantised: Evaluation
    attainable: Float64[np.ndarray, "foci"]
    attainable_at_energy: Float64[np.ndarray, "foci"]
    energy: float
    elements: int
    skin: RadiationMap | None
    pads: tuple[Pad | None, ...]
    side_lobe_on_surface: SideLobe | None
    side_lobe_in_box: SideLobe | None
    suppression_points: Complex128[np.ndarray, "suppressed"]
    head: Float64[np.ndarray, "head"]
    modulation: str

    __repr__ = in_short

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

    def contrast(self, stray: SideLobe | None) -> float:
        """Decibel of the weakest focus that asks for sound above a stray sound; NaN without one.

        Parameters
        ----------
        stray : ``side_lobe_on_surface`` or ``side_lobe_in_box``.
        """
        asked = self.evaluation.target.weights > 0.0
        weakest = float(self.evaluation.magnitudes[asked].min())
        if stray is None or not (stray.pressure > 0.0 and weakest > 0.0):
            return float("nan")
        return float(20.0 * np.log10(weakest / stray.pressure))

    @property
    def suppression_level(self) -> float:
        """Mean of p² in the suppression points against that in the foci [dB]; NaN without suppression points."""
        foci = float(np.mean(self.evaluation.magnitudes**2))
        if not (len(self.suppression_points) and foci > 0.0):
            return float("nan")
        return float(10.0 * np.log10(np.mean(np.abs(self.suppression_points) ** 2) / foci))

    def __str__(self) -> str:
        return "\n".join(
            [str(self.evaluation), *self._attained_lines(), *self._stray_lines(), *self._felt_lines(), *self._heard()]
        )

    def _attained_lines(self) -> list[str]:
        at_energy = self.evaluation.magnitudes / np.where(self.attainable_at_energy > 0, self.attainable_at_energy, 1)
        return [
            f"of what a focus could get alone: {_range(self.attained, '.1%')} at full scale, "
            f"{_range(at_energy, '.1%')} with the energy of this drive",
            f"energy Σ|d|² {self.energy:.1f}, at full scale {self.elements}; rounding to 256 levels changes a focus by "
            f"{self.quantisation_loss:.2%} at most",
        ]

    def _stray_lines(self) -> list[str]:
        lines = []
        for where, stray in (
            ("on the skin", self.side_lobe_on_surface),
            ("in the box round the foci", self.side_lobe_in_box),
        ):
            if stray is not None:
                lines.append(
                    f"strongest stray {where} {stray.pressure:.1f} Pa at {in_mm(stray.point)}: the weakest focus is "
                    f"{self.contrast(stray):+.1f} dB above it"
                )
        if len(self.suppression_points):
            lines.append(
                f"mean p² of {len(self.suppression_points)} suppression points {self.suppression_level:+.1f} dB on foci"
            )
        return lines

    def _felt_lines(self) -> list[str]:
        pads = [pad for pad in self.pads if pad is not None]
        forces = np.array([pad.force for pad in pads])
        lines = []
        if pads:
            areas = np.array([pad.area for pad in pads])
            lines.append(
                f"sound presses with {_range(1e3 * forces, '.3g')} mN on the {_range(1e4 * areas, '.2f')} cm² of skin "
                f"round {len(pads)} of {len(self.pads)} foci"
            )
        for threshold in thresholds_of(self.modulation):
            values = forces if threshold.quantity == "force" else self.evaluation.magnitudes
            if len(values):
                levels = np.array([threshold.level(float(value)) for value in values])
                lines.append(
                    f"{_range(levels, '+.1f')} dB above the threshold of {threshold.quantity}, "
                    f"{_amount(threshold)}, with "
                    f"{threshold.modulation} modulation ({threshold.source})"
                )
        return lines

    def _heard(self) -> list[str]:
        if not len(self.head):
            return []
        return [f"at the head at most {self.head.max():.1f} dB SPL. {NO_SAFETY_ASSESSMENT}"]


def _range(values: Float64[np.ndarray, "values"], form: str) -> str:
    """Say the smallest and the largest of some values."""
    low, high = format(float(values.min()), form), format(float(values.max()), form)
    return low if low == high else f"{low} to {high}"


def _amount(threshold: Threshold) -> str:
    return f"{1e3 * threshold.value:g} mN" if threshold.quantity == "force" else f"{threshold.value:g} Pa"


def verify(
    scene: Scene,
    array: PhasedArray,
    drive: Drive,
    target: Target,
    *,
    solver: Solver,
    transfer: TransferMatrix | None = None,
    head: Vector | Real[np.ndarray, "head 3"] | None = None,
    pad_radius: float = PAD_RADIUS,
    modulation: str = "amplitude",
) -> Verification:
    """Judge a drive in every respect: foci, attainable maximum, stray sound, skin, threshold, levels, head.

    One forward solve with the drive and its rounded twin, and one with beacons in the foci where no transfer matrix is
    given.

    Parameters
    ----------
    scene, array, drive, solver : as in ``evaluate``.
    target : the foci and suppression points.
    transfer : of the foci, for what is attainable; None to have it solved by ``solver``.
    head : (3,) or (N, 3) points of a head [m], to tell the level there.
    pad_radius : of the skin round a focus whose force is told [m].
    modulation : "amplitude" (at 200 Hz) or "spatiotemporal", which threshold is held against it.

    Raises
    ------
    InvalidInput
        As ``evaluate``; a modulation without a threshold, a suppression or head point inside a body or on an
        element, or a skin that is not sound-hard.
    """
    thresholds_of(modulation)
    ears = points_of(np.empty((0, 3)) if head is None else np.atleast_2d(head), "points of the head", least=0)
    field = _spoken(scene, array, drive, target, ears, solver)
    if transfer is None:
        transfer = transfer_matrix(solver.radiate(scene, target.beacons()), array)
    return _judged(field, array, drive, target, ears, transfer, pad_radius, modulation)


def _judged(
    field: RadiatedField,
    array: PhasedArray,
    drive: Drive,
    target: Target,
    ears: Float64[np.ndarray, "head 3"],
    transfer: TransferMatrix,
    pad_radius: float,
    modulation: str,
) -> Verification:
    """Hear everything in the field of a drive and its rounded twin."""
    count, energy = len(target.points), float(np.sum(np.abs(drive.amplitudes) ** 2))
    heard = field.at(np.concatenate([target.points, target.suppression_points, ears]))
    exact, rounded = np.ascontiguousarray(heard.T)
    skin = skin_of(field, 0) if field.scene.obstacles else None
    stray = None if skin is None else _strongest(skin.points, skin.pressure, _away(field.scene, target, skin.points))
    return Verification(
        evaluation=Evaluation(target, exact[:count], field.report),
        quantised=Evaluation(target, rounded[:count], field.report),
        attainable=attainable(transfer)[:count],
        attainable_at_energy=attainable(transfer, energy)[:count],
        energy=energy,
        elements=len(array),
        skin=skin,
        pads=tuple(None if skin is None else skin.pad(focus, pad_radius) for focus in target.points),
        side_lobe_on_surface=stray,
        side_lobe_in_box=_stray_in_box(field, array, target),
        suppression_points=exact[count : count + len(target.suppression_points)],
        head=sound_pressure_level(exact[count + len(target.suppression_points) :]),
        modulation=modulation,
    )


def _spoken(
    scene: Scene,
    array: PhasedArray,
    drive: Drive,
    target: Target,
    ears: Float64[np.ndarray, "head 3"],
    solver: Solver,
) -> RadiatedField:
    """Solve for the drive and its rounded twin, after refusing what cannot be heard."""
    check_solver(solver)
    of_kind(target, Target, "the target", "Target(points, pressures)")
    rounded = quantise(drive).drive()
    sources = drive_sources(array, [drive, rounded if rounded.amplitudes.any() else drive])
    check_placement(scene, array, target.points)
    for points, what in (
        (target.points, "focus"),
        (target.suppression_points, "suppression point"),
        (ears, "point of the head"),
    ):
        if len(points):
            check_outside(scene, points, what)
            check_off_sources(points, sources)
    return solver.radiate(scene, sources)


def _away(scene: Scene, target: Target, points: Float64[np.ndarray, "points 3"]) -> Bool[np.ndarray, "points"]:
    """Whether points are more than a wavelength from every focus."""
    return _farther(points, target.points, OWN * scene.wavelength)


def _farther(
    points: Float64[np.ndarray, "points 3"], others: Float64[np.ndarray, "others 3"], distance: float
) -> Bool[np.ndarray, "points"]:
    """Whether points are farther than a distance [m] from all others."""
    return np.asarray(KDTree(others).query(points)[0]) > distance


def _strongest(
    points: Float64[np.ndarray, "points 3"],
    pressure: Complex128[np.ndarray, "points"],
    chosen: Bool[np.ndarray, "points"],
) -> SideLobe | None:
    """Return the strongest sound at some of the points, None where there are none."""
    if not chosen.any():
        return None
    loudness = np.where(chosen & np.isfinite(pressure), np.abs(pressure), -1.0)
    strongest = int(loudness.argmax())
    return SideLobe(float(loudness[strongest]), points[strongest])


def _stray_in_box(field: RadiatedField, array: PhasedArray, target: Target) -> SideLobe | None:
    """Return the strongest sound in the box round the foci, off them, off the bodies and off the elements."""
    margin = BOX_MARGIN * field.scene.wavelength
    lowest, highest = target.points.min(axis=0) - margin, target.points.max(axis=0) + margin
    spacing = max(BOX_SPACING * field.scene.wavelength, float(np.cbrt(np.prod(highest - lowest) / MOST_POINTS)))
    axes = [np.linspace(low, high, int((high - low) / spacing) + 1) for low, high in zip(lowest, highest, strict=True)]
    points, pressure = _heard_off(field, array, target, _grid(axes))
    loudest = points[np.argsort(-np.abs(pressure))[:CANDIDATES]]
    around = loudest[:, None] + _grid([np.array([-1.0, 0.0, 1.0]) * spacing / 3.0] * 3)
    points, pressure = _heard_off(field, array, target, np.clip(around.reshape(-1, 3), lowest, highest))
    return _strongest(points, pressure, np.isfinite(pressure))


def _grid(axes: list[Float64[np.ndarray, "_"]]) -> Float64[np.ndarray, "points 3"]:
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def _heard_off(
    field: RadiatedField, array: PhasedArray, target: Target, points: Float64[np.ndarray, "points 3"]
) -> tuple[Float64[np.ndarray, "kept 3"], Complex128[np.ndarray, "kept"]]:
    """Hear those of some points that are off the foci, the elements and the bodies."""
    away = _away(field.scene, target, points) & _farther(points, array.positions, 0.5 * field.scene.wavelength)
    points = points[away]
    points = points[field.scene.depth(points) < 0.0]
    return points, field.at(points)[:, 0]
