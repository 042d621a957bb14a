"""Live touch on a virtual clock: foci appear where hands touch objects, and fade."""

import json
from dataclasses import replace

import numpy as np
import pytest

import airtact as at
from airtact.live.drives.factors import OpenAir
from airtact.live.drives.skin_solver import SIDES, SkinRequest, SkinSolver
from airtact.live.drives.strengths import balanced
from airtact.live.drives.touching import TouchAware
from airtact.live.moment import Controls
from airtact.live.scene import LiveScene
from airtact.live.session import SessionWriter
from airtact.live.world import WantedFocus, World
from live.live_scenes import Kept, Scheduled
from references.motions import RADII, SMALL, grasping_recording

BALL = at.VirtualObject(at.sphere(0.012, 3e-3), name="ball")


@pytest.fixture(scope="module")
def scene():
    """A board under the ball, for a small hand."""
    return LiveScene(
        at.air(),
        40e3,
        at.autd3_board().facing((0.0, 0.0, 0.0), (0.0, 0.0, -1.0), 0.2),
        "left",
        SMALL * RADII,
        (),
        np.zeros(0),
        objects=(BALL,),
        both=True,
    )


def hand(index):
    return at.Hand(grasping_recording()[index].landmarks, SMALL * RADII, "left")


def mirrored(frame, shift=(0.0, 0.0, 0.0)):
    """A frame of the right hand."""
    landmarks = None if frame.landmarks is None else frame.landmarks * [-1, 1, 1] + shift
    return at.hands.HandFrame(frame.time, "right", frame.sequence, landmarks)


def held(maker, index=30, drives=6, frames=(), **controls):
    """The moment after some drives for a hand at rest, which bring foci to their full level."""
    rest = grasping_recording()[index]
    for step in range(drives):
        time = step / 60
        maker.take(at.hands.HandFrame(time, "left", step, rest.landmarks))
        for frame in frames:
            maker.take(at.hands.HandFrame(time, frame.side, step, frame.landmarks))
        moment = maker.make(time, Controls(**controls))
    return moment


class Noting(TouchAware):
    """Keeps all moments."""

    def __init__(self, scene):
        super().__init__(scene, solvers=[])
        self.made = []

    def make(self, time, controls):
        self.made.append(super().make(time, controls))
        return self.made[-1]


@pytest.fixture(scope="module")
def grasp(scene, tmp_path_factory):
    """A run in which thumb and index finger grasp the ball and release it, with its session."""
    from live.live_scenes import VirtualClock

    folder = tmp_path_factory.mktemp("grasp")
    clock = VirtualClock()
    clock.now = 100.0  # not a time of the frames
    maker = Noting(scene)
    output = Kept(clock)
    told = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("airtact.live.loop.time", clock)
        at.live.follow(
            scene,
            Scheduled(clock, grasping_recording()[15:50]),
            maker,
            output=output,
            session=SessionWriter(folder / "session.h5", scene),
            report=told.append,
        )
    return maker.made, output, told, folder


def test_two_fingers_at_a_ball_have_foci_at_the_true_contacts_and_none_after_the_release(grasp):
    made, _output, told, _ = grasp
    closed = min(made, key=lambda moment: abs(moment.time - 1.0))
    assert closed.names == ("left.thumb at ball", "left.index at ball") or closed.names == (
        "left.index at ball",
        "left.thumb at ball",
    )
    true = at.contact(hand(30), BALL)
    assert sorted(true.places) == ["index", "thumb"]
    for name, point in zip(closed.names, closed.foci, strict=True):
        place = name.removeprefix("left.").removesuffix(" at ball")
        contact = true.places.index(place)
        goal = true.points[contact] + 0.5e-3 * true.normals[contact]
        assert np.linalg.norm(point - goal) < 0.5e-3
    np.testing.assert_allclose(np.sort(closed.depths), np.sort(true.depths), atol=0.2e-3)
    assert all(not moment.amplitudes.any() for moment in made if not len(moment.foci))
    last = made[-1]
    assert not len(last.foci)
    assert any(len(moment.foci) for moment in made)
    assert any(status.state == "no contact" for status in told)
    assert any(status.state == "playing" for status in told)


def test_the_session_of_a_touch_is_read_again(grasp):
    _made, _output, _, folder = grasp
    session = at.live.read_session(folder)
    assert session.scene.both
    assert session.scene.places == ()
    touching = np.isfinite(session.foci[:, :, 0]).sum(axis=1)
    assert set(touching) == {0, 1, 2} or set(touching) == {0, 2}
    assert (np.isfinite(session.depths).sum(axis=1) >= 0).all()
    loud = np.abs(session.amplitudes).max(axis=1) > 0.0
    assert not loud[touching == 0].any()
    playing = session.playing
    assert np.nanmax(session.strengths[playing]) <= 1.0
    closed = np.nanargmax(
        session.depths.max(axis=1, initial=0.0, where=np.isfinite(session.depths))
    )
    assert np.isfinite(session.contacts[closed, :2]).all()
    assert len(at.live.recording_of(folder).frames) == 35


@pytest.mark.parametrize(
    ("wanted", "place"),
    [
        (WantedFocus("one", place="index.pad"), "index"),
        (WantedFocus("one", place="left.index.pad"), "index"),
        (WantedFocus("one", point=np.array([0.0, 0.0, 0.03])), None),
        (WantedFocus("one", point=np.array([0.0, 0.0, 0.02]), on="ball"), None),
    ],
)
def test_foci_of_an_application_are_at_a_place_a_point_or_on_an_object(scene, wanted, place):
    maker = TouchAware(scene, solvers=[])
    # The ball is away from the hand, so that only the wanted focus plays.
    moved = BALL.moved(at.Pose.shift((0.0, 0.0, 0.05)))
    maker.feel((moved,), (wanted,))
    moment = held(maker)
    assert moment.names == ("one",)
    goal = hand(30).focus("index.pad") if place else wanted.point
    if wanted.on:
        goal = wanted.point + [0.0, 0.0, 0.05]
    np.testing.assert_allclose(moment.foci[0], goal, atol=1e-4)
    assert moment.strengths[0] == pytest.approx(1.0)
    # It fades when it is not wanted any more.
    maker.feel((moved,), ())
    fading = maker.make(moment.time + 0.01, Controls())
    assert fading.strengths[0] == pytest.approx(0.5)
    assert not len(maker.make(moment.time + 0.03, Controls()).foci)


@pytest.mark.parametrize(
    ("wanted", "words"),
    [
        (WantedFocus("far", point=np.array([0.0, 0.0, 1.5])), "workspace"),
        (WantedFocus("hidden", place="right.palm"), "right hand"),
        (WantedFocus("lost", point=np.zeros(3), on="cube"), "cube"),
    ],
)
def test_foci_that_cannot_be_are_rejected_with_a_reason_and_the_others_play(scene, wanted, words):
    maker = TouchAware(scene, solvers=[])
    maker.feel((BALL,), (wanted,))
    moment = held(maker)
    assert len(moment.foci) == 2
    assert words in moment.rejected[wanted.name]


def test_a_focus_at_the_place_of_another_is_rejected(scene):
    maker = TouchAware(scene, solvers=[])
    point = hand(30).focus("palm", 30e-3)
    beside = point + [0.1e-3, 0.0, 0.0]
    maker.feel((), (WantedFocus("one", point=point), WantedFocus("two", point=beside)))
    moment = held(maker)
    assert moment.names == ("one",)
    assert "from one" in moment.rejected["two"]


def test_an_object_that_moves_away_is_released_and_strengths_scale_the_pressure(scene):
    maker = TouchAware(scene, solvers=[])
    moment = held(maker)
    assert len(moment.foci) == 2
    full = moment.pressures.max()
    first, second = moment.names
    half = held(TouchAware(scene, solvers=[]), levels={first: 0.5, second: 0.5})
    np.testing.assert_allclose(half.pressures, 0.5 * moment.pressures, rtol=0.02)
    alone = held(TouchAware(scene, solvers=[]), levels={first: 0.0})
    assert alone.pressures[1] > 1.1 * full
    maker.feel((BALL.moved(at.Pose.shift((0.0, 0.0, 0.05))),), ())
    for _step in range(4):
        moment = maker.make(moment.time + 0.01, Controls())
    assert not len(moment.foci)
    assert not moment.amplitudes.any()


def test_both_hands_touch_and_one_that_is_lost_fades(scene):
    maker = TouchAware(scene, solvers=[])
    other = mirrored(grasping_recording()[30])
    moment = held(maker, frames=[other])
    assert {name.partition(".")[0] for name in moment.names} == {"left", "right"}
    assert moment.other is not None
    lost = at.hands.HandFrame(moment.time, "right", 100)
    maker.take(lost)
    fading = maker.make(moment.time + 0.01, Controls())
    weak = dict(zip(fading.names, fading.strengths, strict=True))
    assert all(level <= 0.55 for name, level in weak.items() if name.startswith("right"))
    left = [level for name, level in weak.items() if name.startswith("left")]
    assert left == pytest.approx([1.0] * len(left), abs=0.2)


def test_a_focus_gets_pressure_in_proportion_to_its_strength(scene):
    foci = np.array([[0.0, 0.0, 0.0], [0.02, 0.0, 0.0], [0.0, 0.02, 0.0]])
    rows = at.open_air_matrix(
        at.Scene(scene.medium, [], frequency=scene.frequency), scene.array, at.Target(foci)
    ).matrix
    strengths = np.array([0.8, 0.4, 0.0])
    amplitudes = balanced(scene, "best", rows, foci, strengths)
    assert np.abs(amplitudes).max() == pytest.approx(0.8)
    pressures = np.abs(rows @ amplitudes)
    assert pressures[1] / pressures[0] == pytest.approx(0.5, rel=0.05)
    assert not balanced(scene, "best", rows, foci, np.zeros(3)).any()


def test_skin_near_contacts_gives_nearly_the_factors_of_the_whole_hand(scene):
    """Beacons are solved in one pose and used 0.3 mm and a frame later."""
    from airtact.live.drives.bending import bones_of

    true = hand(30)
    foci = at.contact(true, BALL).foci().points
    air = at.Scene(scene.medium, [at.sound_hard(true.surface)], frequency=scene.frequency)
    solver = at.BoundaryElement(accuracy=0.15, estimate=False)
    exact = at.transfer_matrix(solver.radiate(air, at.Target(foci).beacons()), scene.array).matrix
    before = hand(29)
    request = SkinRequest(
        0.0,
        0.0,
        {"left": before.joints},
        {"left": np.zeros((25, 3))},
        at.contact(before, BALL).foci().points,
        np.full(2, SIDES.index("left")),
    )
    solution = SkinSolver(scene).solved(request.after(0.0), 0.0)
    factors, benefits = solution.at({"left": bones_of(true)}, foci)
    assert benefits.min() > 0.9
    empty = at.Scene(scene.medium, [], frequency=scene.frequency)
    rows = at.open_air_matrix(empty, scene.array, at.Target(foci)).matrix

    def kept(matrix):
        made = balanced(scene, "best", matrix, foci, np.ones(2))
        return np.abs(exact @ made).min()

    best = kept(exact)
    assert kept(rows * factors) > 0.85 * best
    assert kept(rows * factors) > kept(rows)


def test_a_scene_without_foci_and_objects_waits_for_an_application(tmp_path):
    text = 'frequency = 40e3\n[array]\nlayout = "flat_boards"\n[array.pose]\naxis = [0, 1, 0]\n'
    text += "degrees = -90.0\ntranslation = [0.2, -0.02, 0.0]\n[[obstacles]]\n"
    text += f'hand = "{at.example("pinch.json")}"\ngap = 0.012\n'
    (tmp_path / "scene.toml").write_text(text)
    setup = at.read_scene(tmp_path / "scene.toml", moving=True)
    scene = at.live.live_scene(setup)
    assert scene.both
    assert scene.places == ()
    maker = TouchAware(scene, solvers=[])
    maker.take(at.hands.HandFrame(0.0, "left", 0, setup.hands[0].joints))
    assert not maker.make(0.0, Controls()).amplitudes.any()
    maker.feel((), World().foci(0.0))
    maker.feel((), (WantedFocus("one", place="index.pad"),))
    assert maker.make(0.02, Controls()).amplitudes.any()
    with pytest.raises(at.InvalidInput):
        at.read_scene(tmp_path / "scene.toml")


@pytest.mark.parametrize("name", ["touch_ball", "touch_button"])
def test_the_examples_can_be_followed_and_their_motions_touch(name):
    setup = at.read_scene(name, moving=True)
    scene = at.live.live_scene(setup)
    motion = at.live.hands_from(setup, None, setup.path.parent).frames
    touching = 0
    for frame in motion[:: len(motion) // 4]:
        maker = TouchAware(scene, solvers=[])
        maker.take(frame)
        touching += bool(len(maker.make(frame.time, Controls()).foci))
    assert 0 < touching < 4


def test_a_scene_with_two_hands_has_foci_on_both(tmp_path):
    left = at.load_hand(at.example("relaxed.json"))
    text = '[array]\nlayout = "flat_boards"\n[array.pose]\naxis = [-0.99077, 0.13558, 0.0]\n'
    text += "degrees = 73.172\ntranslation = [0.00285, -0.13385, -0.08323]\n"
    text += f'[[obstacles]]\nhand = "{at.example("relaxed.json")}"\n'
    text += f'[[obstacles]]\nhand = "{tmp_path / "right.json"}"\n'
    text += '[[foci]]\nat = "left.palm"\n[[foci]]\nat = "right.index.pad"\n'
    right = at.hand_from_joints(left.joints * [-1, 1, 1] + [0.25, 0, 0], left.radii)
    pose = {"positions_m": right.joints.tolist(), "radii_m": right.radii.tolist()}
    (tmp_path / "right.json").write_text(json.dumps(pose))
    (tmp_path / "scene.toml").write_text(text)
    scene = at.live.live_scene(at.read_scene(tmp_path / "scene.toml", moving=True))
    assert scene.places == ("left.palm", "right.index.pad")
    maker = TouchAware(scene, solvers=[])
    for one in (left, right):
        maker.take(at.hands.HandFrame(0.0, one.side, 0, one.joints))
    maker.make(0.0, Controls())
    moment = maker.make(0.05, Controls())
    goals = [left.focus("palm"), right.focus("index.pad")]
    np.testing.assert_allclose(moment.foci, goals, atol=1e-6)
    assert moment.pressures.min() > 500.0


def test_an_outline_is_felt_by_a_focus_that_runs_along_the_edge_of_the_contacts(scene):
    ring = at.VirtualObject(at.sphere(0.012, 3e-3), name="ball", style="outline")
    outlined = replace(scene, objects=(ring,))
    maker = TouchAware(outlined, solvers=[])
    first = held(maker)
    later = maker.make(first.time, Controls())
    # One focus goes one frame further at each drive, for boards that play no rounds.
    assert len(first.foci) == len(later.foci) == 1
    assert np.linalg.norm(first.foci - later.foci) > 1e-3
    length = sum(
        np.linalg.norm(np.diff(curve, axis=0), axis=1).sum()
        for curves in at.contact(hand(30), ring).outlines
        for curve in curves
    )
    # Boards that do move it at 7 m/s along both outlines.
    assert later.rate / len(later.frames) * length == pytest.approx(7.0, rel=0.1)
    exact = at.contact(hand(30), ring).target().points
    drives = [maker.make(first.time, Controls()) for _frame in later.frames]
    reached = np.concatenate([moment.foci for moment in drives])
    apart = np.linalg.norm(reached[:, None] - exact, axis=2)
    assert apart.min(axis=1).max() < 1.5e-3
    assert apart.min(axis=0).max() < 4e-3
    # A frame brings the most to the focus that a drive of the same place has.
    frames = np.abs(OpenAir(outlined).rows(drives[-1].foci) @ later.frames.T)
    assert frames.max() == pytest.approx(drives[-1].pressures[0], rel=1e-3)
    # The round does not jump when the skin is the same.
    np.testing.assert_allclose(later.frames, first.frames, atol=1e-3)


def test_foci_that_stay_are_modulated_beside_an_outline(scene):
    ring = at.VirtualObject(at.sphere(0.012, 3e-3), name="ball", style="outline")
    maker = TouchAware(replace(scene, objects=(ring,)), solvers=[])
    wanted = WantedFocus("one", point=np.array([0.0, 0.0, 0.05]))
    maker.feel((ring,), (wanted,))
    moment = held(maker)
    assert moment.names[0] == "one"
    received = np.abs(OpenAir(scene).rows(moment.foci[:1]) @ moment.frames.T)[0]
    assert received.max() > 3.0 * received.min(), received


def test_the_skin_of_a_known_hand_is_meshed_before_its_first_frame(scene, monkeypatch):
    maker = TouchAware(scene, solvers=[], rest=hand(0))
    monkeypatch.setattr("airtact.live.drives.moving_skin.skin_of", None)
    moment = held(maker)
    assert len(moment.foci) == 2
    assert 0.5 < moment.kept < 0.8  # without a solution
