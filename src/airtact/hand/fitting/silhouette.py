"""The outline that a camera saw: beside it the camera looked past the hand, so that no part of it can be there."""

from dataclasses import dataclass
from itertools import combinations
from typing import cast

import numpy as np
from jaxtyping import Bool, Float64, Int32
from scipy import ndimage
from scipy.spatial import KDTree

from airtact.hand.anatomy_parts import PARTS
from airtact.printing import in_short

PIXEL = 1e-3
"""Least side of the squares of an outline, at the distance of the hand [m]."""

SPACING = 1.2
"""Side of the squares over the usual distance of neighbouring points."""

MARGIN = 30e-3
"""How far the outline is known around the hand [m]."""

HOLE = 2e-4
"""Holes of the outline smaller than this are missing points and no free air [m²]."""

SPECK = 0.004
"""Specks smaller than this share of the hand are stray points."""

SPARE, LOOSE = 0.2e-3, 1.0e-3
"""What a hand may stand out of the outline, and the standard deviation of what is more [m]."""

FAR = 12e-3
"""Parts that stand out farther were not seen for other reasons, and count for nothing [m]."""

RIM = 8
"""Points on the rim of each ball that are looked at."""

ANGLES = 2.0 * np.pi * np.arange(RIM) / RIM


def _samples() -> Float64[np.ndarray, "samples 26"]:
    """Weights of the balls at both ends and in the middle of all rods."""
    rods = sorted({pair for part in PARTS.tolist() for pair in combinations(sorted(set(part) - {-1}), 2)})
    rows = np.zeros((26 + len(rods), 26))
    rows[np.arange(26), np.arange(26)] = 1.0
    for row, pair in enumerate(rods):
        rows[26 + row, list(pair)] = 0.5
    return rows


SAMPLES = _samples()
"""Balls that are held against the outline, as weights of the balls of a hand."""


@dataclass(frozen=True, eq=False)
class Outline:
    """How far places beside a hand are from what the camera saw of it.

    Attributes
    ----------
    camera : (3,) [m].
    frame : (3, 3) rows: right and up in the picture, and the line of sight.
    far : distance at which the picture stands [m].
    corner : (2,) of its first square [m].
    pixel : side of its squares [m].
    outside : (W, H) distance of each from the outline, 0 in it [m].
    """

    camera: Float64[np.ndarray, "3"]
    frame: Float64[np.ndarray, "3 3"]
    far: float
    corner: Float64[np.ndarray, "2"]
    pixel: float
    outside: Float64[np.ndarray, "width height"]

    __repr__ = in_short

    def beyond(
        self, balls: Float64[np.ndarray, "balls 4"]
    ) -> tuple[Float64[np.ndarray, "rims"], Float64[np.ndarray, "rims unknowns"], float]:
        """Find how far the rims of a hand's balls stand out of the outline.

        Parameters
        ----------
        balls : (26, 4) centres and radii [m].

        Returns
        -------
        (R,) lengths over their standard deviation, weighted, of those rims that do; (R, 104) their derivatives by the
        balls, weights held fixed; and twice the cost.
        """
        ball = SAMPLES @ balls
        seen = (ball[:, :3] - self.camera) @ self.frame.T
        scale = self.far / seen[:, 2]
        rim = np.column_stack([np.cos(ANGLES), np.sin(ANGLES)])
        flat = scale[:, None] * seen[:, :2]
        places = (flat[:, None] + (scale * ball[:, 3])[:, None, None] * rim).reshape(-1, 2)
        value, slope = self._at(places)
        over = value - SPARE
        out = np.flatnonzero((over > 0.0) & (over < FAR))
        weight = (1.0 - (over[out] / FAR) ** 2) / LOOSE  # Tukey's
        sample, way = out // RIM, rim[out % RIM]
        by_place = slope[out] * (weight * scale[sample])[:, None]
        slopes = np.zeros((len(out), 4))
        fall = -np.einsum("ri,ri->r", by_place, places[out]) / self.far
        slopes[:, :3] = by_place @ self.frame[:2] + fall[:, None] * self.frame[2]
        slopes[:, 3] = np.einsum("ri,ri->r", by_place, way)
        cost = (FAR / LOOSE) ** 2 / 3.0 * float((1.0 - (1.0 - np.clip(over / FAR, 0.0, 1.0) ** 2) ** 3).sum())
        return (
            over[out] * weight,
            (SAMPLES[sample][:, :, None] * slopes[:, None]).reshape(len(out), 4 * SAMPLES.shape[1]),
            cost,
        )

    def _at(
        self, places: Float64[np.ndarray, "places 2"]
    ) -> tuple[Float64[np.ndarray, "places"], Float64[np.ndarray, "places 2"]]:
        """Distance from the outline between the middles of squares, and its slope."""
        cell = (places - self.corner) / self.pixel - 0.5
        cell = np.clip(cell, 0.0, np.array(self.outside.shape) - 1.001)
        low = cell.astype(np.int64)
        s, t = (cell - low).T
        i, j = low.T
        a, b, c, d = (self.outside[i + m, j + n] for m, n in ((0, 0), (1, 0), (0, 1), (1, 1)))
        value = (1 - s) * (1 - t) * a + s * (1 - t) * b + (1 - s) * t * c + s * t * d
        slope = np.column_stack([(1 - t) * (b - a) + t * (d - c), (1 - s) * (c - a) + s * (d - b)])
        return value, slope / self.pixel


def outline(points: Float64[np.ndarray, "points 3"], camera: Float64[np.ndarray, "3"]) -> Outline:
    """Find the outline of a hand in what a camera saw.

    Parameters
    ----------
    points : (N, 3) [m].
    camera : (3,) [m].
    """
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
    return Outline(camera, frame, far, corner, pixel, pixel * np.maximum(outside - 0.5, 0.0))


def _closed(hit: Bool[np.ndarray, "width height"], pixel: float) -> Bool[np.ndarray, "width height"]:
    """Fill the small holes of a picture and leave its specks out."""
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
