"""Pages come from templates: text is escaped, nothing is fetched, and a missing value is an error."""

import re
from base64 import b64decode

import pytest
from jinja2 import UndefinedError
from matplotlib.figure import Figure

from airtact.reports.page import (
    document,
    folded,
    heading,
    key_numbers,
    page_from,
    paragraph,
    picture,
    section,
    table,
)


def test_text_is_escaped_in_every_piece() -> None:
    text, escaped = '<i>&"', "&lt;i&gt;&amp;&#34;"
    pieces = [
        heading(text),
        section(text),
        paragraph(text, "warning"),
        folded(text, text),
        key_numbers([(text, text)]),
        table([text], [[text]], text),
        picture(_figure(), text, text),
    ]
    for piece in pieces:
        assert "<i>" not in piece
        assert escaped in piece
    page = document(text, [*pieces, text])
    assert "<i>" not in page
    assert page.count(escaped) == 1 + sum(piece.count(escaped) for piece in pieces) + 1


def test_a_page_needs_no_other_file() -> None:
    page = document("a page", [picture(_figure(), "caption", "what it shows")])
    (source,) = re.findall(r'(?:src|href)="([^"]*)"', page)
    assert b64decode(source.removeprefix("data:image/webp;base64,")).startswith(b"RIFF")
    assert not re.search(r"https?://|@import|url\(|<script|<link", page)
    assert page.startswith("<!DOCTYPE html>")


def test_a_value_that_a_template_misses_is_an_error() -> None:
    with pytest.raises(UndefinedError, match="'title' is undefined"):
        page_from("page.html.j2", pieces=[])


def _figure() -> Figure:
    figure = Figure(figsize=(2.0, 2.0))
    figure.subplots().plot([0.0, 1.0])
    return figure
