"""Rigid motions and closed triangle surfaces."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float64, Int64, Integer, Real

from airtact.conventions import InvalidInput, Vector
from airtact.scene.closest_point import SignedDistance, signed_distance
from airtact.scene.crossings import self_crossings
from airtact.scene.guards import counted, fixed, number, of_kind, place, points_of, real_numbers, refuse_not_finite
from airtact.scene.printing import in_short
from airtact.scene.topology import (
    cone_volumes,
    edge_twins,
    refuse_bad_indices,
    refuse_degenerate,
    refuse_inside_out,
    refuse_open,
    refuse_wrong_size,
)


@dataclass(frozen=True, eq=False)
class Pose:
    """A rigid motion x -> rotation x + translation.

    Attributes
    ----------
    rotation : (3, 3) proper rotation matrix.
    translation : (3,) [m].

    Raises
    ------
    InvalidInput
        When the matrix is not a rotation (orthonormal to 1e-6, not a mirror) or anything is not finite.

    Examples
    --------
    >>> quarter = Pose.turn((0, 0, 1), math.pi / 2, translation=(0, 0, 1))
    >>> quarter.apply(np.array([[1.0, 0, 0]])).round(12).tolist()
    [[0.0, 1.0, 1.0]]
    """

    rotation: Real[np.ndarray, "3 3"]
    translation: Real[np.ndarray, "3"]

    __repr__ = in_short

    def __post_init__(self) -> None:
        """Check both arrays and keep them read-only."""
        rotation = real_numbers(self.rotation, "the pose's rotation")
        translation = real_numbers(self.translation, "the pose's translation")
        if rotation.shape != (3, 3) or translation.shape != (3,):
            raise InvalidInput(
                f"a pose has shapes {rotation.shape} and {translation.shape}, but it needs a rotation of shape "
                "(3, 3) and a translation of shape (3,)."
            )
        refuse_not_finite(rotation, "the pose's rotation")
        refuse_not_finite(translation, "the pose's translation")
        skew = float(np.abs(rotation.T @ rotation - np.eye(3)).max())
        if skew > 1e-6 or np.linalg.det(rotation) < 0.0:
            raise InvalidInput(
                f"the pose's matrix is not a rotation: it is {skew:.2g} away from orthonormal and its determinant is "
                f"{np.linalg.det(rotation):.3g} (a rotation has 0 and 1)."
            )
        object.__setattr__(self, "rotation", rotation)
        object.__setattr__(self, "translation", translation)

    @classmethod
    def identity(cls) -> "Pose":
        """Build the motion that moves nothing."""
        return cls(np.eye(3), np.zeros(3))

    @classmethod
    def turn(cls, axis: Vector, angle: float, translation: Vector = (0, 0, 0)) -> "Pose":
        """Turn about an axis through the origin, then shift.

        Parameters
        ----------
        axis : (3,) direction, of any length above zero.
        angle : [rad], right-handed about the axis.
        translation : (3,) [m].

        Raises
        ------
        InvalidInput
            When the axis has no length.
        """
        along, angle = real_numbers(np.asarray(axis), "the axis of a turn"), number(angle, "the angle of a turn", "rad")
        if along.shape != (3,):
            raise InvalidInput(f"the axis of a turn has shape {along.shape}, but a direction has shape (3,).")
        length = float(np.linalg.norm(along))
        if not length > 0.0:
            raise InvalidInput(f"the axis of a turn has length {length:g}; give a direction.")
        x, y, z = along / length
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        rotation = np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross
        return cls(rotation, np.asarray(translation, dtype=np.float64))

    def apply(self, points: Real[np.ndarray, "*axes 3"]) -> Float64[np.ndarray, "*axes 3"]:
        """Move points.

        Parameters
        ----------
        points : (..., 3) [m].
        """
        return self.rotate(points) + self.translation

    def rotate(self, vectors: Real[np.ndarray, "*axes 3"]) -> Float64[np.ndarray, "*axes 3"]:
        """Turn directions, without the shift.

        Parameters
        ----------
        vectors : (..., 3).
        """
        return np.asarray(vectors, dtype=np.float64) @ self.rotation.T

    def inverse(self) -> "Pose":
        """Build the motion that undoes this one."""
        return Pose(self.rotation.T, -self.rotation.T @ self.translation)

    def __matmul__(self, other: "Pose") -> "Pose":
        """Chain two motions: ``(self @ other).apply(x) == self.apply(other.apply(x))``."""
        return Pose(self.rotation @ other.rotation, self.apply(other.translation))


@runtime_checkable
class ExactShape(Protocol):
    """A closed form that a surface is a picture of."""

    @property
    def extent(self) -> float:
        """Largest distance between two of its points [m]."""
        ...

    @property
    def area(self) -> float:
        """Area of the skin [m²]."""
        ...

    @property
    def volume(self) -> float:
        """Enclosed volume [m³]."""
        ...

    def depth(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points"]:
        """Distance to the skin [m] of points (P, 3) [m], positive inside."""
        ...

    def project(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points 3"]:
        """Nearest points of the skin (P, 3) [m] to points (P, 3) [m]."""
        ...

    def mesh(self, edge: float) -> "Surface":
        """Draw it with panel edges of at most ``edge`` [m]."""
        ...

    def moved(self, pose: Pose) -> "ExactShape":
        """Move it rigidly."""
        ...

    def grown(self, step: float) -> "ExactShape":
        """Move its skin outwards by a step [m]."""
        ...


@dataclass(frozen=True, eq=False)
class Surface:
    """The skin of a body: a closed mesh of triangles, anticlockwise seen from outside.

    Attributes
    ----------
    vertices : (V, 3) [m].
    triangles : (T, 3) vertex indices.
    midpoints : (T, 3, 3) points of the true skin over the middles of edges 01, 12, 20 [m], which curve the panels;
        None when the panels are flat.
    primitive : the exact shape that this is a picture of, or None.

    Raises
    ------
    InvalidInput
        Wrong shapes, NaN or infinity, indices out of range, an extent over 2 m or under 0.5 mm, degenerate triangles,
        an open or inside-out mesh, midpoints that neighbours do not share: each with how many and where. (Crossings of
        the surface with itself are looked for when it enters a ``Scene``.)

    Examples
    --------
    >>> corners = 0.01 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    >>> tetrahedron = Surface(corners, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]))
    >>> round(tetrahedron.volume * 1e6, 4)
    0.1667
    """

    vertices: Real[np.ndarray, "vertices 3"]
    triangles: Integer[np.ndarray, "triangles 3"]
    midpoints: Real[np.ndarray, "triangles 3 3"] | None = None
    primitive: ExactShape | None = None

    def __post_init__(self) -> None:
        """Check everything that is quick to check and keep read-only copies."""
        vertices = points_of(self.vertices, "surface vertices")
        triangles = _triangles_of(self.triangles)
        refuse_bad_indices(len(vertices), triangles)
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "triangles", triangles)
        refuse_wrong_size(extent_of(self))
        refuse_degenerate(vertices, triangles)
        refuse_open(vertices, triangles)
        refuse_inside_out(vertices, triangles)
        if self.midpoints is not None:
            midpoints = real_numbers(self.midpoints, "surface midpoints")
            _refuse_bad_midpoints(midpoints, vertices, triangles)
            object.__setattr__(self, "midpoints", midpoints)
        if self.primitive is not None:
            _refuse_other_shape(self.primitive, self.corners)

    __repr__ = in_short

    @cached_property
    def corners(self) -> Float64[np.ndarray, "triangles 3 3"]:
        """Corners of each triangle (T, 3, 3) [m]."""
        return fixed(self.vertices[self.triangles])

    @cached_property
    def edge_lengths(self) -> Float64[np.ndarray, "triangles 3"]:
        """Lengths of the straight edges 01, 12, 20 (T, 3) [m]."""
        return fixed(np.linalg.norm(np.roll(self.corners, -1, axis=1) - self.corners, axis=2))

    @cached_property
    def area(self) -> float:
        """Area of the skin [m²]; curved panels by a degree-5 rule."""
        if self.midpoints is None:
            a, b, c = np.moveaxis(self.corners, 1, 0)
            return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2.0)
        _, stretch, weights = _curved(self.corners, self.midpoints)
        return float(np.linalg.norm(stretch, axis=2).sum(axis=0) @ weights)

    @cached_property
    def volume(self) -> float:
        """Enclosed volume [m³]; exact for curved panels too, whose integrand has degree 4."""
        if self.midpoints is None:
            return float(cone_volumes(self.corners).sum())
        points, stretch, weights = _curved(self.corners, self.midpoints)
        centred = points - self.vertices.mean(axis=0)
        return float(np.einsum("tqi,tqi->q", centred, stretch) @ weights / 3.0)

    @cached_property
    def crossings(self) -> Int64[np.ndarray, "crossings 2"]:
        """Pairs of triangles (K, 2) that cross or touch beyond what they share as neighbours; none for a primitive."""
        if self.primitive is not None:
            return np.zeros((0, 2), dtype=np.int64)
        return self_crossings(self.corners, self.triangles)

    @cached_property
    def _distance(self) -> SignedDistance:
        return signed_distance(self.vertices, self.triangles)

    def depth(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points"]:
        """How deep points lie under the skin [m]; negative outside.

        Exact for a primitive, by the flat triangles otherwise.

        Parameters
        ----------
        points : (P, 3) [m].

        Raises
        ------
        InvalidInput
            When they are of another shape, NaN or infinite.
        """
        points = points_of(points, "points", least=0)
        if self.primitive is not None:
            return self.primitive.depth(points)
        return self._distance.depth(points)

    def moved(self, pose: Pose) -> "Surface":
        """Move the surface rigidly, with its midpoints and its exact shape.

        Parameters
        ----------
        pose : the motion.
        """
        of_kind(pose, Pose, "the motion of a surface", "Pose(rotation, translation)")
        copy = object.__new__(Surface)  # a rigid motion keeps all that was checked, so nothing is checked again
        object.__setattr__(copy, "vertices", fixed(pose.apply(self.vertices)))
        object.__setattr__(copy, "triangles", self.triangles)
        object.__setattr__(copy, "midpoints", None if self.midpoints is None else fixed(pose.apply(self.midpoints)))
        object.__setattr__(copy, "primitive", None if self.primitive is None else self.primitive.moved(pose))
        if "crossings" in self.__dict__:
            copy.__dict__["crossings"] = self.crossings
        return copy


def extent_of(surface: Surface) -> float:
    """Largest side of the upright box round a surface, or the largest distance within its exact shape [m].

    Parameters
    ----------
    surface : the surface.
    """
    if surface.primitive is not None:
        return surface.primitive.extent
    return float(np.ptp(surface.corners.reshape(-1, 3), axis=0).max())


def _triangles_of(given: np.ndarray) -> Int64[np.ndarray, "triangles 3"]:
    try:
        array = np.asarray(given)
    except ValueError:
        raise InvalidInput(f"the {len(given)} surface triangles do not have three indices each.") from None
    if array.ndim != 2 or array.shape[1] != 3 or len(array) == 0:
        raise InvalidInput(
            f"surface triangles have shape {array.shape}, but they are an array of shape (triangles, 3)."
        )
    if not np.issubdtype(array.dtype, np.integer):
        raise InvalidInput(f"surface triangles are of type {array.dtype}, but vertex indices are integers.")
    triangles = np.array(array, dtype=np.int64, order="C")
    triangles.flags.writeable = False
    return triangles


def _refuse_other_shape(primitive: ExactShape, corners: Float64[np.ndarray, "triangles 3 3"]) -> None:
    off = np.abs(primitive.depth(corners.reshape(-1, 3)))
    if off.max() > 1e-6 * primitive.extent:
        raise InvalidInput(
            f"a corner of triangle {int(off.argmax()) // 3} lies {off.max() * 1e3:.3g} mm off the exact shape that the "
            "surface is said to be; leave the primitive out or take its own mesh."
        )


def _refuse_bad_midpoints(
    midpoints: np.ndarray, vertices: Float64[np.ndarray, "vertices 3"], triangles: Int64[np.ndarray, "triangles 3"]
) -> None:
    if midpoints.shape != (len(triangles), 3, 3):
        raise InvalidInput(
            f"surface midpoints have shape {midpoints.shape}, but {len(triangles)} triangles need "
            f"({len(triangles)}, 3, 3)."
        )
    refuse_not_finite(midpoints, "surface midpoints")
    flat = midpoints.reshape(-1, 3)
    gap = np.linalg.norm(flat - flat[edge_twins(triangles).ravel()], axis=1)
    parted = np.flatnonzero(gap > 1e-9 * np.ptp(vertices, axis=0).max())
    if len(parted):
        raise InvalidInput(
            f"{counted(len(parted) // 2, 'edge has a midpoint', 'edges have midpoints')} that the two triangles do not "
            f"share, the first near "
            f"{place(flat[parted[0]])}, {gap[parted[0]] * 1e3:.3g} mm apart; the curved skin would be open there."
        )
    ends = vertices[triangles]
    away = np.linalg.norm(midpoints - (ends + np.roll(ends, -1, axis=1)) / 2.0, axis=2)
    bulge = away / np.linalg.norm(np.roll(ends, -1, axis=1) - ends, axis=2)
    if bulge.max() > 0.5:
        triangle, edge = np.unravel_index(bulge.argmax(), bulge.shape)
        raise InvalidInput(
            f"a midpoint of triangle {triangle} lies {away[triangle, edge] * 1e3:.3g} mm off the middle of its edge, "
            f"{bulge.max():.3g} of the edge's length; it may be half of it at most, so use a finer mesh."
        )


def _curved(
    corners: Float64[np.ndarray, "triangles 3 3"], midpoints: Float64[np.ndarray, "triangles 3 3"]
) -> tuple[
    Float64[np.ndarray, "triangles nodes 3"], Float64[np.ndarray, "triangles nodes 3"], Float64[np.ndarray, "nodes"]
]:
    """Points and area vectors of six-node panels at the seven points of Radon's degree-5 rule, with its weights."""
    root = math.sqrt(15.0)
    near, far = (6.0 - root) / 21.0, (6.0 + root) / 21.0
    rings = [(1 / 3, 1 / 3)] + [pair for s in (near, far) for pair in ((s, s), (1 - 2 * s, s), (s, 1 - 2 * s))]
    weights = 0.5 * np.r_[9 / 40, [(155 - root) / 1200] * 3, [(155 + root) / 1200] * 3]
    u, v = np.array(rings).T
    w = 1.0 - u - v
    zero = np.zeros_like(u)
    shape = [w * (2 * w - 1), u * (2 * u - 1), v * (2 * v - 1), 4 * w * u, 4 * u * v, 4 * v * w]
    by_u = [1 - 4 * w, 4 * u - 1, zero, 4 * (w - u), 4 * v, -4 * v]
    by_v = [1 - 4 * w, zero, 4 * v - 1, -4 * u, 4 * u, 4 * (w - v)]
    nodes = np.concatenate([corners, midpoints], axis=1)
    points, along_u, along_v = (np.einsum("kq,tki->tqi", np.array(table), nodes) for table in (shape, by_u, by_v))
    return points, np.cross(along_u, along_v), weights
