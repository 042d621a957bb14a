"""Blocks of the matrix: an order of the panels that keeps each block compact, and which blocks are near each other."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from airtact import _kernels
from airtact.printing import in_short

PANELS = _kernels.lanes // 6
"""Panels of a block."""


@dataclass(frozen=True, eq=False)
class Pairs:
    """Pairs of blocks; block t of the rows is paired with ``column[first[t]:first[t + 1]]``, which rise."""

    first: Int64[np.ndarray, "bounds"]
    column: Int64[np.ndarray, "pairs"]

    __repr__ = in_short

    @classmethod
    def of(cls, chosen: Bool[np.ndarray, "blocks blocks"]) -> "Pairs":
        """Take the pairs that are chosen."""
        first = np.concatenate([[0], np.cumsum(chosen.sum(axis=1))])
        return cls(first.astype(np.int64), np.nonzero(chosen)[1].astype(np.int64))

    @property
    def row(self) -> Int64[np.ndarray, "pairs"]:
        """(N,) block of the rows of each pair."""
        return np.repeat(np.arange(len(self.first) - 1), np.diff(self.first))


def blocks_of(unknowns: int) -> int:
    """How many blocks so many unknowns have."""
    return -(-unknowns // _kernels.lanes)


def block_order(centres: Float64[np.ndarray, "panels 3"]) -> Int64[np.ndarray, "panels"]:
    """Order of panels with centres (T, 3) in which the panels of each block lie together.

    The panels are bisected across the direction of their largest extent, and each half again.
    Bodies that move keep their blocks.
    """
    order = np.empty(len(centres), dtype=np.int64)
    _kernels.block_order(np.ascontiguousarray(centres), PANELS, order)
    return order


def near_blocks(
    panels: int, *lists: tuple[Int64[np.ndarray, "_"], Int64[np.ndarray, "_"]]
) -> Bool[np.ndarray, "blocks blocks"]:
    """Mark the pairs of blocks that have panels near each other.

    Each list says where the near panels of each point begin, and which they are; all panels have as
    many of its points.
    """
    blocks = -(-panels // PANELS)
    met = np.zeros((blocks, blocks), dtype=bool)
    for first, near in lists:
        _kernels.mark_blocks(first, near, (len(first) - 1) // panels * PANELS, PANELS, met)
    return met
