"""The pages of docs/ and the README do what they say: what they show is run, and its output compared."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest

import airtact as at
from airtact.cli import main
from airtact.setup import tables
from airtact.setup.parsing import parse_scene
from paths import ROOT

FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
RUN = re.compile(r"^```(python|sh)$", re.MULTILINE)
PAGES = [
    page
    for page in [*sorted((ROOT / "docs").glob("*.md")), ROOT / "CONTRIBUTING.md"]
    if RUN.search(page.read_text(encoding="utf-8"))
]


@dataclass(frozen=True)
class Block:
    """One fenced block of a page, and the line on which its text begins."""

    kind: str
    text: str
    line: int


def blocks(page: Path) -> list[Block]:
    text = page.read_text(encoding="utf-8")
    return [Block(m[1], m[2], text[: m.start(2)].count("\n")) for m in FENCE.finditer(text)]


def expected_output(page_blocks: list[Block]) -> Iterator[tuple[Block, str | None]]:
    """Pair each block that is run with the output that the page shows directly after it."""
    for block, after in zip(page_blocks, [*page_blocks[1:], None], strict=True):
        if block.kind in ("python", "sh"):
            yield block, after.text if after is not None and after.kind == "text" else None


def run_python(page: Path, block: Block, names: dict) -> None:
    # Empty lines before the text make a traceback name the line of the page.
    exec(compile("\n" * block.line + block.text, str(page), "exec"), names)


def test_there_are_pages() -> None:
    assert len(PAGES) >= 5


@pytest.mark.parametrize("page", PAGES, ids=[page.stem for page in PAGES])
def test_page_runs_and_prints_what_it_shows(page, tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    # Each drive that `airtact live --verify` judges takes a solve of more than a second, and so does each layout that
    # `airtact place` refines. Processes that solve for the hand take 2 s.
    unsolved = partial(at.live.HandAware, solvers=[])
    monkeypatch.setattr("airtact.live.running.HandAware", unsolved)
    monkeypatch.setattr(at.live, "verify_session", partial(at.live.verify_session, drives=1))
    monkeypatch.setattr(at, "place", partial(at.place, refine=1))
    names: dict = {"__name__": page.stem}
    for block, shown in expected_output(blocks(page)):
        capsys.readouterr()
        if block.kind == "sh":
            for command in block.text.splitlines():
                program, *arguments = command.split()
                assert (program, main(arguments)) == ("airtact", 0), command
        else:
            run_python(page, block, names)
        if shown is not None:
            assert capsys.readouterr().out.strip() == shown.strip(), (
                f"{page.name}, line {block.line}"
            )


def test_python_of_the_readme_runs(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict = {"__name__": "readme"}
    python = [block for block in blocks(ROOT / "README.md") if block.kind == "python"]
    assert python, "the README shows no Python"
    for block in python:
        run_python(ROOT / "README.md", block, names)


def test_commands_of_the_readme_exist() -> None:
    targets = set(
        re.findall(r"^(\w[\w-]*):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    )
    commands = [
        line
        for block in blocks(ROOT / "README.md")
        if block.kind == "sh"
        for line in block.text.splitlines()
    ]
    asked = [line.split()[1] for line in commands if line.startswith("make ")]
    assert {"run", "test"} <= set(asked)
    assert set(asked) <= targets


def test_keys_of_the_scene_file_are_those_of_the_schema() -> None:
    page = (ROOT / "docs/scene-file.md").read_text(encoding="utf-8")
    spec = spec_from_file_location("scene_file", ROOT / "docs/scene_file.py")
    assert spec is not None
    assert spec.loader is not None
    writer = module_from_spec(spec)
    spec.loader.exec_module(writer)
    assert writer.filled(page) == page, "run python docs/scene_file.py"
    shown = set(re.findall(r"<!-- table (\w+) -->", page))
    kinds = {name for name in vars(tables) if name.endswith("Table")} - {"Table"}
    assert shown == kinds | {"SceneFile"}


def test_examples_of_the_scene_file_are_read() -> None:
    examples = [block.text for block in blocks(ROOT / "docs/scene-file.md") if block.kind == "toml"]
    assert len(examples) > 10
    smallest = examples[0]
    for text in examples:
        head = [part for part in smallest.split("\n\n") if part.split("\n")[0] not in text]
        parse_scene("\n\n".join([*head, text]))
