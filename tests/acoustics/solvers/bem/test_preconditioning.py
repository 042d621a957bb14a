"""The inverses of the diagonal blocks, and the iteration that they precondition."""

from dataclasses import replace

import numpy as np
import pytest

import airtact as at
from airtact import _kernels
from airtact.acoustics.solvers.bem.block_matrix import iterate
from airtact.acoustics.solvers.bem.solutions import assemble
from airtact.acoustics.solvers.shared import gmres
from airtact.timing import Clock
from worlds import one_each, two_fingers

RANDOM = np.random.default_rng(4)


@pytest.mark.parametrize("size", [1, 7, 96])
@pytest.mark.parametrize(("precision", "error"), [(np.complex64, 2e-3), (np.complex128, 1e-10)])
def test_blocks_are_inverted_even_where_the_first_pivot_is_zero(size, precision, error):
    blocks = (
        RANDOM.normal(size=(3, size, size)) + 1j * RANDOM.normal(size=(3, size, size))
    ).astype(precision)
    if size > 1:
        blocks[1, 0, 0] = 0
    inverses = blocks.copy()
    _kernels.invert_blocks(inverses)
    assert np.abs(inverses @ blocks - np.eye(size)).max() < error


@pytest.fixture(scope="module")
def surface():
    scene = two_fingers(6e-3, 20.0, gap=1e-3, length=0.02)
    source = one_each(np.array([[0.0, 0.0, 0.06]]))
    solver = at.BoundaryElement(accuracy=0.1)
    return solver._prepared(scene, source.refined_positions, Clock()).surface


@pytest.mark.parametrize("transposed", [False, True])
@pytest.mark.parametrize(
    ("store", "error"), [("bfloat16", 5e-3), ("float32", 1e-5), ("float64", 1e-9)]
)
def test_the_solution_is_that_of_the_whole_matrix_after_fewer_steps(
    surface, store, error, transposed
):
    precision = "float64" if store == "float64" else "float32"
    surface = replace(surface, precision=precision)
    dense = assemble(surface, precision).dense()
    unknowns = len(dense)
    assert unknowns % _kernels.lanes  # the last block is not full
    matrix = assemble(surface, store)
    right = RANDOM.normal(size=(2, unknowns)) + 0j
    right = right.astype(matrix.precision)
    found = iterate([matrix], right, transposed, 0.1 * error)
    exact = np.linalg.solve(dense.T if transposed else dense, right.T).T
    assert np.linalg.norm(found.solution - exact) < error * np.linalg.norm(exact)
    plain = gmres(lambda vectors: matrix.times(vectors, transposed), right, 0.1 * error)
    assert found.iterations < plain.iterations
