"""The type checker of the tests: beartype, with int taken for float and float for complex as PEP 484 has it.

A function is checked in its first calls in a process: to check all would take a fifth of the time of the tests.
"""

from collections.abc import Callable
from functools import cache, wraps
from itertools import count

from beartype import BeartypeConf, beartype

CHECKED_CALLS = 200


def check(function: Callable) -> Callable:
    checked = cache(lambda: beartype(conf=BeartypeConf(is_pep484_tower=True))(function))
    calls = count()

    @wraps(function)
    def checking(*arguments, **named):
        return (checked() if next(calls) < CHECKED_CALLS else function)(*arguments, **named)

    return checking
