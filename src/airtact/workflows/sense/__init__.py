"""From a scene file and echoes to where the hand is, and what knowing it brings. Prints nothing."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from airtact.conventions import InvalidInput, NotConverged
from airtact.file_access.atomic import whole_file, writable_folder
from airtact.pose import Pose
from airtact.scene_file.building import Setup, read_scene
from airtact.sensing.codes import random_codes
from airtact.sensing.echoes import Echoes, load_echoes
from airtact.sensing.registration import Located, locate
from airtact.sensing.scattering import ScatteringMatrix, scattering_matrix
from airtact.sensing.simulation import simulate_echoes
from airtact.solvers.bem.solver import BoundaryElement
from airtact.solvers.problem import RadiatedField
from airtact.solvers.spherical.multipole_field import multipole_expansion
from airtact.steps import stored, synthesise
from airtact.timing import Clock, Progress, no_progress
from airtact.transfer import transfer_matrix
from airtact.validation import between, check_seed

FILES = ("pose.json", "echoes.h5")
"""What sensing writes; the second only where echoes were simulated."""

MODEL = BoundaryElement(accuracy=0.02, estimate=False)
TRUTH = BoundaryElement(accuracy=0.01, estimate=False)
"""Solvers of the scattering matrix and, with other panels, of simulated echoes."""

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
    """

    noise: float
    position: float = 2e-3
    degrees: float = 3.0
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Sensed:
    """Where the hand is, relative to the scene file, and the pressures of the weakest focus there [Pa].

    Attributes
    ----------
    located : its pose maps the obstacles' frame of the scene file to where they are, in the same frame.
    off : distance of the middle of the bodies from the scene file's [m], and angle of the turn [rad].
    error : the same from the simulated truth; None for measured echoes.
    uncorrected, corrected : weakest focus with the drive for the scene file's pose, and for the one found [Pa].
    """

    located: Located
    echoes: Echoes
    off: tuple[float, float]
    error: tuple[float, float] | None
    uncorrected: float
    corrected: float


def sense(
    scene_file: Path,
    echoes_file: Path | None,
    simulation: Simulation | None,
    folder: Path,
    report_step: Progress = no_progress,
    store: Path | None = None,
) -> Sensed:
    """Locate the hand of a scene file by measured or simulated echoes, and compare the drives for both poses.

    The pose of the scene file is the start. ``FILES`` go into the folder, which is made if it is not there.

    Raises
    ------
    InvalidInput
        A file or the folder is at fault, not exactly one kind of echoes is given, or as ``locate``.
    NotConverged
        "pose_not_found": no pose near that of the scene file explains the echoes.
    """
    if (echoes_file is None) == (simulation is None):
        raise InvalidInput("give 1 of 2: a file of echoes, or the noise of simulated ones.", code="echoes_missing")
    clock = Clock(report_step)
    with clock.step("scene", f"reading {scene_file.name}"):
        setup = read_scene(scene_file)
        writable_folder(folder)
    with clock.step("scattering", "solving the bodies for spherical waves"):
        scattering = scattering_matrix(stored(MODEL, store), setup.scene)
    true = None if simulation is None else _off(scattering, simulation)
    if echoes_file is not None:
        echoes = load_echoes(echoes_file)
    else:
        assert simulation is not None
        with clock.step("echoes", f"simulating echoes of {TRANSMISSIONS} codes by smaller panels"):
            codes, seen = random_codes(len(setup.array), TRANSMISSIONS), setup.array.seen_from(true or Pose.identity())
            echoes = simulate_echoes(TRUTH, setup.scene, seen, codes, noise=simulation.noise, seed=simulation.seed)
        echoes.save(folder / FILES[1])
    with clock.step("locate", "fitting the pose to the echoes"):
        located = locate(echoes, setup.scene, setup.array, Pose.identity(), scattering=scattering)
    if not located.converged:
        raise NotConverged(
            f"no pose near that of {scene_file.name} explains the echoes: the best one leaves {located.misfit:.2g} of "
            "them unexplained beyond noise. The hand is another one than the scene's, or more than 5 mm away.",
            code="pose_not_found",
        )
    with clock.step("drives", "making the drives for both poses"):
        beacons = multipole_expansion(stored(setup.solver, store).radiate(setup.scene, setup.target.beacons(True)))
        pressures = [_weakest(setup, beacons, pose, true or located.pose) for pose in (Pose.identity(), located.pose)]
    _write(folder / FILES[0], located)
    error = None if true is None else _apart(scattering, located.pose, true)
    off = _apart(scattering, located.pose, Pose.identity())
    return Sensed(located, echoes, off, error, pressures[0], pressures[1])


def _off(scattering: ScatteringMatrix, simulation: Simulation) -> Pose:
    """Move the hand about its middle as far as is simulated."""
    position = between(simulation.position, 0.0, 0.05, "the offset", "m", "is it in millimetres? Give metres.")
    degrees = between(simulation.degrees, 0.0, 45.0, "the turn", "degrees", "the scene's pose is better than that.")
    check_seed(simulation.seed)
    random = np.random.default_rng([simulation.seed, 1])
    along, axis = (vector / np.linalg.norm(vector) for vector in random.normal(size=(2, 3)))
    turn = Pose.turn(axis, np.radians(degrees))
    return Pose(turn.rotation, scattering.centre - turn.rotation @ scattering.centre + position * along)


def _apart(scattering: ScatteringMatrix, one: Pose, other: Pose) -> tuple[float, float]:
    """Distance of the middle of the bodies [m] and angle between two poses [rad]."""
    centre = scattering.centre[None]
    sine = np.linalg.norm(one.rotation.T @ other.rotation - np.eye(3)) / np.sqrt(8.0)
    return float(np.linalg.norm(one.apply(centre) - other.apply(centre))), 2 * float(np.arcsin(min(sine, 1.0)))


def _weakest(setup: Setup, beacons: RadiatedField, believed: Pose, true: Pose) -> float:
    """Pressure of the weakest focus when the drive is made for one pose and the hand has another [Pa]."""
    made, _ = synthesise(setup.synthesise, transfer_matrix(beacons, setup.array.seen_from(believed)), setup.target)
    there = transfer_matrix(beacons, setup.array.seen_from(true))
    return float(np.abs(there.pressure(made)[: len(setup.target.points)]).min())


def _write(path: Path, located: Located) -> None:
    """Write what was found as JSON, in metres and radians."""
    found = {
        "format_version": 1,
        "rotation": np.asarray(located.pose.rotation).tolist(),
        "translation": np.asarray(located.pose.translation).tolist(),
        "centre": located.centre.tolist(),
        "covariance": located.covariance.tolist(),
        "residual": located.residual,
        "misfit": located.misfit,
        "left_out": located.left_out.tolist(),
    }
    with whole_file(path) as partial:
        partial.write_text(json.dumps(found, indent=1), encoding="utf-8")
