"""Size and form of the package: statements, modules, constants, comments, imports of a render.

Run ``python -m benchmarks.size``; give folders to count only those, such as ``src/airtact/drives``.
"""

import ast
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "src" / "airtact"


def trees(folder: Path) -> Iterator[tuple[str, ast.Module]]:
    """Yield text and syntax tree of each Python file under a folder, or of the file itself."""
    for path in [folder] if folder.is_file() else sorted(folder.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        yield text, ast.parse(text)


def statements(folder: Path) -> int:
    """Count ``ast.stmt`` nodes, docstrings included."""
    return sum(isinstance(node, ast.stmt) for _, tree in trees(folder) for node in ast.walk(tree))


def constants(folder: Path) -> int:
    """Count upper-case names assigned at the top of modules."""
    count = 0
    for _, tree in trees(folder):
        for node in tree.body:
            targets = node.targets if isinstance(node, ast.Assign) else []
            targets = [node.target] if isinstance(node, ast.AnnAssign) else targets
            names = [name for target in targets for name in ast.walk(target)]
            count += sum(isinstance(name, ast.Name) and name.id.isupper() for name in names)
    return count


def parallel_assignments(folder: Path) -> int:
    """Count assignments of a tuple of expressions to a tuple of targets."""
    return sum(
        isinstance(node, ast.Assign)
        and isinstance(node.value, ast.Tuple)
        and any(isinstance(target, ast.Tuple) for target in node.targets)
        for _, tree in trees(folder)
        for node in ast.walk(tree)
    )


def error_codes(folder: Path) -> set[str]:
    """Collect the codes that errors are raised with."""
    return {
        word.value.value
        for _, tree in trees(folder)
        for node in ast.walk(tree)
        if isinstance(node, ast.Call)
        for word in node.keywords
        if word.arg == "code"
        and isinstance(word.value, ast.Constant)
        and isinstance(word.value.value, str)
    }


def form(folder: Path) -> tuple[float, float]:
    """Comment-only lines per 1,000 lines, and mean characters of the lines that are not blank."""
    lines = [line for text, _ in trees(folder) for line in text.splitlines()]
    filled = [line for line in lines if line.strip()]
    comments = sum(line.lstrip().startswith("#") for line in lines)
    return 1e3 * comments / len(lines), sum(map(len, filled)) / len(filled)


def import_closure() -> int:
    """Count the modules of airtact that ``airtact render pinch`` has imported once the drive is on disk."""
    code = (
        "import sys, tempfile; from airtact.cli import main;"
        "main(['render', 'pinch', '--no-pictures', '--quiet', '--out', tempfile.mkdtemp()]);"
        "print(sum(name.startswith('airtact') for name in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return int(done.stdout.split()[-1])


def main(folders: list[str]) -> None:
    """Print the table, of the whole package or of folders of it."""
    for folder in [Path(name) for name in folders] or [PACKAGE]:
        comments, width = form(folder)
        modules = sum(1 for _ in trees(folder))
        print(f"{folder.resolve().relative_to(ROOT)}")
        print(f"  statements                        {statements(folder):7,}")
        print(f"  modules                           {modules:7}")
        print(f"  upper-case module constants       {constants(folder):7}")
        print(f"  parallel assignments              {parallel_assignments(folder):7}")
        print(f"  error codes                       {len(error_codes(folder)):7}")
        print(f"  comment lines per 1,000 lines     {comments:7.1f}")
        print(f"  characters per non-blank line     {width:7.1f}")
    if not folders:
        entries = [
            path for path in PACKAGE.iterdir() if not re.match(r"__pycache__|.*\.so", path.name)
        ]
        contract = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]
        layers = contract["importlinter"]["contracts"][0]["layers"]
        print(f"  entries at the top                {len(entries):7}")
        print(f"  layers                            {len(layers):7}")
        print(f"  modules imported by render pinch  {import_closure():7}")
        print(f"tests\n  statements                        {statements(ROOT / 'tests'):7,}")


if __name__ == "__main__":
    main(sys.argv[1:])
