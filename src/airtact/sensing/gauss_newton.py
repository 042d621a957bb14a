"""Damped Gauss-Newton steps (Levenberg and Marquardt), for poses and for calibrations."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from jaxtyping import Float64

Step = Float64[np.ndarray, "unknowns"]
Squares = Float64[np.ndarray, "unknowns unknowns"]


@dataclass(frozen=True, eq=False, kw_only=True)
class Iterate:
    """A point of a fit.

    Attributes
    ----------
    cost : sum of the squares of the residual [Pa²].
    steps : number of steps that led here.
    settled : whether further steps change nothing.
    """

    cost: float
    steps: int = 0
    settled: bool = False


Point = TypeVar("Point", bound=Iterate)


def descend(
    start: Point,
    equations: Callable[[Point], tuple[Squares, Step, Step]],
    move: Callable[[Point, Step], Point],
    *,
    steps: int,
    settled: float,
    flat: float,
) -> Point:
    """Take damped steps until they settle.

    Parameters
    ----------
    start : where to begin.
    equations : returns the normal equations at a point, half the slope of the cost, and the
        diagonal by which the equations are damped.
    move : returns the point that a step leads to.
    steps : largest number of steps.
    settled : length of a step below which the fit has settled.
    flat : relative decrease of the cost below which the fit has settled.
    """
    here = start
    damping = 1e-3
    for count in range(start.steps + 1, start.steps + steps + 1):
        squares, slope, diagonal = equations(here)
        while True:
            step = -np.linalg.solve(squares + damping * np.diag(diagonal), slope)
            short = bool(np.linalg.norm(step) < settled)
            tried = move(here, step)
            if tried.cost < here.cost:
                break
            if short or damping > 1e6:
                return replace(here, steps=count, settled=short)
            damping *= 6.0
        short = short or tried.cost > (1.0 - flat) * here.cost
        here = replace(tried, steps=count, settled=short)
        # A step that worked is followed by one that is nearer to plain Gauss-Newton.
        damping *= 0.2
        if short:
            break
    return here
