"""Values that take the place of those in a scene file, each by the path of its key."""

import re
from collections.abc import Mapping
from typing import Any

from airtact.errors import InvalidInput
from airtact.setup import tables
from airtact.setup.parsing import Item, keys_of, nearest

Value = str | float | int | bool | None
"""What a key may be set to; None takes the key away."""

_STEP = re.compile(r"\.?([\w-]+)|\[(\d+)\]")

_DEFAULTS = {"translation": (0.0, 0.0, 0.0)}
"""Lists that a file may leave out, so that one of their numbers can be given alone."""


def with_changes(data: Mapping[str, Item], changes: Mapping[str, Value]) -> dict[str, Item]:
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
        "unknown_key": a path leads nowhere; the sentence names what is there. "given_twice": two paths are one key.

    Examples
    --------
    >>> with_changes({"foci": [{"at": "thumb.pad"}]}, {"foci[0].offset": 1e-3})
    {'foci': [{'at': 'thumb.pad', 'offset': 0.001}]}
    """
    changed, seen = _copied(dict(data)), {}
    for path, value in changes.items():
        steps = _full(_steps(path), changed, path)
        if (other := seen.setdefault(tuple(steps), path)) != path:
            raise InvalidInput(f"{other} and {path} are 1 key; give it once.", code="given_twice")
        inner = changed
        for index, step in enumerate(steps[:-1]):
            inner = _inside(inner, step, steps[index + 1], path)
        _put(inner, steps[-1], value, path)
    return changed


def _copied(data: Any) -> Any:
    if isinstance(data, dict):
        return {key: _copied(value) for key, value in data.items()}
    return [_copied(value) for value in data] if isinstance(data, list | tuple) else data


def _steps(path: str) -> list[str | int]:
    """Split a path into keys and indices."""
    steps, end = [], 0
    for found in _STEP.finditer(path):
        if found.start() != end or (found[1] and end and path[end] != "."):
            break
        steps.append(found[1] if found[2] is None else int(found[2]))
        end = found.end()
    if end != len(path) or not steps or path[0] in ".[":
        raise InvalidInput(
            f"{path!r} is not the path of a key: write its tables, with numbers from 0 in brackets where there are "
            "several, such as foci[0].offset.",
            code="unknown_key",
        )
    return steps


def _full(steps: list[str | int], data: Mapping[str, Any], path: str) -> list[str | int]:
    """Write out a path that begins with the kind of a body."""
    kind = str(steps[0])
    if kind in keys_of(tables.SceneFile):
        return steps
    bodies = [one if isinstance(one, dict) else {} for one in data.get("obstacles", [])]
    found = [index for index, body in enumerate(bodies) if kind in body]
    if len(found) != 1:
        known = sorted({key for body in bodies for key in body} & set(_KINDS))
        kinds = f" and the bodies {', '.join(known)}" if known else ""
        raise InvalidInput(
            f"{path}: {len(found)} bodies here are named {kind!r}; a path begins with {', '.join(sorted(data))}{kinds}"
            ", and obstacles[0] is the first body.",
            code="unknown_key",
        )
    own = isinstance(bodies[found[0]][kind], dict) and (
        len(steps) < 2 or steps[1] not in ("pose", "boundary")
    )
    return ["obstacles", found[0], *([kind] if own else []), *steps[1:]]


_KINDS = ("capsule", "hand", "pinch", "sphere", "surface")


def _inside(inner: Any, step: str | int, then: str | int, path: str) -> Any:
    """Find the table or the list that a step leads to; a table that is left out is made."""
    if isinstance(step, int) or (isinstance(inner, dict) and step in inner):
        found = _at(inner, step, path)
    elif isinstance(inner, dict) and isinstance(then, str):
        found = inner[step] = {}
    elif isinstance(inner, dict) and step in _DEFAULTS:
        found = inner[step] = list(_DEFAULTS[step])
    else:
        found = _at(inner, step, path)
    return found


def _at(inner: Any, step: str | int, path: str) -> Any:
    if isinstance(step, int) and isinstance(inner, list) and step < len(inner):
        return inner[step]
    if isinstance(step, str) and isinstance(inner, dict) and step in inner:
        return inner[step]
    raise _nowhere(inner, step, path)


def _put(inner: Any, step: str | int, value: Value, path: str) -> None:
    if isinstance(step, str) and isinstance(inner, dict):
        if value is None:
            inner.pop(step, None)
        else:
            inner[step] = value
    else:
        _at(inner, step, path)
        inner[step] = value


def _nowhere(inner: Any, step: str | int, path: str) -> InvalidInput:
    """Make the fault of a step that is not there."""
    word = f"[{step}]" if isinstance(step, int) else step
    if isinstance(inner, list):
        there = f"there are [0] to [{len(inner) - 1}]" if inner else "the list there is empty"
    elif isinstance(inner, dict):
        there = nearest(str(step), inner) if inner else "the table there is empty"
    else:
        there = f"a single value ({inner!r}) stands there"
    return InvalidInput(
        f"{path}: {word} is not in the scene file; {there}.".replace("?.", "?"), code="unknown_key"
    )
