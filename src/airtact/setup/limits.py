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
    MOST_BODIES,
    MOST_DIGITS,
    MOST_LEVELS,
    SMALLEST_NUMBER,
    InvalidInput,
)

_TOKEN = re.compile(
    r"""
    (?P<string> \"\"\"(?:\\.|[^\\])*?\"\"\" | '''.*?''' | "(?:\\.|[^"\\\n])*" | '[^'\n]*')
    | (?P<comment> \#[^\n]*)
    | (?P<opens> [\[{]) | (?P<closes> [\]}])
    | (?P<number> [-+0-9][-+\w]*)
    | (?P<word> \w[-\w]*)
    | (?P<dot> \.)
    | (?P<space> \s+)
    | (?P<other> .)
    """,
    re.VERBOSE | re.DOTALL,
)


def check_text(text: str) -> None:
    """Raise "file_too_large", "file_unreadable", "file_too_large" or "file_too_large" where TOML text goes beyond a limit."""
    try:
        size = len(text.encode())
    except UnicodeEncodeError as error:
        sentence = f"the text is not Unicode: character {error.start} is half of a pair."
        raise InvalidInput(sentence, code="file_unreadable") from None
    if size > LARGEST_SCENE_FILE:
        sentence = f"the text has {size:,} bytes, more than {LARGEST_SCENE_FILE:,}."
        raise InvalidInput(sentence, code="file_too_large")
    levels = dots = 0
    for token in _TOKEN.finditer(text):
        kind = token.lastgroup
        levels += (kind == "opens") - (kind == "closes")
        dots = dots + (kind == "dot") if kind in ("dot", "word", "number", "string", "space") else 0
        if levels > MOST_LEVELS or dots >= MOST_LEVELS:
            line = text.count("\n", 0, token.start()) + 1
            sentence = (
                f"line {line} stands more than {MOST_LEVELS} levels deep in lists, tables or keys."
            )
            raise InvalidInput(sentence, code="file_too_large")
        if kind == "number" and len(token[0]) > MOST_DIGITS:
            line = text.count("\n", 0, token.start()) + 1
            sentence = (
                f"line {line} has a number of {len(token[0])} characters, more than {MOST_DIGITS}."
            )
            raise InvalidInput(sentence, code="file_too_large")


def check_data(data: Mapping[str, str | float | date | time | Sequence | Mapping]) -> None:
    """Raise "file_too_large", "out_of_range" or "too_many" where decoded TOML goes beyond a limit."""
    for node in _numbers(data):
        size = abs(node.value)
        if not math.isfinite(size):
            raise InvalidInput(
                f"{node.path()} is {node.value}, but it must be finite.", code="not_finite"
            )
        if size != 0 and not SMALLEST_NUMBER <= size <= LARGEST_NUMBER:
            raise InvalidInput(
                f"{node.path()} is {node.value:.3g}, but its size must be 0, or lie between {SMALLEST_NUMBER:g} and "
                f"{LARGEST_NUMBER:g}.",
                code="out_of_range",
            )
    bodies = data.get("obstacles")
    if isinstance(bodies, list) and len(bodies) > MOST_BODIES:
        count = counted(len(bodies), "obstacle", "obstacles")
        raise InvalidInput(f"there are {count}, more than {MOST_BODIES}.", code="too_many")


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
        if node.level > MOST_LEVELS:
            sentence = (
                f"{node.path()} stands more than {MOST_LEVELS} levels deep in lists and tables."
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
