"""The same scene solved by airtact and by other packages, each in an interpreter of its own, with its error."""

import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
from jaxtyping import Complex128, Float64, Int64, Real

from airtact.errors import InvalidInput, in_short
from airtact.geometry.mesh.triangles import cone_volumes
from airtact.geometry.primitives import Capsule
from airtact.hands.body import Hulls
from airtact.hands.skin_mesh import even_skin
from airtact.timing import Progress, no_progress
from benchmarks.common import Bodies, Timed, relative_error

Case = dict[str, Real[np.ndarray, "..."] | float | int]
"""What a script reads, by name."""

SCRIPTS = Path(__file__).parent / "peers"

ACCURACIES = (0.1, 0.05, 0.03, 0.02, 0.01, 0.005)
"""Accuracies of the runs of airtact, from coarse to fine."""

EDGES = {"AcousTools": (3.6e-3, 2.5e-3, 1.77e-3), "bempp-cl": (2.7e-3, 2.0e-3, 1.5e-3)}
"""Edges of the triangles for other packages [m]: 1000, 2000 and 4000 triangles; 1800, 3300 and 5900."""

NO_ESTIMATE = ", no estimate"
"""Suffix of the runs of airtact without the estimate of the error, which bempp-cl does not make either."""

CHIEF_POINTS = 20
"""Points inside each finger for AcousTools, which does not converge without them."""

INSIDE = 0.25, 0.8
"""Depth of the points inside, as fractions of the radius."""


@dataclass(frozen=True, eq=False)
class Answer:
    """The result of a script: pressure of unit monopoles, seconds of each run, unknowns, package with its version.

    The peak is the memory above what the process held after a small run [byte].
    """

    matrix: Complex128[np.ndarray, "foci elements"]
    seconds: tuple[float, ...]
    peak: int
    unknowns: int
    version: str

    __repr__ = in_short


@dataclass(frozen=True)
class Solved:
    """The result of a package (with its version) for one case; the setting is its accuracy or number of triangles.

    It is timed from bodies in memory to the transfer matrix; the error is that of the worse focus
    against the reference, the peak as in ``Answer``.
    """

    package: str
    setting: str
    unknowns: int
    timed: Timed
    error: float
    peak: int


def run_case(script: str, python: str, case: Case, limit: float = 3600.0) -> Answer:
    """Run the script "airtact", "acoustools" or "bempp" on a case by an interpreter, ended after ``limit`` seconds.

    Raises ``InvalidInput`` where the script failed or took too long.
    """
    with tempfile.TemporaryDirectory() as folder:
        files = [str(Path(folder) / name) for name in ("case.npz", "answer.npz")]
        np.savez(files[0], **case)  # pyright: ignore[reportArgumentType]
        call = [python, "-W", "ignore", str(SCRIPTS / f"{script}_script.py"), *files]
        try:
            done = subprocess.run(call, capture_output=True, text=True, timeout=limit)
        except OSError as error:
            raise InvalidInput(
                f"{python} cannot be run: {error.strerror}.", code="not_supported"
            ) from None
        except subprocess.TimeoutExpired:
            words = f"{python} did not finish {script}_script.py within {limit:.0f} s."
            raise InvalidInput(words, code="file_too_large") from None
        if done.returncode != 0:
            last = (done.stderr.strip().splitlines() or ["no message"])[-1]
            words = f"{python} ended {script}_script.py with code {done.returncode}: {last}"
            raise InvalidInput(words, code="child_failed")
        with np.load(files[1]) as answer:
            seconds = tuple(answer["seconds"].tolist())
            numbers = int(answer["peak"]), int(answer["unknowns"]), str(answer["version"])
            return Answer(answer["matrix"].astype(np.complex128), seconds, *numbers)


def ours(
    bodies: Bodies,
    elements: Real[np.ndarray, "elements 3"],
    reference: Complex128[np.ndarray, "foci elements"],
    runs: int,
    accuracies: Sequence[float] = ACCURACIES,
    report_step: Progress = no_progress,
) -> list[Solved]:
    """Solve with airtact at several accuracies, with its estimate and without, each in a process of its own."""
    found = []
    for estimate, accuracy in product((True, False), accuracies):
        report_step(f"airtact at {accuracy:.1%}" + ("" if estimate else NO_ESTIMATE))
        case = case_of(bodies, elements, runs, accuracy, estimate)
        solved = _solved(
            run_case("airtact", sys.executable, case), f"{accuracy:.1%} asked", reference
        )
        found.append(solved if estimate else replace(solved, package=solved.package + NO_ESTIMATE))
    return found


def theirs(
    package: str,
    python: str,
    bodies: Bodies,
    elements: Real[np.ndarray, "elements 3"],
    reference: Complex128[np.ndarray, "foci elements"],
    runs: int,
    edges: Sequence[float],
    report_step: Progress = no_progress,
) -> list[Solved]:
    """Solve with another package on meshes of several sizes, each in a process of its own."""
    script, kind = {"AcousTools": ("acoustools", np.int64), "bempp-cl": ("bempp", np.uint32)}[
        package
    ]
    small, found = flat_triangles(bodies, 6e-3), []
    for edge in edges:
        vertices, triangles = flat_triangles(bodies, edge)
        report_step(f"{package} on {len(triangles)} triangles")
        case = {
            **_shared(bodies, elements, runs),
            "wavenumber": bodies.scene.wavenumber.real,
            "vertices": vertices,
            "triangles": triangles.astype(kind),
            "warm_vertices": small[0],
            "warm_triangles": small[1].astype(kind),
            "inside": points_inside(bodies, CHIEF_POINTS),
        }
        found.append(
            _solved(run_case(script, python, case), f"{len(triangles)} triangles", reference)
        )
    return found


def faster(mine: Sequence[Solved], other: Solved) -> tuple[float, Solved] | None:
    """Return how many times faster our fastest run of equal or smaller error is, and that run; None without one."""
    accurate = [one for one in mine if one.error <= other.error]
    if not accurate:
        return None
    best = min(accurate, key=lambda one: one.timed.median)
    return other.timed.median / best.timed.median, best


def case_of(
    bodies: Bodies,
    elements: Real[np.ndarray, "elements 3"],
    runs: int,
    accuracy: float,
    estimate: bool,
) -> Case:
    """Return a case for the script that runs airtact; with 0 runs it measures the memory only."""
    axes, radii = (
        np.array([getattr(one, of) for one in bodies.capsules]) for of in ("axis", "radius")
    )
    air = {"sound_speed": bodies.scene.medium.sound_speed, "frequency": bodies.scene.frequency}
    ask = {"accuracy": accuracy, "estimate": estimate}
    return {**_shared(bodies, elements, runs), **air, **ask, "axes": axes, "radii": radii}


def _shared(bodies: Bodies, elements: Real[np.ndarray, "elements 3"], runs: int) -> Case:
    return {"foci": bodies.foci, "elements": np.asarray(elements), "runs": runs}


def _solved(
    answer: Answer, setting: str, reference: Complex128[np.ndarray, "foci elements"]
) -> Solved:
    error = relative_error(answer.matrix, reference)
    return Solved(
        answer.version, setting, answer.unknowns, Timed(answer.seconds), error, answer.peak
    )


def flat_triangles(
    bodies: Bodies, edge: float
) -> tuple[Float64[np.ndarray, "vertices 3"], Int64[np.ndarray, "t 3"]]:
    """Cover capsules with even flat triangles of a given edge [m], closed, outward, that hold the exact volume."""
    capsules = bodies.capsules
    balls = np.array([[*end, capsule.radius] for capsule in capsules for end in capsule.axis])
    parts = np.array([[2 * index, 2 * index + 1, -1] for index in range(len(capsules))])
    count = len(capsules)
    skin = even_skin(Hulls(balls, parts, np.zeros((count, count)), 1.0 - np.eye(count)), edge)
    vertices, triangles = np.array(skin.vertices), skin.triangles.astype(np.int64)
    owner = np.argmax([capsule.depth(vertices) for capsule in capsules], axis=0)
    for index, capsule in enumerate(capsules):
        own = triangles[owner[triangles[:, 0]] == index]
        axis = nearest_on_axis(capsule, vertices)
        out, stretch = vertices - axis, 1.0
        for _ in range(20):
            held = float(cone_volumes((axis + stretch * out)[own]).sum())
            stretch *= (
                capsule.volume / held
            ) ** 0.4  # the volume grows between the first and the third power
        vertices[owner == index] = (axis + stretch * out)[owner == index]
    return vertices, triangles


def nearest_on_axis(
    capsule: Capsule, points: Float64[np.ndarray, "points 3"]
) -> Float64[np.ndarray, "points 3"]:
    """Find the point of a capsule's axis that is nearest to each point (P, 3) [m]."""
    start, along = capsule.axis[0], capsule.axis[1] - capsule.axis[0]
    share = np.clip((points - start) @ along / max(float(along @ along), 1e-30), 0.0, 1.0)
    return start + share[:, None] * along


def points_inside(bodies: Bodies, count: int, seed: int = 0) -> Float64[np.ndarray, "points 3"]:
    """Choose points inside capsules at random, ``count`` in each, for CHIEF."""
    pick, found = np.random.default_rng(seed), []
    for capsule in bodies.capsules:
        reach = 0.5 * capsule.extent
        some = capsule.axis.mean(axis=0) + pick.uniform(-reach, reach, size=(400 * count, 3))
        depth = capsule.depth(some) / capsule.radius
        found.append(some[(INSIDE[0] < depth) & (depth < INSIDE[1])][:count])
    return np.concatenate(found)
