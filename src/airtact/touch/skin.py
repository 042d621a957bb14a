"""Points of the skin, with their positions, normals, areas, neighbours and parts of the hand."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64, Real

from airtact.errors import InvalidInput, between, fixed, in_short, of_kind, shaped
from airtact.geometry.mesh.triangles import (
    PointLengths,
    area_vectors,
    edge_ends,
    longest_edges,
    unit,
)
from airtact.geometry.surface import Surface
from airtact.hands.body import FREE, OWNER
from airtact.hands.hand import Hand
from airtact.hands.joints import FINGERS, Points

# Largest number of skin points.
MAX_POINTS = 100_000

# Function that returns distances [m] from a surface and its normals at points.
Look = Callable[[Real[np.ndarray, "points 3"]], tuple[PointLengths, Points]]

Bodies = Hand | Surface | Sequence[Hand | Surface] | Mapping[str, Hand | Surface]


@dataclass(frozen=True, eq=False)
class Skin:
    """Points of the skin of a hand or another body in one pose, at which contacts are found.

    Build a skin with ``skin_of``, and pass it to ``contact`` or ``TouchState.update``. For a moving
    hand, build the skin once. For each new pose, ``moved`` returns a ``Skin`` with new points and
    normals; the other properties are kept, except ``bodies`` and ``look``. Values are not checked.

    Attributes
    ----------
    points : (N, 3) positions of the points in this pose, in the frame of the bodies that were
        passed to ``skin_of`` [m].
    normals : (N, 3) unit normals of the skin at the points, pointing out of the body.
    areas : (N,) area of skin that each point represents, in the pose in which the skin was built
        [m²].
    triangles : (T, 3) indices of each triangle's corners in ``points``.
    places : names of the parts of the skin, such as "index" or "palm".
    place : (N,) index in ``places`` of the part to which each point belongs.
    neighbours : (N, K) indices of the points that share an edge with each point, padded with the
        index of the point itself; by default, derived from the triangles.
    bodies : for each part in ``places``, the ``Surface`` of its body in this pose; None if unknown,
        as for a moved skin.
    look : function that returns the distances (P,) of points (P, 3) from the exact surface of a
        moved skin [m], positive outside and negative inside, and the outward unit normals (P, 3)
        there; None if unknown.
    """

    points: Float64[np.ndarray, "points 3"]
    normals: Float64[np.ndarray, "points 3"]
    areas: Float64[np.ndarray, "points"]
    triangles: Int64[np.ndarray, "triangles 3"]
    places: tuple[str, ...]
    place: Int64[np.ndarray, "points"]
    neighbours: Int64[np.ndarray, "points most"] = None  # pyright: ignore
    bodies: tuple[Surface, ...] | None = None
    look: Look | None = None

    __repr__ = in_short

    def __post_init__(self) -> None:
        if self.neighbours is None:
            for name, shape in (
                ("points", (-1, 3)),
                ("normals", (-1, 3)),
                ("areas", (-1,)),
                ("triangles", (-1, 3)),
                ("place", (-1,)),
            ):
                shaped(getattr(self, name), shape, name)
            of_kind(self.places, tuple, "places", "the names of parts")
            ends = edge_ends(self.triangles).reshape(-1, 2)
            # List both directions of each edge once, sorted by their first point.
            pairs = np.unique(np.concatenate([ends, ends[:, ::-1]]), axis=0)
            degrees = np.bincount(pairs[:, 0], minlength=len(self.points))
            column = np.arange(len(pairs)) - np.repeat(np.cumsum(degrees) - degrees, degrees)
            neighbours = np.repeat(np.arange(len(degrees))[:, None], degrees.max(), axis=1)
            neighbours[pairs[:, 0], column] = pairs[:, 1]
            object.__setattr__(self, "neighbours", neighbours)

    def moved(
        self,
        points: Float64[np.ndarray, "points 3"],
        normals: Float64[np.ndarray, "points 3"],
        look: Look | None = None,
    ) -> "Skin":
        """Return the same skin in another pose.

        Parameters
        ----------
        points : (N, 3) new positions of the same points, in the frame of the virtual objects [m].
        normals : (N, 3) new outward unit normals.
        look : function for the exact surface in this pose, as in the attribute ``look``. If it is
            given, the points of contacts lie on the exact surface; by default, they are
            interpolated between the points of the skin.

        Returns
        -------
        A ``Skin``, whose attribute ``bodies`` is None.
        """
        return replace(self, points=points, normals=normals, bodies=None, look=look)


def skin_of(bodies: Bodies, longest_edge: float = 6e-3) -> Skin:
    """Return the points of the skin of a hand, another surface, or several bodies.

    ``contact`` and ``TouchState.update`` find at these points where the skin touches objects.

    Parameters
    ----------
    bodies : a ``Hand``, a ``Surface``, a list of these, or a mapping from names to them; all in one
        frame, which is also that of the result.
    longest_edge : longest distance between neighbouring points [m], 0.001 to 0.05. By default, a
        hand has about 6,000 points, so that a fingertip pressed 2 mm into a ball has several points
        in the ball. At 10 mm, a hand has 1,600 points, which suits a live loop; the density of
        points at the finger pads is the same. Balls with a radius below ``longest_edge``/√3 may lie
        between points.

    Returns
    -------
    A ``Skin``, divided into parts. The parts of a hand are its five fingers ("thumb", "index",
    "middle", "ring", "pinky"), "palm" and "back"; with a left and a right hand, the side precedes
    the name, as in "left.index". A surface is a single part with its name in the mapping, "body N"
    for the N-th body of a list, or "skin" if it is the only body.

    Raises
    ------
    InvalidInput
        If an argument has the wrong type, there are no bodies, ``longest_edge`` is outside its
        range, or a surface requires more than 100,000 points.

    Examples
    --------
    >>> import airtact as at
    >>> skin = skin_of(at.pinch().surfaces)
    >>> skin.places, bool(skin.areas.min() > 0.0)
    (('body 1', 'body 2'), True)
    """
    longest_edge = between(longest_edge, 1e-3, 0.05, "the longest edge", "m")
    named: dict[str, Any]
    if isinstance(bodies, Mapping):
        named = dict(bodies)
    elif isinstance(bodies, Iterable):
        named = {f"body {index + 1}": body for index, body in enumerate(bodies)}
    else:
        named = {"skin": bodies}
    if not named:
        raise InvalidInput("there are no bodies; pass at least one hand or surface.", code="empty")
    hands = [body for body in named.values() if isinstance(body, Hand)]
    sided = len({hand.side for hand in hands}) > 1
    meshes = []
    places: list[str] = []
    surfaces: list[Surface] = []
    first = 0
    for name, body in named.items():
        of_kind(body, Hand | Surface, f"the body {name!r}", "a hand or a surface")
        surface = body.surface if isinstance(body, Hand) else body
        vertices, triangles = _fine_mesh(surface, longest_edge)
        vectors = 0.5 * area_vectors(vertices[triangles])
        sums = np.zeros((len(vertices), 3))
        areas = np.zeros(len(vertices))
        # Each corner receives the area vector and a third of the area of each of its triangles.
        for corner in triangles.T:
            np.add.at(sums, corner, vectors)
            np.add.at(areas, corner, np.linalg.norm(vectors, axis=1) / 3.0)
        normals = unit(sums)
        place = np.zeros(len(vertices), dtype=np.int64)
        names = [name]
        if isinstance(body, Hand):
            # A point belongs to the part of its nearest hull, a phalanx or the palm.
            hulls = body.shape.hulls.each(body.shape.pose.inverse().apply(vertices))
            hull = hulls.argmin(axis=1)
            phalanx = hull < FREE
            place[phalanx] = OWNER[hull[phalanx]]
            facing = normals @ body.position("palm")[1] > 0.0
            place[~phalanx] = np.where(facing[~phalanx], 5, 6)
            prefix = f"{body.side}." if sided else ""
            names = [f"{prefix}{part}" for part in (*FINGERS, "palm", "back")]
        meshes.append((vertices, normals, areas, triangles + first, place + len(places)))
        places += names
        surfaces += [surface] * len(names)
        first += len(vertices)
    points, normals, areas, triangles, place = (
        np.concatenate(part) for part in zip(*meshes, strict=True)
    )
    return Skin(points, normals, areas, triangles, tuple(places), place, bodies=tuple(surfaces))


def _fine_mesh(
    surface: Surface, longest_edge: float
) -> tuple[Float64[np.ndarray, "vertices 3"], Int64[np.ndarray, "triangles 3"]]:
    """Divide triangles into four until no edge is longer than ``longest_edge`` [m]."""
    vertices = np.asarray(surface.vertices)
    triangles = np.asarray(surface.triangles)
    while longest_edges(vertices[triangles]).max() > longest_edge:
        ends = np.sort(edge_ends(triangles).reshape(-1, 2), axis=1)
        edges, inverse = np.unique(ends, axis=0, return_inverse=True)
        if len(vertices) + len(edges) > MAX_POINTS:
            raise InvalidInput(
                f"the surface requires more than {MAX_POINTS:,} skin points if neighbours are at "
                f"most {1e3 * longest_edge:.3g} mm apart: pass only the part that touches objects, "
                "or use objects at least 7 mm across.",
                code="too_many",
            )
        middles = surface.shape.project(vertices[edges].mean(axis=1))
        a, b, c = triangles.T
        ab, bc, ca = (len(vertices) + inverse.reshape(-1, 3)).T
        vertices = np.concatenate([vertices, middles])
        parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        triangles = np.concatenate([np.stack(part, axis=1) for part in parts])
    return fixed(vertices), triangles
