"""Readers that hang, eat memory, crash or say something, to be called in a process of their own."""

import importlib
import os
import signal
from pathlib import Path

import numpy as np

from airtact.errors import InvalidInput


def hangs(path: Path) -> dict:
    while True:
        pass


def eats(path: Path) -> dict:
    held = []
    while True:
        held.append(np.ones(10**6))


def crashes(path: Path) -> dict:
    os.kill(os.getpid(), signal.SIGSEGV)
    return {}


def rejects(path: Path) -> dict:
    raise InvalidInput(f"{path.name} has 1 fault.", code="file_unreadable")


def talks(path: Path) -> dict:
    print("words that are no part of the answer")
    return {"bytes": np.frombuffer(path.read_bytes(), dtype=np.uint8), "pid": np.array(os.getpid())}


def imports(path: Path) -> dict:
    found = []
    for name in ("decimal", "wave"):
        try:
            importlib.import_module(name)
        except ImportError:
            continue
        found.append(name)
    return {"imported": np.array(found)}
