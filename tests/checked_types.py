"""The type checker of the tests: beartype, with int taken for float and float for complex as PEP 484 has it.

A function is checked in its first calls in a process, and wrapped for it in the first one: to check all calls would take
a fifth of the time of the tests, and to wrap all functions half of the start of every worker. A function within another
is made anew in each call of that one, and wrapped anew, so only the first ones are checked.
"""

import dataclasses
import inspect
from collections import defaultdict
from collections.abc import Callable
from functools import cache, partial, wraps
from itertools import count
from typing import Any, get_type_hints

import jaxtyping
from beartype import BeartypeConf, beartype

CHECKED_CALLS = 100
CHECKED_INNER_CALLS = 5

check = beartype(conf=BeartypeConf(is_pep484_tower=True))

_wrapped_at_once = jaxtyping.jaxtyped
_calls = defaultdict(count)  # of each function, by module and name
_one_scope = cache(partial(jaxtyping.jaxtyped, "context"))


def _known(hint: Any, names: dict) -> Any:
    """Return a hint with the names in quotes looked up, where its module knows them."""
    holder = type("", (), {"__annotations__": {"hint": hint}})
    try:
        return get_type_hints(holder, names, include_extras=True)["hint"]
    except NameError:
        return Any


def _wrapped(function: Callable, typechecker: Callable) -> Callable:
    written = function.__annotations__
    function.__annotations__ = {
        name: _known(hint, function.__globals__) for name, hint in written.items()
    }
    # A generator begins when its caller is in another scope, and only jaxtyping's slower way checks it before.
    if inspect.isgeneratorfunction(function):
        checked = _wrapped_at_once(function, typechecker=typechecker)
    else:
        checked = typechecker(function)
    function.__annotations__ = written
    return checked


def _checked(function: Callable, typechecker: Callable) -> Callable:
    wrapped = cache(partial(_wrapped, function, typechecker))
    calls = _calls[function.__module__, function.__qualname__]
    checked_calls = CHECKED_INNER_CALLS if "<locals>" in function.__qualname__ else CHECKED_CALLS

    @wraps(function)
    def checking(*arguments, **named):
        if next(calls) >= checked_calls or jaxtyping.config.jaxtyping_disable:
            return function(*arguments, **named)
        with _one_scope():  # in which the name of an axis means one length
            return wrapped()(*arguments, **named)

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
