"""An array is laid flat without tearing or mirroring, its discs have the colours of their phases; all is in space."""

from itertools import pairwise

import numpy as np
import pytest
from matplotlib import colormaps
from matplotlib.collections import EllipseCollection
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

import airtact as at
from airtact.reports.array_figures import draw_phases, draw_receivers, draw_scene, unfold
from airtact.reports.page import pixels_of

ARRAYS = {
    "box": at.surrounding_box(),
    "board": at.autd3_board(at.Pose.shift((0.0, 0.0, -0.07))),
    "flat": at.flat_boards(2, 2),
    "tilted": at.autd3_board(at.Pose.turn((1.0, 2.0, 3.0), 0.7, (0.1, 0.0, 0.2))),
}


def distances(places):
    return np.linalg.norm(places[:, None] - places[None], axis=-1)


@pytest.mark.parametrize("name", ARRAYS)
def test_unfolding_keeps_distances_and_handedness(name):
    array = ARRAYS[name]
    faces = unfold(array.positions, array.normals)
    assert sorted(np.concatenate([face.elements for face in faces])) == list(range(len(array)))
    for face in faces:
        places = array.positions[face.elements]
        np.testing.assert_allclose(distances(face.seen), distances(places), atol=1e-9)
        # Seen from where the face radiates to, a turn to the left stays one.
        first = face.seen[1] - face.seen[0]
        second = face.seen[40] - face.seen[0]
        turn = np.cross(places[1] - places[0], places[40] - places[0]) @ face.normal
        assert first[0] * second[1] - first[1] * second[0] == pytest.approx(turn)


def test_the_faces_of_the_box_follow_one_another_to_the_right():
    array = ARRAYS["box"]
    faces = unfold(array.positions, array.normals)
    assert [len(face.elements) for face in faces] == [249] * 4
    for face, after in pairwise(faces):
        # Looking along -normal with z up, the next face is a quarter turn clockwise.
        np.testing.assert_allclose(np.cross(face.normal, after.normal), [0, 0, -1], atol=1e-12)
    for face in faces:
        # The long side of the board stands upright.
        assert np.ptp(face.seen[:, 1]) > np.ptp(face.seen[:, 0])


def test_two_bowls_are_two_faces():
    array = at.transducers.known_array("tinylev")
    faces = unfold(array.positions, array.normals)
    assert [len(face.elements) for face in faces] == [36, 36]
    np.testing.assert_allclose(faces[0].normal, -faces[1].normal, atol=1e-3)
    # Neighbours in a bowl are apart in the picture.
    for face in faces:
        assert distances(face.seen)[~np.eye(36, dtype=bool)].min() > 8e-3


@pytest.mark.parametrize("name", ARRAYS)
def test_no_title_is_cut_off(name):
    array = ARRAYS[name]
    amplitudes = np.linspace(0.1, 1.0, len(array)) + 0j
    pixels = pixels_of(draw_phases(array.positions, array.normals, amplitudes))
    for edge in (pixels[0], pixels[-1], pixels[:, 0], pixels[:, -1]):
        assert (edge[:, :3] == 255).all()


def test_a_uniform_amplitude_is_not_drawn():
    array = ARRAYS["flat"]
    figure = draw_phases(array.positions, array.normals, np.exp(1j * np.arange(996.0)))
    labels = [axes.get_xlabel() for axes in figure.axes]
    assert labels == ["x [mm]", "phase [rad]"]


@pytest.mark.parametrize("array", [at.surrounding_box(), at.flat_boards()], ids=["box", "flat"])
def test_all_is_in_the_frame_and_axes_are_equally_long_for_equal_lengths(array):
    fingers = at.pinch()
    figure = draw_scene(
        array.positions,
        array.normals,
        np.exp(1j * np.arange(996.0)),
        fingers.surfaces,
        fingers.foci(),
    )
    axes = figure.axes[0]
    limits = np.array([axes.get_xlim3d(), axes.get_ylim3d(), axes.get_zlim3d()])
    everything = 1e3 * np.concatenate(
        [array.positions, *(surface.vertices for surface in fingers.surfaces)]
    )
    assert np.all(everything >= limits[:, 0] - 1e-9)
    assert np.all(everything <= limits[:, 1] + 1e-9)
    proportions = np.ptp(limits, axis=1) / np.asarray(axes._box_aspect)
    np.testing.assert_allclose(proportions, proportions[0], rtol=1e-6)
    assert [axes.get_xlabel(), axes.get_ylabel(), axes.get_zlabel()] == [
        "x [mm]",
        "y [mm]",
        "z [mm]",
    ]


def test_walls_that_turn_their_backs_to_the_viewer_are_rings():
    array = at.surrounding_box()
    figure = draw_scene(array.positions, array.normals, np.ones(996, complex), [], np.zeros((1, 3)))
    discs = [part for part in figure.axes[0].collections if isinstance(part, Poly3DCollection)]
    figure.draw_without_rendering()
    filled = [len(part.get_facecolor()) for part in discs]
    assert sorted(filled) == [0, 498]


@pytest.mark.parametrize("name", ARRAYS)
def test_values_of_receivers_have_one_scale_and_those_missing_are_grey(name):
    array = ARRAYS[name]
    size = len(array)
    first = np.geomspace(0.05, 1.0, size)
    second = np.full(size, 0.5)
    second[3] = np.nan
    figure = draw_receivers(array.positions, array.normals, {"one": first, "other": second}, "rest")
    upper, lower = (_discs(axes) for axes in figure.axes[:2])
    assert len(upper) == len(lower) == size
    shades = colormaps["viridis"](np.linspace(0.0, 1.0, size))
    np.testing.assert_allclose(upper, shades, atol=0.02)
    half = colormaps["viridis"](np.log(0.5 / 0.05) / np.log(1.0 / 0.05))
    finite = np.isfinite(second)
    np.testing.assert_allclose(lower[finite], np.tile(half, (size - 1, 1)), atol=0.02)
    assert not np.allclose(lower[~finite], half, atol=0.1)


def _discs(axes):
    return next(
        one for one in axes.collections if isinstance(one, EllipseCollection)
    ).get_facecolor()
