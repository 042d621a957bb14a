"""How loud it is around an array, where a head may be."""

import numpy as np
from jaxtyping import Complex, Float64, Real

DIRECTIONS = 2000


def loudest_around(
    positions: Real[np.ndarray, "elements 3"],
    drives: Complex[np.ndarray, "frames elements"],
    sensitivity: float,
    wavenumber: float,
    distance: float = 0.5,
) -> float:
    """Find the loudest pressure on a sphere around an array, in open air, its elements radiating alike to all sides.

    Bodies in the sound throw it elsewhere, and a real transducer radiates less to its back: this is a number to be
    warned by, not one that was measured.

    Parameters
    ----------
    positions : (E, 3) of the elements [m].
    drives : (N, E) what they emit; the loudest frame counts.
    sensitivity : peak pressure of an element at full scale, 1 m away [Pa·m].
    wavenumber : 2πf/c [rad/m].
    distance : how far beyond the outermost element the sphere is [m].

    Returns
    -------
    Peak pressure [Pa].
    """
    middle = (positions.min(axis=0) + positions.max(axis=0)) / 2.0
    reach = float(np.linalg.norm(positions - middle, axis=1).max())
    points = middle + (reach + distance) * _directions(DIRECTIONS)
    loudest = 0.0
    for part in np.array_split(points, 20):
        apart = np.linalg.norm(part[:, None] - positions[None], axis=-1)
        pressure = sensitivity * (np.exp(1j * wavenumber * apart) / apart) @ drives.T
        loudest = max(loudest, float(np.abs(pressure).max()))
    return loudest


def _directions(count: int) -> Float64[np.ndarray, "directions 3"]:
    """Spread unit vectors evenly: a spiral from pole to pole."""
    index = np.arange(count) + 0.5
    height, turn = 1.0 - 2.0 * index / count, np.pi * (1.0 + np.sqrt(5.0)) * index
    width = np.sqrt(1.0 - height**2)
    return np.stack([width * np.cos(turn), width * np.sin(turn), height], axis=1)
