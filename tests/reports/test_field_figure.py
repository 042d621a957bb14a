"""Cuts show the field and the bodies where they are, all drives on one scale."""

import numpy as np
import pytest
from matplotlib.figure import Figure

import airtact as at
from airtact.evaluation.windows import AXES, Window
from airtact.reports.field_figure import (
    FAINT,
    Cut,
    draw_difference,
    draw_field,
    draw_solid,
    solid_depth,
)

UPRIGHT = Window(np.array([0.01, 0.0, 0.02]), AXES["x"], AXES["z"], 0.06, 0.04, 1e-3)
AIR = np.full(len(UPRIGHT.points), -1.0)


def monopole(points, source):
    return np.exp(1j * 732.5 * (r := np.linalg.norm(points - source, axis=1))) / r


def scene_of(*bodies):
    return at.Scene(at.air(), [at.sound_hard(body) for body in bodies])


def outlines(axes):
    """Closed lines around the bodies in a picture [mm]."""
    lines = axes.collections[1]
    return [loop for loop in lines.get_paths()[0].to_polygons(closed_only=False) if len(loop) > 2]


def test_bodies_are_cut_by_the_plane():
    """A ball 6 mm off the plane and a rod in it; a ball beside the plane is not cut."""
    bodies = [
        at.sphere(0.01, 1e-3, (0.0, 6e-3, 0.0)),
        at.sphere(0.01, 3e-3, (0.0, 0.03, 0.0)),
        at.capsule((0.03, 0, 0.0), (0.03, 0, 0.03), radius=5e-3, edge=3e-3),
    ]
    axes = Figure().subplots()
    draw_solid(axes, UPRIGHT, solid_depth(scene_of(*bodies), UPRIGHT.points))
    disc, rod = sorted(outlines(axes), key=lambda loop: loop[:, 0].mean())
    np.testing.assert_allclose(np.linalg.norm(disc, axis=1), 8.0, atol=0.1)
    np.testing.assert_allclose(np.ptp(rod[:, 0]), 10.0, atol=0.1)
    draw_solid(
        empty := Figure().subplots(), UPRIGHT, solid_depth(scene_of(bodies[1]), UPRIGHT.points)
    )
    assert not empty.collections


def drawn_images(figure):
    return [axes.images[0] for axes in figure.axes if axes.images]


def test_a_scale_ends_where_it_is_asked_to_and_is_named():
    source = np.array([0.02, 1e-3, 0.01])
    field = monopole(UPRIGHT.points, source)
    cut = Cut(UPRIGHT, {"strong": field, "weak": 0.25 * field}, AIR)
    figures = [draw_field(cut, name, 1500.0, source[None], ["here"]) for name in cut.pressures]
    images = [image for figure in figures for image in drawn_images(figure)]
    assert [image.get_clim() for image in images] == [(0.0, 1500.0)] * 2
    np.testing.assert_allclose(images[1].get_array(), 0.25 * images[0].get_array())
    axes, bar = figures[0].axes
    assert bar.get_xlabel() == "peak pressure [Pa]"
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x [mm]", "z [mm]")
    assert [note.get_text() for note in axes.texts] == ["here"]


def test_a_difference_is_in_decibels_and_fades_where_both_are_faint():
    source = np.array([0.02, 1e-3, 0.01])
    field = monopole(UPRIGHT.points, source)
    cut = Cut(UPRIGHT, {"strong": 2.0 * field, "weak": field}, AIR)
    figure = draw_difference(cut, ("strong", "weak"), 2000.0, source[None])
    (image,) = drawn_images(figure)
    np.testing.assert_allclose(image.get_array(), 20.0 * np.log10(2.0))
    strength = image.get_alpha()
    pressure = np.abs(2.0 * field).reshape(UPRIGHT.shape)
    assert strength[pressure > 1.5 * FAINT * 2000.0].min() == 1.0
    assert strength[pressure < 0.5 * FAINT * 2000.0].max() == 0.0
    assert figure.axes[1].get_xlabel() == "strong relative to weak [dB]"


def test_the_field_is_drawn_where_it_is():
    source = np.array([0.02, 1e-3, 0.01])
    cut = Cut(UPRIGHT, {"only": monopole(UPRIGHT.points, source)}, AIR)
    (image,) = drawn_images(draw_field(cut, "only", 1000.0, source[None]))
    left, right, bottom, top = image.get_extent()
    row, column = np.unravel_index(np.argmax(image.get_array()), image.get_array().shape)
    rows, columns = image.get_array().shape
    assert left + (column + 0.5) * (right - left) / columns == pytest.approx(20.0, abs=0.51)
    assert bottom + (row + 0.5) * (top - bottom) / rows == pytest.approx(10.0, abs=0.51)
    assert image.origin == "lower"


def test_points_without_a_field_are_left_to_the_grey_of_the_body():
    field = monopole(UPRIGHT.points, np.array([0.02, 1e-3, 0.01]))
    field[np.linalg.norm(UPRIGHT.points, axis=1) < 0.01] = np.nan
    ball = at.sphere(0.01, 2e-3)
    cut = Cut(UPRIGHT, {"only": field}, solid_depth(scene_of(ball), UPRIGHT.points))
    figure = draw_field(cut, "only", 1000.0, np.array([[0.02, 0.0, 0.0]]))
    (image,) = drawn_images(figure)
    deep = np.linalg.norm(UPRIGHT.points, axis=1).reshape(UPRIGHT.shape) < 5e-3
    assert image.get_array().mask[deep].all()
    assert not image.get_array().mask[~np.isnan(field).reshape(UPRIGHT.shape)].any()
    (body,) = outlines(figure.axes[0])
    np.testing.assert_allclose(np.linalg.norm(body, axis=1), 10.0, atol=0.1)
