"""Random scenes of shapes that nothing was tuned on, with independent solutions.

Spheroids, tori, cups, shells, and capsules in threes and fours, 25 to 70 kHz, 1 and 3 % asked. The
pressure is read near the bodies or far from them, or the source is near and the points are far.
Truth are rings of monopoles (``references.axisymmetric``) and, for capsules, fundamental solutions.
"""

from dataclasses import dataclass

import numpy as np

import airtact as at
from airtact.geometry.primitives import Capsule
from references import axisymmetric, fundamental_solutions
from references.axisymmetric import Meridian

FAMILIES = ("spheroid", "torus", "cup", "shell", "capsules")
KINDS = ("near", "far", "focus")


@dataclass(frozen=True)
class Case:
    """One random scene with a unit source, and the points at which its pressure is read."""

    seed: int
    family: str
    kind: str
    accuracy: float
    scene: at.Scene
    bodies: list[Meridian] | list[Capsule]
    source: np.ndarray
    points: np.ndarray

    def truth(self) -> tuple[np.ndarray, float]:
        """Pressure at the points [Pa] and its own relative error."""
        wavenumber, wanted = self.scene.wavenumber, self.accuracy / 10
        if self.family == "capsules":
            pressure, own = fundamental_solutions.pressure_at(
                self.bodies, wavenumber, self.source, self.points, wanted, 2.2
            )
            return pressure[:, 0], own
        if self.kind == "focus":  # the rings want the far points as sources
            pressure, own = axisymmetric.pressure_at(
                self.bodies, wavenumber, self.points, self.source, wanted
            )
            return pressure[0], own
        pressure, own = axisymmetric.pressure_at(
            self.bodies, wavenumber, self.source, self.points, wanted
        )
        return pressure[:, 0], own


def case_of(seed: int) -> Case:
    """Make the random scene of a seed; families, kinds and accuracies take turns."""
    draw = np.random.default_rng([2015, seed])
    family, kind = FAMILIES[seed % 5], KINDS[seed // 5 % 3]
    accuracy = (0.01, 0.03)[seed // 15 % 2]
    frequency = float(draw.uniform(25e3, 70e3))
    if family == "capsules":
        bodies = _capsules(int(draw.integers(3, 5)), draw)
        surfaces = [at.capsule(*_ends(one), one.radius, edge=one.radius / 2) for one in bodies]
    else:
        bodies = [_meridian(family, draw)]
        surfaces = [axisymmetric.surface(bodies[0], min(1e-3, bodies[0].wall))]
    scene = at.Scene(
        at.Medium(sound_speed=343.1, density=1.2),
        [at.sound_hard(surface) for surface in surfaces],
        frequency=frequency,
    )
    # all three are drawn, so that the numbers of a seed do not depend on its kind
    drawn = {
        "near": (_far(draw, 1), _near(draw, scene, 20)),
        "far": (_far(draw, 1), _far(draw, 20)),
        "focus": (_near(draw, scene, 1), _far(draw, 20)),
    }
    source, points = drawn[kind]
    return Case(seed, family, kind, accuracy, scene, bodies, source, points)


def _meridian(family: str, draw: np.random.Generator) -> Meridian:
    def mm(least: float, most: float) -> float:
        return 1e-3 * float(draw.uniform(least, most))

    if family == "spheroid":
        equatorial = mm(3, 9)
        return axisymmetric.spheroid(
            equatorial, min(equatorial * float(draw.uniform(0.4, 2.5)), 14e-3)
        )
    if family == "torus":
        ring = mm(5, 10)
        return axisymmetric.torus(ring, ring * float(draw.uniform(0.2, 0.6)))
    wall = mm(1.2, 2.5)
    if family == "cup":
        return axisymmetric.cup(mm(6, 10), mm(6, 12), wall)
    return axisymmetric.shell(mm(7, 13), wall, float(draw.uniform(35, 110)))


def _capsules(count: int, draw: np.random.Generator) -> list[Capsule]:
    """Place capsules one after the other, each 1 to 4 mm from those before it."""
    placed: list[Capsule] = []
    while len(placed) < count:
        radius, length = draw.uniform(2.5e-3, 4.5e-3), draw.uniform(2e-3, 9e-3)
        axis = draw.normal(size=3)
        pose = at.Pose.turn(tuple(axis / np.linalg.norm(axis)), float(draw.uniform(0, np.pi)))
        one = Capsule(radius, length, at.Pose(pose.rotation, draw.uniform(-11e-3, 11e-3, size=3)))
        points = fundamental_solutions.surface_points(one, 400)[0]
        gaps = [-other.depth(points).max() for other in placed]
        if not gaps or 1e-3 < min(gaps) < 4e-3:
            placed.append(one)
    return placed


def _ends(capsule: Capsule) -> tuple[tuple[float, ...], tuple[float, ...]]:
    ends = capsule.pose.apply(np.array([[0, 0, -0.5], [0, 0, 0.5]]) * capsule.length)
    return tuple(ends[0]), tuple(ends[1])


def _far(draw: np.random.Generator, count: int) -> np.ndarray:
    directions = draw.normal(size=(count, 3))
    return (
        directions
        / np.linalg.norm(directions, axis=1, keepdims=True)
        * draw.uniform(0.06, 0.1, size=(count, 1))
    )


def _near(draw: np.random.Generator, scene: at.Scene, count: int) -> np.ndarray:
    """Points 0.5 to 4 mm off the surfaces, by area."""
    found: list[np.ndarray] = []
    while len(found) < count:
        surface = scene.obstacles[draw.integers(len(scene.obstacles))].surface
        corners = surface.vertices[surface.triangles[draw.integers(len(surface.triangles))]]
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        point = corners.mean(axis=0) + draw.uniform(0.5e-3, 4e-3) * normal / np.linalg.norm(normal)
        if scene.depth(point[None])[0] < -0.5e-3:
            found.append(point)
    return np.array(found)
