"""The silhouette that a camera saw: beside it the camera looked past the hand, so that no part of the hand is there."""

from dataclasses import dataclass
from itertools import combinations
from typing import cast

import numpy as np
from jaxtyping import Bool, Float64, Int32
from scipy import ndimage
from scipy.spatial import KDTree

from airtact.hands.anatomy_parts import PARTS
from airtact.hands.fitting.unknowns import BALLS

PIXEL = 1e-3
"""Least side of the pixels of a silhouette, at the distance of the hand [m]."""

SPACING = 1.2
"""Side of the pixels over the usual distance of neighbouring points."""

MARGIN = 30e-3
"""How far the silhouette extends around the hand [m]."""

HOLE = 2e-4
"""Smaller holes of the silhouette are missing points and no free air [m²]."""

SPECK = 0.004
"""Specks smaller than this share of the hand are outliers."""

SPARE, LOOSE = 0.2e-3, 1.0e-3
"""Distance that a hand may reach out of the silhouette, and the standard deviation of what is more [m]."""

FAR = 12e-3
"""Parts that reach out farther were not seen for other reasons, and have no weight [m]."""

RIM = 8
"""Points on the rim of each ball that are evaluated."""

ANGLES = 2.0 * np.pi * np.arange(RIM) / RIM


def _samples() -> Float64[np.ndarray, "samples balls"]:
    """Weights of the balls at both ends and in the middle of all rods."""
    rods = sorted(
        {pair for part in PARTS.tolist() for pair in combinations(sorted(set(part) - {-1}), 2)}
    )
    rows = np.vstack([np.eye(BALLS), np.zeros((len(rods), BALLS))])
    for row, pair in enumerate(rods):
        rows[BALLS + row, list(pair)] = 0.5
    return rows


SAMPLES = _samples()
"""Balls that are compared with the silhouette, as weights of the balls of a hand."""


@dataclass(frozen=True, eq=False)
class Silhouette:
    """Distance of positions in a picture from the hand that a camera saw there.

    Attributes
    ----------
    camera : (3,) [m].
    frame : (3, 3) rows: right and up in the picture, and the line of sight.
    far : distance of the picture from the camera [m].
    corner : (2,) of its first pixel [m].
    pixel : side of its pixels [m].
    outside : (W, H) distance of each from the silhouette, 0 in it [m].
    """

    camera: Float64[np.ndarray, "3"]
    frame: Float64[np.ndarray, "3 3"]
    far: float
    corner: Float64[np.ndarray, "2"]
    pixel: float
    outside: Float64[np.ndarray, "width height"]

    def beyond(
        self, balls: Float64[np.ndarray, "balls 4"]
    ) -> tuple[Float64[np.ndarray, "rims"], Float64[np.ndarray, "rims numbers"], float]:
        """Find how far the rims of a hand's balls (26, 4) [m] reach out of the silhouette.

        Returns the distances (R,) of those that do over their standard deviation, weighted; their
        derivatives (R, 104) by the balls, weights held fixed; and twice the cost.
        """
        ball = SAMPLES @ balls
        seen = (ball[:, :3] - self.camera) @ self.frame.T
        scale = self.far / seen[:, 2]
        rim = np.column_stack([np.cos(ANGLES), np.sin(ANGLES)])
        flat = scale[:, None] * seen[:, :2]
        positions = (flat[:, None] + (scale * ball[:, 3])[:, None, None] * rim).reshape(-1, 2)
        value, gradient = self._at(positions)
        over = value - SPARE
        out = np.flatnonzero((over > 0.0) & (over < FAR))
        weight = (1.0 - (over[out] / FAR) ** 2) / LOOSE  # Tukey's
        sample, way = out // RIM, rim[out % RIM]
        by_position = gradient[out] * (weight * scale[sample])[:, None]
        by_ball = np.zeros((len(out), 4))
        fall = -np.einsum("ri,ri->r", by_position, positions[out]) / self.far
        by_ball[:, :3] = by_position @ self.frame[:2] + fall[:, None] * self.frame[2]
        by_ball[:, 3] = np.einsum("ri,ri->r", by_position, way)
        cost = (
            (FAR / LOOSE) ** 2
            / 3.0
            * float((1.0 - (1.0 - np.clip(over / FAR, 0.0, 1.0) ** 2) ** 3).sum())
        )
        by_balls = (SAMPLES[sample][:, :, None] * by_ball[:, None]).reshape(len(out), 4 * BALLS)
        return over[out] * weight, by_balls, cost

    def _at(
        self, positions: Float64[np.ndarray, "positions 2"]
    ) -> tuple[Float64[np.ndarray, "positions"], Float64[np.ndarray, "positions 2"]]:
        """Interpolate the distance from the silhouette between the middles of pixels; also its gradient."""
        cell = (positions - self.corner) / self.pixel - 0.5
        cell = np.clip(cell, 0.0, np.array(self.outside.shape) - 1.001)
        low = cell.astype(np.int64)
        s, t = (cell - low).T
        i, j = low.T
        a, b, c, d = (self.outside[i + m, j + n] for m, n in ((0, 0), (1, 0), (0, 1), (1, 1)))
        value = (1 - s) * (1 - t) * a + s * (1 - t) * b + (1 - s) * t * c + s * t * d
        gradient = np.column_stack(
            [(1 - t) * (b - a) + t * (d - c), (1 - s) * (c - a) + s * (d - b)]
        )
        return value, gradient / self.pixel


def silhouette_of(
    points: Float64[np.ndarray, "points 3"], camera: Float64[np.ndarray, "3"]
) -> Silhouette:
    """Find the silhouette of a hand, points (N, 3) [m], that a camera (3,) [m] saw."""
    sight = np.median(points, axis=0) - camera
    far = float(np.linalg.norm(sight))
    sight = sight / far
    right = np.cross(sight, np.eye(3)[np.abs(sight).argmin()])
    right = right / np.linalg.norm(right)
    frame = np.stack([right, np.cross(sight, right), sight])
    seen = (points - camera) @ frame.T
    flat = far * seen[:, :2] / seen[:, 2:]
    tree = KDTree(flat, balanced_tree=False, compact_nodes=False)  # made in half the time
    spacing = float(np.median(tree.query(flat[:: max(len(flat) // 500, 1)], k=2)[0][:, 1]))
    pixel = max(PIXEL, SPACING * spacing)
    corner = flat.min(axis=0) - MARGIN
    shape = np.ceil((flat.max(axis=0) + MARGIN - corner) / pixel).astype(np.int64) + 1
    hit = np.zeros(tuple(shape.tolist()), dtype=bool)
    hit[tuple(((flat - corner) / pixel).astype(np.int64).T)] = True
    outside = np.asarray(ndimage.distance_transform_edt(~_closed(hit, pixel)))
    return Silhouette(camera, frame, far, corner, pixel, pixel * np.maximum(outside - 0.5, 0.0))


def _closed(
    hit: Bool[np.ndarray, "width height"], pixel: float
) -> Bool[np.ndarray, "width height"]:
    """Fill the small holes of a picture and remove its specks."""
    around = ndimage.uniform_filter(hit.astype(np.float64), 3)
    hit = ndimage.binary_closing(hit & (around > 0.4), np.ones((3, 3)))
    parts, count = cast("tuple[Int32[np.ndarray, 'width height'], int]", ndimage.label(hit))
    if count > 1:
        sizes = np.bincount(parts.ravel())
        large = sizes >= SPECK * sizes[1:].sum()
        large[0] = False
        hit = large[parts]
    holes, _ = cast("tuple[Int32[np.ndarray, 'width height'], int]", ndimage.label(~hit))
    small = np.bincount(holes.ravel()) * pixel**2 < HOLE
    return hit | small[holes]
