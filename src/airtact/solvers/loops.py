"""The compiled loops, by the precision that they work in."""

from collections.abc import Callable

from airtact import _kernels


def loop(name: str, precision: str) -> Callable[..., int]:
    """Return a compiled loop for float32, float64 or bfloat16 (``apply_monopoles`` for float32, say)."""
    return getattr(_kernels, f"{name}_{precision}")
