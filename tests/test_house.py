"""The rules of the house: public names, shapes, docstrings, documents, and what importing does."""

import ast
import functools
import importlib
import inspect
import re
import subprocess
import sys
import tomllib
import typing
from collections.abc import Iterator
from pathlib import Path

import click
import numpy as np
import pytest
from jaxtyping import AbstractArray

import airtact as at
from airtact.cli import commands
from airtact.setup import tables
from airtact.setup.parsing import keys_of
from paths import ROOT

MODULES = sorted((ROOT / "src/airtact").rglob("*.py"))
SOURCES = sorted(
    path for folder in ("src", "tests", "benchmarks") for path in (ROOT / folder).rglob("*.py")
)
DOCUMENTS = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "CHANGELOG.md",
    *sorted((ROOT / "docs").glob("*.md")),
]

PUBLIC_NAMES = (Path(__file__).parent / "public_names.txt").read_text(encoding="utf-8").split()
NAMESPACES = [at, *(value for name in at.__all__ if inspect.ismodule(value := getattr(at, name)))]
PUBLIC = {
    f"{module.__name__}.{name}": value
    for module in NAMESPACES
    for name in module.__all__
    if inspect.isroutine(value := getattr(module, name)) or inspect.isclass(value)
}
CLASSES = [name for name, value in PUBLIC.items() if inspect.isclass(value)]
FUNCTIONS = [name for name in PUBLIC if name not in CLASSES]


# --- public names ---------------------------------------------------------------------------------------------------


def test_public_names_are_pinned() -> None:
    assert sorted(at.__all__) == PUBLIC_NAMES
    assert all(hasattr(module, name) for module in NAMESPACES for name in module.__all__)


def test_the_way_through_that_others_rely_on() -> None:
    medium = at.Medium(sound_speed=343.1, density=1.293)
    thumb = at.capsule((-0.014, 0, 0), (-0.014, 0, -0.01), radius=8e-3, edge=2.5e-3)
    scene = at.Scene(medium, [at.sound_hard(thumb)], frequency=40e3)
    target = at.Target(np.array([[-0.005, 0.0, 0.0]]), pressures=1500.0)
    array, pose = (
        at.autd3_board(at.Pose.identity()),
        at.Pose(np.eye(3), np.array([0.08, 0.06, 0.1])),
    )
    solver = at.BoundaryElement(accuracy=0.1)

    beacons = solver.radiate(scene, target.beacons())
    transfer = at.transfer_matrix(beacons, array.seen_from(pose))
    drive = at.time_reversal(transfer, target)
    frame = at.quantise(drive)
    pressure = at.field_map(scene, array.seen_from(pose), drive, target.points, solver=solver)
    evaluation = at.evaluate(scene, array.seen_from(pose), drive, target, solver=solver)

    assert frame.amplitude.dtype == frame.phase.dtype == np.uint8
    assert abs(pressure[0]) == pytest.approx(1500.0, rel=0.05)
    assert evaluation.worst == pytest.approx(1.0, rel=0.05)
    assert "share" in str(evaluation)


# --- shapes and docstrings ------------------------------------------------------------------------------------------


def members(cls: type) -> dict[str, typing.Any]:
    """Public methods and properties that a class defines itself; the types of its fields stand in the class."""
    fields = typing.get_type_hints(cls)
    return {
        name: value
        for name, value in vars(cls).items()
        if not name.startswith("_") and name not in fields
    }


def plain_function(member: typing.Any) -> typing.Callable:
    """Find the function behind a method, a property or a class method."""
    if isinstance(member, property):
        assert member.fget is not None
        return member.fget
    if isinstance(member, functools.cached_property):
        return member.func
    return getattr(member, "__func__", member)


def public_callables() -> Iterator[tuple[str, typing.Callable]]:
    for name in FUNCTIONS:
        yield name, PUBLIC[name]
    for name in CLASSES:
        cls = PUBLIC[name]
        if (
            "__init__" in vars(cls)
            and not issubclass(cls, Exception)
            and not getattr(cls, "_is_protocol", False)
        ):
            yield f"{name}()", cls.__init__
        for member, value in members(cls).items():
            yield f"{name}.{member}", plain_function(value)


CALLABLES = dict(public_callables())


def annotations_of(function: typing.Callable) -> dict[str, typing.Any]:
    """Types of all arguments and of the result; an argument without one is an error of the house."""
    function = inspect.unwrap(function)
    hints = typing.get_type_hints(function)
    parameters = [
        name for name in inspect.signature(function).parameters if name not in ("self", "cls")
    ]
    missing = [name for name in [*parameters, "return"] if name not in hints]
    assert not missing, f"no type: {missing}"
    return hints


def shapeless(hint: typing.Any) -> list[str]:
    """Parts of a type that could hold an array of any shape."""
    if inspect.isclass(hint) and issubclass(hint, AbstractArray):
        return [] if "..." not in hint.dim_str.split() else [f"any shape: {hint}"]
    if hint in (typing.Any, object, list, tuple, dict) or (
        inspect.isclass(hint) and issubclass(hint, np.ndarray)
    ):
        return [f"no shape: {hint}"]
    return [fault for part in typing.get_args(hint) for fault in shapeless(part)]


@pytest.mark.parametrize("name", CALLABLES)
def test_arguments_and_results_carry_shapes(name) -> None:
    faults = {where: shapeless(hint) for where, hint in annotations_of(CALLABLES[name]).items()}
    assert not any(faults.values()), faults


@pytest.mark.parametrize("name", CLASSES)
def test_fields_carry_shapes(name) -> None:
    faults = {field: shapeless(hint) for field, hint in typing.get_type_hints(PUBLIC[name]).items()}
    assert not any(faults.values()), faults


def test_the_search_for_missing_shapes_finds_them() -> None:
    assert shapeless(np.ndarray)
    assert shapeless(np.ndarray | None)
    assert shapeless(dict[str, np.typing.NDArray[np.float64]])
    assert shapeless(typing.get_type_hints(at.Target)["points"]) == []
    arrays = [
        name for name, function in CALLABLES.items() if "jaxtyping" in str(annotations_of(function))
    ]
    assert len(arrays) >= 20  # the search does look at arrays


ANY_ARRAY = {
    "airtact.checks.of_kind",
    "airtact.checks.check_finite",
    "airtact.printing.in_short",
    "airtact.printing.one_line",
    "airtact.acoustics.solvers.gmres.gmres",
    "airtact.emission.channel.Channel.send",
    "airtact.emission.channel.Channel.receive",
    "airtact.emission.feeding.LinkProcess.ask",
    "airtact.emission.player.Player.ask",
}
"""Inner functions that take arrays of any shape and type, a product that does, or messages that hold whatever."""


@pytest.mark.parametrize(
    "module", [path for path in MODULES if path.name != "__init__.py"], ids=lambda path: path.stem
)
def test_inner_functions_and_classes_have_no_bare_array(module) -> None:
    name = ".".join(module.relative_to(ROOT / "src").with_suffix("").parts)
    own = {
        word: value
        for word, value in vars(importlib.import_module(name)).items()
        if not word.startswith("_") and getattr(value, "__module__", None) == name
    }
    hints = {
        f"{name}.{word}": annotations_of(value)
        for word, value in own.items()
        if inspect.isfunction(value)
    }
    for word, cls in own.items():
        if inspect.isclass(cls):
            hints[f"{name}.{word}"] = typing.get_type_hints(cls)
            methods = {member: plain_function(value) for member, value in members(cls).items()}
            hints |= {
                f"{name}.{word}.{key}": annotations_of(it)
                for key, it in methods.items()
                if callable(it)
            }
    faults = {
        where: [fault for hint in types.values() for fault in shapeless(hint)]
        for where, types in hints.items()
    }
    bare = {
        where
        for where, found in faults.items()
        if any(fault.startswith("no shape") for fault in found)
    }
    assert bare - ANY_ARRAY == set()


@pytest.mark.parametrize(
    "name", [*CLASSES, *(name for name in CALLABLES if not name.endswith("()"))]
)
def test_public_names_have_docstrings(name) -> None:
    documented = PUBLIC[name] if name in CLASSES else CALLABLES[name]
    assert inspect.getdoc(documented), name


# --- importing ------------------------------------------------------------------------------------------------------

WATCHED_IMPORT = """
import os, sys
touched = []
def watch(event, arguments):
    if event == "open" and isinstance(arguments[0], (str, bytes)):
        touched.append((os.fsdecode(arguments[0]), str(arguments[1])))
    elif event.startswith(("socket.", "subprocess.")):
        touched.append((event, "w"))
sys.addaudithook(watch)
import airtact
light = set(sys.modules)
names = [getattr(airtact, name) for name in airtact.__all__ if name != "plot"]  # that is matplotlib
installed = (sys.prefix, sys.base_prefix, os.path.dirname(airtact.__file__))
for name, mode in touched:
    if not name.endswith((".py", ".pyc", ".so")) and not name.startswith(installed) or set(mode) & set("wax+"):
        print("touched", name, mode)
for name in ("numpy", "scipy", "jaxtyping", "airtact.acoustics", "airtact.acoustics.solvers"):
    if name in light:
        print("imported before a name was asked for", name)
for name in "matplotlib trimesh h5py rich click skimage ngsolve netgen mmgpy manifold3d jinja2".split():
    if name in sys.modules:
        print("imported", name)
"""

HELP_IMPORTS = """
import sys
from airtact.cli import main
for command in [], ["render"], ["check"], ["hand"]:
    assert main([*command, "--help"]) == 0
print([name for name in ("numpy", "scipy", "matplotlib", "airtact.workflows") if name in sys.modules])
"""


def test_import_touches_no_file_and_no_device() -> None:
    # -B: writing bytecode beside the sources is Python's own doing.
    done = subprocess.run(
        [sys.executable, "-B", "-c", WATCHED_IMPORT], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""


def test_help_imports_no_work() -> None:
    done = subprocess.run([sys.executable, "-c", HELP_IMPORTS], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "[]"


def test_each_public_name_is_what_type_checkers_see() -> None:
    tree = ast.parse(Path(at.__file__).read_text(encoding="utf-8"))
    typed = {
        alias.name: getattr(importlib.import_module(node.module), alias.name)
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom)
        and node.module is not None
        and node.module.startswith("airtact")
        for alias in node.names
    }
    assert sorted(typed) == sorted(at.__all__)
    assert [name for name, value in typed.items() if getattr(at, name) is not value] == []
    assert set(at.__all__) <= set(dir(at))


# --- sources --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_modules_fit_and_say_what_they_are(path) -> None:
    text = path.read_text(encoding="utf-8")
    tree = ast.parse(text)
    assert len(text.splitlines()) <= 600
    assert ast.get_docstring(tree) or path not in MODULES
    functions = [
        node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    ]
    long = {node.name: node.end_lineno - node.lineno + 1 for node in functions if node.end_lineno}
    assert {name: lines for name, lines in long.items() if lines > 60} == {}


@pytest.mark.parametrize(
    "folder", sorted({path.parent for path in MODULES}), ids=lambda path: path.name
)
def test_a_folder_fits_a_glance(folder) -> None:
    assert len([path for path in folder.iterdir() if path.is_file()]) <= 16


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_fault_has_a_code(path) -> None:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        called = ast.unparse(node.func).removeprefix("at.") if isinstance(node, ast.Call) else ""
        if isinstance(node, ast.Call) and called in ("InvalidInput", "NotConverged", "LinkFailed"):
            code = next((word.value for word in node.keywords if word.arg == "code"), None)
            assert code is not None, f"line {node.lineno} has no code"
            if isinstance(code, ast.Constant):
                assert re.fullmatch("[a-z]+(_[a-z0-9]+)*", str(code.value)), (
                    f"line {node.lineno}: {code.value}"
                )


def test_no_module_has_a_name_that_says_nothing() -> None:
    nothing = {"utils", "core", "common", "helpers", "manager", "base", "misc"}
    assert {path.stem for path in MODULES} & nothing == set()


def test_no_file_depends_on_where_it_was_written() -> None:
    # Spelled in parts, so that this file does not find itself.
    patterns = [
        r"\.\./" + "shared",
        "/" + r"work/\w",
        "/" + r"home/\w",
        "/" + "root/",
        "pypi" + r"\.org",
        "python" + "hosted",
        "npm" + "js",
    ]
    forbidden = re.compile("|".join(patterns))
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert listed.returncode == 0, listed.stderr
    found = []
    for name in listed.stdout.splitlines():
        try:
            text = (ROOT / name).read_text(encoding="utf-8")
        except (UnicodeDecodeError, FileNotFoundError):
            continue
        found += [f"{name}: {match[0]}" for match in forbidden.finditer(text)]
    assert len(listed.stdout.splitlines()) > 50
    assert found == []


def test_the_gate_runs_the_tests() -> None:
    script = (ROOT / ".ci/run").read_text(encoding="utf-8").splitlines()
    assert "make test" in [line.strip() for line in script]


# --- documents ------------------------------------------------------------------------------------------------------


def test_every_command_is_documented() -> None:
    page = (ROOT / "docs/commands.md").read_text(encoding="utf-8")
    assert isinstance(commands, click.Group)
    assert [name for name in commands.commands if f"`airtact {name}`" not in page] == []


def test_every_key_of_a_scene_file_is_documented() -> None:
    page = (ROOT / "docs/scene-file.md").read_text(encoding="utf-8")
    kinds = [
        kind
        for kind in vars(tables).values()
        if inspect.isclass(kind) and issubclass(kind, tables.Table)
    ]
    keys = {key for kind in kinds for key in keys_of(kind)}
    assert len(keys) > 20
    assert sorted(key for key in keys if f"`{key}`" not in page) == []


def test_the_drawing_shows_the_rooms_as_they_are() -> None:
    contract = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"][
        "importlinter"
    ]
    layers = [layer.split(" | ") for layer in contract["contracts"][0]["layers"]]
    known = {room for layer in layers for room in layer}
    drawing = (ROOT / "docs/architecture.md").read_text(encoding="utf-8").split("```")[1]
    drawn = [
        re.findall(r"\| (\w+)(?= {2,}|\b)", line)
        for line in drawing.splitlines()
        if re.match(r"\| [a-z]", line)
    ]
    assert [[room for room in line if room in known] for line in drawn] == layers


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_links_lead_somewhere(path) -> None:
    links = re.findall(r"\]\(([^)#]+)\)", path.read_text(encoding="utf-8"))
    assert [
        link for link in links if not link.startswith("http") and not (path.parent / link).exists()
    ] == []


def test_the_page_of_performance_has_the_place_for_what_was_measured() -> None:
    text = (ROOT / "docs/performance.md").read_text(encoding="utf-8")
    table = re.search(r"<!-- measured:begin -->\n(.*?)<!-- measured:end -->", text, re.DOTALL)
    assert table
    assert len(table[1].splitlines()) >= 12


# --- words ----------------------------------------------------------------------------------------------------------

PRIVATE_WORDS = re.compile(
    r"""\b(?:
    hears?|heard|hearing|speaks?|speakers?|speaking|spoken|told|tells?|telling|refus(?:e|es|ed|ing|al|als)
    |judg(?:e|es|ed|ing|ement|ements)|mend(?:s|ed|ing)?|tiles?|spots?|feet|slopes?|slots?|strays?|creases?|creased
    |quiet|loud|louder|loudest|loudness|shall|finer|six\ nodes|outgoing\ waves|(?<!perfectly\ )matched\ layer
    |quiet\ points?|share_reached|anybody|relief
    )\b""",
    re.VERBOSE | re.IGNORECASE,
)
"""Words of a language that only the project spoke; the glossary of the field has a better one for each."""


def words_of(name: str) -> str:
    """Split a name of Python into words."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name.rpartition(".")[2]).replace("_", " ")


@pytest.mark.parametrize(
    "name", [*PUBLIC, *(name for name in CALLABLES if not name.endswith("()"))]
)
def test_public_names_and_docstrings_use_the_words_of_the_field(name) -> None:
    documented = PUBLIC.get(name) or CALLABLES[name]
    assert PRIVATE_WORDS.findall(words_of(name)) == []
    assert PRIVATE_WORDS.findall(inspect.getdoc(documented) or "") == []


def test_the_search_for_private_words_finds_them() -> None:
    assert PRIVATE_WORDS.findall(
        f"what the {words_of('share_heard')} of a matched layer tells"
    ) == [
        "heard",
        "matched layer",
        "tells",
    ]
