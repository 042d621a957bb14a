"""Locate the hand of a scene file from echoes; calibrate its array from echoes or scans."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from airtact.acoustics.medium import Medium
from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.acoustics.solvers.problem import RadiatedField
from airtact.acoustics.solvers.spherical.multipole_field import multipole_expansion
from airtact.drives.drive import Drive, quantise
from airtact.drives.drive_file import read_drive_file
from airtact.drives.transfer import TransferMatrix, transfer_matrix
from airtact.errors import InvalidInput, NotConverged
from airtact.evaluation.scan import Microphone, load_scan
from airtact.evaluation.scan_calibration import ScanCalibration, calibrate_from_scans
from airtact.geometry.pose import Pose
from airtact.sensing.echoes import Echoes, load_echoes
from airtact.sensing.registration import Located, locate, unexplained
from airtact.sensing.scattering import (
    ScatteringFamily,
    scattering_family,
    scattering_matrix,
)
from airtact.sensing.self_calibration import Calibrated, calibrate, moved
from airtact.sensing.transmission import (
    boards_of,
    hadamard_codes,
    random_codes,
    simulate_echoes,
    simulate_transmissions,
)
from airtact.setup.building import read_scene
from airtact.setup.parsing import parse_scene
from airtact.setup.setup import Setup
from airtact.setup.solving import emitted_drive, stored, synthesise
from airtact.timing import Clock, Progress, no_progress
from airtact.transducers.layout import PhasedArray, join

# Largest difference of a pinch's gap from that in the scene file [m]
GAP_RANGE = 2e-3


@dataclass(frozen=True, eq=False)
class Simulation:
    """A simulated hand, displaced in a random direction from the pose in the scene file.

    Attributes
    ----------
    noise : signal-to-noise ratio of the echoes [dB].
    position : distance by which the hand is displaced [m].
    degrees : angle by which the hand is rotated [°].
    seed : seed for the random noise and directions.
    opened : amount by which the gap of the simulated pinch exceeds the gap in the scene file [m].
    """

    noise: float
    position: float = 2e-3
    degrees: float = 3.0
    seed: int = 0
    opened: float = 5e-4


@dataclass(frozen=True, eq=False)
class Sensed:
    """Shift of the hand from its pose in the scene file, and the effect of correcting the drive.

    Attributes
    ----------
    setup, fitted : the setup of the scene file, and the same setup with the estimated
        gap.
    located : estimated pose and its uncertainty. The pose moves the obstacles from their position
        in the scene file to the estimated position.
    echoes : the echoes from which the pose was estimated.
    shifts : (1 or 2, 6) translation of the bodies' centre [m] and rotation [rad] of the estimated
        pose. The first row is relative to the pose in the scene file; for simulated echoes, a
        second row is relative to the true pose.
    before, after : (F,) pressure at each focus on the actual hand [Pa]: before, with the drive for
        the pose in the scene file, and after, with the drive for the estimated pose.
    unexplained : (2, R) rms residual divided by the rms echo at each of R receivers. The first row
        is for the pose in the scene file, the second row for the estimated pose.
    gap, true_gap : gap of the pinch in the scene file, and of the simulated pinch [m]. Both are
        None if the scene has no pinch; ``true_gap`` is also None for measured echoes. The estimated
        gap is ``located.opening``.
    seconds : wall time of each step [s].
    """

    setup: Setup
    fitted: Setup
    located: Located
    echoes: Echoes
    shifts: Float64[np.ndarray, "references 6"]
    before: Float64[np.ndarray, "foci"]
    after: Float64[np.ndarray, "foci"]
    unexplained: Float64[np.ndarray, "2 receivers"]
    gap: float | None
    true_gap: float | None
    seconds: Mapping[str, float]

    @property
    def sizes(self) -> list[tuple[float, float]]:
        """Distance [m] and angle of rotation [rad] for each row of ``shifts``."""
        norms = np.linalg.norm(self.shifts.reshape(-1, 2, 3), axis=2)
        return [(float(distance), float(angle)) for distance, angle in norms]

    def record(self) -> dict[str, Any]:
        """Return a dict for JSON with the pose, its uncertainty and the pressures, in SI units."""
        located = self.located
        return {
            "rotation": located.pose.rotation.tolist(),
            "translation": located.pose.translation.tolist(),
            "centre": located.centre.tolist(),
            "covariance": located.covariance.tolist(),
            "off": list(self.sizes[0]),
            "error": list(self.sizes[1]) if len(self.sizes) > 1 else None,
            "opening": located.opening,
            "true_gap": self.true_gap,
            "residual": located.residual,
            "misfit": located.misfit,
            "left_out": located.left_out.tolist(),
            "uncorrected": float(self.before.min()),
            "corrected": float(self.after.min()),
        }


def sense(
    setup: Setup,
    echoes: Echoes | Simulation,
    progress: Progress = no_progress,
    store: Path | None = None,
) -> Sensed:
    """Estimate a hand's pose from echoes, and compare drives for the assumed and estimated pose.

    The search starts from the pose in the scene file. For a pinch, the gap is fitted as well.

    Parameters
    ----------
    setup : setup that was read from a scene file.
    echoes : measured echoes, or a description of the hand to simulate.
    progress : function called with a description of each step as it begins.
    store : folder in which solved fields are stored and reused.

    Returns
    -------
    A ``Sensed`` with the estimated pose, and the pressures before and after correcting the drive.

    Raises
    ------
    NotConverged
        If no pose near the one in the scene file explains the echoes.
    """
    clock = Clock(progress)
    gaps = [
        table.pinch.gap for table in parse_scene(setup.text).obstacles if table.pinch is not None
    ]
    gap = gaps[0] if len(gaps) == 1 else None  # gaps of more than one pinch cannot be fitted
    with clock.step("scattering", "solving the bodies for spherical waves"):
        solver = stored(BoundaryElement(accuracy=0.02, estimate=False), store).reporting(progress)
        if gap is None:
            model = scattering_matrix(solver, setup.scene)
            scattering = model
        else:

            def opened(value: float) -> Scene:
                return _with_gap(setup, value).scene

            # Touching fingers scatter as one body, so the smallest gap of the family is larger.
            narrowest = max(gap - GAP_RANGE, min(5e-4, 0.5 * gap))
            model = scattering_family(solver, opened, narrowest, gap + GAP_RANGE, start=gap)
            scattering = model.at(model.start)
    # The simulation uses smaller panels than the model. Otherwise both would share their errors,
    # and the fit would seem too accurate.
    true = None
    true_gap = None
    actual_setup = setup
    if isinstance(echoes, Simulation):
        random = np.random.default_rng([echoes.seed, 1])
        along, axis = (vector / np.linalg.norm(vector) for vector in random.normal(size=(2, 3)))
        turn = Pose.turn(axis, np.radians(echoes.degrees)).rotation
        centre = scattering.centre
        true = Pose(turn, centre - turn @ centre + echoes.position * along)
        if gap is not None:
            true_gap = max(gap + echoes.opened, 0.25 * gap)
            actual_setup = _with_gap(setup, true_gap)
        with clock.step("echoes", "simulating echoes of 16 codes with smaller panels"):
            echoes = simulate_echoes(
                BoundaryElement(accuracy=0.01, estimate=False),
                actual_setup.scene,
                setup.array.seen_from(true),
                random_codes(len(setup.array), 16),
                noise=echoes.noise,
                seed=echoes.seed,
            )
    with clock.step("locate", "fitting the pose to the echoes"):
        located = (
            locate(echoes, model, setup.array, Pose.identity())
            if isinstance(model, ScatteringFamily)
            else locate(echoes, setup.scene, setup.array, Pose.identity(), scattering=model)
        )
    if not located.converged:
        reach = (
            f", or its gap is not between {1e3 * model.low:.3g} and {1e3 * model.high:.3g} mm"
            if isinstance(model, ScatteringFamily)
            else ""
        )
        raise NotConverged(
            f"no pose near that of the scene {setup.title} explains the echoes: the best pose "
            f"leaves {located.misfit:.2g} of the echoes unexplained beyond the noise. The hand "
            f"differs from the hand in the scene, or is more than 5 mm away{reach}.",
            code="pose_not_found",
        )
    fitted = setup if located.opening is None else _with_gap(setup, located.opening)
    with clock.step("drives", "computing the drives for both poses"):

        @cache  # without a gap, both setups have the same scene
        def waves(setup: Setup) -> RadiatedField:
            return multipole_expansion(
                stored(setup.solver, store).radiate(
                    setup.scene, setup.target.beacons(suppression=True)
                )
            )

        def transfer(setup: Setup, pose: Pose) -> TransferMatrix:
            return transfer_matrix(waves(setup), setup.array.seen_from(pose))

        # If there is no simulated true pose, use the estimated one.
        actual = transfer(fitted, located.pose) if true is None else transfer(actual_setup, true)

        def pressures(setup: Setup, pose: Pose) -> Float64[np.ndarray, "foci"]:
            drive, _ = synthesise(setup.synthesise, transfer(setup, pose), setup.target)
            return np.abs(actual.pressure(drive)[: len(setup.target.points)])

        before = pressures(setup, Pose.identity())
        after = pressures(fitted, located.pose)
    with clock.step("residual", "comparing echoes at each receiver"):
        final = scattering
        if isinstance(model, ScatteringFamily):
            assert located.opening is not None  # because it was fitted with a family
            final = model.at(located.opening)
        left = np.stack(
            [
                unexplained(echoes, scattering, setup.array, Pose.identity()),
                unexplained(echoes, final, setup.array, located.pose),
            ]
        )
    # Shifts refer to the centre of the bodies; about the origin, a rotation would add a shift.
    centre = scattering.centre[None]
    pose = located.pose
    shifts = []
    for reference in [Pose.identity()] if true is None else [Pose.identity(), true]:
        turn = Rotation.from_matrix(pose.rotation @ reference.rotation.T).as_rotvec()
        shifts.append([*(pose.apply(centre) - reference.apply(centre))[0], *turn])
    return Sensed(
        setup=setup,
        fitted=fitted,
        located=located,
        echoes=echoes,
        shifts=np.array(shifts),
        before=before,
        after=after,
        unexplained=left,
        gap=gap,
        true_gap=true_gap,
        seconds=clock.seconds,
    )


def _with_gap(setup: Setup, gap: float) -> Setup:
    assert setup.path is not None
    return read_scene(setup.path, {"pinch.gap": gap})


def calibrate_array(
    setup: Setup,
    echoes_file: Path | None,
    noise: float | None,
    seed: int,
    progress: Progress = no_progress,
) -> tuple[Calibrated, tuple[float, float] | None]:
    """Calibrate the array of a scene from measured or simulated transmissions.

    Parameters
    ----------
    setup : scene with the array.
    echoes_file : .h5 file of the measured transmissions; None to simulate them.
    noise : signal-to-noise ratio of the simulation [dB]; None for measured transmissions.
    seed : seed of the simulated noise and array.
    progress : function called with a description of each step as it begins.

    Returns
    -------
    The calibration, the largest error of a board's position [m], and the error of the speed of
    sound [m/s]. For measured transmissions, the errors are unknown, and None is returned in their
    place.

    Raises
    ------
    InvalidInput
        If the file is invalid or does not match the array, if neither or both of the file and the
        noise are given, or if the transmissions do not determine all poses and the speed of sound.
    NotConverged
        If no positions of the boards explain the transmissions.
    """
    if (echoes_file is None) == (noise is None):
        raise InvalidInput(
            "pass either a file of transmissions or --simulate.", code="data_missing"
        )
    clock = Clock(progress)
    array = setup.array
    medium = setup.medium
    true = None
    if echoes_file is not None:
        echoes = load_echoes(echoes_file)
    else:
        with clock.step("transmissions", "simulating transmissions of an array with small errors"):
            true = _simulated_array(array, medium, seed)
            echoes = simulate_transmissions(
                *true,
                hadamard_codes(len(array)),
                frequency=setup.frequency,
                noise=noise,
                seed=seed,
            )
    with clock.step("calibrate", "fitting boards, gains and sound speed"):
        calibrated = calibrate(echoes, array, medium)
    if not calibrated.converged:
        raise NotConverged(
            f"no positions of the boards near those of the scene {setup.title} explain the "
            f"transmissions: the best positions leave {calibrated.misfit:.2g} of the "
            "transmissions unexplained beyond the noise. Likely causes: an object between the "
            "boards, direct sound that was subtracted, other codes or another order of the "
            "elements, or boards displaced by more than 2 mm.",
            code="pose_not_found",
        )
    if true is None:
        return calibrated, None
    true_array, true_medium = true
    # The position of a board is that of its centre.
    middles = [
        np.stack([board.positions.mean(axis=0) for board in boards_of(each)])
        for each in (calibrated.array, true_array)
    ]
    error = float(np.linalg.norm(middles[0] - middles[1], axis=1).max())
    return calibrated, (error, abs(calibrated.sound_speed - true_medium.sound_speed))


def calibrate_from_files(
    setup: Setup,
    scan_files: Sequence[Path],
    elements: Sequence[int],
    drive_files: Sequence[Path],
    microphone: Microphone,
    progress: Progress = no_progress,
) -> ScanCalibration:
    """Calibrate the array of a scene from scans of its field without bodies.

    Parameters
    ----------
    setup : scene whose array was scanned.
    scan_files : .csv files with the measured scans.
    elements : index of the element that emitted at full scale during each scan; empty if whole
        drives were emitted.
    drive_files : file of the drive emitted during each scan, or a single file for all scans. If
        ``elements`` is empty as well, the drive of the scene is used.
    microphone : microphone used for the scans.
    progress : function called with a description of each step as it begins.

    Returns
    -------
    The calibrated array, its sensitivity and the pose of the scans, each with its standard error.

    Raises
    ------
    InvalidInput
        If both elements and drives are given, their number differs from the number of scans, an
        element does not exist, a file is invalid, or the scans fit far better after negating their
        phases.
    NotConverged
        If no small misalignment explains a scan to within 50 %.
    """
    if elements and drive_files:
        raise InvalidInput(
            "--element and --drive cannot be combined: omit one.", code="options_clash"
        )
    clock = Clock(progress)
    count = len(setup.array)
    scans = [load_scan(file) for file in scan_files]
    if elements:
        for element in elements:
            if not 0 <= element < count:
                raise InvalidInput(
                    f"there is no element {element}: the array has elements 0 to {count - 1}.",
                    code="unknown_name",
                )
        drives = [Drive(row) for row in np.eye(count, dtype=np.complex128)[list(elements)]]
    elif drive_files:
        # Boards emit the rounded drive.
        drives = [
            quantise(Drive(file.drives[0]), file.levels or setup.levels).drive()
            for file in map(read_drive_file, drive_files)
        ]
    else:
        drives = [emitted_drive(setup, clock)[0]]
    if not elements and len(drives) == 1:
        drives = drives * len(scans)
    with clock.step("calibrate", "fitting sensitivity, gains and the position of the scans"):
        return calibrate_from_scans(
            scans, drives, setup.array, replace(setup.scene, obstacles=[]), microphone
        )


def _simulated_array(array: PhasedArray, medium: Medium, seed: int) -> tuple[PhasedArray, Medium]:
    # Return an array and air with random errors: 0.5 mm, 5 mrad, 1 m/s, and random gains.
    random = np.random.default_rng([seed, 2])
    boards = boards_of(array)
    motions = random.normal(size=(len(boards), 6)) * np.repeat([5e-4, 5e-3], 3)
    motions[0] = 0.0  # the first board defines the frame
    # Logarithm of the magnitude, and phase [rad], of the gains
    logarithm = random.normal(size=(2, len(array))) * np.array([0.1, 0.2])[:, None]
    true = join([moved(board, motion) for board, motion in zip(boards, motions, strict=True)])
    return true.calibrated(np.exp(logarithm[0] + 1j * logarithm[1])), Medium(
        medium.sound_speed + 1.0 * random.normal(), medium.density, medium.absorption
    )
