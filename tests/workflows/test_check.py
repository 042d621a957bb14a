"""A check counts the unknowns of small bodies and estimates those of large ones."""

import numpy as np
import pytest

import airtact as at
from airtact.workflows.check import MOST_COUNTED, unknowns_of

SOLVER = at.BoundaryElement(accuracy=0.1)
AWAY = np.array([[0.0, 0.0, 1.5]])


def scene(radius: float) -> at.Scene:
    return at.Scene(at.air(celsius=20.0), [at.sound_hard(at.sphere(radius, radius / 8))])


def test_small_bodies_are_counted():
    small = scene(0.01)
    assert unknowns_of(SOLVER, small, AWAY) == SOLVER.unknowns(
        small, at.Monopoles(AWAY, np.ones(1))
    )


def test_large_bodies_are_estimated():
    wavelength = scene(0.5).wavelength
    estimate = SOLVER.nodes_per_square_wavelength * 4 * np.pi * 0.5**2 / wavelength**2
    assert estimate > MOST_COUNTED
    assert unknowns_of(SOLVER, scene(0.5), AWAY) == pytest.approx(estimate, rel=1e-3)
