"""Silhouette of a hand in a camera image; the fitted hand must not protrude from it."""

from dataclasses import dataclass
from itertools import combinations
from typing import cast

import numpy as np
from jaxtyping import Bool, Float64, Int32
from scipy import ndimage
from scipy.spatial import KDTree

from airtact.hands.body import PARTS
from airtact.hands.joints import Point, Points


def _sample_weights() -> Float64[np.ndarray, "samples 26"]:
    """Return weights of the 26 balls: one row per ball, and one per midpoint between two balls."""
    rods = sorted(
        {pair for part in PARTS.tolist() for pair in combinations(sorted(set(part) - {-1}), 2)}
    )
    middles = np.zeros((len(rods), 26))
    for row, pair in enumerate(rods):
        middles[row, list(pair)] = 0.5
    return np.vstack([np.eye(26), middles])


# Weights of the hand's balls in each ball that is compared with the silhouette.
_SAMPLES = _sample_weights()


@dataclass(frozen=True, eq=False)
class Silhouette:
    """Distance from the silhouette of a hand as a function of the position in an image.

    Attributes
    ----------
    camera : (3,) position of the camera [m].
    frame : (3, 3) unit vectors, one per row: to the right and upward in the image, and along
        the line of sight.
    focal : distance of the image plane from the camera [m].
    corner : (2,) corner of the first pixel [m].
    pixel : width of a pixel [m].
    outside : (W, H) distance of each pixel from the silhouette [m]; 0 inside.
    """

    camera: Point
    frame: Float64[np.ndarray, "3 3"]
    focal: float
    corner: Float64[np.ndarray, "2"]
    pixel: float
    outside: Float64[np.ndarray, "width height"]

    def beyond(
        self, balls: Float64[np.ndarray, "26 4"]
    ) -> tuple[Float64[np.ndarray, "rims"], Float64[np.ndarray, "rims 104"], float]:
        """Compute how far the rims of a hand's balls (26, 4) [m] protrude from the silhouette.

        Only the R rims that protrude are included. The first result (R,) is the weighted distance
        of each rim from the silhouette, divided by the standard deviation. The second (R, 104)
        contains its derivatives with respect to the balls at constant weights. The third is twice
        the cost.
        """
        tolerated = 0.2e-3
        deviation = 1.0e-3  # standard deviation of the protrusion [m]
        # Parts that protrude farther are missing for other reasons and have no weight.
        farthest = 12e-3
        rim_count = 8  # positions on the rim of each ball
        angles = 2.0 * np.pi * np.arange(rim_count) / rim_count
        rim = np.column_stack([np.cos(angles), np.sin(angles)])
        ball = _SAMPLES @ balls
        seen = (ball[:, :3] - self.camera) @ self.frame.T
        scale = self.focal / seen[:, 2]
        flat = scale[:, None] * seen[:, :2]
        positions = (flat[:, None] + (scale * ball[:, 3])[:, None, None] * rim).reshape(-1, 2)
        value, gradient = self._at(positions)
        over = value - tolerated
        out = np.flatnonzero((over > 0.0) & (over < farthest))
        weight = (1.0 - (over[out] / farthest) ** 2) / deviation  # Tukey's weights
        sample = out // rim_count
        by_position = gradient[out] * (weight * scale[sample])[:, None]
        by_ball = np.zeros((len(out), 4))
        by_depth = -np.einsum("ri,ri->r", by_position, positions[out]) / self.focal
        by_ball[:, :3] = by_position @ self.frame[:2] + by_depth[:, None] * self.frame[2]
        by_ball[:, 3] = np.einsum("ri,ri->r", by_position, rim[out % rim_count])
        by_balls = (_SAMPLES[sample][:, :, None] * by_ball[:, None]).reshape(len(out), 104)
        share = np.clip(over / farthest, 0.0, 1.0)
        tukey = float((1.0 - (1.0 - share**2) ** 3).sum())
        return over[out] * weight, by_balls, (farthest / deviation) ** 2 / 3.0 * tukey

    def _at(
        self, positions: Float64[np.ndarray, "positions 2"]
    ) -> tuple[Float64[np.ndarray, "positions"], Float64[np.ndarray, "positions 2"]]:
        """Interpolate the distance from the silhouette, and its gradient, between pixels."""
        cell = (positions - self.corner) / self.pixel - 0.5
        cell = np.clip(cell, 0.0, np.array(self.outside.shape) - 1.001)
        low = cell.astype(np.int64)
        s, t = (cell - low).T
        i, j = low.T
        a = self.outside[i, j]
        b = self.outside[i + 1, j]
        c = self.outside[i, j + 1]
        d = self.outside[i + 1, j + 1]
        value = (1 - s) * (1 - t) * a + s * (1 - t) * b + (1 - s) * t * c + s * t * d
        by_s = (1 - t) * (b - a) + t * (d - c)
        by_t = (1 - s) * (c - a) + s * (d - b)
        return value, np.column_stack([by_s, by_t]) / self.pixel


def silhouette_of(points: Points, camera: Point) -> Silhouette:
    """Find the silhouette of a hand's points (N, 3) as seen from a camera (3,) [m]."""
    sight = np.median(points, axis=0) - camera
    focal = float(np.linalg.norm(sight))
    sight = sight / focal
    right = np.cross(sight, np.eye(3)[np.abs(sight).argmin()])
    right = right / np.linalg.norm(right)
    frame = np.stack([right, np.cross(sight, right), sight])
    seen = (points - camera) @ frame.T
    flat = focal * seen[:, :2] / seen[:, 2:]
    tree = KDTree(flat, balanced_tree=False, compact_nodes=False)  # takes half the time to build
    spacing = float(np.median(tree.query(flat[:: max(len(flat) // 500, 1)], k=2)[0][:, 1]))
    pixel = max(1e-3, 1.2 * spacing)
    margin = 30e-3
    corner = flat.min(axis=0) - margin
    shape = np.ceil((flat.max(axis=0) + margin - corner) / pixel).astype(np.int64) + 1
    hit = np.zeros(tuple(shape.tolist()), dtype=bool)
    hit[tuple(((flat - corner) / pixel).astype(np.int64).T)] = True
    distance = np.asarray(ndimage.distance_transform_edt(~_closed(hit, pixel)))
    outside = pixel * np.maximum(distance - 0.5, 0.0)
    return Silhouette(camera, frame, focal, corner, pixel, outside)


def _closed(
    hit: Bool[np.ndarray, "width height"], pixel: float
) -> Bool[np.ndarray, "width height"]:
    around = ndimage.uniform_filter(hit.astype(np.float64), 3)
    hit = ndimage.binary_closing(hit & (around > 0.4), np.ones((3, 3)))
    parts, count = cast("tuple[Int32[np.ndarray, 'width height'], int]", ndimage.label(hit))
    if count > 1:
        sizes = np.bincount(parts.ravel())
        large = sizes >= 0.004 * sizes[1:].sum()  # smaller specks are outliers
        large[0] = False
        hit = large[parts]
    holes, _ = cast("tuple[Int32[np.ndarray, 'width height'], int]", ndimage.label(~hit))
    # Smaller holes are missing points and not open air [m²].
    small = np.bincount(holes.ravel()) * pixel**2 < 2e-4
    return hit | small[holes]
