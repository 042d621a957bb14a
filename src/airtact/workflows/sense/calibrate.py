"""From transmissions of an empty array to where its boards are and what its elements are worth. Prints nothing."""

from pathlib import Path

import numpy as np

from airtact.acoustics.medium import Medium
from airtact.checks import check_seed
from airtact.errors import InvalidInput, NotConverged
from airtact.files.atomic import writable_folder
from airtact.sensing.calibration_fit import moved
from airtact.sensing.echoes import Echoes, load_echoes
from airtact.sensing.self_calibration import Calibrated, calibrate
from airtact.sensing.simulation import hadamard_codes
from airtact.sensing.transmission import boards_of, simulate_transmissions
from airtact.setup.building import read_scene
from airtact.timing import Clock, Progress, no_progress
from airtact.transducers.layout import PhasedArray, join

SPREAD = 5e-4, 5e-3
"""Standard deviations of each coordinate [m] and angle [rad] of the boards of a simulated array."""

GAINS = 0.1, 0.2
"""Standard deviations of log magnitude and phase [rad] of the gains of its elements."""

SLOWER = 1.0
"""Standard deviation of its sound speed [m/s]."""


def calibrate_array(
    echoes_file: Path | None,
    scene_file: Path,
    noise: float | None,
    seed: int,
    out: Path,
    report_step: Progress = no_progress,
) -> tuple[Calibrated, tuple[float, float] | None]:
    """Calibrate the array of a scene file by measured transmissions, or by simulated ones with some noise [dB].

    Returns
    -------
    What was found, and for simulated transmissions how far the worst board is off the truth [m], and the sound speed
    [m/s].

    Raises
    ------
    InvalidInput
        A file is at fault, not exactly one kind of transmissions is given, or as ``calibrate``.
    NotConverged
        "pose_not_found": no positions of the boards explain the transmissions.
    """
    if (echoes_file is None) == (noise is None):
        raise InvalidInput(
            "give 1 of 2: a file of transmissions, or --simulate.", code="data_missing"
        )
    clock = Clock(report_step)
    with clock.step("scene", f"reading {scene_file.name}"):
        setup = read_scene(scene_file)
        writable_folder(out.parent)
    medium, array = setup.scene.medium, setup.array
    true = None
    if echoes_file is not None:
        echoes = load_echoes(echoes_file)
    else:
        with clock.step(
            "transmissions", "simulating transmissions of an array that is a little off"
        ):
            true = _off(array, medium, seed)
            echoes = _simulated(*true, setup.scene.frequency, noise, seed)
    with clock.step("calibrate", "fitting boards, gains and sound speed"):
        found = calibrate(echoes, array, medium)
    if not found.converged:
        raise NotConverged(
            f"no positions of the boards near those of {scene_file.name} explain the transmissions: the best leave "
            f"{found.misfit:.2g} of them unexplained beyond noise. Something stands between the boards, direct sound "
            "was subtracted, the codes or the order of the elements differ, or the boards are more than 2 mm off.",
            code="pose_not_found",
        )
    found.save(out)
    return found, None if true is None else _errors(found, *true)


def _off(array: PhasedArray, medium: Medium, seed: int) -> tuple[PhasedArray, Medium]:
    """Return an array and air that are a little off those believed, at random."""
    check_seed(seed)
    random, boards = np.random.default_rng([seed, 2]), boards_of(array)
    motions = random.normal(size=(len(boards), 6)) * np.repeat(SPREAD, 3)
    motions[0] = 0.0
    logarithm = random.normal(size=(2, len(array))) * np.array(GAINS)[:, None]
    true = join([moved(*pair) for pair in zip(boards, motions, strict=True)])
    speed = medium.sound_speed + SLOWER * random.normal()
    return true.calibrated(np.exp(logarithm[0] + 1j * logarithm[1])), Medium(
        speed, medium.density, medium.absorption
    )


def _simulated(
    array: PhasedArray, medium: Medium, frequency: float, noise: float | None, seed: int
) -> Echoes:
    codes = hadamard_codes(len(array))
    return simulate_transmissions(array, medium, codes, frequency=frequency, noise=noise, seed=seed)


def _errors(found: Calibrated, array: PhasedArray, medium: Medium) -> tuple[float, float]:
    middles = [
        np.stack([board.positions.mean(axis=0) for board in boards_of(one)])
        for one in (found.array, array)
    ]
    return float(np.linalg.norm(middles[0] - middles[1], axis=1).max()), abs(
        found.sound_speed - medium.sound_speed
    )
