"""Several traps at once, and traps with foci, between two boards that face each other."""

import numpy as np
import pytest

import airtact as at
from faults import raises_code

SCENE = at.Scene(at.Medium(sound_speed=343.1, density=1.2))
BOARD = at.flat_boards(1, 1)
LEVEL = BOARD.moved(at.Pose.turn((1, 0, 0), 0.0, -BOARD.positions.mean(axis=0)))
FACING = LEVEL.moved(at.Pose.turn((1, 0, 0), np.pi, (0.0, 0.0, 0.2)))
PAIR = at.transducers.join([LEVEL, FACING])
UP = (0, 0, 1)
FOUR = np.array(
    [[-0.03, -0.01, 0.09], [0.02, -0.02, 0.1], [-0.01, 0.025, 0.107], [0.02, 0.01, 0.12]]
)


def weakest(drive: at.Drive, points: np.ndarray) -> float:
    """Smallest stiffness along any direction at the equilibria next to the points."""
    places = at.traps.find(SCENE, PAIR, drive, points)
    assert (np.linalg.norm(places - points, axis=1) < 0.5e-3).all()
    verdicts = at.traps.verdict(SCENE, PAIR, drive, places)
    assert all(verdict.is_trap for verdict in verdicts)
    return min(np.linalg.eigvalsh(verdict.stiffness).min() for verdict in verdicts)


@pytest.mark.parametrize(("kind", "axis"), [("twin", (0, 1, 0)), ("vortex", UP)])
def test_one_trap_has_the_phases_of_its_signature(kind, axis) -> None:
    point = np.array([[0.0, 0.0, 0.1]])
    focus = at.focus_by_distance(LEVEL, at.Target(point), SCENE.medium, SCENE.frequency)
    signed = at.traps.signature(LEVEL, focus, kind, axis)
    held = at.traps.hold(SCENE, LEVEL, point, kind, axis)
    ratio = held.amplitudes * signed.amplitudes.conj()
    assert np.abs(ratio.mean()) > 0.999


def test_four_traps_hold_as_well_as_a_signature_on_four_foci() -> None:
    held = weakest(at.traps.hold(SCENE, PAIR, FOUR, axis=UP), FOUR)
    field = at.FreeField().radiate(SCENE, at.Target(FOUR).beacons())
    foci = at.best(at.transfer_matrix(field, PAIR), at.Target(FOUR))
    assert held > 0.9 * weakest(at.traps.signature(PAIR, foci, "twin", UP), FOUR)
    # The elements are shared: pressures scale with 1/√4, stiffnesses with 1/4.
    alone = weakest(at.traps.hold(SCENE, PAIR, FOUR[1:2], axis=UP), FOUR[1:2])
    assert 0.15 * alone < held < 0.3 * alone


def test_the_stiffest_traps_are_stiffer_and_at_their_points() -> None:
    drive = at.traps.stiffest(SCENE, PAIR, FOUR, axis=UP)
    np.testing.assert_allclose(at.traps.find(SCENE, PAIR, drive, FOUR), FOUR, atol=0.02e-3)
    stiff = weakest(drive, FOUR)
    assert stiff > 1.08 * weakest(at.traps.hold(SCENE, PAIR, FOUR, axis=UP), FOUR)
    # Four traps of equal amplitude have a quarter of the stiffness of one.
    alone = at.traps.stiffest(SCENE, PAIR, FOUR[1:2], axis=UP)
    assert 0.7 < 4 * stiff / weakest(alone, FOUR[1:2]) < 1.1


def test_the_stiffest_trap_beside_a_ball_is_balanced_with_its_echo() -> None:
    ball = at.Scene(SCENE.medium, [at.sound_hard(at.sphere(8e-3, 2e-3, centre=(0.015, 0, 0.1)))])
    point = np.array([[0.0, 0.0, 0.1]])
    solver = at.SphereSeries()
    held = at.traps.hold(ball, PAIR, point, axis=UP, solver=solver)
    stiff = at.traps.stiffest(ball, PAIR, point, axis=UP, solver=solver)
    before, after = (
        np.linalg.norm(at.traps.force(ball, PAIR, drive, point, solver=solver))
        for drive in (held, stiff)
    )
    assert after < 0.05 * before


def test_a_focus_beside_traps_gets_its_share() -> None:
    points = np.array([[0.0, 0.0, 0.1]])
    focus = np.array([[0.03, 0.03, 0.1]])
    drive = at.traps.hold(SCENE, PAIR, points, axis=UP, foci=focus, focus_share=0.5)
    assert weakest(drive, points) > 0.0
    lobe = points + [0.0, 0.0, SCENE.wavelength / 6]
    places = np.concatenate([focus, lobe])
    first, second = np.abs(at.field_map(SCENE, PAIR, drive, places, solver=at.FreeField()))
    assert first == pytest.approx(0.5 * second, rel=0.1)


def test_a_trap_beside_a_ball_uses_its_echo() -> None:
    ball = at.Scene(SCENE.medium, [at.sound_hard(at.sphere(10e-3, 2e-3, centre=(0.02, 0, 0.1)))])
    point = np.array([[0.0, 0.0, 0.1]])
    solver = at.SphereSeries()
    strengths = []
    for scene in (ball, SCENE):
        drive = at.traps.hold(
            scene, LEVEL, point, foci=None, solver=solver if scene is ball else None
        )
        target = point + SCENE.wavelength / 6 * np.array([[0, 1, 0], [0, -1, 0]])
        lobes = at.field_map(ball, LEVEL, drive, target, solver=solver)
        strengths.append(np.abs(lobes[0] - lobes[1]))
    assert strengths[0] > 1.002 * strengths[1]


def test_impossible_traps_are_rejected(as_outside_the_tests) -> None:
    with raises_code("unknown_name", "'bottle'"):
        at.traps.hold(SCENE, PAIR, FOUR, "bottle")
    with raises_code("all_zero"):
        at.traps.hold(SCENE, PAIR, FOUR, axis=(0, 0, 0))
    ball = at.Scene(SCENE.medium, [at.sound_hard(at.sphere(8e-3, 2e-3, centre=(0, 0, 0.1)))])
    for height, words in (
        (0.1, "trap 0 at (0.00, 0.00, 100.00) mm is 8 mm inside"),
        (0.109, "lobe"),
    ):
        with raises_code("inside_body", words):
            at.traps.hold(ball, PAIR, np.array([[0.0, 0.0, height]]), axis=UP)
    with raises_code("behind_faces"):
        at.traps.hold(SCENE, LEVEL, np.array([[0.0, 0.0, -0.05]]))
