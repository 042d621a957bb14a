"""The same scene solved by airtact and by other packages, each in an interpreter of its own, each with its error."""

import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
from jaxtyping import Complex128, Real

from airtact.benching.flat_mesh import flat_triangles, points_inside
from airtact.benching.scenes import Bodies
from airtact.benching.timing import Timed, relative_error
from airtact.conventions import InvalidInput
from airtact.printing import in_short

SCRIPTS = Path(__file__).parent / "peers"

ACCURACIES = (0.1, 0.05, 0.03, 0.02, 0.01, 0.005)
"""That ours is asked for, from coarse to fine."""

EDGES = {"AcousTools": (3.6e-3, 2.5e-3, 1.77e-3), "bempp-cl": (2.7e-3, 2.0e-3, 1.5e-3)}
"""Edges of the triangles of the two fingers that others are given [m]: 1000, 2000 and 4000; 1800, 3300 and 5900."""

NO_ESTIMATE = ", no estimate"
"""What ours is called where it solves for the transfer matrix alone, as bempp-cl does."""

CHIEF_POINTS = 20
"""Points inside each finger for AcousTools, which does not converge without."""


@dataclass(frozen=True, eq=False)
class Answer:
    """What a script answers.

    Attributes
    ----------
    matrix : (F, E) pressure of unit monopoles.
    seconds : of each run.
    peak : memory above what the process held after a small run [byte].
    unknowns : of its system.
    version : the package and its version.
    """

    matrix: Complex128[np.ndarray, "foci elements"]
    seconds: tuple[float, ...]
    peak: int
    unknowns: int
    version: str

    __repr__ = in_short


@dataclass(frozen=True)
class Solved:
    """One package's answer to one case.

    Attributes
    ----------
    package : with its version.
    setting : accuracy or number of triangles.
    unknowns : of its system.
    timed : from bodies in memory to the transfer matrix.
    error : of the worse focus against the truth.
    peak : memory above what the process held after a small run [byte].
    """

    package: str
    setting: str
    unknowns: int
    timed: Timed
    error: float
    peak: int


def run_case(
    script: str, python: str, case: dict[str, Real[np.ndarray, "..."] | float | int], limit: float = 3600.0
) -> Answer:
    """Let an interpreter run one of the scripts on a case.

    Parameters
    ----------
    script : "airtact", "acoustools" or "bempp".
    python : the interpreter.
    case : what the script reads.
    limit : how long it may take [s].

    Returns
    -------
    What it answered.

    Raises
    ------
    InvalidInput
        It did not run to its end; with the last line that it wrote.
    """
    with tempfile.TemporaryDirectory() as folder:
        files = [str(Path(folder) / name) for name in ("case.npz", "answer.npz")]
        np.savez(files[0], **case)  # pyright: ignore[reportArgumentType]
        call = [python, "-W", "ignore", str(SCRIPTS / f"{script}_script.py"), *files]
        try:
            done = subprocess.run(call, capture_output=True, text=True, timeout=limit)
        except OSError as error:
            raise InvalidInput(f"{python} cannot be run: {error.strerror}.") from None
        except subprocess.TimeoutExpired:
            raise InvalidInput(f"{python} did not finish {script}_script.py within {limit:.0f} s.") from None
        if done.returncode != 0:
            last = (done.stderr.strip().splitlines() or ["nothing was said"])[-1]
            raise InvalidInput(f"{python} ended {script}_script.py with code {done.returncode}: {last}")
        with np.load(files[1]) as answer:
            seconds = tuple(float(one) for one in answer["seconds"])
            numbers = int(answer["peak"]), int(answer["unknowns"]), str(answer["version"])
            return Answer(answer["matrix"].astype(np.complex128), seconds, *numbers)


def ours(
    bodies: Bodies,
    elements: Real[np.ndarray, "elements 3"],
    truth: Complex128[np.ndarray, "foci elements"],
    runs: int,
    accuracies: Sequence[float] = ACCURACIES,
    report_step: Callable[[str], None] = lambda step: None,
) -> list[Solved]:
    """Solve with airtact at several accuracies, with its estimate and without, each in a process of its own.

    Parameters
    ----------
    bodies : capsules and foci.
    elements : (E, 3) where it is heard [m].
    truth : (F, E) pressure of unit monopoles.
    runs : timed at each accuracy.
    accuracies : to ask for.
    tell : is told each step.
    """
    found = []
    for estimate, accuracy in product((True, False), accuracies):
        report_step(f"airtact at {accuracy:.1%}" + ("" if estimate else NO_ESTIMATE))
        case = {
            **_shared(bodies, elements, runs),
            "axes": np.array([one.axis for one in bodies.capsules]),
            "radii": np.array([one.radius for one in bodies.capsules]),
            "sound_speed": bodies.scene.medium.sound_speed,
            "frequency": bodies.scene.frequency,
            "accuracy": accuracy,
            "estimate": estimate,
        }
        solved = _solved(run_case("airtact", sys.executable, case), f"{accuracy:.1%} asked", truth)
        found.append(solved if estimate else replace(solved, package=solved.package + NO_ESTIMATE))
    return found


def theirs(
    package: str,
    python: str,
    bodies: Bodies,
    elements: Real[np.ndarray, "elements 3"],
    truth: Complex128[np.ndarray, "foci elements"],
    runs: int,
    edges: Sequence[float],
    report_step: Callable[[str], None] = lambda step: None,
) -> list[Solved]:
    """Solve with another package on meshes of several sizes, each in a process of its own.

    Parameters
    ----------
    package : "AcousTools" or "bempp-cl".
    python : interpreter of an environment that has it.
    bodies, elements, truth, runs, tell : as for ``ours``.
    edges : of the triangles [m].
    """
    script, kind = {"AcousTools": ("acoustools", np.int64), "bempp-cl": ("bempp", np.uint32)}[package]
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
        found.append(_solved(run_case(script, python, case), f"{len(triangles)} triangles", truth))
    return found


def faster(mine: Sequence[Solved], other: Solved) -> tuple[float, Solved] | None:
    """Say how many times quicker the quickest of ours is that is at least as right; None where none is.

    Parameters
    ----------
    mine : our runs.
    other : one of theirs.
    """
    right = [one for one in mine if one.error <= other.error]
    if not right:
        return None
    best = min(right, key=lambda one: one.timed.median)
    return other.timed.median / best.timed.median, best


def _shared(
    bodies: Bodies, elements: Real[np.ndarray, "elements 3"], runs: int
) -> dict[str, Real[np.ndarray, "..."] | float | int]:
    return {"foci": bodies.foci, "elements": np.asarray(elements), "runs": runs}


def _solved(answer: Answer, setting: str, truth: Complex128[np.ndarray, "foci elements"]) -> Solved:
    error = relative_error(answer.matrix, truth)
    return Solved(answer.version, setting, answer.unknowns, Timed(answer.seconds), error, answer.peak)
