"""Drives for traps: several beads with foci, the stiffest traps, moving beads, and signatures.

A signature converts the drive for a focus into the drive for a trap at the same point.

Sources
-------
- A. Marzo and B. W. Drinkwater, "Holographic acoustic tweezers", PNAS 116, 84 (2019).
- A. Marzo, S. A. Seah, B. W. Drinkwater, D. R. Sahoo, B. Long, S. Subramanian, "Holographic
  acoustic elements for manipulation of levitated objects", Nat. Commun. 6, 8661 (2015), for
  signatures.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from jaxtyping import Complex128, Float64, Real
from scipy.linalg import block_diag
from scipy.optimize import minimize

from airtact.acoustics.scene import Scene, check_outside
from airtact.acoustics.solvers.problem import RadiatedField, Solver
from airtact.acoustics.target import Target
from airtact.drives.drive import Drive, check_drive
from airtact.drives.methods import best
from airtact.drives.sequence import Sequence
from airtact.drives.transfer import TransferMatrix, transfer_matrix
from airtact.errors import (
    InvalidInput,
    Vector,
    check_choice,
    direction_of,
    in_mm,
    of_kind,
    point_of,
    points_of,
    within,
)
from airtact.evaluation.metrics import radiate_drives
from airtact.transducers.layout import PhasedArray
from airtact.traps.gorkov import (
    DIRECTIONS,
    Bead,
    Derivatives,
    bead_of,
    default_solver,
    derivatives,
    derivatives_inside,
    force_of,
    stiffness_of,
)


@dataclass(frozen=True)
class Trap:
    """Description of a trap to be created and of the bead that it holds, as in ``Setup.traps``.

    Values are checked when the trap is used, not on construction. The bead does not affect the
    drive; its properties are used to judge whether the trap holds it.

    Attributes
    ----------
    point : (3,) position of the bead's centre in the scene [m].
    kind : "twin" (the default) for two lobes of opposite phase, one on each side of the bead along
        ``axis``; "vortex" for a ring of high pressure around ``axis``, along which the phase
        increases by 2π.
    axis : (3,) direction of the axis in the scene, a vector of any length above zero; by default y.
    radius : radius of the bead [m], above 0 and at most an eighth of a wavelength; 0.65 mm by
        default.
    density, sound_speed : density [kg/m³], 0.01 to 30,000, and speed of sound [m/s], 100 to 10,000,
        of the bead; by default, those of expanded polystyrene.
    """

    point: Vector
    kind: Literal["twin", "vortex"] = "twin"
    axis: Vector = (0, 1, 0)
    radius: float = 0.65e-3
    density: float = 29.36
    sound_speed: float = 900.0

    def lobes(self, wavelength: float) -> Float64[np.ndarray, "lobes 3"]:
        """Return a point on each lobe (L, 3) [m]: 2 for a twin trap, 4 for a vortex."""
        check_choice(self.kind, "the kind of trap", ("twin", "vortex"))
        axis = direction_of(self.axis, "the axis of a trap")
        ways = np.stack([axis, -axis])
        if self.kind == "vortex":
            # The phase can start in any direction perpendicular to the axis.
            start = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
            start = start / np.linalg.norm(start)
            across = np.cross(axis, start)
            ways = np.stack([start, across, -start, -across])
        # Between opposed boards, the lobes are a quarter of a wavelength from the bead. At that
        # distance, however, lobes of beads half a wavelength apart would coincide.
        return point_of(self.point, "a trap") + wavelength / 6.0 * ways

    def bead(self, scene: Scene) -> Bead:
        """Return the bead, or raise ``InvalidInput`` if a number is out of range."""
        return bead_of(scene, self.radius, self.density, self.sound_speed)

    @property
    def phasing(self) -> Complex128[np.ndarray, "lobes"]:
        """Weights (L,) with which the lobe pressures of an ideal trap add up in phase."""
        count = 2 if self.kind == "twin" else 4
        return np.exp(-2j * np.pi * np.arange(count) / count) / count


def target_of(
    traps: Collection[Trap],
    wavelength: float,
    foci: Real[np.ndarray, "foci 3"] | None = None,
    focus_share: float = 1.0,
) -> Target:
    """Return the target for methods adapted by ``holding``: lobes of all traps, then the foci."""
    points = np.concatenate([trap.lobes(wavelength) for trap in traps])
    if foci is None:
        return Target(points)
    foci = points_of(foci, "the foci beside traps")
    shares = np.concatenate([np.ones(len(points)), np.full(len(foci), focus_share)])
    return Target(np.concatenate([points, foci]), shares=shares)


def check_free(traps: Collection[Trap], scene: Scene) -> None:
    """Raise ``InvalidInput`` if a trap or one of its lobes is in a body or behind a plane."""
    if not traps:
        return
    points = np.array([point_of(trap.point, "a trap") for trap in traps])
    check_outside(scene, points, "trap")
    for index, trap in enumerate(traps):
        depth = scene.depth(trap.lobes(scene.wavelength)).max()
        if depth > 0.0:
            raise InvalidInput(
                f"trap {index} at {in_mm(points[index])} is too close to a body: one of its lobes, "
                f"{1e3 * scene.wavelength / 6.0:.2g} mm from the bead, is {1e3 * depth:.2g} mm "
                "inside the body. Move the trap away, or turn its axis.",
                points[index],
                code="inside_body",
            )


def merged(traps: Collection[Trap], target: Target) -> Target:
    """Return a target with a single focus per trap instead of the lobes that ``target_of`` adds.

    Lobes are the foci around the bead of a trap: 2 for a twin trap and 4 for a vortex.

    Parameters
    ----------
    traps : the traps, in the order in which they were passed to ``target_of``.
    target : a target that begins with the lobes of ``traps``.

    Returns
    -------
    A ``Target`` with the centres of the beads, followed by the foci that do not belong to a trap.
    Each trap gets the share of its first lobe. Suppression points are kept; requested pressures and
    phases are not.
    """
    counts = [len(trap.phasing) for trap in traps]
    points = [point_of(trap.point, "a trap")[None] for trap in traps]
    first = np.cumsum([0, *counts[:-1]])
    kept = np.concatenate([first, np.arange(sum(counts), len(target.points))])
    return Target(
        np.concatenate([*points, target.points[sum(counts) :]]),
        shares=None if target.shares is None else target.shares[kept],
        suppression_points=target.suppression_points,
    )


def holding(
    method: Callable[[TransferMatrix, Target], Drive], traps: Collection[Trap]
) -> Callable[[TransferMatrix, Target], Drive]:
    """Adapt a drive method for foci so that it also computes drives for traps.

    The adapted method expects the target that ``target_of`` returns, and the transfer matrix of
    this target. It replaces the lobes of each trap by a single focus, whose pressure is the sum of
    the lobe pressures with the weights ``Trap.phasing``. For a single trap, the drive has the
    phases of the trap's signature (see ``signature``).
    """

    def make(transfer: TransferMatrix, target: Target) -> Drive:
        phasing = [trap.phasing for trap in traps]
        rest = np.eye(len(transfer.matrix) - sum(len(weights) for weights in phasing))
        matrix = block_diag(*phasing, rest) @ transfer.matrix
        return method(TransferMatrix(matrix, transfer.estimated_error), merged(traps, target))

    return make


def hold(
    scene: Scene,
    array: PhasedArray,
    points: Real[np.ndarray, "traps 3"],
    kind: Literal["twin", "vortex"] = "twin",
    axis: Vector = (0, 1, 0),
    foci: Real[np.ndarray, "foci 3"] | None = None,
    focus_share: float = 1.0,
    solver: Solver | None = None,
) -> Drive:
    """Return a drive that creates a trap at each point and, optionally, foci on the skin.

    Parameters
    ----------
    scene : the air and the bodies in it.
    array : transducers in the frame of the scene.
    points : (T, 3) positions of the traps in the scene [m]. Traps shift each other slightly;
        ``find`` returns the positions at which the beads come to rest.
    kind : kind of all traps. "twin" has two lobes of opposite phase, one on each side of the bead
        along ``axis``; "vortex" has a ring of high pressure around ``axis``, along which the phase
        increases by 2π.
    axis : (3,) direction of the axis of all traps in the scene, a vector of any length above zero;
        by default y. Between boards that face each other, use "twin" along the normal of the
        boards.
    foci : (F, 3) additional foci on the skin [m]; none by default.
    focus_share : requested pressure at the foci divided by the mean pressure at the lobes of the
        traps, at least 0; 1 by default, and 0 ignores the foci. The lobes are a sixth of a
        wavelength from the bead.
    solver : solver that computes the field. The default is the closed-form solution for open air if
        the scene has no body, and boundary elements otherwise.

    Returns
    -------
    The ``Drive`` that maximises the smallest of these pressures: the mean at the lobes of each
    trap, and the pressure at each focus divided by ``focus_share``. The strongest element is at
    full scale.

    Raises
    ------
    InvalidInput
        If a focus or a lobe of a trap is in a body or behind the array, if there are more traps and
        foci than elements, if the kind is unknown, if the axis is zero, or if ``focus_share`` is
        negative.
    NotConverged
        If the solver stops before it converges.

    Examples
    --------
    >>> import airtact as at
    >>> places = np.array([[0, -0.1, 0], [0, 0.1, 0]])
    >>> pair = PhasedArray(places, np.array([[0, 1, 0], [0, -1, 0]]))
    >>> drive = hold(Scene(at.air()), pair, np.zeros((1, 3)))
    >>> np.round(drive.amplitudes[1] / drive.amplitudes[0], 6).real.item()
    -1.0
    """
    traps = [Trap(tuple(point), kind, axis) for point in points_of(points, "trap points")]
    check_free(traps, scene)
    target = target_of(traps, scene.wavelength, foci, focus_share)
    field = (solver or default_solver(scene)).radiate(scene, target.beacons())
    return holding(best, traps)(transfer_matrix(field, array), target)


def signature(
    array: PhasedArray,
    drive: Drive,
    kind: Literal["twin", "vortex", "bottle"] = "twin",
    axis: Vector = (0, 1, 0),
) -> Drive:
    """Convert a drive for a focus into one for a trap at the same position, by shifting phases.

    The shifts are the signature of the trap. They depend on the positions of the elements relative
    to their mean position, and make the contributions of the elements to the pressure at the focus
    cancel. They cancel completely if array and drive are symmetric about the focus.

    Parameters
    ----------
    array : the E transducers, in any frame.
    drive : drive of the E elements that creates a focus at the position of the trap.
    kind : "twin" adds π to the phases of the elements on the side of their mean position toward
        which ``axis`` points. "vortex" adds to each phase the angle of the element around the
        array's front direction, the mean of the normals of its elements. "bottle" adds π to the
        phases of the elements within a radius of the line through the mean position along the front
        direction; the radius is chosen so that they have about half of the total amplitude.
    axis : (3,) axis of the trap in the array's frame, a vector of any length above zero; by default
        y. For "vortex" and "bottle", it is only used if the elements face each other (the mean of
        their normals is shorter than 0.3), and then replaces the array's front direction.

    Returns
    -------
    A ``Drive`` with the same amplitudes and shifted phases.

    Raises
    ------
    InvalidInput
        If the drive does not have as many elements as the array, if the kind is unknown, if the
        axis is zero, or if the elements cannot be divided: for "twin", because ``axis`` is
        perpendicular to a flat array; otherwise, because all elements lie on one line along the
        axis.

    Examples
    --------
    >>> places = np.array([[0, -0.1, 0], [0, 0.1, 0]])
    >>> pair = PhasedArray(places, np.array([[0, 1, 0], [0, -1, 0]]))
    >>> signature(pair, Drive(np.array([1, 1 + 0j]))).amplitudes.real.tolist()
    [1.0, -1.0]
    """
    of_kind(array, PhasedArray, "the array", "one such as surrounding_box()")
    check_drive(drive, "the drive", "array", len(array))
    check_choice(kind, "the kind of trap", ("twin", "vortex", "bottle"))
    axis = direction_of(axis, "the axis of a trap")
    offsets = array.positions - array.positions.mean(axis=0)

    if kind == "twin":
        height = offsets @ axis
        # Along its normal, positions of a flat board differ only by rounding.
        if np.ptp(height) < 1e-6:
            raise InvalidInput(
                "the axis of a twin trap is perpendicular to the array, so it does not divide the "
                "elements. Choose an axis in the plane of the array.",
                code="misplaced",
            )
        return Drive(drive.amplitudes * np.where(height > 0.0, -1.0, 1.0))

    # The mean of the normals is close to 0 if elements face each other, and 0.5 for a hemispherical
    # bowl.
    front = array.normals.mean(axis=0)
    length = np.linalg.norm(front)
    front = axis if length < 0.3 else front / length
    across = offsets - (offsets @ front)[:, None] * front
    distance = np.linalg.norm(across, axis=1)
    if distance.max() < 1e-6:
        raise InvalidInput(
            f"all elements lie on the axis of the {kind} trap. Use another axis.",
            code="misplaced",
        )
    if kind == "vortex":
        # The angle can start in any direction perpendicular to the front direction.
        start = np.cross(front, np.eye(3)[np.abs(front).argmin()])
        start = start / np.linalg.norm(start)
        angle = np.arctan2(across @ np.cross(front, start), across @ start)
        return Drive(drive.amplitudes * np.exp(1j * angle))
    # Find the element at whose radius the amplitude is divided most evenly. Elements at equal
    # distances, apart from rounding, stay together.
    inside = distance <= distance[:, None] + 1e-6
    halves = np.abs(inside @ drive.magnitudes - 0.5 * drive.magnitudes.sum())
    return Drive(drive.amplitudes * np.where(inside[halves.argmin()], -1.0, 1.0))


def stiffest(
    scene: Scene,
    array: PhasedArray,
    points: Real[np.ndarray, "traps 3"],
    kind: Literal["twin", "vortex"] = "twin",
    axis: Vector = (0, 1, 0),
    radius: float = 0.65e-3,
    density: float = 29.36,
    sound_speed: float = 900.0,
    solver: Solver | None = None,
) -> Drive:
    """Return a drive that maximises the stiffness of the weakest trap in its weakest direction.

    The weakest direction is the eigenvector of the smallest eigenvalue of a trap's stiffness matrix
    (see ``stiffness``). Starting from the drive of ``hold``, L-BFGS improves the phases to a local
    maximum. A penalty keeps the force at the points small, so that the beads rest close to them;
    ``find`` returns their resting positions. The weight of the beads is ignored.

    Parameters
    ----------
    scene : the air and the bodies in it.
    array : transducers in the frame of the scene.
    points : (T, 3) positions of the traps in the scene [m].
    kind : kind of the initial traps, "twin" or "vortex"; see ``hold``.
    axis : (3,) direction of the axis of the initial traps, a vector of any length above zero.
    radius : radius of the beads [m], above zero and at most an eighth of a wavelength.
    density, sound_speed : density [kg/m³], 0.01 to 30,000, and speed of sound [m/s], 100 to 10,000,
        of the beads; by default, those of expanded polystyrene.
    solver : solver that computes the field. The default is the closed-form solution for open air if
        the scene has no body, and boundary elements otherwise.

    Returns
    -------
    A ``Drive`` with every element at full scale; only the phases are optimised.

    Raises
    ------
    InvalidInput
        If a point is closer than λ/(2π) to a body or a plane, if a lobe of an initial trap (λ/6
        from its point) is in a body or behind the array, if the kind is unknown, or if another
        parameter is outside its range.
    NotConverged
        If the solver stops before it converges.

    Examples
    --------
    >>> import airtact as at
    >>> caps = at.transducers.known_array("tinylev")
    >>> air = Scene(at.air())
    >>> traps = np.array([[-6e-3, 0, 0], [6e-3, 0, 0]])
    >>> drives = hold(air, caps, traps), stiffest(air, caps, traps)
    >>> shifts = [np.abs(at.traps.find(air, caps, drive, traps) - traps).max() for drive in drives]
    >>> np.round(1e3 * np.array(shifts), 2).tolist()
    [0.3, 0.0]
    """
    bead = bead_of(scene, radius, density, sound_speed)
    points = points_of(points, "trap points")
    start = hold(scene, array, points, kind, axis, solver=solver)
    solver = solver or default_solver(scene)
    wavenumber = scene.wavenumber
    # Compute derivatives at the traps for every element, from beacons on spheres around the traps.
    size = 1.0 / wavenumber.real
    target = Target((points[:, None] + size * DIRECTIONS).reshape(-1, 3))
    check_outside(scene, target.points, "point around a trap")
    transfer = transfer_matrix(solver.radiate(scene, target.beacons()), array)
    traps = len(points)
    elements = len(array)
    pressure = transfer.matrix.reshape(traps, -1, elements).transpose(0, 2, 1)
    pressure = pressure.reshape(traps * elements, -1)
    waves = derivatives_inside(pressure, np.full(len(pressure), size), wavenumber)
    # Stack one row per derivative: 1 pressure, 3 first, 9 second and 27 third derivatives.
    parts = (waves.pressure, waves.first, waves.second, waves.third)
    rows = np.concatenate([part.reshape(traps, elements, -1) for part in parts], axis=2)
    a, b = bead.factors(scene)

    def sound_of(amplitudes: np.ndarray) -> Derivatives:
        values = np.einsum("ted,e->td", rows, amplitudes)
        return Derivatives(
            values[:, 0],
            values[:, 1:4],
            values[:, 4:13].reshape(-1, 3, 3),
            values[:, 13:].reshape(-1, 3, 3, 3),
        )

    sound = sound_of(start.at_full_scale().amplitudes)
    values, ways = np.linalg.eigh(stiffness_of(sound, bead, scene))
    scale = np.abs(values).min()
    # A shift of λ/30 costs as much as the stiffness at the start.
    sizes = np.maximum(np.abs(values), 1e-3 * np.abs(values).max())
    shifts = np.einsum("tik,tk,tjk->tij", ways, 30.0 / (scene.wavelength * sizes), ways)

    def loss(phases: Float64[np.ndarray, "elements"]) -> tuple[float, np.ndarray]:
        """Return the value to minimise, and its gradient with respect to the phases.

        The value is a smooth maximum of the negative stiffnesses, plus a penalty for forces at
        the points.
        """
        amplitudes = np.exp(1j * phases)
        sound = sound_of(amplitudes)
        values, ways = np.linalg.eigh(stiffness_of(sound, bead, scene))
        push = np.einsum("tij,tj->ti", shifts, force_of(sound, bead, scene))
        sharpness = 20.0
        least = values.min()
        shares = np.exp(-sharpness * (values - least) / scale)
        total = shares.sum()
        cost = np.log(total) / sharpness - least / scale + np.sum(push**2)
        # Derivatives of the cost by the stiffness matrices and forces.
        weight = -np.einsum("tik,tk,tjk->tij", ways, shares / total, ways) / scale
        pull = 2.0 * np.einsum("tij,tj->ti", shifts, push)
        # Derivatives by the conjugates of the values in ``sound``, from both formulas.
        p = sound.pressure
        g = sound.first
        h = sound.second
        along = np.einsum("ti,ti->t", pull, g)
        by_p = 2.0 * a * (np.einsum("tij,tij->t", weight, h) - along)
        by_g = 4.0 * a * np.einsum("tij,tj->ti", weight, g) - 2.0 * a * p[:, None] * pull
        by_g -= 2.0 * b * np.einsum("tij,tijk->tk", weight, sound.third)
        by_g += 2.0 * b * np.einsum("ti,tij->tj", pull, h)
        by_h = 2.0 * a * p[:, None, None] * weight - 4.0 * b * weight @ h
        by_h += 2.0 * b * np.einsum("ti,tj->tij", pull, g)
        by_third = -2.0 * b * np.einsum("tij,tk->tijk", weight, g)
        by_parts = [part.reshape(traps, -1) for part in (by_p, by_g, by_h, by_third)]
        by_values = np.concatenate(by_parts, axis=1).conj()
        by_amplitude = np.einsum("td,ted->e", by_values, rows)
        return cost, (by_amplitude * 1j * amplitudes).real

    best = minimize(loss, start.phases, jac=True, method="L-BFGS-B", options={"maxiter": 1000})
    return Drive(np.exp(1j * best.x))


def path(
    scene: Scene,
    array: PhasedArray,
    corners: Real[np.ndarray, "corners 3"],
    kind: Literal["twin", "vortex"] = "twin",
    axis: Vector = (0, 1, 0),
    speed: float = 0.02,
    share: float = 0.3,
    radius: float = 0.65e-3,
    density: float = 29.36,
    sound_speed: float = 900.0,
    solver: Solver | None = None,
) -> Sequence:
    """Return a sequence of drives that carries a bead along straight lines and back.

    Each frame contains a single trap, and the trap moves by one step from frame to frame. A bead
    follows if the next trap is closer than the distance at which the trap's restoring force
    peaks. In a standing wave, this distance is an eighth of a wavelength. For each frame, the
    function checks that the trap can hold more than the bead's weight. It also checks that the
    bead's previous resting position is nearer to the trap than the peak of the restoring force.
    Inertia and drag are not included.

    Parameters
    ----------
    scene : the air and the bodies in it.
    array : transducers in the frame of the scene.
    corners : (C, 3) at least 2 corners of the path in the scene [m]. The sequence repeats, so the
        bead returns the same way unless the last corner equals the first.
    kind : kind of the trap, "twin" or "vortex", as for ``hold``.
    axis : (3,) direction of the axis of the trap, a vector of any length.
    speed : speed of the bead during the longest step [m/s], above 0 and at most 10. The rate is the
        same for all frames, so the bead is slower during shorter steps.
    share : largest step between frames, as a fraction of the distance at which the restoring force
        peaks; above 0 and at most 0.9.
    radius : radius of the bead [m], at most an eighth of a wavelength.
    density, sound_speed : density [kg/m³] and speed of sound [m/s] of the bead; by default,
        those of expanded polystyrene.
    solver : solver that computes the field. The default is the closed-form solution for open air if
        the scene has no body, and boundary elements otherwise.

    Returns
    -------
    A ``Sequence`` of the drives along the path, for ``Emission.play``. Its frame rate is ``speed``
    divided by the longest step.

    Raises
    ------
    InvalidInput
        If the bead would be lost between two frames, if all corners coincide, if the kind is
        unknown, if the axis is zero, or if a parameter is outside its range. The error is also
        raised if the trap or one of its lobes would be in a body or behind the array.
    NotConverged
        If the solver stops before it converges.

    Examples
    --------
    >>> import airtact as at
    >>> caps = at.transducers.known_array("tinylev")
    >>> len(path(Scene(at.air()), caps, np.array([[0, 0, 0], [0, 2e-3, 0]])))
    12
    """
    bead = bead_of(scene, radius, density, sound_speed)
    speed = within(speed, 0.0, 10.0, "the speed of a bead", "m/s", "use metres per second.")
    share = within(share, 0.0, 0.9, "the share of a step", "", "smaller steps are safer.")
    corners = points_of(corners, "the corners of a path")
    if np.ptp(corners, axis=0).max() < 1e-6:
        raise InvalidInput("a path needs at least two different corners.", code="too_few")
    solver = solver or default_solver(scene)
    if np.linalg.norm(corners[-1] - corners[0]) > 1e-6:
        corners = np.concatenate([corners, corners[-2::-1]])

    def field_of(points: Float64[np.ndarray, "points 3"]) -> tuple[list[Drive], RadiatedField]:
        """Return the drive of a trap at each point, and a field with one excitation per drive."""
        traps = [Trap(tuple(point), kind, axis) for point in points]
        lobes = np.array([trap.lobes(scene.wavelength) for trap in traps])
        target = Target(lobes.reshape(-1, 3))
        transfer = transfer_matrix(solver.radiate(scene, target.beacons()), array)
        rows = np.arange(len(target.points)).reshape(len(points), -1)
        drives = [
            holding(best, [trap])(transfer.of_rows(own), Target(lobes[index]))
            for index, (trap, own) in enumerate(zip(traps, rows, strict=True))
        ]
        return drives, radiate_drives(scene, array, drives, solver, foci=points)

    # Divide each line between two corners into points, without the last one.
    _, field = field_of(corners)
    points = []
    for index, (start, end) in enumerate(pairwise(corners)):
        way = end - start
        first = _reach(field, bead, start, way, index)
        reach = min(first, _reach(field, bead, end, way, index + 1))
        steps = int(np.ceil(np.linalg.norm(way) / max(share * reach, 1e-6)))
        points.append(start + way * np.arange(steps)[:, None] / max(steps, 1))
    points = np.concatenate(points)
    drives, field = field_of(points)
    # Check that the bead follows from each equilibrium to the next.
    excitations = np.arange(len(points))
    sound = derivatives(field, points, bead, excitations)
    matrices = stiffness_of(sound, bead, scene)
    pulls = force_of(sound, bead, scene)
    rests = points + np.einsum("pij,pj->pi", np.linalg.pinv(matrices, rcond=1e-6), pulls)
    before = np.roll(rests, 1, axis=0)
    ways = rests - before
    sound = derivatives(field, before, bead, excitations)
    restoring = np.einsum("pi,pi->p", force_of(sound, bead, scene), ways)
    linear = np.einsum("pi,pij,pj->p", ways, matrices, ways)
    # In a standing wave, the force sin(2kx) K/(2k) peaks at K λ/(4π), 2/π of the linear force.
    holds = np.linalg.eigvalsh(matrices)[:, 0] * scene.wavelength / (4.0 * np.pi)
    lost = (holds <= 9.80665 * bead.mass) | (restoring < 2.0 / np.pi * linear)
    if lost.any():
        index = int(lost.argmax())
        raise InvalidInput(
            f"the bead would be lost on its way to {in_mm(points[index])}. Move the path, choose "
            "another axis, or set a smaller share.",
            points[index],
            code="misplaced",
        )
    longest = np.linalg.norm(np.diff(points, axis=0, append=points[:1]), axis=1).max()
    return Sequence(np.array([drive.amplitudes for drive in drives]), speed / longest)


def _reach(
    field: RadiatedField,
    bead: Bead,
    point: Float64[np.ndarray, "3"],
    way: Float64[np.ndarray, "3"],
    excitation: int,
) -> float:
    """Return the distance [m] behind a trap at which the force along the path first peaks."""
    way = way / max(np.linalg.norm(way), 1e-12)
    distances = field.scene.wavelength / 4.0 * np.linspace(0.05, 1.0, 20)
    behind = point - distances[:, None] * way
    sound = derivatives(field, behind, bead, np.full(20, excitation))
    pull = force_of(sound, bead, field.scene) @ way
    rising = np.append(np.diff(pull) > 0.0, False)
    return float(distances[rising.argmin()])
