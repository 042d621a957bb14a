"""Transfer matrices in closed form and at random, and points to go with them."""

import numpy as np

import airtact as at

WAVELENGTH = 343.1 / 40e3


def random_matrix(seed: int, foci: int, elements: int = 40) -> at.TransferMatrix:
    numbers = np.random.default_rng(seed).normal(size=(2, foci, elements))
    return at.TransferMatrix(100.0 * (numbers[0] + 1j * numbers[1]), 0.0)


def any_points(count: int) -> np.ndarray:
    return np.arange(3.0 * count).reshape(count, 3) * 1e-3


def open_air(points: np.ndarray, wavelength: float | None = WAVELENGTH) -> at.TransferMatrix:
    """The transfer matrix without obstacles in closed form, sensitivity e^{ikr}/r."""
    array = at.surrounding_box()
    distance = np.linalg.norm(array.positions[None] - points[:, None], axis=-1)
    wave = np.exp(2j * np.pi / WAVELENGTH * distance) / distance
    return at.TransferMatrix(array.element.sensitivity * wave, 0.0, points, wavelength)


def in_open_air(
    points: np.ndarray, pressures: np.ndarray | float | None = None, **asked: np.ndarray
) -> tuple[at.TransferMatrix, at.Target]:
    return open_air(points), at.Target(points, pressures, **asked)


def at_random(
    seed: int, foci: int, pressures: np.ndarray | float | None = None, elements: int = 40
) -> tuple[at.TransferMatrix, at.Target]:
    return random_matrix(seed, foci, elements), at.Target(any_points(foci), pressures)


def scattered(seed: int, count: int, least: float = 4e-3) -> np.ndarray:
    """Points in a ball of 30 mm, no two nearer than ``least``."""
    random, points = np.random.default_rng(seed), np.empty((0, 3))
    while len(points) < count:
        point = random.uniform(-0.03, 0.03, 3)
        if not (np.linalg.norm(points - point, axis=1) < least).any():
            points = np.vstack([points, point])
    return points


def worst(transfer: at.TransferMatrix, drive: at.Drive) -> float:
    return float(np.abs(transfer.pressure(drive)).min())
