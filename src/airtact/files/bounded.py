"""What is read from files, under the limits of ``airtact.errors``: bytes, text, NumPy's arrays, HDF5's datasets.

Only files are opened, never a device or a pipe, and nothing is unpacked before its size is known.
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

from airtact.checks import file_fault
from airtact.errors import LARGEST_DATA, LARGEST_TEXT, InvalidInput

Arrays = dict[str, Shaped[np.ndarray, "..."]]
"""What is in a file of NumPy, by name."""


def check_file(path: Path, largest: int = LARGEST_DATA) -> None:
    """Raise "file_missing", "file_unreadable", or "file_too_large" for a file of more than ``largest`` bytes."""
    try:
        found = path.stat()
    except OSError as error:
        raise file_fault(path, error) from None
    except ValueError as error:  # a name that holds a zero
        raise InvalidInput(
            f"there are 0 files of the name {path.name!r}: {error}.", code="file_missing"
        ) from None
    if not stat.S_ISREG(found.st_mode) and not stat.S_ISDIR(found.st_mode):
        sentence = f"{path.name} is 1 device or pipe, not a file; save its contents in a file."
        raise InvalidInput(sentence, code="file_unreadable")
    if found.st_size > largest:
        sentence = (
            f"{path.name} has {found.st_size:,} bytes, more than {largest:,}; make it smaller."
        )
        raise InvalidInput(sentence, code="file_too_large")


def bytes_of(path: Path, largest: int = LARGEST_DATA) -> bytes:
    """Read a file; raise as ``check_file``."""
    check_file(path, largest)
    try:
        return path.read_bytes()
    except OSError as error:
        raise file_fault(path, error) from None


def text_of(path: Path, largest: int = LARGEST_TEXT) -> str:
    """Read a file as UTF-8 text; raise as ``check_file``, or "file_unreadable"."""
    try:
        return bytes_of(path, largest).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        sentence = f"{path.name} is not a text file: byte {error.start} is not UTF-8."
        raise InvalidInput(sentence, code="file_unreadable") from None


def array_of(path: Path) -> Shaped[np.ndarray, "..."]:
    """Read one array of NumPy's .npy; raise as ``check_file``."""
    raw = bytes_of(path)
    return _whole(_array, raw, path.name, ".npy")


def arrays_of(path: Path) -> Arrays:
    """Read the arrays of NumPy's .npz, ``LARGEST_DATA`` bytes unpacked at most; raise as ``check_file``."""
    raw = bytes_of(path)
    return _whole(_unpacked, raw, path.name, ".npz")


def _unpacked(raw: bytes) -> Arrays:
    with zipfile.ZipFile(io.BytesIO(raw)) as file:
        members = file.infolist()
        _check_size(sum(one.file_size for one in members))
        return {one.filename.removesuffix(".npy"): _array(file.read(one)) for one in members}


def _array(raw: bytes) -> Shaped[np.ndarray, "..."]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of headers that Python 2 wrote
        return np.asarray(np.lib.format.read_array(io.BytesIO(raw), allow_pickle=False))


def _whole(read: Callable[[bytes], Any], raw: bytes, name: str, kind: str) -> Any:
    try:
        return read(raw)
    except InvalidInput as fault:
        raise InvalidInput(f"{name}: {fault}", code=fault.code) from None
    except Exception as error:  # zipfile, zlib and NumPy raise each their own for damaged files
        sentence = f"{name}: its {len(raw)} bytes are no whole {kind} file ({type(error).__name__}); make it anew."
        raise InvalidInput(sentence, code="file_unreadable") from None


def _check_size(size: int) -> None:
    if size > LARGEST_DATA:
        sentence = f"its arrays have {size:,} bytes, more than {LARGEST_DATA:,}; make them fewer or shorter."
        raise InvalidInput(sentence, code="file_too_large")


def datasets_of(path: Path) -> Mapping[str, Shaped[np.ndarray, "..."] | np.generic | str]:
    """Read the datasets at the top of an HDF5 file, ``LARGEST_DATA`` bytes at most; raise as ``check_file``.

    Links to other files, and data that stand in other files, are passed over.
    """
    raw = bytes_of(path)
    return _whole(_datasets, raw, path.name, ".h5")


def _datasets(raw: bytes) -> dict[str, Any]:
    import h5py

    file: Any
    with h5py.File(io.BytesIO(raw), "r") as file:
        links = {name: file.get(name, getlink=True) for name in file}
        found = {
            name: file[name] for name, link in links.items() if isinstance(link, h5py.HardLink)
        }
        sets = {name: one for name, one in found.items() if isinstance(one, h5py.Dataset)}
        own = {name: one for name, one in sets.items() if not one.is_virtual and not one.external}
        _check_size(sum(one.size * max(one.dtype.itemsize, 1) for one in own.values() if one.size))
        return {
            name: one.asstr()[()] if one.dtype.kind in "OS" else one[()]
            for name, one in own.items()
        }
