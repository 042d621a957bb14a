"""Windows and boxes stand where they say."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from airtact.evaluation.windows import box_around, plane_through

WAVELENGTH = 8.6e-3
NOBODY = np.empty((0, 3))


def test_two_foci_above_a_body_give_the_upright_plane_through_both():
    foci = np.array([[-6e-3, 0.0, 0.0], [6e-3, 0.0, 0.0]])
    body = np.array([[0.01, 0.0, -0.04], [-0.01, 0.001, -0.04]])
    window = plane_through(foci, body, WAVELENGTH)
    np.testing.assert_array_equal(window.right, [1, 0, 0])
    assert window.labels == ("x [mm]", "z [mm]")
    np.testing.assert_allclose(window.height_of(foci), 0.0, atol=1e-12)


@given(st.integers(1, 8), st.integers(0, 2**32 - 1))
def test_any_foci_lie_in_the_window_and_the_plane_if_there_is_one(count, seed):
    random = np.random.default_rng(seed)
    foci = random.normal(scale=0.03, size=(count, 3))
    window = plane_through(foci, random.normal(size=(5, 3)), WAVELENGTH)
    if count <= 3:
        np.testing.assert_allclose(window.height_of(foci), 0.0, atol=1e-9)
    left, right, bottom, top = window.extent
    across, along = window.seen(foci).T
    margin = 3e3 * WAVELENGTH - 1e-6
    assert across.min() >= left + margin
    assert across.max() <= right - margin
    assert along.min() >= bottom + margin
    assert along.max() <= top - margin
    np.testing.assert_allclose(window.right @ window.up, 0.0, atol=1e-12)


def test_the_points_of_a_window_are_a_grid_from_its_lower_left_corner():
    window = plane_through(np.array([[0.01, 0.02, 0.03]]), NOBODY, WAVELENGTH)
    rows, columns = window.shape
    grid = window.seen(window.points).reshape(rows, columns, 2)
    left, right, bottom, top = window.extent
    np.testing.assert_allclose(grid[0, 0], [left, bottom])
    np.testing.assert_allclose(grid[-1, -1], [right, top])
    np.testing.assert_allclose(
        grid[0, 1] - grid[0, 0], [(right - left) / (columns - 1), 0], atol=1e-9
    )
    np.testing.assert_allclose(window.height_of(window.points), 0.0, atol=1e-12)
    # Along an axis of the frame a picture shows the frame's own coordinates.
    assert (left + right) / 2 == pytest.approx(10.0)
    assert (bottom + top) / 2 == pytest.approx(30.0)


def test_a_box_reaches_past_the_foci_with_x_fastest():
    foci = np.array([[0.0, 0.0, 0.0], [0.02, 0.0, 0.0]])
    box = box_around(foci, WAVELENGTH)
    points = box.points.reshape(*box.counts[::-1], 3)
    np.testing.assert_allclose(points[0, 0, 1] - points[0, 0, 0], [box.step[0], 0, 0], atol=1e-12)
    np.testing.assert_allclose(points[1, 0, 0] - points[0, 0, 0], [0, 0, box.step[2]], atol=1e-12)
    np.testing.assert_allclose(points[0, 0, 0], foci.min(axis=0) - 1.5 * WAVELENGTH)
    assert np.all(points[-1, -1, -1] > foci.max(axis=0) + 1.5 * WAVELENGTH - box.step)
    assert (box.step == WAVELENGTH / 8).all()


def test_a_large_box_is_coarser_rather_than_larger():
    box = box_around(np.array([[0.0, 0.0, 0.0], [0.2, 0.2, 0.2]]), WAVELENGTH, max_points=20_000)
    assert np.prod(box.counts) <= 22_000
    assert (box.step > WAVELENGTH / 8).all()
