"""Placement of an array: checks in a scene, bounds of its pressure, and reflecting boards."""

from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float64, Real

from airtact import _kernels
from airtact.acoustics.scene import (
    CONTACT,
    Obstacle,
    Plane,
    Scene,
    check_before_planes,
    check_not_inside,
)
from airtact.errors import InvalidInput, counted, in_mm, of_kind, within
from airtact.geometry.distances import distances, nearest_pair
from airtact.geometry.pose import Pose
from airtact.geometry.surface import Surface
from airtact.transducers.boards import Board, kind_of_array
from airtact.transducers.element import check_pattern
from airtact.transducers.layout import PhasedArray

# Largest distance of an element from a focus or from the nearest body [m].
MAX_ELEMENT_DISTANCE = 10.0

# Distance of a point or body behind the face of each element [m]
Depths = Float64[np.ndarray, "elements"]


def check_placement(
    scene: Scene, array: PhasedArray, foci: Real[np.ndarray, "foci 3"] | None = None
) -> None:
    """Check that elements overlap neither each other nor bodies, and that they face the foci.

    Foci (F, 3) and bodies must be in front of directional elements. In scenes with
    reflecting boards, bodies may also be behind the elements, where the boards shade
    them.

    Raises
    ------
    InvalidInput
        If two elements are closer than the radius of their faces; if an element reaches into a body
        or is behind a plane; if a focus or body, or its image in a plane, is behind the face of a
        directional element; if an element is not in the face of a reflecting board; or if an
        argument is invalid.
    """
    of_kind(scene, Scene, "the scene", "Scene(medium, obstacles, frequency)")
    of_kind(array, PhasedArray, "the array", "one such as surrounding_box()")
    check_pattern(array.element, scene.wavenumber)
    check_apart(array)
    _check_outside_bodies(scene, array)
    check_before_planes(scene.planes, array.face_points.reshape(-1, 3), "face")
    if foci is not None:
        check_reach(array, foci)
    # The rigid faces of reflecting boards shade everything behind them.
    strength_in(scene, array)  # raises an error if an element is not on the boards
    if scene.boards or not array.element.directional:
        return
    for plane in planes_behind(scene, array):
        height = 1e3 * float(plane.height(array.positions).min())
        raise InvalidInput(
            f"the plane is {height:.3g} mm behind the elements, which only radiate forward. No "
            "sound reaches it: remove the plane.",
            code="behind_faces",
        )
    for index, obstacle in enumerate(scene.obstacles):
        _check_body(array, obstacle.surface.corners.reshape(-1, 3), f"body {index} reaches")
    # If the image of a body or focus in a plane were behind a face, the image of the element would
    # have to radiate backward.
    for plane in scene.planes:
        radiating = ~flush(plane, array)
        if foci is not None:
            for index, height in enumerate(_height(array, plane.image(foci))):
                behind = np.where(radiating, -height, 0.0)
                _check_behind(array, behind, f"the image of focus {index} in the plane is")
        for index, obstacle in enumerate(scene.obstacles):
            image = plane.image(obstacle.surface.corners.reshape(-1, 3))
            _check_body(array, image, f"the image of body {index} in the plane reaches", radiating)


def check_apart(array: PhasedArray) -> None:
    """Raise an error if two elements overlap, because a board placed twice doubles the pressure."""
    # A point has no radius, but real transducers are more than a tenth of a millimetre apart.
    smallest = max(array.element.radius, 1e-4)
    if array.spacing >= smallest:
        return
    from scipy.spatial import KDTree  # importing it takes 0.2 s

    first, second, distance = nearest_pair(array.positions)
    pairs = KDTree(array.positions).query_pairs(smallest, output_type="ndarray")
    raise InvalidInput(
        f"elements {first} and {second} are {1e3 * distance:.3g} mm apart, near "
        f"{in_mm(array.positions[first])}, and {len(np.unique(pairs))} of {len(array)} elements "
        "overlap. If a board or a file of positions is included twice, remove one of the two; "
        "otherwise move them apart.",
        array.positions[first],
        code="bodies_overlap",
    )


def overlapping_boards(
    array: PhasedArray,
) -> tuple[int, int, Float64[np.ndarray, "3"]] | None:
    """Return the indices of two overlapping boards and a point in both [m], or None.

    Overlaps of up to 6 mm at the edges are allowed, because the boards of ``surrounding_box``
    overlap by 5.7 mm.
    """
    kind = kind_of_array(array.positions, array.normals)
    if kind is None or kind[0].outline is None:
        return None
    board, poses = kind
    middle = 0.5 * (board.positions.min(axis=0) + board.positions.max(axis=0))
    half = 0.5 * np.array(kind[0].outline) - 6e-3
    # Take points 5 mm apart on the face of a board, and find those within another board.
    x, y = np.meshgrid(
        *(np.linspace(-length, length, int(2 * length / 5e-3) + 2) for length in half)
    )
    face = middle + np.stack([x.ravel(), y.ravel(), 0.0 * x.ravel()], axis=1)
    for first, pose in enumerate(poses):
        points = pose.apply(face)
        for second in range(len(poses)):
            if second == first:
                continue
            local = np.abs(poses[second].inverse().apply(points) - middle)
            inside = (local[:, :2] <= half).all(axis=1) & (local[:, 2] < 4e-3)
            if inside.any():
                return min(first, second), max(first, second), points[inside].mean(axis=0)
    return None


def _check_body(
    array: PhasedArray,
    vertices: Float64[np.ndarray, "vertices 3"],
    subject: str,
    elements: Bool[np.ndarray, "elements"] | None = None,
) -> None:
    middle = vertices.mean(axis=0)
    radius = np.sqrt(np.max(np.sum((vertices - middle) ** 2, axis=1)))
    # A bounding sphere usually suffices; convex hulls of fine meshes are slow.
    if _height(array, middle[None]).min() > radius:
        return
    from scipy.spatial import ConvexHull  # importing it takes 0.2 s

    # The vertex farthest behind a face belongs to the convex hull.
    behind = -_height(array, vertices[ConvexHull(vertices).vertices]).min(axis=0)
    _check_behind(array, behind if elements is None else np.where(elements, behind, 0.0), subject)


def planes_behind(scene: Scene, array: PhasedArray) -> tuple[Plane, ...]:
    """Return the planes behind all faces of a directional array, such as a table under boards."""
    if scene.boards or not array.element.directional:
        return ()
    return tuple(
        plane
        for plane in scene.planes
        if (array.normals @ plane.normal > 1.0 - 1e-6).all()
        and (plane.height(array.positions) > CONTACT).all()
    )


def _check_outside_bodies(scene: Scene, array: PhasedArray) -> None:
    depth = scene.depth(array.positions)
    # An array in millimetres would be metres away from everything else.
    if scene.obstacles:
        _check_metres(-depth, "the nearest body")
    reach = array.element.reach
    if reach == 0.0:
        check_not_inside(depth, array.positions, "element")
        return
    # Only evaluate faces close to a surface.
    near = np.flatnonzero(depth > -reach)
    if len(near):
        faces = scene.depth(array.face_points[near].reshape(-1, 3)).reshape(len(near), -1)
        depth[near] = np.maximum(depth[near], faces.max(axis=1))
    inside = int(np.sum(depth > CONTACT))
    if inside:
        deepest = int(depth.argmax())
        raise InvalidInput(
            f"the faces of {inside} of {len(array)} elements reach into a body. The face of "
            f"element {deepest} at {in_mm(array.positions[deepest])} is "
            f"{depth[deepest] * 1e3:.3g} mm inside; move the array or the body away.",
            code="bodies_overlap",
        )


def _check_metres(distances: Depths, place: str) -> None:
    farthest = int(distances.argmax())
    if distances[farthest] > MAX_ELEMENT_DISTANCE:
        raise InvalidInput(
            f"element {farthest} is {distances[farthest]:.4g} m from {place}, more than "
            f"{MAX_ELEMENT_DISTANCE:g} m: is the array or its pose in millimetres? Use metres.",
            code="not_in_metres",
        )


def check_reach(array: PhasedArray, foci: Real[np.ndarray, "foci 3"]) -> None:
    """Raise an error if a focus (F, 3) is over 10 m from an element or behind a directional one."""
    away = distances(foci, array.positions)
    worst = int(away.max(axis=1).argmax())
    _check_metres(away[worst], f"focus {worst}")
    if array.element.directional:
        behind = -_height(array, foci)
        worst = int(np.argmax(behind.max(axis=1)))
        _check_behind(array, behind[worst], f"focus {worst} is")


def _check_behind(array: PhasedArray, behind: Depths, subject: str) -> None:
    faces = np.flatnonzero(behind > CONTACT)
    if not len(faces):
        return
    kind = kind_of_array(array.positions, array.normals)
    board = f"board {faces[0] // len(kind[0])}" if kind and len(kind[1]) > 1 else "the array"
    raise InvalidInput(
        f"{subject} behind the faces of {counted(len(faces), 'element', 'elements')}, which only "
        f"radiate forward. The distance behind element {faces[0]} is "
        f"{behind[faces[0]] * 1e3:.3g} mm. Turn or move {board}.",
        code="behind_faces",
    )


def _height(
    array: PhasedArray, points: Real[np.ndarray, "points 3"]
) -> Float64[np.ndarray, "points elements"]:
    """Return the height [m] of each point in front of each face; negative behind the face."""
    return points @ array.normals.T - np.sum(array.positions * array.normals, axis=1)


def open_air_bound(
    array: PhasedArray, points: Real[np.ndarray, "points 3"], wavenumber: complex
) -> Float64[np.ndarray, "points"]:
    """Return the pressure [Pa] at points if all elements, at full scale, add up in phase there.

    The pressure is the sum of |g_e| · sensitivity · |Σ_j w_j e^{ikr}/r| over
    the elements e that face the point, with gain g_e and weights w_j. Without
    bodies, no drive can produce a higher pressure.

    Parameters
    ----------
    array : the transducers.
    points : (P, 3) points in the frame of the array [m].
    wavenumber : wavenumber k [rad/m]; its imaginary part is the absorption [Np/m].

    Returns
    -------
    (P,) peak pressures [Pa].
    """
    element = array.element
    strengths = element.sensitivity * np.abs(array.gains)
    targets = array.face_points.reshape(-1, 3)
    unit = np.ones((1, 1), dtype=np.complex128)
    bounds = np.empty(len(points))
    for index, point in enumerate(np.asarray(points, dtype=np.float64)):
        received = _kernels.apply_monopoles(
            targets, point[None], unit, complex(wavenumber), "float64"
        )
        # The sound of all elements arrives in phase, so the magnitudes add up.
        waves = np.abs(received.reshape(len(array), -1) @ element.weights)
        if element.directional:
            before = np.einsum("ed,ed->e", point - array.positions, array.normals) > 0.0
            waves = np.where(before, waves, 0.0)
        bounds[index] = strengths @ waves
    return bounds


def strongest_open_air(array: PhasedArray, wavenumber: complex) -> float:
    """Return the largest ``open_air_bound`` [Pa] over all points in front of the array."""
    # Points in front of the centre and of about 15 elements, at least 30 mm from every element.
    chosen = slice(None, None, max(1, len(array) // 15))
    middle = array.positions.mean(axis=0)
    axis = array.normals.mean(axis=0)
    points = [middle]
    for distance in (0.05, 0.1, 0.2):
        points.append(middle + distance * axis)
        points.extend(array.positions[chosen] + distance * array.normals[chosen])
        # At closer points, a single element dominates.
    clear = [
        point for point in points if np.linalg.norm(array.positions - point, axis=1).min() > 30e-3
    ]
    return float(open_air_bound(array, np.array(clear), wavenumber).max())


# Distance from the faces of the transducers to the back of a board [m]. No maker states it: a case
# is 7.1 mm high (Murata, data sheet of the MA40S4S), and a circuit board is usually 1.6 mm thick.
# Components on the back are ignored.
THICKNESS = 8.7e-3


def reflecting_boards(array: PhasedArray, thickness: float = THICKNESS) -> tuple[Obstacle, ...]:
    """Model the boards of an array as rigid bodies that reflect sound.

    Each board is a closed box with the outline stated by the maker, and its transducers are pistons
    in the front face. Boards less than 0.5 mm apart form a single body. Add the bodies to the
    obstacles of the scene, whose frame must be that of the array, and do not move the array
    afterwards.

    Parameters
    ----------
    array : array of boards of one kind whose outline is known, such as "autd3".
    thickness : distance from the faces of the transducers to the back of a board [m],
        0.0005 to 0.05; by default 8.7 mm.

    Returns
    -------
    A tuple of sound-hard ``Obstacle`` bodies, one for each board or group of boards that touch.

    Raises
    ------
    InvalidInput
        If the array does not consist of boards of one kind, if the maker does not state their
        outline, or if the thickness is outside its range.

    Examples
    --------
    >>> from airtact.transducers.layout import autd3_board
    >>> board, = reflecting_boards(autd3_board())
    >>> np.round(1e3 * np.ptp(board.surface.vertices, axis=0), 3).tolist()
    [192.0, 151.4, 8.7]
    """
    from manifold3d import Error, Manifold, OpType

    of_kind(array, PhasedArray, "the array", "one such as autd3_board()")
    within(thickness, 0.5e-3, 50e-3, "the thickness of a board", "m")
    boards = kind_of_array(array.positions, array.normals)
    if boards is None:
        raise InvalidInput(
            "the elements are not laid out like boards of one kind. Use an array of boards, or "
            "declare the bodies behind the elements as obstacles.",
            code="wrong_kind",
        )
    board, poses = boards
    if board.outline is None:
        raise InvalidInput(
            f"{board.name} boards cannot reflect sound, because the manufacturer does not state "
            "their outline. Declare the plates as obstacles instead.",
            code="unknown_name",
        )
    # Boards less than 0.5 mm apart form one body, with the gap between them filled.
    plates = [_plate(board, pose, thickness) for pose in poses]
    grown = [_plate(board, pose, thickness, 0.25e-3) for pose in poses]
    wide = [_plate(board, pose, thickness, thickness) for pose in poses]
    seams = []
    for first, second in combinations(range(len(poses)), 2):
        if not (grown[first] ^ grown[second]).is_empty():
            hull = Manifold.batch_hull([plates[first], plates[second]])
            seams.append(wide[first] ^ wide[second] ^ hull)
    union = Manifold.batch_boolean([*plates, *seams], OpType.Add)
    assert union.status() == Error.NoError  # boxes cannot fail
    # Simplifying removes steps of up to 1 µm in the faces.
    surfaces = []
    for part in union.as_original().simplify(1e-6).decompose():
        mesh = part.to_mesh64()
        vertices: Float64[np.ndarray, "vertices 3"] = np.asarray(mesh.vert_properties)[:, :3]
        triangles = np.asarray(mesh.tri_verts).astype(np.int64)
        # Boards are boxes, so every edge between two of their faces is sharp.
        surfaces.append(Surface(vertices, triangles, sharp_degrees=1.0))
    return tuple(Obstacle(surface, "sound_hard", board=True) for surface in surfaces)


def flush(plane: Plane, array: PhasedArray) -> Bool[np.ndarray, "elements"]:
    """Return a mask of the elements that lie in a plane and radiate along its normal."""
    parallel = array.normals @ plane.normal > 1.0 - 1e-9
    return parallel & (np.abs(plane.height(array.positions)) < CONTACT)


def strength_in(scene: Scene, array: PhasedArray) -> Float64[np.ndarray, "elements"]:
    """Return the factor by which the strength of each element is multiplied in a scene.

    The factor is 1 in open air, and 1/2 for elements in reflecting boards and for directional
    elements flush with a plane. A rigid face doubles the pressure of a source in it, but the
    sensitivity already includes this doubling, because it is stated for a transducer in a board.

    Raises
    ------
    InvalidInput
        If the scene contains boards, but an element does not lie in the face of any board.
    """
    of_kind(scene, Scene, "the scene", "Scene(medium, obstacles, frequency)")
    if not scene.boards:
        strengths = np.ones(len(array))
        if array.element.directional:
            for plane in scene.planes:
                strengths[flush(plane, array)] = 0.5
        return strengths
    surfaces = [scene.obstacles[index].surface for index in scene.boards]
    # Distance to the nearest board; the face of an element is in the front of its own board.
    off = np.min([np.abs(surface.depth(array.positions)) for surface in surfaces], axis=0)
    wrong = int(np.sum(off > 1e-6))  # metres
    if wrong:
        worst = int(off.argmax())
        raise InvalidInput(
            f"{wrong} of {len(array)} elements do not lie on the scene's reflecting boards: "
            f"element {worst} at {in_mm(array.positions[worst])} is {1e3 * off[worst]:.3g} mm "
            "away. Build the boards with reflecting_boards(array) from this array, and solve "
            "again.",
            array.positions[worst],
            code="not_supported",
        )
    return np.full(len(array), 0.5)


def _plate(board: Board, pose: Pose, thickness: float, margin: float = 0.0):
    """Build the box of a board, larger than its outline by a margin [m] on all sides."""
    from manifold3d import Manifold

    middle = 0.5 * (board.positions.min(axis=0) + board.positions.max(axis=0))
    width, height = board.outline or (0.0, 0.0)
    size = np.array([width + 2 * margin, height + 2 * margin, thickness])
    # The front of the box is at z = 0, in the plane of the transducers' faces.
    low = middle - size * [0.5, 0.5, 1.0]
    motion = np.concatenate([pose.rotation, pose.translation[:, None]], axis=1)
    return Manifold.cube(size).translate(low).transform(motion)
