"""The bodies of a scene file: built from their tables, named, and merged where asked."""

import math
from collections.abc import Callable, Sequence
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import TypeVar

import numpy as np
from jaxtyping import Float64, Int64

import airtact as at
from airtact.acoustics.medium import Medium
from airtact.acoustics.scene import Obstacle, filled, impedance, sound_hard
from airtact.errors import LARGEST_SCENE_FILE, InvalidInput, about
from airtact.files.bounded import text_of
from airtact.geometry.checks import NEAREST, approach
from airtact.geometry.pose import Pose
from airtact.geometry.surface import Surface
from airtact.setup import tables
from airtact.setup.parsing import parse_scene

Made = TypeVar("Made")

# Named points of bodies, the outward normals there, and the distance to the next body [m]
NamedPoints = dict[str, tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"], float]]

# Vertices (V, 3) [m] and the indices of each triangle (T, 3)
Triangles = tuple[Float64[np.ndarray, "vertices 3"], Int64[np.ndarray, "triangles 3"]]


def built(
    function: Callable[..., Made], table: tables.Table, leave_out: tuple[str, ...] = ()
) -> Made:
    """Call a function with the keys of a table, which are named as its arguments."""
    arguments = {}
    for key in table.__struct_fields__:
        value = getattr(table, key)
        if key not in leave_out and value is not None:
            arguments[key] = np.array(value) if key == "corners" else value
    return function(**arguments)


def bodies_of(
    file: tables.SceneFile, folder: Path, medium: Callable[[tables.MediumTable], Medium]
) -> "tuple[list[str], list[Obstacle], NamedPoints, list[at.Hand]]":
    """Build the bodies of a scene file: names, obstacles, named points and hands.

    Files of surfaces and hands are found in the folder; ``medium`` makes the fluid that fills a
    body.
    """
    obstacles: list[Obstacle] = []
    names: list[str] = []
    points: NamedPoints = {}
    hands: list[at.Hand] = []
    used = tuple(
        focus.points.at for focus in file.foci if isinstance(focus.points, tables.NamedPointTable)
    )
    for index, table in enumerate(file.obstacles):
        with about(f"obstacles[{index}]"):
            of_body: NamedPoints = {}
            for name, surface in _surfaces(table, folder, of_body, used, hands).items():
                obstacles.append(_obstacle(table, surface, medium))
                names.append(f"{name} {index + 1}" if name in names else name)
            for name in used:
                if name in of_body and name in points:
                    raise InvalidInput(
                        f"{name} is a named point of two bodies; give point = [x, y, z] instead of "
                        "at.",
                        code="given_twice",
                    )
            points |= of_body
    _check_places(file, folder, points)
    if file.merge_bodies:
        with about("merge_bodies"):
            names, obstacles = with_merged_bodies(names, obstacles)
    return names, obstacles, points, hands


def pose_of(table: tables.PoseTable) -> Pose:
    """Build the rigid motion of a table."""
    translation = np.array(table.translation)
    match table.rotation:
        case tables.MatrixTable(rotation=rotation):
            return Pose(np.array(rotation), translation)
        case tables.AxisTable(axis=axis, degrees=degrees):
            # Whole turns are taken off in degrees, where they are exact.
            degrees = math.fmod(degrees, 360.0) if math.isfinite(degrees) else degrees
            return Pose.turn(np.array(axis), math.radians(degrees), translation)
    return Pose(np.eye(3), translation)


def _surfaces(
    table: tables.ObstacleTable,
    folder: Path,
    points: NamedPoints,
    used: tuple[str, ...] = (),
    hands: "list[at.Hand] | None" = None,
) -> dict[str, Surface]:
    """Build the surfaces of an obstacle by name at its pose; add its named points and hand."""
    hands = [] if hands is None else hands
    if table.pose is None:
        return _unmoved(table, folder, points, used, hands)
    unmoved_points: NamedPoints = {}
    unmoved_hands: list[at.Hand] = []
    surfaces = _unmoved(table, folder, unmoved_points, used, unmoved_hands)
    with about("pose"):
        pose = pose_of(table.pose)
    for name, (point, normal, room) in unmoved_points.items():
        points[name] = (pose.apply(point), pose.rotate(normal), room)
    hands += [at.Hand(pose.apply(hand.joints), hand.radii, hand.side) for hand in unmoved_hands]
    return {name: surface.moved(pose) for name, surface in surfaces.items()}


def _unmoved(
    table: tables.ObstacleTable,
    folder: Path,
    points: NamedPoints,
    used: tuple[str, ...],
    hands: "list[at.Hand]",
) -> dict[str, Surface]:
    # Only the named points that foci use are brought to the surface, which takes a mesh.
    match table.body:
        case tables.PinchTable(gap=gap):
            fingers = at.pinch(gap=gap)
            for name, pad, normal in zip(
                ("thumb", "finger"), fingers.pads, fingers.normals, strict=True
            ):
                points[f"{name}.pad"] = (pad, normal, fingers.gap)
            return {"thumb": fingers.surfaces[0], "finger": fingers.surfaces[1]}
        case tables.CapsuleTable(start=start, end=end, radius=radius, edge=edge):
            return {"capsule": at.capsule(np.array(start), np.array(end), radius=radius, edge=edge)}
        case tables.SphereTable(radius=radius, centre=centre, edge=edge):
            return {"sphere": at.sphere(radius=radius, edge=edge, centre=np.array(centre))}
        case tables.HandTable(hand=name, gap=gap):
            from airtact.hands.files import ROOM, load_hand

            hand = load_hand(folder / name, gap)
            for place in hand.places:
                # Only wanted places are brought to the surface, which takes a mesh of it.
                point, normal = hand.place(place) if place in used else hand.places[place]
                points[place] = (point, normal, ROOM)
            hands.append(hand)
            return {"hand": hand.surface}
        case tables.SurfaceTable(surface=name):
            surface = built(
                partial(at.load_surface, folder / name), table.body, leave_out=("surface", "joints")
            )
            hand = _hand_of(table.body, folder, used)
            if hand is not None:
                from airtact.hands.files import ROOM

                hands.append(hand)
                for place, (point, normal) in at.hands.places_on(surface, hand).items():
                    points[place] = (point, normal, ROOM)
            return {Path(name).stem: surface}


def _hand_of(table: tables.SurfaceTable, folder: Path, used: tuple[str, ...]) -> "at.Hand | None":
    from airtact.hands.hand import PLACES

    if table.joints is not None:  # they take precedence over a rig in the file
        return at.load_hand(folder / table.joints)
    if not used:
        return None
    path = folder / table.surface
    try:
        return at.hands.load_rigged_hand(path, table.scale or 1.0)
    except InvalidInput as fault:
        if fault.code == "joint_missing" or not set(used) & set(PLACES):
            return None
        if fault.code == "side_unclear":
            raise InvalidInput(
                f"{path.name}: the joints of its rig are too straight to distinguish a left hand "
                "from a right one; "
                'give joints = "FILE.json" with the same joints and the side.',
                code="side_unclear",
            ) from None
        raise


def _check_places(file: tables.SceneFile, folder: Path, points: NamedPoints) -> None:
    """Raise where a focus names a place of a hand, and the meshes have no joints."""
    # A missing point of a hand's mesh is usually a rig without names, which the reason explains.
    meshes = [table.body for table in file.obstacles if isinstance(table.body, tables.SurfaceTable)]
    if not meshes:
        return
    from airtact.hands.hand import PLACES

    for index, focus in enumerate(file.foci):
        if not isinstance(focus.points, tables.NamedPointTable):
            continue
        name = focus.points.at
        if name not in PLACES or name in points:
            continue
        try:
            at.hands.load_rigged_hand(folder / meshes[0].surface, meshes[0].scale or 1.0)
        except InvalidInput as fault:
            reason = str(fault).removesuffix(".")
            raise InvalidInput(
                f'foci[{index}]: at = "{name}" is not a named point here, for {reason}; give the '
                'obstacle joints = "FILE.json", all of them in the frame of the mesh, or the focus '
                "point = [x, y, z].",
                code="joint_missing",
            ) from None


def _obstacle(
    table: tables.ObstacleTable, surface: Surface, medium: Callable[[tables.MediumTable], Medium]
) -> Obstacle:
    match table.boundary:
        case tables.ImpedanceTable(ratio=ratio):
            return impedance(
                surface, complex(*ratio) if isinstance(ratio, tuple) else complex(ratio)
            )
        case tables.FilledTable(medium=inside):
            with about("medium"):
                return filled(surface, medium(inside))
    return sound_hard(surface)


def with_merged_bodies(
    names: Sequence[str], obstacles: Sequence[Obstacle]
) -> tuple[list[str], list[Obstacle]]:
    """Merge sound-hard bodies that overlap, touch or stand nearer than ``NEAREST`` into one.

    The names of merged bodies are joined with " + "; all are in the order of their first.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    # An impedance or a filling belongs to one body, so only sound-hard ones are merged.
    hard = [index for index, obstacle in enumerate(obstacles) if obstacle.boundary == "sound_hard"]
    near = [
        (first, second)
        for first, second in combinations(hard, 2)
        if approach(obstacles[first].surface, obstacles[second].surface, NEAREST * (1.0 - 1e-9))
        is not None
    ]
    first, second = np.array(near, dtype=np.int64).reshape(-1, 2).T
    count = len(obstacles)
    graph = coo_array((np.ones(len(first)), (first, second)), shape=(count, count))
    groups = connected_components(graph, directed=False)[1]
    words = []
    bodies = []
    for group in dict.fromkeys(groups.tolist()):
        members = np.flatnonzero(groups == group).tolist()
        words.append(" + ".join(names[index] for index in members))
        if len(members) == 1:
            bodies.append(obstacles[members[0]])
        else:
            surfaces = [obstacles[index].surface for index in members]
            bodies.append(sound_hard(at.geometry.merged(surfaces, NEAREST)))
    return words, bodies


def drawable_bodies(path: Path) -> list[Triangles]:
    """Return the triangles of the bodies of a faulty scene file, as far as they can be read.

    Raises
    ------
    InvalidInput
        The file itself cannot be read or is not a scene file.
    """
    triangles = []
    for table in parse_scene(text_of(path, LARGEST_SCENE_FILE)).obstacles:
        try:
            surfaces = _surfaces(table, path.parent, {}).values()
            triangles += [(surface.vertices, surface.triangles) for surface in surfaces]
        except InvalidInput:
            if isinstance(table.body, tables.SurfaceTable):
                bare = bare_triangles(path.parent / table.body.surface, table.body.scale or 1.0)
                if bare is not None:
                    triangles.append(bare)
    return triangles


def bare_triangles(path: Path, scale: float = 1.0) -> Triangles | None:
    """Read the triangles of a surface file as they are, scaled to metres.

    None where the file cannot be read or there is nothing to draw.
    """
    try:
        from airtact.files.meshes import read_mesh

        vertices, triangles = read_mesh(path)
    except InvalidInput:
        return None
    # The file is at fault already, so its numbers may be anything.
    with np.errstate(over="ignore"):
        vertices = scale * vertices
    finite = vertices[np.isfinite(vertices).all(axis=1)]
    if len(finite) == 0 or np.ptp(finite, axis=0).max() == 0.0:
        return None
    return vertices, triangles
