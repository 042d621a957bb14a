"""Moved panels solve the body that they cover then."""

import numpy as np
import pytest

import airtact as at
from references import relative
from worlds import hard

FOCUS = np.array([[1e-3, 0.0, 8e-3]])
BEFORE = np.array([[0.0, 0.0, 0.2], [0.05, 0.0, 0.18], [-0.03, 0.06, 0.19], [0.1, -0.05, 0.15]])
ACCURACY, TOLERANCE = 0.02, 0.005


@pytest.fixture(scope="module")
def panels():
    scene = hard(at.sphere(radius=5e-3, edge=2e-3))
    return at.BoundaryElement(accuracy=ACCURACY, estimate=False).moving_panels(scene, FOCUS)


def exact(radius: float, centre=(0.0, 0.0, 0.0)) -> np.ndarray:
    ball = at.sphere(radius=radius, edge=2e-3, centre=centre)
    return at.SphereSeries().radiate(hard(ball), at.Target(FOCUS).beacons()).at(BEFORE)


@pytest.mark.parametrize(("scale", "shift"), [(1.0, 0.0), (1.0, -1.5e-3), (1.2, 0.0)])
def test_panels_at_rest_shifted_and_stretched_agree_with_the_series(panels, scale, shift):
    moved = [
        scale * points + np.array([shift, 0.0, 0.0]) for points in (panels.corners, panels.inside)
    ]
    found = panels.radiated(*moved, at.Target(FOCUS).beacons(), TOLERANCE).at(BEFORE)
    assert relative(found, exact(scale * 5e-3, (shift, 0.0, 0.0))) < ACCURACY


def test_what_faces_away_from_sources_and_receivers_hardly_counts(panels):
    some = panels.facing(BEFORE, 0.5)
    found = some.radiated(some.corners, some.inside, at.Target(FOCUS).beacons(), TOLERANCE).at(
        BEFORE
    )
    assert 0.4 < len(some.corners) / len(panels.corners) < 0.65
    assert len(some.inside) == 2 * len(some.corners)
    assert relative(found, exact(5e-3)) < 0.1


def test_what_moved_panels_receive_agrees_with_the_series_on_and_around_them(panels):
    shift, sources = (
        np.array([-1.5e-3, 0.0, 0.0]),
        at.Monopoles(BEFORE, np.array([1.0, 1j, -0.5, 0.7 + 0.2j])),
    )
    found = panels.received(panels.corners + shift, panels.inside + shift, sources, TOLERANCE)
    series = at.SphereSeries().radiate(
        hard(at.sphere(radius=5e-3, edge=2e-3, centre=tuple(shift))), sources
    )
    outwards = found.surface.nodes.points - shift
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    on, around = shift + 5e-3 * outwards, shift + 7e-3 * outwards[::20]
    assert relative(found.pressure, series.at(on)) < 1.5 * ACCURACY
    assert relative(found.at(around, np.zeros(len(around), bool)), series.at(around)) < ACCURACY
