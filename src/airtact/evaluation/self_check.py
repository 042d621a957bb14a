"""Errors of the solver on this machine for the known fields around one and two spheres."""

from dataclasses import dataclass
from pathlib import Path

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
from airtact.geometry.pose import Pose
from airtact.geometry.primitives import sphere
from airtact.timing import Progress, no_progress

# The solver to check; no error may exceed its accuracy.
SOLVER = BoundaryElement(accuracy=0.01)


@dataclass(frozen=True)
class KnownField:
    """Difference between a solved pressure and a reference.

    Attributes
    ----------
    name : description of the bodies and of the location of the points.
    truth : method by which the reference was computed.
    error : norm of the difference over all sources and points, relative to the reference.
    reference_error : estimated error of the reference.
    """

    name: str
    truth: str
    error: float
    reference_error: float


@dataclass(frozen=True, eq=False)
class SelfCheck:
    """Result of a self-check: errors of the boundary-element solver on this machine.

    Attributes
    ----------
    instructions : instruction set of the compiled loops.
    threads : number of threads of the compiled loops.
    asked : requested accuracy of the solver.
    fields : comparisons with known fields, in the order in which they were solved.
    """

    instructions: str
    threads: int
    asked: float
    fields: tuple[KnownField, ...]

    @property
    def failed(self) -> tuple[KnownField, ...]:
        """The comparisons whose error is NaN or exceeds the requested accuracy of the solver."""
        return tuple(field for field in self.fields if not field.error <= self.asked)


def self_check(report_step: Progress = no_progress) -> SelfCheck:
    """Compare solutions for one and two spheres with references, near and far from the spheres."""
    report_step("solving one sphere")
    air = Medium(sound_speed=343.1, density=1.293)
    first = sound_hard(sphere(8e-3, 4e-3))
    # Sources near the surface excite many orders of the series.
    sources = Monopoles(8.5e-3 * _directions(8, 1), np.eye(8))
    field = SOLVER.radiate(Scene(air, [first], frequency=40e3), sources)
    series = SphereSeries().radiate(field.scene, sources)
    away = 0.1 * _directions(40, 2)
    close = 10e-3 * _directions(40, 3)
    exact = "sphere series"
    fields = [
        KnownField("one sphere, 100 mm away", exact, _error(field, away, series.at(away)), 1e-8),
        KnownField(
            "one sphere, 2 mm from the surface", exact, _error(field, close, series.at(close)), 1e-8
        ),
    ]

    report_step("solving two spheres")
    second = sound_hard(sphere(5e-3, 2.5e-3).moved(Pose.shift(np.array([16e-3, 0.0, 0.0]))))
    scene = Scene(air, [first, second], frequency=40e3)
    # The reference was solved by ``references/fundamental_solutions.py``, which shares no code with
    # the solver. Its points are across the middle of the gap and 100 mm away. By reciprocity,
    # either set can serve as the sources.
    with np.load(Path(__file__).with_name("two_spheres.npz")) as stored:
        away, between, pressure, error = (
            stored[name] for name in ("away", "between", "pressure", "error")
        )
    for name, points, senders, truth in (
        ("two spheres, between them", between, away, pressure),
        ("two spheres, 100 mm away", away, between, pressure.T),
    ):
        field = SOLVER.radiate(scene, Monopoles(senders, np.eye(len(senders))))
        fields.append(
            KnownField(name, "fundamental solutions", _error(field, points, truth), float(error))
        )
    pools = [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "openmp"]
    return SelfCheck(_kernels.active_variant(), max(pools, default=1), 0.01, tuple(fields))


def _error(
    field: RadiatedField,
    points: Float64[np.ndarray, "points 3"],
    truth: Complex128[np.ndarray, "points sources"],
) -> float:
    return float(np.linalg.norm(field.at(points) - truth) / np.linalg.norm(truth))


def _directions(count: int, seed: int) -> Float64[np.ndarray, "count 3"]:
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
