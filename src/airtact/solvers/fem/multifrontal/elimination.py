"""Multifrontal elimination of a complex symmetric matrix in single precision (I. Duff, J. Reid, ACM TOMS 9 (1983) 302).

A front gathers the entries of the unknowns that it eliminates, and what its children leave. With A the block of those
unknowns, B the rows of its border and C the rest, it keeps A⁻¹ and X = A⁻¹ Bᵀ, and leaves C − B X to a later front.
Nearly all the work is done by products of dense matrices.
"""

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Bool, Complex64, Int32, Int64
from scipy.linalg import get_blas_funcs, get_lapack_funcs
from scipy.sparse import csr_array

from airtact.conventions import InvalidInput
from airtact.printing import in_short
from airtact.solvers.fem.multifrontal.nested_dissection import Dissection
from airtact.solvers.threads import one_thread_each, thread_count

TRIANGLES, BY_TRIANGLES, SWAPPED = get_lapack_funcs(("getrf", "getrs", "laswp"), dtype=np.complex64)
"""LAPACK's factorisation of a matrix in single precision, the solution by it, and rows as it swaps them."""

(BY_ONE_TRIANGLE,) = get_blas_funcs(("trsv",), dtype=np.complex64)
"""Solution by one triangle for one column: twice as quick as LAPACK's for several."""

BLOCK = 384
"""Columns that are left to later fronts at once, from the diagonal down: what is above follows by symmetry."""

SHIFT = 1e-4
"""Absorption added to the diagonal, as a share of it: or a part that resonates would leave no digits of its front.

Refinement takes it away again. Without it single precision failed for one in some ten scenes of 10⁵ unknowns.
"""

RUN = 6
"""Entries in a row that are added together sooner than one by one, about."""


@dataclass(frozen=True, eq=False)
class Entries:
    """Entries of the matrix, those of each front together.

    Attributes
    ----------
    rows, columns : (E,) unknowns; the column's is eliminated first.
    values : (E,) entries.
    ends : (F + 1,) where those of each front begin and end.
    """

    rows: Int32[np.ndarray, "entries"]
    columns: Int32[np.ndarray, "entries"]
    values: Complex64[np.ndarray, "entries"]
    ends: Int64[np.ndarray, "ends"]

    __repr__ = in_short

    def only(self, chosen: Bool[np.ndarray, "unknowns"]) -> "Entries":
        """Entries of some of the unknowns."""
        kept = chosen[self.rows] & chosen[self.columns]
        if kept.all():
            return self
        ends = np.concatenate([[0], np.cumsum(kept)])[self.ends]
        return Entries(self.rows[kept], self.columns[kept], self.values[kept], ends)


@dataclass(frozen=True, eq=False)
class Eliminated:
    """What a front keeps.

    Attributes
    ----------
    own, border : (N,) and (M,) unknowns, as in ``Front``.
    factor, swaps : A as triangles, by LAPACK. (Its inverse would leave ten times as much of a load.)
    solved : (N, M) X.
    """

    own: Int64[np.ndarray, "own"]
    border: Int64[np.ndarray, "border"]
    factor: Complex64[np.ndarray, "own own"]
    swaps: Int32[np.ndarray, "own"]
    solved: Complex64[np.ndarray, "own border"]

    __repr__ = in_short


def sorted_entries(lower: csr_array, dissection: Dissection) -> Entries:
    """Sort the entries of a matrix by the fronts that gather them, with a little absorption.

    Parameters
    ----------
    lower : (U, U) the lower triangle and the diagonal.
    dissection : the fronts; unknowns that none eliminates are 0.
    """
    front = dissection.front.astype(np.int16 if len(dissection.fronts) < 2**15 else np.int32)
    count = np.diff(lower.indptr)
    one, other = np.repeat(front, count), front[lower.indices]
    first, later = np.minimum(one, other), one < other
    order = np.argsort(first, kind="stable")
    ends = np.searchsorted(first[order], np.arange(len(dissection.fronts) + 1))
    order = order[ends[0] :]  # before it are those that no front eliminates
    later = later[order]
    rows, columns = np.repeat(np.arange(len(front), dtype=np.int32), count)[order], lower.indices[order]
    values = lower.data[order].astype(np.complex64)
    diagonal = np.flatnonzero(rows == columns)
    values[diagonal] -= np.complex64(1j * SHIFT) * np.abs(values[diagonal])
    rows, columns = np.where(later, columns, rows), np.where(later, rows, columns)
    return Entries(rows, columns.astype(np.int32), values, ends - ends[0])


def eliminate(entries: Entries, dissection: Dissection) -> list[Eliminated]:
    """Eliminate all unknowns, front by front: those of separate subtrees side by side.

    Raises
    ------
    InvalidInput
        The matrix is singular.
    """
    work = _Work(entries, dissection)
    apart = {number for subtree in dissection.subtrees for number in subtree}
    last = [number for number in range(len(dissection.fronts)) if number not in apart]
    with one_thread_each(), ThreadPoolExecutor(thread_count()) as pool:
        found = [front for fronts in pool.map(work.eliminate, dissection.subtrees) for front in fronts]
        return found + work.eliminate(last, pool)


class _Work:
    """An elimination on its way."""

    def __init__(self, entries: Entries, dissection: Dissection) -> None:
        self.entries, self.dissection = entries, dissection
        self.left: dict[int, Any] = {}

    def eliminate(self, numbers: Sequence[int], pool: ThreadPoolExecutor | None = None) -> list[Eliminated]:
        """Eliminate some fronts in turn, sharing the large products among the threads of a pool."""
        place, found = np.empty(len(self.dissection.front), dtype=np.int64), []
        for number in numbers:
            front = self.dissection.fronts[number]
            count = len(front.own)
            place[front.own] = np.arange(count)
            place[front.border] = count + np.arange(len(front.border))
            block, below, rest = _gathered(self.entries, number, place, count, len(front.border))
            for child in front.children:
                _add(self.left.pop(child), place[self.dissection.fronts[child].border], block, below, rest)
            self.left[number] = rest
            if not count:
                continue
            factor, swaps, singular = TRIANGLES(block.T, overwrite_a=True)
            if singular:
                raise InvalidInput(
                    f"the matrix of finite elements is singular at front {number}; take 'sparsecholesky'."
                )
            solved = np.empty((count, len(below)), dtype=np.complex64, order="F")
            mapped = map if pool is None else pool.map
            starts = range(0, len(below), BLOCK)
            list(mapped(partial(_solve, solved, below, factor, swaps), starts))
            list(mapped(partial(_update, rest, below, solved), starts))
            found.append(Eliminated(front.own, front.border, factor, swaps, solved))
        return found


def _gathered(
    entries: Entries, number: int, place: Int64[np.ndarray, "unknowns"], count: int, border: int
) -> tuple[
    Complex64[np.ndarray, "own own"], Complex64[np.ndarray, "border own"], Complex64[np.ndarray, "border border"]
]:
    """Gather A, B and C of a front, before its children's are added."""
    block, below = np.zeros((count, count), dtype=np.complex64), np.zeros((border, count), dtype=np.complex64)
    mine = slice(entries.ends[number], entries.ends[number + 1])
    rows, columns, values = place[entries.rows[mine]], place[entries.columns[mine]], entries.values[mine]
    inner = rows < count
    block[rows[inner], columns[inner]] = values[inner]
    block[columns[inner], rows[inner]] = values[inner]
    below[rows[~inner] - count, columns[~inner]] = values[~inner]
    return block, below, np.zeros((border, border), dtype=np.complex64)


def _add(
    left: Complex64[np.ndarray, "left left"],
    place: Int64[np.ndarray, "left"],
    block: Complex64[np.ndarray, "own own"],
    below: Complex64[np.ndarray, "border own"],
    rest: Complex64[np.ndarray, "border border"],
) -> None:
    """Add what a child left, whose border begins with all that this front eliminates."""
    if not len(place):
        return
    count = len(block)
    corner = np.tril(left[:count, :count])
    block += corner + corner.T
    block[np.diag_indices(count)] -= corner.diagonal()
    rows = place[count:] - count
    below[rows] += left[count:, :count]
    runs = list(_runs(rows))
    if len(runs) * RUN > len(rows):
        rest[rows[:, None], rows] += left[count:, count:]
        return
    rest_left = left[count:, count:]
    for number, (here, there) in enumerate(runs):
        for column, beside in runs[: number + 1]:
            rest[there, beside] += rest_left[here, column]


def _runs(rows: Int64[np.ndarray, "rows"]) -> Iterator[tuple[slice, slice]]:
    """Stretches of rows that follow each other: where they are in the list, and which they are."""
    ends = np.flatnonzero(np.diff(rows) != 1) + 1
    for start, end in zip([0, *ends.tolist()], [*ends.tolist(), len(rows)], strict=True):
        if end > start:
            yield slice(start, end), slice(int(rows[start]), int(rows[end - 1]) + 1)


def _solve(
    solved: Complex64[np.ndarray, "own border"],
    below: Complex64[np.ndarray, "border own"],
    factor: Complex64[np.ndarray, "own own"],
    swaps: Int32[np.ndarray, "own"],
    start: int,
) -> None:
    block = slice(start, start + BLOCK)
    solved[:, block] = BY_TRIANGLES(factor, np.array(swaps), below[block].T)[0]  # which changes its swaps for a while


def _update(
    rest: Complex64[np.ndarray, "border border"],
    below: Complex64[np.ndarray, "border own"],
    solved: Complex64[np.ndarray, "own border"],
    start: int,
) -> None:
    rest[start:, start : start + BLOCK] -= below[start:] @ solved[:, start : start + BLOCK]


def solve(
    eliminated: list[Eliminated], right: Complex64[np.ndarray, "unknowns sounds"]
) -> Complex64[np.ndarray, "unknowns sounds"]:
    """Solution for each column, good to single precision; unknowns that no front eliminated stay as they are.

    In one thread: it takes as long as reading the factors from memory does.
    """
    found = np.array(right)
    with one_thread_each():
        for front in eliminated:
            mine = found[front.own]
            found[front.border] -= front.solved.T @ mine
            found[front.own] = _by_triangles(front.factor, front.swaps, mine)
        for front in reversed(eliminated):
            found[front.own] -= front.solved @ found[front.border]
    return found


def _by_triangles(
    factor: Complex64[np.ndarray, "own own"],
    swaps: Int32[np.ndarray, "own"],
    right: Complex64[np.ndarray, "own sounds"],
) -> Complex64[np.ndarray, "own sounds"]:
    if right.shape[1] > 1 or not len(right):
        return BY_TRIANGLES(factor, swaps, right)[0]
    column = BY_ONE_TRIANGLE(factor, SWAPPED(right, swaps)[:, 0], lower=True, diag=True)
    return BY_ONE_TRIANGLE(factor, column)[:, None]
