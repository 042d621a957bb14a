"""Functions that read bytes, text and HDF5 datasets within size limits.

Devices and pipes are rejected. The unpacked size is checked before anything is unpacked.
"""

import json
import math
import re
import stat
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from airtact.errors import LARGEST_DATA, InvalidInput, about, file_fault


def check_file(path: Path, largest: int = LARGEST_DATA) -> None:
    """Raise an error if a file is missing, is a device or a pipe, or exceeds ``largest`` bytes."""
    try:
        status = path.stat()
    except OSError as error:
        raise file_fault(path, error) from None
    except ValueError as error:  # the name contains a zero byte
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
            f"{path.name} has {status.st_size:,} bytes, but at most {largest:,} are allowed; make "
            "it smaller.",
            code="file_too_large",
        )


def bytes_of(path: Path, largest: int = LARGEST_DATA) -> bytes:
    """Return the bytes of a file, or raise an error as ``check_file`` does."""
    check_file(path, largest)
    try:
        return path.read_bytes()
    except OSError as error:
        raise file_fault(path, error) from None


def text_of(path: Path, largest: int = 2**26) -> str:
    """Return the text of a UTF-8 file, or raise an error as ``check_file`` does."""
    try:
        text = bytes_of(path, largest).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InvalidInput(
            f"{path.name} is not a text file: byte {error.start} is not UTF-8. Save it as UTF-8.",
            code="file_unreadable",
        ) from None
    # For example, a form feed ends a line in Python, but not in an editor.
    control = re.search("[\0-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u2028\u2029]", text)
    if control is not None:
        line = text.count("\n", 0, control.start()) + 1
        raise InvalidInput(
            f"line {line} of {path.name} contains the control character {control[0]!r}; remove it.",
            code="file_unreadable",
        )
    return text


def json_of(text: str | bytes) -> Any:
    """Parse JSON, or raise ``ValueError`` if it is malformed or an object repeats a key."""

    def without_repeats(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        key, count = Counter(key for key, _ in pairs or [("", None)]).most_common(1)[0]
        if count > 1:
            raise ValueError(f"the key {key!r} occurs {count} times")
        return dict(pairs)

    return json.loads(text, object_pairs_hook=without_repeats)


# Kinds of values in a layout, and the corresponding kinds of NumPy types.
KINDS = {"real": "biuf", "complex": "biufc", "whole": "biu", "text": "OS"}


def datasets_of(
    path: Path, layout: Mapping[str, str], newest: int, largest: int = LARGEST_DATA
) -> dict[str, Any]:
    """Read those datasets and attributes of an HDF5 file that ``layout`` lists.

    If another process has locked the file, the function waits for up to 10 s.

    Parameters
    ----------
    path : the file.
    layout : mapping from the name of each value to its kind and axes, such as
        ``{"drives/time": "real drives"}``. Names of attributes begin with ``@``, and kinds of
        optional values with ``optional``. Kinds are ``real`` (float64), ``complex``,
        ``whole`` (int64) and ``text``. An axis is a number, a name or ``*``. A name stands for the
        same length everywhere, and ``*`` for any length. An axis in brackets is optional.
    newest : newest ``format_version`` that can be read.
    largest : largest size of the file, and of its unpacked arrays [bytes].

    Raises
    ------
    InvalidInput
        If the file is missing, too large, damaged, or a device or pipe; if its version is not
        supported; if data are missing or have the wrong kind or shape; if the arrays are too large;
        or if the file refers to other files.
    """
    import h5py

    check_file(path, largest)
    values: dict[str, Any] = {}
    lengths: dict[str, int] = {}
    size = 0
    with about(path.name), _open_file(path) as file:
        for entry, form in layout.items():
            name = entry.lstrip("@")
            kind, *axes = form.removeprefix("optional ").split()
            item = _item(file, entry)
            if item is None and form.startswith("optional"):
                continue
            # An unsupported version explains all other errors.
            is_version = name == "format_version"
            if item is None:
                # Name files of airtact that belong to another command.
                kinds = {
                    "frames/time": "a live session: use airtact live --from or --verify.",
                    "amplitude": "a drive: use airtact emit or export.",
                    "pressures_real": "echoes: use airtact sense or calibrate.",
                }
                missing = f"the file does not contain {name}; write it in airtact's format."
                own = (
                    f"the file is {words}"
                    for entry, words in kinds.items()
                    if entry not in layout and _item(file, entry) is not None
                )
                raise InvalidInput(
                    next(own, missing),
                    code="unsupported_version" if is_version else "data_missing",
                )
            text = h5py.check_string_dtype(item.dtype) is not None
            if item.dtype.kind not in KINDS[kind] or text != (kind == "text"):
                raise InvalidInput(
                    f"{name} is of type {item.dtype}, but must be {kind}.",
                    code="unsupported_version" if is_version else "not_a_number",
                )
            shape = _checked_shape(name, item.shape, axes, lengths)
            # Whole chunks are unpacked, which can be larger than the dataset.
            chunk = math.prod(getattr(item, "chunks", None) or (0,))
            size += item.dtype.itemsize * max(math.prod(shape), chunk)
            if size > largest:
                raise InvalidInput(
                    f"the arrays of the file take {size:,} bytes, but at most {largest:,} are "
                    "allowed; store fewer or smaller arrays.",
                    code="file_too_large",
                )
            raw = file.attrs[name] if entry.startswith("@") else item[()]
            values[name] = _converted(raw, kind, shape)
            if is_version and not 1 <= values[name] <= newest:
                raise InvalidInput(
                    f"the file's format_version is {values[name]}, but only versions 1 to "
                    f"{newest} can be read: update airtact.",
                    code="unsupported_version",
                )
    return values


@contextmanager
def _open_file(path: Path) -> Iterator[Any]:
    """Open an HDF5 file, and convert all errors of its library to ``InvalidInput``."""
    import h5py

    # On a busy machine, the process that writes a session can end seconds after its loop.
    end = time.monotonic() + 10.0
    try:
        while True:
            try:
                file = h5py.File(path, "r")
                break
            except BlockingIOError:
                if time.monotonic() > end:
                    raise
                time.sleep(0.25)
        with file:
            yield file
    except InvalidInput:
        raise
    except Exception as error:  # h5py raises many types of errors for damaged files
        if isinstance(error, OSError) and error.errno is not None:
            raise file_fault(path, error) from None
        raise InvalidInput(
            f"the file is not a complete HDF5 file ({type(error).__name__}); write it again.",
            code="file_unreadable",
        ) from None


def _item(file: Any, entry: str) -> Any:
    """Return an attribute, or a dataset stored in the file itself; None if there is none."""
    import h5py

    if entry.startswith("@"):
        return file.attrs.get_id(entry[1:]) if entry[1:] in file.attrs else None
    item = file
    for part in entry.split("/"):
        if not isinstance(item, h5py.Group) or not item.id.links.exists(part.encode()):
            return None
        # A link can be circular, or refer to a file that the sender wants to read.
        hard = isinstance(item.get(part, getlink=True), h5py.HardLink)
        item = item[part] if hard else None
        stored_here = isinstance(item, h5py.Dataset) and not (item.is_virtual or item.external)
        if not isinstance(item, h5py.Group) and not stored_here:
            raise InvalidInput(
                f"{entry} is a link or stores its data in another file; store the data in the "
                "file itself.",
                code="file_unreadable",
            )
    # An empty dataset has no shape.
    return item if isinstance(item, h5py.Dataset) and item.shape is not None else None


def _checked_shape(
    name: str, shape: tuple[int, ...], axes: Sequence[str], lengths: dict[str, int]
) -> tuple[int, ...]:
    """Compare a shape with its named axes, record the lengths of new axes, and return the shape."""
    if not axes and math.prod(shape) == 1:
        return ()  # other programs store one number as an array
    if len(shape) < len(axes):
        axes = [axis for axis in axes if not axis.startswith("(")]
    names = [axis.strip("()") for axis in axes]
    expected: list[int | str] = list(names)
    if len(shape) == len(names):
        for index, (axis, actual) in enumerate(zip(names, shape, strict=True)):
            known = int(axis) if axis.isdigit() else lengths.setdefault(axis, actual)
            expected[index] = actual if axis == "*" else known
    if expected != list(shape):
        words = " x ".join(map(str, expected)).replace("*", "any")
        raise InvalidInput(
            f"{name} has shape {shape}, but must be {words or 'one value'}.", code="wrong_shape"
        )
    return shape


def _converted(raw: Any, kind: str, shape: tuple[int, ...]) -> Any:
    """Return a number or text for shape (), otherwise an array."""
    array = np.asarray(raw).reshape(shape)
    if kind == "text":
        texts = [text.decode() if isinstance(text, bytes) else str(text) for text in array.flat]
        return texts if shape else texts[0]
    if kind == "complex":
        return array.astype(np.result_type(array.dtype, np.complex64), copy=False)
    array = array.astype(np.float64 if kind == "real" else np.int64, copy=False)
    return array if shape else array.item()
