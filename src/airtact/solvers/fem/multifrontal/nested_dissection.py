"""Nested dissection of tetrahedra: in which order unknowns are eliminated, and which fronts that takes.

METIS halves the tetrahedra again and again. Unknowns that only the tetrahedra of one smallest part have are eliminated
first, then those that two neighbouring parts share, and so on to those on the first cut (A. George, SIAM J. Numer.
Anal. 10 (1973) 345). Each step is a small dense matrix, a front.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int64
from scipy.sparse import csr_array

from airtact.printing import in_short

SMALLEST = 24
"""Tetrahedra in the smallest parts, about."""

SEPARATE = 3
"""Halvings after which parts are eliminated side by side."""


@dataclass(frozen=True, eq=False)
class Front:
    """A step of the elimination.

    Attributes
    ----------
    own : (N,) unknowns that are eliminated here.
    border : (M,) unknowns that they meet and that are eliminated later, the next to be so first.
    children : fronts that come before, and whose borders hold ``own``.
    """

    own: Int64[np.ndarray, "own"]
    border: Int64[np.ndarray, "border"]
    children: tuple[int, ...]

    __repr__ = in_short


@dataclass(frozen=True, eq=False)
class Dissection:
    """Fronts in the order in which they are eliminated.

    Attributes
    ----------
    fronts : children before those that they are children of.
    front : (U,) where each unknown is eliminated; -1 for those that are not.
    subtrees : fronts that need none of the others', to be eliminated side by side, before those in none.
    """

    fronts: tuple[Front, ...]
    front: Int64[np.ndarray, "unknowns"]
    subtrees: tuple[range, ...]

    __repr__ = in_short

    def only(self, chosen: Bool[np.ndarray, "unknowns"]) -> "Dissection":
        """Fronts of some of the unknowns."""
        fronts = [
            Front(front.own[chosen[front.own]], front.border[chosen[front.border]], front.children)
            for front in self.fronts
        ]
        return Dissection(tuple(fronts), np.where(chosen, self.front, -1), self.subtrees)


def halved(
    tetrahedra: Int64[np.ndarray, "pairs"], unknowns: Int64[np.ndarray, "pairs"]
) -> tuple[Int64[np.ndarray, "tetrahedra"], int]:
    """Part of each tetrahedron, and how often they were halved: the digits of a part, as bits, tell its halves.

    Parameters
    ----------
    tetrahedra, unknowns : which tetrahedron has which unknown, pair by pair.
    """
    import pymetis

    shape = (int(tetrahedra.max()) + 1, int(unknowns.max()) + 1)
    pattern = csr_array((np.ones(len(tetrahedra), dtype=np.int64), (tetrahedra, unknowns)), shape=shape)
    shared = (pattern @ pattern.T).tocoo()
    apart = shared.row != shared.col
    graph = csr_array((shared.data[apart], (shared.row[apart], shared.col[apart])), shape=shared.shape)
    halvings = max(int(np.ceil(np.log2(shape[0] / SMALLEST))), 0)
    _, part = pymetis.part_graph(
        2**halvings,
        pymetis.CSRAdjacency(graph.indptr.astype(np.int32), graph.indices.astype(np.int32)),  # pyright: ignore
        eweights=graph.data.astype(np.int32),  # pyright: ignore
        recursive=True,
    )
    return np.array(part, dtype=np.int64), halvings


def dissected(tetrahedra: Int64[np.ndarray, "pairs"], unknowns: Int64[np.ndarray, "pairs"], count: int) -> Dissection:
    """Fronts of a mesh.

    An unknown belongs to the smallest part of the halving that holds all tetrahedra that have it.

    Parameters
    ----------
    tetrahedra, unknowns : which tetrahedron has which unknown, pair by pair.
    count : unknowns in all.
    """
    part, halvings = halved(tetrahedra, unknowns)
    part = part[tetrahedra]
    first, last = np.full(count, 2**halvings), np.full(count, -1)
    np.minimum.at(first, unknowns, part)
    np.maximum.at(last, unknowns, part)
    depth = np.where(last >= 0, halvings - np.frexp(first ^ last)[1], -1).astype(np.int64)
    rank = np.empty(count, dtype=np.int64)
    order = np.lexsort((first, -depth))
    rank[order] = np.arange(count)
    return _in_order(list(_levels(part, rank[unknowns], order, depth, halvings)), count)


def _levels(
    part: Int64[np.ndarray, "pairs"],
    ranks: Int64[np.ndarray, "pairs"],
    order: Int64[np.ndarray, "unknowns"],
    depth: Int64[np.ndarray, "unknowns"],
    halvings: int,
) -> Iterator[tuple[int, int, Int64[np.ndarray, "mine"], int]]:
    """Level, part, unknowns in their order, and how many are eliminated there: from the smallest parts to the whole."""
    count, holder = len(order), part
    for level in range(halvings, -1, -1):
        pairs = np.sort(holder * count + ranks)
        pairs = pairs[np.diff(pairs, prepend=-1) > 0]  # np.unique takes ten times as long
        holder, ranks = pairs // count, pairs % count
        kept = depth[order[ranks]] <= level
        holder, ranks = holder[kept], ranks[kept]
        unknowns, ends = order[ranks], np.searchsorted(holder, np.arange(2**level + 1))
        for one in range(2**level):
            mine = unknowns[ends[one] : ends[one + 1]]
            yield level, one, mine, int(np.count_nonzero(depth[mine] == level))
        holder = holder >> 1


def _in_order(levels: list[tuple[int, int, Int64[np.ndarray, "_"], int]], count: int) -> Dissection:
    """Order the fronts so that each follows its children, and little is left waiting."""
    halvings = levels[0][0]
    last = [((one + 1) << (halvings - level)) - 1 for level, one, _, _ in levels]
    order = np.lexsort(([-level for level, _, _, _ in levels], last))
    number = {levels[place][:2]: place_in_order for place_in_order, place in enumerate(order.tolist())}
    fronts, front = [], np.full(count, -1)
    for place in order.tolist():
        level, one, mine, cut = levels[place]
        children = () if level == halvings else (number[level + 1, 2 * one], number[level + 1, 2 * one + 1])
        front[mine[:cut]] = len(fronts)
        fronts.append(Front(mine[:cut], mine[cut:], children))
    level = min(SEPARATE, halvings)
    size = 2 ** (halvings - level + 1)
    ends = [number[level, one] + 1 for one in range(2**level)]
    return Dissection(tuple(fronts), front, tuple(range(end - size + 1, end) for end in ends))
