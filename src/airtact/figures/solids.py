"""Lit triangles and lines on them, in axes in space."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from airtact.figures.space_axes import View
from airtact.mesh.quadratic_triangles import cut, with_middles

MOST_PARTS = 40
"""Parts into which an edge is cut at most."""

INSIDE = np.array([0.91, 0.45, 0.16, 1.0])
"""Colour of the backs of triangles, which one sees where a surface is open or turned."""


OVERLAP = 1.03
"""Triangles are drawn larger by this factor, or the background would shimmer through between them."""

LINE = (0.13, 0.13, 0.13, 1.0)
"""Colour of edges."""


@dataclass(frozen=True, eq=False)
class Lines:
    """Straight lines on a surface.

    Attributes
    ----------
    segments : (N, 2, 3) ends [mm].
    outward : (N, 3) direction in which the surface faces there; lines on its far side are not seen.
    ahead : (N,) how far towards the viewer they are drawn so that the surface does not cover them [mm].
    colour : red, green, blue, opaqueness.
    breadth : [mm], or 0 for as thin as can be.
    """

    segments: Float64[np.ndarray, "lines 2 3"]
    outward: Float64[np.ndarray, "lines 3"]
    ahead: Float64[np.ndarray, "lines"]
    colour: tuple[float, float, float, float] = LINE
    breadth: float = 0.0

    def seen(self, view: View) -> Float64[np.ndarray, "seen 4 3"]:
        """Find the narrow rectangles, as broad as the lines, to draw for those on the near side."""
        facing = self.outward @ view.towards_viewer > 0
        segments = self.segments[facing] + self.ahead[facing, None, None] * view.towards_viewer
        across = np.cross(segments[:, 1] - segments[:, 0], view.towards_viewer)
        length = np.linalg.norm(across, axis=1, keepdims=True)
        across *= 0.5 * self.breadth / np.where(length > 0, length, 1.0)
        ends = segments[:, 0], segments[:, 1]
        return np.stack([ends[0] - across, ends[1] - across, ends[1] + across, ends[0] + across], axis=1)


def unit_normals(corners: Float64[np.ndarray, "triangles 3 3"]) -> Float64[np.ndarray, "triangles 3"]:
    """Find the directions in which triangles look; zero for those without an area."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return normals / np.where(length > 0, length, 1.0)


def lit(
    colours: Float64[np.ndarray, "triangles 4"], normals: Float64[np.ndarray, "triangles 3"], view: View
) -> Float64[np.ndarray, "triangles 4"]:
    """Shade colours by a lamp over the viewer's shoulder; the backs of triangles are ``INSIDE``."""
    behind = normals @ view.towards_viewer < 0
    shaded = np.where(behind[:, None], INSIDE, colours)
    shaded[:, :3] *= 0.65 + 0.35 * np.clip(np.where(behind, -1.0, 1.0) * (normals @ view.lamp), 0, 1)[:, None]
    return shaded


def polygons_of(
    corners: Float64[np.ndarray, "triangles 3 3"],
    colours: Float64[np.ndarray, "triangles 4"],
    lines: Sequence[Lines],
    view: View,
    closed: bool = True,
) -> tuple[list[Float64[np.ndarray, "_ 3"]], Float64[np.ndarray, "polygons 4"]]:
    """Find the polygons [mm] to draw for triangles and the lines on them, and their colours.

    Triangles that face away from the viewer are left out where they close a body.
    """
    normals = unit_normals(corners)
    seen = normals @ view.towards_viewer > 0 if closed else np.ones(len(corners), dtype=bool)
    faces = lit(colours[seen], normals[seen], view)
    narrow = [some.seen(view) for some in lines]
    strokes = [np.tile(some.colour, (len(part), 1)) for some, part in zip(lines, narrow, strict=True)]
    middles = corners[seen].mean(axis=1, keepdims=True)
    overlapping = middles + OVERLAP * (corners[seen] - middles)
    polygons = [*overlapping, *np.concatenate([np.empty((0, 4, 3)), *narrow])]
    return polygons, np.concatenate([faces, *strokes])


def solid(
    corners: Float64[np.ndarray, "triangles 3 3"],
    colours: Float64[np.ndarray, "triangles 4"],
    lines: Sequence[Lines],
    view: View,
    closed: bool = True,
) -> Poly3DCollection:
    """Put triangles and lines into one collection, which matplotlib draws from the back to the front."""
    polygons, painted = polygons_of(corners, colours, lines, view, closed)
    # matplotlib sorts the colours with the polygons but not the line widths, so all have the same
    return Poly3DCollection(polygons, facecolors=painted, edgecolors=painted, linewidths=line_width(len(polygons)))


def line_width(count: int) -> float:
    """Width of the lines round polygons [points], which hides the seams between them."""
    return float(np.clip(40.0 / np.sqrt(count + 1), 0.35, 0.8))


def fine_pieces(
    corners: Float64[np.ndarray, "triangles 3 3"], step: float
) -> tuple[Float64[np.ndarray, "pieces 3 3"], Int64[np.ndarray, "pieces"]]:
    """Cut triangles into pieces so small that they can be put in order from the back to the front.

    Parameters
    ----------
    corners : (T, 3, 3) [mm].
    step : longest edge of a piece [mm].

    Returns
    -------
    pieces : (P, 3, 3) [mm], and (P,) the triangle that each came from.
    """
    longest = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).max(axis=1)
    parts = np.ceil(np.clip(longest / step, 1, MOST_PARTS)).astype(np.int64)
    pieces, parents = cut(with_middles(corners), parts)
    return pieces[:, :3], parents


def edge_lines(
    corners: Float64[np.ndarray, "triangles 3 3"], chosen: Bool[np.ndarray, "triangles 3"], step: float
) -> Lines:
    """Find lines along edges of triangles.

    Parameters
    ----------
    corners : (T, 3, 3) [mm].
    chosen : (T, 3) which of the edges 01, 12, 20.
    step : longest line [mm].
    """
    starts, ends = corners[chosen], np.roll(corners, -1, axis=1)[chosen]
    normals = np.repeat(unit_normals(corners)[:, None], 3, axis=1)[chosen]
    length = np.linalg.norm(ends - starts, axis=1)
    parts = np.ceil(np.clip(length / step, 1, MOST_PARTS)).astype(np.int64)
    owner = np.repeat(np.arange(len(starts)), parts)
    share = (np.arange(len(owner)) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[owner]
    along = (ends - starts)[owner]
    first = starts[owner] + share[:, None] * along
    segments = np.stack([first, first + along / parts[owner, None]], axis=1)
    return Lines(segments, normals[owner], 0.5 * np.minimum(length / parts, step)[owner])
