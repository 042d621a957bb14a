"""GMRES against a direct solution, and how it stops."""

import numpy as np
import pytest

from airtact.acoustics.solvers.shared import gmres
from faults import raises_code


def system(seed: int = 0, size: int = 80):
    pick = np.random.default_rng(seed)
    matrix = np.eye(size) + 0.05 * (
        pick.normal(size=(size, size)) + 1j * pick.normal(size=(size, size))
    )
    return matrix, pick.normal(size=(size, 3)) + 1j * pick.normal(size=(size, 3))


@pytest.mark.parametrize(("kind", "tolerance"), [(np.complex64, 1e-4), (np.complex128, 1e-10)])
def test_every_column_is_solved_to_the_tolerance(kind, tolerance):
    matrix, right = system()
    found = gmres(lambda v: v @ matrix.T.astype(kind), right.T.astype(kind), tolerance)
    exact = np.linalg.solve(matrix, right)
    assert found.solution.T.dtype == kind
    assert np.linalg.norm(found.solution.T - exact) < 10 * tolerance * np.linalg.norm(exact)
    left = np.linalg.norm(matrix @ found.solution.T - right, axis=0) / np.linalg.norm(right, axis=0)
    assert np.allclose(left, found.residuals, atol=tolerance)


@pytest.mark.parametrize(
    "matrix",
    [
        # as many different eigenvalues as steps are needed
        *(np.diag(np.exp(1j * np.arange(size))) for size in (1, 2, 5)),
        np.roll(np.eye(4), 1, axis=0),  # nothing is gained before the last step
    ],
)
def test_an_exhausted_krylov_space_gives_the_exact_solution(matrix):
    right = np.eye(len(matrix), dtype=complex)[:1] + (0 if matrix.dtype == float else 0.5 + 0.2j)
    found = gmres(lambda v: v @ matrix.T, right, 1e-9)
    assert found.iterations == len(matrix)
    assert np.allclose(matrix @ found.solution[0], right[0], atol=1e-8)


def near_resonance(size: int = 120, small: int = 20):
    """Make a matrix with some eigenvalues down to 0.01, as cavities have, and right-hand sides."""
    pick = np.random.default_rng(3)
    across = np.linalg.qr(pick.normal(size=(size, size)) + 1j * pick.normal(size=(size, size)))[0]
    values = np.concatenate([np.geomspace(0.01, 0.8, small), np.linspace(0.8, 1.2, size - small)])
    parts = np.concatenate([np.full(small, 0.1), np.ones(size - small)])
    return (across * values) @ across.conj().T, np.stack(
        [across @ parts, across @ (parts * 1j ** np.arange(size))], axis=1
    )


def test_iterations_go_on_where_a_small_residual_leaves_a_large_error():
    matrix, right = near_resonance()
    exact = np.linalg.solve(matrix, right).T
    stopped = {
        error: gmres(lambda v: v @ matrix.T, right.T, 0.01, error)
        for error in (np.inf, 0.05, 0.005)
    }
    for error, found in stopped.items():
        off = np.linalg.norm(found.solution - exact, axis=1) / np.linalg.norm(exact, axis=1)
        assert off.max() > 0.2 if error == np.inf else off.max() < error
    most = stopped[np.inf].iterations + 2
    last = gmres(lambda v: v @ matrix.T, right.T, 0.01, 0.0, most)
    assert last.iterations == most  # no fault: the residual is as small as asked


def test_well_conditioned_equations_take_no_further_iterations():
    matrix, right = system()
    plain, careful = (
        gmres(lambda v: v @ matrix.T, right.T, 1e-3, error) for error in (np.inf, 1e-9)
    )
    assert careful.iterations == plain.iterations


@pytest.mark.parametrize(
    ("product", "right"),
    [
        (lambda v: v @ system()[0].T, system()[1].T),  # stopped short
        (lambda v: np.full_like(v, np.nan), np.ones((2, 5), complex)),
        (lambda v: 0 * v, np.ones((1, 4), complex)),
    ],
    ids=["slow", "NaN", "zero"],
)
def test_what_does_not_reach_the_tolerance_does_not_count_as_solved(product, right):
    with raises_code("not_converged"):
        gmres(product, right, 1e-10, most_iterations=3)


@pytest.mark.parametrize("strength", [1e-24, 1e20])
def test_squares_beyond_single_precision_do_no_harm(strength):
    matrix = (np.eye(20) + 0.01).astype(np.complex64)
    right = np.full((1, 20), strength, np.complex64)
    found = gmres(lambda vectors: vectors @ matrix.T, right, 1e-3)
    assert np.allclose(found.solution @ matrix.T / strength, 1.0, atol=1e-3)
