"""The table of a sweep: a row for each point, as CSV or as Parquet."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from airtact.acoustics.field_file import save
from airtact.errors import extra
from airtact.setup.sweeping.rows import ERROR, SENTENCE, Row, Value


def columns_of(rows: Sequence[Row]) -> list[str]:
    """List the columns of all rows as they come first, those of faults last."""
    names = dict.fromkeys(name for row in rows for name in row)
    return [name for name in names if name not in (ERROR, SENTENCE)] + [ERROR, SENTENCE]


def write_csv(file: Path, rows: Sequence[Row], varied: Sequence[str]) -> None:
    """Write rows as CSV: varied values with 12 digits, results with 6; what a row lacks is empty."""
    columns, stream = columns_of(rows), io.StringIO(newline="")
    writer = csv.writer(stream)
    writer.writerow(columns)
    for row in rows:
        writer.writerow([_words(row.get(name), 12 if name in varied else 6) for name in columns])
    save(file, stream.getvalue().encode())


def write_parquet(file: Path, rows: Sequence[Row]) -> None:
    """Write rows as Parquet; raises "extra_missing" without PyArrow."""
    pyarrow, stream = _pyarrow(), io.BytesIO()
    pyarrow.parquet.write_table(
        pyarrow.table({name: [row.get(name) for row in rows] for name in columns_of(rows)}), stream
    )
    save(file, stream.getvalue())


def check_parquet() -> None:
    """Raise "extra_missing" without PyArrow."""
    _pyarrow()


def _pyarrow() -> Any:
    with extra("parquet", "a table as Parquet needs PyArrow"):
        import pyarrow.parquet
    return pyarrow


def _words(value: Value, digits: int) -> str:
    if value is None:
        return ""
    return f"{value:.{digits}g}" if isinstance(value, float) else str(value)
