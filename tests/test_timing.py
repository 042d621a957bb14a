"""The clock of solvers and workflows."""

import pytest

from airtact.timing import Clock


def test_a_clock_reports_steps_and_adds_up_their_times():
    lines: list[str] = []
    clock = Clock(lines.append)
    for _ in range(2):
        with clock.step("matrix", "filling the matrix"):
            pass
    once = clock.seconds["matrix"]
    with pytest.raises(ZeroDivisionError), clock.step("matrix"):
        _ = 1 / 0
    assert lines == ["filling the matrix"] * 2 + ["matrix"]
    assert list(clock.seconds) == ["matrix"]
    assert clock.seconds["matrix"] > once > 0
