"""Kinds of boards: positions of their transducers, and channels in their messages."""

from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64, Real

from airtact.errors import InvalidInput, counted, fixed, in_short, of_kind
from airtact.geometry.pose import Pose, nearest_motion

# Radius of a piston for Murata's MA40S4S at 40 kHz, whose case has a radius of 4.95 mm [m]. It is
# 6 dB down at 42 degrees from the axis; the data sheet states a full width of 80 degrees. Other
# transducers of this size, such as those in kits, are similar.
MURATA_RADIUS = 4.5e-3


@dataclass(frozen=True, eq=False)
class Board:
    """One kind of transducer board, as returned by ``board_named``.

    In its own frame, a board lies in the plane z = 0 and radiates toward +z. The origin is the
    first element of an "autd3" board, and the centre of any other board.

    Attributes
    ----------
    name : name in commands and scene files, such as "autd3".
    title : name in printed text.
    positions : (E, 3) centres of the transducers in the board's frame [m]. Their order is the order
        of the elements in drives and arrays.
    channels : (E,) for each element, the index from 0 of its value in a message to the board.
    message_length : number of channels in a message, some of which may have no transducer.
    outline : width (along x) and height (along y) of the board [m]; None if it is unknown or
        varies.
    placed : whether the board fixes the positions of its transducers. Otherwise, they are connected
        by wires, and ``positions`` are only an example.
    max_boards : largest number of boards on one link to the computer.
    amplitudes, phases : number of amplitude levels and of phase levels.
    transducer : manufacturer's name of the transducer.
    radius : radius of a piston with the directivity of this transducer [m]; see
        ``piston``.
    source : documents that describe the board's layout and the format of its messages.
    """

    name: str
    title: str
    positions: Float64[np.ndarray, "elements 3"]
    channels: Int64[np.ndarray, "elements"]
    message_length: int
    outline: tuple[float, float] | None
    placed: bool
    max_boards: int
    amplitudes: int
    phases: int
    transducer: str
    radius: float
    source: str

    __repr__ = in_short

    def __len__(self) -> int:
        return len(self.positions)


def board_named(name: str) -> Board:
    """Return the description of a kind of board.

    Parameters
    ----------
    name : "autd3", "sonicsurface", "nano16" or "openmpd".

    Returns
    -------
    A ``Board``, with the positions of its transducers and its levels. For a ``PhasedArray`` of
    boards, use ``board_array``.

    Raises
    ------
    InvalidInput
        If there is no such board.

    Examples
    --------
    >>> len(board_named("autd3"))
    249
    """
    if name not in BOARDS:
        raise InvalidInput(
            f"there is no board {name!r}; the boards are {', '.join(BOARDS)}.",
            code="unknown_name",
        )
    return BOARDS[name]


def boards_needed(board: Board, elements: int) -> int:
    """Return the number of boards that together have the given number of elements.

    Raises
    ------
    InvalidInput
        If the elements do not fill whole boards, or one link cannot drive so many boards.
    """
    count = _whole_boards(board, elements)
    if count > board.max_boards:
        raise InvalidInput(
            f"{elements} elements require {count} {board.name} boards, but one link drives at most "
            f"{board.max_boards}: compute a drive for at most {board.max_boards * len(board)} "
            "elements.",
            code="too_many",
        )
    return count


def _whole_boards(board: Board, elements: int) -> int:
    count, rest = divmod(elements, len(board))
    if rest or count == 0:
        near = len(board) * min(max(count, 1), board.max_boards)
        raise InvalidInput(
            f"{counted(elements, 'element does', 'elements do')} not make up whole {board.name} "
            f"boards, which have {len(board)} elements each: use a drive for {near} elements. "
            "airtact only plays drives on the boards that it supports; other programs can play "
            "drive.csv on your own array.",
            code="sizes_differ",
        )
    return count


def kind_of_array(
    positions: Real[np.ndarray, "elements 3"], normals: Real[np.ndarray, "elements 3"]
) -> tuple[Board, list[Pose]] | None:
    """Return the kind and poses of an array's boards, or None if the array has no boards."""
    # Kinds with the same pitch differ in the order of their elements, so at most one matches.
    for board in BOARDS.values():
        if board.placed:
            with suppress(InvalidInput):
                return board, poses_of_boards(board, positions, normals)
    return None


def poses_of_boards(
    board: Board | str,
    positions: Real[np.ndarray, "elements 3"],
    normals: Real[np.ndarray, "elements 3"],
) -> list[Pose]:
    """Return the pose of each board of an array, in the order of the elements.

    Links to boards, such as ``UDPLink``, take these poses. The rotation is a least-squares fit
    (Kabsch, Acta Cryst. A 32, 922, 1976).

    Parameters
    ----------
    board : the kind of board as a ``Board``, or its name, such as "autd3".
    positions, normals : (E, 3) positions [m] and (E, 3) unit normals of the array's elements, board
        by board, each board in the order of ``Board.positions``.

    Returns
    -------
    List of one ``Pose`` per board, which maps coordinates in the board's frame (that of
    ``Board.positions``) to those of the array. The pose is the identity for boards that do not fix
    the positions of their transducers.

    Raises
    ------
    InvalidInput
        If the board is unknown, if the elements do not fill whole boards, if an element is over 0.1
        mm from its position on the board, or if a normal deviates by over 1 mrad.
    """
    board = board_named(board) if isinstance(board, str) else board
    of_kind(board, Board, "the board", 'the name of one, such as "AUTD3"')
    count = _whole_boards(board, len(positions))
    if not board.placed:
        return [Pose.identity()] * count
    parts = zip(np.split(positions, count), np.split(normals, count), strict=True)
    return [_board_pose(board, index, *part) for index, part in enumerate(parts)]


def _board_pose(
    board: Board,
    index: int,
    positions: Real[np.ndarray, "elements 3"],
    normals: Real[np.ndarray, "elements 3"],
) -> Pose:
    # Points on both sides of the board prevent the fit from turning it over, which would hide a
    # mirrored order of its elements.
    up = 0.1 * np.array([0.0, 0.0, 1.0])
    nominal = np.concatenate([board.positions + up, board.positions - up])
    actual = np.concatenate([positions + 0.1 * normals, positions - 0.1 * normals])
    pose = Pose(*nearest_motion(nominal, actual))
    off = np.linalg.norm(pose.apply(board.positions) - positions, axis=1)
    lean = np.linalg.norm(normals - pose.rotation[:, 2], axis=1)
    worst = int(off.argmax())
    if off[worst] > 1e-4 or lean.max() > 1e-3:  # [m] and [rad]
        first = index * len(board)
        raise InvalidInput(
            f"elements {first} to {first + len(board) - 1} are not laid out like board {index} of "
            f"{board.name}: element {first + worst} is {off[worst] * 1e3:.3g} mm from its "
            f"position, and normals differ by up to {np.degrees(lean.max()):.3g} degrees. Compute "
            "the drive for the layout of this board.",
            code="wrong_kind",
        )
    return pose


# Column and row of each transducer of an "openmpd" board.
_COLUMNS, _ROWS = np.divmod(np.arange(256), 16)

_LISTED = (
    # 18 (x) by 14 (y) cells, x fastest, from transducer 0; three cells are empty.
    Board(
        name="autd3",
        title="AUTD3",
        positions=fixed(
            np.array(
                [
                    (10.16e-3 * column, 10.16e-3 * row, 0.0)
                    for row in range(14)
                    for column in range(18)
                    if (column, row) not in {(1, 1), (2, 1), (16, 1)}
                ]
            )
        ),
        channels=np.arange(249),
        message_length=249,
        outline=(192.0e-3, 151.4e-3),
        placed=True,
        max_boards=256,
        amplitudes=256,
        phases=256,
        transducer="Nippon Ceramic T4010A1",
        # The case has a radius of 5 mm. Piston and maker's curve are 6 dB down at 50 degrees from
        # the axis at 40 kHz. The AUTD3 SDK contains this curve as a table (``T4010A1``): 0.708,
        # 0.501 and 0.355 of the pressure on the axis at 40, 50 and 60 degrees. For the piston,
        # these values are 0.62, 0.49 and 0.38.
        radius=4.0e-3,
        source="AUTD3 SDK (autd3-core); message as in pyautd3",
    ),
    # 16 by 16 cells in the order of the channels: blocks of 4 (x) by 2 (y), y first. The cells of a
    # block are in the order of their channels (``Distribute.vhd``).
    Board(
        name="sonicsurface",
        title="SonicSurface",
        positions=fixed(
            np.array(
                [
                    (10.5e-3 * (4 * group + x - 7.5), 10.5e-3 * (2 * pair + y - 7.5), 0.0)
                    for group in range(4)
                    for pair in range(8)
                    for x, y in ((0, 0), (2, 0), (3, 0), (1, 1), (0, 1), (3, 1), (2, 1), (1, 0))
                ]
            )
        ),
        channels=np.arange(256),
        message_length=256,
        outline=(183.0e-3, 169.0e-3),
        placed=True,
        max_boards=2,
        amplitudes=2,
        phases=32,
        transducer="of 10 mm, as Murata MA40S4S",
        radius=MURATA_RADIUS,
        source="upnalab/SonicSurface: control software, Distribute.vhd, PhaseLine.vhd",
    ),
    # The pins that are driven: A0 to A5 are bits 0 to 5, and D2 to D7 bits 10 to 15.
    Board(
        name="nano16",
        title="Ultraino Nano16",
        positions=fixed(
            np.array(
                [
                    (10.0e-3 * (column - 1.5), 10.0e-3 * (row - 1.0), 0.0)
                    for row in range(3)
                    for column in range(4)
                ]
            )
        ),
        channels=np.concatenate([np.arange(6), np.arange(10, 16)]),
        message_length=16,
        outline=None,
        placed=False,
        max_boards=1,
        amplitudes=2,
        phases=16,
        transducer="of 10 mm, as Murata MA40S4S",
        radius=MURATA_RADIUS,
        source="asiermarzo/Ultraino: DriverNano16.ino, ArduinoNano.java",
    ),
    # 16 x 16 cells column by column from the top. Pins form blocks of 4 (x) by 2 (y), numbered by
    # column and row as in ``board_6.pat``.
    Board(
        name="openmpd",
        title="OpenMPD",
        positions=fixed(10.5e-3 * np.stack([_COLUMNS - 7.5, 7.5 - _ROWS, 0.0 * _ROWS], axis=1)),
        channels=8 * (31 - 8 * (_COLUMNS // 4) - _ROWS // 2)
        + np.array([[1, 5], [0, 4], [3, 6], [2, 7]])[_COLUMNS % 4, _ROWS % 2],
        message_length=256,
        outline=None,
        placed=True,
        max_boards=256,
        amplitudes=65,
        phases=128,
        transducer="Murata MA40S4S",
        radius=MURATA_RADIUS,
        source="RMResearch/OpenMPD_Hardware 3.4.2: CommandReader.vhd; board_6.pat of OpenMPD_Libs",
    ),
)

# Boards by name, in the order in which they are listed.
BOARDS = {board.name: board for board in _LISTED}
