"""From the words of --vary to the points of a grid."""

import re
from collections.abc import Sequence
from itertools import product
from math import isfinite, prod

import numpy as np

from airtact.errors import InvalidInput
from airtact.setup.sweeping.rows import Row
from airtact.setup.sweeping.sweep import MOST

_VARIED = re.compile(r"(?P<path>[^=]+)=(?P<low>[^:]+):(?P<high>[^:]+):(?P<count>[^:]+)")


def grid_of(varied: Sequence[str]) -> list[Row]:
    """Return the points of a grid from "PATH=LOW:HIGH:COUNT" each, the last one varying fastest.

    Values are integers where both ends are written as such and all between are.

    Examples
    --------
    >>> grid_of(["a=0:1:2", "b=0.5:1:2"])
    [{'a': 0, 'b': 0.5}, {'a': 0, 'b': 1.0}, {'a': 1, 'b': 0.5}, {'a': 1, 'b': 1.0}]
    """
    axes: dict[str, Sequence[float | int]] = {}
    for words in varied:
        found = _VARIED.fullmatch(words)
        path, values = (
            (words, None)
            if found is None
            else (found["path"].strip(), _values(**found.groupdict()))
        )
        if values is None:
            raise InvalidInput(
                f'--vary "{words}" is not PATH=LOW:HIGH:COUNT with two numbers and a count from 1 to {MOST:,}, such as '
                '"foci[0].offset=0.0005:0.003:6".',
                code="out_of_range",
            )
        if found is not None and len(values) == 1 and float(found["high"]) != values[0]:
            raise InvalidInput(
                f'--vary "{words}" has 1 point but two ends, {found["low"]} and {found["high"]}: give a count of 2 or '
                "more, or one value as both ends.",
                code="out_of_range",
            )
        if path in axes:
            raise InvalidInput(f"{path} is varied 2 times; give it once.", code="given_twice")
        axes[path] = values
    if prod(map(len, axes.values())) > MOST:
        total = prod(map(len, axes.values()))
        raise InvalidInput(
            f"the grid has {total:,} points, more than {MOST:,}.", code="out_of_range"
        )
    return [dict(zip(axes, values, strict=True)) for values in product(*axes.values())]


def _values(path: str, low: str, high: str, count: str) -> Sequence[float | int] | None:
    """Return the values of an axis, or None where its words are no numbers."""
    try:
        first, last, number = float(low), float(high), int(count)
    except ValueError:
        return None
    if not (1 <= number <= MOST and isfinite(first) and isfinite(last)):
        return None
    values = np.linspace(first, last, number).tolist()
    whole = all(re.fullmatch(r"[+-]?\d+", end.strip()) for end in (low, high))
    return (
        [int(value) for value in values]
        if whole and all(one.is_integer() for one in values)
        else values
    )
