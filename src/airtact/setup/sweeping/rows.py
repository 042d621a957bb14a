"""A row of a sweep: a point and what the function returned there, or the code and the sentence of its fault."""

from collections.abc import Callable, Mapping
from typing import TypeVar

import numpy as np

from airtact.errors import InvalidInput, NotConverged, one_sentence

Value = str | float | int | bool | None
Row = dict[str, Value]
Function = Callable[[Row], Mapping[str, Value]]
"""What a sweep computes at each point."""

Given = TypeVar("Given")
"""What may or may not be a ``Value``."""

ERROR, SENTENCE = "error", "sentence"
"""Columns of the code and the sentence of a fault; both are empty where there is none."""

PASSING = ("file_failed", "file_missing", "file_unreadable", "too_little_memory")
"""Faults of the moment, which are tried again by the next run."""


def checked(given: Mapping[str, Given], what: str) -> Row:
    """Return names and single values as a row; raise "wrong_kind" for others."""
    if not isinstance(given, Mapping):
        raise InvalidInput(
            f'{what} is a {type(given).__name__}, but it must be names with a value each, such as {{"gap": 0.012}}.',
            code="wrong_kind",
        )
    row: Row = {}
    for name, value in given.items():
        plain = value.item() if isinstance(value, np.generic) else value
        if not isinstance(name, str) or not (plain is None or isinstance(plain, str | float | int)):
            raise InvalidInput(
                f"{what} has {name!r} = a {type(value).__name__}, but names are text and values single numbers, text, "
                "true, false or None.",
                code="wrong_kind",
            )
        row[name] = plain
    return row


def attempt(function: Function, point: Row) -> Row:
    """Compute one point; a fault becomes its code and its sentence."""
    try:
        result = checked(function(dict(point)), "the result")
        twice = sorted({*point, ERROR, SENTENCE} & result.keys())
        if twice:
            raise InvalidInput(
                f"{len(twice)} columns of the result are taken: {', '.join(twice)}.",
                code="given_twice",
            )
    except (InvalidInput, NotConverged) as fault:
        return {ERROR: fault.code, SENTENCE: str(fault)}
    except MemoryError:
        return {ERROR: "too_little_memory", SENTENCE: "the memory is full: run fewer processes."}
    except OSError as fault:
        return {
            ERROR: "file_failed",
            SENTENCE: one_sentence(f"{fault.filename or 'a file'}: {fault.strerror or fault}"),
        }
    except (Exception, SystemExit) as fault:
        return {
            ERROR: "function_failed",
            SENTENCE: one_sentence(f"{type(fault).__name__}: {fault}"),
        }
    return {**result, ERROR: "", SENTENCE: ""}
