"""Where the transducers of an array stand and where they look; the AUTD3 board and arrays made of it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Real

from airtact.conventions import InvalidInput
from airtact.scene.guards import counted, fixed, of_kind, points_of, real_numbers
from airtact.scene.pose import Pose
from airtact.scene.printing import in_short
from airtact.transducers.element import Element, monopole

WIDEST = 10.0
"""Largest extent of an array [m]."""

PITCH = 10.16e-3
"""Distance of neighbouring transducers on an AUTD3 board [m]."""

COLUMNS, ROWS = 18, 14
MISSING = ((1, 1), (2, 1), (16, 1))
"""Cells (column, row) of the AUTD3 board's grid that hold no transducer."""

OUTLINE = (192.0e-3, 151.4e-3)
"""Width (along x) and height (along y) of an AUTD3 board [m]."""


@dataclass(frozen=True, eq=False)
class PhasedArray:
    """Transducers in the air: one kind of element at many places.

    Attributes
    ----------
    positions : (E, 3) centres of the elements' faces [m].
    normals : (E, 3) directions in which they radiate; stored as unit vectors.
    element : what stands at every position; a monopole unless given.
    tangents : (E, 3) direction of each element's own x axis, which the points of its face turn with; stored as unit
        vectors. Chosen across the normal where not given.

    Raises
    ------
    InvalidInput
        If there is no element, shapes do not match, a number is not finite, the elements span over 10 m, a normal is
        zero, or a tangent is not across its normal.
    """

    positions: Float64[np.ndarray, "elements 3"]
    normals: Float64[np.ndarray, "elements 3"]
    element: Element
    tangents: Float64[np.ndarray, "elements 3"]

    __repr__ = in_short

    def __init__(
        self,
        positions: Real[np.ndarray, "elements 3"],
        normals: Real[np.ndarray, "normals 3"],
        element: Element | None = None,
        tangents: Real[np.ndarray, "tangents 3"] | None = None,
    ) -> None:
        places = points_of(positions, "element positions")
        spread = float(np.ptp(places, axis=0).max())
        if spread > WIDEST:
            raise InvalidInput(
                f"the elements span {spread:.4g} m, more than {WIDEST:g} m: is this in millimetres? Give metres."
            )
        if element is not None:
            of_kind(element, Element, "what stands at every position", "monopole() or piston(radius)")
        unit_normals = _unit(_as_many(normals, places, "normal"), "normal")
        if tangents is None:
            tangents = _crosswise(unit_normals)
        unit_tangents = _unit(_as_many(tangents, places, "tangent"), "tangent")
        slant = np.abs(np.sum(unit_normals * unit_tangents, axis=1))
        if slant.max() > 1e-5:
            first = int(np.argmax(slant))
            raise InvalidInput(
                f"the tangent of element {first} must be across its normal, but their cosine is {slant[first]:g}."
            )
        object.__setattr__(self, "positions", places)
        object.__setattr__(self, "normals", unit_normals)
        object.__setattr__(self, "element", monopole() if element is None else element)
        object.__setattr__(self, "tangents", _unit(_across(unit_tangents, unit_normals), "tangent"))

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def face_points(self) -> Float64[np.ndarray, "elements face 3"]:
        """(E, Q, 3) points on the faces of the elements [m]."""
        frames = np.stack([self.tangents, np.cross(self.normals, self.tangents), self.normals], axis=1)
        return self.positions[:, None, :] + np.einsum("qi,eij->eqj", self.element.points, frames)

    def moved(self, pose: Pose) -> "PhasedArray":
        """Move the array rigidly: positions x become pose.apply(x), and the faces turn with it."""
        of_kind(pose, Pose, "the motion of an array", "Pose(rotation, translation)")
        return PhasedArray(
            pose.apply(self.positions), pose.rotate(self.normals), self.element, pose.rotate(self.tangents)
        )

    def seen_from(self, pose: Pose) -> "PhasedArray":
        """Bring the array into the obstacles' frame.

        Parameters
        ----------
        pose : maps the obstacles' frame to the array's: where the hand is, seen from the array.

        Returns
        -------
        The array moved by the inverse of the pose: moving the hand one way is moving the array the other way.
        """
        of_kind(pose, Pose, "where the hand is", "Pose(rotation, translation)")
        return self.moved(pose.inverse())


def _as_many(
    given: Real[np.ndarray, "directions 3"], places: Float64[np.ndarray, "elements 3"], name: str
) -> Float64[np.ndarray, "elements 3"]:
    """Return one direction for each element, or refuse another number of them."""
    vectors = real_numbers(given, f"element {name}s")
    if vectors.ndim != 2 or vectors.shape[1] != 3:
        raise InvalidInput(f"element {name}s have shape {vectors.shape}, but they need ({len(places)}, 3).")
    if len(vectors) != len(places):
        need = counted(len(places), "position needs", "positions need")
        raise InvalidInput(f"{need} as many {name}s, not {len(vectors)}.")
    return vectors


def _unit(vectors: Real[np.ndarray, "elements 3"], name: str) -> Float64[np.ndarray, "elements 3"]:
    """Return the directions of some vectors; refuse zero and what is not finite."""
    lengths = np.linalg.norm(np.asarray(vectors, dtype=np.float64), axis=1)
    bad = ~np.isfinite(lengths) | (lengths < 1e-12)
    if bad.any():
        first = int(np.argmax(bad))
        count = counted(int(bad.sum()), "element", "elements")
        raise InvalidInput(
            f"the {name}s of {count} have no direction, first that of element {first}: {vectors[first]}."
        )
    return fixed(vectors / lengths[:, None])


def _across(
    vectors: Float64[np.ndarray, "elements 3"], normals: Float64[np.ndarray, "elements 3"]
) -> Float64[np.ndarray, "elements 3"]:
    """Return what is left of each vector across its normal."""
    return vectors - np.sum(vectors * normals, axis=1, keepdims=True) * normals


def _crosswise(normals: Float64[np.ndarray, "elements 3"]) -> Float64[np.ndarray, "elements 3"]:
    """Choose a vector across each normal: from x, or from y where the normal is near x."""
    axes = np.where(np.abs(normals[:, :1]) < 0.9, np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
    return _across(axes, normals)


def autd3_board(pose: Pose | None = None, element: Element | None = None) -> PhasedArray:
    """Place the 249 transducers of one AUTD3 board, in its own order (read in the AUTD3 SDK).

    A grid of 18 (x) by 14 (y) cells, 10.16 mm apart; the cells (1, 1), (2, 1) and (16, 1) are empty. The index runs
    along x fastest. The origin is transducer 0; the board radiates along +z.

    Parameters
    ----------
    pose : maps the board's frame to the array's; the identity unless given.
    element : what stands at every position; a monopole unless given.

    Examples
    --------
    >>> board = autd3_board()
    >>> len(board), np.round(board.positions[19] * 1e3, 2).tolist()
    (249, [30.48, 10.16, 0.0])
    """
    cells = [(column, row) for row in range(ROWS) for column in range(COLUMNS) if (column, row) not in MISSING]
    positions = np.zeros((len(cells), 3))
    positions[:, :2] = PITCH * np.array(cells)
    ones = np.ones((len(cells), 1))
    board = PhasedArray(positions, ones * [0.0, 0.0, 1.0], element, ones * [1.0, 0.0, 0.0])
    return board if pose is None else board.moved(pose)


def _centred_board(element: Element | None) -> PhasedArray:
    """Place an AUTD3 board with the middle of its grid, which is that of its outline, at the origin."""
    middle = np.array([COLUMNS - 1, ROWS - 1, 0.0]) * PITCH / 2
    return autd3_board(Pose(np.eye(3), -middle), element)


def surrounding_box(element: Element | None = None) -> PhasedArray:
    """Build the paper's array (its section 3.3): four AUTD3 boards, 996 transducers, around 14 x 14 x 18 cm.

    The origin is the centre of the box and z its long axis. The faces stand at x = +70 mm, x = -70 mm, y = +70 mm and
    y = -70 mm, in that order, each a board centred on its face and radiating inwards, in the board's own order. The
    board's x axis (18 elements) runs along +z on every face, so its y axis (14 elements) runs along +y, -y, -x and +x:
    each face is the first one turned about z. The outlines of real boards would overlap at the corners by 11.4 mm, as
    idealised in the paper.

    Parameters
    ----------
    element : what stands at every position; a monopole unless given, as in the paper (its section 4.1).

    Examples
    --------
    >>> len(surrounding_box())
    996
    """
    board = _centred_board(element)
    stand_up = Pose(np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]), np.array([70e-3, 0.0, 0.0]))
    turns = [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)]
    faces = []
    for cosine, sine in turns:
        about_z = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        faces.append(board.moved(Pose(about_z, np.zeros(3)) @ stand_up))
    return join(faces)


def flat_boards(rows: int = 2, columns: int = 2, element: Element | None = None) -> PhasedArray:
    """AUTD3 boards edge to edge in the plane z = 0, centred on the origin, radiating to +z.

    Columns of boards run along x, 192.0 mm apart, and rows along y, 151.4 mm apart (the outline of a board). Boards
    follow one another along x first, each in its own order.

    Parameters
    ----------
    rows, columns : how many boards along y and along x.
    element : what stands at every position; a monopole unless given.

    Raises
    ------
    InvalidInput
        If there is no board, or they span over 10 m.

    Examples
    --------
    >>> len(flat_boards(2, 2))
    996
    """
    for name, count in (("rows", rows), ("columns", columns)):
        if not isinstance(count, int | np.integer):
            raise InvalidInput(f"flat boards need a whole number of {name}, not {count!r}.")
    if rows < 1 or columns < 1:
        raise InvalidInput(f"flat boards need at least 1 row and 1 column, not {rows} and {columns}.")
    width, height = OUTLINE
    extent = max(rows * height, columns * width)
    if extent > WIDEST:
        raise InvalidInput(f"{rows} by {columns} flat boards span {extent:.4g} m, more than {WIDEST:g} m; take fewer.")
    board = _centred_board(element)
    places = [
        np.array([(column - (columns - 1) / 2) * width, (row - (rows - 1) / 2) * height, 0.0])
        for row in range(rows)
        for column in range(columns)
    ]
    return join([board.moved(Pose(np.eye(3), place)) for place in places])


def join(arrays: Sequence[PhasedArray]) -> PhasedArray:
    """One array of several with the same element, in the order given.

    Raises
    ------
    InvalidInput
        If there is no array, or the elements differ.
    """
    if not isinstance(arrays, Sequence):
        raise InvalidInput(f"joining needs a list of 1 or more arrays, not a {type(arrays).__name__}.")
    if len(arrays) == 0:
        raise InvalidInput("joining needs at least 1 array, not 0.")
    for index, array in enumerate(arrays):
        of_kind(array, PhasedArray, f"array {index}", "such as autd3_board(pose)")
        if not array.element.same_as(arrays[0].element):
            raise InvalidInput(f"array {index} has another element than array 0: only equal elements can be joined.")
    return PhasedArray(
        np.concatenate([array.positions for array in arrays]),
        np.concatenate([array.normals for array in arrays]),
        arrays[0].element,
        np.concatenate([array.tangents for array in arrays]),
    )
