"""Flat, even triangles on the bodies for other packages, moved outward until they enclose the exact volume."""

import numpy as np
from jaxtyping import Float64, Int64

from airtact.benching.scenes import Bodies
from airtact.hand.skin_mesh import even_skin
from airtact.hand.sphere_mesh import Hulls
from airtact.mesh.topology import cone_volumes
from airtact.surfaces.primitives import Capsule

INSIDE = 0.25, 0.8
"""Depth of the points inside, as fractions of the radius."""


def flat_triangles(bodies: Bodies, edge: float) -> tuple[Float64[np.ndarray, "vertices 3"], Int64[np.ndarray, "t 3"]]:
    """Cover capsules with even flat triangles of a given edge [m], closed, outward."""
    capsules = bodies.capsules
    balls = np.array([[*end, capsule.radius] for capsule in capsules for end in capsule.axis])
    parts = np.array([[2 * index, 2 * index + 1, -1] for index in range(len(capsules))])
    count = len(capsules)
    skin = even_skin(Hulls(balls, parts, np.zeros((count, count)), 1.0 - np.eye(count)), edge)
    vertices, triangles = np.array(skin.vertices), skin.triangles.astype(np.int64)
    owner = np.argmax([capsule.depth(vertices) for capsule in capsules], axis=0)
    for index, capsule in enumerate(capsules):
        own = triangles[owner[triangles[:, 0]] == index]
        axis = nearest_on_axis(capsule, vertices)
        out, stretch = vertices - axis, 1.0
        for _ in range(20):
            held = float(cone_volumes((axis + stretch * out)[own]).sum())
            stretch *= (capsule.volume / held) ** 0.4  # the volume grows between the first and the third power
        vertices[owner == index] = (axis + stretch * out)[owner == index]
    return vertices, triangles


def nearest_on_axis(capsule: Capsule, points: Float64[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points 3"]:
    """Find the point of a capsule's axis that is nearest to each point (P, 3) [m]."""
    start, along = capsule.axis[0], capsule.axis[1] - capsule.axis[0]
    share = np.clip((points - start) @ along / max(float(along @ along), 1e-30), 0.0, 1.0)
    return start + share[:, None] * along


def points_inside(bodies: Bodies, count: int, seed: int = 0) -> Float64[np.ndarray, "points 3"]:
    """Choose points inside capsules at random, ``count`` in each, for CHIEF."""
    pick, found = np.random.default_rng(seed), []
    for capsule in bodies.capsules:
        reach = 0.5 * capsule.extent
        some = capsule.axis.mean(axis=0) + pick.uniform(-reach, reach, size=(400 * count, 3))
        depth = capsule.depth(some) / capsule.radius
        found.append(some[(INSIDE[0] < depth) & (depth < INSIDE[1])][:count])
    return np.concatenate(found)
