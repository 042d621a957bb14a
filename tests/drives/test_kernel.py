"""The compiled Gerchberg-Saxton against a NumPy twin that shares no code with it."""

import numpy as np
import pytest

from airtact import _kernels

pytestmark = pytest.mark.usefixtures("variant")


def twin(matrix, expected, sources, iterations, weighted):
    """Return the sources, the worst share and the drive of the best iteration, or of the last where not weighted."""
    asked = expected > 0
    matrix = matrix[asked]
    expected = expected[asked]
    sources = sources[asked]
    weight = np.abs(sources)
    kept = sources
    reached = -1.0
    before = 0.0 * expected
    damping = 1.0
    for _ in range(iterations):
        sent = matrix.conj().T @ sources
        pressure = matrix @ (sent / np.abs(sent))
        share = np.abs(pressure) / expected
        if not weighted or share.min() > reached:
            kept = sources
            reached = share.min()
        step = np.log(share.mean() / share)
        damping = 0.7 * damping if step @ before < -0.5 * (before @ before) else damping
        weight = weight * np.exp(damping * step) if weighted else weight
        before = step
        weight = weight / weight.max()
        sources = weight * pressure / np.abs(pressure)
    sent = matrix.conj().T @ kept
    return kept, reached, sent / np.abs(sent)


def compiled(matrix, rows, expected, sources, iterations, weighted, between_foci=0):
    planes = [np.ascontiguousarray(part, dtype=np.float32) for part in (matrix.real, matrix.imag)]
    return _kernels.gerchberg_saxton(
        *planes,
        rows,
        expected.astype(np.float32),
        between_foci,
        iterations,
        weighted,
        sources.astype(np.complex64),
    )


@pytest.mark.parametrize("weighted", [True, False])
@pytest.mark.parametrize("elements", [5, 256, 700])
def test_every_set_is_taken_as_by_numpy(elements, weighted):
    random = np.random.default_rng(elements)
    matrix = random.normal(size=(12, elements)) + 1j * random.normal(size=(12, elements))
    rows = np.array([random.permutation(12)[:7] for _ in range(4)])
    expected = random.uniform(0.5, 1.0, rows.shape)
    expected[1, 2:] = expected[2, 3] = 0.0  # sets of 2 and of 6 foci
    start = random.uniform(0.5, 1.0, rows.shape) * np.exp(
        2j * np.pi * random.uniform(size=rows.shape)
    )
    sources, worst, drives = compiled(matrix, rows, expected, start, 4, weighted)
    for index, chosen in enumerate(rows):
        kept, reached, drive = twin(matrix[chosen], expected[index], start[index], 4, weighted)
        assert worst[index] == pytest.approx(reached, rel=1e-4)
        np.testing.assert_allclose(drives[index], drive, atol=2e-3)
        np.testing.assert_allclose(sources[index][expected[index] > 0], kept, atol=1e-4)


def test_an_element_that_reaches_no_focus_stays_silent():
    matrix = np.ones((2, 300), dtype=complex)
    matrix[:, 7] = 0.0
    _, worst, drives = compiled(
        matrix, np.array([[0, 1]]), np.ones((1, 2)), np.ones((1, 2), dtype=complex), 3, True
    )
    assert drives[0, 7] == 0.0
    assert worst[0] == pytest.approx(299.0)


def test_rows_that_are_not_there_are_rejected():
    with pytest.raises(IndexError, match="a row that the matrix does not have"):
        compiled(
            np.ones((2, 3), dtype=complex),
            np.array([[0, 2]]),
            np.ones((1, 2)),
            np.ones((1, 2)),
            1,
            True,
        )


@pytest.mark.parametrize("elements", [5, 700])
def test_going_between_foci_alone_is_taken_as_by_numpy(elements):
    random = np.random.default_rng(elements)
    matrix = random.normal(size=(7, elements)) + 1j * random.normal(size=(7, elements))
    expected = random.uniform(0.5, 1.0, 7)
    pressure = expected.astype(complex)
    for _ in range(6):
        pressure = matrix @ (matrix.conj().T @ (expected * pressure / np.abs(pressure)))
    sources = expected**2 * pressure / np.abs(pressure) ** 2
    start = expected[None].astype(complex)
    computed, _, _ = compiled(
        matrix, np.arange(7)[None], expected[None], start, 1, True, between_foci=6
    )
    np.testing.assert_allclose(computed[0], sources / np.abs(sources).max(), atol=1e-4)
