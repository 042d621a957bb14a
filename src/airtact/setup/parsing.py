"""Parse a scene file into its tables, optionally with changed values of some keys."""

import difflib
import math
import re
import typing
from collections.abc import Iterable, Mapping
from copy import deepcopy
from itertools import pairwise
from typing import Any

import msgspec

from airtact.errors import (
    LARGEST_NUMBER,
    LARGEST_SCENE_FILE,
    SMALLEST_NUMBER,
    InvalidInput,
)
from airtact.setup.tables import ObstacleTable, SceneFile, Table

# New value of a key; None removes the key
Value = str | float | int | bool | None


def parse_scene(text: str, changes: Mapping[str, Value] | None = None) -> SceneFile:
    """Parse the text of a scene file into its tables.

    Parameters
    ----------
    text : text of the file, in TOML.
    changes : mapping from paths of keys, such as ``foci[0].offset``, to values that replace those
        in the file. None removes a key.

    Raises
    ------
    InvalidInput
        If the text is not TOML, too large or too deeply nested. The error is also raised if a key
        is unknown, missing or in conflict with another key, or if a value has the wrong type, is
        not finite, is out of range or is not a known name.

    Examples
    --------
    >>> parse_scene("[medum]")
    Traceback (most recent call last):
    ...
    airtact.errors.InvalidInput: medum is not a key of a scene file; did you mean medium?
    """
    try:
        size = len(text.encode())
    except UnicodeEncodeError as error:
        raise InvalidInput(
            f"the text is not Unicode: character {error.start} is an unpaired surrogate.",
            code="file_unreadable",
        ) from None
    if size > LARGEST_SCENE_FILE:
        raise InvalidInput(
            f"the text has {size:,} bytes, more than {LARGEST_SCENE_FILE:,}.",
            code="file_too_large",
        )
    # The decoder needs minutes for keys with thousands of parts.
    parts = 0
    for word in text.split("."):
        parts = 0 if re.search(r"[\n=,\[\]{}]", word) else parts + 1
        if parts >= 32:
            raise InvalidInput(
                "a key has more than 32 parts separated by dots: use fewer.", code="file_too_large"
            )
    try:
        data = msgspec.toml.decode(text.encode())
        if changes:
            data = with_changes(data, changes)
        _check_numbers(data, "")
    except RecursionError:
        raise InvalidInput(
            "lists or tables are nested too deeply.", code="file_too_large"
        ) from None
    except InvalidInput:
        raise
    except ValueError as error:  # also raised for numbers with thousands of digits
        words = str(error)
        place = re.search(r"at line (\d+)", words)
        line = f": {text.split(chr(10))[int(place[1]) - 1].strip()}" if place else "."
        raise InvalidInput(
            f"this is not TOML: {words[:1].lower()}{words[1:]}{line}", code="file_unreadable"
        ) from None
    try:
        return msgspec.convert(data, SceneFile)
    except msgspec.ValidationError as error:
        raise _explained(error, data) from None


def _check_numbers(data: object, path: str) -> None:
    # Products of numbers beyond these limits might overflow or underflow later.
    if isinstance(data, dict):
        for key, value in data.items():
            _check_numbers(value, _joined(path, key))
    elif isinstance(data, list):
        for index, value in enumerate(data):
            _check_numbers(value, f"{path}[{index}]")
    elif isinstance(data, int | float):
        if not abs(data) < math.inf:  # also NaN
            raise InvalidInput(f"{path} is {data}, but it must be finite.", code="not_finite")
        if 0 < abs(data) < SMALLEST_NUMBER or abs(data) > LARGEST_NUMBER:
            # The largest integers cannot be formatted as floats.
            number = f"{data:.3g}" if abs(data) < 1e300 else "too large"
            raise InvalidInput(
                f"{path} is {number}, but its magnitude must be 0 or between {SMALLEST_NUMBER:g} "
                f"and {LARGEST_NUMBER:g}.",
                code="out_of_range",
            )


def nearest(word: str, names: Iterable[str], prefix: str = "") -> str:
    """Suggest the most similar name, or list all names if none is similar.

    >>> nearest("finite_elemant", ["boundary_element", "finite_element"])
    'did you mean finite_element?'
    """
    names = sorted(names)
    # The run time of difflib grows with the square of the word's length.
    close = difflib.get_close_matches(word[:50], names, n=1)
    if close:
        return f"did you mean {prefix}{close[0]}?"
    return f"use one of {', '.join(prefix + name for name in names)}."


def _explained(error: msgspec.ValidationError, data: Any) -> InvalidInput:
    fault, _, path = str(error).rpartition(" - at `$")
    fault = fault or path  # at the top level, there is no path
    path = "" if fault is path else path.strip("`.")
    if isinstance(error.__cause__, InvalidInput):
        cause = error.__cause__
        return InvalidInput(f"{path}: {cause}" if path else str(cause), code=cause.code)
    unknown = re.fullmatch(r"Object contains unknown field `(.+)`", fault, re.DOTALL)
    if unknown:
        before = f"{path}." if path else ""
        keys = _table_of(_along(path, data)[1]).__struct_fields__
        return InvalidInput(
            f"{before}{unknown[1]} is not a key of a scene file; "
            f"{nearest(unknown[1], keys, before)}",
            code="unknown_key",
        )
    missing = re.fullmatch(r"Object missing required field `(.+)`", fault)
    if missing:
        return InvalidInput(
            f"the key {_joined(path, missing[1])} is missing: add it.", code="key_missing"
        )
    value, kinds = _along(path, data)
    if fault.startswith("Invalid enum value"):
        words = [kind for kind in kinds if isinstance(kind, str)]
        return InvalidInput(
            f'{path} = "{value}" is not known; {nearest(value, words)}', code="unknown_name"
        )
    if re.match(r"Expected `(int|float)` [<>]", fault):
        limits = next(kind for kind in kinds if isinstance(kind, msgspec.Meta))
        bounds = (("above", limits.gt), ("at least", limits.ge), ("at most", limits.le))
        words = " and ".join(f"{word} {bound:g}" for word, bound in bounds if bound is not None)
        return InvalidInput(f"{path} is {value:g}, but it must be {words}.", code="out_of_range")
    of_tables = any(isinstance(kind, type) and issubclass(kind, Table) for kind in kinds)
    if of_tables and re.fullmatch(r"Expected `array( \| null)?`, got `object`", fault):
        return InvalidInput(
            f"{path} is a table, but it must be a list of tables: write [[{path}]] with double "
            "brackets.",
            code="wrong_kind",
        )
    code = "out_of_range"  # such as the length of a list
    if of_kind := re.match(r"Expected `([a-z| ]+)`, got", fault):
        code = "not_a_number" if re.search("int|float", of_kind[1]) else "wrong_kind"
    fault = re.sub(r"`([a-z| ]+)`", _plain_types, fault)
    return InvalidInput(f"{path}: {fault[:1].lower()}{fault[1:]}.", code=code)


def _along(path: str, data: Any) -> tuple[Any, list[Any]]:
    kinds: list[Any] = [SceneFile]
    for key, index in re.findall(r"(\w+)|\[(\d+)\]", path):
        data = data[key or int(index)]
        if key:
            kinds = _parts(typing.get_type_hints(_table_of(kinds), include_extras=True)[key])
    return data, kinds


def _parts(kind: Any) -> list[Any]:
    inner = typing.get_args(kind)
    return [part for each in inner for part in _parts(each)] if inner else [kind]


def _table_of(kinds: Iterable[Any]) -> type[Table]:
    return next(kind for kind in kinds if isinstance(kind, type) and issubclass(kind, Table))


def _plain_types(match: re.Match[str]) -> str:
    # Authors of TOML files may not know the type names of Python and JSON.
    words = {
        "array": "a list",
        "bool": "true or false",
        "float": "a number",
        "int": "a whole number",
        "object": "a table",
        "str": "a string",
    }
    return " or ".join(words.get(word, word) for word in match[1].split(" | ") if word != "null")


def _joined(path: str, key: str) -> str:
    return f"{path}.{key}" if path else key


def with_changes(data: Mapping[str, Any], changes: Mapping[str, Value]) -> dict[str, Any]:
    """Replace the values of some keys of decoded TOML.

    Parameters
    ----------
    data : tables, lists and values of a scene file; they are not modified.
    changes : mapping from the path of a key, such as ``foci[0].offset``, to its new value. None
        removes a key, and missing keys are added. ``hand.gap`` refers to the only obstacle that is
        a hand; the same applies to other kinds of bodies.

    Raises
    ------
    InvalidInput
        If a path does not lead to a key (the message lists the existing keys), or two paths lead
        to the same key.

    Examples
    --------
    >>> with_changes({"foci": [{"at": "thumb.pad"}]}, {"foci[0].offset": 1e-3})
    {'foci': [{'at': 'thumb.pad', 'offset': 0.001}]}
    """
    changed = deepcopy(dict(data))
    seen: set[tuple[str | int, ...]] = set()
    for path, value in changes.items():
        steps = _steps(path, changed)
        if steps in seen:
            raise InvalidInput(f"{path} is set twice; set it only once.", code="given_twice")
        seen.add(steps)
        inner: Any = changed
        for step, following in pairwise(steps):
            # Add missing tables, and a missing translation.
            if isinstance(inner, dict) and isinstance(following, str):
                inner.setdefault(step, {})
            elif isinstance(inner, dict) and step == "translation":
                inner.setdefault(step, [0.0, 0.0, 0.0])
            inner = _entry(inner, step, path)
        last = steps[-1]
        if isinstance(inner, dict) and value is None:
            inner.pop(last, None)
            continue
        if not (isinstance(inner, dict) and isinstance(last, str)):
            _entry(inner, last, path)
        inner[last] = value
    return changed


def _steps(path: str, data: Mapping[str, Any]) -> tuple[str | int, ...]:
    # Split a path into keys and indices, and replace the kind of a body with its index.
    if not re.fullmatch(r"[\w-]+(\.[\w-]+|\[\d+\])*", path):
        raise InvalidInput(
            f"{path!r} is not the path of a key: use a path such as foci[0].offset, "
            "where [0] selects the first table.",
            code="unknown_key",
        )
    kind, *keys = (name or int(index) for name, index in re.findall(r"([\w-]+)|\[(\d+)\]", path))
    if kind in SceneFile.__struct_fields__:
        return (kind, *keys)
    bodies = [body if isinstance(body, dict) else {} for body in data.get("obstacles", [])]
    indices = [index for index, body in enumerate(bodies) if kind in body]
    if len(indices) != 1 or kind not in ObstacleTable.one_of:
        raise InvalidInput(
            f"{path}: {kind!r} is neither a key of the file ({', '.join(sorted(data))}) nor a "
            f"kind of body ({', '.join(ObstacleTable.one_of)}) that occurs exactly once. Use "
            "obstacles[0] for the first body.",
            code="unknown_key",
        )
    # Keys of a body are either in the table of its kind or next to that table.
    if isinstance(bodies[indices[0]][kind], dict) and keys[:1] not in (["pose"], ["boundary"]):
        keys = [kind, *keys]
    return ("obstacles", indices[0], *keys)


def _entry(inner: Any, step: str | int, path: str) -> Any:
    try:
        if isinstance(inner, dict | list):
            return inner[step]  # pyright: ignore[reportArgumentType, reportCallIssue]
    except (LookupError, TypeError):
        pass
    hint = f"its value is {inner!r}."
    if isinstance(inner, dict):
        hint = nearest(str(step), inner)
    elif isinstance(inner, list):
        hint = f"there are {len(inner)} entries, starting from [0]."
    raise InvalidInput(f"{path}: {step} is not in the scene file; {hint}", code="unknown_key")
