"""From the text of a scene file to its tables, with other values for some keys."""

import difflib
import math
import re
import typing
from collections.abc import Iterable, Mapping
from copy import deepcopy
from functools import cache
from itertools import pairwise
from typing import Any

import msgspec

from airtact.errors import (
    LARGEST_NUMBER,
    LARGEST_SCENE_FILE,
    SMALLEST_NUMBER,
    InvalidInput,
)
from airtact.setup import tables
from airtact.setup.tables import Choice, SceneFile, Table
from airtact.transducers.boards import BOARDS

# Value that a key may be set to; None removes the key
Value = str | float | int | bool | None

AnyTable = typing.TypeVar("AnyTable", bound=Table)

# Largest number of lists and tables inside each other, and of parts of a dotted key
MAX_LEVELS = 32

# Largest number of obstacles in a scene file
MAX_BODIES = 256


def parse_scene(text: str, changes: Mapping[str, Value] | None = None) -> SceneFile:
    r"""Turn the text of a scene file into its tables.

    Parameters
    ----------
    text : TOML.
    changes : other values for some keys, see ``with_changes``.

    Raises
    ------
    InvalidInput
        "file_unreadable", "unknown_key" (with the nearest right key), "key_missing",
        "key_misplaced" (a key of another choice), "options_clash" (none or several of keys that
        exclude each other), "unknown_name", "out_of_range" or "not_finite"; or a limit is passed:
        "file_too_large" or "too_many".

    Examples
    --------
    >>> parse_scene("[medum]")
    Traceback (most recent call last):
    ...
    airtact.errors.InvalidInput: medum is not a key of a scene file; did you mean medium?
    """
    _check_text(text)
    try:
        data = msgspec.toml.decode(text.encode())
    except RecursionError:
        raise InvalidInput("lists and tables are nested too deep.", code="file_too_large") from None
    except ValueError as error:  # also of numbers with thousands of digits
        words = str(error)
        raise InvalidInput(
            f"this is not TOML: {words[:1].lower()}{words[1:]}.", code="file_unreadable"
        ) from None
    if changes:
        data = with_changes(data, changes)
    _check_numbers(data, "", 0)
    # Before any body is made: each may take a second, and pairs are compared later.
    bodies = data.get("obstacles")
    if isinstance(bodies, list) and len(bodies) > MAX_BODIES:
        raise InvalidInput(
            f"there are {len(bodies)} obstacles, more than {MAX_BODIES}.", code="too_many"
        )
    return _table(data, SceneFile, "")


def _check_text(text: str) -> None:
    try:
        size = len(text.encode())
    except UnicodeEncodeError as error:
        sentence = f"the text is not Unicode: character {error.start} is half of a pair."
        raise InvalidInput(sentence, code="file_unreadable") from None
    if size > LARGEST_SCENE_FILE:
        sentence = f"the text has {size:,} bytes, more than {LARGEST_SCENE_FILE:,}."
        raise InvalidInput(sentence, code="file_too_large")
    # The decoder takes minutes for keys of thousands of parts; all else it reads in seconds.
    parts = 0
    for word in text.split("."):
        parts = 0 if re.search(r"[\n=,\[\]{}]", word) else parts + 1
        if parts >= MAX_LEVELS:
            raise InvalidInput(
                f"a key has more than {MAX_LEVELS} parts between dots.", code="file_too_large"
            )


def _check_numbers(data: object, path: str, level: int) -> None:
    # Products of numbers beyond these sizes would overflow, or lose all digits, further on.
    if level > MAX_LEVELS:
        raise InvalidInput(
            f"{path} is more than {MAX_LEVELS} levels deep in lists and tables.",
            code="file_too_large",
        )
    if isinstance(data, dict):
        for key, value in data.items():
            _check_numbers(value, _joined(path, key), level + 1)
    elif isinstance(data, list):
        for index, value in enumerate(data):
            _check_numbers(value, f"{path}[{index}]", level + 1)
    elif isinstance(data, int | float):
        if not abs(data) < math.inf:  # also NaN
            raise InvalidInput(f"{path} is {data}, but it must be finite.", code="not_finite")
        if 0 < abs(data) < SMALLEST_NUMBER or abs(data) > LARGEST_NUMBER:
            # No float holds the largest integers.
            number = f"{data:.3g}" if abs(data) < 1e300 else "too large"
            raise InvalidInput(
                f"{path} is {number}, but its size must be 0, or lie between {SMALLEST_NUMBER:g} "
                f"and {LARGEST_NUMBER:g}.",
                code="out_of_range",
            )


@cache
def keys_of(table: type[Table]) -> frozenset[str]:
    """Return the keys that a table may hold, those of its choices included."""
    keys: set[str] = set()
    for field in _fields(table):
        kinds = _tables_in(field.type)
        if len(kinds) < 2:
            keys.add(field.name)
        else:
            keys.update(*(_keys_beside(kind) for kind in kinds))
    return frozenset(keys)


def nearest(word: str, names: Iterable[str], prefix: str = "") -> str:
    """Suggest the known word that was probably meant, or list all.

    >>> nearest("finite_elemant", ["boundary_element", "finite_element"])
    'did you mean finite_element?'
    """
    names = sorted(names)
    # The time of difflib grows with the square of the word's length.
    close = difflib.get_close_matches(word[:50], names, n=1)
    if close:
        return f"did you mean {prefix}{close[0]}?"
    return f"there is {', '.join(prefix + name for name in names)}."


def _table(data: Any, table: type[AnyTable], path: str) -> AnyTable:
    """Convert one table, after its choices and the tables in it."""
    if not isinstance(data, dict):
        return _converted(data, table, path)
    _check_keys(data, table, path)
    ready: dict[str, Any] = {}
    # Choices come last, so that a fault inside a table is named before one of the choice.
    for field in sorted(_fields(table), key=lambda field: len(_tables_in(field.type))):
        kinds = _tables_in(field.type)
        if len(kinds) > 1:
            chosen = _chosen(data, field, kinds, path)
            if chosen is not None:
                ready[field.name] = chosen
        elif field.name in data:
            value = data[field.name]
            inner = _joined(path, field.name)
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
    names = keys_of(table)
    for key in data:
        if key not in names:
            before = f"{path}." if path else ""
            raise InvalidInput(
                f"{before}{key} is not a key of a scene file; {nearest(key, names, before)}",
                code="unknown_key",
            )


def _chosen(
    data: Mapping[str, Any], field: msgspec.structs.FieldInfo, kinds: list[type[Table]], path: str
) -> Table | None:
    """Find the choice that a table makes, and convert its keys.

    None for the default of the field.
    """
    tags = {str(kind.__struct_config__.tag): kind for kind in kinds}
    by_value = not issubclass(kinds[0], Choice)
    # msgspec distinguishes tables by a tag in them only, not by which keys they have.
    tag = (_tag_by_value if by_value else _tag_by_key)(data, field, tags, path)
    if tag is None:
        return None
    kind = tags[tag]
    keys = _keys_beside(kind)
    foreign = {key for each in kinds for key in _keys_beside(each)} & data.keys() - keys
    for key in sorted(foreign):
        owners = [
            _phrase(field, name, by_value)
            for name, each in tags.items()
            if key in _keys_beside(each)
        ]
        raise InvalidInput(
            f"{_joined(path, key)} goes only with {' or '.join(owners)}.", code="key_misplaced"
        )
    if tag == ".csv":
        return _table({"file": data[field.name]}, kind, path)
    if not by_value and tag not in kind.__struct_fields__:
        return _table(data[tag], kind, _joined(path, tag))
    for inner in _fields(kind):
        if inner.required and inner.name not in data:
            raise InvalidInput(
                f"the key {_joined(path, inner.name)} is missing: "
                f"{_phrase(field, tag, by_value)} needs it.",
                code="key_missing",
            )
    chosen = {key: data[key] for key in keys if key in data}
    if by_value:
        chosen.pop(field.name, None)
    return _table(chosen, kind, path)


def _phrase(field: msgspec.structs.FieldInfo, tag: str, by_value: bool) -> str:
    return f'{field.name} = "{tag}"' if by_value else tag


def _tag_by_key(
    data: Mapping[str, Any],
    field: msgspec.structs.FieldInfo,
    tags: Mapping[str, type[Table]],
    path: str,
) -> str | None:
    """Find the choice whose tag is a key, or else the one that has other keys of the table."""
    chosen = [tag for tag in tags if tag in data]
    if not chosen:
        chosen = [tag for tag, kind in tags.items() if _keys_beside(kind) & data.keys()]
    if not chosen and not field.required:
        return None
    if len(chosen) != 1:
        choices = [" and ".join(_leading(kind)) for kind in tags.values()]
        raise InvalidInput(
            f"{path}: give exactly one of {', '.join(choices)}; {len(chosen)} given.",
            code="options_clash",
        )
    return chosen[0]


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
    # A frequent slip: the kind of board in place of the layout.
    if value in BOARDS and field.name == "layout":
        raise InvalidInput(
            f'{_joined(path, field.name)} = "{value}" is a kind of board: write layout = "boards", '
            f'board = "{value}" '
            "and poses = [{ translation = [x, y, z] }], a pose for each board.",
            code="unknown_name",
        )
    names = [tag for tag in tags if tag != ".csv"]
    kind = f"not a known {field.name}"
    if ".csv" in tags:
        kind = f"neither a known {field.name} nor a .csv file"
    raise InvalidInput(
        f'{_joined(path, field.name)} = "{value}" is {kind}; {nearest(value, names)}',
        code="unknown_name",
    )


@cache
def _keys_beside(kind: type[Table]) -> frozenset[str]:
    # A choice whose tag is one of its keys has its keys in the table that makes the choice; of
    # other choices that table has only the tag, with the keys in a table of its own.
    config = kind.__struct_config__
    if not issubclass(kind, Choice):
        keys = frozenset() if config.tag == ".csv" else keys_of(kind)
        return keys | {str(config.tag_field)}
    if config.tag in kind.__struct_fields__:
        return keys_of(kind)
    return frozenset({str(config.tag)})


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


def _converted(data: Any, kind: type[Any], path: str) -> Any:
    try:
        return msgspec.convert(data, kind)
    except msgspec.ValidationError as error:
        fault, _, inner = str(error).partition(" - at ")
    where = path + inner.strip("`").removeprefix("$")
    where = where.removeprefix(".")
    missing = re.fullmatch(r"Object missing required field `(.+)`", fault)
    if missing:
        raise InvalidInput(f"the key {_joined(where, missing[1])} is missing.", code="key_missing")
    fault = re.sub(r"`([a-z| ]+)`", _plain_types, fault)
    raise InvalidInput(f"{where}: {fault[:1].lower()}{fault[1:]}.", code="out_of_range")


def _plain_types(match: re.Match[str]) -> str:
    # Users of TOML do not know the names of Python's and JSON's types.
    words = {
        "array": "a list",
        "bool": "true or false",
        "float": "a number",
        "int": "a whole number",
        "object": "a table",
        "str": "a string",
    }
    return " or ".join(words.get(word, word) for word in match[1].split(" | ") if word != "null")


def with_changes(data: Mapping[str, Any], changes: Mapping[str, Value]) -> dict[str, Any]:
    """Return decoded TOML in which some keys have other values.

    Parameters
    ----------
    data : tables, lists and values of a scene file; it stays as it is.
    changes : values by paths such as ``foci[0].offset``. ``hand.gap`` is short for the key of the
        only obstacle that is a hand, and so for the other kinds of bodies. A key that the file
        leaves out is added.

    Raises
    ------
    InvalidInput
        "unknown_key": a path leads nowhere; the sentence names what is there. "given_twice": two
        paths are one key.

    Examples
    --------
    >>> with_changes({"foci": [{"at": "thumb.pad"}]}, {"foci[0].offset": 1e-3})
    {'foci': [{'at': 'thumb.pad', 'offset': 0.001}]}
    """
    changed = deepcopy(dict(data))
    seen: dict[tuple[str | int, ...], str] = {}
    for path, value in changes.items():
        steps = _full(_steps(path), changed, path)
        earlier = seen.setdefault(tuple(steps), path)
        if earlier != path:
            raise InvalidInput(
                f"{earlier} and {path} are the same key; give it once.", code="given_twice"
            )
        # Tables that the file leaves out are made on the way.
        inner: Any = changed
        for step, following in pairwise(steps):
            inner = _inside(inner, step, following, path)
        last = steps[-1]
        if not isinstance(last, str) or not isinstance(inner, dict):
            _at(inner, last, path)
            inner[last] = value
        elif value is None:
            inner.pop(last, None)
        else:
            inner[last] = value
    return changed


def _steps(path: str) -> list[str | int]:
    if not re.fullmatch(r"[\w-]+(\.[\w-]+|\[\d+\])*", path):
        raise InvalidInput(
            f"{path!r} is not the path of a key: write its tables, with numbers from 0 in brackets "
            "where there are several, such as foci[0].offset.",
            code="unknown_key",
        )
    return [
        match[1] if match[2] is None else int(match[2])
        for match in re.finditer(r"([\w-]+)|\[(\d+)\]", path)
    ]


def _full(steps: list[str | int], data: Mapping[str, Any], path: str) -> list[str | int]:
    """Write out a path that begins with the kind of a body."""
    kind = str(steps[0])
    if kind in keys_of(SceneFile):
        return steps
    bodies = [body if isinstance(body, dict) else {} for body in data.get("obstacles", [])]
    indices = [index for index, body in enumerate(bodies) if kind in body]
    if len(indices) != 1:
        kinds = {body.__struct_config__.tag for body in typing.get_args(tables.Body)}
        names = sorted({key for body in bodies for key in body} & kinds)
        beside = f" and the bodies {', '.join(names)}" if names else ""
        raise InvalidInput(
            f"{path}: {len(indices)} bodies are named {kind!r}; a path begins with "
            f"{', '.join(sorted(data))}{beside}, and obstacles[0] is the first body.",
            code="unknown_key",
        )
    index = indices[0]
    # Keys of the body stand in a table of its kind, pose and boundary beside it.
    beside_kind = len(steps) > 1 and steps[1] in ("pose", "boundary")
    if isinstance(bodies[index][kind], dict) and not beside_kind:
        return ["obstacles", index, *steps]
    return ["obstacles", index, *steps[1:]]


def _inside(inner: Any, step: str | int, following: str | int, path: str) -> Any:
    """Find the table or the list that a step leads to; a table that is left out is made."""
    if isinstance(step, str) and isinstance(inner, dict) and step not in inner:
        if isinstance(following, str):
            inner[step] = {}
        elif step == "translation":  # which a file may leave out
            inner[step] = [0.0, 0.0, 0.0]
    return _at(inner, step, path)


def _at(inner: Any, step: str | int, path: str) -> Any:
    if isinstance(step, int) and isinstance(inner, list) and step < len(inner):
        return inner[step]
    if isinstance(step, str) and isinstance(inner, dict) and step in inner:
        return inner[step]
    word = f"[{step}]" if isinstance(step, int) else step
    if isinstance(inner, list):
        hint = f"there are [0] to [{len(inner) - 1}]." if inner else "the list is empty."
    elif isinstance(inner, dict):
        hint = nearest(str(step), inner) if inner else "the table is empty."
    else:
        hint = f"its value is {inner!r}, not a table or a list."
    raise InvalidInput(f"{path}: {word} is not in the scene file; {hint}", code="unknown_key")
