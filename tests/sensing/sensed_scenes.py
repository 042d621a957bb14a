"""Two capsules in a box of monopoles, their scattering matrix, and poses off by some millimetres."""

from functools import cache

import numpy as np

import airtact as at

AIR = at.Medium(343.1, 1.293)
BOX = at.surrounding_box(at.monopole())
TRUE = at.Pose.turn((1, 2, 3), 0.4, (3e-3, -2e-3, 5e-3))


@cache
def capsules(gap: float = 0.013) -> at.Scene:
    first = at.capsule((-gap, 0, -5e-3), (-gap, 0, 8e-3), radius=6e-3, edge=2e-3)
    second = at.capsule((12e-3, 2e-3, -3e-3), (11e-3, -3e-3, 9e-3), radius=5e-3, edge=2e-3)
    return at.Scene(AIR, [at.sound_hard(first), at.sound_hard(second)], frequency=40e3)


@cache
def solved() -> at.sensing.ScatteringMatrix:
    return at.scattering_matrix(at.BoundaryElement(accuracy=0.03, estimate=False), capsules())


CODES = at.sensing.random_codes(996, 8, seed=2)


@cache
def measured(gap: float = 0.013) -> at.Echoes:
    """Echoes that the boundary elements make with smaller panels than the model's."""
    solver = at.BoundaryElement(accuracy=0.01, estimate=False)
    seen = BOX.seen_from(TRUE)
    return at.simulate_echoes(solver, capsules(gap), seen, CODES, noise=30.0, seed=1)


def off_by(pose: at.Pose, position: float, angle: float, seed: int) -> at.Pose:
    """Move and turn the bodies about their middle by so much [m, rad] in a random direction."""
    random = np.random.default_rng(seed)
    along, axis = (vector / np.linalg.norm(vector) for vector in random.normal(size=(2, 3)))
    centre = solved().centre
    turn = at.Pose.turn(axis, angle)
    return pose @ at.Pose(turn.rotation, centre - turn.rotation @ centre + position * along)


def errors(found: at.Pose, true: at.Pose = TRUE) -> tuple[float, float]:
    """Distance of the middle of the bodies [m] and angle [rad] between two poses."""
    centre = solved().centre[None]
    apart = float(np.linalg.norm(found.apply(centre) - true.apply(centre)))
    return apart, float(np.linalg.norm(found.rotation.T @ true.rotation - np.eye(3)) / np.sqrt(2))


def relative(found: np.ndarray, exact: np.ndarray) -> float:
    return float(np.linalg.norm(found - exact) / np.linalg.norm(exact))
