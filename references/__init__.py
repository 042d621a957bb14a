"""Independent solutions, difficult meshes and hand motions that tests and benchmarks share."""

import numpy as np


def relative(values: np.ndarray, exact: np.ndarray) -> float:
    """Relative error over all entries, in the 2-norm."""
    return float(np.linalg.norm(values - exact) / np.linalg.norm(exact))


def relative_columns(values: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """Relative error of each excitation over the points, in the 2-norm."""
    return np.linalg.norm(values - exact, axis=0) / np.linalg.norm(exact, axis=0)
