"""Places of boards: known optima, rules that every layout keeps, files that are read back."""

from dataclasses import replace
from itertools import count

import numpy as np
import pytest

import airtact as at
from airtact.acoustics.solvers.problem import FreeField
from airtact.setup.board_search import Search
from airtact.setup.placing import _hand_poses, hands_of
from airtact.transducers.placement import check_apart, open_air_bound, overlapping_boards
from faults import raises_code
from worlds import AIR, ball

FOCUS = np.array([0.01, -0.02, 0.03])

OPEN_AIR = """
medium = { celsius = 20.0 }
array = { layout = "flat_boards", rows = 1, columns = 1 }
foci = [{ point = [0.0, 0.0, 0.15] }, { point = [0.02, 0.0, 0.15] }]
"""


def in_open_air(*foci: np.ndarray) -> at.Setup:
    flat = at.autd3_board().facing(FOCUS, (0, 0, -1), 0.2)
    return at.Setup(at.Scene(AIR, []), flat, at.Target(np.array(foci)))


@pytest.fixture(scope="module")
def beside_ball() -> at.Setup:
    """A ball of 8 mm with a focus 0.5 mm off its side towards +x."""
    board = at.autd3_board().facing((0, 0, 0), (0, 0, -1), 0.2)
    return at.Setup(
        ball(8e-3), board, at.Target((8.5e-3, 0.0, 0.0)), solver=at.SphereSeries(), accuracy=0.03
    )


@pytest.fixture(scope="module")
def two_boards(beside_ball):
    return at.place(beside_ball, 2, "nano16", distance=(0.12, 0.22), tries=40, refine=1)


def test_one_focus_in_open_air_is_best_on_the_axis_at_the_smallest_distance() -> None:
    setup = in_open_air(FOCUS)
    result = at.place(setup, distance=(0.12, 0.2), tries=8, refine=1)
    best = result.layouts[0]
    way = FOCUS - best.middles[0]
    assert np.linalg.norm(way) == pytest.approx(0.12, rel=0.01)
    axis = best.poses[0].rotation[:, 2]
    assert way @ axis / np.linalg.norm(way) > np.cos(np.radians(3.0))
    on_axis = at.autd3_board().facing(FOCUS, (1, 0, 0), 0.12)
    bound = open_air_bound(on_axis, FOCUS[None], setup.scene.wavenumber.real)[0]
    assert best.weakest == pytest.approx(bound, rel=0.01)
    assert result.verified == pytest.approx(best.weakest, rel=1e-6)
    present = open_air_bound(setup.array, FOCUS[None], setup.scene.wavenumber.real)[0]
    assert result.present == pytest.approx(present, rel=1e-6)


def test_moving_a_board_back_costs_what_the_distance_costs() -> None:
    setup = in_open_air(FOCUS)
    result = at.place(setup, distance=(0.12, 0.12), tries=1)
    board = result.layouts[0].array
    back = board.moved(at.Pose.shift(-10e-3 * board.normals[0]))
    ratio = (
        open_air_bound(back, FOCUS[None], setup.scene.wavenumber.real)[0]
        / result.layouts[0].weakest
    )
    assert result.moves.shape == (1, 6)
    assert result.moves[0, 2] == pytest.approx(ratio - 1.0, abs=2e-3)
    assert (result.moves < 2e-3).all()


def test_the_best_board_is_on_the_side_of_the_focus(beside_ball) -> None:
    result = at.place(beside_ball, tries=40, refine=1)
    assert result.layouts[0].middles[0, 0] > 0.12
    assert result.layouts[0].weakest > 1.1 * result.median
    assert result.verified == pytest.approx(result.layouts[0].weakest, rel=0.03)


def test_layouts_keep_the_rules(two_boards) -> None:
    assert len(two_boards.layouts) > 30
    weakest = [layout.weakest for layout in two_boards.layouts]
    assert weakest == sorted(weakest, reverse=True)
    for layout in two_boards.layouts:
        assert len(layout.poses) == 2
        check_apart(layout.array)
        assert overlapping_boards(layout.array) is None
        # From the skin of the ball, and from the focus
        assert np.linalg.norm(layout.array.positions, axis=1).min() > 0.12 + 7.9e-3
        focus = layout.array.positions - [8.5e-3, 0.0, 0.0]
        assert np.linalg.norm(focus, axis=1).min() > 0.12
        assert np.linalg.norm(layout.middles - [8.5e-3, 0.0, 0.0], axis=1).max() < 0.2201


def test_weakest_is_the_pressure_of_the_best_drive(beside_ball, two_boards) -> None:
    layout = two_boards.layouts[0]
    beacons = beside_ball.solver.radiate(beside_ball.scene, beside_ball.target.beacons())
    transfer = at.transfer_matrix(beacons, layout.array)
    pressure = np.abs(transfer.pressure(at.best(transfer, beside_ball.target)))
    assert layout.weakest == pytest.approx(pressure.min(), rel=2e-3)


def test_a_seed_repeats_the_search() -> None:
    setup = in_open_air(FOCUS, FOCUS + [0.03, 0, 0])
    first, again = (at.place(setup, board="nano16", tries=8, seed=1, refine=1) for _ in range(2))
    assert [layout.weakest for layout in first.layouts] == [
        layout.weakest for layout in again.layouts
    ]
    assert np.array_equal(first.layouts[0].array.positions, again.layouts[0].array.positions)


def test_boards_stay_inside_the_region() -> None:
    setup = in_open_air(FOCUS)
    low, high = np.array([[-0.3, -0.3, -0.4], [0.3, 0.3, -0.05]])
    boxed = at.place(setup, board="nano16", region=(tuple(high), tuple(low)), tries=8, refine=1)
    within = at.place(
        setup, board="nano16", region=lambda points: points[:, 2] < -0.05, tries=8, refine=1
    )
    for layout in (*boxed.layouts, *within.layouts):
        assert layout.array.positions[:, 2].max() < -0.05
    assert all((layout.array.positions > low).all() for layout in boxed.layouts)


def test_hands_that_move_count_by_the_weakest(beside_ball) -> None:
    turned = at.Pose.turn((0, 0, 1), np.pi)
    both = at.place(
        beside_ball, board="nano16", hands=[at.Pose.identity(), turned], tries=10, refine=1
    )
    best = both.layouts[0]
    beacons = beside_ball.solver.radiate(beside_ball.scene, beside_ball.target.beacons())
    each = [
        np.abs(at.transfer_matrix(beacons, best.array.seen_from(pose)).matrix).sum()
        for pose in (at.Pose.identity(), turned)
    ]
    assert best.weakest == pytest.approx(min(each), rel=2e-3)
    # Neither side is in the shadow.
    assert abs(best.middles[0, 0]) < 0.1


def test_mirrored_boards_come_in_pairs(beside_ball) -> None:
    region = ((-0.4, -0.4, -0.4), (0.42, 0.4, 0.4))  # its middle is at x = 10 mm
    result = at.place(
        beside_ball, 4, "nano16", region=region, tries=4, refine=1, symmetric="x", tilted=False
    )
    focus = beside_ball.target.points[0]
    for layout in result.layouts:
        check_apart(layout.array)
        for first, second in (layout.poses[:2], layout.poses[2:]):
            board = layout.single.moved(first).positions
            image = layout.single.moved(second).positions
            np.testing.assert_allclose(np.sort(0.02 - board[:, 0]), np.sort(image[:, 0]), atol=1e-9)
            np.testing.assert_allclose(np.sort(board[:, 2]), np.sort(image[:, 2]), atol=1e-9)
            # Without tilts the placed board faces the focus, and its image faces the image.
            middle = board.mean(axis=0)
            way = (focus - middle) / np.linalg.norm(focus - middle)
            assert way @ first.rotation[:, 2] == pytest.approx(1.0, abs=1e-6)


def test_fixed_boards_stay_and_count(beside_ball) -> None:
    alone = at.place(beside_ball, tries=20, refine=0)
    beside = at.place(beside_ball, tries=20, refine=1, fixed=[0])
    present = beside_ball.array.positions
    for layout in beside.layouts:
        np.testing.assert_allclose(layout.array.positions[-249:], present, atol=1e-9)
        assert overlapping_boards(layout.array) is None
    assert beside.moves.shape == (2, 6)
    # The fixed board adds its sound, at one focus all of it.
    assert beside.layouts[0].weakest > 1.2 * alone.layouts[0].weakest
    assert beside.verified == pytest.approx(beside.layouts[0].weakest, rel=0.03)


def test_the_lowest_tenth_forgives_a_hand() -> None:
    setup = in_open_air(FOCUS)
    # In one of eleven hands the focus is far away.
    hands = [at.Pose.identity()] * 10 + [at.Pose.shift((0.0, 0.0, 0.1))]
    region = ((-0.4, -0.4, -0.4), (0.4, 0.4, 0.0))
    settings = {"region": region, "distance": (0.1, 0.4), "tries": 6, "refine": 1}
    tenth = at.place(setup, 1, "nano16", hands=hands, objective="lowest_tenth", **settings)
    weakest = at.place(setup, 1, "nano16", hands=hands, **settings)
    near = at.place(setup, 1, "nano16", hands=hands[:1], **settings)
    assert tenth.layouts[0].weakest > 1.1 * weakest.layouts[0].weakest
    assert tenth.layouts[0].weakest <= 1.01 * near.layouts[0].weakest
    assert tenth.verified == pytest.approx(tenth.layouts[0].weakest, rel=1e-6)


def test_shares_weigh_the_foci() -> None:
    foci = np.array([FOCUS, FOCUS + [0.05, 0, 0]])
    array = at.autd3_board().facing(FOCUS, (0, 0, -1), 0.2)
    setup = at.Setup(at.Scene(AIR, []), array, at.Target(foci, shares=np.array([1.0, 0.0])))
    result = at.place(setup, board="nano16", tries=1)
    beacons = FreeField().radiate(setup.scene, setup.target.beacons())
    alone = np.abs(at.transfer_matrix(beacons, result.layouts[0].array).matrix[0]).sum()
    assert result.layouts[0].weakest == pytest.approx(alone)


def test_layouts_are_written_as_scene_files(tmp_path) -> None:
    (tmp_path / "air.toml").write_text(OPEN_AIR, encoding="utf-8")
    setup = at.read_scene(tmp_path / "air.toml")
    result = at.place(setup, 2, "nano16", tries=3, refine=0)
    files = result.save(tmp_path / "out", 2)
    assert [file.name for file in files] == ["layout_1.toml", "layout_2.toml"]
    for file, layout in zip(files, result.layouts, strict=False):
        again = at.read_scene(file)
        assert np.allclose(again.array.positions, layout.array.positions, atol=1e-8)
        assert again.array.element.same_as(layout.single.element)
        assert np.array_equal(again.target.points, setup.target.points)
    # The array of a written file is replaced too.
    again = replace(result, setup=at.read_scene(files[0]), layouts=result.layouts[1:2])
    (file,) = again.save(tmp_path / "again")
    assert np.allclose(at.read_scene(file).array.positions, result.layouts[1].array.positions)


@pytest.mark.parametrize("name", ["pinch_pose", "open_hand", "touch_ball"])
def test_written_scenes_find_their_files(name, tmp_path) -> None:
    setup = at.read_scene(name)
    board = at.autd3_board()
    pose = at.Pose.shift((0.0, 0.0, -0.5))
    layout = at.setup.Layout((pose,), 1.0, board)
    placement = at.setup.Placement(setup, "autd3", (layout,), 1.0, 1.0, np.zeros((1, 6)))
    (file,) = placement.save(tmp_path)
    again = at.read_scene(file)
    assert np.array_equal(again.target.points, setup.target.points)
    assert [len(body.surface.corners) for body in again.scene.obstacles] == [
        len(body.surface.corners) for body in setup.scene.obstacles
    ]


def test_hands_of_a_recording_replace_the_hand() -> None:
    setup = at.read_scene("live_pinch")
    recording = at.example("pinching.jsonl", (".jsonl",))
    hands = hands_of(setup, recording, 3)
    assert len(hands) == 3
    poses = list(_hand_poses(setup, hands))
    for hand, (scene, target, motion) in zip(hands, poses, strict=True):
        assert np.allclose(target.points[0], hand.focus("thumb.pad", 1e-3))
        assert len(scene.obstacles) == 1
        assert np.array_equal(motion.rotation, np.eye(3))


def test_impossible_requests_are_rejected(beside_ball, two_boards, monkeypatch) -> None:
    group, calls = Search.group, count()

    def few(search, place):
        """Look for room 100 times, and find none in the thousands of places that are left."""
        return group(search, place) if next(calls) < 100 else None

    setup = in_open_air(FOCUS)
    for wrong, code in (
        ({"boards": 0}, "out_of_range"),
        ({"tries": 0}, "out_of_range"),
        ({"distance": (0.2, 0.1)}, "out_of_range"),
        ({"distance": (-0.2, 0.1)}, "out_of_range"),
        ({"board": "autd4"}, "unknown_name"),
        ({"distance": (150.0, 250.0)}, "out_of_range"),
        ({"objective": "lowest_tenth"}, "data_missing"),
        ({"hands": []}, "empty"),
        ({"seed": -1}, "out_of_range"),
        ({"boards": 3, "symmetric": "x"}, "options_clash"),
        ({"fixed": [1]}, "unknown_name"),
        ({"fixed": [0, 0]}, "unknown_name"),
        ({"fixed": [0], "board": "nano16"}, "unknown_name"),
    ):
        with raises_code(code):
            at.place(setup, **wrong)
    monkeypatch.setattr(Search, "group", few)
    with raises_code("out_of_range"):  # the ball is nearer than its focus is far
        at.place(beside_ball, distance=(0.15, 0.15))
    hand = at.load_hand(at.example("pinch.json"))
    with raises_code("not_supported"):  # its focus is not on a named point
        at.place(beside_ball, hands=[hand])
    with raises_code("data_missing"):
        replace(two_boards, setup=setup).save("out")
