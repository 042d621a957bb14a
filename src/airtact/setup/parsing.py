"""From the text of a scene file to its tables, or to one sentence that names the key at fault."""

import difflib
import re
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import date, time
from functools import cache
from typing import Any

import msgspec

from airtact.errors import InvalidInput
from airtact.setup.limits import check_data, check_text
from airtact.setup.tables import RENAMED, Choice, SceneFile, Table
from airtact.transducers.boards import BOARDS

Item = str | float | date | time | Sequence | Mapping
"""What decoded TOML holds."""

LONGEST_WORD = 50
"""A longer word is cut before it is compared with those that are known."""

AnyTable = typing.TypeVar("AnyTable", bound=Table)


def parse_scene(
    text: str, change: Callable[[dict[str, Item]], dict[str, Item]] | None = None
) -> SceneFile:
    r"""Turn the text of a scene file into its tables.

    Parameters
    ----------
    text : TOML.
    change : is applied to the decoded TOML before it is checked.

    Raises
    ------
    InvalidInput
        "file_unreadable", "unknown_key" (with the nearest right key), "unknown_key", "key_missing", "key_misplaced" (a key
        of another choice), "options_clash" (none or several of keys that exclude each other), "unknown_name" or
        "out_of_range"; or a limit is passed: "file_too_large", "file_unreadable", "file_too_large", "file_too_large", "not_finite",
        "out_of_range" or "too_many".

    Examples
    --------
    >>> parse_scene("[medium]\ncelsuis = 20.0")
    Traceback (most recent call last):
    ...
    airtact.errors.InvalidInput: medium.celsuis is not a key of a scene file; did you mean medium.celsius?
    """
    check_text(text)
    try:
        data = msgspec.toml.decode(text.encode())
    except RecursionError:
        raise InvalidInput(
            "lists and tables stand too deep in each other.", code="file_too_large"
        ) from None
    except ValueError as error:  # also of numbers with thousands of digits
        raise InvalidInput(
            f"this is not TOML: {str(error)[:1].lower()}{str(error)[1:]}.", code="file_unreadable"
        ) from None
    data = data if change is None else change(data)
    check_data(data)
    return _table(data, SceneFile, "")


@cache
def keys_of(table: type[Table]) -> frozenset[str]:
    """List the keys that a table may hold, those of its choices among them."""
    keys: set[str] = set()
    for field in _fields(table):
        kinds = _tables_in(field.type)
        keys |= (
            {field.name}
            if len(kinds) < 2
            else {key for kind in kinds for key in _keys_beside(kind)}
        )
    return frozenset(keys)


def nearest(word: str, known: Iterable[str], prefix: str = "") -> str:
    """Write which known word was probably meant, or all that there are.

    >>> nearest("finite_elemant", ["boundary_element", "finite_element"])
    'did you mean finite_element?'
    """
    known = sorted(known)
    close = difflib.get_close_matches(word[:LONGEST_WORD], known, n=1)
    return (
        f"did you mean {prefix}{close[0]}?"
        if close
        else f"there is {', '.join(prefix + name for name in known)}."
    )


def _table(data: Any, table: type[AnyTable], path: str) -> AnyTable:
    """Convert one table, after its choices and the tables in it."""
    if not isinstance(data, dict):
        return _converted(data, table, path)
    _check_keys(data, table, path)
    ready: dict[str, Any] = {}
    for field in sorted(_fields(table), key=lambda field: len(_tables_in(field.type))):
        kinds, value, inner = (
            _tables_in(field.type),
            data.get(field.name),
            _joined(path, field.name),
        )
        if len(kinds) > 1:
            chosen = _chosen(data, field, kinds, path)
            ready |= {} if chosen is None else {field.name: chosen}
        elif field.name in data:
            listed = "list[" in str(field.type)
            if kinds and listed and isinstance(value, list):
                value = [
                    _table(item, kinds[0], f"{inner}[{index}]") for index, item in enumerate(value)
                ]
            elif kinds and not listed and (isinstance(value, dict) or field.type is kinds[0]):
                value = _table(value, kinds[0], inner)
            ready[field.name] = value
    return _converted(ready, table, path)


def _check_keys(data: Mapping[str, Any], table: type[Table], path: str) -> None:
    known, before = keys_of(table), f"{path}." if path else ""
    for key in data:
        if (table, key) in RENAMED:
            now = RENAMED[table, key]
            raise InvalidInput(
                f"the key {before}{key} is now called {before}{now}; rename it.", code="unknown_key"
            )
        if key not in known:
            sentence = f"{before}{key} is not a key of a scene file; {nearest(key, known, before)}"
            raise InvalidInput(sentence, code="unknown_key")


def _chosen(
    data: Mapping[str, Any], field: msgspec.structs.FieldInfo, kinds: list[type[Table]], path: str
) -> Table | None:
    """Find the choice that a table makes, and convert its keys; None for the default of the field."""
    tags = {str(kind.__struct_config__.tag): kind for kind in kinds}
    by_value = not issubclass(kinds[0], Choice)
    tag = (
        _tag_by_value(data, field, tags, path) if by_value else _tag_by_key(data, field, tags, path)
    )
    if tag is None:
        return None
    kind = tags[tag]
    own = _keys_beside(kind)
    for key in sorted({key for other in kinds for key in _keys_beside(other)} & data.keys() - own):
        owners = [
            _phrase(field, name, by_value)
            for name, other in tags.items()
            if key in _keys_beside(other)
        ]
        sentence = f"{_joined(path, key)} goes only with {' or '.join(owners)}."
        raise InvalidInput(sentence, code="key_misplaced")
    if tag == ".csv":
        return _table({"file": data[field.name]}, kind, path)
    if not by_value and tag not in kind.__struct_fields__:
        return _table(data[tag], kind, _joined(path, tag))
    for key in (one.name for one in _fields(kind) if one.required):
        if key not in data:
            sentence = f"the key {_joined(path, key)} is missing: {_phrase(field, tag, by_value)} needs it."
            raise InvalidInput(sentence, code="key_missing")
    return _table(
        {key: data[key] for key in own if key in data and not (by_value and key == field.name)},
        kind,
        path,
    )


def _phrase(field: msgspec.structs.FieldInfo, tag: str, by_value: bool) -> str:
    return f'{field.name} = "{tag}"' if by_value else tag


def _tag_by_key(
    data: Mapping[str, Any],
    field: msgspec.structs.FieldInfo,
    tags: Mapping[str, type[Table]],
    path: str,
) -> str | None:
    """Find the choice whose tag is a key, or else the one that has other keys of the table."""
    given = [tag for tag in tags if tag in data]
    given = given or [tag for tag, kind in tags.items() if _keys_beside(kind) & data.keys()]
    if not given and not field.required:
        return None
    if len(given) != 1:
        choices = [" and ".join(_leading(kind)) for kind in tags.values()]
        sentence = f"{path}: give exactly one of {', '.join(choices)}; {len(given)} given."
        raise InvalidInput(sentence, code="options_clash")
    return given[0]


def _tag_by_value(
    data: Mapping[str, Any],
    field: msgspec.structs.FieldInfo,
    tags: Mapping[str, type[Table]],
    path: str,
) -> str:
    """Find the choice that the value of a key names, or the default one."""
    if field.name not in data:
        if field.required:
            raise InvalidInput(
                f"the key {_joined(path, field.name)} is missing.", code="key_missing"
            )
        return str(field.default.__struct_config__.tag)
    value = data[field.name]
    if not isinstance(value, str):
        return str(_converted(value, str, _joined(path, field.name)))
    if value in tags:
        return value
    if value.endswith(".csv") and ".csv" in tags:
        return ".csv"
    if value in BOARDS and field.name == "layout":
        raise InvalidInput(
            f'{_joined(path, field.name)} = "{value}" is a kind of board: write layout = "boards", board = "{value}" '
            "and poses = [{ translation = [x, y, z] }], a pose for each board.",
            code="unknown_name",
        )
    known = [tag for tag in tags if tag != ".csv"]
    kind = (
        f"neither a known {field.name} nor a .csv file"
        if ".csv" in tags
        else f"not a known {field.name}"
    )
    sentence = f'{_joined(path, field.name)} = "{value}" is {kind}; {nearest(value, known)}'
    raise InvalidInput(sentence, code="unknown_name")


@cache
def _keys_beside(kind: type[Table]) -> frozenset[str]:
    """List the keys of a choice that stand in the table which makes it."""
    config, fields = kind.__struct_config__, keys_of(kind)
    if not issubclass(kind, Choice):
        return frozenset({str(config.tag_field)}) | (
            fields if config.tag != ".csv" else frozenset()
        )
    return fields if config.tag in kind.__struct_fields__ else frozenset({str(config.tag)})


def _leading(kind: type[Table]) -> list[str]:
    """List the keys that a choice needs, or may have where it needs none."""
    if kind.__struct_config__.tag not in kind.__struct_fields__:
        return [str(kind.__struct_config__.tag)]
    return [field.name for field in _fields(kind) if field.required] or list(kind.__struct_fields__)


@cache
def _tables_in(kind: Any) -> list[type[Table]]:
    """Find the tables that a type holds: alone, in a list or as one of several choices."""
    if isinstance(kind, type) and issubclass(kind, Table):
        return [kind]
    return [table for part in typing.get_args(kind) for table in _tables_in(part)]


@cache
def _fields(table: type[Table]) -> tuple[msgspec.structs.FieldInfo, ...]:
    return msgspec.structs.fields(table)


def _joined(path: str, key: str) -> str:
    return f"{path}.{key}" if path else key


_PLAIN_WORDS = {
    "array": "a list",
    "bool": "true or false",
    "float": "a number",
    "int": "a whole number",
    "object": "a table",
    "str": "a string",
}


def _converted(data: Any, kind: type[Any], path: str) -> Any:
    """Convert by msgspec, and write its errors in the words of TOML."""
    try:
        return msgspec.convert(data, kind)
    except msgspec.ValidationError as error:
        what, _, inner = str(error).partition(" - at ")
    where = path + inner.strip("`").removeprefix("$")
    where = where.removeprefix(".")
    if missing := re.fullmatch(r"Object missing required field `(.+)`", what):
        raise InvalidInput(f"the key {_joined(where, missing[1])} is missing.", code="key_missing")
    what = re.sub(r"`([a-z| ]+)`", _plain_types, what)
    raise InvalidInput(f"{where}: {what[:1].lower()}{what[1:]}.", code="out_of_range")


def _plain_types(match: re.Match[str]) -> str:
    return " or ".join(
        _PLAIN_WORDS.get(word, word) for word in match[1].split(" | ") if word != "null"
    )
