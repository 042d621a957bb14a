"""The bodies of a scene file: built from their tables, named, and merged if requested."""

import math
from collections.abc import Callable, Collection, Sequence
from itertools import combinations
from pathlib import Path
from typing import TypeVar

import numpy as np
from jaxtyping import Float64

import airtact as at
from airtact.acoustics.medium import Medium
from airtact.acoustics.scene import Obstacle, filled, impedance, sound_hard
from airtact.errors import InvalidInput, about
from airtact.geometry.checks import NEAREST, approach
from airtact.geometry.pose import Pose
from airtact.geometry.surface import Surface
from airtact.setup.tables import MediumTable, ObstacleTable, PoseTable, SceneFile, Table

Made = TypeVar("Made")

# Largest distance of a focus from a named position on a hand [m]
ROOM = 0.2

# Named points of bodies, with the outward normal there and the distance to the next body [m]
NamedPoints = dict[str, tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"], float]]


# Surfaces by name, named points, and the hands that are bodies or define named points on them
Bodies = tuple[dict[str, Surface], NamedPoints, "list[at.Hand]"]


def built(function: Callable[..., Made], table: Table, *leave_out: str) -> Made:
    """Call a function with the keys of a table as keyword arguments; lists become arrays."""
    return function(
        **{
            key: np.array(value) if isinstance(value, list | tuple) else value
            for key in table.__struct_fields__
            if key not in leave_out and (value := getattr(table, key)) is not None
        }
    )


def bodies_of(
    file: SceneFile, folder: Path, medium: Callable[[MediumTable], Medium]
) -> "tuple[list[str], list[Obstacle], NamedPoints, dict[str, at.Hand]]":
    """Build the bodies of a scene file.

    Paths of surfaces and hands are relative to ``folder``. ``medium`` is a function that builds the
    fluid inside a body.

    Returns
    -------
    The names of the bodies, the obstacles in the same order, the named points, and a mapping from
    the names of bodies to their hands.
    """
    obstacles: list[Obstacle] = []
    names: list[str] = []
    points: NamedPoints = {}
    hands: dict[str, at.Hand] = {}
    used = {focus.at for focus in file.foci if focus.at is not None}
    several = sum(table.hand is not None for table in file.obstacles) > 1
    for index, table in enumerate(file.obstacles):
        with about(f"obstacles[{index}]"):
            surfaces, places, of_table = _bodies(table, folder, used)
            if several and table.hand is not None:
                surfaces = {f"{of_table[0].side} hand": surfaces["hand"]}
            if table.pose is not None:
                pose = pose_of(table.pose)
                surfaces = {name: surface.moved(pose) for name, surface in surfaces.items()}
                places = {
                    name: (pose.apply(point), pose.rotate(normal), room)
                    for name, (point, normal, room) in places.items()
                }
                of_table = [hand.moved(pose) for hand in of_table]
            for name, surface in surfaces.items():
                if table.ratio is not None:
                    ratio = table.ratio if isinstance(table.ratio, tuple) else (table.ratio,)
                    obstacles.append(impedance(surface, complex(*ratio)))
                elif table.medium is not None:
                    with about("medium"):
                        obstacles.append(filled(surface, medium(table.medium)))
                else:
                    obstacles.append(sound_hard(surface))
                names.append(f"{name} {index + 1}" if name in names else name)
            # A place on a hand has one name such as "palm"; with two hands, also "left.palm".
            side = f"{of_table[0].side}." if of_table else ""
            if side:
                places |= {f"{side}{name}": place for name, place in places.items()}
            for name in used & places.keys() & points.keys():
                advice = "use point = [x, y, z] instead of at."
                if of_table and of_table[0].side in {hand.side for hand in hands.values()}:
                    advice = (
                        f"both are {side[:-1]} hands: is the side of one wrong? Otherwise {advice}"
                    )
                elif side and not name.startswith(side):
                    advice = f'use at = "{side}{name}".'
                raise InvalidInput(
                    f"{name} is a named point on two bodies; {advice}", code="given_twice"
                )
            points |= places
            if of_table:  # such a table defines a single body
                hands[names[-1]] = of_table[0]
    if file.merge_bodies:
        with about("merge_bodies"):
            names, obstacles = _merged(names, obstacles)
    return names, obstacles, points, hands


def unsided(name: str) -> str:
    """Return the name of a point on a hand without the hand's side: "palm" for "left.palm"."""
    return name.removeprefix("left.").removeprefix("right.")


def pose_of(table: PoseTable) -> Pose:
    """Build the pose that a table describes."""
    translation = np.array(table.translation)
    with about("pose"):
        if table.rotation is not None:
            return Pose(np.array(table.rotation), translation)
        if table.axis is None or table.degrees is None:
            return Pose(np.eye(3), translation)
        # Remove whole turns in degrees, because the remainder is exact there.
        angle = math.radians(math.fmod(table.degrees, 360.0))
        return Pose.turn(np.array(table.axis), angle, translation)


def _bodies(table: ObstacleTable, folder: Path, used: set[str]) -> Bodies:
    if table.pinch is not None:
        fingers = at.pinch(table.pinch.gap)
        names = ("thumb", "finger")
        pads = {
            f"{name}.pad": (pad, normal, fingers.gap)
            for name, pad, normal in zip(names, fingers.pads, fingers.normals, strict=True)
        }
        return dict(zip(names, fingers.surfaces, strict=True)), pads, []
    if table.capsule is not None:
        return {"capsule": built(at.capsule, table.capsule)}, {}, []
    if table.sphere is not None:
        return {"sphere": built(at.sphere, table.sphere)}, {}, []
    if table.hand is not None:
        hand = at.load_hand(folder / table.hand, table.gap)
        # Where fingers touch, a place lies inside the body; this only matters if a focus is there.
        places = {
            name: hand.place(name) if {name, f"{hand.side}.{name}"} & used else place
            for name, place in hand.places.items()
        }
        return {"hand": hand.surface}, {name: (*places[name], ROOM) for name in places}, [hand]
    assert table.surface is not None
    settings = {
        key: getattr(table, key)
        for key in ("scale", "largest_hole", "sharp_degrees", "union", "smallest")
        if getattr(table, key) is not None
    }
    surface = at.load_surface(folder / table.surface, **settings)
    surfaces = {Path(table.surface).stem: surface}
    hand = _scanned_hand(table, folder, used)
    if hand is None:
        return surfaces, {}, []
    places = at.hands.places_on(surface, hand)
    return surfaces, {name: (*places[name], ROOM) for name in places}, [hand]


def _scanned_hand(table: ObstacleTable, folder: Path, used: Collection[str]) -> "at.Hand | None":
    # Read the joints of a scanned hand. Return None if it has no joints or no focus needs them.
    if table.joints is not None:  # the key takes precedence over a rig in the file
        return at.load_hand(folder / table.joints)
    if not used:
        return None
    assert table.surface is not None
    try:
        return at.hands.load_rigged_hand(folder / table.surface, table.scale or 1.0)
    except InvalidInput as fault:
        if fault.code == "joint_missing":
            return None
        raise


def _merged(
    names: Sequence[str], obstacles: Sequence[Obstacle]
) -> tuple[list[str], list[Obstacle]]:
    """Merge sound-hard bodies that overlap, touch or are less than ``NEAREST`` [m] apart.

    The names of merged bodies are joined by " + ". Groups are ordered by their first body.
    """
    from scipy.cluster.hierarchy import DisjointSet

    groups = DisjointSet(range(len(obstacles)))
    # An impedance or a medium belongs to a single body, so only sound-hard bodies are merged.
    hard = [index for index, obstacle in enumerate(obstacles) if obstacle.boundary == "sound_hard"]
    for first, second in combinations(hard, 2):
        surfaces = (obstacles[first].surface, obstacles[second].surface)
        if approach(*surfaces, NEAREST * (1.0 - 1e-9)) is not None:
            groups.merge(first, second)
    words = []
    bodies = []
    subsets: list[set[int]] = groups.subsets()
    for members in sorted(sorted(subset) for subset in subsets):
        words.append(" + ".join(names[index] for index in members))
        body = obstacles[members[0]]
        if len(members) > 1:
            surfaces = [obstacles[index].surface for index in members]
            body = sound_hard(at.geometry.merged(surfaces, NEAREST))
        bodies.append(body)
    return words, bodies
