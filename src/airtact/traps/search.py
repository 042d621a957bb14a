"""Positions of traps, and the verdict on whether a point is a trap."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Real

from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.problem import RadiatedField, Solver
from airtact.drives.drive import Drive
from airtact.errors import in_mm, millimetres, one_line
from airtact.transducers.layout import PhasedArray
from airtact.traps.gorkov import (
    Bead,
    clearances,
    derivatives,
    force_of,
    solved,
    stiffness_of,
)


@dataclass(frozen=True, eq=False)
class Verdict:
    """Verdict on whether a point traps a bead, with the values on which it is based.

    Attributes
    ----------
    point : (3,) position of the centre of the bead [m].
    force : (3,) radiation force at the point [N].
    stiffness : (3, 3) stiffness matrix [N/m].
    shift : (3,) vector from the point to the equilibrium [m], estimated from force and
        stiffness.
    holds : ratio of the holding force to the weight of the bead. The holding force is the largest
        restoring force within a quarter of a wavelength of the point, along the weakest of the six
        directions ±x, ±y and ±z.
    excess : relative amount by which Gor'kov's potential overestimates force and stiffness for this
        bead.
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
    """Judge for each point whether it traps a bead; see ``force`` for the arguments.

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
    """Return the verdict on the equilibrium nearest to a point, or on the point if it has none."""
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
        sound = derivatives(field, points.reshape(-1, 3)[free], bead)
        pull = force_of(sound, bead, field.scene)
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
    """Return the position (P, 3) [m] of the potential's minimum near each of P points.

    The function takes the same arguments as ``force``. A row is NaN if there is no minimum within
    half a wavelength of the point. The weight of the bead is not included: it lowers the bead by
    its weight divided by the stiffness.
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
