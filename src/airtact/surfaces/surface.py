"""Closed triangle surfaces."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float64, Int64, Integer, Real

from airtact.conventions import InvalidInput
from airtact.mesh.curving import SHARP_DEGREES, curved
from airtact.mesh.intersections import self_crossings
from airtact.mesh.topology import (
    check_closed,
    check_indices,
    check_not_degenerate,
    check_orientation,
    check_size,
    edge_twins,
)
from airtact.pose import Pose
from airtact.printing import in_short
from airtact.surfaces.curved_mesh import CurvedMesh
from airtact.surfaces.mesh_shape import CurvedShape
from airtact.surfaces.panels import Panels, panels_of
from airtact.surfaces.shape import Shape
from airtact.validation import (
    check_finite,
    counted,
    fixed,
    in_mm,
    number,
    of_kind,
    points_of,
    positive,
    real_numbers,
)


@dataclass(frozen=True, eq=False)
class Surface:
    """The skin of a body: a closed mesh of triangles, anticlockwise seen from outside.

    Attributes
    ----------
    vertices : (V, 3) [m].
    triangles : (T, 3) vertex indices.
    midpoints : (T, 3, 3) points of the true skin over the middles of edges 01, 12, 20 [m], which curve the panels;
        None to curve them by the normals of the triangles round each vertex.
    primitive : the exact shape that this is a picture of, or None.
    sharp_degrees : edges whose triangles turn by more than this stay sharp; 0 leaves all triangles flat.
    mended : what was mended before it became a surface, a sentence each.

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
    primitive: Shape | None = None
    sharp_degrees: float = SHARP_DEGREES
    repairs: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check everything that is quick to check and keep read-only copies."""
        vertices = points_of(self.vertices, "surface vertices")
        triangles = _triangles_of(self.triangles)
        check_indices(len(vertices), triangles)
        _check_wrong_angle(self.sharp_degrees)
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "triangles", triangles)
        check_size(extent_of(self))
        check_not_degenerate(vertices, triangles)
        check_closed(vertices, triangles)
        check_orientation(vertices, triangles)
        if self.midpoints is not None:
            midpoints = real_numbers(self.midpoints, "surface midpoints")
            _check_bad_midpoints(midpoints, vertices, triangles)
            object.__setattr__(self, "midpoints", midpoints)
        if self.primitive is not None:
            _check_other_shape(self.primitive, self.corners)

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
    def shape(self) -> Shape:
        """The true skin: the primitive, or the triangles curved by their midpoints or normals."""
        if self.primitive is not None:
            return self.primitive
        middles, sharp = curved(self.vertices, self.triangles, self.sharp_degrees)
        quadratic_triangles = np.concatenate(
            [self.corners, middles if self.midpoints is None else self.midpoints], axis=1
        )
        return CurvedShape(CurvedMesh(self.vertices, quadratic_triangles, self.triangles, sharp), Pose.identity())

    @property
    def area(self) -> float:
        """Area of the true skin [m²]."""
        return self.shape.area

    @property
    def volume(self) -> float:
        """Enclosed volume [m³]."""
        return self.shape.volume

    def panelled(self, edge: float, beside: Real[np.ndarray, "points 3"] | None = None) -> Panels:
        """Cover the skin with curved six-node panels, as the solvers do.

        Parameters
        ----------
        edge : edge of the equilateral triangle as large as the panels wanted [m].
        beside : (P, 3) points beside which panels are cut finer, down to half of that edge [m].

        Raises
        ------
        InvalidInput
            When the edge is not above zero, or the surface cannot be meshed anew.
        """
        edge = positive(edge, "edge", "m")
        near = np.empty((0, 3)) if beside is None else points_of(beside, "points beside which panels are finer", 0)
        return panels_of([self.shape], edge, near, smallest=0.5 * edge)

    @cached_property
    def crossings(self) -> Int64[np.ndarray, "crossings 2"]:
        """Pairs of triangles (K, 2) that cross or touch beyond what they share as neighbours; none for a primitive."""
        if self.primitive is not None:
            return np.zeros((0, 2), dtype=np.int64)
        return self_crossings(self.corners, self.triangles)

    def depth(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points"]:
        """How deep points lie under the true skin [m]; negative outside.

        Parameters
        ----------
        points : (P, 3) [m].

        Raises
        ------
        InvalidInput
            When they are of another shape, NaN or infinite.
        """
        return self.shape.depth(points_of(points, "points", least=0))

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
        object.__setattr__(copy, "sharp_degrees", self.sharp_degrees)
        object.__setattr__(copy, "repairs", self.repairs)
        copy.__dict__["shape"] = self.shape.moved(pose)
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


def _check_wrong_angle(degrees: float) -> None:
    if not 0.0 <= number(degrees, "sharp_degrees", "degrees") <= 180.0:
        raise InvalidInput(f"sharp_degrees is {degrees:g}, but edges turn by 0 to 180 degrees.")


def _check_other_shape(primitive: Shape, corners: Float64[np.ndarray, "triangles 3 3"]) -> None:
    off = np.abs(primitive.depth(corners.reshape(-1, 3)))
    if off.max() > 1e-6 * primitive.extent:
        raise InvalidInput(
            f"a corner of triangle {int(off.argmax()) // 3} lies {off.max() * 1e3:.3g} mm off the exact shape that the "
            "surface is said to be; leave the primitive out or take its own mesh."
        )


def _check_bad_midpoints(
    midpoints: np.ndarray, vertices: Float64[np.ndarray, "vertices 3"], triangles: Int64[np.ndarray, "triangles 3"]
) -> None:
    if midpoints.shape != (len(triangles), 3, 3):
        raise InvalidInput(
            f"surface midpoints have shape {midpoints.shape}, but {len(triangles)} triangles need "
            f"({len(triangles)}, 3, 3)."
        )
    check_finite(midpoints, "surface midpoints")
    flat = midpoints.reshape(-1, 3)
    gap = np.linalg.norm(flat - flat[edge_twins(triangles).ravel()], axis=1)
    parted = np.flatnonzero(gap > 1e-9 * np.ptp(vertices, axis=0).max())
    if len(parted):
        raise InvalidInput(
            f"{counted(len(parted) // 2, 'edge has a midpoint', 'edges have midpoints')} that the two triangles do not "
            f"share, the first near "
            f"{in_mm(flat[parted[0]])}, {gap[parted[0]] * 1e3:.3g} mm apart; the curved skin would be open there.",
            flat[parted[0]],
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
