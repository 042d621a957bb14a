"""The threads of linear algebra, which wait for each other where matrices are small."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

from threadpoolctl import ThreadpoolController


@cache
def _threads() -> ThreadpoolController:
    """Find the libraries whose threads can be limited, once: it takes milliseconds."""
    return ThreadpoolController()


@contextmanager
def one_thread() -> Iterator[None]:
    """Let linear algebra use one thread inside the block."""
    with _threads().limit(limits=1, user_api="blas"):
        yield
