"""Times of several runs with their spread; errors of transfer matrices and drives."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from jaxtyping import Complex128

Result = TypeVar("Result")


@dataclass(frozen=True)
class Timed:
    """Wall times of the runs of one job, in order [s], and the processor time of all its threads where it was taken."""

    seconds: tuple[float, ...]
    processor: tuple[float, ...] = ()

    @property
    def median(self) -> float:
        """The middle one [s]."""
        return float(np.median(self.seconds))

    def __str__(self) -> str:
        unit, scale = ("s", 1.0) if self.median >= 1.0 else ("ms", 1e3)
        values = (min(self.seconds), self.median, max(self.seconds))
        low, middle, high = (_three_digits(scale * value) for value in values)
        taken = (
            f"; processor {_three_digits(scale * float(np.median(self.processor)))}"
            if self.processor
            else ""
        )
        return f"{middle} {unit} ({low} to {high}{taken})"


REST = 0.1
"""Seconds after which the idle threads of a matrix product no longer spin and disturb ours."""


AWAKE = 0.05
"""Seconds of work after which a processor that rested is as quick as before."""


def timed(jobs: Sequence[Callable[[], Result]]) -> tuple[Timed, list[Result]]:
    """Run the first job until the processor is warm, then time the others; return their times and what each gave."""
    jobs[0]()
    time.sleep(REST)
    woken = time.perf_counter()
    while time.perf_counter() - woken < AWAKE:
        jobs[0]()
    seconds, processor, results = [], [], []
    for job in jobs[1:]:
        began = time.perf_counter(), time.process_time()
        results.append(job())
        seconds.append(time.perf_counter() - began[0])
        processor.append(time.process_time() - began[1])
    return Timed(tuple(seconds), tuple(processor)), results


def relative_error(
    found: Complex128[np.ndarray, "foci elements"], true: Complex128[np.ndarray, "foci elements"]
) -> float:
    """Error of the worst row, relative to its norm."""
    return float(np.max(np.linalg.norm(found - true, axis=1) / np.linalg.norm(true, axis=1)))


def correlation(
    found: Complex128[np.ndarray, "elements"], true: Complex128[np.ndarray, "elements"]
) -> float:
    """How alike two drives are but for one factor: 1 is the same."""
    return float(np.abs(np.vdot(found, true)) / (np.linalg.norm(found) * np.linalg.norm(true)))


def _three_digits(value: float) -> str:
    """Write three digits that count, in plain figures.

    >>> _three_digits(1234.5), _three_digits(23.456), _three_digits(0.45678)
    ('1234', '23.5', '0.457')
    """
    return f"{value:.{max(0, 2 - int(np.floor(np.log10(max(value, 1e-9)))))}f}"
