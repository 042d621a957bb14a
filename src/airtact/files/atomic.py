"""Atomic writing: an interrupted run leaves no incomplete file."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from airtact.errors import InvalidInput


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield another path in the same folder to write to, then rename it.

    The file appears only when it is complete, even if several processes write it.
    """
    partial = path.with_name(f".{path.name}.{secrets.token_hex(4)}.partial")
    try:
        yield partial
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


@contextmanager
def written(path: Path) -> Iterator[Path]:
    """Write a file like ``whole_file``; raise "not_writable" on failure."""
    if not path.parent.is_dir():
        raise InvalidInput(
            f"{path.name} cannot be written: there is no folder {path.parent}; make it first.",
            code="not_writable",
        )
    try:
        with whole_file(path) as partial:
            yield partial
    except OSError as error:
        raise InvalidInput(
            f"cannot write {path}: {error.strerror or error} (error {error.errno}).",
            code="not_writable",
        ) from None


def writable_folder(path: Path) -> Path:
    """Make a folder and check that it is writable; raise "not_writable" on failure."""
    try:
        path.mkdir(parents=True, exist_ok=True)
        with whole_file(path / "probe") as probe:
            probe.touch()
        (path / "probe").unlink()
    except (FileExistsError, NotADirectoryError):
        file = next(part for part in (path, *path.parents) if part.exists())
        raise InvalidInput(
            f"the output folder {path} cannot be made: {file} is a file. Name another folder.",
            code="not_writable",
        ) from None
    except OSError as error:
        raise InvalidInput(
            f"cannot write into the output folder {path}: {error.strerror} (error {error.errno}).",
            code="not_writable",
        ) from None
    return path
