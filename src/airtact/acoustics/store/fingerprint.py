"""One short name for all that determines a field: scene, sources, solver and the code that computes it."""

import ast
import hashlib
import re
import struct
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import TypeVar

import numpy as np

from airtact import _kernels, errors
from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.problem import Solver
from airtact.acoustics.sources import Monopoles
from airtact.errors import InvalidInput

PACKAGE = Path(errors.__file__).parent
KERNELS = Path(str(_kernels.__file__))

Part = TypeVar("Part")
"""Dataclasses, arrays, numbers, text, and lists and tables of them."""

STATEMENT = re.compile(
    r"^[ \t]*((?:from|import)[ \t][^\n(]*\bairtact\b[^\n(]*(?:\([^)]*\))?)", re.MULTILINE
)
"""A statement that may import a module of airtact; reading only these takes a tenth of the time of whole files."""


def fingerprint(
    solver: Solver, scene: Scene, sources: Monopoles, made_by: str | None = None
) -> str:
    """Name a field by everything that determines it, to the last bit.

    That is every field of the dataclasses that solver, scene and sources consist of, except those
    that take no part in comparisons (``field(compare=False)``: caches): each vertex and mid-edge
    point, boundary, medium, frequency, position, strength and setting; and ``made_by``, by default
    ``program`` of the modules that define those dataclasses. The name has 40 hexadecimal digits.

    Raises
    ------
    InvalidInput
        Something has no known bytes, such as a shape or a solver that is no dataclass; or a file of code is missing.
    """
    return name_of((solver, scene, sources), {type(solver).__module__}, made_by)


def name_of(parts: Sequence[Part], modules: Iterable[str] = (), made_by: str | None = None) -> str:
    """Name some values and the code of the modules that define them, or that are given, as ``fingerprint`` does."""
    digest, found = hashlib.blake2b(digest_size=20), set(modules)
    for part in parts:
        _feed(digest.update, part, found)
    digest.update((made_by or program(frozenset(found))).encode())
    return digest.hexdigest()


@cache
def program(modules: frozenset[str], package: Path = PACKAGE, kernels: Path = KERNELS) -> str:
    """Name the code that some modules run: airtact's version and a digest of all files that their imports lead to.

    Modules outside airtact count as well, and always the compiled loops; raises "file_missing".
    """
    digest = hashlib.blake2b(digest_size=20)
    for name, file in sorted(code_files(modules, package).items()):
        digest.update(name.encode() + hashlib.blake2b(_bytes_of(file)).digest())
    digest.update(hashlib.blake2b(_bytes_of(kernels)).digest())
    return f"airtact {version('airtact')} {digest.hexdigest()}"


def code_files(modules: frozenset[str], package: Path = PACKAGE) -> dict[str, Path]:
    """Follow imports of modules of airtact, also those inside functions: all files by the names of their modules.

    A package on the way counts with its own file; what that imports is followed only where a module
    asks the package for a name that it takes from there.
    """
    found: dict[str, Path] = {}
    waiting, followed = list(modules), {"airtact._kernels"}
    while waiting:
        name = waiting.pop()
        if name in followed:
            continue
        followed.add(name)
        found[name] = _file_of(name, package)
        waiting.extend(_imports(_bytes_of(found[name]).decode(), package))
        while name.startswith("airtact.") and name.count(".") > 1:
            name = name.rpartition(".")[0]
            found[name] = _file_of(name, package)
    return found


def _file_of(name: str, package: Path) -> Path:
    """Find a module's file; that of a module outside airtact is where it was loaded from."""
    if name.split(".")[0] != "airtact":
        loaded = getattr(sys.modules.get(name), "__file__", None)
        if loaded is None:
            raise InvalidInput(
                f"the module {name} has 0 files of code to compare.", code="file_missing"
            )
        return Path(loaded)
    base = package.joinpath(*name.split(".")[1:])
    inside = base / "__init__.py"
    return inside if inside.is_file() else base.with_suffix(".py")


def _bytes_of(file: Path) -> bytes:
    try:
        return file.read_bytes()
    except OSError as error:
        raise InvalidInput(
            f"{file} of airtact cannot be read: {error.strerror}.", code="file_missing"
        ) from None


def _imports(text: str, package: Path) -> Iterator[str]:
    """Yield the names of the modules of airtact that a file imports."""
    try:
        trees = [ast.parse(statement) for statement in STATEMENT.findall(text)]
    except SyntaxError:  # a text that looks like an import, or a bracket in a comment
        trees = [ast.parse(text)]
    for node in (node for tree in trees for node in ast.walk(tree)):
        if isinstance(node, ast.Import):
            yield from (one.name for one in node.names if one.name.split(".")[0] == "airtact")
        elif isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "airtact":
            yield from (_inside(str(node.module), one.name, package) for one in node.names)


def _inside(package_name: str, name: str, package: Path) -> str:
    """Name the module behind ``from package_name import name``: one of that name, or the package that defines it."""
    module, inner = _file_of(package_name, package), f"{package_name}.{name}"
    if inner == "airtact._kernels" or _file_of(inner, package).is_file():
        return inner
    defined = module.name != "__init__.py" or name in re.findall(r"\w+", _bytes_of(module).decode())
    return package_name if defined else inner


def _feed(update: Callable[[bytes], None], value: object, modules: set[str]) -> None:
    """Hand over the kind, the length and the bytes of a value, so that no two values give the same bytes.

    ``modules`` collects the names of those that define the dataclasses.
    """
    kind = type(value)
    if isinstance(value, np.ndarray) and value.dtype.kind in "biufc":
        update(f"array {value.dtype.str} {value.shape} ".encode())
        update(np.ascontiguousarray(value).tobytes())
    elif is_dataclass(value):
        modules.add(kind.__module__)
        some = [field.name for field in fields(value) if field.compare]
        update(f"{kind.__module__}.{kind.__qualname__} {len(some)} ".encode())
        for name in some:
            update(f"{name} ".encode())
            _feed(update, getattr(value, name), modules)
    elif value is None or isinstance(value, bool | int | str | np.bool_ | np.integer):
        words = f"{value}".encode()
        update(f"{'text' if isinstance(value, str) else 'whole'} {len(words)} ".encode() + words)
    elif isinstance(value, float | complex | np.floating | np.complexfloating):
        update(b"number " + struct.pack("<dd", complex(value).real, complex(value).imag))
    elif isinstance(value, tuple | list):
        update(f"list {len(value)} ".encode())
        for one in value:
            _feed(update, one, modules)
    elif isinstance(value, Mapping):
        update(f"table {len(value)} ".encode())
        for key in sorted(value):
            _feed(update, key, modules)
            _feed(update, value[key], modules)
    else:
        raise InvalidInput(
            f"a {kind.__qualname__} cannot be compared with another one: it is no dataclass of numbers.",
            code="does_not_match",
        )
