"""Pressures of a drive on samples and shifts that it was not made for."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from airtact.acoustics.solvers.problem import RadiatedField
from airtact.drives.drive import Drive
from airtact.drives.linear_methods import time_reversal
from airtact.drives.methods import FOR_SAMPLES
from airtact.drives.robust_drives import robust
from airtact.drives.transfer import TransferMatrix
from airtact.drives.transfer_ensemble import TransferEnsemble, ensemble
from airtact.evaluation.held_out import (
    HELD_OUT_SAMPLES,
    SOLVED_HELD_OUT_SAMPLES,
    HeldOut,
    held_out,
    shift_map,
)
from airtact.evaluation.windows import Window, plane_of_scene
from airtact.setup.setup import Setup
from airtact.setup.solving import solver_of_samples


def other_samples(setup: Setup, beacons: RadiatedField) -> TransferEnsemble:
    """Sample the uncertainty with another seed than the drive was made for."""
    assert setup.uncertainty is not None
    solver = solver_of_samples(setup)
    return ensemble(
        beacons,
        setup.array,
        setup.uncertainty,
        HELD_OUT_SAMPLES if solver is None else SOLVED_HELD_OUT_SAMPLES,
        setup.seed + 1,
        solver=solver,
    )


def kept_by_drive(
    setup: Setup, beacons: RadiatedField, transfer: TransferMatrix, drive: Drive
) -> HeldOut:
    """Evaluate a drive on other samples and for a shifted hand, beside two other methods."""
    assert setup.uncertainty is not None
    drives = {setup.method.replace("_", " "): drive}
    # Compared with the method for samples and with the simplest method.
    if setup.method not in FOR_SAMPLES:
        drives["robust"] = robust(transfer, setup.target)
    if setup.method != "time_reversal":
        drives["time reversal"] = time_reversal(transfer, setup.target)
    solver = solver_of_samples(setup)
    return replace(
        held_out(other_samples(setup, beacons), setup.target, drives),
        maps=tuple(
            shift_map(beacons, setup.array, setup.target, drives, window, solver=solver)
            for window in _shifts(setup, setup.uncertainty.shift)
        ),
    )


def weakest_nine_of_ten(
    setup: Setup, beacons: RadiatedField, drives: Mapping[str, Drive]
) -> dict[str, float]:
    """Return the pressure that the weakest focus exceeds in 9 of 10 other samples [Pa]."""
    requested = np.flatnonzero(setup.target.weights > 0.0)
    samples = other_samples(setup, beacons)
    weakest = {
        name: np.abs(samples.pressures(drive)[:, requested]).min(axis=1)
        for name, drive in drives.items()
    }
    return {name: float(np.quantile(values, 0.1)) for name, values in weakest.items()}


def _shifts(setup: Setup, deviation: float) -> list[Window]:
    """Return shifts in the plane of the foci and across it, up to three standard deviations.

    With a rigid plane in the scene they are along it, which needs only one solve, and across it.
    """
    window = plane_of_scene(setup.scene, setup.target.points)
    wavelength = setup.scene.wavelength
    reach = 2.0 * float(np.clip(3.0 * deviation, 0.25 * wavelength, 2.0 * wavelength))
    axes = np.stack([window.right, window.up, window.normal])
    if setup.scene.planes:
        plane = setup.scene.planes[0]
        flat = axes - np.outer(axes @ plane.normal, plane.normal)
        # The axis nearest to the plane keeps its direction. Rounding makes the choice between equal
        # axes independent of rounding errors.
        right = flat[np.argmax(np.linalg.norm(flat, axis=1).round(3))]
        right = right / np.linalg.norm(right)
        axes = np.stack([right, np.cross(plane.normal, right), plane.normal])
    right, up, normal = axes
    across = normal * np.sign(normal[np.argmax(np.abs(normal))])
    return [Window(np.zeros(3), right, axis, reach, reach, reach / 16) for axis in (up, across)]
