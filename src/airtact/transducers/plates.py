"""The boards of an array as rigid bodies that reflect, with the elements in their faces."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from jaxtyping import Float64

from airtact.acoustics.scene import Obstacle, Scene
from airtact.checks import counted, in_mm, of_kind, within
from airtact.errors import InvalidInput
from airtact.geometry.pose import Pose
from airtact.geometry.surface import Surface
from airtact.transducers.boards import Board, kind_of_array
from airtact.transducers.layout import PhasedArray

THICKNESS = 8.7e-3
"""Distance from the faces of the transducers to the back of a board [m].

No maker states it for a whole board: it is the 7.1 mm of a transducer's case (Murata, data sheet of
the MA40S4S) on
1.6 mm of laminate, the usual thickness of a circuit board. What is on the back is left out."""

THINNEST, THICKEST = 0.5e-3, 50e-3
"""Thicknesses that may be given [m]."""

TOUCHING = 0.5e-3
"""Boards nearer than this are one body, with the seam between them filled [m]: no board fits better than that."""

FLUSH = 1e-6
"""Steps in the faces of joined boards up to this high are levelled [m]."""

IN_FACE = 1e-6
"""Farthest that an element stands off the face of its board [m]."""

BAFFLED = 0.5
"""Strength of a source in a rigid face over that in open air, for the same pressure in front of it.

The face mirrors the source, so the stated sensitivity, which is that of a transducer on its board,
would count twice.
"""


def reflecting_boards(array: PhasedArray, thickness: float = THICKNESS) -> tuple[Obstacle, ...]:
    """Build the boards of an array as rigid bodies, for a scene in which they reflect.

    Each board is a closed box of its maker's outline under the faces of its transducers, which are
    pistons in its front. Boards that touch or overlap are one body. Give the bodies to the scene
    together with all others; the array must then stand where it stood when they were made.

    Parameters
    ----------
    array : made of boards whose outline is known.
    thickness : from the faces of the transducers to the back of a board [m], 0.5 to 50 mm.

    Raises
    ------
    InvalidInput
        "wrong_kind": the array does not consist of one kind of board; "unknown_name": of boards whose outline the
        maker does not state; "out_of_range".

    Examples
    --------
    >>> from airtact.transducers.layout import autd3_board
    >>> board, = reflecting_boards(autd3_board())
    >>> np.round(1e3 * np.ptp(board.surface.vertices, axis=0), 3).tolist()
    [192.0, 151.4, 8.7]
    """
    of_kind(array, PhasedArray, "the array", "one such as autd3_board()")
    within(
        thickness,
        THINNEST,
        THICKEST,
        "the thickness of a board",
        "m",
        "is it in millimetres? Give metres.",
    )
    found = kind_of_array(array.positions, array.normals)
    if found is None:
        raise InvalidInput(
            f"{counted(len(array), 'element is', 'elements are')} not laid out like boards of one kind, so no board "
            "reflects: give an array of boards, or the bodies behind the elements as obstacles.",
            code="wrong_kind",
        )
    board, poses = found
    if board.outline is None:
        raise InvalidInput(
            f"{counted(len(poses), 'board', 'boards')} of {board.name} cannot reflect, because its outline is not "
            "stated by its maker: give the plates as obstacles.",
            code="unknown_name",
        )
    return tuple(
        Obstacle(surface, "sound_hard", board=True) for surface in _bodies(board, poses, thickness)
    )


def strength_in(scene: Scene, array: PhasedArray) -> float:
    """Return the factor of the strength of the elements of an array in a scene: 1, or ``BAFFLED`` in reflecting boards.

    Raises
    ------
    InvalidInput
        "not_supported": the scene has boards, and an element is not in the face of one.
    """
    of_kind(scene, Scene, "the scene", "Scene(medium, obstacles, frequency)")
    if not scene.boards:
        return 1.0
    boards = [scene.obstacles[index].surface for index in scene.boards]
    off = np.min([np.abs(one.depth(array.positions)) for one in boards], axis=0)
    wrong = np.flatnonzero(off > IN_FACE)
    if len(wrong):
        worst = int(off.argmax())
        raise InvalidInput(
            f"{len(wrong)} of {counted(len(array), 'element', 'elements')} stand off the scene's reflecting boards, "
            f"element {worst} at {in_mm(array.positions[worst])} by {1e3 * off[worst]:.3g} mm: make the boards of the "
            "array as it stands by reflecting_boards(array), and solve again.",
            array.positions[worst],
            code="not_supported",
        )
    return BAFFLED


def _bodies(board: Board, poses: Sequence[Pose], thickness: float) -> list[Surface]:
    """Make one closed surface of each board by itself, and of all that hang together."""
    from manifold3d import Error, Manifold, OpType

    plates = [_plate(board, pose, thickness) for pose in poses]
    near, wide = (
        [_plate(board, pose, thickness, grown) for pose in poses]
        for grown in (0.5 * TOUCHING, thickness)
    )
    seams = []
    for one, two in combinations(range(len(poses)), 2):
        if (near[one] ^ near[two]).is_empty():
            continue
        seams.append(wide[one] ^ wide[two] ^ Manifold.batch_hull([plates[one], plates[two]]))
    whole = Manifold.batch_boolean([*plates, *seams], OpType.Add)
    assert whole.status() == Error.NoError  # boxes
    return [_surface(part) for part in whole.as_original().simplify(FLUSH).decompose()]


def _plate(board: Board, pose: Pose, thickness: float, grown: float = 0.0):
    """Make the box of one board, larger than its outline by a margin [m] all round."""
    from manifold3d import Manifold

    middle = 0.5 * (board.positions.min(axis=0) + board.positions.max(axis=0))
    width, height = board.outline or (0.0, 0.0)
    size = np.array([width + 2 * grown, height + 2 * grown, thickness])
    low = middle - size * [0.5, 0.5, 1.0]
    moved = np.concatenate([pose.rotation, pose.translation[:, None]], axis=1)
    return Manifold.cube(size).translate(low).transform(moved)


def _surface(part) -> Surface:
    mesh = part.to_mesh64()
    vertices: Float64[np.ndarray, "vertices 3"] = np.asarray(mesh.vert_properties)[:, :3]
    return Surface(vertices, np.asarray(mesh.tri_verts).astype(np.int64), sharp_degrees=1.0)
