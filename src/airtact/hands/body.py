"""The body of a hand: blended convex hulls of two or three balls each.

Source: A. Tkach, M. Pauly, A. Tagliasacchi, "Sphere-meshes for real-time hand modeling and
tracking", ACM Trans. Graph. 35, 222 (2016). The hull of balls contains every point whose distance
from some point of the balls' simplex is less than the radius interpolated there.
"""

from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64, Real

from airtact import _kernels
from airtact.errors import fixed, in_mm, in_short
from airtact.hands.joints import (
    CHAINS,
    FINGERS,
    GENERIC_LENGTH,
    Joints,
    PerPoint,
    Point,
    Points,
    Radii,
    hand_length,
)

HullPairs = Float64[np.ndarray, "hulls hulls"]


class Look(NamedTuple):
    """Distances of P points from the skin, and the shape of the skin near the points.

    Attributes
    ----------
    distance : (P,) distance from the skin [m], negative inside.
    gradient : (P, 3) gradient of the distance at constant blend radius.
    bend : (P,) radius of curvature of the skin [m].
    facing : (P,) distance [m] from the closest hull that must not merge with the hull nearest to
        the point, such as a hull of another finger.
    nearest : (P,) index of the nearest hull.
    """

    distance: PerPoint
    gradient: Points
    bend: PerPoint
    facing: PerPoint
    nearest: Int64[np.ndarray, "points"]


@dataclass(frozen=True, eq=False)
class Hulls:
    """Convex hulls of balls, and the radii that blend them.

    Two hulls with outward normals n and m are blended by the smooth minimum of their distances,
    with a blend radius of ``blend`` (1 - n·m)/2. Skins that face each other merge if their distance
    is less than half of ``blend``. At a right angle, the blend radius is half of ``blend``. Hulls
    that share a ball join without a bulge.

    Attributes
    ----------
    balls : (B, 4) centre and radius of each ball [m].
    parts : (H, 3) indices of the two or three balls of each hull; the third is -1 for two balls.
    blend : (H, H) blend radius of skins that face each other [m]; 0 for no blending.
    apart : (H, H) 1 for pairs of hulls that stay separate, such as those of two fingers; 0 for
        other pairs.
    """

    balls: Float64[np.ndarray, "balls 4"]
    parts: Int64[np.ndarray, "hulls 3"]
    blend: HullPairs
    apart: HullPairs

    @classmethod
    def unblended(
        cls, balls: Float64[np.ndarray, "balls 4"], parts: Int64[np.ndarray, "hulls 3"]
    ) -> "Hulls":
        """Build hulls that are not blended and may overlap."""
        none = np.zeros((len(parts), len(parts)))
        return cls(balls, parts, none, none)

    def look(
        self, points: Real[np.ndarray, "points 3"], carve: float = 0.0, reach: float = 0.0
    ) -> Look:
        """Return the distances of points (P, 3) [m] from the skin, and the skin's local curvature.

        Hulls that must stay separate are made thinner until they are ``carve`` [m] apart. A hull is
        ignored if its distance exceeds that of the nearest hull by more than ``reach`` [m] plus the
        largest blend radius.
        """
        reach = max(reach, carve, float(self.blend.max()))
        return Look(
            *_kernels.blended_distance(
                points, self.balls, self.parts, self.blend, self.apart, carve, reach
            )
        )

    def each(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points hulls"]:
        """Return the distance (P, H) [m] of points (P, 3) from each hull, without blending."""
        return _kernels.hull_distances(points, self.balls, self.parts)

    def project(self, points: Real[np.ndarray, "points 3"]) -> Points:
        """Project points (P, 3) near the skin onto the skin, along the gradient of the distance."""
        points = np.array(points, dtype=np.float64, order="C")
        _kernels.project_on_hulls(
            points,
            self.balls,
            self.parts,
            self.blend,
            self.apart,
            float(self.blend.max()),
            12,  # maximum number of Newton iterations
            2e-3,  # longest step of an iteration [m]
            1e-9,  # tolerance of the distance from the skin [m]
            0.5e-3,  # range of a bisection if the iteration does not converge [m]
            24,  # number of steps of this bisection
        )
        return points


# Index of the ball in the middle of the thumb's metacarpal, where the web begins.
WEB_BALL = 25


def _parts() -> Int64[np.ndarray, "hulls 3"]:
    phalanges = [(start, end, -1) for chain in CHAINS for start, end in pairwise(chain[1:])]
    palm = [(1, 2, -1), (1, WEB_BALL, 6), (1, 5, 6), (0, 1, 5)]
    for base in (5, 10, 15):
        palm += [(base, base + 1, base + 6), (base, base + 5, base + 6), (0, base, base + 5)]
    parts = np.array([*phalanges, *palm])
    parts.flags.writeable = False
    return parts


# Balls of each hull: first the phalanges of all fingers, then the palm.
PARTS = _parts()

# Number of hulls that are phalanges.
FREE = 14

# Index of the finger of each phalanx.
OWNER = np.array([0, 0, 1, 1, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4])


@dataclass(frozen=True, eq=False)
class Touch:
    """A place where the skins of two parts of a hand touch, and are therefore merged into one skin.

    Only parts that are separate in an open hand are considered. Skins merge if they are less than
    0.3 mm apart or, next to such a place, less than 2 mm apart. ``Hand.touches`` lists all places
    of a hand.

    Attributes
    ----------
    first, second : names of the parts, such as "last phalanx of the thumb" and "palm".
    gap : distance between the skins of the parts before merging, negative if they overlapped [m].
    place : (3,) position midway between the skins, in the frame of the joints [m].
    """

    first: str
    second: str
    gap: float
    place: Point

    __repr__ = in_short

    @property
    def note(self) -> str:
        """A sentence that names the merged parts, and states their position and gap or overlap."""
        apart = "have a gap of" if self.gap > 0.0 else "overlap by"
        return (
            f"the {self.first} and the {self.second} are merged near {in_mm(self.place)}: their "
            f"skins {apart} {1e3 * abs(self.gap):.2g} mm"
        )


def hand_hulls(joints: Joints, radii: Radii) -> tuple[Hulls, tuple[Touch, ...]]:
    """Build the hulls of a hand, and list the parts that merge only because of its pose."""
    scale = hand_length(joints) / GENERIC_LENGTH
    # The blend radii were tuned on the generic hand. The ball of the web is thinner than the thumb.
    thumb = np.append(0.5 * (joints[1] + joints[2]), 0.4 * (radii[1] + radii[2]))
    balls = np.ascontiguousarray(np.vstack([np.column_stack([joints, radii]), thumb]))
    blend = scale * _open_hand_blend()
    apart = blend == 0.0
    np.fill_diagonal(apart, False)
    open_hulls = Hulls(balls, PARTS, blend, apart.astype(np.float64))
    touches = []
    for i, j, gap, place in _joined_skins(open_hulls, apart):
        touches.append(Touch(part_name(i), part_name(j), gap, place))
        # Overlapping skins are blended over a wider radius, by up to 3 mm.
        width = scale * (5e-3 + min(max(-gap, 0.0), 3e-3))
        blend[i, j] = blend[j, i] = max(width, blend[i, j])
        apart[i, j] = apart[j, i] = False
    return Hulls(fixed(balls), PARTS, fixed(blend), fixed(apart.astype(np.float64))), tuple(touches)


def part_name(part: int) -> str:
    """Return the name of the part of the hand to which a hull belongs, such as "palm"."""
    if part >= FREE:
        return "palm"
    finger = FINGERS[OWNER[part]]
    bones = ("first", "last") if finger == "thumb" else ("first", "middle", "last")
    bone = bones[part - int(np.argmax(OWNER[part] == OWNER))]
    return f"{bone} phalanx of the {finger if finger == 'thumb' else f'{finger} finger'}"


@cache
def _open_hand_blend() -> HullPairs:
    """Return a generic hand's blend radii [m] for parts that are connected in every pose."""
    count = len(PARTS)
    blend = np.zeros((count, count))
    balls = [set(part.tolist()) - {-1} for part in PARTS]
    roots = [int(np.argmax(finger == OWNER)) for finger in range(5)]  # first phalanges
    neighbours = [{2, 1, WEB_BALL}, {1, 6, 11}, {6, 11, 16}, {11, 16, 21}, {16, 21}]
    for i in range(count):
        for j in range(i):
            if i >= FREE and j >= FREE:
                blend[i, j] = 8e-3  # within the palm
            elif balls[i] & balls[j]:
                blend[i, j] = 6e-3  # at a joint
            elif j in roots and i >= FREE and balls[i] & neighbours[roots.index(j)]:
                blend[i, j] = 5e-3  # where a finger meets the palm
    for i, j in pairwise(roots[1:]):
        blend[j, i] = 5e-3  # the web between neighbouring fingers
    return fixed(blend + blend.T)


def _joined_skins(
    hulls: Hulls, apart: Bool[np.ndarray, "hulls hulls"]
) -> list[tuple[int, int, float, Point]]:
    """Find phalanges whose skin merges with a separate hull, sorted by the distance of the skins.

    Skins less than 0.3 mm apart merge. Hulls next to such a pair also merge if they are less than
    2 mm apart, because tiny tunnels would otherwise remain between them.
    """
    samples = 25
    starts = hulls.balls[PARTS[:FREE, 0]]
    bones = hulls.balls[PARTS[:FREE, 1]] - starts
    shares = np.linspace(0.0, 1.0, samples)
    spheres = starts[:, None] + shares[:, None] * bones[:, None]
    gaps = hulls.each(spheres[..., :3].reshape(-1, 3)).reshape(FREE, samples, -1)
    gaps -= spheres[..., 3:]
    # The coarse sample overestimates the gap, so candidates may exceed the 2 mm used below by 20 %.
    phalanx, hull = np.nonzero((gaps.min(axis=1) < 1.2 * 2e-3) & apart[:FREE])
    if len(phalanx) == 0:
        return []
    # The nearest sphere along each phalanx is refined on ever finer grids around the best one.
    middle = shares[gaps.argmin(axis=1)[phalanx, hull]]
    width = 1.0 / (samples - 1)
    rows = np.arange(len(phalanx))
    gap = np.zeros(len(phalanx))
    sphere = np.zeros((len(phalanx), 4))
    for _ in range(3):
        share = np.clip(middle[:, None] + width * np.linspace(-1.0, 1.0, 9), 0.0, 1.0)
        spheres = starts[phalanx, None] + share[..., None] * bones[phalanx, None]
        distance = hulls.each(spheres[..., :3].reshape(-1, 3)).reshape(len(phalanx), 9, -1)
        gaps = np.take_along_axis(distance, hull[:, None, None], axis=2)[..., 0] - spheres[..., 3]
        best = gaps.argmin(axis=1)
        middle = share[rows, best]
        gap = gaps[rows, best]
        sphere = spheres[rows, best]
        width /= 4.0
    pairs = np.sort(np.stack([phalanx, hull], axis=1), axis=1)
    near = gap < 0.3e-3
    touching = np.zeros(hulls.blend.shape, dtype=bool)
    touching[tuple(pairs[near].T)] = True
    # In a pair next to a touching pair, each hull belongs to that pair or is connected to it.
    joined = (hulls.blend > 0.0).astype(np.int64) + np.eye(len(PARTS), dtype=np.int64)
    beside = joined @ (touching | touching.T).astype(np.int64) @ joined > 0
    order = np.argsort(gap, kind="stable")
    order = order[(near | (beside[tuple(pairs.T)] & (gap < 2e-3)))[order]]
    # Pairs of phalanges occur twice, once from each side, and the nearer one is kept.
    order = order[np.sort(np.unique(pairs[order], axis=0, return_index=True)[1])]
    joints = []
    for index in order:
        towards = Hulls.unblended(hulls.balls, PARTS[hull[index], None])
        away = towards.look(sphere[index, None, :3]).gradient[0]
        # The position is halfway between the skins, on the shortest line from sphere to hull.
        place = sphere[index, :3] - (sphere[index, 3] + 0.5 * gap[index]) * away
        joints.append((int(pairs[index, 0]), int(pairs[index, 1]), float(gap[index]), place))
    return joints
