"""The scene file: a TOML text that describes what is in the air, the array and what a person feels."""

from airtact.scene_file.building import Setup, read_scene

__all__ = ["Setup", "read_scene"]
