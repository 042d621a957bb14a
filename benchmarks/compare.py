"""Rows of ``airtact bench`` beside those of the last tag: one that got 20 % slower is red, and the exit code is 1.

Run ``make bench-compare``, or ``PYTHONPATH=. python benchmarks/compare.py --baseline
out/before/bench.csv`` with what ``airtact bench --quick --out out/before`` wrote earlier, on the
same machine in the same state. Without a baseline the last tag is checked out below ``out/``,
installed there and measured first, once.
"""

import argparse
import csv
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

SLOWER = 1.2
"""Time over the baseline's from which a row is red."""

OUT = Path("out/bench-compare")


@dataclass(frozen=True)
class Change:
    """A row of both benches: median and least time now and before [s]."""

    what: str
    before: tuple[float, float]
    now: tuple[float, float]

    @property
    def ratio(self) -> float:
        return self.now[0] / self.before[0]

    @property
    def red(self) -> bool:
        """Whether it got slower by more than its spread: even its quickest run is beyond the median before."""
        return self.ratio > SLOWER and self.now[1] > self.before[0]


def times_in(file: Path) -> dict[str, tuple[float, float]]:
    """Return median and least time of each row of a bench.csv that has them."""
    with file.open(newline="", encoding="utf-8") as stream:
        rows = [row for row in csv.DictReader(stream) if row["median_s"]]
    return {
        f"{row['what']}, {row['setting']}": (float(row["median_s"]), float(row["least_s"]))
        for row in rows
    }


def changes(before: Path, now: Path) -> list[Change]:
    """Pair the rows of two benches; those of one alone are left out."""
    old, new = times_in(before), times_in(now)
    return [Change(what, old[what], new[what]) for what in new if what in old]


def of_last_tag() -> Path:
    """Measure the last tag, unless that was done before."""
    found = subprocess.run(
        ["git", "describe", "--tags", "--abbrev=0"], capture_output=True, text=True
    )
    if found.returncode:
        sys.exit(
            "there is no tag to compare with: give --baseline bench.csv, which airtact bench --quick writes."
        )
    tag = found.stdout.strip()
    folder = (OUT / tag).resolve()
    file = folder / "bench" / "bench.csv"
    if not file.exists():
        source, python = folder / "source", folder / "venv/bin/python"
        folder.mkdir(parents=True, exist_ok=True)
        subprocess.run(
            ["git", "worktree", "add", "--force", "--detach", str(source), tag], check=True
        )
        subprocess.run([sys.executable, "-m", "venv", str(folder / "venv")], check=True)
        subprocess.run(
            [str(python), "-m", "pip", "install", "--quiet", f"{source}[mesh]"], check=True
        )
        bench(python, file.parent)
    return file


def bench(python: Path | str, folder: Path) -> Path:
    subprocess.run(
        [str(python), "-m", "airtact", "bench", "--quick", "--quiet", "--out", str(folder)],
        check=True,
    )
    return folder / "bench.csv"


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--baseline", type=Path, help="bench.csv to compare with; the last tag's by default"
    )
    parser.add_argument("--now", type=Path, help="bench.csv of now; measured by default")
    given = parser.parse_args(arguments)
    before = given.baseline or of_last_tag()
    found = changes(before, given.now or bench(sys.executable, OUT / "now"))
    table = Table("row", "before", "now", "least", "ratio")
    for one in found:
        times = [f"{1e3 * seconds:.3g} ms" for seconds in (one.before[0], *one.now)]
        table.add_row(one.what, *times, f"{one.ratio:.2f}", style="red" if one.red else None)
    console = Console()
    console.print(table)
    gone = sorted(times_in(before).keys() - {one.what for one in found})
    console.print(f"Not measured now: {'; '.join(gone) or 'nothing'}.")
    red = sum(one.red for one in found)
    console.print(f"{red} of {len(found)} rows are slower than {SLOWER:g} times {before}.")
    return 1 if red or not found else 0


if __name__ == "__main__":
    sys.exit(main())
