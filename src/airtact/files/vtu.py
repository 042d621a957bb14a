"""VTU files of other programs, by meshio, under the limits of ``airtact.errors``."""

import lzma
import warnings
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from jaxtyping import Complex128, Float64, Int64

from airtact.checks import file_fault
from airtact.errors import LARGEST_DATA, LARGEST_NUMBER, InvalidInput, about, extra
from airtact.files.bounded import check_file

Columns = dict[str, Complex128[np.ndarray, "nodes"]]
"""Numbers at the nodes, by name."""

Nodes = tuple[Float64[np.ndarray, "nodes 3"], Columns, Int64[np.ndarray, "tetrahedra 4"] | None]
"""Positions, numbers, and four nodes of each tetrahedron where there are any."""

_one_reads = Lock()


def nodes_of_vtu(path: Path) -> Nodes:
    """Read the nodes of a VTU file, what it has of them, and its tetrahedra without the middles of their edges.

    Raises
    ------
    InvalidInput
        As ``check_file``; "extra_missing"; "file_unreadable" or "file_too_large" for arrays that are damaged, or
        have more than ``LARGEST_DATA`` bytes unpacked.
    """
    with extra("formats", f"{path.name} needs meshio to be read"):
        import meshio
    check_file(path)
    try:
        with warnings.catch_warnings(), _bounded(meshio.vtu._vtu):
            warnings.simplefilter(
                "ignore"
            )  # of arrays that are cut short, whose values are counted below
            mesh = meshio.vtu.read(path)
            return _whole(mesh)
    except OSError as fault:
        raise file_fault(path, fault) from None
    except InvalidInput as fault:
        with about(path.name):
            raise InvalidInput(str(fault), code=fault.code) from None
    except Exception as fault:  # whatever meshio and its parser raise
        raise InvalidInput(
            f"{path.name} is not a VTU file (0 nodes): {fault!r}.", code="file_unreadable"
        ) from None


def _whole(mesh: Any) -> Nodes:
    """Take the nodes that corners of tetrahedra are, or all of them where there are none."""
    points, data = np.asarray(mesh.points, dtype=np.float64), {}
    for name, values in mesh.point_data.items():
        if np.ndim(values) == 1:
            data[name.lower()] = np.asarray(values, dtype=np.complex128)
    found = [
        np.asarray(block.data)[:, :4] for block in mesh.cells if block.type in ("tetra", "tetra10")
    ]
    cells = np.concatenate(found).astype(np.int64) if found else None
    short = [name for name, values in data.items() if len(values) != len(points)]
    if short:
        sentence = f"it has {len(points)} nodes and {len(data[short[0]])} values of {short[0]}; write it anew."
        raise InvalidInput(sentence, code="file_unreadable")
    largest = max(
        (float(np.abs(one).max(initial=0.0)) for one in (points, *data.values())), default=0.0
    )
    if largest > LARGEST_NUMBER:
        sentence = f"it has the number {largest:.3g}, but numbers go up to {LARGEST_NUMBER:g}; write it anew."
        raise InvalidInput(sentence, code="out_of_range")
    if cells is None:
        return points, data, None
    if not 0 <= cells.min(initial=0) <= cells.max(initial=0) < len(points):
        sentence = f"it has {len(points)} nodes, and cells of others; write it anew."
        raise InvalidInput(sentence, code="file_unreadable")
    used, corners = np.unique(cells, return_inverse=True)
    kept = {name: values[used] for name, values in data.items()}
    return points[used], kept, corners.reshape(-1, 4).astype(np.int64)


class _Unpacking:
    """Stands for ``zlib`` or ``lzma`` where a library unpacks with them: ``LARGEST_DATA`` bytes in all at most."""

    def __init__(self, decompressor: Callable[[], Any]) -> None:
        self._decompressor, self._left = decompressor, LARGEST_DATA

    def decompress(self, data: bytes) -> bytes:
        """Unpack some bytes."""
        unpacked = self._decompressor().decompress(data, self._left)
        self._left -= len(unpacked)
        if self._left < 1:
            sentence = f"its arrays have more than {LARGEST_DATA:,} bytes unpacked; make them fewer or shorter."
            raise InvalidInput(sentence, code="file_too_large")
        return unpacked


@contextmanager
def _bounded(reader: Any) -> Iterator[None]:
    """Bound what a module of meshio unpacks, which calls ``zlib`` and ``lzma`` by these names."""
    with _one_reads:
        before = reader.zlib, reader.lzma
        reader.zlib, reader.lzma = _Unpacking(zlib.decompressobj), _Unpacking(lzma.LZMADecompressor)
        try:
            yield
        finally:
            reader.zlib, reader.lzma = before
