"""The type checker of the tests: beartype, with int taken for float and float for complex as PEP 484 has it.

A function is checked in its first calls in a process, and wrapped for it in the first one: to check all calls would take
a fifth of the time of the tests, and to wrap all functions half of the start of every worker.
"""

import dataclasses
import inspect
from collections.abc import Callable
from functools import cache, partial, wraps
from itertools import count
from typing import Any

import jaxtyping
from beartype import BeartypeConf, beartype

CHECKED_CALLS = 200

check = beartype(conf=BeartypeConf(is_pep484_tower=True))

_wrapped_at_once = jaxtyping.jaxtyped


def _checked(function: Callable, typechecker: Callable) -> Callable:
    @cache
    def wrapped() -> Callable:
        # Names in quotes were mostly unknown where they are written, so that nothing could be checked.
        function.__annotations__ = {
            name: Any if isinstance(hint, str) else hint
            for name, hint in function.__annotations__.items()
        }
        checked = _wrapped_at_once(function, typechecker=typechecker)
        function.__annotations__ = written
        return checked

    written = function.__annotations__
    calls = count()

    @wraps(function)
    def checking(*arguments, **named):
        return (wrapped() if next(calls) < CHECKED_CALLS else function)(*arguments, **named)

    checking.is_checked = True
    return checking


def jaxtyped(decorated: Any = None, *, typechecker: Callable) -> Any:
    """Stand in for ``jaxtyping.jaxtyped``, with which the import hook decorates functions and classes."""
    if decorated is None:
        return partial(jaxtyped, typechecker=typechecker)
    if not inspect.isclass(decorated):
        return _checked(decorated, typechecker)
    if dataclasses.is_dataclass(decorated) and not hasattr(decorated.__init__, "is_checked"):
        decorated.__init__ = _checked(decorated.__init__, typechecker)
    return decorated
