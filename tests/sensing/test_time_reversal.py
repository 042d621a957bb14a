"""Codes of the strongest echoes: for small balls those that focus on each, from any direction, by noisy echoes."""

from functools import cache

import numpy as np

import airtact as at
from airtact.sensing import (
    ScatteringMatrix,
    dort,
    hadamard_codes,
    iterate_time_reversal,
    random_codes,
)
from faults import raises_code
from sensing.sensed_scenes import AIR, BOX

PLACES = np.array([[-8e-3, 0, 2e-3], [9e-3, 3e-3, 0]])
RADII = 0.9e-3, 0.8e-3
CODES = random_codes(996, 24, seed=3)


@cache
def balls() -> ScatteringMatrix:
    """Two balls much smaller than the wavelength, and over two wavelengths apart."""
    bodies = [
        at.sphere(radius, radius / 2, tuple(place))
        for radius, place in zip(RADII, PLACES, strict=True)
    ]
    scene = at.Scene(AIR, [at.sound_hard(body) for body in bodies], frequency=40e3)
    return at.scattering_matrix(at.BoundaryElement(accuracy=0.02, estimate=False), scene)


def echoes(codes: np.ndarray, **spoilt) -> at.Echoes:
    return at.simulate_echoes(balls(), balls().scene, BOX, codes, **spoilt)


def likeness(code: np.ndarray, ball: int) -> float:
    """Correlation of a code with the one that focuses on a ball in open air, in closed form."""
    focusing = at.FreeField().radiate(
        at.Scene(AIR, [], frequency=40e3), at.Monopoles(PLACES[ball : ball + 1], np.ones(1))
    )
    wanted = focusing.at(BOX.positions)[:, 0].conj()
    return float(abs(np.vdot(wanted, code)) / np.linalg.norm(wanted) / np.linalg.norm(code))


def test_the_strongest_vector_focuses_on_the_strongest_ball_and_the_others_on_both() -> None:
    found = dort(echoes(CODES, noise=30.0), 8)
    assert found.codes.shape == (996, 8)
    assert np.allclose(np.abs(found.codes).max(axis=0), 1.0)
    assert np.all(np.diff(found.values) <= 0)
    assert likeness(found.codes[:, 0], 0) > 0.95
    assert likeness(found.codes[:, 0], 1) < 0.3
    # the second ball is as strong as the first one's dipoles: vectors mix these, but span what
    # focuses on it
    assert np.linalg.norm([likeness(one, 1) for one in found.codes.T]) > 0.95


def test_few_codes_find_what_codes_of_all_elements_find() -> None:
    few, all_of_them = dort(echoes(CODES)), dort(echoes(hadamard_codes(996)))
    alike = abs(np.vdot(few.codes[:, 0], all_of_them.codes[:, 0]))
    assert alike > 0.95 * np.linalg.norm(few.codes) * np.linalg.norm(all_of_them.codes)


def test_iterations_tend_to_the_strongest_vector() -> None:
    code = iterate_time_reversal(lambda code: echoes(code, noise=20.0).pressures, CODES[:, 0], 12)
    assert np.isclose(np.abs(code).max(), 1.0)
    assert likeness(code, 0) > 0.95


def test_elements_that_do_not_receive_are_silent() -> None:
    some = np.arange(0, 996, 3)
    codes = dort(echoes(CODES, receivers=some)).codes
    assert not np.delete(codes, some, axis=0).any()


def test_what_cannot_be_asked_for_is_rejected() -> None:
    with raises_code("out_of_range", "25", "24"):
        dort(echoes(CODES), 25)
    parts = np.repeat(np.arange(4), 249)
    with raises_code("link_failed", "996"):
        dort(echoes(random_codes(996, 4, parts=parts), ring_down=1e-3))
    with raises_code("out_of_range", "0"):
        iterate_time_reversal(lambda code: code, CODES[:, 0], 0)
    with raises_code("signal_unusable", "0 Pa"):
        iterate_time_reversal(lambda code: 0 * code, CODES[:, 0])
