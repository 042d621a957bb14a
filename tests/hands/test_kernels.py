"""The compiled distance of a hand's body against NumPy twins that share no code with it, and even triangles."""

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import Delaunay

from airtact import _kernels
from airtact.geometry.mesh.triangles import edge_twins, enclosed_volume, panel_areas
from airtact.hands.body import Hulls
from airtact.hands.shape import curved_panels
from airtact.hands.skin_mesh import even_skin

BALLS = np.array(
    [
        [0, 0, 0, 9],
        [30, 2, 1, 6],
        [8, 26, -4, 11],
        [31, 3, 25, 5],
        [12, -14, 9, 7],
        [-9, -3, 2, 20],
    ],
    dtype=np.float64,
)
BALLS = 1e-3 * BALLS
PARTS = np.array([[0, 1, -1], [0, 1, 2], [1, 3, -1], [4, 3, -1], [0, 5, -1], [5, 0, 2]])


pytestmark = pytest.mark.usefixtures("variant")


def simplex(part: np.ndarray, fineness: int) -> np.ndarray:
    if part[2] < 0:
        shares = np.linspace(0, 1, 40 * fineness + 1)[:, None]
        return (1 - shares) * BALLS[part[0]] + shares * BALLS[part[1]]
    i, j = np.meshgrid(np.arange(fineness + 1), np.arange(fineness + 1))
    i, j = (index[i + j <= fineness, None] / fineness for index in (i, j))
    return (1 - i - j) * BALLS[part[0]] + i * BALLS[part[1]] + j * BALLS[part[2]]


def nearest_ball(points: np.ndarray, part: np.ndarray, fineness: int = 250) -> np.ndarray:
    """Least distance to so many balls that no more are needed (P,)."""
    balls = simplex(part, fineness)
    return np.array(
        [(np.linalg.norm(balls[:, :3] - point, axis=1) - balls[:, 3]).min() for point in points]
    )


def random_points(count: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(
        [-0.05, -0.04, -0.04], [0.05, 0.05, 0.05], (count, 3)
    )


def test_distance_to_each_hull_is_that_to_its_nearest_ball():
    points = random_points(60, 1)
    found = _kernels.hull_distances(points, BALLS, PARTS)
    for index, part in enumerate(PARTS):
        assert np.abs(found[:, index] - nearest_ball(points, part)).max() < 1e-6


def normals(points: np.ndarray, part: np.ndarray, step: float = 1e-6) -> np.ndarray:
    out = np.empty((2, *points.shape[::-1], len(PARTS)))
    for axis in range(3):
        for side, shift in enumerate((-step, step)):
            moved = points + shift * np.eye(3)[axis]
            out[side, axis] = _kernels.hull_distances(moved, BALLS, PARTS)
    return ((out[1] - out[0]) / (2 * step))[..., part].T


def gaps(
    points: np.ndarray, balls: np.ndarray, parts: np.ndarray, camera: np.ndarray | None = None
) -> tuple:
    """Distances, their derivatives by the balls, and hulls, without blending."""
    none = np.zeros((len(parts), len(parts)))
    return _kernels.hull_gaps(points, balls, parts, none, camera, -0.05)


@pytest.mark.parametrize("row", [False, True])
def test_gaps_change_with_balls_as_the_distance_does(row):
    balls = BALLS.copy()
    if row:  # no triangle, but three balls in a row
        balls[2, :3] = balls[0, :3] + 0.4 * (balls[1, :3] - balls[0, :3])
    points = random_points(40, 3)
    distance, by_balls, hull = gaps(points, balls, PARTS)
    each = _kernels.hull_distances(points, balls, PARTS)
    assert distance == pytest.approx(each.min(axis=1), abs=1e-15)
    assert np.take_along_axis(each, hull[:, None], axis=1)[:, 0] == pytest.approx(
        distance, abs=1e-15
    )
    for index in range(balls.size):
        moved = np.zeros(balls.size)
        moved[index] = 1e-7
        moved = moved.reshape(balls.shape)
        change = (
            gaps(points, balls + moved, PARTS)[0] - gaps(points, balls - moved, PARTS)[0]
        ) / 2e-7
        assert np.mean(np.abs(change - by_balls[:, index]) < 1e-5) >= (
            0.9 if row else 1.0
        )  # a row has a kink


def test_points_behind_a_ball_have_the_distance_of_its_front_or_its_rim():
    ball, camera = (
        np.array([[0.0, 0.0, 0.0, 0.01], [0.0, 0.0, 0.0, 0.01]]),
        np.array([0.0, 0.0, 1e6]),
    )
    points = np.array([[0.006, 0.0, -0.012], [0.0, 0.013, -0.02], [0.006, 0.0, 0.012]])
    distance, by_balls, _ = gaps(points, ball, np.array([[0, 1, -1]]), camera)
    front = np.array([0.6, 0.0, 0.8])
    wanted = [points[0] @ front - 0.01, 0.003, np.linalg.norm(points[2]) - 0.01]
    assert distance == pytest.approx(wanted, abs=1e-7)
    for row, normal in zip(
        by_balls, (front, [0.0, 1.0, 0.0], points[2] / np.linalg.norm(points[2])), strict=True
    ):
        assert row.reshape(2, 4).sum(axis=0) == pytest.approx(
            [*-np.asarray(normal), -1.0], abs=1e-4
        )


def test_blending_is_the_smooth_minimum():
    random = np.random.default_rng(3)
    blend = np.triu(random.uniform(0, 0.012, (6, 6)) * (random.random((6, 6)) < 0.7), 1)
    hulls = Hulls(BALLS, PARTS, blend + blend.T, np.zeros((6, 6)))
    points = random_points(4000, 2)
    each = hulls.each(points)
    near = np.sort(each, axis=1)
    points, each = (array[(np.abs(near[:, 0]) < 4e-3)] for array in (points, each))
    outward = np.stack([normals(points, part) for part in range(6)])
    expected = each.min(axis=1)
    for i in range(6):
        for j in range(i):
            turn = 0.5 * (1 - np.einsum("pi,pi->p", outward[i], outward[j]))
            width = np.maximum((blend + blend.T)[i, j] * turn, 1e-12)
            over = np.maximum(width - np.abs(each[:, i] - each[:, j]), 0)
            expected = np.minimum(
                expected, np.minimum(each[:, i], each[:, j]) - over**2 / (4 * width)
            )
    found = hulls.look(points)
    assert len(points) > 200
    assert np.mean(found.distance < each.min(axis=1) - 1e-5) > 0.03  # creases there are
    assert np.abs(found.distance - expected).max() < 1e-7
    assert np.array_equal(each[np.arange(len(points)), found.nearest], each.min(axis=1))


def test_what_stands_apart_is_carved_out_and_seen():
    balls = np.array([[0, 0, 0, 5], [30, 0, 0, 5], [0, 10.5, 0, 5], [30, 10.5, 0, 5]]) * 1e-3
    hulls = Hulls(balls, np.array([[0, 1, -1], [2, 3, -1]]), np.zeros((2, 2)), 1 - np.eye(2))
    points = 1e-3 * np.array([[15, 4.9, 0], [15, 5.1, 0], [15, -4.9, 0], [15, 3.0, 0.0]])
    assert hulls.look(points).distance == pytest.approx([-1e-4, 1e-4, -1e-4, -2e-3])
    carved = hulls.look(points, carve=2e-3)
    assert carved.distance == pytest.approx([1.4e-3, 1.6e-3, -1e-4, -0.5e-3])
    assert carved.facing == pytest.approx([0.6e-3, 0.4e-3, 10.4e-3, 2.5e-3])


def test_a_rod_is_covered_evenly_and_holds_its_volume():
    balls = np.array([[0, 0, 0, 0.008], [0.03, 0, 0, 0.008]])
    rod = Hulls.unblended(balls, np.array([[0, 1, -1]]))
    skin = even_skin(rod, 4e-3)
    panels = curved_panels(rod, skin)
    assert edge_twins(skin.triangles).min() >= 0
    assert skin.angles.min() > 30
    assert np.abs(rod.look(panels.reshape(-1, 3)).distance).max() < 1e-8
    assert enclosed_volume(panels) == pytest.approx(
        np.pi * 0.008**2 * (0.03 + 4 / 3 * 0.008), rel=2e-3
    )
    assert panel_areas(panels).sum() == pytest.approx(
        2 * np.pi * 0.008 * (0.03 + 2 * 0.008), rel=2e-3
    )


def test_sizes_grow_no_faster_than_the_way_over_edges_from_the_smallest():
    x, y = (index.ravel() for index in np.meshgrid(np.arange(12.0), np.arange(9.0)))
    vertices = np.column_stack([x, y, np.random.default_rng(5).uniform(0, 1, len(x))])
    triangles = Delaunay(vertices[:, :2] + 0.01 * vertices[:, 2:]).simplices.astype(np.int64)
    ends = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    ends = np.unique(np.sort(ends, axis=1), axis=0)
    lengths = np.linalg.norm(vertices[ends[:, 0]] - vertices[ends[:, 1]], axis=1)
    ways = dijkstra(coo_array((lengths, ends.T), shape=(len(x), len(x))).tocsr(), directed=False)
    asked = np.random.default_rng(6).uniform(0.5, 9, len(x))
    sizes = asked.copy()
    _kernels.grade_sizes(vertices, triangles, 0.35, 30, sizes)
    assert sizes == pytest.approx((asked + 0.35 * ways).min(axis=1))
