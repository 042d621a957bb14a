"""From a scene file and echoes to where the hand is, and what knowing it brings. Prints nothing."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.acoustics.solvers.problem import RadiatedField, Solver
from airtact.acoustics.solvers.spherical.multipole_field import multipole_expansion
from airtact.checks import between, check_seed
from airtact.drives.transfer import TransferMatrix, transfer_matrix
from airtact.errors import InvalidInput, NotConverged
from airtact.files.atomic import whole_file, writable_folder
from airtact.geometry.pose import Pose
from airtact.reports.sense_page import Sensed, write_sense_page
from airtact.sensing.echoes import Echoes, load_echoes
from airtact.sensing.registration import Located, locate, unexplained
from airtact.sensing.scattering import (
    ScatteringFamily,
    ScatteringMatrix,
    scattering_family,
    scattering_matrix,
)
from airtact.sensing.simulation import random_codes, simulate_echoes
from airtact.setup import tables
from airtact.setup.building import read_scene
from airtact.setup.parsing import parse_scene
from airtact.setup.setup import Setup
from airtact.setup.solving import stored, synthesise
from airtact.timing import Clock, Progress, no_progress

FILES = ("pose.json", "report.html", "echoes.h5")
"""What sensing writes; the last only where echoes were simulated."""

MODEL = BoundaryElement(accuracy=0.02, estimate=False)
TRUTH = BoundaryElement(accuracy=0.01, estimate=False)
"""Solvers of the scattering matrix and, with other panels, of simulated echoes."""

SPREAD, NARROWEST = 2e-3, 5e-4
"""How much wider and narrower the gap of fingers may be than in the scene file, and the least gap sought [m]."""

TRANSMISSIONS = 16
"""Codes of random phases that are simulated."""


@dataclass(frozen=True, eq=False)
class Simulation:
    """Echoes of a hand that is off the pose of the scene file, in a random direction.

    Attributes
    ----------
    noise : rms of the echoes over that of the noise [dB].
    position, degrees : how far the hand is off and turned [m, degree].
    seed : of noise and directions.
    opened : how much wider the gap of fingers is than in the scene file, where that has a pinch
        [m].
    """

    noise: float
    position: float = 2e-3
    degrees: float = 3.0
    seed: int = 0
    opened: float = 5e-4


def sense(
    scene_file: Path,
    echoes_file: Path | None,
    simulation: Simulation | None,
    folder: Path,
    report_step: Progress = no_progress,
    store: Path | None = None,
    pictures: bool = True,
) -> Sensed:
    """Locate the hand of a scene file by measured or simulated echoes, and compare the drives for both poses.

    The pose of the scene file is the start. Where the body is a pinch, its gap is found, too.
    ``FILES`` go into the folder, which is made if it is not there; without ``pictures`` there is no
    page.

    Raises
    ------
    InvalidInput
        A file or the folder is at fault, not exactly one kind of echoes is given, or as ``locate``.
    NotConverged
        "pose_not_found": no pose near that of the scene file explains the echoes.
    """
    if (echoes_file is None) == (simulation is None):
        raise InvalidInput(
            "give 1 of 2: a file of echoes (--echoes FILE), or --simulate.", code="data_missing"
        )
    clock = Clock(report_step)
    with clock.step("scene", f"reading {scene_file.name}"):
        setup = read_scene(scene_file)
        writable_folder(folder)
    for name in FILES[:2]:  # an older run's must not stand beside this run's echoes
        (folder / name).unlink(missing_ok=True)
    gap = _gap_of(setup)
    with clock.step("scattering", "solving the bodies for spherical waves"):
        model = _model(scene_file, setup, gap, stored(MODEL, store).reporting(report_step))
    scattering = model if isinstance(model, ScatteringMatrix) else model.at(model.start)
    true = None if simulation is None else _off(scattering, simulation)
    true_gap = None if simulation is None else _opened(gap, simulation)
    really = setup if true_gap is None else _with_gap(scene_file, true_gap)
    echoes = _received(echoes_file, simulation, really, true, clock)
    if simulation is not None:
        echoes.save(folder / FILES[2])
    with clock.step("locate", "fitting the pose to the echoes"):
        located = _located(echoes, setup, model)
    _check_found(located, model, scene_file)
    with clock.step("drives", "making the drives for both poses"):
        opening = located.opening
        found = setup if opening is None else _with_gap(scene_file, opening)
        pairs = (setup, Pose.identity()), (found, located.pose)
        before, after = _brought(
            pairs, (found, located.pose) if true is None else (really, true), store
        )
    with clock.step("residual", "comparing echoes at each receiver"):
        left = _unexplained(echoes, setup, model, located)
    _write(folder / FILES[0], located)
    known = gap, true_gap, clock.seconds
    sensed = Sensed(
        setup, found, located, echoes, true, scattering.centre, before, after, left, *known
    )
    if pictures:
        report_step("drawing the report")
        write_sense_page(folder / FILES[1], sensed)
    return sensed


def _received(
    echoes_file: Path | None,
    simulation: Simulation | None,
    setup: Setup,
    true: Pose | None,
    clock: Clock,
) -> Echoes:
    """Read echoes, or simulate what the array receives of codes of random phases."""
    if simulation is None:
        assert echoes_file is not None  # one of both is given
        return load_echoes(echoes_file)
    with clock.step("echoes", f"simulating echoes of {TRANSMISSIONS} codes by smaller panels"):
        codes, seen = (
            random_codes(len(setup.array), TRANSMISSIONS),
            setup.array.seen_from(true or Pose.identity()),
        )
        return simulate_echoes(
            TRUTH, setup.scene, seen, codes, noise=simulation.noise, seed=simulation.seed
        )


def _located(
    echoes: Echoes,
    setup: Setup,
    model: ScatteringMatrix | ScatteringFamily,
) -> Located:
    if isinstance(model, ScatteringFamily):
        return locate(echoes, model, setup.array, Pose.identity())
    return locate(echoes, setup.scene, setup.array, Pose.identity(), scattering=model)


def _unexplained(
    echoes: Echoes, setup: Setup, model: ScatteringMatrix | ScatteringFamily, located: Located
) -> Float64[np.ndarray, "2 receivers"]:
    """Return what the scene file's pose and the one found leave at each receiver, over the rms of all echoes."""
    if isinstance(model, ScatteringMatrix):
        matrices = model, model
    else:
        assert located.opening is not None  # that of a family is found
        matrices = model.at(model.start), model.at(located.opening)
    poses = Pose.identity(), located.pose
    return np.stack(
        [
            unexplained(echoes, one, setup.array, pose)
            for one, pose in zip(matrices, poses, strict=True)
        ]
    )


def _gap_of(setup: Setup) -> float | None:
    """Return the gap of the only body that is a pinch [m]."""
    bodies = [one.body for one in parse_scene(setup.text).obstacles]
    gaps = [body.gap for body in bodies if isinstance(body, tables.PinchTable)]
    return gaps[0] if len(gaps) == 1 else None


def _with_gap(scene_file: Path, gap: float) -> Setup:
    return read_scene(scene_file, {"pinch.gap": gap})


def _model(
    scene_file: Path, setup: Setup, gap: float | None, solver: Solver
) -> ScatteringMatrix | ScatteringFamily:
    """Solve the bodies for spherical waves, at several gaps where they have one."""
    if gap is None:
        return scattering_matrix(solver, setup.scene)

    def opened(value: float) -> Scene:
        return _with_gap(scene_file, value).scene

    return scattering_family(
        solver, opened, max(gap - SPREAD, min(NARROWEST, 0.5 * gap)), gap + SPREAD, start=gap
    )


def _opened(gap: float | None, simulation: Simulation) -> float | None:
    """Return the gap of the simulated pinch [m]."""
    opened = between(
        simulation.opened, -SPREAD, SPREAD, "the opening", "m", "is it in millimetres? Give metres."
    )
    return None if gap is None else max(gap + opened, 0.25 * gap)


def _check_found(
    located: Located, model: ScatteringMatrix | ScatteringFamily, scene_file: Path
) -> None:
    """Raise "pose_not_found" where a pose is not to be believed."""
    if located.converged:
        return
    words = "or more than 5 mm away"
    if isinstance(model, ScatteringFamily):
        words += f", or its gap is not between {1e3 * model.low:.3g} and {1e3 * model.high:.3g} mm"
    raise NotConverged(
        f"no pose near that of {scene_file.name} explains the echoes: the best one leaves {located.misfit:.2g} of "
        f"them unexplained beyond noise. The hand is another one than the scene's, {words}.",
        code="pose_not_found",
    )


def _off(scattering: ScatteringMatrix, simulation: Simulation) -> Pose:
    """Move the hand about its middle as far as is simulated."""
    position = between(
        simulation.position, 0.0, 0.05, "the offset", "m", "is it in millimetres? Give metres."
    )
    degrees = between(
        simulation.degrees,
        0.0,
        45.0,
        "the turn",
        "degrees",
        "the scene's pose is better than that.",
    )
    check_seed(simulation.seed)
    random = np.random.default_rng([simulation.seed, 1])
    along, axis = (vector / np.linalg.norm(vector) for vector in random.normal(size=(2, 3)))
    turn = Pose.turn(axis, np.radians(degrees))
    return Pose(
        turn.rotation, scattering.centre - turn.rotation @ scattering.centre + position * along
    )


def _waves(setup: Setup, store: Path | None) -> RadiatedField:
    """Solve for the foci of a scene, for any pose of its hand."""
    return multipole_expansion(
        stored(setup.solver, store).radiate(setup.scene, setup.target.beacons(True))
    )


def _transfer(solved: Callable[[Setup], RadiatedField], setup: Setup, pose: Pose) -> TransferMatrix:
    """Return the transfer matrix of a hand that has a pose relative to the scene file's."""
    return transfer_matrix(solved(setup), setup.array.seen_from(pose))


def _brought(
    pairs: tuple[tuple[Setup, Pose], ...], there: tuple[Setup, Pose], store: Path | None
) -> list[Float64[np.ndarray, "foci"]]:
    """Return the pressures of the foci of the hand that is there, of the drives for hands and their poses [Pa]."""
    solved = cache(partial(_waves, store=store))  # all are one scene where there is no gap
    matrix = _transfer(solved, *there)
    return [_pressures(matrix, one, _transfer(solved, one, pose)) for one, pose in pairs]


def _pressures(
    there: TransferMatrix, setup: Setup, believed: TransferMatrix
) -> Float64[np.ndarray, "foci"]:
    """Pressures of the foci where the hand is, of the drive made for where it is believed to be [Pa]."""
    made, _ = synthesise(setup.synthesise, believed, setup.target)
    return np.abs(there.pressure(made)[: len(setup.target.points)])


def _write(path: Path, located: Located) -> None:
    """Write what was found as JSON, in metres and radians."""
    found = {
        "format_version": 1,
        "rotation": np.asarray(located.pose.rotation).tolist(),
        "translation": np.asarray(located.pose.translation).tolist(),
        "centre": located.centre.tolist(),
        "opening": located.opening,
        "covariance": located.covariance.tolist(),
        "residual": located.residual,
        "misfit": located.misfit,
        "left_out": located.left_out.tolist(),
    }
    with whole_file(path) as partial:
        partial.write_text(json.dumps(found, indent=1), encoding="utf-8")
