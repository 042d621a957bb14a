"""Known fields solved on this machine: one sphere against its series, two spheres against fundamental solutions."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128, Float64
from threadpoolctl import threadpool_info

from airtact import _kernels
from airtact.acoustics.scene import Scene, sound_hard
from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.acoustics.solvers.problem import RadiatedField
from airtact.acoustics.solvers.spherical.sphere_series import SphereSeries
from airtact.acoustics.sources import Monopoles
from airtact.benching.fundamental_solutions import pressure_at
from airtact.benching.scenes import AIR, FREQUENCY
from airtact.geometry.pose import Pose
from airtact.geometry.primitives import Capsule, sphere
from airtact.printing import in_short
from airtact.timing import Progress, no_progress

ASKED = 0.01
"""Accuracy that the check asks for."""

SOLVER = BoundaryElement(accuracy=ASKED)
"""The solver that is held against known pressures."""

REFERENCE_ERROR = 1e-3
"""Own error of the fundamental solutions, a tenth of what is asked."""

SERIES_ERROR = 1e-8
"""Error to which the series is summed."""

RADII, GAP = (8e-3, 5e-3), 3e-3
"""Radii of the two spheres and the gap between them [m]; the first is the single sphere."""

OFF = 0.5e-3
"""Distance of the sources off the first sphere [m]."""


@dataclass(frozen=True)
class KnownField:
    """How far the pressure at some points is off a known one.

    Attributes
    ----------
    name : the bodies and where the points lie.
    truth : what the pressure is compared with.
    error : norm of the difference over that of the known pressures, over all sources and points.
    own : error of the known pressures, by their own estimate.
    """

    name: str
    truth: str
    error: float
    own: float


@dataclass(frozen=True, eq=False)
class SelfCheck:
    """What was solved on this machine and how far it was off.

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
        """The fields that are farther off than asked."""
        return tuple(one for one in self.fields if not one.error <= self.asked)


def self_check(report_step: Progress = no_progress) -> SelfCheck:
    """Solve one sphere and two with the default boundary elements, near and far from their surfaces."""
    pools = [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "openmp"]
    fields = tuple(_one_sphere(report_step)) + tuple(_two_spheres(report_step))
    return SelfCheck(_kernels.active_variant(), max(pools, default=1), ASKED, fields)


def _one_sphere(report_step: Progress) -> Iterator[KnownField]:
    scene = _scene([Capsule(RADII[0], 0.0, Pose.identity())])
    sources = Monopoles(_directions(8, 1) * (RADII[0] + OFF), np.eye(8))
    report_step("solving one sphere")
    field = SOLVER.radiate(scene, sources)
    series = SphereSeries().radiate(scene, sources)
    for where, points in (
        ("100 mm away", 0.1 * _directions(40, 2)),
        ("2 mm off the surface", _directions(40, 3) * (RADII[0] + 2e-3)),
    ):
        yield _compared(
            f"one sphere, {where}", "sphere series", field, points, series.at(points), SERIES_ERROR
        )


def _two_spheres(report_step: Progress) -> Iterator[KnownField]:
    middle = np.array([sum(RADII) + GAP, 0.0, 0.0])
    shapes = [
        Capsule(RADII[0], 0.0, Pose.identity()),
        Capsule(RADII[1], 0.0, Pose(np.eye(3), middle)),
    ]
    scene = _scene(shapes)
    away = 0.1 * _directions(24, 4)
    between = np.array([RADII[0] + GAP / 2, 0.0, 0.0]) + np.linspace(-5e-3, 5e-3, 9)[:, None] * [
        0.0,
        0.6,
        0.8,
    ]
    report_step("solving two spheres by fundamental solutions")
    known, own = pressure_at(shapes, scene.wavenumber, away, between, REFERENCE_ERROR)
    report_step("solving two spheres")
    truth = "fundamental solutions"
    field = SOLVER.radiate(scene, Monopoles(away, np.eye(len(away))))
    yield _compared("two spheres, between them", truth, field, between, known, own)
    field = SOLVER.radiate(scene, Monopoles(between, np.eye(len(between))))
    yield _compared("two spheres, 100 mm away", truth, field, away, known.T, own)


def _compared(
    name: str,
    truth: str,
    field: RadiatedField,
    points: Float64[np.ndarray, "points 3"],
    known: Complex128[np.ndarray, "points sources"],
    own: float,
) -> KnownField:
    return KnownField(
        name, truth, float(np.linalg.norm(field.at(points) - known) / np.linalg.norm(known)), own
    )


def _scene(shapes: list[Capsule]) -> Scene:
    surfaces = [sphere(shape.radius, shape.radius / 2).moved(shape.pose) for shape in shapes]
    return Scene(AIR, [sound_hard(surface) for surface in surfaces], frequency=FREQUENCY)


def _directions(count: int, seed: int) -> Float64[np.ndarray, "count 3"]:
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
