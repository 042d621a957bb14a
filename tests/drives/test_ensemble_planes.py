"""Samples before a rigid plane against direct solves, a hand and its mirror as two bodies, and sums of images."""

from dataclasses import replace
from functools import cache

import numpy as np

import airtact as at
from airtact.acoustics.scene import with_images
from airtact.acoustics.uncertainty import draws
from faults import raises_code
from references.rigid_poses import matrices_at

MEDIUM = at.air(celsius=20.0)
TABLE = at.plane((0, 0, -0.014), (0, 0, 1))
FOCI = np.array([[0.0, -4.5e-3, 0.0], [3e-3, 0.0, 4e-3]])
UPRIGHT = at.flat_boards(1, 1).moved(at.Pose.turn((1, 0, 0), -np.pi / 2, (0.0, -0.12, 0.1)))
EXACT = at.BoundaryElement(accuracy=0.005, estimate=False)
STILL = at.Pose.identity()
DOUBT = at.Uncertainty(position=1e-3, rotation=4.0)


def finger(pose: at.Pose = STILL) -> at.Surface:
    return at.capsule((-6e-3, 0, 0), (6e-3, 0, 0), radius=4e-3, edge=2e-3).moved(pose)


def scene(pose: at.Pose = STILL, medium: at.Medium = MEDIUM) -> at.Scene:
    return at.Scene(medium, [at.sound_hard(finger(pose))], frequency=40e3, planes=[TABLE])


@cache
def beacons() -> at.acoustics.RadiatedField:
    return EXACT.radiate(scene(), at.Target(FOCI).beacons())


def in_open_air() -> at.acoustics.RadiatedField:
    empty = at.Scene(MEDIUM, [], frequency=40e3, planes=[TABLE])
    return at.FreeField().radiate(empty, at.Target(FOCI).beacons())


def off(computed, exact) -> float:
    return float(np.linalg.norm(computed - exact) / np.linalg.norm(exact))


def drawn(uncertainty: at.Uncertainty, samples: int) -> list[at.Pose]:
    middle = FOCI.mean(axis=0)
    return [one.hand for one in draws(uncertainty, samples, 0, middle, [middle], len(FOCI))]


def test_each_sample_is_that_of_a_hand_and_its_mirror_image_as_two_bodies() -> None:
    """The last of 64 samples are combined from the solutions for others."""
    computed = at.ensemble(beacons(), UPRIGHT, DOUBT, samples=64, solver=EXACT)
    poses = drawn(DOUBT, 64)
    for index in (0, 1, 62, 63):
        matrix, pose = computed.matrices[index], poses[index]
        start, end = TABLE.image(pose.apply(np.array([[-6e-3, 0, 0], [6e-3, 0, 0]])))
        bodies = [finger(pose), at.capsule(start, end, radius=4e-3, edge=2e-3)]
        both = at.Scene(MEDIUM, [at.sound_hard(one) for one in bodies], frequency=40e3)
        emitting = with_images([TABLE], at.Monopoles(pose.apply(FOCI), np.eye(2)))
        field = EXACT.radiate(both, emitting).at(UPRIGHT.face_points.reshape(-1, 3))
        weights = UPRIGHT.element.sensitivity * UPRIGHT.element.weights
        exact = np.einsum("eqf,q->fe", field.reshape(len(UPRIGHT), -1, 2), weights)
        assert off(matrix, exact) < EXACT.accuracy


def test_the_hands_of_another_seed_are_those_of_another_ensemble() -> None:
    computed = at.ensemble(beacons(), UPRIGHT, DOUBT, samples=8, seed=0, solver=EXACT)
    exact = at.ensemble(beacons(), UPRIGHT, DOUBT, samples=4, seed=3, solver=EXACT)
    again = computed.resampled(4, seed=3)
    assert again.seed == 3
    assert again.geometry.shape == exact.geometry.shape
    assert off(again.matrices, exact.matrices) < EXACT.accuracy
    with raises_code("wrong_kind"):
        computed.of_rows(np.array([0])).resampled(4, seed=3)


def test_one_solve_serves_what_is_off_along_the_plane() -> None:
    """No solver is given: only what keeps the plane is in doubt."""
    doubt = at.Uncertainty(age=0.01, velocity=(0.3, 0.1, 0.0), gain=0.1)
    along = at.ensemble(beacons(), UPRIGHT, doubt, samples=6)
    solved = at.ensemble(beacons(), UPRIGHT, doubt, samples=6, solver=EXACT)
    assert off(along.matrices, solved.matrices) < 1e-12
    turned = at.Pose.turn((0, 0, 1), 0.3, (2e-3, 1e-3, 0.0))
    (computed,) = matrices_at(beacons(), UPRIGHT, [turned])
    exact = EXACT.radiate(scene(turned), at.Target(turned.apply(FOCI)).beacons())
    assert (
        off(computed, at.transfer_matrix(exact, UPRIGHT).matrix) < 3e-3
    )  # other panels on the turned body


def test_shifts_to_one_height_share_a_solve(monkeypatch) -> None:
    nominal = beacons()
    heights = []
    radiate = at.BoundaryElement.radiate

    def counted(solver, there, sources):
        heights.append(there.planes[0].point[2])
        return radiate(solver, there, sources)

    monkeypatch.setattr(at.BoundaryElement, "radiate", counted)
    poses = [
        at.Pose(np.eye(3), np.array([x, y, z]))
        for z in (0.0, 1e-3)
        for x in (0.0, 2e-3)
        for y in (-1e-3, 1e-3)
    ]
    computed = list(matrices_at(nominal, UPRIGHT, poses, solver=EXACT))
    np.testing.assert_allclose(heights, [-0.015])
    for matrix, pose in zip(computed, poses, strict=True):
        field = EXACT.radiate(scene(pose), at.Target(pose.apply(FOCI)).beacons())
        assert off(matrix, at.transfer_matrix(field, UPRIGHT).matrix) < 3e-3


def test_warmer_air_is_solved_in_it() -> None:
    (computed,) = matrices_at(beacons(), UPRIGHT, [at.Pose.identity()], 1.01, EXACT)
    slow = replace(MEDIUM, sound_speed=MEDIUM.sound_speed / 1.01)
    exact = EXACT.radiate(scene(medium=slow), at.Target(FOCI).beacons())
    assert off(computed, at.transfer_matrix(exact, UPRIGHT).matrix) < 1e-6


def test_open_air_before_a_plane_needs_no_solver() -> None:
    doubt = replace(DOUBT, own_position=1e-3, temperature=2.0)
    computed = at.ensemble(in_open_air(), UPRIGHT, doubt, samples=4)
    for matrix, draw in zip(
        computed.matrices, draws(doubt, 4, 0, FOCI.mean(axis=0), list(FOCI), 2), strict=True
    ):
        foci = draw.hand.apply(
            np.stack([own.apply(one) for own, one in zip(draw.groups, FOCI, strict=True)])
        )
        slow = replace(MEDIUM, sound_speed=MEDIUM.sound_speed / draw.slower)
        faces, k = UPRIGHT.face_points.reshape(-1, 1, 3), slow.wavenumber(40e3)
        away = np.linalg.norm(faces - np.concatenate([foci, TABLE.image(foci)]), axis=2)
        exact = (np.exp(1j * k * away) / away).reshape(len(UPRIGHT), -1, 2, 2).sum(axis=2)
        weights = UPRIGHT.element.sensitivity * UPRIGHT.element.weights
        assert off(matrix, np.einsum("eqf,q->fe", exact, weights)) < 1e-9


def test_samples_that_reach_the_plane_are_left_out() -> None:
    computed = at.ensemble(
        beacons(),
        UPRIGHT,
        at.Uncertainty(position=10e-3),
        samples=8,
        solver=at.BoundaryElement(0.1),
    )
    assert 0 < computed.left_out < 8


def test_a_hand_that_is_lifted_needs_a_solver() -> None:
    for doubt in (DOUBT, at.Uncertainty(temperature=1.0), at.Uncertainty(along_skin=1e-3)):
        with raises_code("not_converged"):
            at.ensemble(beacons(), UPRIGHT, doubt, samples=2)
