"""Closed triangle surfaces."""

from dataclasses import InitVar, dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Integer, Real

from airtact.errors import (
    InvalidInput,
    between,
    check_finite,
    counted,
    fixed,
    in_mm,
    of_kind,
    one_line,
    points_of,
    positive,
    real_numbers,
    sides_in_mm,
)
from airtact.geometry.mesh.triangles import (
    SHARP_DEGREES,
    EdgeVectors,
    IndexPairs,
    PointLengths,
    Points,
    QuadraticTriangles,
    Triangles,
    TriangleVectors,
    Twins,
    check_closed,
    check_indices,
    check_not_degenerate,
    check_orientation,
    check_size,
    edge_lengths,
)
from airtact.geometry.panels import Panels, panels_of
from airtact.geometry.pose import Pose, nearest_motion
from airtact.geometry.shape import Shape


class Body:
    """Empty object that identifies a rigid body, stored in the attribute ``Surface.body``.

    Two surfaces whose ``body`` is the same object are one body in two poses, so solvers can reuse
    what they computed for one of them.
    """


@dataclass(frozen=True, eq=False)
class Surface:
    """The surface of a body: a closed mesh of triangles, anticlockwise when seen from outside.

    Functions such as ``sphere`` and ``load_surface`` return surfaces, and ``sound_hard`` and others
    make bodies of them for a ``Scene``. Solvers replace the flat triangles by curved panels.

    Attributes
    ----------
    vertices : (V, 3) positions of the vertices [m], in the frame in which the body is used.
    triangles : (T, 3) indices of each triangle's corners in ``vertices``.
    midpoints : (T, 3, 3) points of the true surface at the middles of edges 01, 12, 20 of each
        triangle [m]. If None, the curvature of the panels follows from the normals of the triangles
        around each vertex.
    primitive : the exact shape that the triangles approximate, or None.
    sharp_degrees : angle between the normals of neighbouring triangles above which their edge
        remains sharp [degrees], 0 to 180; 75 by default. 0 keeps the triangles flat. An edge that
        meets no other sharp edge is rounded.
    repairs : a sentence for each kind of damage repaired by the function that built the surface,
        such as ``load_surface``; empty by default.
    shape : the true surface, which is ``primitive`` if there is one, or else the curved triangles;
        computed, not passed.

    Raises
    ------
    InvalidInput
        If an array has the wrong shape, if a number is NaN or infinite, if an index is out of
        range, if the extent is over 2 m or under 0.5 mm, if a triangle is degenerate, if the mesh
        is open or inside out, or if neighbours do not share their midpoints. ``Scene`` checks for
        self-intersections.

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
    # The shape of triangles that were already checked or repaired.
    _known_shape: InitVar[Shape | None] = None
    shape: Shape = field(init=False, repr=False, compare=False)

    def __post_init__(self, _known_shape: Shape | None) -> None:
        slip = "it is the angle between two triangles."
        between(self.sharp_degrees, 0.0, 180.0, "sharp_degrees", "degrees", slip)
        if _known_shape is None:
            self._check()
            from airtact.geometry.mesh_shape import MeshShape, QuadraticMesh

            mesh = QuadraticMesh(self.vertices, self.triangles, self.midpoints, self.sharp_degrees)
            _known_shape = self.primitive or MeshShape(mesh, Pose.identity())
        object.__setattr__(self, "shape", _known_shape)

    def _check(self) -> None:
        vertices = points_of(self.vertices, "surface vertices")
        triangles = _triangles_of(self.triangles)
        check_indices(len(vertices), triangles)
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "triangles", triangles)
        corners = vertices[triangles]
        box = float(np.ptp(corners.reshape(-1, 3), axis=0).max())
        check_size(box if self.primitive is None else self.primitive.extent)
        check_not_degenerate(vertices, triangles)
        twins = check_closed(vertices, triangles)
        check_orientation(vertices, triangles, twins)
        if self.midpoints is not None:
            midpoints = real_numbers(self.midpoints, "surface midpoints")
            _check_midpoints(midpoints, corners, twins)
            object.__setattr__(self, "midpoints", midpoints)

    def __repr__(self) -> str:
        kind = ""
        if self.primitive is not None:
            kind = type(self.primitive).__name__.removesuffix("Shape").lower()
        triangles = counted(len(self.triangles), "triangle", "triangles")
        repairs = counted(len(self.repairs), "repair", "repairs") if self.repairs else ""
        return one_line(self, kind, triangles, sides_in_mm(self.vertices), repairs)

    @cached_property
    def body(self) -> "Body":
        """Identity of the body, which is the same in all poses."""
        return Body()

    @cached_property
    def pose(self) -> Pose:
        """Pose relative to the frame in which the body was built."""
        return Pose.identity()

    @cached_property
    def corners(self) -> EdgeVectors:
        """(T, 3, 3) corners of each triangle [m]."""
        return fixed(self.vertices[self.triangles])

    @cached_property
    def edge_lengths(self) -> TriangleVectors:
        """(T, 3) lengths of the straight edges 01, 12, 20 [m]."""
        return fixed(edge_lengths(self.corners))

    @cached_property
    def quadratic_triangles(self) -> QuadraticTriangles:
        """(T, 6, 3) the triangles as curved panels [m]."""
        middles = self.midpoints
        if middles is None:
            middles = self.shape.edge_middles(self.corners)
        return np.concatenate([self.corners, middles], axis=1)

    @property
    def extent(self) -> float:
        """Largest side [m] of the original bounding box, or largest diameter of the exact shape."""
        return self.shape.extent

    @property
    def area(self) -> float:
        """Area of the true surface [m²]."""
        return self.shape.area

    @property
    def volume(self) -> float:
        """Enclosed volume [m³]."""
        return self.shape.volume

    @property
    def crossings(self) -> IndexPairs:
        """(K, 2) pairs of triangles that meet, other than at a common corner or edge."""
        return self.shape.crossings

    def panelled(self, edge: float) -> Panels:
        """Cover the surface with curved quadratic (six-node) panels, as the solvers do.

        Parameters
        ----------
        edge : edge length of an equilateral triangle that has the area of a typical panel [m].

        Returns
        -------
        The panels, and their distance from the true surface.

        Raises
        ------
        InvalidInput
            If the edge is not above zero, or if the surface cannot be remeshed.
        """
        edge = positive(edge, "edge", "m")
        return panels_of([self.shape], edge, np.empty((0, 3)), smallest=0.5 * edge)

    def depth(self, points: Points) -> PointLengths:
        """Return the depth (P,) [m] of points (P, 3) below the surface, negative outside.

        The method raises ``InvalidInput`` if the shape of ``points`` is wrong or a point is not
        finite.
        """
        return self.shape.depth(points_of(points, "points", least=0))

    def moved(self, pose: Pose) -> "Surface":
        """Return the surface, including its midpoints and exact shape, after a rigid motion."""
        of_kind(pose, Pose, "the motion of a surface", "Pose(rotation, translation)")
        shape = self.shape.moved(pose)
        moved = replace(
            self,
            vertices=fixed(pose.apply(self.vertices)),
            midpoints=None if self.midpoints is None else fixed(pose.apply(self.midpoints)),
            primitive=None if self.primitive is None else shape,
            _known_shape=shape,  # a rigid motion does not invalidate the checks
        )
        object.__setattr__(moved, "body", self.body)
        object.__setattr__(moved, "pose", pose @ self.pose)
        return moved


def rigid_motion(before: Surface, after: Surface) -> tuple[Pose, float]:
    """Return the least-squares rigid motion from one surface to another with the same triangles.

    The second result is the largest distance [m] between corresponding vertices or edge midpoints
    after this motion. It is infinite if the surfaces differ in their triangles or in how the
    triangles are curved.
    """
    if before is after:
        return Pose.identity(), 0.0
    if before.body is after.body:
        return after.pose @ before.pose.inverse(), 0.0
    same = before.triangles is after.triangles or np.array_equal(before.triangles, after.triangles)
    curved_alike = (
        type(before.shape) is type(after.shape)
        and (before.midpoints is None) == (after.midpoints is None)
        and before.sharp_degrees == after.sharp_degrees
    )
    if not same or len(before.vertices) != len(after.vertices) or not curved_alike:
        return Pose.identity(), float("inf")
    pose = Pose(*nearest_motion(before.vertices, after.vertices))
    off = np.linalg.norm(pose.apply(before.vertices) - after.vertices, axis=1).max()
    if before.midpoints is not None and after.midpoints is not None:
        off = max(off, np.linalg.norm(pose.apply(before.midpoints) - after.midpoints, axis=2).max())
    return pose, float(off)


def _triangles_of(triangles: np.ndarray) -> Triangles:
    try:
        array = np.asarray(triangles)
    except ValueError:
        raise InvalidInput(
            f"the {len(triangles)} surface triangles do not have three vertex indices each.",
            code="wrong_shape",
        ) from None
    if array.ndim != 2 or array.shape[1] != 3 or len(array) == 0:
        raise InvalidInput(
            f"surface triangles have shape {array.shape}, but must have shape (triangles, 3) with "
            "at least one triangle.",
            code="wrong_shape",
        )
    if not np.issubdtype(array.dtype, np.integer):
        raise InvalidInput(
            f"surface triangles have type {array.dtype}, but vertex indices must be integers.",
            code="not_a_number",
        )
    indices = np.array(array, dtype=np.int64, order="C")
    indices.flags.writeable = False
    return indices


def _check_midpoints(midpoints: np.ndarray, corners: EdgeVectors, twins: Twins) -> None:
    if midpoints.shape != corners.shape:
        raise InvalidInput(
            f"surface midpoints have shape {midpoints.shape}, but {len(corners)} triangles need "
            f"{corners.shape}.",
            code="wrong_shape",
        )
    check_finite(midpoints, "surface midpoints")
    flat = midpoints.reshape(-1, 3)
    gap = np.linalg.norm(flat - flat[twins.ravel()], axis=1)
    parted = np.flatnonzero(gap > 1e-9 * np.ptp(corners.reshape(-1, 3), axis=0).max())
    if len(parted):
        where = flat[parted[0]]
        have = counted(len(parted) // 2, "edge has a midpoint", "edges have midpoints")
        raise InvalidInput(
            f"{have} that the two triangles do not share, the first near {in_mm(where)}, "
            f"{gap[parted[0]] * 1e3:.3g} mm apart. Use the same midpoint for both triangles.",
            where,
            code="mesh_faulty",
        )
    away = np.linalg.norm(midpoints - (corners + np.roll(corners, -1, axis=1)) / 2.0, axis=2)
    bulge = away / edge_lengths(corners)
    if bulge.max() > 0.5:
        triangle, edge = np.unravel_index(bulge.argmax(), bulge.shape)
        raise InvalidInput(
            f"a midpoint of triangle {triangle} lies {away[triangle, edge] * 1e3:.3g} mm from the "
            f"middle of its straight edge, which is {bulge.max():.3g} times the edge's length (at "
            "most 0.5 is allowed). Use smaller triangles.",
            midpoints[triangle, edge],
            code="mesh_faulty",
        )
