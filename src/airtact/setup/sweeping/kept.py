"""Results of a sweep on disk, one file a point, named by all that the result follows from."""

import functools
import hashlib
import json
import types
from collections.abc import Iterable
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any

from airtact.acoustics.field_file import save
from airtact.acoustics.store import name_of
from airtact.errors import InvalidInput
from airtact.setup.sweeping.rows import ERROR, SENTENCE, Function, Row

SUFFIX = ".point.json"


def names_of(function: Function, points: Iterable[Row]) -> list[str]:
    """Name points by their values, the function and the code that it runs; 40 hexadecimal digits each.

    A function counts by its module's file, what that imports of airtact, its name, its own code and
    its default arguments; a ``functools.partial`` also by its arguments; an object of a dataclass
    by its fields, except those that take no part in comparisons. Other modules that the file
    imports, and values that it reads, do not count.
    """
    modules: set[str] = set()
    whole = name_of(*_parts(function, modules))
    return [_short(whole, point) for point in points]


def _short(whole: str, point: Row) -> str:
    text = json.dumps([whole, sorted(point.items())], ensure_ascii=True)
    return hashlib.blake2b(text.encode(), digest_size=20).hexdigest()


def _parts(function: Any, modules: set[str]) -> list[Any]:
    """List what a function is, beside the code of its module."""
    if isinstance(function, functools.partial):
        return [*_parts(function.func, modules), list(function.args), dict(function.keywords)]
    if isinstance(function, types.FunctionType):
        if function.__closure__:
            raise InvalidInput(
                f"{function.__qualname__} holds {len(function.__closure__)} values of what surrounds it, which do not "
                "show in its name: make it a function of a module, and give them by functools.partial.",
                code="does_not_match",
            )
        modules.add(function.__module__)
        defaults = list(function.__defaults__ or ()), dict(function.__kwdefaults__ or {})
        return [function.__module__, function.__qualname__, _own_code(function.__code__), *defaults]
    if not is_dataclass(function) or isinstance(function, type):
        raise InvalidInput(
            f"a {type(function).__name__} cannot be compared with another one, so that its results cannot be kept: "
            "give a function of a module, or an object of a dataclass.",
            code="does_not_match",
        )
    modules.add(type(function).__module__)
    return [function]


def _own_code(code: types.CodeType) -> list[str]:
    """Write what tells two functions of one name apart, such as two lambdas: their instructions and constants."""
    inner = [one for one in code.co_consts if isinstance(one, types.CodeType)]
    constants = repr([one for one in code.co_consts if not isinstance(one, types.CodeType)])
    own = [code.co_code.hex(), constants, repr(code.co_names), repr(code.co_varnames)]
    return own + [words for one in inner for words in _own_code(one)]


def load(store: Path, names: Iterable[str]) -> dict[str, Row]:
    """Read what is kept of some points; a damaged file counts as none."""
    found = {}
    for name in names:
        try:
            whole = json.loads((store / (name + SUFFIX)).read_bytes())
        except (OSError, ValueError):
            continue
        row = whole.get("row") if isinstance(whole, dict) and whole.get("name") == name else None
        if isinstance(row, dict) and {ERROR, SENTENCE} <= row.keys():
            found[name] = row
    return found


def keep(store: Path, name: str, row: Row) -> None:
    """Write the result of a point; its file appears whole or not at all."""
    save(store / (name + SUFFIX), json.dumps({"name": name, "row": row}).encode())
