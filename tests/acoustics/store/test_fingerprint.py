"""A field's name follows from all code that computes it: found by its imports, and never with a file left out."""

import ast
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import airtact as at
from airtact.acoustics.solvers.problem import RadiatedField, Solver
from airtact.acoustics.store.fingerprint import (
    KERNELS,
    PACKAGE,
    _imports,
    code_files,
    fingerprint,
    program,
)
from faults import raises_code

SOURCE = at.Monopoles(np.array([[0.0, 0.0, 0.012]]), np.ones(1))
BALL = at.Scene(at.Medium(343.1, 1.293), [at.sound_hard(at.sphere(3e-3, 2e-3))])
SOLVES = frozenset(
    {
        "airtact.acoustics.solvers.bem.solver",
        "airtact.acoustics.solvers.problem",
        "airtact.acoustics.scene",
    }
)
HANDS = SOLVES | {"airtact.hands.shape", "airtact.geometry.surface"}


@pytest.fixture
def copied(tmp_path: Path) -> Path:
    return shutil.copytree(
        PACKAGE, tmp_path / "airtact", ignore=shutil.ignore_patterns("__pycache__")
    )


def named(modules: frozenset[str], package: Path, kernels: Path = KERNELS) -> str:
    return program.__wrapped__(modules, package, kernels)


def test_the_program_is_named_by_its_version_and_its_files() -> None:
    assert program(SOLVES).startswith(f"airtact {at.__version__} ")
    assert program(SOLVES) is program(SOLVES)


@pytest.mark.parametrize(
    "path",
    [
        "conventions.py",
        "validation.py",
        "pose.py",
        "mesh/topology.py",
        "mesh/__init__.py",
        "surfaces/panels.py",
        "surfaces/primitives.py",
        "scene/medium.py",
        "solvers/bem/operator.py",
        "solvers/gmres.py",
        "solvers/memory.py",
        "hand/skin_mesh.py",
        "hand/shape.py",
    ],
)
def test_a_changed_byte_that_a_solve_follows_from_changes_the_name(copied: Path, path: str) -> None:
    before = named(HANDS, copied)
    with (copied / path).open("a") as file:
        file.write("#")
    assert named(HANDS, copied) != before


def test_every_file_that_is_followed_counts(copied: Path) -> None:
    before, files = named(HANDS, copied), code_files(HANDS, copied)
    assert len(files) > 40
    for file in files.values():
        content = file.read_bytes()
        file.write_bytes(content + b"\n")
        assert named(HANDS, copied) != before, file
        file.write_bytes(content)
    assert named(HANDS, copied) == before


@pytest.mark.parametrize(
    "path", ["cli/__init__.py", "pages/run_page.py", "__init__.py", "solvers/fem/solver.py"]
)
def test_a_file_that_a_solve_does_not_follow_from_changes_nothing(copied: Path, path: str) -> None:
    before = named(HANDS, copied)
    (copied / path).write_text("1 / 0\n")
    assert named(HANDS, copied) == before


def test_the_compiled_loops_count(copied: Path, tmp_path: Path) -> None:
    kernels = tmp_path / "kernels.so"
    kernels.write_bytes(b"one")
    before = named(SOLVES, copied, kernels)
    kernels.write_bytes(b"two")
    assert named(SOLVES, copied, kernels) != before
    kernels.unlink()
    with raises_code("file_missing", "kernels.so"):
        named(SOLVES, copied, kernels)


@pytest.mark.parametrize(
    "path", ["mesh/topology.py", "mesh/__init__.py", "solvers/problem.py", "conventions.py"]
)
def test_a_missing_file_is_an_error(copied: Path, path: str) -> None:
    (copied / path).unlink()
    with raises_code(
        "file_missing", path.rpartition("/")[2].removesuffix(".py").replace("__init__", "mesh")
    ):
        named(SOLVES, copied)


def test_a_moved_module_is_followed_to_where_it_went(copied: Path) -> None:
    (copied / "elsewhere").mkdir()
    (copied / "elsewhere/__init__.py").touch()
    (copied / "solvers/gmres.py").rename(copied / "elsewhere/gmres.py")
    for file in copied.rglob("*.py"):
        text = file.read_text()
        file.write_text(text.replace("airtact.acoustics.solvers.gmres", "airtact.elsewhere.gmres"))
    before = named(SOLVES, copied)
    with (copied / "elsewhere/gmres.py").open("a") as file:
        file.write("#")
    assert named(SOLVES, copied) != before


@pytest.mark.parametrize(
    "statement",
    [
        "import airtact.files.text_table",
        "import os, airtact.files.text_table",
        "from airtact.files import text_table",
        "from airtact.files.text_table import text_table",
        "from airtact.files.text_table import (\n    text_table,  # a table (of text)\n)",
        "def late():\n    from airtact.files.text_table import text_table",
        "if 1:\n    import airtact.files.text_table as table",
    ],
)
def test_every_way_to_import_is_followed(copied: Path, statement: str) -> None:
    assert "airtact.files.text_table" not in code_files(SOLVES, copied)
    (copied / "solvers/gmres.py").write_text(statement + "\n")
    assert "airtact.files.text_table" in code_files(SOLVES, copied)


@pytest.mark.parametrize(
    "statement", ["from airtact import nowhere", "from airtact.geometry.mesh import nowhere"]
)
def test_a_module_that_is_nowhere_is_an_error(copied: Path, statement: str) -> None:
    (copied / "__init__.py").write_text('"""Empty."""\n')
    (copied / "solvers/gmres.py").write_text(statement + "\n")
    with raises_code("file_missing", "nowhere.py"):
        named(SOLVES, copied)


def test_reading_statements_finds_what_reading_whole_files_finds() -> None:
    """The quick way against Python's own grammar, for every module of the package."""
    for name, file in code_files(frozenset({"airtact.cli"})).items():
        whole = {
            node.module if isinstance(node, ast.ImportFrom) else one.name
            for node in ast.walk(ast.parse(file.read_text()))
            if isinstance(node, ast.Import | ast.ImportFrom)
            for one in node.names
        }
        modules = {
            found
            for found in whole
            if found and found.startswith("airtact.") and "_kernels" not in found
        }
        found = set(_imports(file.read_text(), PACKAGE))
        assert modules <= found | {one.rpartition(".")[0] for one in found}, name


def test_nothing_of_commands_and_pages_is_followed_from_a_solve() -> None:
    rooms = {name.split(".")[1] for name in code_files(HANDS) if "." in name}
    assert rooms.isdisjoint(
        {"cli", "pages", "figures", "workflows", "hardware", "files", "store", "synthesis"}
    )
    assert "airtact" not in code_files(HANDS)


@dataclass(frozen=True)
class Outside(Solver):
    """A solver that somebody wrote elsewhere."""

    def radiate(self, scene: at.Scene, sources: at.Monopoles) -> RadiatedField:
        return at.FreeField().radiate(scene, sources)


def test_the_file_of_a_solver_from_elsewhere_counts(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    before = fingerprint(Outside(), BALL, SOURCE)
    other = tmp_path / "other.py"
    other.write_text(Path(__file__).read_text() + "#")
    monkeypatch.setattr(sys.modules[Outside.__module__], "__file__", str(other))
    program.cache_clear()
    assert fingerprint(Outside(), BALL, SOURCE) != before
    monkeypatch.setattr(sys.modules[Outside.__module__], "__file__", None)
    program.cache_clear()
    with raises_code("file_missing", "0 files"):
        fingerprint(Outside(), BALL, SOURCE)
