"""Rows of a bench beside an earlier one: those that got slower are red, and fail it."""

from pathlib import Path

from benchmarks.compare import changes, main

HEAD = "what,setting,unknowns,median_s,least_s,most_s,error,peak_byte\n"
BEFORE = "a,10 ms,100,0.010,0.009,0.012,0.01,\nb,x,100,0.1,0.09,0.12,0.01,\nmemory,x,,,,,,\ngone,x,1,1,1,1,1,\n"


def written(folder: Path, name: str, rows: str) -> Path:
    (folder / name).write_text(HEAD + rows, encoding="utf-8")
    return folder / name


def test_a_row_that_got_slower_is_red_and_fails(tmp_path, capsys) -> None:
    before = written(tmp_path, "before.csv", BEFORE)
    now = written(
        tmp_path, "now.csv", "a,10 ms,100,0.0125,0.0115,0.014,0.01,\nb,x,100,0.11,0.1,0.13,0.01,\n"
    )
    assert [(one.what, one.red) for one in changes(before, now)] == [
        ("a, 10 ms", True),
        ("b, x", False),
    ]
    assert main(["--baseline", str(before), "--now", str(now)]) == 1
    assert "1 of 2 rows are slower" in capsys.readouterr().out


def test_spread_alone_is_not_red_nor_is_the_same_bench(tmp_path) -> None:
    before = written(tmp_path, "before.csv", BEFORE)
    noisy = written(tmp_path, "now.csv", "a,10 ms,100,0.0125,0.0098,0.02,0.01,\n")
    assert main(["--baseline", str(before), "--now", str(noisy)]) == 0
    assert main(["--baseline", str(before), "--now", str(before)]) == 0
    assert (
        main(
            [
                "--baseline",
                str(before),
                "--now",
                str(written(tmp_path, "other.csv", "other,x,1,1,1,1,1,\n")),
            ]
        )
        == 1
    )
