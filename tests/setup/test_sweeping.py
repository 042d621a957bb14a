"""A function at many points: rows in order, faults as rows, results that are kept and found again."""

import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial

import numpy as np
import pytest

import airtact as at
from airtact.cli.sweep import write_csv
from airtact.setup.sweeping import SUFFIX, names_of, process_count
from setup.sweep_functions import logged, square

POINTS = [{"x": x} for x in (5, 0, 3, 1)]


@pytest.fixture
def threads():
    with ThreadPoolExecutor(2) as pool:
        yield pool


def test_rows_stand_in_the_order_of_the_points(threads) -> None:
    counts = []
    rows = at.sweep(square, POINTS, threads, progress=lambda *numbers: counts.append(numbers))
    assert rows == [{"x": x, "square": x * x, "error": "", "sentence": ""} for x in (5, 0, 3, 1)]
    assert counts == [(done, 4, 0) for done in range(5)]


def fails(point):
    match point["x"]:
        case 0:
            raise at.InvalidInput("x is 0; give more.", code="out_of_range")
        case 1:
            raise at.NotConverged("stopped after 9.", code="not_converged")
        case 3:
            return {"list": [1, 2]}
        case 4:
            return {"x": 1}
        case 6:
            raise MemoryError
        case 7:
            raise FileNotFoundError(2, "No such file", "a.csv")
    return {"wide": np.float64(2.5), "count": np.int64(3), "nothing": None}


def test_what_fails_is_a_row_with_its_sentence(threads, tmp_path) -> None:
    rows = at.sweep(fails, [{"x": x} for x in range(8)], threads, tmp_path)
    codes = [row["error"] for row in rows]
    wanted = [
        "out_of_range",
        "not_converged",
        "",
        "wrong_kind",
        "given_twice",
        "",
        "too_little_memory",
        "file_failed",
    ]
    assert codes == wanted
    assert rows[0]["sentence"] == "x is 0; give more."
    assert rows[2] == {
        "x": 2,
        "wide": 2.5,
        "count": 3,
        "nothing": None,
        "error": "",
        "sentence": "",
    }
    assert type(rows[2]["wide"]) is float
    assert len(list(tmp_path.glob(f"*{SUFFIX}"))) == 6  # faults of the moment are tried again


def test_what_is_kept_is_not_computed_again(threads, tmp_path) -> None:
    log, store = tmp_path / "log", tmp_path / "store"
    function = partial(logged, log=str(log))
    points = [*POINTS, {"x": 5}]
    once = at.sweep(function, points[:2], threads, store)
    counts = []
    rows = at.sweep(
        function, points, threads, store, progress=lambda *numbers: counts.append(numbers)
    )
    assert rows[:2] == once
    assert rows[2]["sentence"] == "ValueError: three"
    assert rows[4] == rows[0]
    assert counts == [(2, 4, 0), *counts[1:-1], (4, 4, 1)]
    begun = [
        line.split()[1]
        for line in log.read_text(encoding="utf-8").splitlines()
        if line.startswith("begins")
    ]
    assert sorted(begun) == ["0", "1", "3", "5"]


def test_a_damaged_file_is_computed_again(threads, tmp_path) -> None:
    at.sweep(square, POINTS, threads, tmp_path)
    for index, file in enumerate(sorted(tmp_path.glob(f"*{SUFFIX}"))):
        file.write_bytes([b"", b"{", b"[1]", b'{"name": "other", "row": {"square": -1}}'][index])
    assert at.sweep(square, POINTS, threads, tmp_path) == at.sweep(square, POINTS, threads)


@dataclass(frozen=True)
class Power:
    exponent: float
    note: str = field(default="", compare=False)

    def __call__(self, point):
        return {"power": point["x"] ** self.exponent}


def test_a_result_is_named_by_point_function_and_arguments() -> None:
    def one(function, point=POINTS[0]):
        (name,) = names_of(function, [point])
        return name

    assert one(Power(2.0)) == one(Power(2.0, note="another"))
    assert one(partial(logged, log="a")) == one(partial(logged, log="a"))
    named = [
        one(Power(2.0)),
        one(Power(3.0)),
        one(square),
        one(fails),
        one(square, {"x": 6}),
        one(square, {"y": 5}),
    ]
    named += [one(partial(logged, log=name)) for name in "ab"]
    assert len(set(named)) == len(named)


def ends_the_program(point):
    sys.exit(3)


def test_a_function_that_ends_the_program_is_a_row(threads) -> None:
    (row,) = at.sweep(ends_the_program, POINTS[:1], threads)
    assert (row["error"], row["sentence"]) == ("function_failed", "SystemExit: 3")


def test_what_cannot_be_named_or_passed_on_is_rejected(threads, tmp_path) -> None:
    factor = 3.0

    class Other:
        def __call__(self, point):
            return {}

    for function in (lambda point: {"y": factor}, lambda point: {}, Other(), np.sin):
        with pytest.raises(at.InvalidInput) as fault:
            at.sweep(function, POINTS, threads, tmp_path)
        assert fault.value.code in ("does_not_match", "wrong_kind")
    with pytest.raises(at.InvalidInput, match="define it in a module") as fault:
        at.sweep(lambda point: {}, POINTS)
    assert fault.value.code == "wrong_kind"


@pytest.mark.parametrize(
    ("points", "code"),
    [
        ([], "out_of_range"),
        ([1.0], "wrong_kind"),
        ([{"x": np.zeros(3)}], "wrong_kind"),
        ([{1: 2}], "wrong_kind"),
        (None, "wrong_kind"),
        ({"x": 1}, "wrong_kind"),
        ([{"x": 1}, {"error": 2}], "given_twice"),
    ],
)
def test_points_of_the_wrong_kind_are_rejected(points, code, threads, as_outside_the_tests) -> None:
    with pytest.raises(at.InvalidInput) as fault:
        at.sweep(square, points, threads)
    assert fault.value.code == code


def test_no_more_processes_than_points_and_memory_allow(monkeypatch) -> None:
    monkeypatch.setattr("airtact.setup.sweeping.available_memory", lambda: 10e9)
    monkeypatch.setattr("airtact.setup.sweeping.processor_count", lambda: 8)
    assert process_count(100) == 8
    assert process_count(3) == 3
    assert process_count(100, 5) == 5
    assert process_count(100, memory=2e9) == 4
    assert process_count(100, memory=9e9) == 1
    with pytest.raises(at.InvalidInput):
        process_count(100, memory=11e9)


def test_the_table_holds_all_columns(tmp_path) -> None:
    fine, failed = {"error": "", "sentence": ""}, {"error": "bad", "sentence": "It, is."}
    rows = [{"gap": 1 / 3, **failed}, {"gap": 1.0, "p": 2 / 3, "n": None, **fine}]
    write_csv(tmp_path / "a.csv", rows)
    text = (tmp_path / "a.csv").read_bytes().decode()
    assert (
        text
        == 'gap,p,n,error,sentence\r\n0.333333333333,,,bad,"It, is."\r\n1,0.666666666667,,,\r\n'
    )
