"""The picture in space shows everything, in proportion."""

import numpy as np
import pytest
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from airtact.figures.scene_figure import draw_scene
from airtact.hand.pinch import pinch
from airtact.transducers.layout import flat_boards, surrounding_box


@pytest.mark.parametrize("array", [surrounding_box(), flat_boards()], ids=["box", "flat"])
def test_all_is_in_the_frame_and_axes_are_equally_long_for_equal_lengths(array):
    fingers = pinch()
    figure = draw_scene(array.positions, array.normals, np.exp(1j * np.arange(996.0)), fingers.surfaces, fingers.foci())
    axes = figure.axes[0]
    limits = np.array([axes.get_xlim3d(), axes.get_ylim3d(), axes.get_zlim3d()])
    everything = 1e3 * np.concatenate([array.positions, *(surface.vertices for surface in fingers.surfaces)])
    assert np.all(everything >= limits[:, 0] - 1e-9)
    assert np.all(everything <= limits[:, 1] + 1e-9)
    proportions = np.ptp(limits, axis=1) / np.asarray(axes._box_aspect)
    np.testing.assert_allclose(proportions, proportions[0], rtol=1e-6)
    assert [axes.get_xlabel(), axes.get_ylabel(), axes.get_zlabel()] == ["x [mm]", "y [mm]", "z [mm]"]


def test_walls_that_turn_their_backs_to_the_viewer_are_rings():
    array = surrounding_box()
    figure = draw_scene(array.positions, array.normals, np.ones(996, complex), [], np.zeros((1, 3)))
    discs = [part for part in figure.axes[0].collections if isinstance(part, Poly3DCollection)]
    figure.draw_without_rendering()
    filled = [len(part.get_facecolor()) for part in discs]
    assert sorted(filled) == [0, 498]
