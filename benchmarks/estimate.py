"""The estimated error against the true one, in random scenes of shapes that nothing was tuned on.

Spheroids, tori, cups, shells, and capsules in threes and fours, 25 to 70 kHz, 1 and 3 % asked. The
source is far and the points are near the bodies or far from them, or the source is near and the
points far. Truth are rings of monopoles (``references.axisymmetric``) and, for capsules,
fundamental solutions.

    python -m benchmarks.estimate [scenes [first]]
"""

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

import airtact as at
from references.random_scenes import Case, case_of

HELD, SHARE = (0.3, 10.0), 0.95
"""Estimated over true error, and the share of the scenes that must keep it."""

LOUD = 2.0
"""True error over the accuracy asked above which there must be a warning."""


@dataclass(frozen=True)
class Row:
    """What a solve said about its error and what it was."""

    case: Case
    true: float
    estimated: float
    own: float
    warned: bool
    seconds: float

    @property
    def ratio(self) -> float:
        """Estimated over true error."""
        return self.estimated / self.true

    @property
    def sure(self) -> bool:
        """Whether the truth is true enough to say."""
        return self.own < 0.3 * max(self.true, 0.3 * self.case.accuracy)

    @property
    def held(self) -> bool:
        """Whether the ratio is as wanted; errors far under the accuracy asked may be overestimated."""
        least, most = HELD
        return least <= self.ratio <= most or (
            self.ratio > most and self.estimated < self.case.accuracy
        )

    @property
    def quiet(self) -> bool:
        """Whether the error is over twice what was asked and nothing was said."""
        return self.true > LOUD * self.case.accuracy and not self.warned

    def __str__(self) -> str:
        """Write the row in one line."""
        case = self.case
        marks = "".join(
            mark
            for mark, on in (
                ("  NOT HELD", not self.held),
                ("  QUIET", self.quiet),
                ("  unsure", not self.sure),
            )
            if on
        )
        found = f"{100 * self.true:7.3f} % off, {100 * self.estimated:7.3f} % estimated, ratio {self.ratio:6.2f}"
        return (
            f"{case.seed:4} {case.family:9} {case.kind:6} {case.scene.frequency / 1e3:5.1f} kHz, "
            f"{100 * case.accuracy:g} % asked: {found}, truth {100 * self.own:.1g} % off, {self.seconds:.1f} s{marks}"
        )


def row_of(case: Case) -> Row:
    """Solve a case and hold its estimate against the truth."""
    begun = time.perf_counter()
    field = at.BoundaryElement(accuracy=case.accuracy).radiate(
        case.scene, at.Monopoles(case.source, np.ones(1))
    )
    report = field.report_at(case.points)
    estimated = float(field.error_at(case.points)[0])
    seconds = time.perf_counter() - begun
    true, own = case.truth()
    error = float(np.linalg.norm(field.at(case.points)[:, 0] - true) / np.linalg.norm(true))
    return Row(case, error, estimated, own, bool(report.warnings), seconds)


def rows(count: int, first: int = 0) -> Iterator[Row]:
    """Hold scenes one by one."""
    for seed in range(first, first + count):
        yield row_of(case_of(seed))


def summary(held: list[Row]) -> str:
    """Say in a line how many estimates held."""
    sure = [row for row in held if row.sure]
    ratios = np.array([row.ratio for row in sure])
    least, most = np.quantile(ratios, [0.025, 0.975])
    return (
        f"{len(sure)} of {len(held)} scenes with a sure truth: estimated over true error {least:.2f} to {most:.2f} in "
        f"95 %, {np.median(ratios):.2f} in the median; {sum(row.held for row in sure) / len(sure):.1%} held "
        f"({SHARE:.0%} asked), {sum(row.quiet for row in sure)} quiet over twice the accuracy asked, "
        f"{sum(row.true > row.case.accuracy for row in sure)} over what was asked"
    )


if __name__ == "__main__":
    found = []
    for row in rows(*(int(argument) for argument in sys.argv[1:] or ["200"])):
        print(row, flush=True)
        found.append(row)
    print(summary(found))
