"""Tiles of panels, and the matrix whose far tiles are sums of crosses."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.distance import pdist

import airtact as at
from airtact.solvers.bem.blocks import PANELS, Pairs, blocks_of, in_blocks, near_tiles
from airtact.solvers.bem.layer_potentials import NearRule
from airtact.solvers.bem.operator import assemble, dual_surface
from airtact.solvers.bem.quadrature import place_nodes

WAVENUMBER = 732.5 + 0.2j


def stick(length: float) -> np.ndarray:
    """Panels of a stick, turned out of the axes."""
    shape = at.capsule((0, 0, 0), (0, 0, length), 0.005, 0.003).moved(at.Pose.turn((1, 2, 3), 0.7)).shape
    return shape.panels(3.4e-3, np.pi / 4)


def test_panels_of_a_tile_lie_together_and_no_panel_is_lost():
    centres = stick(0.08)[:, :3].mean(axis=1)
    order = in_blocks(centres)
    assert (np.sort(order) == np.arange(len(centres))).all()
    tiles = [centres[order[begin : begin + PANELS]] for begin in range(0, len(centres), PANELS)]
    assert len(tiles) == blocks_of(6 * len(centres)) > 4
    assert max(pdist(tile).max() for tile in tiles) < 0.014  # across the stick it is 0.01, and 0.09 along it


@pytest.mark.parametrize("seed", range(5))
def test_tiles_move_with_the_panels(seed):
    centres = stick(0.08)[:, :3].mean(axis=1)
    pose = at.Pose.turn(np.random.default_rng(seed).normal(size=3), 2.0, translation=(0.1, 0.2, -0.3))
    assert (in_blocks(pose.apply(centres)) == in_blocks(centres)).all()


def test_few_panels_are_one_tile():
    assert (in_blocks(np.zeros((3, 3))) == np.arange(3)).all()


def test_tiles_are_near_where_any_panel_is():
    first, near = np.array([0, 1, *[1] * (PANELS - 1), *[2] * 2]), np.array([PANELS, 0])
    met = near_tiles(PANELS + 2, first, near)
    assert met.tolist() == [[False, True], [True, False]]
    pairs = Pairs.of(met)
    assert (pairs.row.tolist(), pairs.column.tolist()) == ([0, 1], [1, 0])


def boxes(*places: float, size: tuple[float, float, float]) -> np.ndarray:
    """Panels of boxes over each other."""
    panels = []
    for place in places:
        mesh = trimesh.creation.box(size).subdivide().apply_translation((0, 0, place))
        panels.append(at.Surface(np.array(mesh.vertices), np.array(mesh.faces)).shape.panels(3.4e-3, np.pi / 4))
    return np.concatenate(panels)


@pytest.mark.parametrize(
    "panels",
    [
        pytest.param(lambda: boxes(0.0, size=(0.03, 0.025, 0.02)), id="flat faces that do not hear themselves"),
        pytest.param(lambda: boxes(0.0, size=(0.035, 0.025, 0.002)), id="a thin plate"),
        pytest.param(
            lambda: boxes(-0.008, 0.0, 0.4, size=(0.02, 0.02, 0.003)), id="plates beside each other and far off"
        ),
    ],
)
def test_crosses_miss_nothing(panels):
    """Each far tile is held against its entries: rows may hide a part of it that others show."""
    centres = panels()[:, :3].mean(axis=1)
    order, nothing = in_blocks(centres), np.zeros(len(centres))
    nodes = place_nodes(panels()[order], nothing.astype(np.int64), nothing)
    surface = dual_surface(nodes, WAVENUMBER, NearRule(1.6, (4, 4)), "float32")
    dense, lanes, error = assemble(surface, "float32").dense(), 6 * PANELS, 5e-3
    matrix = assemble(surface, "float32", error)
    assert len(matrix.crosses) > 5
    left = []
    for row, column, count, begin in zip(matrix.far.row, matrix.far.column, matrix.crosses, matrix.begin, strict=True):
        exact = dense[lanes * row : lanes * (row + 1), lanes * column : lanes * (column + 1)]
        lines = matrix.rows[begin : begin + 2 * count, 0] + 1j * matrix.rows[begin : begin + 2 * count, 1]
        kept = lines[count:, : len(exact)].T @ lines[:count, : exact.shape[1]]
        left.append(np.linalg.norm(kept - exact))
    half = 0.5 * np.sqrt(matrix.count)
    assert np.linalg.norm(left) < error * half
    assert max(left) < 10 * error * half / len(matrix.whole.first)


@pytest.mark.parametrize("store", ["bfloat16", "float32", "float64"])
def test_a_matrix_of_crosses_is_as_good_as_asked_and_better_when_more_is(store):
    panels = stick(0.08)
    order = in_blocks(panels[:, :3].mean(axis=1))
    nothing = np.zeros(len(panels))
    nodes = place_nodes(panels[order], nothing.astype(np.int64), nothing)
    precision = "float64" if store == "float64" else "float32"
    surface = dual_surface(nodes, WAVENUMBER, NearRule(1.6, (4, 4)), precision)
    whole = assemble(surface, store)
    assert not whole.far.column.size
    random = np.random.default_rng(1)
    vectors = random.normal(size=(3, whole.count)) + 1j * random.normal(size=(3, whole.count))
    rounding = {"bfloat16": 2e-3, "float32": 1e-5, "float64": 1e-12}[store]
    kept = []
    for error in (0.03, 1e-3, 1e-5):
        matrix = assemble(surface, store, error)
        kept.append(len(matrix.tiles) / len(whole.tiles) + matrix.crosses.mean() * 2 / matrix.tiles.shape[1])
        for transposed in (False, True):
            exact = whole.times(vectors, transposed)
            off = np.linalg.norm(matrix.times(vectors, transposed) - exact) / np.linalg.norm(exact)
            assert off < error + rounding
    assert kept == sorted(kept)
    assert kept[0] < 0.7
