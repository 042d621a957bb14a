"""The estimated error against the true one, in random scenes of shapes that nothing was tuned on.

Spheroids, tori, cups, shells, and capsules in threes and fours, 25 to 70 kHz, 1 and 3 % asked. The
source is far and the points are near the bodies or far from them, or the source is near and the
points far. Truth are rings of monopoles (``references.axisymmetric``) and, for capsules,
fundamental solutions.

    python -m benchmarks.estimate [scenes [first]]
"""

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

import airtact as at
from airtact.evaluation import fundamental_solutions
from airtact.geometry.primitives import Capsule
from references import axisymmetric
from references.axisymmetric import Meridian

FAMILIES = ("spheroid", "torus", "cup", "shell", "capsules")
KINDS = ("near", "far", "focus")
"""Where the pressure is read: near the bodies, far from them; or the source is near and the points are far."""

HELD, SHARE = (0.3, 10.0), 0.95
"""Estimated over true error, and the share of the scenes that must keep it."""

LOUD = 2.0
"""True error over the accuracy asked above which there must be a warning."""

AIR = at.Medium(sound_speed=343.1, density=1.2)


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


@dataclass(frozen=True)
class Row:
    """What a solve said about its error and what it was."""

    case: Case
    true: float
    estimated: float
    own: float
    warned: bool
    seconds: float

    @property
    def ratio(self) -> float:
        """Estimated over true error."""
        return self.estimated / self.true

    @property
    def sure(self) -> bool:
        """Whether the truth is true enough to say."""
        return self.own < 0.3 * max(self.true, 0.3 * self.case.accuracy)

    @property
    def held(self) -> bool:
        """Whether the ratio is as wanted; errors far under the accuracy asked may be overestimated."""
        least, most = HELD
        return least <= self.ratio <= most or (
            self.ratio > most and self.estimated < self.case.accuracy
        )

    @property
    def quiet(self) -> bool:
        """Whether the error is over twice what was asked and nothing was said."""
        return self.true > LOUD * self.case.accuracy and not self.warned

    def __str__(self) -> str:
        """Write the row in one line."""
        case = self.case
        marks = "".join(
            mark
            for mark, on in (
                ("  NOT HELD", not self.held),
                ("  QUIET", self.quiet),
                ("  unsure", not self.sure),
            )
            if on
        )
        found = f"{100 * self.true:7.3f} % off, {100 * self.estimated:7.3f} % estimated, ratio {self.ratio:6.2f}"
        return (
            f"{case.seed:4} {case.family:9} {case.kind:6} {case.scene.frequency / 1e3:5.1f} kHz, "
            f"{100 * case.accuracy:g} % asked: {found}, truth {100 * self.own:.1g} % off, {self.seconds:.1f} s{marks}"
        )


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
    scene = at.Scene(AIR, [at.sound_hard(surface) for surface in surfaces], frequency=frequency)
    far, near = partial(_far, draw), partial(_near, draw, scene)
    source, points = {
        "near": (far(1), near(20)),
        "far": (far(1), far(20)),
        "focus": (near(1), far(20)),
    }[kind]
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


def row_of(case: Case) -> Row:
    """Solve a case and hold its estimate against the truth."""
    begun = time.perf_counter()
    field = at.BoundaryElement(accuracy=case.accuracy).radiate(
        case.scene, at.Monopoles(case.source, np.ones(1))
    )
    report = field.report_at(case.points)
    estimated = float(field.error_at(case.points)[0])
    seconds = time.perf_counter() - begun
    true, own = case.truth()
    error = float(np.linalg.norm(field.at(case.points)[:, 0] - true) / np.linalg.norm(true))
    return Row(case, error, estimated, own, bool(report.warnings), seconds)


def rows(count: int, first: int = 0) -> Iterator[Row]:
    """Hold scenes one by one."""
    for seed in range(first, first + count):
        yield row_of(case_of(seed))


def summary(held: list[Row]) -> str:
    """Say in a line how many estimates held."""
    sure = [row for row in held if row.sure]
    ratios = np.array([row.ratio for row in sure])
    least, most = np.quantile(ratios, [0.025, 0.975])
    return (
        f"{len(sure)} of {len(held)} scenes with a sure truth: estimated over true error {least:.2f} to {most:.2f} in "
        f"95 %, {np.median(ratios):.2f} in the median; {sum(row.held for row in sure) / len(sure):.1%} held "
        f"({SHARE:.0%} asked), {sum(row.quiet for row in sure)} quiet over twice the accuracy asked, "
        f"{sum(row.true > row.case.accuracy for row in sure)} over what was asked"
    )


if __name__ == "__main__":
    found = []
    for row in rows(*(int(argument) for argument in sys.argv[1:] or ["200"])):
        print(row, flush=True)
        found.append(row)
    print(summary(found))
