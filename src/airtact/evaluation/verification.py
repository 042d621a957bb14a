"""Verification of a drive in every respect, by one solve with a solver that did not make it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Real
from scipy.spatial import KDTree

from airtact.acoustics.planes import before_planes
from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.problem import RadiatedField, Solver
from airtact.acoustics.target import Target
from airtact.drives.drive import Drive, quantise
from airtact.drives.reach import check_foci
from airtact.drives.transfer import TransferMatrix, transfer_matrix
from airtact.errors import InvalidInput, Vector, counted, in_mm, of_kind, points_of
from airtact.evaluation.field import radiate_drives
from airtact.evaluation.head_level import NO_SAFETY_ASSESSMENT, sound_pressure_level
from airtact.evaluation.metrics import Evaluation
from airtact.evaluation.radiation import PAD_RADIUS, Pad, RadiationMap, radiation_of
from airtact.evaluation.tactile_thresholds import thresholds_of
from airtact.printing import one_line, span
from airtact.timing import Progress, no_progress
from airtact.transducers.layout import PhasedArray
from airtact.transducers.levels import EIGHT_BITS, Levels


def attainable(
    transfer: TransferMatrix, energy: float | None = None
) -> Float64[np.ndarray, "foci"]:
    """Return the largest pressure of each focus if the array served it alone [Pa], peak.

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
    """All figures of a drive; ``print`` it for a summary.

    Attributes
    ----------
    evaluation : the pressure at each of the F foci.
    quantised : the same when the drive is rounded to levels.
    levels : those levels.
    attainable : (F,) pressure of each focus at full scale if the array served it alone [Pa].
    attainable_at_energy : (F,) the same at the energy of the drive [Pa].
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
        return one_line(
            self,
            f"weakest of {counted(len(self.attained), 'focus', 'foci')} "
            f"{self.evaluation.magnitudes.min():.0f} Pa",
            f"{span(100 * self.attained, '%', '.0f')} of a focus served alone",
            f"at most {self.head.max():.0f} dB SPL at the head" if len(self.head) else "",
        )

    @property
    def attained(self) -> Float64[np.ndarray, "foci"]:
        """(F,) pressure of each focus over what it could get alone at full scale."""
        return self.evaluation.magnitudes / self.attainable

    @property
    def quantisation_loss(self) -> float:
        """Largest change of a focus's pressure by rounding, over its pressure."""
        # Silent foci have no relative change.
        exact = self.evaluation.magnitudes
        change = np.abs(self.quantised.magnitudes - exact)[exact > 0.0] / exact[exact > 0.0]
        return float(change.max(initial=0.0))

    def contrast(self, lobe: SideLobe | None) -> float:
        """Level of the weakest focus above a side lobe [dB]; NaN without one."""
        weakest = float(self.evaluation.magnitudes[self.evaluation.target.weights > 0.0].min())
        if lobe is None or not (lobe.pressure > 0.0 and weakest > 0.0):
            return float("nan")
        return float(20.0 * np.log10(weakest / lobe.pressure))

    @property
    def suppression_level(self) -> float:
        """Mean p² at the suppression points over that at the foci [dB]; NaN without such points."""
        foci = float(np.mean(self.evaluation.magnitudes**2))
        if not (len(self.suppression_points) and foci > 0.0):
            return float("nan")
        return float(10.0 * np.log10(np.mean(np.abs(self.suppression_points) ** 2) / foci))

    def pads(self, radius: float = PAD_RADIUS) -> tuple[Pad | None, ...]:
        """Return the piece of skin round each focus, None where the skin is over 2 mm away.

        Parameters and errors are those of ``RadiationMap.pad``.
        """
        return tuple(
            None if self.skin is None else self.skin.pad(at, radius)
            for at in self.evaluation.target.points
        )

    def over_thresholds(self, modulation: str = "amplitude") -> str:
        """Return a line for each tactile threshold of a modulation: the level of the foci above it.

        Parameters
        ----------
        modulation : "amplitude" (at 200 Hz) or "spatiotemporal".

        Raises
        ------
        InvalidInput
            If no threshold is known for the modulation.
        """
        lines = []
        for threshold in thresholds_of(modulation):
            if threshold.quantity == "force":
                values = [pad.force for pad in self.pads() if pad is not None]
                amount = f"{1e3 * threshold.value:g} mN"
            else:
                values = self.evaluation.magnitudes.tolist()
                amount = f"{threshold.value:g} Pa"
            if not values:
                continue
            levels = [threshold.level(value) for value in values]
            above = (
                f"{span(levels, 'dB', '+.1f')} above" if np.isfinite(levels).all() else "far below"
            )
            lines.append(
                f"{above} the threshold of {threshold.quantity}, {amount}, with "
                f"{threshold.modulation} modulation ({threshold.source})"
            )
        return "\n".join(lines)

    def __str__(self) -> str:
        # A focus that no element reaches stays at 0 instead of 0 / 0.
        attainable = np.where(self.attainable_at_energy > 0, self.attainable_at_energy, 1)
        at_energy = self.evaluation.magnitudes / attainable
        lines = [
            str(self.evaluation),
            f"of a focus served alone: {span(100 * self.attained, '%', '.1f')} at full scale, "
            f"{span(100 * at_energy, '%', '.1f')} with the energy of this drive",
            f"energy Σ|d|² {self.energy:.1f}, at full scale {self.elements}; rounding to "
            f"{len(self.levels.amplitudes)} levels of amplitude and {self.levels.phases} of phase "
            f"changes a focus by {self.quantisation_loss:.2%} at most",
        ]
        for where, lobe in (
            ("on the skin", self.side_lobe_on_surface),
            ("in the box round the foci", self.side_lobe_in_box),
        ):
            if lobe is not None:
                lines.append(
                    f"strongest side lobe {where} {lobe.pressure:.1f} Pa at {in_mm(lobe.point)}: "
                    f"the weakest focus is {self.contrast(lobe):+.1f} dB above it"
                )
        if len(self.suppression_points):
            lines.append(
                f"mean p² of {len(self.suppression_points)} suppression points over that of the "
                f"foci {self.suppression_level:+.1f} dB"
            )
        pads = [pad for pad in self.pads() if pad is not None]
        if pads:
            forces = span([1e3 * pad.force for pad in pads], "mN", ".3g")
            areas = span([1e4 * pad.area for pad in pads], "cm²", ".2f")
            foci = counted(len(self.evaluation.target.points), "focus", "foci")
            lines.append(
                f"sound presses with {forces} on the {areas} of skin round {len(pads)} of {foci}"
            )
        lines.append(self.over_thresholds())
        if len(self.head):
            lines.append(
                f"at the head at most {self.head.max():.1f} dB SPL. {NO_SAFETY_ASSESSMENT}"
            )
        return "\n".join(lines)


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
    """Verify a drive: foci, attainable maximum, side lobes, skin, thresholds, rounding and head.

    Parameters
    ----------
    scene, array, drive, solver, progress : as in ``evaluate``.
    target : the foci and suppression points.
    transfer : of the foci, for the attainable maximum; None to compute it by ``solver``.
    head : (3,) or (N, 3) points of a head [m] at which the level is evaluated.
    levels : of a board; the solve is for the drive and for the drive rounded to them.

    Returns
    -------
    All figures of the drive.

    Raises
    ------
    InvalidInput
        As ``evaluate``; a suppression or head point in a body or on an element, or a body that is
        not sound-hard.
    """
    of_kind(target, Target, "the target", "Target(points, pressures)")
    head = np.empty((0, 3)) if head is None else np.atleast_2d(head)
    head = points_of(head, "points of the head", least=0)
    if transfer is not None:
        check_foci(transfer, target)
    # Both drives in one solve: rounding then costs a right-hand side, not a factorisation.
    rounded = quantise(drive, levels).drive()
    if not rounded.amplitudes.any():  # a drive too weak for the levels
        rounded = drive
    solver = solver.reporting(progress)
    suppressed = target.suppression_points
    field = radiate_drives(
        scene,
        array,
        [drive, rounded],
        solver,
        foci=target.points,
        points={"suppression point": suppressed, "point of the head": head},
    )
    if transfer is None:
        transfer = transfer_matrix(solver.radiate(scene, target.beacons()), array)
    foci = len(target.points)
    progress = progress or no_progress
    progress("evaluating the field at the foci and on the surfaces")
    points = np.concatenate([target.points, suppressed, head])
    exact, quantised = np.ascontiguousarray(field.at(points).T)
    report = field.report_at(points)
    skin = radiation_of(field, 0) if scene.obstacles else None
    progress("looking for side lobes")
    # Nearer than a wavelength a maximum is part of the focus, not a lobe.
    lobe_on_surface = None
    if skin is not None:
        off = _farther(skin.points, target.points, scene.wavelength)
        lobe_on_surface = _strongest(skin.points, np.where(off, skin.pressure, np.nan))
    return Verification(
        evaluation=Evaluation(target, exact[:foci], report),
        levels=levels,
        quantised=Evaluation(target, quantised[:foci], report),
        attainable=attainable(transfer)[:foci],
        attainable_at_energy=attainable(transfer, drive.energy)[:foci],
        energy=drive.energy,
        elements=len(array),
        skin=skin,
        side_lobe_on_surface=lobe_on_surface,
        side_lobe_in_box=_side_lobe_in_box(field, array, target),
        suppression_points=exact[foci : foci + len(suppressed)],
        head=sound_pressure_level(exact[foci + len(suppressed) :]),
    )


def _farther(
    points: Float64[np.ndarray, "points 3"],
    centres: Float64[np.ndarray, "centres 3"],
    distance: float,
) -> Bool[np.ndarray, "points"]:
    """Whether points are farther than a distance [m] from all centres."""
    return np.asarray(KDTree(centres).query(points)[0]) > distance


def _strongest(
    points: Float64[np.ndarray, "points 3"], pressure: Complex128[np.ndarray, "points"]
) -> SideLobe | None:
    """Return the strongest of the finite pressures, None if there is none."""
    if not np.isfinite(pressure).any():
        return None
    # NaN marks points that do not count; −1 is below every magnitude.
    magnitudes = np.where(np.isfinite(pressure), np.abs(pressure), -1.0)
    return SideLobe(float(magnitudes.max()), points[magnitudes.argmax()])


def _side_lobe_in_box(field: RadiatedField, array: PhasedArray, target: Target) -> SideLobe | None:
    """Return the strongest pressure in a box two wavelengths beyond the foci.

    It is off the foci by a wavelength, off the elements by half a wavelength, and off the bodies.
    """
    wavelength = field.scene.wavelength

    def pressure_at(
        points: Float64[np.ndarray, "points 3"],
    ) -> tuple[Float64[np.ndarray, "chosen 3"], Complex128[np.ndarray, "chosen"]]:
        points = points[
            _farther(points, target.points, wavelength)
            & _farther(points, array.positions, 0.5 * wavelength)
        ]
        outside = field.scene.depth(points) < 0.0
        points = points[outside & before_planes(field.scene.planes, points)]
        return points, field.at(points)[:, 0]

    low = target.points.min(axis=0) - 2.0 * wavelength
    high = target.points.max(axis=0) + 2.0 * wavelength
    # Six points per wavelength, but 20,000 points at most.
    spacing = max(wavelength / 6.0, float(np.cbrt(np.prod(high - low) / 20_000)))
    counts = ((high - low) / spacing).astype(int) + 1
    points, pressure = pressure_at(_grid(list(map(np.linspace, low, high, counts))))
    # A lobe may be between the points: look again, at a third of the spacing, round the strongest.
    strongest = points[np.argsort(-np.abs(pressure))[:40]]
    around = strongest[:, None] + _grid([np.array([-1.0, 0.0, 1.0]) * spacing / 3.0] * 3)
    return _strongest(*pressure_at(np.clip(around.reshape(-1, 3), low, high)))


def _grid(axes: list[Float64[np.ndarray, "_"]]) -> Float64[np.ndarray, "points 3"]:
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
