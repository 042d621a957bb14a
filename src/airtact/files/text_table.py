"""Tables with named columns in text files; error messages state the line."""

import csv
import re
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Complex128, Float64, Int64

from airtact.errors import LARGEST_NUMBER, InvalidInput, counted, in_short
from airtact.files.bounded import text_of


@dataclass(frozen=True, eq=False)
class TextTable:
    """A table read from a file, with its cells as text.

    Column names are in lower case. ``lines`` contains the line number of each row, from 1.
    ``comments`` contains the lines that begin with % or #, without that character.
    """

    file: str
    names: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    lines: tuple[int, ...]
    comments: tuple[str, ...] = ()

    __repr__ = in_short

    def require(self, *names: str) -> None:
        """Raise an error if one of the columns is missing."""
        missing = [name for name in names if name not in self.names]
        if missing:
            raise InvalidInput(
                f"{self.file} has no column {', '.join(missing)}: the columns must be "
                f"{', '.join(names)}, but are {', '.join(self.names)}.",
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
        """Read a column as real numbers.

        NaN and infinity are rejected.
        """
        return np.array(self._parsed(name, _real, "a real number"), dtype=np.float64)

    def complex_numbers(self, name: str) -> Complex128[np.ndarray, "rows"]:
        """Read a column as finite complex numbers such as ``0.5-1.2i``."""
        return np.array(self._parsed(name, _complex, "a number"), dtype=np.complex128)

    def order(self, name: str) -> Int64[np.ndarray, "rows"]:
        """Return the order of the rows according to a column that numbers them from 0.

        The method raises ``InvalidInput`` unless the column contains every number from 0 to N − 1
        once, where N is the number of rows.
        """
        numbers = self.numbers(name)
        order = np.argsort(numbers, kind="stable")
        wrong = np.flatnonzero(numbers[order] != np.arange(len(order)))
        if len(wrong):
            row = order[wrong[0]]
            raise InvalidInput(
                f"{name} is {numbers[row]:g} in line {self.lines[row]} of {self.file}, but this "
                f"column must contain each number from 0 to {len(order) - 1} once.",
                code="out_of_range",
            )
        return order

    def _parsed(self, name: str, parse: Callable[[str], Any], kind: str) -> list[Any]:
        self.require(name)
        column = self.names.index(name)
        values = [parse(cells[column]) for cells in self.rows]
        for row, value in enumerate(values):
            if value is None or not max(abs(value.real), abs(value.imag)) <= LARGEST_NUMBER:
                raise InvalidInput(
                    f"{name} is {self.rows[row][column]!r} in line {self.lines[row]} of "
                    f"{self.file}; use {kind} of at most {LARGEST_NUMBER:g}.",
                    code="file_unreadable",
                )
        return values


def read_text_table(path: Path) -> TextTable:
    """Read a file of cells separated by commas, or by spaces as in .txt files from COMSOL.

    The first line that is not a comment contains the names of the columns. If this line contains
    numbers, the last comment before it contains the names, as in files from COMSOL.
    """
    file = path.name
    comments: list[str] = []
    header = ""
    spaced = False
    rows: dict[int, tuple[str, ...]] = {}  # by line
    for line, text in enumerate(map(str.strip, text_of(path).splitlines()), start=1):
        if text.startswith(("%", "#")):
            comments.append(text.lstrip("%# "))
            if not rows:
                header = comments[-1]
        elif text:
            if not rows:
                spaced = "," not in text
            rows[line] = _cells(file, line, text)
    first = next(iter(rows), 0)
    if rows and all(_complex(cell) is None for cell in rows[first]):
        names = [name.lower() for name in rows.pop(first)]
    elif spaced and "@" in header:
        # Single spaces are part of a name such as "p (Pa) @ freq=40000", which begins a column.
        names = re.split(r"\t+|\s{2,}|\s+(?=\S+ \(\S*\) @ )", header.lower())
    elif header:
        # Names may contain commas if the cells of the rows are separated by spaces.
        names = header.lower().split() if spaced else list(_cells(file, 1, header.lower()))
        # COMSOL writes the commas of "p (Pa) @ freq=40000, gap=10" without quotation marks.
        for index in range(len(names) - 1, 0, -1):
            extra = rows and len(names) > len(rows[first])
            if extra and "@" not in names[index] and "=" in names[index]:
                names[index - 1 : index + 1] = [f"{names[index - 1]}, {names[index]}"]
    else:
        raise InvalidInput(
            f"{file} has no line with the names of its columns; add it.", code="file_unreadable"
        )
    name, count = Counter(names).most_common(1)[0]
    if count > 1:
        raise InvalidInput(
            f"{file} has several columns named {name!r}; rename them.", code="given_twice"
        )
    for line, cells in rows.items():
        if len(cells) != len(names):
            raise InvalidInput(
                f"line {line} of {file} has {counted(len(cells), 'cell', 'cells')}, but there are "
                f"{counted(len(names), 'column', 'columns')} ({', '.join(names)}).",
                code="wrong_shape",
            )
    return TextTable(file, tuple(names), tuple(rows.values()), tuple(rows), tuple(comments))


def _cells(file: str, line: int, text: str) -> tuple[str, ...]:
    if "," not in text:
        return tuple(text.split())
    try:
        return tuple(cell.strip() for cell in next(csv.reader([text], skipinitialspace=True)))
    except csv.Error as error:
        raise InvalidInput(
            f"line {line} of {file} has {len(text):,} characters and contains a cell that cannot "
            f"be read: {error}.",
            code="file_unreadable",
        ) from None


# Python's float also accepts "1_000" and digits of other scripts, which are mistakes in a table.
NUMBER = r"(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:e[+-]?[0-9]+)?"
REAL = re.compile(rf"[+-]?{NUMBER}", re.IGNORECASE)
COMPLEX = re.compile(rf"[+-]?{NUMBER}(?: *[+-] *{NUMBER}[ij]|[ij])?", re.IGNORECASE)


def _real(cell: str) -> float | None:
    return float(cell) if REAL.fullmatch(cell) else None


def _complex(cell: str) -> complex | None:
    """Read a complex number with the imaginary unit i, as in files from COMSOL and MATLAB."""
    if not COMPLEX.fullmatch(cell):
        return None
    return complex(cell.lower().replace(" ", "").replace("i", "j"))
