"""Scenes, times, errors and kept references that the benchmarks share."""

import hashlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from jaxtyping import Complex128, Float64, Num, Real

from airtact.acoustics.medium import Medium
from airtact.acoustics.scene import Scene, sound_hard
from airtact.acoustics.target import Target
from airtact.errors import in_short
from airtact.geometry.pose import Pose
from airtact.geometry.primitives import Capsule, capsule
from airtact.geometry.surface import Surface
from references.fundamental_solutions import pressure_at

AIR = Medium(sound_speed=343.1, density=1.293)
"""The paper's air."""

FREQUENCY = 40e3
OFFSET = 0.5e-3
"""Distance of each focus off its pad [m]."""


@dataclass(frozen=True, eq=False)
class Bodies:
    """The surfaces of bodies, and foci (F, 3) beside them [m]."""

    surfaces: tuple[Surface, ...]
    foci: Float64[np.ndarray, "foci 3"]

    __repr__ = in_short

    @property
    def scene(self) -> Scene:
        """The bodies, sound-hard, in the paper's air."""
        return Scene(AIR, [sound_hard(surface) for surface in self.surfaces], frequency=FREQUENCY)

    @property
    def target(self) -> Target:
        """The foci, as strong as possible."""
        return Target(self.foci)

    @property
    def capsules(self) -> list[Capsule]:
        """The bodies' exact shapes, where all of them are capsules."""
        return [
            surface.primitive for surface in self.surfaces if isinstance(surface.primitive, Capsule)
        ]


def two_fingers(
    gap: float = 12e-3,
    tilt: float = 20.0,
    radius: float = 8e-3,
    length: float = 44e-3,
    lift: float = 0.0,
) -> Bodies:
    """Two capsules whose tips face each other, hanging down and leaning outward, a focus in front of each pad.

    By default they are 16 mm thick, 60 mm long and 12 mm apart. Gap, radius, length of the axis and
    ``lift`` of the second above the first are in metres, ``tilt`` in degrees.
    """
    surfaces, tips = [], []
    lean = np.radians(tilt)
    for side in (-1.0, 1.0):
        tip = np.array([side * (0.5 * gap + radius), 0.0, 0.5 * (1.0 + side) * lift])
        root = tip + length * np.array([side * np.sin(lean), 0.0, -np.cos(lean)])
        surfaces.append(capsule(tuple(tip), tuple(root), radius, edge=radius / 2))
        tips.append(tip)
    across = (tips[1] - tips[0]) / np.linalg.norm(tips[1] - tips[0])
    foci = np.array([tips[0] + (radius + OFFSET) * across, tips[1] - (radius + OFFSET) * across])
    return Bodies(tuple(surfaces), foci)


def deformed(frame: int) -> Bodies:
    """Two fingers that are different bodies at every frame: thickness, length, lean, gap and height all change."""
    beat = np.sin(0.9 * frame + np.arange(5.0)) - np.sin(np.arange(5.0))
    return two_fingers(
        gap=12e-3 + 1.5e-3 * beat[0],
        tilt=20.0 + 5.0 * beat[1],
        radius=8e-3 + 0.1e-3 * beat[2],
        length=44e-3 + 0.3e-3 * beat[3],
        lift=1e-3 * beat[4],
    )


def moved_each(rest: Bodies, frame: int) -> Bodies:
    """Move each of two bodies rigidly, its focus with it, by a few millimetres and degrees."""
    beat = np.sin(0.9 * frame + np.arange(6.0)) - np.sin(np.arange(6.0))
    moved, foci = [], []
    for side, surface, focus in zip((-1.0, 1.0), rest.surfaces, rest.foci, strict=True):
        pose = rotated_about(
            focus, np.radians(4.0) * beat[:3] * side, 0.6e-3 * (side + 0.5) * beat[3:]
        )
        moved.append(surface.moved(pose))
        foci.append(pose.apply(focus[None])[0])
    return Bodies(tuple(moved), np.array(foci))


def whole_motion(frame: int) -> Pose:
    """Move a hand as a whole: 20 degrees and 10 mm about."""
    beat = np.sin(0.7 * frame + np.arange(6.0)) - np.sin(np.arange(6.0))
    return rotated_about(
        np.zeros(3), np.radians(20.0) * beat[:3] / np.sqrt(3.0), 10e-3 * beat[3:] / np.sqrt(3.0)
    )


def rotated_about(
    centre: Real[np.ndarray, "3"], turn: Real[np.ndarray, "3"], shift: Real[np.ndarray, "3"]
) -> Pose:
    """Rotate about a centre [m] by a rotation vector [rad], then shift [m]."""
    angle = float(np.linalg.norm(turn))
    if angle == 0.0:
        return Pose(np.eye(3), np.asarray(shift, dtype=np.float64))
    rotation = Pose.turn(turn / angle, angle).rotation
    return Pose(rotation, centre - rotation @ centre + shift)


def moved_foci(bodies: Bodies, frame: int) -> Bodies:
    """Give the same bodies other foci: each before its finger, some millimetres to the side and off its surface."""
    beat = np.sin(1.3 * frame + np.arange(6.0)).reshape(2, 3)
    foci = (
        bodies.foci
        + 1.5e-3 * beat * np.array([0.0, 1.0, 1.0])
        + np.array([[1.0], [-1.0]]) * [1e-3, 0.0, 0.0]
    )
    return Bodies(bodies.surfaces, foci)


Result = TypeVar("Result")


@dataclass(frozen=True)
class Timed:
    """Wall times of the runs of one job, in order [s], and the processor time of all its threads where it was taken."""

    seconds: tuple[float, ...]
    processor: tuple[float, ...] = ()

    @property
    def median(self) -> float:
        """The middle one [s]."""
        return float(np.median(self.seconds))

    def __str__(self) -> str:
        unit, scale = ("s", 1.0) if self.median >= 1.0 else ("ms", 1e3)
        values = (min(self.seconds), self.median, max(self.seconds))
        low, middle, high = (_three_digits(scale * value) for value in values)
        taken = (
            f"; processor {_three_digits(scale * float(np.median(self.processor)))}"
            if self.processor
            else ""
        )
        return f"{middle} {unit} ({low} to {high}{taken})"


REST = 0.1
"""Seconds after which the idle threads of a matrix product no longer spin and disturb ours."""


AWAKE = 0.05
"""Seconds of work after which a processor that rested is as quick as before."""


def timed(jobs: Sequence[Callable[[], Result]]) -> tuple[Timed, list[Result]]:
    """Run the first job until the processor is warm, then time the others; return their times and what each gave."""
    jobs[0]()
    time.sleep(REST)
    woken = time.perf_counter()
    while time.perf_counter() - woken < AWAKE:
        jobs[0]()
    seconds, processor, results = [], [], []
    for job in jobs[1:]:
        began = time.perf_counter(), time.process_time()
        results.append(job())
        seconds.append(time.perf_counter() - began[0])
        processor.append(time.process_time() - began[1])
    return Timed(tuple(seconds), tuple(processor)), results


def relative_error(
    found: Complex128[np.ndarray, "foci elements"], true: Complex128[np.ndarray, "foci elements"]
) -> float:
    """Error of the worst row, relative to its norm."""
    return float(np.max(np.linalg.norm(found - true, axis=1) / np.linalg.norm(true, axis=1)))


def correlation(
    found: Complex128[np.ndarray, "elements"], true: Complex128[np.ndarray, "elements"]
) -> float:
    """How alike two drives are but for one factor: 1 is the same."""
    return float(np.abs(np.vdot(found, true)) / (np.linalg.norm(found) * np.linalg.norm(true)))


def _three_digits(value: float) -> str:
    """Write three digits that count, in plain figures.

    >>> _three_digits(1234.5), _three_digits(23.456), _three_digits(0.45678)
    ('1234', '23.5', '0.457')
    """
    return f"{value:.{max(0, 2 - int(np.floor(np.log10(max(value, 1e-9)))))}f}"


@dataclass(frozen=True, eq=False)
class Reference:
    """Reference pressure [Pa], for bodies without a closed form, and its estimated relative error."""

    pressure: Complex128[np.ndarray, "points excitations"]
    own_error: float

    __repr__ = in_short


def reference_pressure(
    bodies: Bodies,
    sources: Real[np.ndarray, "sources 3"],
    points: Real[np.ndarray, "points 3"],
    folder: Path,
) -> Reference:
    """Return the pressure of unit monopoles beside capsules, read from ``folder`` if it is there.

    The sources are far from the surfaces, the points anywhere outside [m].
    """
    wavenumber, capsules = bodies.scene.wavenumber, bodies.capsules
    settings = str([(c.radius, c.length, wavenumber, 3.0) for c in capsules])
    poses = [part for one in capsules for part in (one.pose.rotation, one.pose.translation)]
    return cached_reference(
        folder,
        settings,
        (*poses, sources, points),
        lambda: Reference(*pressure_at(capsules, wavenumber, sources, points)),
    )


def cached_reference(
    folder: Path,
    settings: str,
    arrays: Sequence[Num[np.ndarray, "..."]],
    compute: Callable[[], Reference],
) -> Reference:
    """Read a reference from a folder, or compute and write it; its file is named by its settings and arrays."""
    digest = hashlib.sha256(settings.encode())
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    file = folder / f"reference-{digest.hexdigest()[:16]}.npz"
    if not file.exists():
        made = compute()
        folder.mkdir(parents=True, exist_ok=True)
        np.savez(file, pressure=made.pressure, own_error=made.own_error)
    with np.load(file) as cached:
        return Reference(cached["pressure"], float(cached["own_error"]))
