"""The compiled loops, by the precision that they work in."""

from collections.abc import Callable

import numpy as np

from airtact import _kernels


def loop(name: str, precision: str) -> Callable[..., int]:
    """Return a compiled loop for float32, float64 or bfloat16 (``apply_monopoles`` for float32, say)."""
    return getattr(_kernels, f"{name}_{precision}")


def loop_for(name: str, kind: np.dtype) -> Callable[..., int]:
    """Return a compiled loop for the precision of some complex numbers: complex64 or complex128."""
    return loop(name, "float32" if kind == np.complex64 else "float64")
