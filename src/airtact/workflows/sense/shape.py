"""The capsules of a scene file whose ends and radii are found from echoes, and the foci that they carry."""

from dataclasses import replace

import numpy as np

from airtact.acoustics.scene import Scene
from airtact.acoustics.target import Target
from airtact.geometry.pose import Pose
from airtact.sensing.registration import Located
from airtact.sensing.shapes.fit import LocatedShape
from airtact.sensing.shapes.unknown import UnknownShape, carried_by_capsules
from airtact.setup.building import Setup

SIMULATED = 0.3
"""How far simulated ends and radii are off, at random, over the standard deviations of what is expected."""


def unknown_shape(setup: Setup) -> UnknownShape:
    """Take the ends and radii of the scene file's capsules as unknown; raise "wrong_kind" where a body is none."""
    return UnknownShape.of_capsules(setup.scene)


def reshaped(setup: Setup, unknown: UnknownShape, seed: int) -> Setup:
    """Return a hand whose shape is off what the scene file says, at random."""
    off = np.random.default_rng([seed, 2]).normal(size=len(unknown.expected))
    return with_bodies(
        setup, unknown.scene_of(unknown.expected + SIMULATED * off * unknown.deviations)
    )


def with_bodies(setup: Setup, scene: Scene) -> Setup:
    """Return the scene file with other capsules, which carry its foci."""
    target = setup.target
    points, suppressed = (
        carried_by_capsules(some, setup.scene, scene)
        for some in (target.points, target.suppression_points)
    )
    given = (
        {}
        if target.shares is None
        else {"shares": target.wanted if target.phases is not None else target.shares}
    )
    if target.pressures is not None:
        given = {"pressures": target.wanted if target.phases is not None else target.pressures}
    return replace(
        setup, scene=scene, target=Target(points, **given, suppression_points=suppressed)
    )


def surface_off(located: Located, true: Scene, true_pose: Pose) -> float | None:
    """Distance of the true surfaces from those that were found, rms [m]; None where only a pose was."""
    if not isinstance(located, LocatedShape):
        return None
    points = true_pose.apply(np.concatenate([one.surface.vertices for one in true.obstacles]))
    return float(np.sqrt(np.mean(located.scene.depth(located.pose.inverse().apply(points)) ** 2)))
