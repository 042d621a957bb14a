"""Readers that cannot be trusted, in a process of their own with a limit of time and one of memory."""

import importlib
import io
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from airtact.errors import InvalidInput
from airtact.files.bounded import Arrays

MOST_SECONDS = 60
"""Longest that a reader may compute [s]."""

MOST_MEMORY = 4_000_000_000
"""Most address space that its process may take, libraries included [bytes]."""

PATIENCE = 10
"""Longest time that it may take beside other work, over ``MOST_SECONDS``."""

SENTENCE, CODE = "fault: sentence", "fault: code"
"""Names of the arrays that hold a fault."""


def read_apart(
    reader: Callable[[Path], Arrays],
    path: Path,
    seconds: int = MOST_SECONDS,
    memory: int = MOST_MEMORY,
    without: Sequence[str] = (),
) -> Arrays:
    """Call a reader in another process, and return the arrays that it returns.

    On Windows, which has no such limits, and where no process can be started, it is called in this
    one.

    Parameters
    ----------
    reader : a function of a module; it gets the path.
    path : of a file.
    seconds : of the processor that it may take.
    memory : that its process may have [bytes].
    without : packages that cannot be imported there, as if they were not installed.

    Raises
    ------
    InvalidInput
        What the reader raises; "file_too_large" and "too_little_memory" beyond the limits; "file_unreadable" where its
        process ended otherwise.
    """
    if sys.platform == "win32" or not sys.executable:
        return reader(path)
    call = [
        sys.executable,
        "-P",
        "-m",
        __name__,
        reader.__module__,
        reader.__name__,
        str(path.absolute()),
    ]
    paths = os.pathsep.join(os.path.abspath(one) for one in sys.path)
    environment = {
        **os.environ,
        "PYTHONPATH": paths,
        "OPENBLAS_NUM_THREADS": "1",
        "OMP_NUM_THREADS": "1",
    }
    try:
        done = subprocess.run(
            [*call, str(seconds), str(memory), *without],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            env=environment,
            timeout=PATIENCE * seconds,
            check=False,
        )
    except OSError:
        return reader(path)
    except subprocess.TimeoutExpired:
        raise _too_long(path, seconds) from None
    if done.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
        raise _too_long(path, seconds)
    if done.returncode != 0:
        sentence = f"{_named(path)} ended its reader with code {done.returncode}: it is damaged; export it anew."
        raise InvalidInput(sentence, code="file_unreadable")
    with np.load(io.BytesIO(done.stdout), allow_pickle=False) as found:
        arrays = dict(found)
    if SENTENCE in arrays:
        raise InvalidInput(str(arrays[SENTENCE]), code=str(arrays[CODE]))
    return arrays


def out_of_memory(name: str) -> InvalidInput:
    """Make the fault of a file whose reader got no more memory."""
    sentence = f"{name} needs more memory than its reader may take (1 process); make it simpler, or export it anew."
    return InvalidInput(sentence, code="too_little_memory")


def _named(path: Path) -> str:
    return f"{path.name} ({path.stat().st_size:,} bytes)"


def _too_long(path: Path, seconds: int) -> InvalidInput:
    sentence = f"{_named(path)} is not read within {seconds} s of processor time; make it simpler, or export it anew."
    return InvalidInput(sentence, code="file_too_large")


def _main(module: str, name: str, file: str, seconds: str, memory: str, *without: str) -> None:
    """Be the other process: read under the limits, and write what was read to the standard output."""
    for package in without:
        sys.modules[package] = None  # pyright: ignore[reportArgumentType]
    answer = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is no part of the answer
    reader = getattr(importlib.import_module(module), name)
    _limit(int(seconds), int(memory))
    try:
        found = reader(Path(file))
    except InvalidInput as fault:
        found = _as_arrays(fault)
    except MemoryError:
        found = _as_arrays(out_of_memory(Path(file).name))
    with answer:
        np.savez(answer, **found)  # pyright: ignore[reportArgumentType]


def _as_arrays(fault: InvalidInput) -> Arrays:
    return {SENTENCE: np.array(str(fault)), CODE: np.array(fault.code)}


def _limit(seconds: int, memory: int) -> None:
    if sys.platform != "win32":
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
        resource.setrlimit(resource.RLIMIT_AS, (memory, memory))


if __name__ == "__main__":
    _main(*sys.argv[1:])
