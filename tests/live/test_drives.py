"""Drives that know the hand: against whole solutions, and beside a process that may say no."""

import time
from dataclasses import replace

import numpy as np
import pytest

import airtact as at
from airtact.live.drives.factors import HandFactors, OpenAir, PartSolver, RigidParts
from airtact.live.drives.solver_process import Request, SolverProcess
from airtact.live.scene import gap_change, pose_hand, turn
from live.live_scenes import Ready, correlations
from references.motions import still


def seen(joints) -> at.hands.HandFrame:
    return still(0, 0.0, landmarks=joints)


def at_weakest(transfer: at.TransferMatrix, amplitudes: np.ndarray) -> float:
    return float(np.abs(transfer.matrix @ amplitudes).min() / np.linalg.norm(amplitudes))


def test_open_air_rows_are_those_of_the_transfer_matrix(board, joints):
    foci = pose_hand(board, joints).foci
    empty = at.Scene(board.medium, [], frequency=board.frequency)
    exact = at.open_air_matrix(empty, board.array, at.Target(foci)).matrix
    np.testing.assert_allclose(OpenAir(board).rows(foci), exact, atol=2e-4 * np.abs(exact).max())


def test_an_element_reaches_nothing_behind_its_face(board, joints):
    behind = board.array.positions.mean(axis=0) - 0.05 * board.array.normals[0]
    assert not OpenAir(board).rows(behind[None]).any()


@pytest.mark.parametrize(("part", "least"), [("phalanges", 0.8), ("hand", 0.95)])
def test_a_still_hand_gets_nearly_what_the_whole_solution_gives(board, joints, exact, part, least):
    maker = at.live.HandAware(
        board, noise=1e-4, solvers=[Ready(PartSolver(board).meshed(joints, part, 0.0))]
    )
    maker.take(seen(joints))
    moment = maker.make(0.01, at.live.Controls())
    best = at.weighted_gerchberg_saxton(exact, at.Target(exact.foci))
    assert moment.rule == part
    assert at_weakest(exact, moment.amplitudes) >= least * at_weakest(exact, best.amplitudes)
    assert moment.shape_age == pytest.approx(0.01)


def test_factors_ride_along_with_a_hand_that_moves_as_a_whole(board, joints, phalanges):
    middle = joints.mean(axis=0)
    pose = at.Pose.turn((0.3, 1.0, 0.2), 0.06, translation=(0.004, -0.003, 0.005))
    moved = pose.apply(joints - middle) + middle
    posed = pose_hand(board, moved)
    fresh = PartSolver(board).meshed(moved, "phalanges", 0.0)
    rows = OpenAir(board).rows(posed.foci)
    assert gap_change(posed.distances, phalanges.distances) < 1e-9
    assert 0.02 < turn(posed.directions, phalanges.directions) < 0.1
    assert correlations(rows * phalanges.factors, rows * fresh.factors).min() > 0.97


def test_phalanges_as_one_body_are_solved_on_panels_of_a_similar_pose(board, joints):
    hand = pose_hand(board, joints).hand
    solver = PartSolver(board)
    for gap in (0.008, 0.010):
        pose = np.array(hand.open_to(gap).joints)
        moved = solver.meshed(pose, "phalanges", 0.0)
    rows, fresh = OpenAir(board).rows(moved.foci), PartSolver(board).meshed(pose, "phalanges", 0.0)
    assert correlations(rows * moved.factors, rows * fresh.factors).min() > 0.99


def test_rigid_phalanges_are_solved_wherever_they_are(board, joints, phalanges):
    wide = np.array(pose_hand(board, joints).hand.open_to(0.03).joints)
    rigid = RigidParts(board, wide)
    again, rows = rigid.solved(joints, 0.0), OpenAir(board).rows(pose_hand(board, joints).foci)
    assert correlations(rows * again.factors, rows * phalanges.factors).min() > 0.98
    assert not rigid.outgrown
    longer = 1.15 * joints
    for index in range(200):
        rigid.solved(longer, 0.01 * index)
        if rigid.outgrown:
            return
    raise AssertionError("bodies of a smaller hand were kept")


def test_distances_are_played_where_nothing_is_solved_or_wanted(board, joints, phalanges):
    maker = at.live.HandAware(board, solvers=[Ready()])
    maker.take(seen(joints))
    assert maker.make(0.0, at.live.Controls()).rule == "distances"
    maker = at.live.HandAware(board, solvers=[Ready(phalanges)])
    maker.take(seen(joints))
    told = maker.make(0.0, at.live.Controls(ignore_hand=True))
    assert (told.rule, told.shape_age) == ("distances", None)
    assert np.abs(told.amplitudes).max() == pytest.approx(1.0)
    assert maker.make(0.0, at.live.Controls()).rule == "phalanges"


def test_a_pose_far_from_what_was_solved_is_not_trusted(board, joints, phalanges):
    far = np.array(pose_hand(board, joints).hand.open_to(0.06).joints)
    near, opened = (
        at.live.HandAware(board, noise=1e-4, solvers=[Ready(phalanges)]) for _ in range(2)
    )
    near.take(seen(joints))
    opened.take(seen(far))
    assert (
        opened.make(0.0, at.live.Controls()).kept < near.make(0.0, at.live.Controls()).kept - 0.15
    )


def test_a_lost_hand_is_silent(board, joints):
    maker = at.live.HandAware(board, solvers=[Ready()])
    for begun in (False, True):
        moment = maker.make(1.0, at.live.Controls())
        assert moment.joints is None
        assert moment.foci is None
        assert not moment.amplitudes.any()
        if not begun:
            maker.take(seen(joints))


def test_the_process_solves_says_what_it_cannot_and_ends(board, joints):
    process = SolverProcess(board, "phalanges")
    crossed = joints.copy()
    crossed[[2, 3, 4]] = joints[[7, 8, 9]]  # the thumb within the index finger

    def wait_for(kind: type, hand: np.ndarray) -> object:
        until = time.monotonic() + 120.0
        while time.monotonic() < until:
            process.ask(Request(0.0, hand, np.zeros((25, 3)), time.monotonic()))
            found = [one for one in process.solutions() if isinstance(one, kind)]
            if found:
                return found[-1]
            time.sleep(0.01)
        raise AssertionError(f"no {kind} within a minute")

    try:
        assert "mm" in wait_for(str, crossed)
        assert wait_for(HandFactors, joints).factors.shape == (2, len(board.array))
    finally:
        process.close()
    assert process._worker.process.poll() is not None


def test_solvers_that_rested_go_on_when_the_tracker_is_quieter(board, joints):
    solver, random = Ready(), np.random.default_rng(3)
    maker = at.live.HandAware(
        replace(board, places=("palm",), offsets=board.offsets[:1]), solvers=[solver]
    )
    asked = []
    for index in range(200):
        noise = 2.5e-3 if index < 100 else 1e-4
        maker.take(still(index, index / 60, landmarks=joints + noise * random.normal(size=(25, 3))))
        solver.asked = None
        maker.make(index / 60 + 0.01, at.live.Controls())
        asked.append(solver.asked is not None)
    assert not any(asked[20:100])
    assert all(asked[170:])


def test_a_solver_that_is_killed_is_restarted(board):
    solver = SolverProcess(board, "phalanges")
    try:
        first = solver._worker.process
        assert solver.revive() == 0
        first.kill()
        first.wait()
        assert solver.revive() == 1
        assert solver._worker.process is not first
    finally:
        solver.close()
