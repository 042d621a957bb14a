"""Reading of bytes, text and HDF5 datasets within size limits.

Devices and pipes are rejected. The unpacked size is checked before anything is unpacked.
"""

import io
import stat
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Shaped

from airtact.errors import LARGEST_DATA, InvalidInput, about, file_fault


def check_file(path: Path, largest: int = LARGEST_DATA) -> None:
    """Raise for a missing file, a device or pipe, or more than ``largest`` bytes."""
    try:
        status = path.stat()
    except OSError as error:
        raise file_fault(path, error) from None
    except ValueError as error:  # the name holds a zero byte
        raise InvalidInput(
            f"there is no file named {path.name!r}: {error}.", code="file_missing"
        ) from None
    if not stat.S_ISREG(status.st_mode) and not stat.S_ISDIR(status.st_mode):
        raise InvalidInput(
            f"{path.name} is a device or pipe; save its contents in a file.",
            code="file_unreadable",
        )
    if status.st_size > largest:
        raise InvalidInput(
            f"{path.name} has {status.st_size:,} bytes, more than {largest:,}; make it smaller.",
            code="file_too_large",
        )


def bytes_of(path: Path, largest: int = LARGEST_DATA) -> bytes:
    """Read a file; raise as ``check_file``."""
    check_file(path, largest)
    try:
        return path.read_bytes()
    except OSError as error:
        raise file_fault(path, error) from None


def text_of(path: Path, largest: int = 2**26) -> str:
    """Read a file as UTF-8 text; raise as ``check_file`` or with "file_unreadable"."""
    try:
        return bytes_of(path, largest).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InvalidInput(
            f"{path.name} is not a text file: byte {error.start} is not UTF-8.",
            code="file_unreadable",
        ) from None


def datasets_of(path: Path) -> Mapping[str, Shaped[np.ndarray, "..."] | np.generic | str]:
    """Read the datasets in the root group of an HDF5 file, up to ``LARGEST_DATA`` bytes.

    Links to other files and external data are ignored. Raise as ``check_file``.
    """
    import h5py

    content = bytes_of(path)
    file: Any
    try:
        with about(path.name), h5py.File(io.BytesIO(content), "r") as file:
            datasets = {
                name: file[name]
                for name in file
                if isinstance(file.get(name, getlink=True), h5py.HardLink)
                and isinstance(file[name], h5py.Dataset)
                and not file[name].is_virtual
                and not file[name].external
            }
            size = sum(
                item.size * max(item.dtype.itemsize, 1) for item in datasets.values() if item.size
            )
            if size > LARGEST_DATA:
                raise InvalidInput(
                    f"its arrays have {size:,} bytes, more than {LARGEST_DATA:,}; store fewer or "
                    "smaller arrays.",
                    code="file_too_large",
                )
            return {
                name: item.asstr()[()] if item.dtype.kind in "OS" else item[()]
                for name, item in datasets.items()
            }
    except InvalidInput:
        raise
    except Exception as error:  # h5py raises many kinds for damaged files
        raise InvalidInput(
            f"{path.name} is not a complete .h5 file ({type(error).__name__}); write it again.",
            code="file_unreadable",
        ) from None
