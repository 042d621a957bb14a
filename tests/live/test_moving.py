"""Foci that run along paths on a hand that moves itself: where they are, what they get, and how little drives step."""

import time

import numpy as np
import pytest

import airtact as at
from airtact.live.drives.factors import OpenAir, PartSolver
from airtact.live.drives.moving import Rounds, aligned, moving_points
from airtact.live.scene import pose_hand
from faults import raises_code
from live.live_scenes import Kept, Ready, Scheduled
from references.motions import to_and_fro


def scene_file(folder, modulation: str):
    text = (
        at.example("live_pinch")
        .read_text()
        .replace("hands/pinch.json", str(at.example("pinch.json")))
    )
    path = folder / "moving.toml"
    path.write_text(
        text[: text.index("[drive.modulation]")] + f"[drive.modulation]\n{modulation}\n"
    )
    return at.read_scene(path)


@pytest.fixture(scope="module")
def setup(tmp_path_factory):
    return scene_file(tmp_path_factory.mktemp("moving"), 'kind = "lm"\nframes = 12')


@pytest.fixture(scope="module")
def scene(setup):
    return at.live.live_scene(setup)


@pytest.fixture(scope="module")
def joints(setup):
    return setup.hands[0].joints


@pytest.fixture(scope="module")
def phalanges(scene, joints):
    return PartSolver(scene).meshed(joints, "phalanges", 0.0)


def test_paths_are_those_of_the_scene_and_ride_with_the_hand(setup, scene, joints):
    paths = setup.modulation.paths(setup.scene, setup.target, setup.array.positions.mean(axis=0))
    here = moving_points(scene.moving, pose_hand(scene, joints))
    np.testing.assert_allclose(
        here, paths.transpose(1, 0, 2), atol=2e-4
    )  # the foci of the file are on its mesh
    pose = at.Pose.turn((0.0, 0.0, 1.0), 0.4, (0.01, 0.02, 0.03))
    moved = moving_points(scene.moving, pose_hand(scene, pose.apply(joints)))
    np.testing.assert_allclose(
        moved, pose.apply(here.reshape(-1, 3)).reshape(here.shape), atol=1e-9
    )
    assert scene.moving.rate == pytest.approx(50.0 * 12, rel=0.01)


def test_each_focus_gets_its_sound_where_it_is(scene, joints, phalanges):
    posed = pose_hand(scene, joints)
    frames = Rounds(scene, scene.moving, OpenAir(scene).rows).frames(
        posed, phalanges.factors[2:], "best"
    )
    points = moving_points(scene.moving, posed)
    air = at.Scene(scene.medium, [at.sound_hard(posed.hand.surface)], frequency=scene.frequency)
    some = (0, 6)
    target = at.Target(points[list(some)].reshape(-1, 3))
    beacons = at.BoundaryElement(accuracy=0.08, estimate=False).radiate(air, target.beacons())
    matrix = at.transfer_matrix(beacons, scene.array).matrix.reshape(
        len(some), -1, len(scene.array)
    )
    for rows, index in zip(matrix, some, strict=True):
        transfer = at.TransferMatrix(rows, float("nan"))
        best = at.drives.METHODS["best"](transfer, at.Target(points[index])).amplitudes
        assert np.abs(rows @ frames[index]).min() > 0.8 * np.abs(rows @ best).min()


def largest_step(one, other) -> float:
    """Largest change of the amplitudes times phases of all elements, root mean square over them."""
    return float(np.sqrt(np.mean(np.abs(one - other) ** 2, axis=-1)).max())


@pytest.mark.slow
@pytest.mark.parametrize("modulation", ['kind = "lm"', 'kind = "stm"\npath = "points"'])
def test_a_newer_round_steps_no_farther_than_a_round_itself_at_the_link(
    tmp_path, joints, modulation
):
    scene = at.live.live_scene(scene_file(tmp_path, modulation))
    found = PartSolver(scene).meshed(joints, "phalanges", 0.0)
    maker, link, rounds = (
        at.live.HandAware(scene, solvers=[Ready(found)]),
        at.emission.RecordingLink("autd3", 4),
        [],
    )
    with at.live.Output(link) as boards:
        for index in range(12):
            now = index / 60
            maker.take(
                at.hands.HandFrame(
                    now, "left", index, joints + to_and_fro(0.2 + now) - to_and_fro(0.2)
                )
            )
            moment = maker.make(now, at.live.Controls())
            assert scene.moving is not None
            assert moment.frames is not None
            rounds.append(moment.frames)
            boards.cycle(moment.frames, scene.moving.rate)
            while boards.share < 1.0:  # the sound rises
                time.sleep(1 / 60)
                boards.cycle(moment.frames, scene.moving.rate)
            taken, until = len(link.frames), time.monotonic() + 5
            while len(link.frames) < taken + 3 and time.monotonic() < until:
                time.sleep(1 / 60)
    sent = np.array([frame.drive().amplitudes for frame in link.frames[:-1]])
    sent = sent[np.abs(sent).max(axis=1) > 0.99]
    made = np.array(rounds)
    likeness = np.abs(np.einsum("se,rne->srn", sent.conj(), made)).reshape(len(sent), -1)
    which, place = np.divmod(likeness.argmax(axis=1), made.shape[1])
    replaced = np.flatnonzero(np.diff(which))
    assert len(replaced) > 4
    within = max(largest_step(one, np.roll(one, 1, axis=0)) for one in made)
    for last in replaced:
        # A link that is late skips places of a round; the newer round may step as far as the round
        # itself does there.
        newer = made[which[last + 1]]
        skipped = largest_step(newer[place[last]], newer[place[last + 1]])
        assert largest_step(sent[last], sent[last + 1]) < 1.15 * max(within, skipped)
    assert largest_step(made[0], -made[1]) > 1.5 * largest_step(made[0], made[1])


def test_frames_unlike_their_neighbours_keep_the_phase_that_they_had():
    random = np.random.default_rng(0)
    before = np.exp(2j * np.pi * random.random((12, 249)))
    turned = np.exp(2j * np.pi * random.random((12, 1)))
    assert largest_step(aligned(before * turned, before), before) < 0.3


def test_the_loop_leads_foci_and_the_page_holds_them_still(setup, scene, clock):
    frames = [at.hands.HandFrame(i / 60, "left", i, setup.hands[0].joints) for i in range(40)]
    outputs = []
    for modulated in (True, False):
        outputs.append(Kept(clock))
        hands, maker = Scheduled(clock, frames), at.live.HandAware(scene, solvers=[])
        controls = at.live.Controls(modulated=modulated)
        at.live.follow(scene, hands, maker, output=outputs[-1], controls=controls)
    led, still = outputs
    assert led.cycled
    assert {cycle.shape for cycle in led.cycled} == {(12, len(scene.array))}
    assert np.abs(led.cycled[-1]).max() <= 1.0
    assert still.sent
    assert not still.cycled


@pytest.mark.parametrize(
    ("modulation", "code"),
    [
        ('kind = "lm"\nframes = 100', "sizes_differ"),
        ('kind = "lm"\nfrequency = 4000', "out_of_range"),
    ],
)
def test_paths_that_cannot_be_led_are_rejected(tmp_path, modulation, code):
    with raises_code(code):
        at.live.live_scene(scene_file(tmp_path, modulation))
