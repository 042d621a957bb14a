"""Pages come from templates: text is escaped, nothing is fetched, and a missing value is an error."""

import re
from base64 import b64decode

import pytest
from jinja2 import UndefinedError

from airtact.reports.page import write_page
from airtact.reports.sweep_page import Swept, write_sweep_page

TEXT = '<i>&"'
ROWS = [
    {"gap": gap, "weakest_Pa": 100.0 * gap, "gain": 1.5, "error": "", "sentence": ""}
    for gap in (1.0, 2.0, 3.0)
]
FAILED = {"gap": 4.0, "error": TEXT, "sentence": TEXT}


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> str:
    path = tmp_path_factory.mktemp("sweep") / "sweep.html"
    write_sweep_page(path, Swept(TEXT, TEXT, ("gap",), [*ROWS, FAILED]))
    return path.read_text(encoding="utf-8")


def test_text_is_escaped(page) -> None:
    assert "<i>" not in page
    # The titles of page and heading, the code with its sentence, the cell, and the scene file.
    assert page.count("&lt;i&gt;&amp;&#34;") == 6


def test_a_page_needs_no_other_file(page) -> None:
    sources = re.findall(r'(?:src|href)="([^"]*)"', page)
    assert len(sources) == 2
    for source in sources:
        assert b64decode(source.removeprefix("data:image/webp;base64,")).startswith(b"RIFF")
    assert not re.search(r"https?://|@import|url\(|<script src|<link", page)
    assert page.startswith("<!DOCTYPE html>")


def test_columns_have_units(tmp_path) -> None:
    rows = [{"hand.gap": gap, "weakest_Pa": 1e3, "error": ""} for gap in (0.01, 0.02)]
    write_sweep_page(tmp_path / "sweep.html", Swept("", "", ("hand.gap",), rows))
    page = (tmp_path / "sweep.html").read_text(encoding="utf-8")
    for cell in (">hand.gap</th>", ">0.02</th>", ">weakest [Pa]</th>"):
        assert cell in page


def test_a_value_that_a_template_misses_is_an_error(tmp_path) -> None:
    with pytest.raises(UndefinedError, match="'title' is undefined"):
        write_page(tmp_path / "page.html", "page.html.j2")
