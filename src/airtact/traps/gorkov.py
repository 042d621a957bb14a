"""Gor'kov potential of a small bead, its force and stiffness, positions of traps, and verdicts.

Sources
-------
- L. P. Gor'kov, "On the forces acting on a small particle in an acoustical field in an ideal
  fluid", Sov. Phys. Dokl. 6, 773 (1962).
- H. Bruus, "Acoustofluidics 7: The acoustic radiation force on small particles", Lab Chip 12, 1014
  (2012), equations (3) and (4).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128, Float64, Int64, Real
from scipy.integrate import lebedev_rule
from scipy.spatial import KDTree
from scipy.special import spherical_jn

from airtact.acoustics.medium import Medium
from airtact.acoustics.scene import Scene, check_outside
from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.acoustics.solvers.problem import FreeField, RadiatedField, Solver
from airtact.drives.drive import Drive
from airtact.errors import InvalidInput, in_mm, millimetres, of_kind, one_line, points_of, within
from airtact.evaluation.metrics import radiate_drives
from airtact.transducers.layout import PhasedArray

# Quadrature points on the unit sphere, exact to order 11. At kr = 1, waves of order 9 and higher
# change the third derivatives by 1e-7.
_columns, _weights = lebedev_rule(11)
DIRECTIONS = _columns.T


@dataclass(frozen=True)
class Bead:
    """A small bead, treated as a fluid sphere.

    ``Trap.bead`` creates the bead of a trap. ``force`` and similar functions create it from their
    arguments ``radius``, ``density`` and ``sound_speed``. Values are not checked here.

    Attributes
    ----------
    radius : radius of the bead [m]. Gor'kov's potential is valid up to an eighth of a wavelength.
    material : medium with the bead's density and speed of sound; its absorption is ignored.
    """

    radius: float
    material: Medium

    @property
    def mass(self) -> float:
        """Mass of the bead [kg]."""
        return 4.0 / 3.0 * np.pi * self.radius**3 * self.material.density

    def room(self, scene: Scene) -> float:
        """Return the least allowed distance [m] of the bead's centre from bodies and elements."""
        # Small spheres amplify errors of the field in the derivatives. Near a ball, the stiffness
        # from boundary elements is off by 2.5 % at λ/16 and by 25 % at half of that.
        return max(self.radius, scene.wavelength / 16.0)

    def factors(self, scene: Scene) -> tuple[float, float]:
        """Return the factors a and b of the potential U = a|p|² − b|∇p|² for peak pressures p.

        a = V f₁/(4ρc²) and b = V 3f₂/(8ρω²), because the particle velocity is ∇p/(iωρ).
        """
        air = scene.medium
        volume = self.mass / self.material.density
        ratio = self.material.density / air.density
        monopole = 1.0 - (air.sound_speed / self.material.sound_speed) ** 2 / ratio
        dipole = 2.0 * (ratio - 1.0) / (2.0 * ratio + 1.0)
        angular = 2.0 * np.pi * scene.frequency
        return (
            volume * monopole / (4.0 * air.density * air.sound_speed**2),
            volume * 3.0 * dipole / (8.0 * air.density * angular**2),
        )


@dataclass(frozen=True)
class Derivatives:
    """Pressure at P points, and its first to third derivatives along x, y and z.

    Attributes
    ----------
    pressure : (P,) pressure at the points [Pa].
    first, second, third : first derivatives (P, 3) [Pa/m], second derivatives (P, 3, 3) [Pa/m²] and
        third derivatives (P, 3, 3, 3) [Pa/m³].
    """

    pressure: Complex128[np.ndarray, "points"]
    first: Complex128[np.ndarray, "points 3"]
    second: Complex128[np.ndarray, "points 3 3"]
    third: Complex128[np.ndarray, "points 3 3 3"]


def potential(
    scene: Scene,
    array: PhasedArray,
    drive: Drive,
    points: Real[np.ndarray, "points 3"],
    radius: float = 0.65e-3,
    density: float = 29.36,
    sound_speed: float = 900.0,
    solver: Solver | None = None,
) -> Float64[np.ndarray, "points"]:
    """Return Gor'kov's potential of a bead at points; its negative gradient is the force.

    Beads collect at its minima, as ``find`` computes. The potential neglects streaming, viscosity,
    weight, and reflections of the sound that the bead scatters. See ``force`` for its accuracy.

    Parameters
    ----------
    scene : the air and the bodies in it.
    array : transducers in the frame of the scene; see ``PhasedArray.seen_from``.
    drive : drive of the array, one complex amplitude per element.
    points : (P, 3) positions of the bead's centre in the scene [m].
    radius : radius of the bead [m], above 0 and at most an eighth of a wavelength.
    density, sound_speed : density [kg/m³], 0.01 to 30,000, and speed of sound [m/s], 100 to 10,000,
        of the bead, which is treated as a fluid sphere; by default, those of expanded polystyrene.
    solver : solver that computes the field. The default is the closed-form solution for open air if
        the scene has no body, and boundary elements otherwise.

    Returns
    -------
    (P,) potential at each point relative to silence [J].

    Raises
    ------
    InvalidInput
        If the bead's centre is closer to a body, a plane or an element than the radius of the bead
        or a sixteenth of a wavelength, whichever is larger. The error is also raised if a point or
        a body is behind the face of a directional element, if elements overlap each other or a
        body, if the drive is silent or does not have as many elements as the array, or if a
        parameter is outside its range.
    NotConverged
        If the solver stops before it converges.
    """
    field, points, bead = solved(scene, array, drive, points, radius, density, sound_speed, solver)
    sound = derivatives(field, points, bead)
    return potential_of(sound.pressure, sound.first, bead, scene)


def force(
    scene: Scene,
    array: PhasedArray,
    drive: Drive,
    points: Real[np.ndarray, "points 3"],
    radius: float = 0.65e-3,
    density: float = 29.36,
    sound_speed: float = 900.0,
    solver: Solver | None = None,
) -> Float64[np.ndarray, "points 3"]:
    """Return the radiation force on a bead at points, from the gradient of Gor'kov's potential.

    Gor'kov's potential is valid for beads much smaller than the wavelength. It overestimates force
    and stiffness by about (ka)²/2 for a bead of radius a at the wavenumber k: for polystyrene in
    air at 40 kHz, by 7 % at 0.5 mm, 12 % at 0.65 mm and 33 % at 1 mm. The result neglects
    streaming, viscosity, weight, and reflections of the sound that the bead scatters.

    Parameters
    ----------
    scene : the air and the bodies in it.
    array : transducers in the frame of the scene; see ``PhasedArray.seen_from``.
    drive : drive of the array, one complex amplitude per element.
    points : (P, 3) positions of the bead's centre in the scene [m].
    radius : radius of the bead [m], above 0 and at most an eighth of a wavelength. For larger
        beads, use ``body_force``.
    density, sound_speed : density [kg/m³], 0.01 to 30,000, and speed of sound [m/s], 100 to 10,000,
        of the bead, which is treated as a fluid sphere; by default, those of expanded polystyrene.
    solver : solver that computes the field. The default is the closed-form solution for open air if
        the scene has no body, and boundary elements otherwise.

    Returns
    -------
    (P, 3) time-averaged force on the bead at each point, along the axes of the scene [N].

    Raises
    ------
    InvalidInput
        If the bead's centre is closer to a body, a plane or an element than the radius of the bead
        or a sixteenth of a wavelength, whichever is larger. The error is also raised if a point or
        a body is behind the face of a directional element, if elements overlap each other or a
        body, if the drive is silent or does not have as many elements as the array, or if a
        parameter is outside its range.
    NotConverged
        If the solver stops before it converges.

    Examples
    --------
    A bead between two facing elements is pulled to the middle, where the pressure has a node:

    >>> places = np.array([[0, -0.1, 0], [0, 0.1, 0]])
    >>> pair = PhasedArray(places, np.array([[0, 1, 0], [0, -1, 0]]))
    >>> open_air = Scene(Medium(sound_speed=343.1, density=1.2), [])
    >>> pull = force(open_air, pair, Drive(np.array([1, -1 + 0j])), np.array([[0.0, 1e-3, 0.0]]))
    >>> bool(pull[0, 1] < 0.0)
    True
    """
    field, points, bead = solved(scene, array, drive, points, radius, density, sound_speed, solver)
    return force_of(derivatives(field, points, bead), bead, scene)


def stiffness(
    scene: Scene,
    array: PhasedArray,
    drive: Drive,
    points: Real[np.ndarray, "points 3"],
    radius: float = 0.65e-3,
    density: float = 29.36,
    sound_speed: float = 900.0,
    solver: Solver | None = None,
) -> Float64[np.ndarray, "points 3 3"]:
    """Return the stiffness matrix of the radiation force on a bead at each point.

    The matrix consists of the second derivatives of Gor'kov's potential, K_ij = ∂²U/∂x_i∂x_j =
    −∂F_i/∂x_j, along the axes x, y and z of the scene. For a small displacement s from an
    equilibrium, the force is −K s, so the bead is trapped there if all eigenvalues of K are
    positive. The points need not be equilibria, but K only describes a trap at an equilibrium, as
    returned by ``find``. The weight of the bead does not depend on its position, so it does not
    affect the stiffness. For the errors of Gor'kov's potential, see ``force``.

    Parameters
    ----------
    scene : the air and the bodies in it.
    array : transducers in the frame of the scene.
    drive : drive of the array, one complex amplitude per element.
    points : (P, 3) positions of the bead's centre in the scene [m].
    radius : radius of the bead [m], above zero and at most an eighth of a wavelength.
    density, sound_speed : density [kg/m³], 0.01 to 30,000, and speed of sound [m/s], 100 to 10,000,
        of the bead, which is treated as a fluid sphere; by default, those of expanded polystyrene.
    solver : solver that computes the field. The default is the closed-form solution for open air if
        the scene has no body, and boundary elements otherwise.

    Returns
    -------
    (P, 3, 3) symmetric stiffness matrix at each point [N/m].

    Raises
    ------
    InvalidInput
        If the bead's centre is closer to a body, a plane or an element than the radius of the bead
        or a sixteenth of a wavelength, whichever is larger. The error is also raised if a point or
        a body is behind the face of a directional element, if elements overlap each other or a
        body, if the drive is silent or does not have as many elements as the array, or if a
        parameter is outside its range.
    NotConverged
        If the solver stops before it converges.
    """
    field, points, bead = solved(scene, array, drive, points, radius, density, sound_speed, solver)
    return stiffness_of(derivatives(field, points, bead), bead, scene)


def bead_of(scene: Scene, radius: float, density: float, sound_speed: float) -> Bead:
    """Return the bead, or raise ``InvalidInput`` if a number is out of range."""
    of_kind(scene, Scene, "the scene", "Scene(medium, obstacles, frequency)")
    # At this limit, the force is already overestimated by 40 %.
    slip = (
        "Gor'kov's potential only applies to beads up to a quarter of a wavelength across. For "
        "larger beads, use at.traps.body_force."
    )
    radius = within(radius, 0.0, scene.wavelength / 8.0, "the radius of a bead", "m", slip)
    return Bead(radius, Medium(sound_speed, density))


def default_solver(scene: Scene) -> Solver:
    """Return ``FreeField`` if the scene has no body, and ``BoundaryElement`` otherwise."""
    return BoundaryElement() if scene.obstacles else FreeField()


def solved(
    scene: Scene,
    array: PhasedArray,
    drive: Drive,
    points: Real[np.ndarray, "points 3"],
    radius: float,
    density: float,
    sound_speed: float,
    solver: Solver | None,
) -> tuple[RadiatedField, Float64[np.ndarray, "points 3"], Bead]:
    """Check the arguments of ``force``; return the drive's field, the points and the bead."""
    bead = bead_of(scene, radius, density, sound_speed)
    points = points_of(points, "bead points")
    check_outside(scene, points, "bead")
    solver = solver or default_solver(scene)
    # Pass the points as foci, because they must be in front of the elements.
    return radiate_drives(scene, array, [drive], solver, foci=points), points, bead


def derivatives(
    field: RadiatedField,
    points: Real[np.ndarray, "points 3"],
    bead: Bead,
    excitations: Int64[np.ndarray, "points"] | None = None,
) -> Derivatives:
    """Return the pressure and its derivatives at bead positions, without truncation error.

    ``excitations`` (P,) selects the excitation of the field for each point; by default the first.

    In a ball without sources and bodies, the pressure is a sum of regular spherical waves j_l(kr)
    Y_lm. The moments of the pressure on a sphere around the point are its integrals, weighted by
    trace-free products of the coordinates. The moments determine the waves of order l ≤ 3, and only
    these waves contribute to derivatives up to the third at the centre. For a plane wave e^{iks·x},
    the moment of order l is i^l j_l(kr) times the trace-free tensor of s, and the derivatives are
    (ik)^l s…s. The factors in the code follow from this case.
    """
    points = points_of(points, "bead points")
    wavenumber = field.scene.wavenumber
    clearance = clearances(field, points)
    nearest = int(clearance.argmin())
    room = bead.room(field.scene)
    if clearance[nearest] < room:
        raise InvalidInput(
            f"the centre of bead {nearest} at {in_mm(points[nearest])} is "
            f"{millimetres(clearance[nearest], 3)} from a body, plane or element, but it must be "
            f"at least {millimetres(room, 3)} away. Move it.",
            points[nearest],
            code="bodies_overlap",
        )
    # Errors of the field have less effect on a larger sphere, because j_3 ~ (kr)³.
    radius = np.minimum(1.0 / wavenumber.real, 0.9 * clearance)
    around = points[:, None] + radius[:, None, None] * DIRECTIONS
    if excitations is None:
        excitations = np.zeros(len(points), dtype=np.int64)
    pressures = field.at(around.reshape(-1, 3)).reshape(len(points), len(DIRECTIONS), -1)
    pressure = pressures[np.arange(len(points)), :, excitations]
    return derivatives_inside(pressure, radius, wavenumber)


def derivatives_inside(
    pressure: Complex128[np.ndarray, "points directions"],
    radius: Float64[np.ndarray, "points"],
    wavenumber: complex,
) -> Derivatives:
    """Return the derivatives at the centres of spheres from the pressures on the spheres.

    The pressures are those in the ``DIRECTIONS`` from each centre.
    """
    pressure = pressure * (_weights / (4.0 * np.pi))
    waves = [spherical_jn(order, wavenumber * radius) for order in range(4)]
    identity = np.eye(3)
    second = np.einsum("qi,qj->qij", DIRECTIONS, DIRECTIONS)
    third = np.einsum("qij,qk->qijk", second, DIRECTIONS)
    # Subtract the traces of the direction tensors.
    second = second - identity / 3.0
    third = third - _symmetric(DIRECTIONS) / 5.0

    centre = pressure.sum(axis=1) / waves[0]
    gradient = wavenumber * (pressure @ DIRECTIONS) / waves[1][:, None]
    curvature = np.einsum("pq,qij->pij", pressure, second) / waves[2][:, None, None]
    curvature = wavenumber**2 * (curvature - identity / 3.0 * centre[:, None, None])
    cubic = np.einsum("pq,qijk->pijk", pressure, third) / waves[3][:, None, None, None]
    cubic = wavenumber**3 * cubic - wavenumber**2 / 5.0 * _symmetric(gradient)
    return Derivatives(centre, gradient, curvature, cubic)


def clearances(
    field: RadiatedField, points: Float64[np.ndarray, "points 3"]
) -> Float64[np.ndarray, "points"]:
    """Return the distance [m] from the nearest body, plane or source, negative inside a body."""
    clearance, _ = KDTree(field.sources.positions).query(points)
    clearance = np.minimum(clearance, -field.scene.depth(points))
    for plane in field.scene.planes:
        clearance = np.minimum(clearance, plane.height(points))
    return clearance


def _symmetric(vectors: np.ndarray) -> np.ndarray:
    """Return δ_ij v_k + δ_ik v_j + δ_jk v_i (N, 3, 3, 3) for vectors v (N, 3)."""
    product = np.einsum("ij,nk->nijk", np.eye(3), vectors)
    return product + product.transpose(0, 1, 3, 2) + product.transpose(0, 3, 2, 1)


def potential_of(
    pressure: Complex128[np.ndarray, "points"],
    gradient: Complex128[np.ndarray, "points 3"],
    bead: Bead,
    scene: Scene,
) -> Float64[np.ndarray, "points"]:
    """Return the potential a|p|² − b|∇p|² (P,) [J], with the bead's factors a and b."""
    a, b = bead.factors(scene)
    return a * np.abs(pressure) ** 2 - b * np.sum(np.abs(gradient) ** 2, axis=1)


def force_of(sound: Derivatives, bead: Bead, scene: Scene) -> Float64[np.ndarray, "points 3"]:
    """Return the force −∇(a|p|² − b|∇p|²) (P, 3) [N], with the bead's factors a and b."""
    a, b = bead.factors(scene)
    by_pressure = np.einsum("p,pi->pi", sound.pressure.conj(), sound.first)
    by_velocity = np.einsum("pj,pij->pi", sound.first.conj(), sound.second)
    return -2.0 * (a * by_pressure - b * by_velocity).real


def stiffness_of(sound: Derivatives, bead: Bead, scene: Scene) -> Float64[np.ndarray, "points 3 3"]:
    """Return the stiffness matrix ∇∇(a|p|² − b|∇p|²) (P, 3, 3) [N/m].

    The factors a and b of the potential depend on the bead.
    """
    a, b = bead.factors(scene)
    by_pressure = np.einsum("pi,pj->pij", sound.first.conj(), sound.first)
    by_pressure += np.einsum("p,pij->pij", sound.pressure.conj(), sound.second)
    by_velocity = np.einsum("pik,pjk->pij", sound.second.conj(), sound.second)
    by_velocity += np.einsum("pk,pijk->pij", sound.first.conj(), sound.third)
    return 2.0 * (a * by_pressure - b * by_velocity).real


@dataclass(frozen=True, eq=False)
class Verdict:
    """Verdict on whether a point traps a bead, with the values on which it is based.

    ``verdict`` returns one per point. ``is_trap`` is True if ``shift`` is at most a twentieth of a
    wavelength, if the stiffness is positive in all directions, and if ``holds`` is above 1.
    Printing the verdict shows the reasons. Vectors are in the frame of the scene.

    Attributes
    ----------
    point : (3,) position of the bead's centre [m].
    force : (3,) radiation force on the bead at the point, without its weight [N].
    stiffness : (3, 3) stiffness matrix at the point, as returned by ``stiffness`` [N/m].
    shift : (3,) vector from the point to the place where the radiation force is zero [m], estimated
        by dividing the force by the stiffness.
    holds : ratio of the holding force to the weight of the bead. The holding force is the largest
        restoring force within a quarter of a wavelength of the point, along the weakest of the six
        directions ±x, ±y and ±z; 0 if there is none.
    excess : relative amount by which Gor'kov's potential overestimates force and stiffness for this
        bead; 0.1 is 10 %. The other attributes are not corrected for it.
    wavelength : wavelength of the sound [m].
    """

    point: Float64[np.ndarray, "3"]
    force: Float64[np.ndarray, "3"]
    stiffness: Float64[np.ndarray, "3 3"]
    shift: Float64[np.ndarray, "3"]
    holds: float
    excess: float
    wavelength: float

    def __repr__(self) -> str:
        return one_line(self, str(self))

    @property
    def balanced(self) -> bool:
        """Whether the equilibrium is within a twentieth of a wavelength of the point."""
        return bool(np.linalg.norm(self.shift) <= self.wavelength / 20.0)

    @property
    def stable(self) -> bool:
        """Whether the force pushes the bead back after a displacement in any direction."""
        return bool(np.linalg.eigvalsh(self.stiffness).min() > 0.0)

    @property
    def is_trap(self) -> bool:
        """Whether the point is balanced and stable, and the trap can carry the bead's weight."""
        return self.balanced and self.stable and self.holds > 1.0

    def __str__(self) -> str:
        along = np.diag(self.stiffness)
        held = [name for name, value in zip("xyz", along, strict=True) if value > 0.0]
        # The reasons why there is no trap come first.
        reasons = []
        if not held:
            reasons.append("the force pushes the bead away in all directions")
        reasons += [
            f"along {name} the stiffness is {value:.2g} N/m"
            for name, value in zip("xyz", along, strict=True)
            if value <= 0.0
        ]
        if not self.stable and len(held) == 3:
            # The axes do not reveal an instability in a direction between them.
            values, ways = np.linalg.eigh(self.stiffness)
            way = (np.round(ways[:, 0], 2) + 0.0).tolist()
            reasons.append(f"along {way} the stiffness is {values[0]:.2g} N/m")
        if not self.balanced:
            # The estimate is linear, so it is meaningless farther away.
            distance = float(np.linalg.norm(self.shift))
            near = distance < self.wavelength / 4.0
            place = f"about {millimetres(distance)}" if near else "over a quarter of a wavelength"
            reasons.append(f"the equilibrium is {place} away")
        if self.stable:
            # Write two digits without an exponent.
            holds = f"{float(f'{self.holds:.2g}'):g} times the weight of the bead"
            enough = "holds" if self.holds > 1.0 else "too weak for the bead: it only holds"
            values = ", ".join(f"{value:.3g}" for value in along)
            reasons += [f"{enough} {holds}", f"stable along x, y and z ({values} N/m)"]
        elif held:
            reasons.append(f"stable along {' and '.join(held)}")
        reasons.append(f"forces are overestimated by about {self.excess:.0%}")
        word = "trap" if self.is_trap else "no trap"
        return f"{word} at {in_mm(np.round(self.point, 5) + 0.0)}: {'; '.join(reasons)}"


def verdict(
    scene: Scene,
    array: PhasedArray,
    drive: Drive,
    points: Real[np.ndarray, "points 3"],
    radius: float = 0.65e-3,
    density: float = 29.36,
    sound_speed: float = 900.0,
    solver: Solver | None = None,
) -> list[Verdict]:
    """Judge for each point whether it traps a bead.

    A point is a trap if the radiation force vanishes within a twentieth of a wavelength of it, if
    the force pushes the bead back after a displacement in any direction, and if it can carry more
    than the bead's weight. The force and its limitations are those of ``force``. To judge the place
    at which a bead comes to rest, pass the points that ``find`` returns, without rows of NaN.

    Parameters
    ----------
    scene : the air and the bodies in it.
    array : transducers in the frame of the scene; see ``PhasedArray.seen_from``.
    drive : drive of the array, one complex amplitude per element.
    points : (P, 3) positions of the bead's centre in the scene [m].
    radius : radius of the bead [m], above 0 and at most an eighth of a wavelength.
    density, sound_speed : density [kg/m³], 0.01 to 30,000, and speed of sound [m/s], 100 to 10,000,
        of the bead, which is treated as a fluid sphere; by default, those of expanded polystyrene.
    solver : solver that computes the field. The default is the closed-form solution for open air if
        the scene has no body, and boundary elements otherwise.

    Returns
    -------
    A list of one ``Verdict`` per point. Its attribute ``is_trap`` states whether the point is a
    trap, based on the attributes ``force``, ``stiffness`` and ``holds`` (the largest load, in
    multiples of the bead's weight).

    Raises
    ------
    InvalidInput
        If the bead's centre is closer to a body, a plane or an element than the radius of the bead
        or a sixteenth of a wavelength, whichever is larger. The error is also raised if a point or
        a body is behind the face of a directional element, if elements overlap each other or a
        body, if the drive is silent or does not have as many elements as the array, or if a
        parameter is outside its range.
    NotConverged
        If the solver stops before it converges.

    Examples
    --------
    >>> import airtact as at
    >>> places = np.array([[0, -0.05, 0], [0, 0.05, 0]])
    >>> pair = at.PhasedArray(places, np.array([[0, 1, 0], [0, -1, 0]]))
    >>> drive = at.Drive(np.array([1, -1 + 0j]))
    >>> result = verdict(at.Scene(at.air()), pair, drive, np.zeros((1, 3)))[0]
    >>> result.balanced, result.stiffness.shape
    (True, (3, 3))
    """
    return judge(*solved(scene, array, drive, points, radius, density, sound_speed, solver))


def judge(
    field: RadiatedField, points: Float64[np.ndarray, "points 3"], bead: Bead
) -> list[Verdict]:
    """Return a verdict for each point, based on the first excitation of a field."""
    scene = field.scene
    sound = derivatives(field, points, bead)
    forces = force_of(sound, bead, scene)
    matrices = stiffness_of(sound, bead, scene)
    verdicts = []
    for point, pull, matrix in zip(points, forces, matrices, strict=True):
        # The pseudo-inverse ignores directions in which the force does not vary.
        shift = np.linalg.pinv(matrix, rcond=1e-6) @ pull
        holds = _largest_hold(field, point, bead) / (9.80665 * bead.mass)  # standard gravity
        # Fitted to the exact force on polystyrene in air.
        excess = 0.55 * (scene.wavenumber.real * bead.radius) ** 2
        verdicts.append(Verdict(point, pull, matrix, shift, holds, excess, scene.wavelength))
    return verdicts


def settled(field: RadiatedField, point: Float64[np.ndarray, "3"], bead: Bead) -> Verdict:
    """Judge whether a trap holds at the equilibrium near a point, or else at the point."""
    place = descend(field, point, bead)
    return judge(field, (point if np.isnan(place).any() else place)[None], bead)[0]


def _largest_hold(field: RadiatedField, point: Float64[np.ndarray, "3"], bead: Bead) -> float:
    """Return the largest restoring force [N] along the weakest of six directions; 0 if none."""
    distances = field.scene.wavelength / 4.0 * np.linspace(0.1, 1.0, 10)
    ways = np.concatenate([np.eye(3), -np.eye(3)])
    points = point + distances[:, None, None] * ways
    free = clearances(field, points.reshape(-1, 3)) >= bead.room(field.scene)
    restoring = np.zeros(len(free))
    if free.any():
        pull = force_of(derivatives(field, points.reshape(-1, 3)[free], bead), bead, field.scene)
        restoring[free] = -np.sum(pull * np.tile(ways, (10, 1))[free], axis=1)
    return max(0.0, float(restoring.reshape(10, 6).max(axis=0).min()))


def find(
    scene: Scene,
    array: PhasedArray,
    drive: Drive,
    points: Real[np.ndarray, "points 3"],
    radius: float = 0.65e-3,
    density: float = 29.36,
    sound_speed: float = 900.0,
    solver: Solver | None = None,
) -> Float64[np.ndarray, "points 3"]:
    """Find the minimum of Gor'kov's potential near each point, where a bead comes to rest.

    Newton's method descends from each point until a step is below 10 nm. The weight of the bead is
    not included: it lowers the bead by its weight divided by the vertical stiffness.

    Parameters
    ----------
    scene : the air and the bodies in it.
    array : transducers in the frame of the scene.
    drive : drive of the array, one complex amplitude per element.
    points : (P, 3) points in the scene at which the search starts [m].
    radius : radius of the bead [m], above zero and at most an eighth of a wavelength.
    density, sound_speed : density [kg/m³], 0.01 to 30,000, and speed of sound [m/s], 100 to 10,000,
        of the bead; by default, those of expanded polystyrene.
    solver : solver that computes the field. The default is the closed-form solution for open air if
        the scene has no body, and boundary elements otherwise.

    Returns
    -------
    (P, 3) positions of the minima in the scene [m]. A row is NaN if the descent moves more than
    half a wavelength away from the point, comes closer to a body, a plane or an element than the
    radius of the bead or a sixteenth of a wavelength, or does not end at a minimum.

    Raises
    ------
    InvalidInput
        If a point is in a body, behind a plane or on an element, if a point or a body is behind the
        face of a directional element, if elements overlap each other or a body, if the drive is
        silent or does not have as many elements as the array, or if a parameter is outside its
        range.
    NotConverged
        If the solver stops before it converges.
    """
    field, starts, bead = solved(scene, array, drive, points, radius, density, sound_speed, solver)
    return np.stack([descend(field, start, bead) for start in starts])


def descend(
    field: RadiatedField, start: Float64[np.ndarray, "3"], bead: Bead
) -> Float64[np.ndarray, "3"]:
    """Return the minimum of the potential near a point (3,) [m], or NaN if there is none."""
    scene = field.scene
    point = np.array(start)
    for _ in range(100):
        far = np.linalg.norm(point - start) > 0.5 * scene.wavelength
        if far or clearances(field, point[None])[0] < bead.room(scene):
            break
        sound = derivatives(field, point[None], bead)
        # With magnitudes of the curvatures, Newton's method also descends at saddles.
        curvatures, ways = np.linalg.eigh(stiffness_of(sound, bead, scene)[0])
        sizes = np.maximum(np.abs(curvatures), 1e-6 * np.abs(curvatures).max())
        step = ways @ (ways.T @ force_of(sound, bead, scene)[0] / sizes)
        length = np.linalg.norm(step)
        # Steps of a twentieth of a wavelength cannot skip a minimum.
        point += step * min(1.0, scene.wavelength / 20.0 / max(length, 1e-12))
        if length < 1e-8:
            return point if curvatures.min() > 0.0 else np.full(3, np.nan)
    return np.full(3, np.nan)
