"""Reading of bytes, text, NumPy arrays and HDF5 datasets within size limits.

Devices and pipes are rejected. The unpacked size is checked before anything is unpacked.
"""

import io
import stat
import warnings
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Shaped

from airtact.errors import LARGEST_DATA, InvalidInput, about, file_fault

# Arrays of a file by name
Arrays = dict[str, Shaped[np.ndarray, "..."]]


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


def array_of(path: Path) -> Shaped[np.ndarray, "..."]:
    """Read the array of a .npy file; raise as ``check_file``."""
    return _decoded(_array, path, ".npy")


def arrays_of(path: Path) -> Arrays:
    """Read the arrays of a .npz file, up to ``LARGEST_DATA`` bytes unpacked.

    Raise as ``check_file``.
    """
    return _decoded(_archive, path, ".npz")


def datasets_of(path: Path) -> Mapping[str, Shaped[np.ndarray, "..."] | np.generic | str]:
    """Read the datasets in the root group of an HDF5 file, up to ``LARGEST_DATA`` bytes.

    Links to other files and external data are ignored. Raise as ``check_file``.
    """
    return _decoded(_datasets, path, ".h5")


def _decoded(decode: Callable[[bytes], Any], path: Path, kind: str) -> Any:
    content = bytes_of(path)
    try:
        with about(path.name):
            return decode(content)
    except InvalidInput:
        raise
    except Exception as error:  # zipfile, zlib, NumPy and h5py raise many kinds for damaged files
        raise InvalidInput(
            f"{path.name} is not a complete {kind} file ({type(error).__name__}); write it again.",
            code="file_unreadable",
        ) from None


def _array(content: bytes) -> Shaped[np.ndarray, "..."]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about headers written by Python 2
        return np.asarray(np.lib.format.read_array(io.BytesIO(content), allow_pickle=False))


def _archive(content: bytes) -> Arrays:
    with zipfile.ZipFile(io.BytesIO(content)) as file:
        members = file.infolist()
        _check_size(sum(member.file_size for member in members))
        return {
            member.filename.removesuffix(".npy"): _array(file.read(member)) for member in members
        }


def _datasets(content: bytes) -> dict[str, Any]:
    import h5py

    file: Any
    with h5py.File(io.BytesIO(content), "r") as file:
        datasets = {
            name: file[name]
            for name in file
            if isinstance(file.get(name, getlink=True), h5py.HardLink)
            and isinstance(file[name], h5py.Dataset)
            and not file[name].is_virtual
            and not file[name].external
        }
        sizes = [item.size * max(item.dtype.itemsize, 1) for item in datasets.values() if item.size]
        _check_size(sum(sizes))
        return {
            name: item.asstr()[()] if item.dtype.kind in "OS" else item[()]
            for name, item in datasets.items()
        }


def _check_size(size: int) -> None:
    if size > LARGEST_DATA:
        raise InvalidInput(
            f"its arrays have {size:,} bytes, more than {LARGEST_DATA:,}; store fewer or smaller "
            "arrays.",
            code="file_too_large",
        )
