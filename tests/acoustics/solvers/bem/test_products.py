"""Rounded matrices against those that they stand for."""

import numpy as np
import pytest

from airtact.acoustics.solvers.bem.reduced_body import (
    MAX_COMPILED_VECTORS,
    RoundedMatrix,
    product,
    rounded,
)

pick = np.random.default_rng(0)


def some(*shape: int) -> np.ndarray:
    return pick.normal(size=shape) + 1j * pick.normal(size=shape)


@pytest.mark.parametrize("transposed", [False, True])
@pytest.mark.parametrize("count", [1, 2, MAX_COMPILED_VECTORS, MAX_COMPILED_VECTORS + 1])
def test_products_are_right_to_the_rounding(count, transposed):
    matrix = (some(60, 80) * np.geomspace(1e-15, 1e15, 60)[:, None]).astype(np.complex64)
    matrix[3] = 0
    kept = rounded(matrix, 0.01)
    assert isinstance(kept, RoundedMatrix)
    vectors = some(count, 60 if transposed else 80)
    exact = vectors @ (matrix if transposed else matrix.T).astype(complex)
    found = product(kept, vectors, transposed)
    assert found.dtype == np.complex64
    if transposed:
        assert np.linalg.norm(found - exact) < 1e-3 * np.linalg.norm(exact)
    else:
        rows = np.linalg.norm(exact, axis=0)
        assert (np.linalg.norm(found - exact, axis=0) <= 1e-3 * rows).all()


def test_a_matrix_stays_as_it_is_where_rounding_would_cost_more_than_asked():
    matrix = some(40, 50).astype(np.complex64)
    assert rounded(matrix, 1e-5) is matrix
    assert rounded(matrix.astype(complex), 0.1).dtype == np.complex128
    one_large = matrix.copy()
    one_large[:, 0] *= 1e4  # of each row: the others fall below the scale
    kept = rounded(one_large, 1e-3)
    assert isinstance(kept, RoundedMatrix)
    assert np.linalg.norm(kept.as_complex() - one_large) < 1e-4 * np.linalg.norm(one_large)
