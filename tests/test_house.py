"""Rules that hold for the whole repository: public names, shapes, docstrings, imports, documents."""

import ast
import functools
import inspect
import re
import subprocess
import sys
import tomllib
import typing
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import click
import numpy as np
from jaxtyping import AbstractArray

import airtact as at
from airtact.cli import commands
from airtact.setup import tables
from paths import ROOT

MODULES = sorted((ROOT / "src/airtact").rglob("*.py"))
PACKAGES = [at] + [getattr(at, name) for name in at.__all__ if inspect.ismodule(getattr(at, name))]

RELIED_ON = """
Medium air Surface sphere capsule load_surface sound_hard filled impedance plane Pose Scene
Target Monopoles PhasedArray surrounding_box flat_boards autd3_board piston monopole pinch Hand
hand_from_joints load_hand fit_hand BoundaryElement FiniteElement SphereSeries FreeField
SampledField multipole_expansion transfer_matrix open_air_matrix TransferMatrix Drive best
time_reversal weighted_gerchberg_saxton max_min upper_bound focus_by_distance quantise evaluate
compare field_map read_scene load_drive example plot Uncertainty ensemble robust Echoes
simulate_echoes scattering_matrix locate calibrate sweep AUTD3Link Emission Stored InvalidInput
NotConverged VirtualObject contact
"""


def public() -> dict[str, Any]:
    names = {
        f"{package.__name__}.{name}": getattr(package, name)
        for package in PACKAGES
        for name in package.__all__
    }
    return {
        name: value
        for name, value in names.items()
        if inspect.isroutine(value) or inspect.isclass(value)
    }


def members(cls: type) -> Iterator[tuple[str, Callable]]:
    """Functions behind the public methods and properties that a class defines itself."""
    fields = typing.get_type_hints(cls)
    for name, value in vars(cls).items():
        if name.startswith("_") or name in fields:
            continue
        if isinstance(value, property):
            value = value.fget
        elif isinstance(value, functools.cached_property):
            value = value.func
        yield name, getattr(value, "__func__", value)


def public_callables() -> dict[str, Callable]:
    """Public functions, and the constructors and members of public classes, by name."""
    callables: dict[str, Callable] = {}
    for name, value in public().items():
        if not inspect.isclass(value):
            callables[name] = value
            continue
        if (
            "__init__" in vars(value)
            and not issubclass(value, Exception)
            and not getattr(value, "_is_protocol", False)
        ):
            callables[f"{name}()"] = value.__init__
        callables |= {f"{name}.{member}": function for member, function in members(value)}
    return callables


def annotations_of(function: Callable) -> dict[str, Any]:
    """Types of all arguments and of the result; a missing one fails the test."""
    function = inspect.unwrap(function)
    hints = typing.get_type_hints(function)
    parameters = [
        name for name in inspect.signature(function).parameters if name not in ("self", "cls")
    ]
    missing = [name for name in [*parameters, "return"] if name not in hints]
    assert not missing, f"{function.__qualname__} has no type for {missing}"
    return hints


def without_shape(hint: Any) -> list[str]:
    """Parts of a type that could hold an array of any shape."""
    if inspect.isclass(hint) and issubclass(hint, AbstractArray):
        return [str(hint)] if "..." in hint.dim_str.split() else []
    if hint in (Any, object, list, tuple, dict) or (
        inspect.isclass(hint) and issubclass(hint, np.ndarray)
    ):
        return [str(hint)]
    return [fault for part in typing.get_args(hint) for fault in without_shape(part)]


def test_names_that_others_rely_on_are_there() -> None:
    assert set(RELIED_ON.split()) <= set(at.__all__)
    assert all(hasattr(package, name) for package in PACKAGES for name in package.__all__)


def test_public_arguments_results_and_fields_carry_shapes() -> None:
    hints = {name: annotations_of(function) for name, function in public_callables().items()}
    hints |= {
        name: typing.get_type_hints(cls) for name, cls in public().items() if inspect.isclass(cls)
    }
    faults = {
        (name, where): shapes
        for name, types in hints.items()
        for where, hint in types.items()
        if (shapes := without_shape(hint))
    }
    assert faults == {}
    assert sum("jaxtyping" in str(types) for types in hints.values()) >= 20


def test_public_names_have_docstrings() -> None:
    documented = public() | {
        name: f for name, f in public_callables().items() if not name.endswith("()")
    }
    assert [name for name, value in documented.items() if not inspect.getdoc(value)] == []


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
for name in ("numpy", "scipy", "jaxtyping", "airtact.acoustics"):
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
print([name for name in ("numpy", "scipy", "matplotlib") if name in sys.modules])
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


SMALL_SCENE_IMPORTS = """
import sys
from airtact.cli import main
for pictures in ["--no-pictures"], []:
    assert main(["render", sys.argv[1], *pictures, "--quiet", "--out", sys.argv[2]]) == 0
    print([name for name in ("scipy", "matplotlib") if name in sys.modules])
"""


def test_a_small_scene_does_without_scipy_whose_import_takes_longer_than_its_solve(
    tmp_path: Path,
) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text(at.read_scene("pinch").text.replace("accuracy = 0.01", "accuracy = 0.1"))
    command = [sys.executable, "-c", SMALL_SCENE_IMPORTS, str(scene), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-2:] == ["[]", "['matplotlib']"]


def test_modules_have_docstrings_and_errors_have_codes() -> None:
    faults = []
    for path in MODULES:
        tree = ast.parse(path.read_text(encoding="utf-8"))
        if not ast.get_docstring(tree):
            faults.append(f"{path.name} has no docstring")
        for node in ast.walk(tree):
            called = ast.unparse(node.func) if isinstance(node, ast.Call) else ""
            if called in ("InvalidInput", "NotConverged", "LinkFailed") and "code" not in {
                word.arg for word in typing.cast(ast.Call, node).keywords
            }:
                faults.append(f"{path.name}:{typing.cast(ast.Call, node).lineno} has no code")
    assert faults == []


def test_names_used_through_the_package_come_from_lower_layers() -> None:
    # import-linter sees `import airtact as at` as an import of the package, not of what is used.
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    layers = project["tool"]["importlinter"]["contracts"][0]["layers"]
    depth = {name: index for index, layer in enumerate(layers) for name in layer.split(" | ")}
    wrong = []
    for path in MODULES:
        package = path.relative_to(ROOT / "src/airtact").parts[0].removesuffix(".py")
        tree = ast.parse(path.read_text(encoding="utf-8"))
        imported = [
            alias.name
            for node in ast.walk(tree)
            if isinstance(node, ast.Import)
            for alias in node.names
        ]
        if package not in depth or "airtact" not in imported:
            continue
        for node in ast.walk(tree):  # examples in docstrings may use everything
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(
                node
            ):
                del node.body[0]
        for name in re.findall(r"\b(?:at|airtact)\.(\w+)", ast.unparse(tree)):
            used = getattr(at, name, None)
            home = name if name in depth else getattr(used, "__module__", "").split(".")[1:2]
            home = home if isinstance(home, str) else "".join(home)
            if home in depth and home != package and depth[home] <= depth[package]:
                wrong.append(f"{path.name} uses at.{name}, which is of {home}")
    assert wrong == []


def test_no_module_shares_its_name_with_a_public_name_of_its_package() -> None:
    # The submodule would hide the lazily imported name once it is imported itself.
    clashes = [
        f"{package.__name__}.{name}"
        for package in PACKAGES
        for name in package.__all__
        if package.__name__ != "airtact.reports" and hasattr(package, "__path__")
        if (Path(package.__path__[0]) / f"{name}.py").exists()
    ]
    assert clashes == []


def test_no_file_depends_on_where_it_was_written() -> None:
    # Spelled in parts, so that this file does not find itself.
    patterns = [
        r"\.\./" + "shared",
        "/" + r"work/\w",
        "/" + r"home/\w",
        "/" + "root/",
        "pypi" + r"\.org",
    ]
    forbidden = re.compile("|".join([*patterns, "python" + "hosted", "npm" + "js"]))
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    found = []
    for name in listed.stdout.splitlines():
        try:
            text = (ROOT / name).read_text(encoding="utf-8")
        except (UnicodeDecodeError, FileNotFoundError):
            continue
        found += [f"{name}: {match[0]}" for match in forbidden.finditer(text)]
    assert len(listed.stdout.splitlines()) > 50
    assert found == []


def test_every_command_and_every_key_of_a_scene_file_is_documented() -> None:
    page = (ROOT / "docs/commands.md").read_text(encoding="utf-8")
    assert isinstance(commands, click.Group)
    assert [name for name in commands.commands if f"`airtact {name}`" not in page] == []
    page = (ROOT / "docs/scene-file.md").read_text(encoding="utf-8")
    kinds = [
        kind
        for kind in vars(tables).values()
        if inspect.isclass(kind) and issubclass(kind, tables.Table)
    ]
    keys = {key for kind in kinds for key in kind.__struct_fields__}
    assert len(keys) > 20
    assert sorted(key for key in keys if f"`{key}`" not in page) == []


def test_links_in_documents_lead_somewhere() -> None:
    documents = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")]
    broken = []
    for path in [*documents, *sorted((ROOT / "docs").glob("*.md"))]:
        links = re.findall(r"\]\(([^)#]+)\)", path.read_text(encoding="utf-8"))
        missing = [
            link
            for link in links
            if not link.startswith("http") and not (path.parent / link).exists()
        ]
        broken += [f"{path.name}: {link}" for link in missing]
    assert broken == []
