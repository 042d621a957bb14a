"""Positions and normals of the transducers of an array, arrays made of boards, and known arrays."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Complex128, Float64, Num, Real

from airtact.errors import (
    InvalidInput,
    Vector,
    check_choice,
    check_finite,
    complex_numbers,
    counted,
    fixed,
    of_kind,
    one_line,
    point_of,
    points_of,
    positive,
    real_numbers,
    sides_in_mm,
)
from airtact.geometry.distances import nearest_pair
from airtact.geometry.pose import Pose
from airtact.transducers.boards import MURATA_RADIUS, Board, board_named
from airtact.transducers.element import Element, monopole, piston

# Largest extent of an array [m]
MAX_ARRAY_EXTENT = 10.0


@dataclass(frozen=True, eq=False)
class PhasedArray:
    """An array of transducers: one kind of element at many positions.

    All coordinates are in one frame, which functions call the array's frame; ``moved`` and
    ``seen_from`` return the array in other frames. The order of the elements is the order of the
    amplitudes in a ``Drive``.

    Attributes
    ----------
    positions : (E, 3) centres of the elements' faces [m].
    normals : (E, 3) directions in which the elements radiate, vectors of any length above zero;
        stored as unit vectors. By default, +z for all elements.
    element : kind of transducer at every position. By default, a piston with a radius of 4.5 mm
        that radiates only forward; without normals, a monopole.
    tangents : (E, 3) directions of the elements' x axes, which orient the points on
        their faces; stored as unit vectors. By default, any directions perpendicular to
        the normals.
    gains : (E,) complex gain by which the pressure of each element is multiplied, for the phasor p
        in Re[p e^{−iωt}]: 1 by default, 0 for a dead element. See ``calibrated``.

    Raises
    ------
    InvalidInput
        If there is no element, if shapes do not match, if a number is not finite, if the elements
        span more than 10 m, if a normal is zero, if a tangent is not perpendicular to its normal,
        or if all elements are dead.
    """

    positions: Float64[np.ndarray, "elements 3"]
    normals: Float64[np.ndarray, "elements 3"]
    element: Element
    tangents: Float64[np.ndarray, "elements 3"]
    gains: Complex128[np.ndarray, "elements"]

    def __repr__(self) -> str:
        dead = int(np.sum(self.gains == 0.0))
        size = counted(len(self), "element", "elements")
        calibrated = np.any((self.gains != 1.0) & (self.gains != 0.0))
        return one_line(
            self,
            f"{size}, {dead} dead" if dead else size,
            self.element.kind,
            sides_in_mm(self.positions),
            "calibrated" if calibrated else "",
        )

    def __init__(
        self,
        positions: Real[np.ndarray, "elements 3"],
        normals: Real[np.ndarray, "normals 3"] | None = None,
        element: Element | None = None,
        tangents: Real[np.ndarray, "tangents 3"] | None = None,
        gains: Num[np.ndarray, "gains"] | None = None,
    ) -> None:
        positions = points_of(positions, "element positions")
        spread = float(np.ptp(positions, axis=0).max())
        if spread > MAX_ARRAY_EXTENT:
            raise InvalidInput(
                f"the elements span {spread:.4g} m, more than {MAX_ARRAY_EXTENT:g} m: are they in "
                "millimetres? Use metres.",
                code="not_in_metres",
            )
        if element is None:
            # Murata's transducers are the most common.
            element = monopole() if normals is None else piston(MURATA_RADIUS, points=12)
        if normals is None:
            normals = np.tile([0.0, 0.0, 1.0], (len(positions), 1))
        of_kind(element, Element, "the element of an array", "monopole() or piston(radius)")
        normals = _unit(_as_many(normals, positions, "normal"), "normal")
        if tangents is None:
            # Perpendicular to each normal, starting from x, or from y if the normal is close to x.
            along_x = np.abs(normals[:, :1]) >= 0.9
            tangents = _across(np.where(along_x, [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]), normals)
        tangents = _unit(_as_many(tangents, positions, "tangent"), "tangent")
        # Both are unit vectors, so this is the cosine of the angle between them.
        slant = np.abs(np.einsum("ed,ed->e", normals, tangents))
        if slant.max() > 1e-5:
            first = int(np.argmax(slant))
            raise InvalidInput(
                f"the tangent of element {first} must be perpendicular to its normal, but the "
                f"cosine of the angle between them is {slant[first]:g}.",
                code="out_of_range",
            )
        gains = complex_numbers(
            np.ones(len(positions)) if gains is None else gains, "element gains"
        )
        if gains.shape != (len(positions),):
            raise InvalidInput(
                f"element gains must have shape ({len(positions)},), not {gains.shape}.",
                code="wrong_shape",
            )
        check_finite(gains, "element gains")
        if not gains.any():
            raise InvalidInput(
                "the gains of all elements are 0, so nothing would be emitted. Use a nonzero gain "
                "for at least one element.",
                code="all_zero",
            )
        gains.flags.writeable = False
        # ``vars`` bypasses the frozen dataclass. The tangents become exactly perpendicular.
        vars(self).update(
            positions=positions,
            normals=normals,
            element=element,
            tangents=_unit(_across(tangents, normals), "tangent"),
            gains=gains,
        )

    def __len__(self) -> int:
        return len(self.positions)

    @cached_property
    def face_points(self) -> Float64[np.ndarray, "elements face 3"]:
        """(E, Q, 3) points on the faces of the elements [m]."""
        axes = [self.tangents, np.cross(self.normals, self.tangents), self.normals]
        offsets = np.einsum("qi,eij->eqj", self.element.points, np.stack(axes, axis=1))
        return fixed(self.positions[:, None, :] + offsets)

    @cached_property
    def spacing(self) -> float:
        """Smallest distance [m] between two elements, or infinity for a single element."""
        return nearest_pair(self.positions)[2] if len(self) > 1 else np.inf

    def moved(self, pose: Pose) -> "PhasedArray":
        """Return the array after a rigid motion, in which positions x become pose.apply(x)."""
        of_kind(pose, Pose, "the motion of an array", "Pose(rotation, translation)")
        # Skip the checks: a rigid motion requires none, and a moving hand requires many motions per
        # second. Normalise the directions, so that rounding errors do not accumulate.
        moved = object.__new__(PhasedArray)
        normals = _unit(pose.rotate(self.normals), "normal")
        vars(moved).update(
            positions=fixed(pose.apply(self.positions)),
            normals=normals,
            element=self.element,
            tangents=_unit(_across(pose.rotate(self.tangents), normals), "tangent"),
            gains=self.gains,
            spacing=self.spacing,
        )
        return moved

    def facing(self, point: Vector, direction: Vector, distance: float) -> "PhasedArray":
        """Return the array moved to a given distance from a point and turned to radiate toward it.

        Parameters
        ----------
        point : (3,) point, such as a focus [m].
        direction : (3,) vector of any length above zero, in the direction from the point to the
            centre of the array.
        distance : distance from the point to the centre of the array [m].

        Raises
        ------
        InvalidInput
            If the array has no front because its elements radiate in all directions, if the
            direction is zero, or if the distance is not above zero.

        Examples
        --------
        >>> board = autd3_board().facing((0, 0, 0), direction=(-1, 0, 0), distance=0.2)
        >>> (np.round(board.positions.mean(axis=0), 9) + 0.0).tolist()
        [-0.2, 0.0, 0.0]
        >>> np.round(board.normals[0], 9).tolist()
        [1.0, 0.0, 0.0]
        """
        distance = positive(distance, "the distance of an array", "m")
        outward = _unit(point_of(direction, "the direction to an array")[None], "direction")[0]
        front = self.normals.mean(axis=0)
        # The length of the mean unit normal is 0 for a box and 0.5 for a hemispherical bowl.
        if np.linalg.norm(front) < 0.3:
            raise InvalidInput(
                f"the normals of {counted(len(self), 'element', 'elements')} point in all "
                "directions, so the array has no front; use moved(pose).",
                code="misplaced",
            )
        front = front / np.linalg.norm(front)
        turned = self.moved(Pose.between(front, -outward))
        middle = point_of(point, "the point in front of an array") + distance * outward
        return turned.moved(Pose(np.eye(3), middle - turned.positions.mean(axis=0)))

    def calibrated(self, gains: Num[np.ndarray, "gains"]) -> "PhasedArray":
        """Return the array with a gain for each element, which transfer matrices take into account.

        Parameters
        ----------
        gains : (E,) complex gain of each element; 0 for a dead element. They replace
            earlier gains.

        Raises
        ------
        InvalidInput
            If the number of gains is wrong, if a gain is not finite, or if all gains are 0.
        """
        return PhasedArray(self.positions, self.normals, self.element, self.tangents, gains)

    def seen_from(self, pose: Pose) -> "PhasedArray":
        """Return the array in the frame of the obstacles.

        Parameters
        ----------
        pose : pose of the hand in the array's frame; it maps the frame of the obstacles to that
            of the array.

        Returns
        -------
        A new array, moved by the inverse of the pose.
        """
        of_kind(pose, Pose, "the pose of the hand", "Pose(rotation, translation)")
        return self.moved(pose.inverse())


def _as_many(
    directions: Real[np.ndarray, "directions 3"],
    positions: Float64[np.ndarray, "elements 3"],
    name: str,
) -> Float64[np.ndarray, "elements 3"]:
    vectors = real_numbers(directions, f"element {name}s")
    if vectors.shape != positions.shape:
        raise InvalidInput(
            f"element {name}s have shape {vectors.shape}, but must have {positions.shape}.",
            code="wrong_shape",
        )
    return vectors


def _unit(vectors: Real[np.ndarray, "elements 3"], name: str) -> Float64[np.ndarray, "elements 3"]:
    lengths = np.sqrt(np.einsum("ed,ed->e", vectors, vectors, dtype=np.float64))
    bad = ~np.isfinite(lengths) | (lengths < 1e-12)
    if bad.any():
        first = int(np.argmax(bad))
        raise InvalidInput(
            f"the {name} of element {first} is {vectors[first]} and has no direction. Use a "
            "nonzero vector.",
            code="all_zero",
        )
    return fixed(vectors / lengths[:, None])


def _across(
    vectors: Float64[np.ndarray, "elements 3"], normals: Float64[np.ndarray, "elements 3"]
) -> Float64[np.ndarray, "elements 3"]:
    return vectors - np.einsum("ed,ed->e", vectors, normals)[:, None] * normals


def board_array(
    board: str = "autd3", poses: Sequence[Pose] | None = None, element: Element | None = None
) -> PhasedArray:
    """Return an array of boards of one kind.

    In its own frame, a board lies in the plane z = 0, with its rows along x, and radiates toward
    +z. The origin is the first element of an "autd3" board, and the centre of any other board.

    Parameters
    ----------
    board : name of the kind: "autd3", "sonicsurface", "nano16" or "openmpd". The command ``airtact
        boards`` describes them.
    poses : list of one ``Pose`` for each board, which maps the board's frame to the array's frame.
        By default, a single board whose frame is the array's frame.
    element : kind of transducer; by default, the piston of the board (see
        ``Board.radius``).

    Returns
    -------
    A ``PhasedArray`` with the elements of the first board in the order of ``Board.positions``, then
    those of the second, and so on.

    Raises
    ------
    InvalidInput
        If there is no such board, or the list of poses is empty.

    Examples
    --------
    >>> facing_down = Pose.turn((1, 0, 0), np.pi, (0, 0, 0.2))
    >>> len(board_array("sonicsurface", [Pose.identity(), facing_down]))
    512
    """
    flat = _flat(board_named(board), element)
    of_kind(poses, list | tuple | None, "the list of poses", "a list of Pose, one for each board")
    return flat if poses is None else join([flat.moved(pose) for pose in poses])


def _flat(board: Board, element: Element | None) -> PhasedArray:
    ones = np.ones((len(board), 1))
    element = piston(board.radius, points=12) if element is None else element
    return PhasedArray(board.positions, ones * [0.0, 0.0, 1.0], element, ones * [1.0, 0.0, 0.0])


def autd3_board(pose: Pose | None = None, element: Element | None = None) -> PhasedArray:
    """Return an array of one AUTD3 board: 249 transducers in the order of the AUTD3 SDK.

    The board is a grid of 18 (x) by 14 (y) cells, 10.16 mm apart; the cells (1, 1), (2, 1) and
    (16, 1), counted from 0, are empty. The index increases fastest along x. The origin of the
    board's frame is at transducer 0 in cell (0, 0), and the board radiates toward +z.

    Parameters
    ----------
    pose : ``Pose`` that maps the board's frame to that of the array; by default, the identity.
    element : kind of transducer, such as ``monopole()``; by default, a piston with the radius of
        the board's transducers, ``Board.radius``.

    Returns
    -------
    A ``PhasedArray`` of 249 elements.

    Examples
    --------
    >>> board = autd3_board()
    >>> len(board), np.round(board.positions[19] * 1e3, 2).tolist()
    (249, [30.48, 10.16, 0.0])
    """
    return board_array("autd3", None if pose is None else [pose], element)


def _centred(board: Board, element: Element | None) -> PhasedArray:
    middle = (board.positions.min(axis=0) + board.positions.max(axis=0)) / 2
    return _flat(board, element).moved(Pose(np.eye(3), -middle))


def surrounding_box(element: Element | None = None, board: str | None = None) -> PhasedArray:
    """Return an array of four boards that form the sides of a box and radiate inward.

    By default, it is the array of Inoue, Makino and Shinoda (2014), section 3.3: AUTD3 boards
    around a box of 14 x 14 x 18 cm. The origin is the centre of the box, and z its long axis. The
    faces are at x = +70 mm, x = -70 mm, y = +70 mm and y = -70 mm, in this order. The elements of
    a board are centred on its face and keep their order. The board's x axis (18 elements) runs
    along +z on every face, so its y axis (14 elements) runs along +y, -y, -x and +x: each face is
    the first one rotated about z. This box is 140 mm wide, but a real board is 151.4 mm wide and
    would extend 5.7 mm beyond its neighbours at each corner. Use ``board="autd3"`` for a box into
    which real boards fit.

    Parameters
    ----------
    element : kind of transducer; by default, the piston of the board (see ``Board.radius``). Inoue,
        Makino and Shinoda use ``monopole()`` (section 4.1).
    board : name of a kind of board, "autd3" or "sonicsurface". Each face is then half the board's
        height from the centre (75.7 mm for "autd3"), so that thin boards touch along the edges that
        are parallel to z. The default is the box of Inoue, Makino and Shinoda.

    Returns
    -------
    A ``PhasedArray`` with four times the elements of a board, face by face.

    Raises
    ------
    InvalidInput
        If there is no such board, or the size of the board is unknown (nano16, openmpd).

    Examples
    --------
    >>> len(surrounding_box())
    996
    """
    kind = board_named("autd3" if board is None else board)
    if kind.outline is None:
        raise InvalidInput(
            f"the size of {kind.name} boards is unknown, so they cannot form a box. Use another "
            "kind of board.",
            code="unknown_name",
        )
    distance = 70e-3 if board is None else kind.outline[1] / 2
    flat = _centred(kind, element)
    stand_up = Pose(
        np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),
        np.array([distance, 0.0, 0.0]),
    )
    # Rotate about z to +x, −x, +y and −y. Exact cosines and sines avoid rounding errors.
    turns = [
        np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        for cosine, sine in ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))
    ]
    return join([flat.moved(Pose(turn, np.zeros(3)) @ stand_up) for turn in turns])


def flat_boards(rows: int = 2, columns: int = 2, element: Element | None = None) -> PhasedArray:
    """Return a grid of AUTD3 boards in the plane z = 0, centred on the origin, facing +z.

    Boards touch edge to edge: they are spaced by the size of a board, 192.0 mm along x
    and 151.4 mm along y, and are not turned. Boards are numbered along x first, starting at the
    smallest x and y, and the elements of each board keep their order.

    Parameters
    ----------
    rows, columns : number of boards along y and along x, at least 1.
    element : kind of transducer; by default, the piston of the board, with a radius of 4.0 mm.

    Returns
    -------
    A ``PhasedArray`` of 249 · ``rows`` · ``columns`` elements.

    Raises
    ------
    InvalidInput
        If ``rows`` or ``columns`` is not an integer of at least 1, or the boards span more than
        10 m along x or y.

    Examples
    --------
    >>> len(flat_boards(2, 2))
    996
    """
    for name, count in (("rows", rows), ("columns", columns)):
        if not isinstance(count, int | np.integer) or count < 1:
            raise InvalidInput(
                f"the number of {name} of flat boards must be a whole number of at least 1, not "
                f"{count!r}.",
                code="out_of_range",
            )
    autd3 = board_named("autd3")
    width, height = autd3.outline or (0.0, 0.0)
    extent = max(rows * height, columns * width)
    if extent > MAX_ARRAY_EXTENT:
        raise InvalidInput(
            f"{rows} by {columns} flat boards span {extent:.4g} m, more than "
            f"{MAX_ARRAY_EXTENT:g} m; use fewer boards.",
            code="out_of_range",
        )
    board = _centred(autd3, element)
    # Along x fastest, in the order of the boards.
    places = [
        [(column - (columns - 1) / 2) * width, (row - (rows - 1) / 2) * height, 0.0]
        for row in range(rows)
        for column in range(columns)
    ]
    return join([board.moved(Pose(np.eye(3), np.array(place))) for place in places])


def join(arrays: Sequence[PhasedArray]) -> PhasedArray:
    """Join arrays with the same kind of element into one array.

    Parameters
    ----------
    arrays : list or tuple of the arrays to join, all in one frame; ``PhasedArray.moved`` moves an
        array.

    Returns
    -------
    A ``PhasedArray`` with the elements of all arrays in the given order, and with their gains.

    Raises
    ------
    InvalidInput
        If there is no array, or the arrays have different kinds of element (attribute ``element``),
        for example different sensitivities.
    """
    of_kind(arrays, list | tuple, "the arrays to join", "a list of arrays")
    if len(arrays) == 0:
        raise InvalidInput("there is no array to join; pass at least one.", code="empty")
    for index, array in enumerate(arrays):
        of_kind(array, PhasedArray, f"array {index}", "such as autd3_board(pose)")
        if not array.element.same_as(arrays[0].element):
            raise InvalidInput(
                f"the element of array {index} differs from that of array 0; only arrays with the "
                "same element can be joined.",
                code="sizes_differ",
            )
    return PhasedArray(
        np.concatenate([array.positions for array in arrays]),
        np.concatenate([array.normals for array in arrays]),
        arrays[0].element,
        np.concatenate([array.tangents for array in arrays]),
        np.concatenate([array.gains for array in arrays]),
    )


KNOWN_ARRAYS = ("tinylev", "biglev", "flat_8x8", "opposed_sonicsurfaces")


def known_array(name: str, element: Element | None = None) -> PhasedArray:
    """Return a well-known array with its axis along y, centred on the origin to within 2 mm.

    Parameters
    ----------
    name : "tinylev" or "biglev" for two spherical caps of 36 transducers each, which face the
        origin from y = ±59 mm or ±95 mm; "flat_8x8" for 64 transducers in the plane y = 0, 10 mm
        apart, which radiate toward +y; "opposed_sonicsurfaces" for two boards of 256 transducers at
        y = ±116.5 mm, which face each other. If there are two parts, the part at positive y comes
        first.
    element : kind of transducer; by default, a piston with a radius of 4.5 mm.

    Returns
    -------
    A ``PhasedArray`` of 72, 72, 64 or 512 elements.

    Raises
    ------
    InvalidInput
        If there is no such array.

    Examples
    --------
    >>> known_array("tinylev")
    PhasedArray(72 elements, pistons of 4.5 mm, 60 x 118.2 x 60 mm)
    """
    check_choice(name, "the array", KNOWN_ARRAYS)
    table = np.loadtxt(
        Path(__file__).with_name("layouts") / f"{name}.csv", delimiter=",", skiprows=1
    )
    return PhasedArray(table[:, :3], table[:, 3:], element)
