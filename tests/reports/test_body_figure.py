"""Pictures of bodies, of their panels and of faults show what is there, in proportion and in order."""

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread
from mpl_toolkits.mplot3d import Axes3D

import airtact as at
from airtact.reports.body_figure import draw_bodies, draw_panels, sharp_edges
from airtact.reports.page import write_picture
from airtact.reports.solids import add_solid, broad_view, space_axes
from geometry.mesh.meshes import box_mesh

BOX = at.Surface(*box_mesh())
BALL = at.sphere(0.01, 3e-3)


def spaces(figure) -> list[Axes3D]:
    return [axes for axes in figure.axes if isinstance(axes, Axes3D)]


def pixels(tmp_path, figure) -> np.ndarray:
    write_picture(tmp_path / "picture.png", figure)
    assert [entry.name for entry in tmp_path.iterdir()] == ["picture.png"]
    return imread(tmp_path / "picture.png")[:, :, :3]


@pytest.mark.parametrize(
    "draw",
    [
        lambda: draw_panels(BALL.panelled(4e-3).quadratic_triangles),
        lambda: draw_bodies([BALL], ["a"]),
    ],
)
def test_a_body_is_seen_from_two_opposite_sides_in_proportion(draw):
    left, right = spaces(draw())
    assert left.elev == -right.elev
    assert (left.azim - right.azim) % 360 == 180
    for axes in (left, right):
        limits = np.array([axes.get_xlim3d(), axes.get_ylim3d(), axes.get_zlim3d()])
        assert np.all(np.abs(limits) >= 9.9)  # millimetres
        np.testing.assert_allclose(
            np.ptp(limits, axis=1),
            np.asarray(axes._box_aspect) * np.ptp(limits[0]) / axes._box_aspect[0],
        )


def test_sharp_edges_are_those_of_the_box_wherever_it_stands():
    moved = BOX.moved(at.Pose.turn((0, 1, 0), 0.3, (0.1, 0, 0)))
    assert (
        sharp_edges(BOX).sum() == sharp_edges(moved).sum() == 24
    )  # twelve edges, each of two triangles
    assert not sharp_edges(BALL).any()
    lengths = BOX.edge_lengths[sharp_edges(BOX)]
    assert lengths.sum() == pytest.approx(2 * 4 * (0.02 + 0.03 + 0.04))


def test_what_looks_away_is_left_out():
    axes = space_axes(Figure(), broad_view(BOX.vertices))
    add_solid(axes, BOX.corners, np.ones((12, 4)))
    assert len(axes.collections[0].get_facecolor()) == 6
