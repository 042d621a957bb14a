"""The estimated error against the true one in random scenes; a benchmark does it in 200."""

import numpy as np
import pytest

import airtact as at
from references import relative
from references.random_scenes import case_of


@pytest.mark.slow
def test_the_estimate_holds_in_twenty_random_scenes() -> None:
    ratios = []
    for seed in range(20):
        case = case_of(seed)
        field = at.BoundaryElement(accuracy=case.accuracy).radiate(
            case.scene, at.Monopoles(case.source, np.ones(1))
        )
        report = field.report_at(case.points)
        estimate = field.error_at(case.points)[0]
        exact, own_error = case.truth()
        error = relative(field.at(case.points)[:, 0], exact)
        if own_error >= 0.3 * max(error, 0.3 * case.accuracy):
            continue  # the truth is too uncertain
        assert error <= 2 * case.accuracy or report.warnings, seed
        # errors far below the accuracy may be overestimated
        ratios.append(
            estimate / error >= 0.3 and (estimate / error <= 10 or estimate < case.accuracy)
        )
    assert len(ratios) >= 15
    assert np.mean(ratios) >= 0.9
