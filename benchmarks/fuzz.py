"""Damaged sessions, echoes, drives and tables: each must be read, or rejected in one sentence.

Run it from the root of the project: ``python -m benchmarks.fuzz [--files 1200]``. It counts
tracebacks, warnings, crashes, reads of over 10 s and over 1 GB; each is printed with its seed.
"""

import argparse
import json
import random
import select
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np

import airtact as at

# Entries of other kinds, shapes and sizes that replace one of a file.
VALUES: tuple[Any, ...] = (
    *(0, 1, -1, 9, 2**63 - 1, 1e-300, 1e300, np.nan, np.inf, 1j, True),
    *("", "x" * 100_000, "\0", "\u202e\x1b[31m", b"\xff\xfe", ["a", "b"]),
    *(np.zeros(0), np.zeros((0, 3)), np.zeros((2, 2, 2)), np.full(5, np.nan), np.ones(3, bool)),
    *(np.arange(7, dtype=">i2"), np.ones(3, np.float16), np.zeros(2, "i4,f8"), h5py.Empty("f8")),
)
CELLS = ("", "nan", "1e400", "0_8", "0. 8", "0i", "٠", "9" * 5000, "-1", "1e9", "\f", '"', "x", "2")
BYTES = (b"", b"\0", b"\xff\xff\xff\xff", b"\n", b",", b'"', b"\0\0\x80\x7f", b"[" * 3000, b"\r")


def whole_files(folder: Path) -> None:
    """Write one file of each kind."""
    setup = at.read_scene(at.example("live_pinch"))
    scene = at.live.live_scene(setup)
    joints = at.hands.load_recording(at.example("reaching.jsonl")).frames[0].landmarks
    writer = at.live.SessionWriter(folder / "session.h5", scene, "a scene")
    for index in range(3):
        time_of_drive = 0.01 * index
        writer.frame(at.hands.HandFrame(time_of_drive, "left", index, joints))
        foci = np.zeros((len(scene.places), 3))
        amplitudes = np.ones(len(scene.array), complex)
        hand = at.hand_from_joints(joints, side="left").joints
        moment = at.live.Moment(time_of_drive, time_of_drive, hand, foci, amplitudes, np.ones(2))
        writer.drive(moment, time_of_drive)
    writer.close()
    codes = np.exp(1j * np.arange(12.0).reshape(4, 3))
    at.Echoes(codes, codes, noise=1e-3, valid=np.ones((4, 3), bool)).save(folder / "echoes.h5")
    array = at.autd3_board()
    drives = np.exp(1j * np.arange(2.0 * len(array)).reshape(2, -1))
    at.Drive(drives[0]).save(folder / "drive.h5", array)
    at.Drive(drives[0]).save(folder / "drive.csv", array)
    at.drives.Sequence(drives, 1000.0).save(folder / "sequence.h5", array)
    numbers = np.random.default_rng(0).normal(scale=0.05, size=(40, 5)).round(6).tolist()
    rows = [",".join(map(str, row)) for row in numbers]
    (folder / "scan.csv").write_text("\n".join(["x,y,z,pressure,phase", *rows]))
    fields = [f"{x},{y},{z},{p}{q:+}i" for x, y, z, p, q in numbers]
    (folder / "field.csv").write_text("\n".join(["% x, y, z, pressure", *fields]))
    (folder / "gains.csv").write_text("element,gain,phase\n0,0.9,0.1\n3,1.1,-0.2\n7,0,0\n")


def read(name: str, path: Path) -> None:
    """Read a damaged file as the commands do."""
    scene = at.Scene(at.air(), [])
    source = at.Monopoles(np.array([[0.1, 0.1, 9.0]]), np.ones(1))
    readers: dict[str, Callable[[Path], object]] = {
        "echoes.h5": at.sensing.load_echoes,
        "scan.csv": at.evaluation.load_scan,
        "gains.csv": partial(at.transducers.load_calibration, elements=8),
        "field.csv": partial(
            at.acoustics.load_samples, scene=scene, sources=source, time_sign="e^{-iωt}"
        ),
    }
    if name == "session.h5":
        at.live.recording_of(path)
        readers[name] = at.live.read_session
    readers.get(name, at.load_drive)(path)


def damage_entry(path: Path, draw: random.Random) -> None:
    """Replace, remove, link or enlarge a dataset or attribute of an HDF5 file."""
    with h5py.File(path, "a") as file:
        names: list[str] = []
        file.visit(names.append)
        if file.attrs and draw.random() < 0.4:
            name = draw.choice(sorted(file.attrs))
            file.attrs.pop(name)
            if draw.random() < 0.8:
                value = draw.choice([value for value in VALUES if np.size(value) < 1000])
                file.attrs[name] = "x" * 1000 if isinstance(value, str) else value
            return
        name = draw.choice(sorted(names))
        # An earlier damage may have declared 600 GB, which some computers would set about reading.
        small = isinstance(file[name], h5py.Dataset) and (file[name].size or 0) < 10**8
        before = file[name][()] if small else 0.0
        del file[name]
        kind = draw.randrange(8)
        if kind == 0:
            file[name] = h5py.SoftLink(draw.choice((f"/{name}", "/", "/none")))
        elif kind == 1:
            file[name] = h5py.ExternalLink("/etc/hostname", "/x")
        elif kind == 2:
            shape = draw.choice(((10**6, 10**6), (10**9, 25, 3), (10**9, 249), (2**40,)))
            file.create_dataset(name, shape, "f8", chunks=(1,) * len(shape))
        elif kind == 3:
            zeros = np.zeros(10**7)
            file.create_dataset(name, data=zeros, compression="gzip", chunks=(10**7,))
        elif kind == 4 and isinstance(before, np.ndarray) and before.size:
            values = before.copy()
            values.flat[draw.randrange(values.size)] = draw.choice((0, 1, -1, 99, 3.5))
            file[name] = values
        elif kind == 5 and isinstance(before, np.ndarray) and before.ndim:
            file[name] = draw.choice((before[:-1], before.T, np.repeat(before, 2, axis=0)))
        elif kind < 7:
            value = draw.choice(VALUES)
            file[name] = "x\ufffd" if isinstance(value, str) and "\0" in value else value


def damaged(path: Path, draw: random.Random) -> None:
    """Damage a file in one to three places, by structure or by bytes."""
    for _ in range(draw.choice((1, 1, 2))):
        structured = draw.random() < 0.7
        if structured and path.suffix == ".h5":
            try:
                damage_entry(path, draw)
            except Exception:  # the last damage left nothing to open
                return
        elif structured:
            lines = path.read_text(encoding="utf-8", errors="replace").split("\n")
            row = draw.randrange(len(lines))
            cells = lines[row].split(",")
            cells[draw.randrange(len(cells))] = draw.choice(CELLS)
            lines[row] = ",".join(cells)
            swap = draw.randrange(len(lines))
            if draw.random() < 0.3:
                lines[row], lines[swap] = lines[swap], lines[row]
            path.write_text("\n".join(lines), encoding="utf-8")
        else:
            raw = path.read_bytes()
            place = draw.randrange(max(len(raw), 1))
            cut = place + draw.choice((0, 1, 4, 100, len(raw)))
            path.write_bytes(raw[:place] + draw.choice(BYTES) + raw[cut:])


def attempt(seed: int, whole: Path, path: Path) -> dict[str, object]:
    """Damage and read one file; return the outcome, the time [s] and the peak memory [bytes]."""
    draw = random.Random(seed)
    source = draw.choice(sorted(whole.iterdir()))
    path = path.with_suffix(source.suffix)
    path.write_bytes(source.read_bytes())
    damaged(path, draw)
    Path("/proc/self/clear_refs").write_text("5")  # resets the peak
    begun = time.monotonic()
    outcome = "read"
    words = ""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            read(source.name, path)
    except at.InvalidInput as fault:
        outcome = "rejected"
        words = f"{fault} [{fault.code}]"
        if not words.isprintable():
            outcome = "unprintable"
    except BaseException:
        outcome = "traceback"
        words = traceback.format_exc()
    status = Path("/proc/self/status").read_text()
    peak = 1024 * int(status.partition("VmHWM:")[2].split()[0])
    seconds = time.monotonic() - begun
    return {
        "seed": seed,
        "file": source.name,
        "outcome": outcome,
        "words": words,
        "seconds": seconds,
        "bytes": peak,
    }


def campaign(count: int, whole: Path) -> list[dict[str, Any]]:
    """Attempt seeds in a process that is started anew whenever it crashes or hangs."""
    results: list[dict[str, Any]] = []
    while len(results) < count:
        first = len(results)
        command = [sys.executable, "-m", "benchmarks.fuzz", "--files", str(count)]
        with subprocess.Popen(
            [*command, "--first", str(first), "--whole", str(whole)],
            stdout=subprocess.PIPE,
            text=True,
        ) as child:
            assert child.stdout is not None
            limit = 60.0  # it imports airtact first
            while len(results) < count:
                ready = select.select([child.stdout], [], [], limit)[0]
                line = child.stdout.readline() if ready else ""
                if not line:
                    child.kill()
                    outcome = "crash" if ready else "hang"
                    results.append({"seed": len(results), "outcome": outcome, "seconds": limit})
                    break
                results.append(json.loads(line))
                limit = 20.0
    return results


def main() -> None:
    """Print the outcomes, and each that must not be."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--files", type=int, default=1200)
    parser.add_argument("--first", type=int, help="run seeds from this one in this process")
    parser.add_argument("--whole", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        if options.first is not None:
            for seed in range(options.first, options.files):
                print(json.dumps(attempt(seed, options.whole, Path(name) / "one")), flush=True)
            return
        whole_files(Path(name))
        for path in Path(name).iterdir():
            read(path.name, path)
        results = campaign(options.files, Path(name))
    for result in results:
        large = result.get("bytes", 0) > 1e9
        if result["outcome"] not in ("read", "rejected") or result["seconds"] > 10.0 or large:
            print(result)
            print(result.get("words", ""))
    print(Counter((result.get("file"), result["outcome"]) for result in results))
    print(Counter(result["outcome"] for result in results))
    print(f"over 10 s: {sum(result['seconds'] > 10.0 for result in results)}")
    print(f"over 1 GB: {sum(result.get('bytes', 0) > 1e9 for result in results)}")
    print(f"largest: {max(result.get('bytes', 0) for result in results) / 1e6:.0f} MB")


if __name__ == "__main__":
    main()
