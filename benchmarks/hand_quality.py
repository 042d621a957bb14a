"""How good must a hand's mesh be: what errors of pose, shape, mesh and delay cost at the true hand.

Run ``PYTHONPATH=. python benchmarks/hand_quality.py [--seeds 3] [--scene pinch]``: writes
docs/hand-mesh-quality.csv and .png and prints the answers. About ten minutes on two idle cores; all
outcomes are kept in ``out/hand_quality``, so that an interrupted run continues. With ``--scene``
only that scene's are computed, and nothing is written to docs.
"""

import argparse
import csv
import time
from dataclasses import asdict, fields
from pathlib import Path

from benchmarks.hand_mesh_quality import Outcome, Study, cases, studies

ROOT = Path(__file__).parent.parent
KEPT = ROOT / "out/hand_quality"
COLUMNS = [field.name for field in fields(Outcome)]


def read(path: Path) -> list[Outcome]:
    if not path.exists():
        return []
    with path.open() as lines:
        return [
            Outcome(
                row["scene"],
                row["error"],
                float(row["size"]),
                int(row["seed"]),
                *map(float, list(row.values())[4:]),
            )
            for row in csv.DictReader(lines)
        ]


def write(path: Path, outcomes: list[Outcome]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as lines:
        table = csv.DictWriter(lines, COLUMNS, lineterminator="\n")
        table.writeheader()
        for outcome in outcomes:
            row = asdict(outcome)
            table.writerow(
                row | {name: f"{row[name]:.5g}" for name in COLUMNS if isinstance(row[name], float)}
            )


def outcomes_of(study: Study, seeds: int) -> list[Outcome]:
    kept = KEPT / f"{study.name.replace(' ', '-')}.csv"
    done = read(kept)
    seen = {(one.error, one.size, one.seed) for one in done}
    for case in cases(study, seeds):
        if (case.error, float(f"{case.size:.5g}"), case.seed) in seen:
            continue
        began = time.perf_counter()
        done.append(study.outcome(case))
        write(kept, done)
        seconds = time.perf_counter() - began
        print(
            f"{study.name}, {case.error}, {case.size:g}, {case.seed}: {done[-1].focus:.3f}, {seconds:.1f} s",
            flush=True,
        )
    return done


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--scene", choices=("pinch", "open hand"))
    asked = parser.parse_args()
    found = []
    for study in studies(ROOT / "src/airtact/setup/examples/hands", KEPT):
        if asked.scene in (None, study.name):
            found += outcomes_of(study, asked.seeds)
    if asked.scene is None:
        from benchmarks.hand_mesh_figure import answers, draw_quality

        write(ROOT / "docs/hand-mesh-quality.csv", found)
        draw_quality(found).savefig(ROOT / "docs/hand-mesh-quality.png", dpi=110)
        print("\n".join(answers(found)))


if __name__ == "__main__":
    main()
