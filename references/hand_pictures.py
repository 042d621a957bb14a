"""Pictures of our own hands as a camera would take them: a depth buffer, the colour of skin, a lamp."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from airtact.geometry.pose import Pose
from airtact.hands.hand import Hand

WIDTH, HEIGHT, FOCAL = 640, 480, 600.0
"""Size of the pictures and focal length [pixels]."""

SKIN = np.array([0.86, 0.64, 0.52])
LIGHT = np.array([-0.35, -0.6, -0.72])
"""Direction to the lamp, in the camera's frame: above, to the left, behind the camera."""


@dataclass(frozen=True, eq=False)
class Picture:
    """What a camera saw: colours (H, W, 3) of 8 bits, and depth (H, W) [m], infinite where nothing is."""

    colours: np.ndarray
    depth: np.ndarray


def facing(hand: Hand, turn: np.ndarray, place: tuple[float, float, float]) -> Pose:
    """Put a hand before the camera (x right, y down, z forwards), palm towards it, fingers up, then turn it.

    Parameters
    ----------
    hand : any.
    turn : rotation vector in the camera's frame [rad].
    place : of the root of the middle finger [m].
    """
    joints = hand.joints
    up = joints[11] - joints[0]
    across = joints[6] - joints[21]
    out = (
        np.cross(up, across) if hand.side == "left" else np.cross(across, up)
    )  # away from the palm's back
    down, near = -up / np.linalg.norm(up), out / np.linalg.norm(out)
    axes = np.stack(
        [np.cross(down, -near), down, -near]
    )  # rows: the camera's axes in the hand's frame
    rotation = Rotation.from_rotvec(turn).as_matrix() @ axes
    return Pose(rotation, np.array(place) - rotation @ joints[11])


def pictured(hand: Hand, pose: Pose, edge: float = 6e-3, forearm: bool = True) -> Picture:
    """Take a picture of a hand.

    Parameters
    ----------
    hand : any.
    pose : from its frame to the camera's.
    edge : of the triangles that are drawn [m].
    forearm : whether the hand has one.
    """
    skin = hand.shape.skin(edge)
    places, triangles = skin.vertices, skin.triangles
    bent = hand.shape.hulls.look(places).gradient
    if forearm:
        places, bent, triangles = _with_forearm(hand, places, triangles)
    normals, corners = pose.rotate(bent), pose.apply(places)
    depth = np.full((HEIGHT, WIDTH), np.inf)
    facing_us = np.zeros((HEIGHT, WIDTH, 3))
    _draw(corners[triangles], normals[triangles], depth, facing_us)
    return Picture(_lit(depth, facing_us), depth)


def _with_forearm(
    hand: Hand, vertices: np.ndarray, triangles: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Add a forearm, which our hands lack and every hand in MediaPipe's training had: an elliptic cone."""
    wrist, knuckles = hand.joints[0], hand.joints[[6, 21]]
    down = wrist - hand.joints[11]
    down = down / np.linalg.norm(down)
    across = knuckles[0] - knuckles[1]
    across = across - (across @ down) * down
    across = across / np.linalg.norm(across)
    back = np.cross(down, across)
    angle, along = np.meshgrid(np.linspace(0, 2 * np.pi, 33)[:-1], np.linspace(-0.025, 0.2, 24))
    wide, thick = 0.027 + 0.05 * along, 0.0195 + 0.06 * along
    round_it = np.cos(angle)[..., None] * across, np.sin(angle)[..., None] * back
    places = (
        wrist
        + along[..., None] * down
        + wide[..., None] * round_it[0]
        + thick[..., None] * round_it[1]
    )
    out = round_it[0] / wide[..., None] + round_it[1] / thick[..., None]
    rows, columns = np.arange(23)[:, None] * 32, np.arange(32)[None]
    corners = [
        rows + columns,
        rows + (columns + 1) % 32,
        rows + 32 + columns,
        rows + 32 + (columns + 1) % 32,
    ]
    halves = [
        np.stack([corners[a], corners[b], corners[c]], axis=-1).reshape(-1, 3)
        for a, b, c in ((0, 1, 2), (1, 3, 2))
    ]
    normals = np.concatenate([hand.shape.hulls.look(vertices).gradient, out.reshape(-1, 3)])
    return (
        np.concatenate([vertices, places.reshape(-1, 3)]),
        normals / np.linalg.norm(normals, axis=1, keepdims=True),
        np.concatenate([triangles, *(len(vertices) + half for half in halves)]),
    )


def _draw(
    corners: np.ndarray, normals: np.ndarray, depth: np.ndarray, facing_us: np.ndarray
) -> None:
    """Strew points over every triangle, closer together than pixels; in each pixel the nearest one is seen."""
    edges = np.linalg.norm(np.roll(corners, 1, axis=1) - corners, axis=-1).max(axis=1)
    parts = np.ceil(1.6 * FOCAL * edges / corners[:, :, 2].min(axis=1)).astype(int)
    for level in np.unique(parts := 4 * -(-parts // 4)):
        one, two = np.meshgrid(np.arange(level + 1) / level, np.arange(level + 1) / level)
        inside = one + two <= 1.0 + 1e-9
        shares = np.stack([1.0 - one[inside] - two[inside], one[inside], two[inside]])
        chosen = parts == level
        points = np.einsum("sp,tsx->tpx", shares, corners[chosen]).reshape(-1, 3)
        bent = np.einsum("sp,tsx->tpx", shares, normals[chosen]).reshape(-1, 3)
        columns = np.round(FOCAL * points[:, 0] / points[:, 2] + WIDTH / 2).astype(int)
        rows = np.round(FOCAL * points[:, 1] / points[:, 2] + HEIGHT / 2).astype(int)
        seen = (columns >= 0) & (columns < WIDTH) & (rows >= 0) & (rows < HEIGHT)
        points, bent, columns, rows = points[seen], bent[seen], columns[seen], rows[seen]
        far_first = np.argsort(-points[:, 2], kind="stable")
        order = far_first[points[far_first, 2] < depth[rows[far_first], columns[far_first]]]
        depth[rows[order], columns[order]] = points[order, 2]
        facing_us[rows[order], columns[order]] = bent[order]


def _lit(depth: np.ndarray, normals: np.ndarray) -> np.ndarray:
    length = np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-9)
    lamp = LIGHT / np.linalg.norm(LIGHT)
    falling = np.clip(normals / length @ lamp, 0.0, 1.0)[..., None]
    there = np.isfinite(depth)
    flat = np.where(there, depth, 0.0)
    # Creases are darker: a place that is deeper than its surroundings gets less of the sky.
    weight = gaussian_filter(there.astype(float), 6.0) + 1e-9
    crease = np.clip(1.0 - 40.0 * (flat - gaussian_filter(flat, 6.0) / weight), 0.55, 1.1)[
        ..., None
    ]
    red = np.array([1.0, 0.82, 0.74]) ** (1.0 - falling)  # blood shines through where light grazes
    body = SKIN * red * (0.42 + 0.58 * falling) * crease
    rows = np.linspace(0.0, 1.0, HEIGHT)[:, None, None]
    wall = np.broadcast_to((0.5 - 0.15 * rows) * np.array([0.85, 0.95, 1.0]), (HEIGHT, WIDTH, 3))
    picture = np.where(there[..., None], body, wall)
    picture = gaussian_filter(picture, (0.7, 0.7, 0.0))
    return np.clip(255.0 * picture, 0, 255).astype(np.uint8)
