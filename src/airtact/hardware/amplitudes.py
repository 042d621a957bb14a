"""Amplitudes of drives under a cap and in a fade, and the pressure around an array, where a head may be."""

import numpy as np
from jaxtyping import Complex, Float64, Real

from airtact.conventions import InvalidInput
from airtact.synthesis.quantise import Frame, quantise
from airtact.transducers.levels import Levels
from airtact.transfer import Drive
from airtact.validation import number

GOLDEN = (np.sqrt(5.0) - 1.0) / 2.0
"""Multiples of the golden ratio's fraction spread evenly over 0 to 1, however many are taken."""

COARSE, BEAMS, FINE = 2000, 12, 100
"""Number of directions evaluated first, of those with the largest pressure that are refined, and of directions
around each of these."""


def faded(drive: Drive, levels: Levels, share: float) -> Frame:
    """Quantise a drive at a share of its amplitude.

    Boards with levels of amplitude reduce every element. Boards without switch on that share of their elements, spread
    evenly over the order of the elements: the pressure at a focus is proportional to their number.
    """
    if not levels.phase_only:
        return quantise(Drive(share * drive.amplitudes), levels)
    order = (np.arange(len(drive)) + 0.5) * GOLDEN % 1.0
    return quantise(Drive(np.where(order < share, drive.amplitudes, 0.0)), levels)


def share_under_cap(drives: Complex[np.ndarray, "frames elements"], levels: Levels, cap: float) -> float:
    """Return the factor that brings the largest amplitude of some drives under a cap, in per cent of full scale.

    Without levels of amplitude, the cap is the share of elements that are on. Raise "out_of_range" outside 0 to 100.
    """
    cap = number(cap, "the cap", "per cent")
    if not 0.0 < cap <= 100.0:
        raise InvalidInput(
            f"the cap is {cap:g} per cent of full scale, but it must be above 0 and at most 100.", code="out_of_range"
        )
    if levels.phase_only:
        return cap / 100.0
    return min(1.0, cap / 100.0 / max(float(np.abs(drives).max()), 1e-12))


def largest_pressure_around(
    positions: Real[np.ndarray, "elements 3"],
    drives: Complex[np.ndarray, "frames elements"],
    sensitivity: float,
    wavenumber: float,
    distance: float = 0.5,
) -> float:
    """Find the largest peak pressure [Pa] on a sphere around an array, ``distance`` [m] beyond the outermost element.

    Elements radiate to all sides alike in open air, with a peak pressure of ``sensitivity`` [Pa·m]. Bodies scatter the
    sound elsewhere, and a real transducer radiates less to its back: the number serves as a warning and is no
    measurement.
    """
    middle = (positions.min(axis=0) + positions.max(axis=0)) / 2.0
    radius = float(np.linalg.norm(positions - middle, axis=1).max()) + distance

    def pressures(directions: Real[np.ndarray, "directions 3"]) -> Float64[np.ndarray, "directions"]:
        apart = np.linalg.norm((middle + radius * directions)[:, None] - positions[None], axis=-1)
        return np.abs((np.exp(1j * wavenumber * apart) / apart) @ drives.T).max(axis=1)

    directions = _directions(COARSE)
    found = np.concatenate([pressures(part) for part in np.array_split(directions, 20)])
    # A beam may be narrower than the step between two directions: refine around the largest pressures.
    near = _directions(FINE)[None] * np.sqrt(4.0 * np.pi / COARSE) * np.linspace(0.2, 1.0, FINE)[None, :, None]
    around = (directions[np.argsort(found)[-BEAMS:], None] + near).reshape(-1, 3)
    around /= np.linalg.norm(around, axis=1, keepdims=True)
    largest = max(float(found.max()), *(float(pressures(part).max()) for part in np.array_split(around, 10)))
    return sensitivity * largest


def _directions(count: int) -> Float64[np.ndarray, "directions 3"]:
    """Spread unit vectors evenly: a spiral from pole to pole."""
    index = np.arange(count) + 0.5
    height, turn = 1.0 - 2.0 * index / count, np.pi * (1.0 + np.sqrt(5.0)) * index
    width = np.sqrt(1.0 - height**2)
    return np.stack([width * np.cos(turn), width * np.sin(turn), height], axis=1)
