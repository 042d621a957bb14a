"""Blocks of panels, and the matrix whose far blocks are sums of low-rank terms."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.distance import pdist

import airtact as at
from airtact.acoustics.solvers.bem.block_matrix import (
    PANELS,
    block_order,
    blocks_of,
)
from airtact.acoustics.solvers.bem.layer_potentials import NearRule
from airtact.acoustics.solvers.bem.quadrature import place_nodes
from airtact.acoustics.solvers.bem.solutions import DualSurface, assemble, dual_surface

WAVENUMBER = 732.5 + 0.2j


def stick(length: float) -> np.ndarray:
    shape = (
        at.capsule((0, 0, 0), (0, 0, length), 0.005, 0.003)
        .moved(at.Pose.turn((1, 2, 3), 0.7))
        .shape
    )
    return shape.panels(3.4e-3, np.pi / 4)


def test_panels_of_a_block_lie_together_and_no_panel_is_lost():
    centres = stick(0.08)[:, :3].mean(axis=1)
    order = block_order(centres)
    assert (np.sort(order) == np.arange(len(centres))).all()
    blocks = [centres[order[begin : begin + PANELS]] for begin in range(0, len(centres), PANELS)]
    assert len(blocks) == blocks_of(6 * len(centres)) > 4
    assert (
        max(pdist(block).max() for block in blocks) < 0.014
    )  # across the stick it is 0.01, and 0.09 along it


def surface_of(panels: np.ndarray, precision: str) -> DualSurface:
    ordered, nothing = panels[block_order(panels[:, :3].mean(axis=1))], np.zeros(len(panels))
    nodes = place_nodes(ordered, nothing.astype(np.int64), nothing)
    return dual_surface(nodes, WAVENUMBER, NearRule(1.6, (4, 4)), precision)


def boxes(*heights: float, size: tuple[float, float, float]) -> np.ndarray:
    panels = []
    for height in heights:
        mesh = trimesh.creation.box(size).subdivide().apply_translation((0, 0, height))
        panels.append(
            at.Surface(np.array(mesh.vertices), np.array(mesh.faces)).shape.panels(
                3.4e-3, np.pi / 4
            )
        )
    return np.concatenate(panels)


@pytest.mark.parametrize(
    "panels",
    [
        pytest.param(
            lambda: boxes(0.0, size=(0.03, 0.025, 0.02)),
            id="flat faces without a double layer on themselves",
        ),
        pytest.param(lambda: boxes(0.0, size=(0.035, 0.025, 0.002)), id="a thin plate"),
        pytest.param(
            lambda: boxes(-0.008, 0.0, 0.4, size=(0.02, 0.02, 0.003)),
            id="plates beside each other and far away",
        ),
    ],
)
def test_low_rank_terms_miss_nothing(panels):
    """Each far block is compared with its entries: some rows may lack a part that others have."""
    surface = surface_of(panels(), "float32")
    dense, lanes, error = assemble(surface, "float32").dense(), 6 * PANELS, 5e-3
    matrix = assemble(surface, "float32", error)
    assert len(matrix.far.ranks) > 5
    errors = []
    for row, column, count, begin in zip(
        np.repeat(np.arange(len(matrix.far.first) - 1), np.diff(matrix.far.first)),
        matrix.far.column,
        matrix.far.ranks,
        matrix.far.begin,
        strict=True,
    ):
        exact = dense[lanes * row : lanes * (row + 1), lanes * column : lanes * (column + 1)]
        lines = (
            matrix.factors[begin : begin + 2 * count, 0]
            + 1j * matrix.factors[begin : begin + 2 * count, 1]
        )
        found = lines[count:, : len(exact)].T @ lines[:count, : exact.shape[1]]
        errors.append(np.linalg.norm(found - exact))
    half = 0.5 * np.sqrt(matrix.count)
    assert np.linalg.norm(errors) < error * half
    assert max(errors) < 10 * error * half / len(matrix.whole.first)


@pytest.mark.parametrize("store", ["bfloat16", "float32", "float64"])
def test_a_matrix_of_low_rank_terms_has_the_error_asked_for(store):
    surface = surface_of(stick(0.08), "float64" if store == "float64" else "float32")
    whole = assemble(surface, store)
    assert not whole.far.column.size
    random = np.random.default_rng(1)
    vectors = random.normal(size=(3, whole.count)) + 1j * random.normal(size=(3, whole.count))
    rounding = {"bfloat16": 2e-3, "float32": 1e-5, "float64": 1e-12}[store]
    stored = []
    for error in (0.03, 1e-4):
        matrix = assemble(surface, store, error)
        stored.append(
            len(matrix.blocks) / len(whole.blocks)
            + matrix.far.ranks.mean() * 2 / matrix.blocks.shape[1]
        )
        for transposed in (False, True):
            exact = whole.times(vectors, transposed)
            off = np.linalg.norm(matrix.times(vectors, transposed) - exact) / np.linalg.norm(exact)
            assert off < error + rounding
    assert stored == sorted(stored)
    assert stored[0] < 0.7
