"""Files that appear whole or not at all, so that an interrupted run leaves nothing half written."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from airtact.conventions import InvalidInput


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Write under another name, then rename: the file appears only once it is finished.

    Parameters
    ----------
    path : of the finished file.

    Yields
    ------
    The path to write to, in the same folder; removed again if the writing fails.
    """
    partial = path.with_name(f".{path.name}.partial")
    try:
        yield partial
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def writable_folder(path: Path) -> Path:
    """Make a folder and prove that files can be written in it.

    Raises
    ------
    InvalidInput : the folder cannot be made, or nothing can be written there.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        with whole_file(path / "probe") as probe:
            probe.touch()
        (path / "probe").unlink()
    except OSError as error:
        raise InvalidInput(
            f"cannot write into the output folder {path}: {error.strerror} (error {error.errno})",
            code="folder_not_writable",
        ) from None
    return path
