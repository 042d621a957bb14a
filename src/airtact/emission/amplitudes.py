"""Amplitudes of drives under a cap and in a fade, and the pressure around an array, where a head may be."""

import numpy as np
from jaxtyping import Complex, Float64, Real

from airtact.drives.drive import Drive
from airtact.drives.frame import Frame, frame_at
from airtact.errors import InvalidInput
from airtact.transducers.levels import Levels
from airtact.transducers.modulation import AmplitudeModulation

CLOCK = 40e3
"""Periods of the sound that boards emit, in a second."""

USUAL_FRAMES = 20
MOST_FRAMES = 40
"""Frames of a period of amplitude modulation, where nothing else limits them."""

COARSE = 2000
FINE = 100
"""Number of directions evaluated first, of those with the largest pressure that are refined, and of directions
around each of these."""


def faded(drive: Drive, levels: Levels, share: float) -> Frame:
    """Quantise a drive at a share of its amplitude, as ``frame_at``."""
    return frame_at(drive.amplitudes, levels, share)


def modulated(
    drive: Drive, modulation: AmplitudeModulation, levels: Levels, fastest: float, share: float
) -> tuple[list[Frame], float]:
    """Return the frames of one period of a modulated drive at a share of its amplitude, and their rate [frames/s].

    ``fastest`` is how many frames a second the boards take. Raise as ``frames_of_period``.
    """
    count, rate = frames_of_period(modulation.frequency, fastest)
    return [
        faded(drive, levels, share * float(factor)) for factor in modulation.envelope(count)
    ], rate


def frames_of_period(frequency: float, fastest: float, clock: float = CLOCK) -> tuple[int, float]:
    """Choose how many frames a period of a modulation has, and their rate [frames/s].

    Boards without a limit of their own play frames that last whole periods of the sound: of 16 to
    40 frames a period, the number whose frequency is nearest, and of these the one nearest to 20.
    Slower lines carry as many as they can, an even number up to 20: 2 are on and off.

    Parameters
    ----------
    frequency : of the modulation [Hz].
    fastest : frames a second that the boards take.
    clock : periods of the sound in a second.

    Raises
    ------
    InvalidInput
        "out_of_range": the frequency with the nearest that the boards can play.

    Examples
    --------
    >>> frames_of_period(200.0, np.inf), frames_of_period(40.0, 88.0)
    ((20, 4000.0), (2, 80.0))
    """
    if np.isfinite(fastest):
        most = int(fastest / frequency + 1e-9)
        if most < 2:
            raise InvalidInput(
                f"an amplitude modulation of {frequency:g} Hz needs {2 * frequency:g} frames/s, and the boards take "
                f"{fastest:.4g}: give {np.floor(fastest / 2):g} Hz or less, such as --modulate "
                f"am:{np.floor(fastest / 2):g}.",
                code="out_of_range",
            )
        count = min(most - most % 2, USUAL_FRAMES)
        return count, count * frequency
    if frequency > clock / MOST_FRAMES:
        raise InvalidInput(
            f"an amplitude modulation of {frequency:g} Hz is too fast: the fastest is {clock / MOST_FRAMES:g} Hz.",
            code="out_of_range",
        )
    counts = np.arange(16, MOST_FRAMES + 1)
    divides = np.maximum(np.rint(clock / (frequency * counts)), 1.0)
    off = np.round(np.abs(clock / (divides * counts) / frequency - 1.0), 9)
    best = np.lexsort((np.abs(counts - USUAL_FRAMES), off))[0]
    return int(counts[best]), float(clock / divides[best])


def pressures_around(
    positions: Real[np.ndarray, "elements 3"],
    drives: Complex[np.ndarray, "frames elements"],
    sensitivity: float,
    wavenumber: float,
    distance: float = 0.5,
) -> tuple[float, float]:
    """Find the largest pressures [Pa] on a sphere around an array, ``distance`` [m] beyond the outermost element.

    Elements radiate to all sides alike in open air, with a peak pressure of ``sensitivity`` [Pa·m].
    Bodies scatter the sound elsewhere, and a real transducer radiates less to its back: the number
    serves as a warning and is no measurement.

    Returns
    -------
    The peak pressure in the strongest frame, and the root of the mean of the squares over the frames, each where it is
    largest.
    """
    middle = (positions.min(axis=0) + positions.max(axis=0)) / 2.0
    radius = float(np.linalg.norm(positions - middle, axis=1).max()) + distance

    def pressures(
        directions: Real[np.ndarray, "directions 3"],
    ) -> Float64[np.ndarray, "two directions"]:
        apart = np.linalg.norm((middle + radius * directions)[:, None] - positions[None], axis=-1)
        found = np.abs((np.exp(1j * wavenumber * apart) / apart) @ drives.T)
        return np.stack([found.max(axis=1), np.sqrt(np.mean(found**2, axis=1))])

    directions = _directions(COARSE)
    found = np.concatenate([pressures(part) for part in np.array_split(directions, 20)], axis=1)
    # A beam may be narrower than the step between two directions: refine around the largest
    # pressures.
    near = (
        _directions(FINE)[None]
        * np.sqrt(4.0 * np.pi / COARSE)
        * np.linspace(0.2, 1.0, FINE)[None, :, None]
    )
    around = (directions[np.argsort(found[0])[-12:], None] + near).reshape(-1, 3)
    around /= np.linalg.norm(around, axis=1, keepdims=True)
    refined = np.concatenate([pressures(part) for part in np.array_split(around, 10)], axis=1)
    peak, average = np.maximum(found.max(axis=1), refined.max(axis=1))
    return sensitivity * float(peak), sensitivity * float(average)


def _directions(count: int) -> Float64[np.ndarray, "directions 3"]:
    """Spread unit vectors evenly: a spiral from pole to pole."""
    index = np.arange(count) + 0.5
    height = 1.0 - 2.0 * index / count
    turn = np.pi * (1.0 + np.sqrt(5.0)) * index
    width = np.sqrt(1.0 - height**2)
    return np.stack([width * np.cos(turn), width * np.sin(turn), height], axis=1)
