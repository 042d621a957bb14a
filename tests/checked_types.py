"""The type checker of the tests: beartype, with int taken for float and float for complex as PEP 484 has it.

A function is checked in its first calls in a process: to check all would take a third of the time of the tests.
"""

import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache, reduce, wraps
from itertools import count

from beartype import BeartypeConf, beartype

CHECKED_CALLS = 200


def check(function: Callable) -> Callable:
    checked = cache(lambda: beartype(conf=BeartypeConf(is_pep484_tower=True))(function))
    calls = count()

    @wraps(function)
    def checking(*arguments, **named):
        if next(calls) < CHECKED_CALLS:
            return checked()(*arguments, **named)
        with suppress(AttributeError):  # properties and inner functions cannot be marked
            path = function.__qualname__.split(".")
            reduce(getattr, path, sys.modules[function.__module__]).__no_type_check__ = True
        return function(*arguments, **named)

    return checking
