"""What several tests of the scene need."""

from collections.abc import Callable
from pathlib import Path

import jaxtyping
import numpy as np
import pytest
from hypothesis import settings
from meshes import box_mesh

from airtact.scene.geometry import Surface

settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")

HAND = Path(__file__).parents[2] / "examples" / "hands" / "generic-hand-right.glb"


@pytest.fixture
def box() -> Callable[..., Surface]:
    return lambda *corners: Surface(*box_mesh(*corners))


@pytest.fixture
def as_outside_the_tests(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shapes are checked by annotations while testing only, so the guards that users meet need them switched off."""
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)


@pytest.fixture
def hand_file() -> Path:
    return HAND


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20140624)
