"""Pressure of drives under deviations of hand, air and transducers, on held-out samples."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from airtact.acoustics.solvers.problem import RadiatedField, Solver
from airtact.acoustics.target import Target
from airtact.drives.drive import Drive
from airtact.drives.transfer_ensemble import TransferEnsemble, matrices_at
from airtact.errors import InvalidInput, in_short
from airtact.evaluation.metrics import pascals
from airtact.evaluation.windows import Window
from airtact.geometry.pose import Pose
from airtact.transducers.layout import PhasedArray

HELD_OUT_SAMPLES = 256
"""Number of samples on which drives are evaluated."""

SOLVED_HELD_OUT_SAMPLES = 64
"""Number of samples in front of a plane, where each sample needs a solve."""


@dataclass(frozen=True, eq=False)
class ShiftMap:
    """The weakest focus under several drives when the hand and its foci are shifted.

    Attributes
    ----------
    shifts : a window around zero shift; its points are shifts of the hand in the obstacles' frame
        [m].
    pressures : (D, P) peak pressure of the weakest focus at each shift, at the energy of the first
        drive [Pa]; NaN for impossible shifts.
    """

    shifts: Window
    pressures: Float64[np.ndarray, "drives points"]

    __repr__ = in_short


@dataclass(frozen=True, eq=False)
class HeldOut:
    """The weakest focus under several drives, over samples that no drive was made for.

    Attributes
    ----------
    names : names of the D drives.
    pressures : (D, S) peak pressure of the weakest focus in each sample, at the energy of the first
        drive [Pa].
    expected : (D,) the same without deviations [Pa].
    left_out : number of impossible samples.
    maps : the same for a hand that is shifted in a plane; may be empty.
    """

    names: tuple[str, ...]
    pressures: Float64[np.ndarray, "drives samples"]
    expected: Float64[np.ndarray, "drives"]
    left_out: int
    maps: tuple[ShiftMap, ...] = ()

    __repr__ = in_short

    @property
    def lowest_tenth(self) -> Float64[np.ndarray, "drives"]:
        """(D,) pressure that the weakest focus exceeds in 9 of 10 samples [Pa]."""
        return np.quantile(self.pressures, 0.1, axis=1)

    def sentence(self) -> str:
        """State the pressure that the weakest focus exceeds in 9 of 10 samples."""
        first, *rest = self.lowest_tenth
        words = [f"{name}: {pascals(low)}" for name, low in zip(self.names[1:], rest, strict=True)]
        compared = f" ({', '.join(words)} at equal energy)" if words else ""
        left_out = f"; {self.left_out} samples are impossible" if self.left_out else ""
        return (
            "With the given uncertainty the weakest focus gets at least "
            f"{pascals(first)} 9 of 10 times, and {pascals(self.expected[0])} without "
            f"deviations{compared}{left_out}."
        )


def held_out(samples: TransferEnsemble, target: Target, drives: Mapping[str, Drive]) -> HeldOut:
    """Evaluate drives on samples, each at the energy of the first.

    Parameters
    ----------
    samples : samples with another seed than those that the drives were made for.
    target : the foci; those without a request do not count.
    drives : drives by name.

    Raises
    ------
    InvalidInput
        "empty": there is no drive; or a drive is for another number of elements.
    """
    if not drives:
        raise InvalidInput(
            'no drives were given. Give at least one, as {"name": drive}.', code="empty"
        )
    # The rows of the foci come first; suppression points after them do not count.
    asked = np.flatnonzero(target.weights > 0.0)
    factors = _factors(drives)
    sampled = [np.abs(samples.pressures(drive)[:, asked]).min(axis=1) for drive in drives.values()]
    nominal = [np.abs(samples.pressure(drive)[asked]).min() for drive in drives.values()]
    return HeldOut(
        names=tuple(drives),
        pressures=factors[:, None] * np.stack(sampled),
        expected=factors * np.array(nominal),
        left_out=samples.left_out,
    )


def shift_map(
    beacons: RadiatedField,
    array: PhasedArray,
    target: Target,
    drives: Mapping[str, Drive],
    shifts: Window,
    *,
    solver: Solver | None = None,
) -> ShiftMap:
    """Evaluate drives, each at the energy of the first, for a shifted hand.

    Parameters
    ----------
    beacons : field of unit beacons at the foci.
    array, target, drives : for the hand at its expected position.
    shifts : a window around zero shift.
    solver : solves the scene for each distance from a plane, if there is a plane.
    """
    asked = np.flatnonzero(target.weights > 0.0)
    amplitudes = np.stack([drive.amplitudes for drive in drives.values()], axis=1)
    weakest = np.full((len(drives), len(shifts.points)), np.nan)
    poses = (Pose(np.eye(3), shift) for shift in shifts.points)
    for index, matrix in enumerate(matrices_at(beacons, array, poses, solver=solver)):
        # The pixel of an impossible shift, with an element inside the hand, stays NaN.
        if matrix is not None:
            weakest[:, index] = np.abs(matrix[asked] @ amplitudes).min(axis=0)
    return ShiftMap(shifts, _factors(drives)[:, None] * weakest)


def _factors(drives: Mapping[str, Drive]) -> Float64[np.ndarray, "drives"]:
    """Return the factors that bring drives to the energy of the first."""
    first = next(iter(drives.values()))
    return np.array([drive.factor_to_match(first) for drive in drives.values()])
