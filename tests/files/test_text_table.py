"""Tables of text are read by the names of their columns; a fault names its line."""

import numpy as np
import pytest

from airtact.files.text_table import read_text_table
from faults import raises_code


def table_of(folder, text: str):
    (folder / "a.csv").write_text(text, encoding="utf-8")
    return read_text_table(folder / "a.csv")


def test_columns_are_found_by_name_whatever_their_order_and_case(tmp_path) -> None:
    table = table_of(tmp_path, '\ufeffNote, Y ,x\n\n# a remark\n"a, quoted", 2e-3, 1\nb,4,-3\n')
    assert table.names == ("note", "y", "x")
    assert table.lines == (4, 5)
    np.testing.assert_array_equal(table.numbers("x"), [1.0, -3.0])
    np.testing.assert_array_equal(table.numbers("y"), [2e-3, 4.0])


def test_names_may_stand_in_the_last_comment_and_numbers_be_complex(tmp_path) -> None:
    table = table_of(
        tmp_path, "% Model: x.mph\n% x, p (Pa)\n1, 0.5 - 1.25i\n2,3e-2i\n3,4\n% the end\n"
    )
    np.testing.assert_array_equal(table.complex_numbers("p (pa)"), [0.5 - 1.25j, 0.03j, 4.0])


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("", "file_unreadable"),
        ("1,2\n", "file_unreadable"),
        ("x;y\n1;2\n", "data_missing"),
        ("x,y,X\n1,2,3\n", "given_twice"),
        ("y\n1\n", "data_missing"),
        ("x,y\n1,2\n\n1\n", "wrong_shape"),
        ("x\n1\nabc\n", "file_unreadable"),
        ("x,y\n1,2\n,2\n", "file_unreadable"),
        ("x\n1\n-inf\n", "file_unreadable"),
        ("x\n1+2i\n", "file_unreadable"),
        ("x\n0i\n", "file_unreadable"),
        ("x,y\n0. 8,1\n", "file_unreadable"),
        ("x\n0_8\n", "file_unreadable"),
        ("x\n0.８\n", "file_unreadable"),
        ("x\n٠.٨\n", "file_unreadable"),
        ("x\n1\f2\n", "file_unreadable"),
        ("x\n1\x852\n", "file_unreadable"),
    ],
)
def test_what_is_not_a_table_is_rejected(tmp_path, text: str, code: str) -> None:
    with raises_code(code):
        table_of(tmp_path, text).numbers("x")


@pytest.mark.parametrize("text", ["x\ty\tz\n1\t2\t3\n", "% x y z\n1 2 3\n", "x y z\n1  2 3\n"])
def test_spaces_and_tabs_stand_between_cells_too(tmp_path, text) -> None:
    table = table_of(tmp_path, text)
    assert [table.numbers(name).tolist() for name in "xyz"] == [[1.0], [2.0], [3.0]]
