"""What is not part of a plain installation is named, with how to install it, by the sentence that asks for it."""

import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from paths import HANDS, ROOT, SCENES

WITHOUT = """
import sys
from importlib.abc import MetaPathFinder

class Without(MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name.partition(".")[0] in sys.argv[1].split(","):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Without())
from airtact.cli import main
sys.exit(main(sys.argv[2:]))
"""

EXTRAS = {
    "fem": ["ngsolve", "netgen"],
    "mesh": ["mmgpy", "skimage"],
}


def run_without(extra: str, *arguments: str | Path) -> tuple[int, str]:
    command = [sys.executable, "-c", WITHOUT, ",".join(EXTRAS[extra]), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    return done.returncode, done.stderr.splitlines()[-1]


def test_finite_elements_name_their_extra(tmp_path) -> None:
    text = (SCENES / "ball.toml").read_text(encoding="utf-8")
    (tmp_path / "ball.toml").write_text(f'{text}name = "finite_element"\n', encoding="utf-8")
    code, sentence = run_without("fem", "render", tmp_path / "ball.toml", "--out", tmp_path / "out")
    assert code == 2
    assert "pip install 'airtact[fem]'" in sentence
    assert sentence.endswith("[extra_missing]")


@pytest.mark.parametrize(
    ("command", "file", "out"),
    [
        ("hand", "pinch.json", "hand.ply"),
        pytest.param("mesh", "generic-hand-right.glb", "out.vtkhdf", marks=pytest.mark.slow),
    ],
)
def test_bodies_of_meshes_and_hands_name_their_extra(command, file, out, tmp_path) -> None:
    code, sentence = run_without("mesh", command, HANDS / file, "--out", tmp_path / out)
    assert code == 2
    assert "pip install 'airtact[mesh]'" in sentence
    assert sentence.endswith("[extra_missing]")


def test_all_is_every_extra_for_users() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"][
        "optional-dependencies"
    ]
    named = {
        name
        for requirement in extras["all"]
        for name in requirement.partition("[")[2].partition("]")[0].split(",")
    }
    assert named == set(extras) - {"all", "docs", "test"}


def test_a_source_install_without_a_compiler_says_so_in_one_line(tmp_path) -> None:
    cmake = shutil.which("cmake")
    if cmake is None:
        pytest.skip("cmake is not installed here; pip brings its own to build from the sources.")
    without = {**os.environ, "CXX": str(tmp_path / "no-compiler")}
    done = subprocess.run(
        [cmake, "-S", ROOT, "-B", tmp_path], capture_output=True, text=True, env=without, timeout=60
    )
    assert done.returncode != 0
    (line,) = [line for line in done.stderr.splitlines() if "C++17" in line]
    assert "No C++17 compiler was found: install one" in line
    assert "wheel" in line
