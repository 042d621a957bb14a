"""Build the body of a hand from joints and radii: its hulls of balls, and which of them are one or stand apart."""

from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float64, Int64

from airtact.checks import fixed, in_mm
from airtact.hands.joints import CHAINS, FINGERS, LENGTH, hand_length
from airtact.hands.sphere_mesh import Hulls
from airtact.printing import in_short

MERGED = 0.3e-3
"""Skins nearer than this are one [m]."""

PALM, JOINT, BASE, WEB, TOUCH = 8e-3, 6e-3, 5e-3, 5e-3, 5e-3
"""Blend radii of a hand of usual length: in the palm, at joints, where fingers meet the palm, between the roots of
neighbouring fingers, and where skins touch [m]."""

DEEPER = 3e-3
"""Where skins overlap, the blend radius is larger by the overlap, up to this [m]."""

BESIDE = 2e-3
"""Beside parts that touch, their neighbours are one where nearer than this [m]; otherwise tiny tunnels are left."""

ROOTS = ((2, 3), (6, 7), (11, 12), (16, 17), (21, 22))
"""First phalanges."""

WEB_BALL = 25
"""The ball in the middle of the thumb's metacarpal, from which skin spans to the index finger's knuckle."""

SAMPLES = 25
"""Points along a bone where its distance to others is evaluated first."""


def _parts() -> tuple[tuple[int, int, int], ...]:
    free = [(start, end, -1) for chain in CHAINS for start, end in pairwise(chain[1:])]
    palm = [(1, 2, -1), (1, WEB_BALL, 6), (1, 5, 6), (0, 1, 5)]
    for base in (5, 10, 15):
        palm += [(base, base + 1, base + 6), (base, base + 5, base + 6), (0, base, base + 5)]
    return (*free, *palm)


PARTS = np.array(_parts())
"""Balls of each hull: the phalanges of all fingers, then what makes the palm."""
PARTS.flags.writeable = False

FREE = 14
"""How many of them are phalanges."""

OWNER = np.array(
    [FINGERS.index(finger) for finger in FINGERS for _ in range(2 if finger == "thumb" else 3)]
)
"""Finger of each phalanx."""


@dataclass(frozen=True, eq=False)
class Touch:
    """A position where two parts of a hand are so near that their skins are one.

    Attributes
    ----------
    one, other : names of the parts.
    gap : of their skins, negative where they overlap [m].
    place : (3,) between them [m].
    """

    one: str
    other: str
    gap: float
    place: Float64[np.ndarray, "3"]

    __repr__ = in_short

    @property
    def note(self) -> str:
        """One sentence: which parts are one, where, and how far their skins are apart or in each other."""
        apart = (
            f"{1e3 * self.gap:.2g} mm apart"
            if self.gap > 0.0
            else f"{-1e3 * self.gap:.2g} mm in each other"
        )
        return f"the {self.one} and the {self.other} are one near {in_mm(self.place)}, their skins being {apart}"


def hand_hulls(
    joints: Float64[np.ndarray, "25 3"], radii: Float64[np.ndarray, "25"]
) -> tuple[Hulls, tuple[Touch, ...]]:
    """Build the body of a hand, and find where parts that stand apart in an open hand are one here."""
    scale = hand_length(joints) / LENGTH
    thumb = np.append(0.5 * (joints[1] + joints[2]), 0.4 * (radii[1] + radii[2]))
    balls = np.ascontiguousarray(np.vstack([np.column_stack([joints, radii]), thumb]))
    blend = scale * _open_hand()
    apart = blend == 0.0
    np.fill_diagonal(apart, False)
    open_hulls = Hulls(balls, PARTS, blend, apart.astype(np.float64))
    pairs, gaps, positions = _near(open_hulls, apart)
    for (one, other), gap in zip(pairs, gaps, strict=True):
        width = scale * (TOUCH + min(max(-float(gap), 0.0), DEEPER))
        blend[one, other] = blend[other, one] = max(width, blend[one, other])
        apart[one, other] = apart[other, one] = False
    touches = tuple(
        Touch(part_name(int(one)), part_name(int(other)), float(gap), position)
        for (one, other), gap, position in zip(pairs, gaps, positions, strict=True)
    )
    return Hulls(fixed(balls), PARTS, fixed(blend), fixed(apart.astype(np.float64))), touches


def part_name(part: int) -> str:
    """Name the part of the hand that a hull is."""
    if part >= FREE:
        return "palm"
    finger = FINGERS[OWNER[part]]
    first = int(np.flatnonzero(OWNER[part] == OWNER)[0])
    bones = ("first", "last") if finger == "thumb" else ("first", "middle", "last")
    return f"{bones[part - first]} phalanx of the {finger}{'' if finger == 'thumb' else ' finger'}"


@cache
def _open_hand() -> Float64[np.ndarray, "hulls hulls"]:
    """Return the blend radii between the parts that are one in every pose."""
    count = len(PARTS)
    blend = np.zeros((count, count))
    balls = [set(part.tolist()) - {-1} for part in PARTS]
    roots = [next(i for i in range(FREE) if tuple(PARTS[i, :2]) == root) for root in ROOTS]
    beside = [{2, 1, WEB_BALL}, {1, 6, 11}, {6, 11, 16}, {11, 16, 21}, {16, 21}]
    for i in range(count):
        for j in range(i):
            if i >= FREE and j >= FREE:
                blend[i, j] = PALM
            elif balls[i] & balls[j]:
                blend[i, j] = JOINT
            elif j in roots and i >= FREE and balls[i] & beside[roots.index(j)]:
                blend[i, j] = BASE
    for one, other in pairwise(roots[1:]):
        blend[other, one] = WEB
    return fixed(blend + blend.T)


def _near(
    hulls: Hulls, apart: Bool[np.ndarray, "hulls hulls"]
) -> tuple[
    Int64[np.ndarray, "touches 2"], Float64[np.ndarray, "touches"], Float64[np.ndarray, "touches 3"]
]:
    """Find hulls nearer than ``MERGED``, or ``BESIDE`` others that are: pairs, gaps, and the positions between."""
    starts, ends = hulls.balls[PARTS[:FREE, 0]], hulls.balls[PARTS[:FREE, 1]]
    shares = np.linspace(0.0, 1.0, SAMPLES)
    spheres = starts[:, None] + shares[:, None] * (ends - starts)[:, None]
    gaps = hulls.each(spheres[..., :3].reshape(-1, 3)).reshape(FREE, SAMPLES, -1) - spheres[..., 3:]
    best = gaps.argmin(axis=1)
    one, other = np.nonzero((gaps.min(axis=1) < 1.2 * BESIDE) & apart[:FREE])
    if len(one) == 0:
        return np.zeros((0, 2), dtype=np.int64), np.zeros(0), np.zeros((0, 3))
    middle, width, rows = shares[best[one, other]], 1.0 / (SAMPLES - 1), np.arange(len(one))
    gap, sphere = np.zeros(len(one)), np.zeros((len(one), 4))
    for _ in range(3):
        tried = middle[:, None] + width * np.linspace(-1.0, 1.0, 9)
        tried = np.clip(tried, 0.0, 1.0)
        found = starts[one, None] + tried[..., None] * (ends - starts)[one, None]
        distance = hulls.each(found[..., :3].reshape(-1, 3)).reshape(len(one), 9, -1)
        gaps = np.take_along_axis(distance, other[:, None, None], axis=2)[..., 0] - found[..., 3]
        pick = gaps.argmin(axis=1)
        middle, width, gap, sphere = (
            tried[rows, pick],
            width / 4.0,
            gaps[rows, pick],
            found[rows, pick],
        )
    one_of, other_of = np.minimum(one, other), np.maximum(one, other)
    touching = np.zeros(hulls.blend.shape, dtype=bool)
    touching[one_of[gap < MERGED], other_of[gap < MERGED]] = True
    joined = (hulls.blend > 0.0).astype(np.int64) + np.eye(len(PARTS), dtype=np.int64)
    beside = joined @ (touching | touching.T).astype(np.int64) @ joined > 0
    pairs, order = np.stack([one_of, other_of], axis=1), np.argsort(gap, kind="stable")
    order = order[(gap < MERGED)[order] | (beside[one_of, other_of] & (gap < BESIDE))[order]]
    order = order[np.sort(np.unique(pairs[order], axis=0, return_index=True)[1])]
    zero, positions = np.zeros((1, 1)), np.empty((len(order), 3))
    for row, index in enumerate(order):
        alone = Hulls(hulls.balls, PARTS[other[index], None], zero, zero)
        away = alone.look(sphere[index, None, :3]).gradient[0]
        positions[row] = sphere[index, :3] - (sphere[index, 3] + 0.5 * gap[index]) * away
    return pairs[order], gap[order], positions
