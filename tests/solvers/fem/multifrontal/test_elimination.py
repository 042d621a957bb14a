"""Orders of finite elements and the elimination of their matrix, by themselves."""

import numpy as np
import pytest
from scipy.sparse import csr_array

import airtact as at
from airtact.solvers.fem.multifrontal.elimination import eliminate, solve, sorted_entries
from airtact.solvers.fem.multifrontal.nested_dissection import dissected
from airtact.solvers.fem.orders import longest_served


def test_longer_edges_get_higher_orders():
    served = longest_served(5, 0.9)
    assert served[4] == pytest.approx(0.9)
    assert (np.diff(served) > 0).all()
    assert (longest_served(5, 0.9, ease=3.0) > served).all()
    degree = np.arange(1, 7)  # a polynomial of each through Chebyshev's points misses e^{ikx} by as much as the others
    missed = []
    for order, length in zip(degree, served, strict=False):
        wave = np.polynomial.Chebyshev.interpolate(
            lambda x: np.cos(2 * np.pi * x), order, domain=[0.25 - length / 2, 0.25 + length / 2]
        )
        shifted = np.polynomial.Chebyshev.interpolate(
            lambda x: np.sin(2 * np.pi * x), order, domain=[0.25 - length / 2, 0.25 + length / 2]
        )
        x = np.linspace(0.25 - length / 2, 0.25 + length / 2, 400)
        missed.append(np.abs(wave(x) + 1j * shifted(x) - np.exp(2j * np.pi * x)).max())
    assert max(missed) < 2 * min(missed)


def test_fronts_solve_a_matrix_of_random_numbers():
    """Tetrahedra in a row, each with three unknowns of its own and two that it shares with the next."""
    chance, count = np.random.default_rng(0), 60
    unknowns = (5 * np.arange(count)[:, None] + np.arange(7))[:, :7]
    size = int(unknowns.max()) + 1
    matrix = np.zeros((size, size), dtype=np.complex128)
    for own in unknowns:
        part = chance.normal(size=(7, 7)) + 1j * chance.normal(size=(7, 7))
        matrix[np.ix_(own, own)] += part + part.T + 8 * np.eye(7)
    order = dissected(np.repeat(np.arange(count), 7), unknowns.ravel(), size)
    assert sorted(np.concatenate([front.own for front in order.fronts])) == list(range(size))
    kept = chance.random(size) < 0.9
    for chosen in (np.ones(size, dtype=bool), kept):
        entries = sorted_entries(csr_array(np.tril(matrix)), order).only(chosen)
        fronts = eliminate(entries, order.only(chosen))
        right = np.where(chosen[:, None], chance.normal(size=(size, 2)), 0).astype(np.complex64)
        found = solve(fronts, right)[chosen]
        shifted = matrix - 1e-4j * np.diag(np.abs(matrix.diagonal()))
        exact = np.linalg.solve(shifted[np.ix_(chosen, chosen)], right[chosen])
        assert np.linalg.norm(found - exact) < 1e-5 * np.linalg.norm(exact)


def test_a_singular_matrix_is_refused():
    order = dissected(np.zeros(2, dtype=np.int64), np.arange(2), 2)
    with pytest.raises(at.InvalidInput, match="singular at front 0; take 'sparsecholesky'"):
        eliminate(sorted_entries(csr_array((2, 2), dtype=np.complex128), order), order)
