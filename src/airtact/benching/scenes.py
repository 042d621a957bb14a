"""The timed scenes: two fingers in many poses, with a focus in front of each."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Real

from airtact.acoustics.medium import Medium
from airtact.acoustics.scene import Scene, sound_hard
from airtact.acoustics.target import Target
from airtact.geometry.pose import Pose
from airtact.geometry.primitives import Capsule, capsule
from airtact.geometry.surface import Surface
from airtact.printing import in_short

AIR = Medium(sound_speed=343.1, density=1.293)
"""The paper's air."""

FREQUENCY = 40e3
OFFSET = 0.5e-3
"""Distance of each focus off its pad [m]."""


@dataclass(frozen=True, eq=False)
class Bodies:
    """The surfaces of bodies, and foci (F, 3) beside them [m]."""

    surfaces: tuple[Surface, ...]
    foci: Float64[np.ndarray, "foci 3"]

    __repr__ = in_short

    @property
    def scene(self) -> Scene:
        """The bodies, sound-hard, in the paper's air."""
        return Scene(AIR, [sound_hard(surface) for surface in self.surfaces], frequency=FREQUENCY)

    @property
    def target(self) -> Target:
        """The foci, as strong as possible."""
        return Target(self.foci)

    @property
    def capsules(self) -> list[Capsule]:
        """The bodies' exact shapes, where all of them are capsules."""
        return [
            surface.primitive for surface in self.surfaces if isinstance(surface.primitive, Capsule)
        ]


def two_fingers(
    gap: float = 12e-3,
    tilt: float = 20.0,
    radius: float = 8e-3,
    length: float = 44e-3,
    lift: float = 0.0,
) -> Bodies:
    """Two capsules whose tips face each other, hanging down and leaning outward, a focus in front of each pad.

    By default they are 16 mm thick, 60 mm long and 12 mm apart. Gap, radius, length of the axis and
    ``lift`` of the second above the first are in metres, ``tilt`` in degrees.
    """
    surfaces, tips = [], []
    lean = np.radians(tilt)
    for side in (-1.0, 1.0):
        tip = np.array([side * (0.5 * gap + radius), 0.0, 0.5 * (1.0 + side) * lift])
        root = tip + length * np.array([side * np.sin(lean), 0.0, -np.cos(lean)])
        surfaces.append(capsule(tuple(tip), tuple(root), radius, edge=radius / 2))
        tips.append(tip)
    across = (tips[1] - tips[0]) / np.linalg.norm(tips[1] - tips[0])
    foci = np.array([tips[0] + (radius + OFFSET) * across, tips[1] - (radius + OFFSET) * across])
    return Bodies(tuple(surfaces), foci)


def deformed(frame: int) -> Bodies:
    """Two fingers that are different bodies at every frame: thickness, length, lean, gap and height all change."""
    beat = np.sin(0.9 * frame + np.arange(5.0)) - np.sin(np.arange(5.0))
    return two_fingers(
        gap=12e-3 + 1.5e-3 * beat[0],
        tilt=20.0 + 5.0 * beat[1],
        radius=8e-3 + 0.1e-3 * beat[2],
        length=44e-3 + 0.3e-3 * beat[3],
        lift=1e-3 * beat[4],
    )


def moved_each(rest: Bodies, frame: int) -> Bodies:
    """Move each of two bodies rigidly, its focus with it, by a few millimetres and degrees."""
    beat = np.sin(0.9 * frame + np.arange(6.0)) - np.sin(np.arange(6.0))
    moved, foci = [], []
    for side, surface, focus in zip((-1.0, 1.0), rest.surfaces, rest.foci, strict=True):
        pose = rotated_about(
            focus, np.radians(4.0) * beat[:3] * side, 0.6e-3 * (side + 0.5) * beat[3:]
        )
        moved.append(surface.moved(pose))
        foci.append(pose.apply(focus[None])[0])
    return Bodies(tuple(moved), np.array(foci))


def whole_motion(frame: int) -> Pose:
    """Move a hand as a whole: 20 degrees and 10 mm about."""
    beat = np.sin(0.7 * frame + np.arange(6.0)) - np.sin(np.arange(6.0))
    return rotated_about(
        np.zeros(3), np.radians(20.0) * beat[:3] / np.sqrt(3.0), 10e-3 * beat[3:] / np.sqrt(3.0)
    )


def rotated_about(
    centre: Real[np.ndarray, "3"], turn: Real[np.ndarray, "3"], shift: Real[np.ndarray, "3"]
) -> Pose:
    """Rotate about a centre [m] by a rotation vector [rad], then shift [m]."""
    angle = float(np.linalg.norm(turn))
    if angle == 0.0:
        return Pose(np.eye(3), np.asarray(shift, dtype=np.float64))
    rotation = Pose.turn(turn / angle, angle).rotation
    return Pose(rotation, centre - rotation @ centre + shift)


def moved_foci(bodies: Bodies, frame: int) -> Bodies:
    """Give the same bodies other foci: each before its finger, some millimetres to the side and off its surface."""
    beat = np.sin(1.3 * frame + np.arange(6.0)).reshape(2, 3)
    foci = (
        bodies.foci
        + 1.5e-3 * beat * np.array([0.0, 1.0, 1.0])
        + np.array([[1.0], [-1.0]]) * [1e-3, 0.0, 0.0]
    )
    return Bodies(bodies.surfaces, foci)
