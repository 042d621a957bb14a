"""A true hand of another shape family than ours: the GLB hand, bent by its own rig and seen by a depth camera."""

import json
import struct
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from airtact.geometry.mesh.curving import curved
from airtact.geometry.mesh.triangles import SHARP_DEGREES, edge_twins
from airtact.geometry.mesh_shape import QuadraticMesh
from airtact.hands.body import OWNER, PARTS
from airtact.hands.hand import Hand
from airtact.hands.joints import CHAINS
from airtact.hands.kinematics import bending_axis
from airtact.setup.examples import example

FILE = example("generic-hand-right.glb")

KINDS = {5121: np.uint8, 5123: np.uint16, 5126: np.float32}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}

FOCAL, PIXELS = 450.0, 320
"""Of the camera: 1 mm of a hand at 0.45 m to a pixel."""

BENDS = {
    "rest": {},
    "pinch": {
        "thumb": (0, 8, 14, 18),
        "index": (0, 48, 42, 22),
        "middle": (0, 22, 22, 12),
        "ring": (0, 16, 18, 10),
    },
    "grip": {
        "thumb": (0, 10, 15, 15),
        **dict.fromkeys(("index", "middle", "ring", "pinky"), (0, 45, 50, 30)),
    },
    "point": {
        "thumb": (0, 5, 20, 20),
        **dict.fromkeys(("middle", "ring", "pinky"), (0, 60, 65, 35)),
    },
    "curl": dict.fromkeys(("index", "middle", "ring", "pinky"), (0, 20, 25, 15)),
}
"""How far the joints of each finger bend, from the metacarpal on [degrees]."""


@dataclass(frozen=True)
class Build:
    """What another person's hand is made of, over that of the file: its palm's length, width and thickness, and each
    finger's length and thickness, thumb first."""

    palm: tuple[float, float, float]
    lengths: tuple[float, float, float, float, float]
    thicknesses: tuple[float, float, float, float, float]


BUILDS = {
    "generic": Build((1.0, 1.0, 1.0), (1.0, 1.0, 1.0, 1.0, 1.0), (1.0, 1.0, 1.0, 1.0, 1.0)),
    "slender": Build(
        (1.02, 0.93, 0.92), (1.04, 1.05, 1.09, 1.1, 1.12), (0.92, 0.9, 0.87, 0.9, 0.86)
    ),
    "stout": Build((0.97, 1.06, 1.08), (0.95, 0.9, 0.94, 0.9, 0.88), (1.03, 1.1, 1.12, 1.08, 1.12)),
}
"""Three true hands; fits were first tuned on the first of them alone."""

HELD_OUT = {
    "child": Build((0.8, 0.84, 0.9), (0.82, 0.78, 0.8, 0.77, 0.8), (0.9, 0.93, 0.91, 0.93, 0.9)),
}
"""A true hand that no fit was tuned on: small, with short thick fingers."""


@dataclass(frozen=True, eq=False)
class Rigged:
    """Vertices (V, 3) and triangles of the skin, each its own place, the joints (25, 3) and which joint bends what."""

    vertices: np.ndarray
    triangles: np.ndarray
    joints: np.ndarray
    weights: np.ndarray


def rest() -> Rigged:
    """Read the hand and its rig from the file (glTF 2.0, Khronos Group, sections 3.6 and 3.7.3)."""
    whole = FILE.read_bytes()
    size = struct.unpack("<I", whole[12:16])[0]
    tree, data = json.loads(whole[20 : 20 + size]), whole[28 + size :]

    def array(index: int) -> np.ndarray:
        accessor = tree["accessors"][index]
        start = tree["bufferViews"][accessor["bufferView"]].get("byteOffset", 0)
        width = WIDTHS[accessor["type"]]
        count = accessor["count"] * width
        return np.frombuffer(data, KINDS[accessor["componentType"]], count, start).reshape(
            -1, width
        )

    primitive, skin = tree["meshes"][0]["primitives"][0], tree["skins"][0]
    vertices = array(primitive["attributes"]["POSITION"]).astype(np.float64)
    triangles = array(primitive["indices"]).reshape(-1, 3).astype(np.int64)
    bound, shares = (
        array(primitive["attributes"]["JOINTS_0"]),
        array(primitive["attributes"]["WEIGHTS_0"]),
    )
    weights = np.zeros((len(vertices), 25))
    np.add.at(weights, (np.arange(len(vertices))[:, None], bound), shares.astype(np.float64))
    inverse = (
        array(skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1).astype(np.float64)
    )
    joints = np.linalg.inv(inverse)[:, :3, 3]
    _, first, same = np.unique(
        np.round(vertices, 7), axis=0, return_index=True, return_inverse=True
    )
    return Rigged(
        vertices[first],
        same[triangles],
        joints,
        weights[first] / weights[first].sum(axis=1, keepdims=True),
    )


def reshaped(hand: Rigged, build: Build) -> Rigged:
    """Scale the bones of a hand at rest along themselves and across, and let the skin follow by its rig."""
    along = hand.joints[11] - hand.joints[0]
    along = along / np.linalg.norm(along)
    back = np.cross(along, hand.joints[6] - hand.joints[21])
    back = back / np.linalg.norm(back)
    frame = np.stack([along, np.cross(back, along), back])
    maps = np.tile(frame.T @ np.diag(build.palm) @ frame, (25, 1, 1))
    places = hand.joints[0] + (hand.joints - hand.joints[0]) @ maps[0].T
    for finger, chain in enumerate(CHAINS):
        length, thickness = build.lengths[finger], build.thicknesses[finger]
        for start, end in pairwise(chain[1:]):
            bone = hand.joints[end] - hand.joints[start]
            way = np.outer(bone, bone) / (bone @ bone)
            maps[start] = maps[end] = length * way + thickness * (np.eye(3) - way)
            places[end] = places[start] + length * bone
    moved = np.einsum("jab,pjb->pja", maps, hand.vertices[:, None] - hand.joints) + places
    return Rigged(
        np.einsum("pj,pja->pa", hand.weights, moved), hand.triangles, places, hand.weights
    )


def bent(hand: Rigged, bends: dict[str, tuple[float, ...]]) -> Rigged:
    """Bend fingers by linear blend skinning."""
    turns = np.tile(np.eye(4), (25, 1, 1))
    for finger, name in enumerate(("thumb", "index", "middle", "ring", "pinky")):
        whole = np.eye(4)
        axis = bending_axis(hand.joints, "right", finger)
        for joint, degrees in zip(CHAINS[finger][:-1], bends.get(name, (0, 0, 0, 0)), strict=False):
            turn = np.eye(4)
            turn[:3, :3] = Rotation.from_rotvec(np.radians(degrees) * axis).as_matrix()
            turn[:3, 3] = hand.joints[joint] - turn[:3, :3] @ hand.joints[joint]
            whole = whole @ turn
            turns[joint] = whole
        turns[CHAINS[finger][-1]] = whole

    def moved(points: np.ndarray, weights: np.ndarray) -> np.ndarray:
        ahead = np.column_stack([points, np.ones(len(points))])
        return np.einsum("pj,jab,pb->pa", weights, turns, ahead)[:, :3]

    joints = moved(hand.joints, np.eye(25))
    return Rigged(moved(hand.vertices, hand.weights), hand.triangles, joints, hand.weights)


def posed(name: str, share: float = 1.0, build: str = "generic") -> Rigged:
    """Take one of the poses of ``BENDS``, or a share of the way to it, of a hand of ``BUILDS`` or ``HELD_OUT``."""
    whole = rest() if build == "generic" else reshaped(rest(), (BUILDS | HELD_OUT)[build])
    return rounded(
        bent(
            whole,
            {finger: tuple(share * x for x in angles) for finger, angles in BENDS[name].items()},
        )
    )


def rounded(hand: Rigged) -> Rigged:
    """Cut each triangle in four, the new corners on the curved skin that solvers use, up to 1 mm off.

    A camera that sees the flat triangles would see another hand than the one that scatters.
    """
    middles, _ = curved(hand.vertices, hand.triangles, SHARP_DEGREES)
    twins = edge_twins(hand.triangles).ravel()
    once, number = np.unique(np.minimum(np.arange(len(twins)), twins), return_inverse=True)
    ends = np.stack([hand.triangles, np.roll(hand.triangles, -1, axis=1)], axis=2).reshape(-1, 2)[
        once
    ]
    (a, b, c), (d, e, f) = hand.triangles.T, len(hand.vertices) + number.reshape(-1, 3).T
    return Rigged(
        np.vstack([hand.vertices, middles.reshape(-1, 3)[once]]),
        np.concatenate(
            [np.stack(corners, axis=1) for corners in ((a, d, f), (d, b, e), (f, e, c), (d, e, f))]
        ),
        hand.joints,
        np.vstack([hand.weights, hand.weights[ends].mean(axis=1)]),
    )


def turned_to_camera(hand: Rigged, seed: int, tilt: float = 35.0, palm: bool = True) -> Rigged:
    """Put a hand 0.45 m before a camera in the origin that looks along z, its palm or back to it, tilted by chance."""
    random = np.random.default_rng(seed)
    up = hand.joints[11] - hand.joints[0]
    up = up / np.linalg.norm(up)
    across = hand.joints[6] - hand.joints[21]
    back = np.cross(up, across) / np.linalg.norm(np.cross(up, across))
    look = back if palm else -back  # the camera looks along z
    frame = np.stack([np.cross(up, look), up, look])
    turn = Rotation.from_rotvec(np.radians(tilt) * random.uniform(-1, 1, 3)).as_matrix() @ frame
    middle = hand.joints.mean(axis=0)
    place = np.array([0.0, 0.0, 0.45]) + random.uniform(-0.02, 0.02, 3)

    def moved(points: np.ndarray) -> np.ndarray:
        return (points - middle) @ turn.T + place

    return Rigged(moved(hand.vertices), hand.triangles, moved(hand.joints), hand.weights)


def depths_seen(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Depth (PIXELS, PIXELS) of the nearest triangle along the ray through each pixel, infinite where there is none."""
    flat = FOCAL * vertices[:, :2] / vertices[:, 2:] + PIXELS / 2
    place, depth = flat[triangles], vertices[triangles, 2]
    low = np.clip(np.ceil(place.min(axis=1)).astype(np.int64), 0, PIXELS)
    wide = np.clip(np.floor(place.max(axis=1)).astype(np.int64) + 1, 0, PIXELS) - low
    count = np.maximum(wide, 0).prod(axis=1)
    one = np.repeat(np.arange(len(triangles)), count)  # each pixel of the box round each triangle
    number = np.arange(len(one)) - np.repeat(np.cumsum(count) - count, count)
    x, y = low[one, 0] + number // wide[one, 1], low[one, 1] + number % wide[one, 1]
    (a, b), (c, d) = (place[one, 1] - place[one, 0]).T, (place[one, 2] - place[one, 0]).T
    determinant = a * d - b * c
    determinant[np.abs(determinant) < 1e-12] = np.inf
    u = ((x - place[one, 0, 0]) * d - (y - place[one, 0, 1]) * c) / determinant
    v = ((y - place[one, 0, 1]) * a - (x - place[one, 0, 0]) * b) / determinant
    inside = (u >= 0) & (v >= 0) & (u + v <= 1) & np.isfinite(determinant)
    far = 1 / ((1 - u - v) / depth[one, 0] + u / depth[one, 1] + v / depth[one, 2])
    image = np.full((PIXELS, PIXELS), np.inf)
    np.minimum.at(image, (x[inside], y[inside]), far[inside])
    return image


def seen(
    hand: Rigged, seed: int, noise: float = 1e-3, outliers: float = 0.1, holes: int = 5
) -> np.ndarray:
    """Points (N, 3) that the camera sees [m]: noise in depth, round holes, and outliers."""
    random = np.random.default_rng(seed)
    image = depths_seen(hand.vertices, hand.triangles)
    x, y = np.nonzero(np.isfinite(image))
    depth = image[x, y] + random.normal(scale=noise, size=len(x))
    rays = np.column_stack([(x - PIXELS / 2) / FOCAL, (y - PIXELS / 2) / FOCAL, np.ones(len(x))])
    points = rays * depth[:, None]
    for centre in points[random.choice(len(points), holes)]:
        points = points[np.linalg.norm(points - centre, axis=1) > random.uniform(4e-3, 8e-3)]
    low, high = points.min(axis=0), points.max(axis=0)
    wide = 0.2 * (high - low)
    return np.vstack(
        [points, random.uniform(low - wide, high + wide, (int(outliers * len(points)), 3))]
    )


def rough(joints: np.ndarray, seed: int, spread: float = 4.7e-3) -> np.ndarray:
    """Landmarks of a tracker that are 7.5 mm off in the mean."""
    return joints + np.random.default_rng(seed).normal(scale=spread, size=joints.shape)


def places_on(vertices: np.ndarray, triangles: np.ndarray, count: int) -> np.ndarray:
    """Places evenly over a skin."""
    random = np.random.default_rng(0)
    corners = vertices[triangles]
    areas = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    chosen = corners[random.choice(len(triangles), count, p=areas / areas.sum())]
    return np.einsum("pc,pci->pi", random.dirichlet(np.ones(3), count), chosen)


def off_each_other(
    hand: Hand, true: Rigged, count: int = 4000
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Distances of places on the true skin from the fitted one, and back [m], and the parts that they are of."""
    skin = hand.shape.skin(5e-3)
    there, back = (
        places_on(true.vertices, true.triangles, count),
        places_on(skin.vertices, skin.triangles, count),
    )
    owner = np.r_[OWNER, np.full(len(PARTS) - len(OWNER), 5)]
    parts = [owner[hand.shape.hulls.look(places).nearest] for places in (there, back)]
    from_true = np.abs(_flat(skin.vertices, skin.triangles).depth(there))
    from_fitted = np.abs(_flat(true.vertices, true.triangles).depth(back))
    return from_true, from_fitted, *parts


def _flat(vertices: np.ndarray, triangles: np.ndarray) -> QuadraticMesh:
    """Triangles that stay flat, unchecked: their ``depth`` is the distance to the triangles."""
    corners = vertices[triangles]
    straight = 0.5 * (corners + np.roll(corners, -1, axis=1))
    smooth = np.zeros(triangles.shape, dtype=bool)
    return QuadraticMesh(vertices, triangles, straight, 0.0, smooth)
