"""Hands that are wrong in one way by a known amount."""

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from airtact import _kernels
from airtact.geometry.surface import Surface
from airtact.hands.hand import Hand
from airtact.hands.joints import CHAINS
from airtact.hands.skin_mesh import even_skin

TURNED = 3
"""Joints of each finger that are turned, from its root on."""

FINEST, PASSES = 6e-3, 8
"""Edge of the triangles that coarser ones are made from [m], in so many passes."""


def random_direction(seed: int) -> Float64[np.ndarray, "3"]:
    """Choose a direction (3,) uniformly on the sphere.

    Parameters
    ----------
    seed : of the choice.
    """
    vector = np.random.default_rng(seed).normal(size=3)
    return vector / np.linalg.norm(vector)


def bent(hand: Hand, size: float, seed: int) -> Hand:
    """Turn the joints of all fingers by chance, bones keeping their lengths.

    Parameters
    ----------
    hand : right.
    size : root mean square distance by which the five tips are elsewhere afterwards [m].
    seed : of the choice.
    """
    turns = np.random.default_rng(seed).normal(size=(len(CHAINS), TURNED, 3))
    tips = [chain[-1] for chain in CHAINS]
    scale = 0.0 if size == 0.0 else 1e-3
    for _ in range(6 if size else 0):  # nearly proportional: a few steps find it
        away = np.linalg.norm(_turned(hand, scale * turns)[tips] - hand.joints[tips], axis=1)
        scale *= size / float(np.sqrt(np.mean(away**2)))
    return Hand(_turned(hand, scale * turns), hand.radii, hand.side)


def _turned(
    hand: Hand, turns: Float64[np.ndarray, "fingers turned 3"]
) -> Float64[np.ndarray, "25 3"]:
    joints = hand.joints.copy()
    for chain, finger in zip(CHAINS, turns, strict=True):
        first = len(chain) - 1 - TURNED
        for joint, turn in enumerate(finger, start=first):
            outer = list(chain[joint + 1 :])
            root = joints[chain[joint]]
            joints[outer] = root + Rotation.from_rotvec(turn).apply(joints[outer] - root)
    return joints


def random_radii(hand: Hand, share: float, seed: int) -> Hand:
    """Make the radius of every joint wrong by chance.

    Parameters
    ----------
    hand : right.
    share : root mean square error over the radii.
    seed : of the choice.
    """
    errors = np.random.default_rng(seed).normal(size=len(hand.radii))
    errors *= share / np.sqrt(np.mean(errors**2))
    return Hand(hand.joints, hand.radii * np.exp(errors), hand.side)


def scaled_radii(hand: Hand, share: float) -> Hand:
    """Make all radii too large or too small.

    Parameters
    ----------
    hand : right.
    share : by how much of the radius, negative for too small.
    """
    return Hand(hand.joints, hand.radii * (1.0 + share), hand.side)


def hand_of_triangles(hand: Hand, edge: float) -> Surface:
    """Mesh a hand with triangles of one size whose corners alone lie on it, as a file has them.

    Parameters
    ----------
    hand : right.
    edge : of the triangles [m], however much the skin bends.
    """
    hulls = hand.shape.hulls
    skin = even_skin(hulls, min(edge, FINEST))
    vertices, triangles = skin.vertices, skin.triangles
    for _ in range(PASSES):
        most = 2 * len(vertices)
        counts = np.array([len(vertices), len(triangles)])
        vertices = np.concatenate([vertices, np.zeros((most - counts[0], 3))])
        triangles = np.concatenate([triangles, np.zeros((2 * most - counts[1], 3), dtype=np.int64)])
        _kernels.even_pass(vertices, np.full(most, edge), triangles, counts, False, 1.0, 0.5)
        vertices, triangles = hulls.project(vertices[: counts[0]]), triangles[: counts[1]].copy()
    return Surface(vertices, triangles)
