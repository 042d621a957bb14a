"""Emissions of the tests give up failed silence after 0.3 s instead of 5 s."""

from functools import partial

import pytest

from airtact.emission.player import Settings


@pytest.fixture(autouse=True)
def short_silencing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("airtact.emission.emission.Settings", partial(Settings, silencing=0.3))
