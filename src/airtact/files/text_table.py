"""Tables in text files with named columns; errors state the line."""

import csv
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Complex128, Float64

from airtact.errors import LARGEST_NUMBER, InvalidInput, counted, in_short
from airtact.files.bounded import text_of

MAX_COLUMNS = 1024

MAX_CELLS = 4_000_000


@dataclass(frozen=True, eq=False)
class TextTable:
    """Cells of a file as text.

    Column names are in lower case. ``lines`` are the line numbers of the rows, from 1, and
    ``comments`` the lines that begin with % or #, without that sign.
    """

    file: str
    names: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    lines: tuple[int, ...]
    comments: tuple[str, ...] = ()

    __repr__ = in_short

    def require(self, *names: str) -> None:
        """Raise "data_missing" if the table lacks one of the columns."""
        missing = [name for name in names if name not in self.names]
        if missing:
            raise InvalidInput(
                f"{self.file} has no column {', '.join(missing)}: it needs {', '.join(names)}, but "
                f"has {', '.join(self.names)}.",
                code="data_missing",
            )

    def without_nan(self) -> "TextTable":
        """Return the table without the rows in which a cell is NaN."""
        finite = [
            index
            for index, cells in enumerate(self.rows)
            if not any(cell.lower().startswith("nan") for cell in cells)
        ]
        rows = tuple(self.rows[index] for index in finite)
        return replace(self, rows=rows, lines=tuple(self.lines[index] for index in finite))

    def numbers(self, name: str) -> Float64[np.ndarray, "rows"]:
        """Read a column as real numbers; raise "data_missing" or "file_unreadable".

        NaN and infinity are unreadable.
        """
        values = self.complex_numbers(name)
        not_real = np.flatnonzero(np.imag(values))
        if len(not_real):
            raise self._unreadable(int(not_real[0]), name, "which is not a real number")
        return np.ascontiguousarray(np.real(values))

    def complex_numbers(self, name: str) -> Complex128[np.ndarray, "rows"]:
        """Read a column as complex numbers such as ``0.5-1.2i``; raise as ``numbers``."""
        self.require(name)
        column = self.names.index(name)
        values = np.empty(len(self.rows), dtype=np.complex128)
        for row, cells in enumerate(self.rows):
            try:
                values[row] = _number(cells[column])
            except ValueError:
                raise self._unreadable(row, name, "which is not a number") from None
            if not np.isfinite(values[row]):
                raise self._unreadable(row, name, "which is not finite; remove such lines")
            if not abs(values[row]) <= LARGEST_NUMBER:
                raise self._unreadable(row, name, f"beyond {LARGEST_NUMBER:g}")
        return values

    def _unreadable(self, row: int, name: str, why: str) -> InvalidInput:
        cell = self.rows[row][self.names.index(name)]
        return InvalidInput(
            f"line {self.lines[row]} of {self.file} has {cell!r} for {name}, {why}.",
            code="file_unreadable",
        )


def read_text_table(path: Path) -> TextTable:
    """Read a file of cells separated by commas, or by spaces as in .txt files of COMSOL.

    The first line that is not a comment names the columns. If it contains numbers, the last comment
    before it names them, as in files of COMSOL.
    """
    file = path.name
    header = ""
    header_in_comment = True
    comments = []
    spaced = False
    rows = []
    lines = []
    count = 0
    for line, text in enumerate(text_of(path).splitlines(), start=1):
        if not text.strip():
            continue
        if text.lstrip().startswith(("%", "#")):
            comments.append(text.lstrip().lstrip("%# "))
            if header_in_comment and not rows:
                header = comments[-1]
            continue
        _check_separators(file, line, text)
        cells = _cells(file, line, text)
        count += len(cells)
        if count > MAX_CELLS:
            raise InvalidInput(
                f"{file} has more than {MAX_CELLS:,} cells; remove columns or lines.",
                code="file_too_large",
            )
        if header_in_comment and not rows and not any(_is_number(cell) for cell in cells):
            header = text
            header_in_comment = False
        else:
            # Names may have commas where the cells of the rows are between spaces.
            spaced = header_in_comment and "," not in text
            rows.append(cells)
            lines.append(line)
    if not header:
        raise InvalidInput(
            f"{file} has {counted(len(rows), 'row', 'rows')} of numbers, but no line with the "
            "names of its columns; add one.",
            code="file_unreadable",
        )
    names = [name.lower() for name in _cells(file, 1, header, spaced)]
    # COMSOL writes the commas of "p (Pa) @ freq=40000, gap=10" without quotation marks.
    for index in range(len(names) - 1, 0, -1):
        if rows and len(names) > len(rows[0]) and "@" not in names[index] and "=" in names[index]:
            names[index - 1 : index + 1] = [f"{names[index - 1]}, {names[index]}"]
    for name in names:
        if names.count(name) > 1:
            raise InvalidInput(
                f"{file} has several columns named {name!r}; rename them.",
                code="given_twice",
            )
    for line, cells in zip(lines, rows, strict=True):
        if len(cells) != len(names):
            raise InvalidInput(
                f"line {line} of {file} has {counted(len(cells), 'cell', 'cells')}, but there are "
                f"{counted(len(names), 'column', 'columns')}, {', '.join(names)}.",
                code="wrong_shape",
            )
    return TextTable(file, tuple(names), tuple(rows), tuple(lines), tuple(comments))


def _check_separators(file: str, line: int, text: str) -> None:
    """Raise if semicolons separate the cells."""
    if ";" in text and "," not in text:
        raise InvalidInput(
            f"line {line} of {file} has semicolons instead of commas; separate cells by commas.",
            code="unknown_format",
        )


def _cells(file: str, line: int, text: str, spaced: bool = False) -> tuple[str, ...]:
    if spaced and "@" in text:
        # Single spaces are part of a name such as "p (Pa) @ freq=40000", which begins a column.
        return tuple(re.split(r"\t+|\s{2,}|\s+(?=\S+ \(\S*\) @ )", text.strip()))
    if spaced or "," not in text:
        return tuple(text.split())
    try:
        cells = tuple(cell.strip() for cell in next(csv.reader([text], skipinitialspace=True)))
    except csv.Error as error:
        raise InvalidInput(
            f"line {line} of {file}, of {len(text):,} characters, has a cell that cannot be read: "
            f"{error}.",
            code="file_unreadable",
        ) from None
    if len(cells) > MAX_COLUMNS:
        raise InvalidInput(
            f"line {line} of {file} has {len(cells):,} cells, more than {MAX_COLUMNS:,}; remove "
            "columns.",
            code="wrong_shape",
        )
    return cells


def _is_number(cell: str) -> bool:
    try:
        _number(cell)
    except ValueError:
        return False
    return True


def _number(cell: str) -> complex:
    """Read a complex number with the imaginary unit i, as in files of COMSOL and MATLAB."""
    return complex(cell.lower().replace(" ", "").replace("i", "j").replace("jnf", "inf"))
