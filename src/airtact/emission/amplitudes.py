"""Frames of a modulation, and the pressure around an array, where a head may be."""

import numpy as np
from jaxtyping import Complex, Float64, Real

from airtact.errors import InvalidInput


def frames_of_period(frequency: float, fastest: float) -> tuple[int, float]:
    """Choose the number of frames of a period of a modulation, and their rate [frames/s].

    Boards without a limit of their own play frames that last whole periods of the 40 kHz sound: of
    16 to 40 frames, the number that comes nearest to the frequency, and among equals the one
    nearest to 20. Slower serial lines get an even number of frames, up to 20; 2 are on and off.

    Parameters
    ----------
    frequency : of the modulation [Hz].
    fastest : largest rate of the boards [frames/s].

    Raises
    ------
    InvalidInput
        "out_of_range"; the message has the nearest frequency that the boards can play.

    Examples
    --------
    >>> frames_of_period(200.0, np.inf), frames_of_period(40.0, 88.0)
    ((20, 4000.0), (2, 80.0))
    """
    if np.isfinite(fastest):
        # 1e-9: a quotient that should be whole may be rounded down.
        count = int(fastest / frequency + 1e-9)
        if count < 2:
            nearest = np.floor(fastest / 2)
            raise InvalidInput(
                f"an amplitude modulation of {frequency:g} Hz needs {2 * frequency:g} frames/s, "
                f"and the boards take {fastest:.4g}: give {nearest:g} Hz or less, such as "
                f"--modulate am:{nearest:g}.",
                code="out_of_range",
            )
        count = min(count - count % 2, 20)
        return count, count * frequency
    if frequency > 40e3 / 40:
        raise InvalidInput(
            f"an amplitude modulation of {frequency:g} Hz is too fast: the fastest is "
            f"{40e3 / 40:g} Hz.",
            code="out_of_range",
        )
    counts = np.arange(16, 41)
    periods = np.maximum(np.rint(40e3 / (frequency * counts)), 1.0)
    error = np.round(np.abs(40e3 / (periods * counts) / frequency - 1.0), 9)
    best = np.lexsort((np.abs(counts - 20), error))[0]
    return int(counts[best]), float(40e3 / periods[best])


def pressures_around(
    positions: Real[np.ndarray, "elements 3"],
    drives: Complex[np.ndarray, "frames elements"],
    sensitivity: float,
    wavenumber: float,
    distance: float = 0.5,
) -> tuple[float, float]:
    """Largest pressures [Pa] on a sphere around an array, ``distance`` [m] beyond it.

    Elements radiate equally in all directions in open air, with a peak pressure of ``sensitivity``
    [Pa·m]. Bodies scatter the sound elsewhere, and a real transducer radiates less backwards: the
    result is a warning, not a measurement.

    Returns
    -------
    The peak pressure in the strongest frame, and the root mean square over the frames, each where
    it is largest.
    """
    middle = (positions.min(axis=0) + positions.max(axis=0)) / 2.0
    radius = float(np.linalg.norm(positions - middle, axis=1).max()) + distance

    def pressures(
        directions: Real[np.ndarray, "directions 3"], parts: int
    ) -> Float64[np.ndarray, "two directions"]:
        # In parts, which bounds the memory for the distances.
        values = []
        for part in np.array_split(directions, parts):
            lengths = np.linalg.norm((middle + radius * part)[:, None] - positions[None], axis=-1)
            frames = np.abs((np.exp(1j * wavenumber * lengths) / lengths) @ drives.T)
            values.append([frames.max(axis=1), np.sqrt(np.mean(frames**2, axis=1))])
        return np.concatenate(values, axis=1)

    directions = _directions(2000)
    coarse = pressures(directions, 20)
    # A beam may be narrower than the step between two directions: refine around the 12 largest
    # pressures, with 100 directions each up to one step away.
    steps = (
        _directions(100)[None]
        * np.sqrt(4.0 * np.pi / len(directions))
        * np.linspace(0.2, 1.0, 100)[None, :, None]
    )
    around = (directions[np.argsort(coarse[0])[-12:], None] + steps).reshape(-1, 3)
    around /= np.linalg.norm(around, axis=1, keepdims=True)
    fine = pressures(around, 10)
    peak, average = np.maximum(coarse.max(axis=1), fine.max(axis=1))
    return sensitivity * float(peak), sensitivity * float(average)


def _directions(count: int) -> Float64[np.ndarray, "directions 3"]:
    """Evenly spread unit vectors: a spiral from pole to pole."""
    index = np.arange(count) + 0.5
    height = 1.0 - 2.0 * index / count
    turn = np.pi * (1.0 + np.sqrt(5.0)) * index
    width = np.sqrt(1.0 - height**2)
    return np.stack([width * np.cos(turn), width * np.sin(turn), height], axis=1)
