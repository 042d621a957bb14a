"""The picture of the skin is bright where sound presses, dark where it does not, on both sides."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.image import imread
from mpl_toolkits.mplot3d import Axes3D

from airtact.evaluation.radiation import RadiationMap, radiation_of
from airtact.figures.picture_file import write_picture
from airtact.figures.surface_figure import FOCUS, _on_pieces, draw_radiation
from airtact.scene.medium import Medium
from airtact.scene.scene import Scene, sound_hard
from airtact.scene.sources import Monopoles
from airtact.solvers.spherical.sphere_series import SphereSeries
from airtact.surfaces.primitives import sphere


@pytest.fixture(scope="module")
def skin() -> RadiationMap:
    scene = Scene(Medium(343.1, 1.293), [sound_hard(sphere(8e-3, edge=3e-3))])
    return radiation_of(SphereSeries().radiate(scene, Monopoles(np.array([[0.03, -0.02, 0.02]]), np.ones(1))), 0)


def redness(tmp_path, figure) -> tuple[float, float]:
    """How much red the bodies have over green in the left and the right half: the scale runs from yellow to red."""
    write_picture(tmp_path / "skin.png", figure)
    image = imread(tmp_path / "skin.png")[:, :, :3]
    image = image[:, : int(0.8 * image.shape[1])]
    halves = np.array_split(image, 2, axis=1)
    found = []
    for half in halves:
        body = half[np.ptp(half, axis=2) > 0.1]
        found.append(float(np.mean((body[:, 0] - body[:, 1]) / body.max(axis=1))))
    return found[0], found[1]


def test_the_side_towards_the_source_is_redder(skin, tmp_path) -> None:
    left, right = redness(tmp_path, draw_radiation(skin))
    assert left > 1.3 * right  # the left view is from where the source is
    pale, _ = redness(tmp_path, draw_radiation(skin, most=100 * skin.radiation_pressure.max()))
    assert pale < 0.5 * left


def test_colours_are_the_pressures_of_the_panels(skin) -> None:
    # Of a quadratic in place the pieces have the exact values, and of a constant the constant.
    assert np.allclose(_on_pieces(replace(skin, radiation_pressure=np.full(len(skin.points), 3.0))), 3.0)
    x = skin.points[:, 0]
    pieces = _on_pieces(replace(skin, radiation_pressure=x))
    assert pieces.shape == (9 * len(skin.quadratic_triangles),)
    np.testing.assert_allclose(pieces.reshape(-1, 9).mean(axis=1), x.reshape(-1, 6).mean(axis=1), atol=2e-4)


def test_foci_are_rings(skin) -> None:
    figure = draw_radiation(skin, foci=np.array([[0.0, 0.0, 9e-3]]))
    spaces = [axes for axes in figure.axes if isinstance(axes, Axes3D)]
    assert len(spaces) == 2
    for axes in spaces:
        rings = axes.collections[1]
        np.testing.assert_allclose(rings.get_edgecolor()[0, :3], to_rgb(FOCUS), atol=1e-6)
        assert axes.get_zlim3d()[1] >= 9.0 * 0.999
