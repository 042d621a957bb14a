"""Tables in text files: columns by name, numbers in cells, and the line in every error. The only reader of them."""

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Complex128, Float64

from airtact.checks import counted
from airtact.errors import LARGEST_NUMBER, MOST_CELLS, MOST_COLUMNS, InvalidInput
from airtact.files.bounded import text_of
from airtact.printing import in_short

COMMENTS = ("%", "#")
"""Lines that begin so are comments."""

OTHER_SEPARATORS = {";": "semicolon", "\t": "tab", " ": "space"}
"""What some programs write between cells in place of commas."""


@dataclass(frozen=True, eq=False)
class TextTable:
    """Cells of a file, not yet read as numbers: columns' names in small letters, and the line of each row, from 1."""

    file: str
    names: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    lines: tuple[int, ...]

    __repr__ = in_short

    def require(self, *names: str) -> None:
        """Raise "data_missing" where the table lacks one of the columns."""
        missing = [name for name in names if name not in self.names]
        if missing:
            raise InvalidInput(
                f"{self.file} has no column {', '.join(missing)}: it needs {', '.join(names)}, and has "
                f"{counted(len(self.names), 'column', 'columns')}, {', '.join(self.names)}.",
                code="data_missing",
            )

    def numbers(self, name: str) -> Float64[np.ndarray, "rows"]:
        """Read a column as real numbers; raise "data_missing", or "file_unreadable" for NaN or infinity too."""
        found = self.complex_numbers(name)
        for row in np.flatnonzero(np.imag(found)):
            raise self._unreadable(int(row), name, "which is not a real number")
        return np.ascontiguousarray(np.real(found))

    def complex_numbers(self, name: str) -> Complex128[np.ndarray, "rows"]:
        """Read a column as complex numbers such as ``0.5-1.2i``; raise as ``numbers``."""
        self.require(name)
        column = self.names.index(name)
        found = np.empty(len(self.rows), dtype=np.complex128)
        for row, cells in enumerate(self.rows):
            try:
                found[row] = complex(_plain(cells[column]))
            except ValueError:
                raise self._unreadable(row, name, "which is not a number") from None
            if not np.isfinite(found[row]):
                raise self._unreadable(row, name, "which is not finite; leave such lines out")
            if not abs(found[row]) <= LARGEST_NUMBER:
                raise self._unreadable(row, name, f"beyond {LARGEST_NUMBER:g}")
        return found

    def _unreadable(self, row: int, name: str, why: str) -> InvalidInput:
        cell = self.rows[row][self.names.index(name)]
        return InvalidInput(
            f"line {self.lines[row]} of {self.file} has {cell!r} for {name}, {why}.",
            code="file_unreadable",
        )


def read_text_table(path: Path) -> TextTable:
    """Read a file of cells between commas.

    The first line that is no comment names the columns; where it holds numbers already, the last
    comment before it does, as COMSOL writes it.
    """
    text = text_of(path)
    head, commented, rows, lines, count = "", True, [], [], 0
    for line, words in enumerate(text.splitlines(), start=1):
        if not words.strip():
            continue
        if words.lstrip().startswith(COMMENTS):
            head = words.lstrip().lstrip("%# ") if commented and not rows else head
            continue
        _check_other_separators(path.name, line, words)
        cells = _cells(path.name, line, words)
        count += len(cells)
        if count > MOST_CELLS:
            sentence = (
                f"{path.name} has more than {MOST_CELLS:,} cells; leave columns or lines out."
            )
            raise InvalidInput(sentence, code="file_too_large")
        if commented and not rows and not any(_is_number(cell) for cell in cells):
            head, commented = words, False
            continue
        rows.append(cells)
        lines.append(line)
    names = _named(path.name, head, len(rows))
    for line, cells in zip(lines, rows, strict=True):
        if len(cells) != len(names):
            raise InvalidInput(
                f"line {line} of {path.name} has {counted(len(cells), 'cell', 'cells')}, but there are "
                f"{counted(len(names), 'column', 'columns')}, {', '.join(names)}.",
                code="wrong_shape",
            )
    return TextTable(path.name, names, tuple(rows), tuple(lines))


def _check_other_separators(file: str, line: int, words: str) -> None:
    for separator, name in OTHER_SEPARATORS.items():
        count = len(words.strip().split(separator)) - 1
        if count and "," not in words:
            raise InvalidInput(
                f"line {line} of {file} has no comma but {counted(count, name, f'{name}s')}; put commas between cells.",
                code="unknown_format",
            )


def _named(file: str, head: str, rows: int) -> tuple[str, ...]:
    if not head:
        raise InvalidInput(
            f"{file} has {counted(rows, 'row', 'rows')} of numbers, but no line that names its columns.",
            code="file_unreadable",
        )
    names = tuple(name.lower() for name in _cells(file, 1, head))
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise InvalidInput(
            f"{file} has {names.count(twice[0])} columns of the name {twice[0]!r}; give each its own.",
            code="given_twice",
        )
    return names


def _cells(file: str, line: int, words: str) -> tuple[str, ...]:
    try:
        cells = tuple(cell.strip() for cell in next(csv.reader([words], skipinitialspace=True)))
    except csv.Error as error:
        sentence = f"line {line} of {file}, of {len(words):,} characters, has a cell that cannot be read: {error}."
        raise InvalidInput(sentence, code="file_unreadable") from None
    if len(cells) > MOST_COLUMNS:
        sentence = f"line {line} of {file} has {len(cells):,} cells, more than {MOST_COLUMNS:,}; leave columns out."
        raise InvalidInput(sentence, code="wrong_shape")
    return cells


def _is_number(cell: str) -> bool:
    try:
        complex(_plain(cell))
    except ValueError:
        return False
    return True


def _plain(cell: str) -> str:
    """COMSOL and MATLAB write i where Python writes j."""
    return cell.lower().replace(" ", "").replace("i", "j").replace("jnf", "inf")
