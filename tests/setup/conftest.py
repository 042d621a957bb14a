"""Scenes that are read from their text."""

import pytest

import airtact as at


@pytest.fixture
def read(tmp_path):

    def reader(*parts: str) -> at.Setup:
        path = tmp_path / "scene.toml"
        path.write_text("".join(parts), encoding="utf-8")
        return at.read_scene(path)

    return reader
