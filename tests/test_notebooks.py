"""The notebooks run as they stand, use public names only, and do each task in the lines that a new user may need."""

import ast
import re
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

import airtact as at
from paths import ROOT

NOTEBOOKS = sorted((ROOT / "docs/notebooks").glob("*.ipynb"))

MOST_STATEMENTS = {"fingertip": 12, "six-foci": 10, "circle": 10}
"""Lines of the first cell, which does the task of its notebook; blank ones do not count."""


def sources_of(path: Path) -> list[str]:
    return [
        cell.source for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"
    ]


def test_there_is_a_notebook_for_each_task() -> None:
    assert sorted(path.stem for path in NOTEBOOKS) == sorted(MOST_STATEMENTS)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_task_fits_its_statements(path) -> None:
    assert len(ast.parse(sources_of(path)[0]).body) <= MOST_STATEMENTS[path.stem]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_uses_public_names_only(path) -> None:
    code = "\n".join(sources_of(path))
    imported = {
        name.name
        for node in ast.walk(ast.parse(code))
        if isinstance(node, ast.Import)
        for name in node.names
    }
    assert imported <= {"airtact", "numpy"}
    assert "from airtact" not in code
    assert not re.search(r"\._\w", code)
    names = set(re.findall(r"\bat\.(\w+)", code))
    assert names <= set(at.__all__)
    cells = nbformat.read(path, as_version=4).cells
    assert [
        cell
        for cell in cells
        if cell.cell_type == "code" and (cell.outputs or cell.execution_count)
    ] == []


def test_the_notebooks_run(tmp_path) -> None:
    # One after the other in one kernel, whose start takes as long as a notebook
    together = nbformat.v4.new_notebook()
    cells = {}
    for path in NOTEBOOKS:
        cells[path.stem] = nbformat.read(path, as_version=4).cells
        together.cells += [nbformat.v4.new_code_cell("%reset -f"), *cells[path.stem]]
    NotebookClient(together, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()
    for name, its_cells in cells.items():
        shown = [output for cell in its_cells for output in cell.get("outputs", [])]
        assert any("image/png" in output.get("data", {}) for output in shown), name
        if name == "six-foci":
            assert any("weakest of 6 foci" in output.get("text", "") for output in shown)
        assert [output.text for output in shown if output.get("name") == "stderr"] == []
