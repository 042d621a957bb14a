"""Every shape in a signature is checked while the tests run."""

import gc
import shutil
import signal
from collections.abc import Callable, Iterator
from copy import deepcopy
from importlib import import_module
from pathlib import Path
from typing import Any

import jaxtyping
import matplotlib as mpl
import numpy as np
import pytest
from hypothesis import settings
from jaxtyping import install_import_hook

import checked_types
from paths import GENERIC_HAND

mpl.use("Agg")
gc.disable()  # until all tests are collected, as nearly all that this makes stays
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)  # jobs of a shell ignore it
jaxtyping.jaxtyped = checked_types.jaxtyped
install_import_hook("airtact", "checked_types.check")
settings.register_profile("airtact", deadline=None, derandomize=True, max_examples=40)
settings.load_profile("airtact")

CHROMIUM = (
    shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
)
SOFTWARE = [
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--no-sandbox",
]

_kernels = import_module("airtact._kernels")  # after the hook


def pytest_collection_finish() -> None:
    """Exempt modules and collected tests, which stay to the end, from garbage collection.

    Searching these objects in vain takes more than a second in every worker.
    """
    gc.freeze()
    gc.enable()


@pytest.fixture(params=_kernels.variants())
def variant(request):
    """Run a test with every instruction set that this machine has."""
    best = _kernels.active_variant()
    _kernels.use_variant(request.param)
    yield request.param
    _kernels.use_variant(best)


@pytest.fixture(scope="session", autouse=True)
def _skins_are_meshed_once() -> Iterator[None]:
    """Mesh each pose of a hand once in a process: most tests with a hand read one of the same few scenes.

    Tests of the meshes call ``skin_mesh.even_skin`` itself.
    """
    from airtact.hands import hand, shape, skin_mesh

    known: dict[bytes, Any] = {}

    def even_skin(hulls, edge):
        parts = (hulls.balls, hulls.parts, hulls.blend, hulls.apart, np.array(edge))
        key = b"".join(part.tobytes() for part in parts)
        if key not in known:
            known[key] = skin_mesh.even_skin(hulls, edge)
        return deepcopy(known[key])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(hand, "even_skin", even_skin)
        patch.setattr(shape, "even_skin", even_skin)
        yield


@pytest.fixture(scope="session", autouse=True)
def _bodies_are_searched_once_for_thin_parts() -> Iterator[None]:
    """Search each shape that passes once in a process: most tests read one of the same few scenes."""
    from airtact.geometry import checks

    search = checks.thin_part
    thick: set[tuple[Any, ...]] = set()

    def thin_part(surface):
        key = (type(surface.shape), surface.vertices.tobytes(), surface.triangles.tobytes())
        part = None if key in thick else search(surface)
        if part is None:
            thick.add(key)
        return part

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(checks, "thin_part", thin_part)
        yield


@pytest.fixture
def box() -> Callable[..., Any]:
    import airtact as at
    from geometry.mesh.meshes import box_mesh

    return lambda *corners: at.Surface(*box_mesh(*corners))


@pytest.fixture
def as_outside_the_tests(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shapes are checked by annotations while testing only, so the guards that users meet need them switched off."""
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)


@pytest.fixture
def hand_file() -> Path:
    return GENERIC_HAND


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20140624)


@pytest.fixture(scope="module")
def browser():
    if CHROMIUM is None:
        pytest.skip("no Chromium is installed, so no page is opened.")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=CHROMIUM, args=SOFTWARE)
        yield opened
        opened.close()
