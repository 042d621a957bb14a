"""Write the tables of keys in scene-file.md from the tables of the schema: ``python docs/scene_file.py``.

The tables are between ``<!-- table NAME -->`` and ``<!-- end -->``; the rest of the page is
written by hand.
"""

import inspect
import re
import types
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec

from airtact.setup import tables

PAGE = Path(__file__).with_name("scene-file.md")
PLACE = re.compile(r"(<!-- table (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)
TYPES = {bool: "true or false", float: "number", int: "whole number", str: "text"}


def filled(page: str) -> str:
    """Return the page with its tables of keys rewritten."""
    return PLACE.sub(lambda place: place[1] + table_of(getattr(tables, place[2])) + place[3], page)


def table_of(table: type[tables.Table]) -> str:
    """Describe the keys of a table: a sentence on choices, and a row for each key, or for like keys."""
    meanings = dict(meanings_of(table))
    head = ""
    if table.one_of:
        names = ", ".join(f"`{name}`" for name in table.one_of)
        head = f"Set exactly one of {names}.\n\n"
    keys: dict[tuple[str, ...], list[str]] = {}
    for field in msgspec.structs.fields(table):
        meaning, unit = meanings[field.name]
        meaning, default = default_of(field, meaning)
        cells = (type_of(field.type), unit, default, meaning + rules_of(field))
        keys.setdefault(cells, []).append(f"`{field.name}`")
    rows = ["|key|type|unit|default|meaning|", "|---|---|---|---|---|"]
    rows += [f"|{'|'.join((', '.join(names), *cells))}|" for cells, names in keys.items()]
    return head + "\n".join(rows) + "\n"


def meanings_of(table: type[tables.Table]) -> Iterator[tuple[str, tuple[str, str]]]:
    """Yield the meaning and the unit of each key, as the docstrings state them."""
    for kind in reversed(table.__mro__):
        text = inspect.cleandoc(vars(kind).get("__doc__") or "")
        text = re.sub(r"\n    +", " ", text.partition("----------\n")[2])
        for names, meaning in re.findall(r"^([\w, ]+) : (.*)$", text, re.MULTILINE):
            keys = names.split(", ")
            unit = re.search(r" ?\[([^\]]*)\](?=[.;])", meaning)
            plain = meaning.replace(unit[0], "", 1) if unit else meaning
            units = unit[1].split(", ") if unit else [""]
            for index, key in enumerate(keys):
                yield key, (plain.replace("``", "`").rstrip("."), units[index % len(units)])


def default_of(field: msgspec.structs.FieldInfo, meaning: str) -> tuple[str, str]:
    """Split the stated default from the meaning of a key, or return the schema's default."""
    kept, _, stated = meaning.partition("; by default ")
    if stated:
        return kept, stated
    if field.required:
        return meaning, "required"
    if field.default in (None, msgspec.NODEFAULT) or isinstance(field.default, tables.Table):
        return meaning, ""
    written = msgspec.json.encode(field.default).decode()
    return meaning, re.sub(r"\.0\b", "", written).replace(",", ", ")


def type_of(kind: Any) -> str:
    """Name a type for users of TOML, with its range."""
    kinds = [part for part in parts_of(kind) if part is not type(None)]
    return " or ".join(dict.fromkeys(name_of(part) for part in kinds))


def parts_of(kind: Any) -> Iterator[Any]:
    """Yield the alternatives of a type, without rules."""
    if typing.get_origin(kind) in (types.UnionType, typing.Union):
        for part in typing.get_args(kind):
            yield from parts_of(part)
    elif typing.get_origin(kind) is typing.Annotated and not any(
        isinstance(note, msgspec.Meta) for note in kind.__metadata__
    ):
        yield from parts_of(kind.__origin__)
    else:
        yield kind


def name_of(kind: Any) -> str:
    """Name one alternative of a type."""
    origin = typing.get_origin(kind)
    if origin is typing.Annotated:
        limits = next(note for note in kind.__metadata__ if isinstance(note, msgspec.Meta))
        lowest = f"at least {limits.ge:g}" if limits.ge is not None else ""
        lowest = f"above {limits.gt:g}" if limits.gt is not None else lowest
        span = f"{limits.ge:g} to {limits.le:g}" if limits.le is not None else lowest
        return type_of(kind.__origin__) + (f", {span}" if span else "")
    if origin is typing.Literal:
        return ", ".join(f'"{word}"' for word in typing.get_args(kind))
    if origin is list:
        return f"list of {type_of(typing.get_args(kind)[0])}".replace("table", "tables")
    if origin is tuple:
        parts = typing.get_args(kind)
        if len(parts) == 2:
            return "[a, b]"
        return "[x, y, z]" if parts[0] is float else "3 x 3 numbers"
    if isinstance(kind, type) and issubclass(kind, tables.Table):
        return "table"
    return TYPES[kind]


def rules_of(field: msgspec.structs.FieldInfo) -> str:
    """State with which keys a key can be combined."""
    words = {"only with": "Only with", "not with": "Not with", "needed by": "Required with"}
    rules = [
        note for note in getattr(field.type, "__metadata__", ()) if isinstance(note, tables.Rule)
    ]
    return "".join(
        f". {words[rule.words]} {' or '.join(f'`{other}`' for other in rule.conditions)}"
        for rule in rules
    )


if __name__ == "__main__":
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
