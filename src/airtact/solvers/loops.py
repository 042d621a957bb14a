"""The compiled loops, by the precision that they work in."""

from collections.abc import Callable
from typing import Any

from airtact import _kernels


def loop(name: str, precision: str) -> Callable[..., Any]:
    """Return a compiled loop for float32, float64 or bfloat16 (``apply_monopoles`` for float32, say)."""
    return getattr(_kernels, f"{name}_{precision}")
