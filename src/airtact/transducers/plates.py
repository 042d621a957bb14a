"""The boards of an array as rigid, reflecting bodies with elements in their faces."""

from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float64

from airtact.acoustics.planes import Plane
from airtact.acoustics.scene import CONTACT, Obstacle, Scene
from airtact.errors import InvalidInput, in_mm, of_kind, within
from airtact.geometry.pose import Pose
from airtact.geometry.surface import Surface
from airtact.transducers.boards import Board, kind_of_array
from airtact.transducers.layout import PhasedArray

# Distance from the faces of the transducers to the back of a board [m]. No maker states it: a case
# is 7.1 mm high (Murata, data sheet of the MA40S4S), and a circuit board is usually 1.6 mm thick.
# Components on the back are ignored.
THICKNESS = 8.7e-3


def reflecting_boards(array: PhasedArray, thickness: float = THICKNESS) -> tuple[Obstacle, ...]:
    """Model the boards of an array as rigid bodies that reflect sound.

    Each board is a closed box with the outline stated by the maker, and its
    transducers are pistons in the front face. Boards that touch or overlap form a
    single body. Add the bodies to the obstacles of the scene, and do not move the
    array afterwards.

    Parameters
    ----------
    array : array of boards whose outline is known.
    thickness : distance from the faces of the transducers to the back of a board [m],
        0.5 to 50 mm.

    Raises
    ------
    InvalidInput
        If the array does not consist of boards of one kind, the maker does not state their outline,
        or the thickness is out of range.

    Examples
    --------
    >>> from airtact.transducers.layout import autd3_board
    >>> board, = reflecting_boards(autd3_board())
    >>> np.round(1e3 * np.ptp(board.surface.vertices, axis=0), 3).tolist()
    [192.0, 151.4, 8.7]
    """
    from manifold3d import Error, Manifold, OpType

    of_kind(array, PhasedArray, "the array", "one such as autd3_board()")
    slip = "is it in millimetres? Use metres."
    within(thickness, 0.5e-3, 50e-3, "the thickness of a board", "m", slip)
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
            f"boards of {board.name} cannot reflect, because the maker does not state their "
            "outline. Declare the plates as obstacles instead.",
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
    """Return which elements lie in a plane and radiate along its normal."""
    parallel = array.normals @ plane.normal > 1.0 - 1e-9
    return parallel & (np.abs(plane.height(array.positions)) < CONTACT)


def strength_in(scene: Scene, array: PhasedArray) -> Float64[np.ndarray, "elements"]:
    """Return the factor by which the strength of each element is multiplied in a scene.

    The factor is 1 in open air, and 1/2 in reflecting boards and for directional
    elements flush with a plane. A rigid face doubles a source, but the sensitivity
    already includes this doubling, because it is stated for a transducer in a
    board.

    Raises
    ------
    InvalidInput
        If the scene contains boards, but an element is not in the face of one.
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
