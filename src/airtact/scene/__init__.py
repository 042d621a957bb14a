"""What is in the air: media, bodies, sources and targets. No acoustics is solved here."""

from airtact.scene.medium import Medium, air
from airtact.scene.planes import Plane, plane
from airtact.scene.scene import Obstacle, Scene, filled, impedance, sound_hard
from airtact.scene.sources import Monopoles
from airtact.scene.target import Target

__all__ = [
    "Medium",
    "Monopoles",
    "Obstacle",
    "Plane",
    "Scene",
    "Target",
    "air",
    "filled",
    "impedance",
    "plane",
    "sound_hard",
]
