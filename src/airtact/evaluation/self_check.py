"""Errors of the solver on this machine for known fields of one sphere and of two."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128, Float64
from threadpoolctl import threadpool_info

from airtact import _kernels
from airtact.acoustics.medium import Medium
from airtact.acoustics.scene import Scene, sound_hard
from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.acoustics.solvers.problem import RadiatedField
from airtact.acoustics.solvers.spherical.sphere_series import SphereSeries
from airtact.acoustics.sources import Monopoles
from airtact.evaluation.fundamental_solutions import pressure_at
from airtact.geometry.pose import Pose
from airtact.geometry.primitives import Capsule, sphere
from airtact.printing import in_short
from airtact.timing import Progress, no_progress

ASKED = 0.01
"""Relative error that the self-check allows."""

SOLVER = BoundaryElement(accuracy=ASKED)
"""The solver that is checked."""


@dataclass(frozen=True)
class KnownField:
    """Difference between a solved pressure and a reference.

    Attributes
    ----------
    name : the bodies and where the points lie.
    truth : the reference.
    error : norm of the difference over that of the reference, over all sources and points.
    own : estimated error of the reference.
    """

    name: str
    truth: str
    error: float
    own: float


@dataclass(frozen=True, eq=False)
class SelfCheck:
    """Errors of the solver on this machine.

    Attributes
    ----------
    instructions : name of the compiled loops' instruction set in use.
    threads : threads that the loops run on.
    asked : accuracy that the solver was asked for.
    fields : known fields, in the order in which they were solved.
    """

    instructions: str
    threads: int
    asked: float
    fields: tuple[KnownField, ...]

    __repr__ = in_short

    @property
    def failed(self) -> tuple[KnownField, ...]:
        """The fields whose error is larger than asked, or NaN."""
        return tuple(field for field in self.fields if not field.error <= self.asked)


def self_check(report_step: Progress = no_progress) -> SelfCheck:
    """Solve one sphere and two with boundary elements, near and far from their surfaces."""
    pools = [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "openmp"]
    fields = tuple(_one_sphere(report_step)) + tuple(_two_spheres(report_step))
    return SelfCheck(_kernels.active_variant(), max(pools, default=1), ASKED, fields)


def spheres() -> list[Capsule]:
    """Two spheres of 8 mm and 5 mm radius with a gap of 3 mm, as capsules of length 0."""
    beside = Pose(np.eye(3), np.array([16e-3, 0.0, 0.0]))
    return [Capsule(8e-3, 0.0, Pose.identity()), Capsule(5e-3, 0.0, beside)]


def _one_sphere(report_step: Progress) -> Iterator[KnownField]:
    ball = spheres()[0]
    scene = _scene([ball])
    sources = Monopoles(_directions(8, 1) * (ball.radius + 0.5e-3), np.eye(8))
    report_step("solving one sphere")
    field = SOLVER.radiate(scene, sources)
    series = SphereSeries().radiate(scene, sources)
    probes = {
        "100 mm away": 0.1 * _directions(40, 2),
        "2 mm off the surface": _directions(40, 3) * (ball.radius + 2e-3),
    }
    for where, points in probes.items():
        error = _relative_error(field, points, series.at(points))
        yield KnownField(f"one sphere, {where}", "sphere series", error, own=1e-8)


def _two_spheres(report_step: Progress) -> Iterator[KnownField]:
    shapes = spheres()
    scene = _scene(shapes)
    away = 0.1 * _directions(24, 4)
    along = np.linspace(-5e-3, 5e-3, 9)[:, None] * [0.0, 0.6, 0.8]
    between = np.array([9.5e-3, 0.0, 0.0]) + along  # across the middle of the gap
    report_step("solving two spheres by fundamental solutions")
    known, own = pressure_at(shapes, scene.wavenumber, away, between, wanted=0.1 * ASKED)
    report_step("solving two spheres")
    truth = "fundamental solutions"
    field = SOLVER.radiate(scene, Monopoles(away, np.eye(len(away))))
    error = _relative_error(field, between, known)
    yield KnownField("two spheres, between them", truth, error, own)
    field = SOLVER.radiate(scene, Monopoles(between, np.eye(len(between))))
    yield KnownField("two spheres, 100 mm away", truth, _relative_error(field, away, known.T), own)


def _relative_error(
    field: RadiatedField,
    points: Float64[np.ndarray, "points 3"],
    known: Complex128[np.ndarray, "points sources"],
) -> float:
    return float(np.linalg.norm(field.at(points) - known) / np.linalg.norm(known))


def _scene(shapes: list[Capsule]) -> Scene:
    surfaces = [sphere(shape.radius, shape.radius / 2).moved(shape.pose) for shape in shapes]
    air = Medium(sound_speed=343.1, density=1.293)
    return Scene(air, [sound_hard(surface) for surface in surfaces], frequency=40e3)


def _directions(count: int, seed: int) -> Float64[np.ndarray, "count 3"]:
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
