"""Checks of the placement of an array in a scene, and bounds on its pressure in open air."""

import numpy as np
from jaxtyping import Bool, Float64, Real
from scipy.spatial import ConvexHull, KDTree
from scipy.spatial.distance import cdist

from airtact import _kernels
from airtact.acoustics.planes import Plane, check_before_planes
from airtact.acoustics.scene import CONTACT, Scene, check_not_inside
from airtact.errors import InvalidInput, counted, in_mm, of_kind
from airtact.transducers.boards import kind_of_array
from airtact.transducers.element import check_pattern
from airtact.transducers.layout import PhasedArray
from airtact.transducers.plates import flush, strength_in

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
    for plane in scene.planes:
        _check_images(plane, scene, array, foci)


def check_apart(array: PhasedArray) -> None:
    """Raise an error if two elements overlap: a board placed twice would double the pressure."""
    # A point has no radius, but real transducers are more than a tenth of a millimetre apart.
    smallest = max(array.element.radius, 1e-4)
    if array.spacing >= smallest:
        return
    distances, neighbours = map(np.asarray, KDTree(array.positions).query(array.positions, k=2))
    first = int(distances[:, 1].argmin())
    distance = distances[first, 1]
    second = int(next(index for index in neighbours[first] if index != first))
    overlapping = int(np.sum(distances[:, 1] < smallest))
    raise InvalidInput(
        f"elements {first} and {second} are {1e3 * distance:.3g} mm apart at "
        f"{in_mm(array.positions[first])}, and {overlapping} of {len(array)} elements overlap: is "
        "a board or a list included twice? Move or remove one of them.",
        array.positions[first],
        code="bodies_overlap",
    )


def overlapping_boards(
    array: PhasedArray,
) -> tuple[int, int, Float64[np.ndarray, "3"]] | None:
    """Return the indices of two overlapping boards and a point in both [m], or None.

    Overlaps of up to 6 mm at the edges are allowed, because those in the paper's box are 5.7 mm.
    """
    kind = kind_of_array(array.positions, array.normals)
    if kind is None or kind[0].outline is None:
        return None
    board, poses = kind
    middle = 0.5 * (board.positions.min(axis=0) + board.positions.max(axis=0))
    half = 0.5 * np.array(kind[0].outline) - 6e-3
    # Take points 5 mm apart on the face of a board, and find those within another board.
    axes = [np.linspace(-length, length, int(2 * length / 5e-3) + 2) for length in half]
    x, y = np.meshgrid(*axes)
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
    # The vertex farthest behind a face belongs to the convex hull.
    behind = -_height(array, vertices[ConvexHull(vertices).vertices]).min(axis=0)
    _check_behind(array, behind if elements is None else np.where(elements, behind, 0.0), subject)


def _check_images(
    plane: Plane, scene: Scene, array: PhasedArray, foci: Real[np.ndarray, "foci 3"] | None
) -> None:
    """Raise an error if the image of a body or focus in a plane is behind a face."""
    # If it is, the image of the element would have to radiate backward.
    radiating = ~flush(plane, array)
    if foci is not None:
        for index, height in enumerate(_height(array, plane.image(foci))):
            behind = np.where(radiating, -height, 0.0)
            _check_behind(array, behind, f"the image of focus {index} in the plane is")
    for index, obstacle in enumerate(scene.obstacles):
        image = plane.image(obstacle.surface.corners.reshape(-1, 3))
        _check_body(array, image, f"the image of body {index} in the plane reaches", radiating)


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
    """Raise an error if a focus (F, 3) is over 10 m away or behind a directional element."""
    distances = cdist(foci, array.positions)
    worst = int(distances.max(axis=1).argmax())
    _check_metres(distances[worst], f"focus {worst}")
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
        f"radiate forward: {behind[faces[0]] * 1e3:.3g} mm behind element {faces[0]}. Turn or "
        f"move {board}.",
        code="behind_faces",
    )


def _height(
    array: PhasedArray, points: Real[np.ndarray, "points 3"]
) -> Float64[np.ndarray, "points elements"]:
    """Return the height [m] of each point in front of each face; negative behind the face."""
    return points @ array.normals.T - np.sum(array.positions * array.normals, axis=1)


def open_air_bound(
    array: PhasedArray, points: Real[np.ndarray, "points 3"], wavenumber: float
) -> Float64[np.ndarray, "points"]:
    """Return the peak pressure [Pa] at points if all elements are at full scale and in phase there.

    The pressure is the sum of |g_e| · sensitivity · |Σ_j w_j e^{ikr}/r| over
    the elements e that face the point, with gain g_e and weights w_j. Without
    bodies, no drive can produce a higher pressure.

    Parameters
    ----------
    array : the transducers.
    points : (P, 3) points in the frame of the array [m].
    wavenumber : wavenumber k [rad/m].

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


def strongest_open_air(array: PhasedArray, wavenumber: float) -> float:
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
