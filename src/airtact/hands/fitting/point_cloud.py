"""Check the point cloud of a hand, leave out outliers and far points, and average the rest in cells."""

from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float64, Real

from airtact.checks import counted, in_mm, points_of
from airtact.errors import InvalidInput
from airtact.hands.joints import BONES, CHAINS, unit
from airtact.hands.sphere_mesh import Hulls

FEWEST = 200
"""Points that the fit of a hand takes at least."""

LARGEST = 1e6
"""Coordinates beyond this are no positions [m]."""

AROUND = 45e-3
"""Points farther than this from all bones are not of the hand [m]."""

FOREARM = 8e-3, 70e-3
"""The forearm begins so far behind the wrist, and is so wide at most [m]."""

ELSEWHERE = 0.3
"""Share of points elsewhere above which they are another body and no outliers."""

CELL, BESIDE = 4e-3, 3e-3
"""Side of the cubes, and how near the middle point of a cube the points of its mean are [m]."""

SPARSE = 0.2
"""Cubes with fewer points than this share of the usual number hold outliers."""

_LINES = np.array([(*ends, -1) for ends in (*BONES, *pairwise(chain[1] for chain in CHAINS))])


def checked_cloud(
    points: Real[np.ndarray, "points 3"], joints: Float64[np.ndarray, "25 3"]
) -> Float64[np.ndarray, "near 3"]:
    """Return the points of a cloud (N, 3) [m] that lie around the rough joints of a hand (25, 3) [m].

    Raises
    ------
    InvalidInput
        The cloud holds NaN, too few points or none near the hand, is in millimetres, or much of it is of another body.
    """
    cloud = points_of(points, "points of a cloud", least=0)
    if len(cloud) < FEWEST:
        raise InvalidInput(
            f"the cloud has {counted(len(cloud), 'point', 'points')}, but a hand takes at least {FEWEST}: give more of "
            "it.",
            code="too_few",
        )
    widest = int(np.abs(cloud).max(axis=1).argmax())
    if np.abs(cloud[widest]).max() > LARGEST:
        raise InvalidInput(
            f"point {widest} of the cloud has a coordinate of {np.abs(cloud[widest]).max():.3g} m, but hands are seen "
            f"within {LARGEST:g} m: give metres, and leave out what the camera did not see.",
            code="out_of_range",
        )
    apart = _apart(cloud, joints)
    forearm = _forearm(cloud, joints)
    near = (apart < AROUND) & ~forearm
    if near.sum() < FEWEST:
        usual = float(np.median(apart))
        if (_apart(1e-3 * cloud, joints) < AROUND).mean() > 0.5:
            sentence = f"the cloud lies {usual:.4g} m from the landmarks: is it in millimetres? Give metres."
            raise InvalidInput(sentence, code="not_in_metres")
        raise InvalidInput(
            f"{near.sum()} of {len(cloud)} points lie within {1e3 * AROUND:g} mm of the landmarks, half of them "
            f"{1e3 * usual:.4g} mm off: bring both into one frame.",
            code="misplaced",
        )
    other = ~near & ~forearm
    if other.mean() > ELSEWHERE:
        raise InvalidInput(
            f"{other.sum()} of {len(cloud)} points lie more than {1e3 * AROUND:g} mm from the landmarks, half of them "
            f"around {in_mm(np.median(cloud[other], axis=0))}: a second hand or a background? Cut them away.",
            np.median(cloud[other], axis=0),
            code="given_twice",
        )
    return cloud[near]


def cell_means(
    points: Float64[np.ndarray, "points 3"], cell: float = CELL
) -> Float64[np.ndarray, "fewer 3"]:
    """Return the mean of the points (N, 3) in each cube [m]; sparse cubes hold outliers and have none.

    The mean is of the points near the one nearest to the mean of all, so that outliers weigh less.
    """
    cubes = np.floor((points - points.min(axis=0)) / cell).astype(np.int64)
    wide = cubes.max(axis=0) + 1
    keys = (cubes[:, 0] * wide[1] + cubes[:, 1]) * wide[2] + cubes[:, 2]
    _, cube, count = np.unique(keys, return_inverse=True, return_counts=True)
    mean = np.column_stack([np.bincount(cube, column) / count for column in points.T])
    off = np.linalg.norm(points - mean[cube], axis=1)
    order = np.lexsort((off, cube))
    first = order[np.r_[0, np.cumsum(count)[:-1]]]
    close = np.linalg.norm(points - points[first][cube], axis=1) < BESIDE
    many = np.bincount(cube[close], minlength=len(first))
    mean = np.column_stack(
        [np.bincount(cube[close], column, len(first)) / many for column in points[close].T]
    )
    return mean[count >= SPARSE * np.median(count)]


def _apart(
    points: Float64[np.ndarray, "points 3"], joints: Float64[np.ndarray, "25 3"]
) -> Float64[np.ndarray, "points"]:
    """Distance of points from the nearest bone, or line across the palm [m]."""
    balls, none = np.column_stack([joints, np.zeros(25)]), np.zeros((len(_LINES), len(_LINES)))
    return Hulls(balls, _LINES, none, none).look(points).distance


def _forearm(
    points: Float64[np.ndarray, "points 3"], joints: Float64[np.ndarray, "25 3"]
) -> Bool[np.ndarray, "points"]:
    """Whether points lie on the forearm, behind the wrist."""
    along = unit(joints[0] - joints[[6, 11, 16, 21]].mean(axis=0))
    behind = (points - joints[0]) @ along
    beside = np.linalg.norm(points - joints[0] - behind[:, None] * along, axis=1)
    return (behind > FOREARM[0]) & (beside < FOREARM[1])
