"""Atomic writing: an interrupted run or a full disk leaves no incomplete file."""

import io
import os
import secrets
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from airtact.errors import InvalidInput


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a temporary path in the folder of ``path``, and then rename the file to ``path``.

    The file appears at ``path`` when it is complete, even if several processes write it, and
    replaces an existing file. If the file cannot be written, the error names the path.
    """
    partial = path.with_name(f".{path.name}.{secrets.token_hex(4)}.partial")
    try:
        try:
            yield partial
            os.replace(partial, path)
        finally:
            partial.unlink(missing_ok=True)
    except OSError as error:
        reason = f"{error.strerror or error} (error {error.errno})"
        if not path.parent.is_dir():
            reason = f"there is no folder {path.parent}; create it first"
        raise InvalidInput(f"cannot write {path}: {reason}.", code="not_writable") from None


@contextmanager
def whole_hdf5(path: Path) -> Iterator[Any]:
    """Yield an HDF5 file in memory, and then write it to disk as ``whole_file`` does."""
    import h5py

    # HDF5 crashes the process if it closes a file on a full disk.
    content = io.BytesIO()
    with h5py.File(content, "w") as file:
        yield file
    with whole_file(path) as partial:
        partial.write_bytes(content.getbuffer())


def writable_folder(path: Path) -> Path:
    """Create a folder, and check that it is writable."""
    try:
        path.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=path).close()
    except (FileExistsError, NotADirectoryError):
        file = next(part for part in (path, *path.parents) if part.exists())
        raise InvalidInput(
            f"the output folder {path} cannot be created: {file} is a file. Choose another folder.",
            code="not_writable",
        ) from None
    except OSError as error:
        raise InvalidInput(
            f"cannot write to the output folder {path}: {error.strerror} (error {error.errno}).",
            code="not_writable",
        ) from None
    return path
