"""A hand on panels that bend with it: against whole solutions of the bent hand, and against a rigid motion of it."""

import time
from dataclasses import replace

import numpy as np
import pytest

import airtact as at
from airtact.acoustics.solvers.shared import monopole_pressure
from airtact.hands.kinematics import turned
from airtact.live.drives.bending import BendingHand, bones_of
from airtact.live.drives.factors import HandFactors, OpenAir, PartSolver
from airtact.live.drives.maker import solved_for
from airtact.live.drives.solver_process import Request, SolverProcess
from airtact.live.scene import pose_hand
from live.live_scenes import correlations, one_board
from references.hand_poses import example


@pytest.fixture(scope="module")
def joints():
    return example("relaxed")[0]


@pytest.fixture(scope="module")
def scene(joints):
    """A board before an open hand, foci off its palm and two of its fingers."""
    radii = example("relaxed")[1]
    hand = at.hand_from_joints(joints, radii)
    array = at.autd3_board().facing(
        tuple(joints.mean(axis=0)), tuple(hand.position("palm")[1]), 0.2
    )
    places, offsets = ("palm", "index.pad", "ring.pad"), np.full(3, 3e-3)
    return replace(
        one_board(), array=array, side=hand.side, radii=radii, places=places, offsets=offsets
    )


def bent(joints: np.ndarray, scene: at.live.LiveScene, angle: float) -> np.ndarray:
    for finger in (1, 2, 3, 4):
        joints = turned(joints, scene.side, finger, -angle * (1.0 + 0.2 * finger))
    return joints


@pytest.fixture(scope="module")
def bending(scene, joints):
    """A hand that was solved a little bent, on panels that were made for the straight one."""
    found = BendingHand(scene)
    found.solved(joints, 0.0)
    found.keep(found.solved(bent(joints, scene, 0.04), 0.0))
    return found


def alike(scene, joints, factors: np.ndarray, reference: np.ndarray) -> np.ndarray:
    rows = OpenAir(scene).rows(pose_hand(scene, joints).foci)
    return correlations(rows * factors, rows * reference)


def test_the_pose_that_was_solved_is_the_whole_solution(scene, joints, bending):
    pose = bent(joints, scene, 0.04)
    found = bending.carried(pose, 1.0)
    assert (found.part, found.time, found.share) == ("carried", 1.0, pytest.approx(1.0))
    assert (
        alike(scene, pose, found.factors, PartSolver(scene).meshed(pose, "hand", 0.0).factors).min()
        > 0.96
    )


def test_sound_that_is_carried_is_nearer_to_a_bent_hand_than_sound_that_is_not(
    scene, joints, bending
):
    pose = bent(joints, scene, 0.08)
    truth = PartSolver(scene).meshed(pose, "hand", 0.0).factors
    carried = alike(scene, pose, bending.carried(pose, 0.0).factors, truth)
    left = alike(scene, pose, bending.carried(bent(joints, scene, 0.04), 0.0).factors, truth)
    assert carried.min() > 0.9
    assert ((1.0 - carried) < 0.5 * (1.0 - left))[
        1:
    ].all()  # of the fingers; the palm stays where it is
    assert bending.carried(pose, 0.0).share < 1.0


def test_a_hand_that_moves_as_a_whole_carries_its_sources_along(scene, joints, bending):
    pose = at.Pose.turn((0.3, 1.0, 0.2), 0.1, translation=(0.004, -0.003, 0.005))
    start = bent(joints, scene, 0.04)
    found = bending.carried(pose.apply(start), 0.0)
    sources, array = bending.solved(start, 0.0), scene.array
    faces = pose.inverse().apply(array.face_points.reshape(-1, 3))
    strengths = sources.rest.copy()
    strengths[sources.of_leading] += sources.leading.strengths(sources.posed)
    wavenumber = scene.medium.wavenumber(scene.frequency)

    def heard(points: np.ndarray, strengths: np.ndarray) -> np.ndarray:
        pressure = monopole_pressure(faces, points, strengths, wavenumber, "float64")
        return array.element.weights @ pressure.reshape(len(array), -1, 3)

    truth = 1.0 + heard(sources.points, strengths) / heard(sources.posed.foci, np.eye(3) + 0j)
    off = np.linalg.norm(found.factors.T - truth) / np.linalg.norm(truth)
    assert off < 0.065  # found at a quarter of the elements; 0.08 without their pattern


def test_what_comes_by_way_of_bones_is_added_up_with_the_phase_of_its_path(scene, joints, bending):
    found, later = bending.carried(joints, 0.0), pose_hand(scene, bent(joints, scene, 0.02))
    moved = bones_of(later.hand)
    turns = np.einsum("hij,hik->hjk", found.bones.axes, moved.axes)
    centres = (
        np.einsum("hfj,hjk->hfk", found.centres - found.bones.starts[:, None], turns)
        + moved.starts[:, None]
    )
    by_way = np.linalg.norm(centres[:, :, None] - scene.array.positions, axis=3)
    straight = np.linalg.norm(later.foci[:, None] - scene.array.positions, axis=2)
    longer = np.linalg.norm(centres - later.foci, axis=2)[..., None] + by_way - straight
    phases = scene.medium.wavenumber(scene.frequency).real * longer
    expected = found.straight[:, None] + np.sum(found.waves * np.exp(1j * phases), axis=0)
    np.testing.assert_allclose(found.at(scene, later), expected, atol=1e-3 * np.abs(expected).max())


def test_whole_hands_are_carried_where_foci_are_many(scene):
    assert solved_for(scene) == ["carried"]
    assert "carried" not in solved_for(one_board())


@pytest.mark.slow
def test_a_process_carries_what_its_thread_solves_and_ends_without_a_fault(scene, joints):
    process = SolverProcess(scene, "carried")
    try:
        until = time.monotonic() + 300.0
        while not (found := process.solutions()) and time.monotonic() < until:
            process.ask(Request(0.0, joints, np.zeros((25, 3)), time.monotonic()))
            time.sleep(0.02)
        assert isinstance(found[-1], HandFactors)
        assert found[-1].factors.shape == (3, len(scene.array))
        process.ask(Request(0.1, joints, np.zeros((25, 3)), time.monotonic()))
        process._worker._mailbox.end()  # as where the loop is gone, in the middle of what its thread solves
        assert process._worker.process.wait(300.0) == 0
    finally:
        process.close()
