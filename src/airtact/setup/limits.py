"""Limits of a scene file, checked before anything is built from it: nesting, lengths and sizes of numbers, bodies."""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import date, time
from typing import Any

from airtact.checks import counted
from airtact.errors import (
    LARGEST_NUMBER,
    LARGEST_SCENE_FILE,
    SMALLEST_NUMBER,
    InvalidInput,
)

MAX_LEVELS = 32
"""Largest number of lists and tables inside each other, and of parts of a dotted key."""

MAX_BODIES = 256
"""Largest number of obstacles in a scene file."""


def check_text(text: str) -> None:
    """Raise "file_too_large" or "file_unreadable" where TOML text goes beyond a limit."""
    try:
        size = len(text.encode())
    except UnicodeEncodeError as error:
        raise InvalidInput(
            f"the text is not Unicode: character {error.start} is half of a pair.",
            code="file_unreadable",
        ) from None
    if size > LARGEST_SCENE_FILE:
        raise InvalidInput(
            f"the text has {size:,} bytes, more than {LARGEST_SCENE_FILE:,}.",
            code="file_too_large",
        )
    # The decoder takes minutes for keys of thousands of parts; all else it reads in seconds.
    parts = 0
    for word in text.split("."):
        parts = 0 if re.search(r"[\n=,\[\]{}]", word) else parts + 1
        if parts >= MAX_LEVELS:
            raise InvalidInput(
                f"a key has more than {MAX_LEVELS} parts between dots.", code="file_too_large"
            )


def check_data(data: Mapping[str, str | float | date | time | Sequence | Mapping]) -> None:
    """Raise "file_too_large", "out_of_range" or "too_many" where decoded TOML goes beyond a limit."""
    for node in _numbers(data):
        size = abs(node.value)
        if not size < math.inf:  # also NaN
            raise InvalidInput(
                f"{node.path()} is {node.value}, but it must be finite.", code="not_finite"
            )
        if 0 < size < SMALLEST_NUMBER or size > LARGEST_NUMBER:
            number = f"{node.value:.3g}" if size < 1e300 else "too large"  # no float holds it
            raise InvalidInput(
                f"{node.path()} is {number}, but its size must be 0, or lie between "
                f"{SMALLEST_NUMBER:g} and {LARGEST_NUMBER:g}.",
                code="out_of_range",
            )
    bodies = data.get("obstacles")
    if isinstance(bodies, list) and len(bodies) > MAX_BODIES:
        count = counted(len(bodies), "obstacle", "obstacles")
        raise InvalidInput(f"there are {count}, more than {MAX_BODIES}.", code="too_many")


def check_total(count: int, most: int) -> None:
    """Raise "too_many" where there are more foci and suppression points than the scene file allows."""
    if count > most:
        raise InvalidInput(
            f"there are {count:,} foci and suppression points or more, but most_points is {most:,}: "
            "give fewer, or a larger most_points at the top of the file.",
            code="too_many",
        )


@dataclass(frozen=True, slots=True)
class _Node:
    """A value in tables and lists; its path is written only where it is at fault."""

    value: Any
    key: str
    above: "_Node | None"
    level: int

    def path(self) -> str:
        keys, node = [], self
        while node is not None:
            keys.append(node.key)
            node = node.above
        return "".join(reversed(keys)).removeprefix(".")


def _numbers(data: object) -> Iterator[_Node]:
    """List the numbers in tables and lists in their order; raise "file_too_large"."""
    stack = [_Node(data, "", None, 0)]
    while stack:
        node = stack.pop()
        if node.level > MAX_LEVELS:
            sentence = (
                f"{node.path()} stands more than {MAX_LEVELS} levels deep in lists and tables."
            )
            raise InvalidInput(sentence, code="file_too_large")
        inside = []
        if isinstance(node.value, dict):
            inside = [
                _Node(value, f".{key}", node, node.level + 1) for key, value in node.value.items()
            ]
        elif isinstance(node.value, list | tuple):
            inside = [
                _Node(value, f"[{index}]", node, node.level + 1)
                for index, value in enumerate(node.value)
            ]
        elif isinstance(node.value, int | float):
            yield node
        stack += reversed(inside)
