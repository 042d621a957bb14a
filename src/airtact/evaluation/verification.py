"""Verification of a drive by one solve with an independent solver, and forces on bodies."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Int64, Real
from scipy.spatial import KDTree

from airtact.acoustics.medium import Medium
from airtact.acoustics.scene import Scene, before_planes
from airtact.acoustics.solvers.bem.quadrature import place_nodes
from airtact.acoustics.solvers.problem import RadiatedField, Solver
from airtact.acoustics.target import Target
from airtact.drives.drive import Drive, quantise
from airtact.drives.head_level import NO_SAFETY_ASSESSMENT, sound_pressure_level
from airtact.drives.transfer import TransferMatrix, check_foci, transfer_matrix
from airtact.errors import (
    InvalidInput,
    Vector,
    counted,
    in_mm,
    of_kind,
    one_line,
    points_of,
    shaped,
    span,
)
from airtact.evaluation.metrics import Evaluation, in_real_air, radiate_drives, sensation
from airtact.evaluation.steepening import steepening
from airtact.geometry.panels import panels_of
from airtact.timing import Progress, no_progress
from airtact.transducers.layout import PhasedArray
from airtact.transducers.levels import EIGHT_BITS, Levels


def radiation_pressure(
    pressure: Complex128[np.ndarray, "points"],
    velocity: Complex128[np.ndarray, "points 3"],
    medium: Medium,
) -> Float64[np.ndarray, "points"]:
    """Return the acoustic radiation pressure on a sound-hard surface.

    This is the time average of the excess pressure. To second order, it is ⟨p²⟩/(2ρc²) − ρ⟨v²⟩/2,
    with density ρ and sound speed c. No momentum flows through a hard surface at rest, because
    the normal velocity is 0. With the peak values P and U of pressure and velocity, the average is
    therefore |P|²/(4ρc²) − ρ|U|²/4 (L. V. King, Proc. R. Soc. Lond. A 147, 212, 1934; T. Hasegawa,
    K. Yosioka, J. Acoust. Soc. Am. 46, 1139, 1969).
    A plane wave of pressure p at normal incidence exerts 2⟨p²⟩/(ρc²) on a wall.

    Parameters
    ----------
    pressure : (P,) complex peak value of the total pressure on the surface [Pa].
    velocity : (P, 3) complex peak value of the particle velocity, which is tangential to the
        surface, such as ``field.velocity(points)[:, :, 0]`` [m/s].
    medium : the air.

    Returns
    -------
    (P,) radiation pressure [Pa]; positive values push the surface into the body.

    Examples
    --------
    >>> air = Medium(sound_speed=343.1, density=1.293)
    >>> wall = radiation_pressure(np.array([2 * 1000 + 0j]), np.zeros((1, 3), dtype=complex), air)
    >>> float(wall[0] / (2 * (1000**2 / 2) / (1.293 * 343.1**2)))
    1.0
    """
    of_kind(medium, Medium, "the medium", "air(celsius)")
    pressure = shaped(pressure, (-1,), "the pressure")
    velocity = shaped(velocity, (len(pressure), 3), "the velocity")
    potential = np.abs(pressure) ** 2 / (4.0 * medium.density * medium.sound_speed**2)
    return potential - 0.25 * medium.density * np.sum(np.abs(velocity) ** 2, axis=1)


@dataclass(frozen=True, eq=False)
class RadiationMap:
    """Sound that one drive produces at Q points on the surfaces of all bodies of a scene.

    ``verify`` returns it as ``Verification.skin``.

    Attributes
    ----------
    body : (Q,) index in ``Scene.obstacles`` of each point's body.
    points, normals, areas : (Q, 3) position in the scene [m], (Q, 3) outward unit normal, and (Q,)
        area of the surface that the point represents [m²].
    pressure : (Q,) incident plus scattered pressure, complex peak value [Pa].
    radiation_pressure : (Q,) time-averaged pressure, positive if it pushes the surface inward [Pa];
        see the function ``radiation_pressure``.
    """

    body: Int64[np.ndarray, "points"]
    points: Float64[np.ndarray, "points 3"]
    normals: Float64[np.ndarray, "points 3"]
    areas: Float64[np.ndarray, "points"]
    pressure: Complex128[np.ndarray, "points"]
    radiation_pressure: Float64[np.ndarray, "points"]

    def __repr__(self) -> str:
        return one_line(self, f"{len(self.points)} points on surfaces")

    def force(self, body: int) -> Float64[np.ndarray, "3"]:
        """Return the force (3,) [N] that the sound exerts on the body with the index ``body``."""
        # Pressure acts against the outward normal.
        chosen = self.body == body
        return -(self.areas * self.radiation_pressure)[chosen] @ self.normals[chosen]

    def pad_force(self, focus: Real[np.ndarray, "3"]) -> float:
        """Return the force [N] on the skin within 5 mm of a focus, about the area of a fingertip.

        The force is positive inward, and NaN if the skin is more than 2 mm from the focus.
        """
        nearest = int(np.linalg.norm(self.points - focus, axis=1).argmin())
        # Height of the focus above the tangent plane of the nearest point
        height = float((np.asarray(focus) - self.points[nearest]) @ self.normals[nearest])
        if height > 2e-3:
            return float("nan")
        centre = focus - height * self.normals[nearest]
        pad = np.linalg.norm(self.points - centre, axis=1) < 5e-3
        # The opposite side of a thin finger may also be within the radius.
        pad &= (self.normals @ self.normals[nearest] > 0.0) & (self.body == self.body[nearest])
        return float(np.sum((self.areas * self.radiation_pressure)[pad]))


def radiation_of(field: RadiatedField, excitation: int) -> RadiationMap:
    """Compute the radiation pressure on all surfaces for one excitation of a solved field.

    The function raises ``InvalidInput`` if the scene has no body, if a body is not sound-hard, or
    if the solver does not compute the velocity on a surface.
    """
    scene = field.scene
    if not scene.obstacles:
        raise InvalidInput(
            "the scene has no body, so there is no radiation pressure; add a body.", code="empty"
        )
    for index, obstacle in enumerate(scene.obstacles):
        if obstacle.boundary != "sound_hard":
            raise InvalidInput(
                f"body {index} is {obstacle.boundary}, but radiation pressure can only be "
                "computed on sound_hard bodies.",
                code="not_supported",
            )
    shapes = [obstacle.surface.shape for obstacle in scene.obstacles]
    # Radiation pressure varies over half a wavelength, so the points must be closer than that.
    edge = scene.wavelength / 3.0
    panels = panels_of(shapes, edge, np.empty((0, 3)), smallest=edge)
    nodes = place_nodes(panels.quadratic_triangles, panels.body, panels.deviation)
    # Quadratic panels deviate from the surface; the solver evaluates the field on the panels.
    points = np.array(nodes.points)
    for index, shape in enumerate(shapes):
        on_body = nodes.body == index
        points[on_body] = shape.project(points[on_body])
    pressure = field.at(points)[:, excitation]
    velocity = field.velocity(points)[:, :, excitation]
    # Solvers whose field is valid only away from surfaces return NaN there.
    lost = int(np.sum(~np.isfinite(pressure) | ~np.isfinite(velocity).all(axis=1)))
    if lost:
        raise InvalidInput(
            f"{field.report.solver} returns no pressure or velocity at {lost} of {len(points)} "
            "surface points. Use BoundaryElement for radiation pressure.",
            code="data_missing",
        )
    return RadiationMap(
        body=nodes.body,
        points=points,
        normals=nodes.normals,
        areas=nodes.weights,
        pressure=pressure,
        radiation_pressure=radiation_pressure(pressure, velocity, scene.medium),
    )


def attainable(transfer: TransferMatrix) -> Float64[np.ndarray, "foci"]:
    """Return the peak pressure that each focus would reach as the only focus.

    The attainable pressure is Σ_e |H_fe|: every element is at full scale, and all contributions are
    in phase.

    Parameters
    ----------
    transfer : (F, E) transfer matrix H of F points and E elements. Its rows belong to the foci,
        followed by the suppression points if there are any.

    Returns
    -------
    (F,) attainable peak pressure for each row of the matrix [Pa].

    Raises
    ------
    InvalidInput
        If ``transfer`` is not a ``TransferMatrix``.

    Examples
    --------
    >>> attainable(TransferMatrix(np.array([[3.0 + 0j, 4j]]), 0.0)).tolist()
    [7.0]
    """
    of_kind(transfer, TransferMatrix, "the transfer matrix", "transfer_matrix(beacons, array)")
    return np.abs(transfer.matrix).sum(axis=1)


@dataclass(frozen=True, eq=False)
class SideLobe:
    """The strongest pressure more than a wavelength from every focus, as found by ``verify``.

    The search covers the surfaces of the bodies and the air up to two wavelengths beyond the foci.

    Attributes
    ----------
    pressure : peak value of the pressure [Pa].
    point : (3,) position in the scene at which this pressure occurs [m].
    """

    pressure: float
    point: Float64[np.ndarray, "3"]


@dataclass(frozen=True, eq=False)
class Verification:
    """Results of ``verify``; printing them shows a summary.

    Attributes
    ----------
    evaluation : ``Evaluation`` with the pressure at each of the F foci.
    quantised : ``Evaluation`` for the drive rounded to ``levels``, or for the exact drive if
        rounding would make it silent.
    levels : amplitude and phase levels of the board, as passed to ``verify``.
    attainable : (F,) peak pressure that each focus would reach at full scale as the only focus
        [Pa].
    skin : ``RadiationMap`` of the sound on the surfaces of the bodies; None in open air.
    forces : (F,) inward force on the skin within 5 mm of each focus, reduced by nonlinear
        steepening [N]; NaN for foci more than 2 mm from skin and where ``evaluation.expected`` is
        NaN.
    side_lobe : ``SideLobe``, the strongest pressure more than a wavelength from every focus, on the
        bodies or in the air up to two wavelengths beyond the foci.
    suppression_points : (Q,) complex peak pressure at the target's suppression points [Pa].
    head : (N,) sound pressure level at the points of a head that were passed to ``verify``, without
        steepening [dB SPL].
    """

    evaluation: Evaluation
    quantised: Evaluation
    levels: Levels
    attainable: Float64[np.ndarray, "foci"]
    skin: RadiationMap | None
    forces: Float64[np.ndarray, "foci"]
    side_lobe: SideLobe
    suppression_points: Complex128[np.ndarray, "suppressed"]
    head: Float64[np.ndarray, "head"]

    def __repr__(self) -> str:
        magnitudes = self.evaluation.magnitudes
        weakest = f"weakest focus {magnitudes[self.evaluation.target.weakest(magnitudes)]:.0f} Pa"
        return one_line(self, weakest, f"{self.contrast:+z.1f} dB above the side lobe")

    @property
    def attained(self) -> Float64[np.ndarray, "foci"]:
        """(F,) ratio of each focus's pressure to ``attainable``."""
        return self.evaluation.magnitudes / self.attainable

    @property
    def quantisation_loss(self) -> float:
        """Largest relative change of a focus's pressure due to rounding."""
        # The relative change is undefined for silent foci.
        exact = self.evaluation.magnitudes
        change = np.abs(self.quantised.magnitudes - exact)[exact > 0.0] / exact[exact > 0.0]
        return float(change.max(initial=0.0))

    @property
    def contrast(self) -> float:
        """Level of the weakest focus relative to the strongest side lobe [dB]."""
        weakest = self.evaluation.magnitudes[self.evaluation.target.weights > 0.0].min()
        return float(20.0 * np.log10(weakest / self.side_lobe.pressure))

    @property
    def suppression_level(self) -> float:
        """Mean p² at the suppression points relative to the foci [dB]; NaN if there is no point."""
        if not len(self.suppression_points):
            return float("nan")
        foci = np.mean(self.evaluation.magnitudes**2)
        return float(10.0 * np.log10(np.mean(np.abs(self.suppression_points) ** 2) / foci))

    def __str__(self) -> str:
        lines = [
            str(self.evaluation),
            f"{span(100 * self.attained, '%', '.0f')} of the pressure that the array could "
            "produce at each focus alone",
            f"rounding to {len(self.levels.amplitudes)} amplitude levels and {self.levels.phases} "
            "phase levels changes the pressure at a focus by at most "
            f"{self.quantisation_loss:.2%}",
            f"strongest side lobe {self.side_lobe.pressure:.1f} Pa at "
            f"{in_mm(self.side_lobe.point)}: the weakest focus is {self.contrast:+z.1f} dB "
            "above it",
        ]
        if len(self.suppression_points):
            lines.append(
                f"mean p² at {len(self.suppression_points)} suppression points relative to the "
                f"foci: {self.suppression_level:+z.1f} dB"
            )
        forces = self.forces[np.isfinite(self.forces)]
        if len(forces):
            lines.append(
                f"force of the sound on the skin {span(1e3 * forces, 'mN', '.3g')} at "
                f"{len(forces)} of {counted(len(self.forces), 'focus', 'foci')}"
            )
        # Where the estimate for real air is invalid, the pressure is far above the threshold.
        evaluation = self.evaluation
        felt = np.fmin(evaluation.magnitudes, evaluation.expected)
        lines.append(sensation(float(felt[evaluation.target.weights > 0.0].min()), "amplitude"))
        if len(self.head):
            level = f"{self.head.max():.1f} dB SPL"
            if in_real_air(evaluation.pressures, evaluation.target, evaluation.steepening):
                level += " without nonlinear steepening, which changes it by up to 2 dB"
            lines.append(f"level at the head: at most {level}. {NO_SAFETY_ASSESSMENT}")
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
    """Compute the pressures, side lobes, skin forces, rounding loss and head level of a drive.

    Parameters
    ----------
    scene : the air and the bodies in it. Its frame is called the obstacles' frame.
    array : the E transducers in the obstacles' frame; see ``PhasedArray.seen_from``.
    drive : the drive of the array, with E complex amplitudes as fractions of full scale.
    target : the foci and suppression points in the obstacles' frame.
    solver : solver for the field. To verify a drive, use a more accurate solver than the one
        used for its transfer matrix, or a solver based on another method.
    transfer : transfer matrix of the target, from which the attainable pressures follow (see
        ``attainable``); by default, it is computed with ``solver`` in a second solve.
    head : (3,) or (N, 3) points of a head in the obstacles' frame, at which the sound pressure
        level is evaluated [m]; none by default. The head itself scatters no sound.
    levels : amplitude and phase levels of a board, by default 256 of each. The drive rounded to
        them is also verified, unless rounding makes it silent.
    progress : function, such as ``print``, that is called with a description of each step as it
        begins.

    Returns
    -------
    A ``Verification`` with the pressures at the foci, before and after rounding, the attainable
    pressures, the strongest side lobe, the forces on the skin, and the levels at the head. Printing
    it shows a summary.

    Raises
    ------
    InvalidInput
        If the drive is silent or does not have as many elements as the array, if elements overlap,
        if an element is inside a body or behind a plane, if a focus, a suppression point or a point
        of the head is in a body, behind a plane or on an element, if a focus or a body is behind
        the face of a directional element, if a body is not sound-hard, if the transfer matrix was
        computed for another target, or if an argument has the wrong type.
    NotConverged
        If the solver stops before it converges.
    """
    of_kind(target, Target, "the target", "Target(points, pressures)")
    head = np.empty((0, 3)) if head is None else np.atleast_2d(head)
    head = points_of(head, "points of the head", least=0)
    if transfer is not None:
        check_foci(transfer, target)
    # Solve both drives together: rounding then costs a right-hand side instead of a factorisation.
    rounded = quantise(drive, levels).drive()
    if not rounded.amplitudes.any():  # a drive too weak for the levels
        rounded = drive
    solver = of_kind(solver, Solver, "the solver", "one such as BoundaryElement()").reporting(
        progress
    )
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
    steepened = steepening(scene, field.sources, target.points, exact[:foci])
    rounding = steepening(scene, field.sources, target.points, quantised[:foci], 1)
    skin = radiation_of(field, 0) if scene.obstacles else None
    progress("searching for side lobes")
    return Verification(
        evaluation=Evaluation(target, exact[:foci], report, steepening=steepened),
        levels=levels,
        quantised=Evaluation(target, quantised[:foci], report, steepening=rounding),
        attainable=attainable(transfer)[:foci],
        skin=skin,
        # Half of the energy that the fundamental loses reaches the focus as harmonics, which also
        # exert pressure. The force on walls in benchmarks/nonlinear.py agrees to within 6 %.
        forces=np.array([skin.pad_force(at) if skin else np.nan for at in target.points])
        * (0.5 + 0.5 * steepened.kept**2),
        side_lobe=_side_lobe(field, skin, array, target),
        suppression_points=exact[foci : foci + len(suppressed)],
        head=sound_pressure_level(exact[foci + len(suppressed) :]),
    )


def _farther(
    points: Float64[np.ndarray, "points 3"],
    centres: Float64[np.ndarray, "centres 3"],
    distance: float,
) -> Bool[np.ndarray, "points"]:
    return np.asarray(KDTree(centres).query(points)[0]) > distance


def _side_lobe(
    field: RadiatedField, skin: RadiationMap | None, array: PhasedArray, target: Target
) -> SideLobe:
    """Return the strongest pressure on the bodies and in a box two wavelengths beyond the foci.

    Points within a wavelength of a focus, within half a wavelength of an element or inside bodies
    are ignored.
    """
    scene = field.scene
    wavelength = scene.wavelength

    def pressure_at(
        points: Float64[np.ndarray, "points 3"],
    ) -> tuple[Float64[np.ndarray, "chosen 3"], Float64[np.ndarray, "chosen"]]:
        points = points[
            _farther(points, target.points, wavelength)
            & _farther(points, array.positions, 0.5 * wavelength)
        ]
        outside = scene.depth(points) < 0.0
        points = points[outside & before_planes(scene.planes, points)]
        return points, np.abs(field.at(points)[:, 0])

    low = target.points.min(axis=0) - 2.0 * wavelength
    high = target.points.max(axis=0) + 2.0 * wavelength
    # Six points per wavelength, but at most 20,000 points.
    spacing = max(wavelength / 6.0, float(np.cbrt(np.prod(high - low) / 20_000)))
    counts = ((high - low) / spacing).astype(int) + 1
    points, pressure = pressure_at(_grid(list(map(np.linspace, low, high, counts))))
    # A lobe may lie between the points, so refine the 40 strongest to a third of the spacing.
    strongest = points[np.argsort(-pressure)[:40]]
    around = strongest[:, None] + _grid([np.array([-1.0, 0.0, 1.0]) * spacing / 3.0] * 3)
    points, pressure = pressure_at(np.clip(around.reshape(-1, 3), low, high))
    if skin is not None:
        # A maximum within a wavelength of a focus is part of the focus, not a lobe.
        off = _farther(skin.points, target.points, wavelength)
        points = np.concatenate([points, skin.points[off]])
        pressure = np.concatenate([pressure, np.abs(skin.pressure[off])])
    return SideLobe(float(pressure.max()), points[pressure.argmax()])


def _grid(axes: list[Float64[np.ndarray, "_"]]) -> Float64[np.ndarray, "points 3"]:
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
