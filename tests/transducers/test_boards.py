"""Layouts of boards against what their makers publish, and boards found again in arrays."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import airtact as at
from airtact.transducers.boards import BOARDS, board_named, boards_needed, poses_of_boards
from faults import raises_code

# Places [mm] of some channels in SonicSurface's own control software, whose plane is x, z and which
# looks to +y.
SONICSURFACE = {
    0: (-78.75, 80.75),
    1: (-57.75, 80.75),
    2: (-47.25, 80.75),
    3: (-68.25, 70.25),
    4: (-78.75, 70.25),
    5: (-47.25, 70.25),
    6: (-57.75, 70.25),
    7: (-68.25, 80.75),
    8: (-78.75, 59.75),
    63: (-68.25, -66.25),
    64: (-36.75, 80.75),
    130: (36.75, 80.75),
    201: (68.25, 59.75),
    255: (57.75, -66.25),
}

# Places [mm] and pins of some transducers in a board file of OpenMPD, board_6.pat.
OPENMPD = {
    0: (-78.75, 78.75, 249),
    1: (-78.75, 68.25, 253),
    2: (-78.75, 57.75, 241),
    15: (-78.75, -78.75, 197),
    16: (-68.25, 78.75, 248),
    32: (-57.75, 78.75, 251),
    33: (-57.75, 68.25, 254),
    48: (-47.25, 78.75, 250),
    49: (-47.25, 68.25, 255),
    64: (-36.75, 78.75, 185),
    127: (-5.25, -78.75, 135),
    255: (78.75, -78.75, 7),
}


def random_poses(count: int, seed: int = 5) -> list[at.Pose]:
    random = np.random.default_rng(seed)
    turns = Rotation.random(count, rng=random).as_matrix()
    return [at.Pose(turn, random.uniform(-0.3, 0.3, 3)) for turn in turns]


@pytest.mark.parametrize("board", BOARDS.values(), ids=lambda board: board.name)
def test_a_board_is_a_plane_of_positions_with_a_channel_each(board) -> None:
    assert board.positions.shape == (len(board), 3)
    assert not board.positions[:, 2].any()
    assert len(set(board.channels.tolist())) == len(board)
    assert 0 <= board.channels.min() <= board.channels.max() < board.message_length
    apart = np.linalg.norm(board.positions[:, None] - board.positions[None], axis=-1)
    assert apart[~np.eye(len(board), dtype=bool)].min() > 9.9e-3
    assert board_named(board.name) is board


def test_sonicsurface_has_the_order_of_its_own_software() -> None:
    board = board_named("sonicsurface")
    for channel, (x, z) in SONICSURFACE.items():
        # Seen from the front with x to the right, its z points down: y = −z, and its middle is 2 mm
        # off.
        np.testing.assert_allclose(
            1e3 * board.positions[channel], [x, 2.0 - z, 0.0], rtol=0, atol=1e-9
        )


def test_openmpd_has_the_positions_and_pins_of_its_board_file() -> None:
    board = board_named("openmpd")
    for index, (x, y, pin) in OPENMPD.items():
        np.testing.assert_allclose(1e3 * board.positions[index], [x, y, 0.0], rtol=0, atol=1e-9)
        assert board.channels[index] == pin


def test_a_nano_drives_the_pins_that_its_firmware_drives() -> None:
    # DDRC = 0b00111111 and DDRD = 0b11111100, bits 0 to 7 of a slot being port C and 8 to 15 port
    # D.
    driven = [bit for bit in range(16) if (0b11111100 << 8 | 0b00111111) >> bit & 1]
    assert board_named("nano16").channels.tolist() == driven


@pytest.mark.parametrize("name", ["autd3", "sonicsurface", "openmpd"])
def test_boards_are_found_in_an_array_of_them(name: str) -> None:
    poses = random_poses(2)
    array = at.transducers.board_array(name, poses)
    found = poses_of_boards(board_named(name), array.positions, array.normals)
    for pose, there in zip(poses, found, strict=True):
        np.testing.assert_allclose(there.rotation, pose.rotation, rtol=0, atol=1e-12)
        np.testing.assert_allclose(there.translation, pose.translation, rtol=0, atol=1e-12)


def test_boards_without_positions_of_their_own_are_anywhere() -> None:
    places = np.random.default_rng(1).uniform(-0.1, 0.1, (12, 3))
    pose = poses_of_boards(board_named("nano16"), places, np.tile([0.0, 0.0, 1.0], (12, 1)))
    np.testing.assert_array_equal(pose[0].rotation, np.eye(3))


def shifted(index: int):
    array = at.transducers.board_array("autd3", random_poses(2))
    places = array.positions.copy()
    places[index] += [0.0, 0.0, 1e-3]
    return poses_of_boards(board_named("autd3"), places, array.normals)


def mirrored():
    board = board_named("autd3")
    return poses_of_boards(
        board, board.positions * [-1.0, 1.0, 1.0], np.tile([0.0, 0.0, 1.0], (249, 1))
    )


@pytest.mark.usefixtures("as_outside_the_tests")
@pytest.mark.parametrize(
    ("make", "code"),
    [
        (lambda: board_named("ultrahaptics"), "unknown_name"),
        (lambda: boards_needed(board_named("autd3"), 248), "sizes_differ"),
        (lambda: boards_needed(board_named("autd3"), 1000), "sizes_differ"),
        (lambda: boards_needed(board_named("sonicsurface"), 996), "sizes_differ"),
        (lambda: boards_needed(board_named("sonicsurface"), 768), "too_many"),
        (lambda: shifted(300), "wrong_kind"),
        (mirrored, "wrong_kind"),
        (lambda: at.transducers.board_array("autd3", at.Pose.identity()), "wrong_kind"),
        (lambda: at.transducers.board_array("autd3", []), "empty"),
        (lambda: at.surrounding_box(board="openmpd"), "unknown_name"),
    ],
)
def test_what_is_no_board_is_rejected(make, code: str) -> None:
    with raises_code(code):
        make()
