"""Some elements of an array, from which what varies slowly over it follows at all of them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex64, Float64, Int64
from scipy.interpolate import RBFInterpolator
from scipy.sparse import csr_array

from airtact.printing import in_short

NEIGHBOURS = 8
"""Chosen elements that a value is found from."""


@dataclass(frozen=True, eq=False)
class SomeElements:
    """Some elements of an array, spread evenly over it.

    Attributes
    ----------
    chosen : (S,) which they are.
    weights : (E, S) of their values in the value at each element, by linear radial basis functions.
    """

    chosen: Int64[np.ndarray, "some"]
    weights: csr_array

    __repr__ = in_short

    @classmethod
    def of(cls, positions: Float64[np.ndarray, "elements 3"], count: int) -> "SomeElements":
        """Choose a number of elements at positions (E, 3) [m], each the farthest from those before it."""
        chosen, away = [0], np.linalg.norm(positions - positions[0], axis=1)
        while len(chosen) < count:
            chosen.append(int(away.argmax()))
            away = np.minimum(away, np.linalg.norm(positions - positions[chosen[-1]], axis=1))
        some = np.array(chosen)
        neighbours = min(NEIGHBOURS, count)
        each = RBFInterpolator(
            positions[some], np.eye(count), neighbours, kernel="linear", degree=0
        )
        weights = each(positions)
        weights[np.abs(weights) < 1e-6] = 0.0
        return cls(some, csr_array(weights.astype(np.float32)))

    def everywhere(
        self, values: Complex64[np.ndarray, "*any some"]
    ) -> Complex64[np.ndarray, "*any elements"]:
        """Find values at all elements from those at the chosen ones."""
        found = self.weights @ values.reshape(-1, len(self.chosen)).T
        return np.ascontiguousarray(found.T).reshape(*values.shape[:-1], -1)
