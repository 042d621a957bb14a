"""Transfer matrices of sampled hands against those of hands that were placed there, and solved anew."""

from functools import cache

import numpy as np
import pytest

import airtact as at
from airtact.acoustics.uncertainty import draws
from airtact.drives.transfer_ensemble import TransferEnsemble
from faults import raises_code
from references.rigid_poses import matrices_at

FOCI = np.array([[0.0, 0.0, 8.5e-3], [3e-3, 0.0, 8.2e-3]])
MEDIUM = at.air(celsius=20.0)
FLAT = at.flat_boards(1, 2).moved(at.Pose.turn((1, 0, 0), np.pi, (0, 0, 0.15)))


def ball(centre=(0.0, 0.0, 0.0)) -> at.Surface:
    return at.sphere(radius=8e-3, centre=centre, edge=3e-3)


@cache
def beacons() -> at.acoustics.RadiatedField:
    scene = at.Scene(MEDIUM, [at.sound_hard(ball())], frequency=40e3)
    return at.SphereSeries().radiate(scene, at.Target(FOCI).beacons())


def in_open_air(points=FOCI) -> at.acoustics.RadiatedField:
    return at.FreeField().radiate(at.Scene(MEDIUM, [], frequency=40e3), at.Target(points).beacons())


def off(computed, exact) -> float:
    return float(np.linalg.norm(computed - exact) / np.linalg.norm(exact))


def test_nothing_in_doubt_gives_the_nominal_matrix() -> None:
    nominal = at.transfer_matrix(beacons(), FLAT)
    samples = at.ensemble(beacons(), FLAT, at.Uncertainty(), samples=3)
    assert samples.geometry.shape == (3, 2, 498)
    assert samples.gains is None
    np.testing.assert_allclose(samples.geometry, np.stack([nominal.matrix] * 3), rtol=1e-6)


@pytest.mark.parametrize("array", [FLAT, at.surrounding_box()], ids=["flat", "box"])
def test_a_hand_that_is_off_gives_the_matrix_of_that_place(array) -> None:
    poses = [
        at.Pose.turn((1, 2, 3), np.radians(5.0), (2e-3, -1e-3, 1e-3)),
        at.Pose.turn((0, 1, 0), 0.0, (0, 0, 3e-3)),
    ]
    computed = np.stack([one for one in matrices_at(beacons(), array, poses) if one is not None])
    exact = np.stack(
        [at.transfer_matrix(beacons(), array.seen_from(pose)).matrix for pose in poses]
    )
    assert off(computed, exact) < 0.01


def test_samples_follow_the_draws_and_the_seed() -> None:
    uncertainty = at.Uncertainty(position=1e-3, rotation=2.0)
    one, same, other = (
        at.ensemble(in_open_air(), FLAT, uncertainty, samples=8, seed=seed) for seed in (5, 5, 6)
    )
    np.testing.assert_array_equal(one.matrices, same.matrices)
    assert off(other.matrices, one.matrices) > 0.1
    drawn = draws(uncertainty, 8, 5, FOCI.mean(axis=0), [FOCI.mean(axis=0)], 2)
    exact = [at.transfer_matrix(in_open_air(), FLAT.seen_from(draw.hand)).matrix for draw in drawn]
    assert off(one.matrices, np.stack(exact)) < 1e-3


def test_the_draws_have_the_deviations_that_were_asked() -> None:
    uncertainty = at.Uncertainty(
        position=1e-3,
        rotation=3.0,
        along_skin=2e-3,
        age=0.01,
        velocity=(0.5, 0, 0),
        temperature=2.0,
    )
    middle = np.array([0.01, 0.02, 0.03])
    drawn = list(draws(uncertainty, 1024, 0, middle, [middle], 1))
    shifts = np.stack([one.hand.apply(middle) - middle for one in drawn])
    np.testing.assert_allclose(shifts.std(axis=0), [np.hypot(1e-3, 5e-3), 1e-3, 1e-3], rtol=0.03)
    cosines = [(np.trace(one.hand.rotation) - 1.0) / 2.0 for one in drawn]
    assert np.degrees(np.sqrt(np.mean(np.arccos(np.clip(cosines, -1, 1)) ** 2))) == pytest.approx(
        3.0, rel=0.03
    )
    assert np.stack([one.skin for one in drawn]).std() == pytest.approx(2e-3, rel=0.03)
    # 0.606 m/s for each kelvin at 20 degrees (Cramer 1993), of 344 m/s
    assert np.std([one.slower for one in drawn]) == pytest.approx(2.0 * 0.00175, rel=0.05)


def test_warmer_air_is_the_field_solved_in_it() -> None:
    """What scaling neglects: 2 K move the ball's surface by 0.03 mm."""
    uncertainty = at.Uncertainty(temperature=4.0)
    samples = at.ensemble(beacons(), FLAT, uncertainty, samples=2, seed=1)
    slower = [
        one.slower for one in draws(uncertainty, 2, 1, FOCI.mean(axis=0), [FOCI.mean(axis=0)], 2)
    ]
    for computed, factor in zip(samples.matrices, slower, strict=True):
        warm = at.Medium(MEDIUM.sound_speed / factor, MEDIUM.density, MEDIUM.absorption)
        scene = at.Scene(warm, [at.sound_hard(ball())], frequency=40e3)
        solved = at.transfer_matrix(
            at.SphereSeries().radiate(scene, at.Target(FOCI).beacons()), FLAT
        ).matrix
        assert off(computed, solved) < 0.1 * off(samples.matrix, solved) + 0.005


def test_dead_elements_and_phases_cost_what_ruze_says() -> None:
    """Mean pressure (1 − dead) e^{−σ²/2} of the nominal one (J. Ruze, Proc. IEEE 54, 633 (1966))."""
    uncertainty = at.Uncertainty(dead=0.1, phase=20.0, gain=0.05)
    samples = at.ensemble(in_open_air(FOCI[:1]), FLAT, uncertainty, samples=400)
    drive = at.time_reversal(samples, at.Target(FOCI[:1]))
    mean = np.abs(samples.pressures(drive)).mean() / abs(samples.pressure(drive)[0])
    assert mean == pytest.approx(0.9 * np.exp(-0.5 * np.radians(20.0) ** 2), rel=0.01)


def two_balls(apart: float = 0.02) -> tuple[at.Scene, at.Target]:
    centres = [(-apart / 2, 0, 0), (apart / 2, 0, 0)]
    bodies = [at.sound_hard(at.sphere(radius=5e-3, centre=centre, edge=2e-3)) for centre in centres]
    foci = np.array([[-apart / 2, 0, 5.5e-3], [apart / 2, 0, 5.5e-3]])
    return at.Scene(MEDIUM, bodies, frequency=40e3), at.Target(foci)


def test_bodies_that_move_by_themselves() -> None:
    """With a solver each sample is solved where its bodies are; without, each focus takes all bodies along."""
    scene, target = two_balls()
    solver = at.BoundaryElement(accuracy=0.05, estimate=False)
    uncertainty = at.Uncertainty(own_position=1e-3)
    field = solver.radiate(scene, target.beacons())
    solved = at.ensemble(field, FLAT, uncertainty, samples=2, solver=solver)
    quick = at.ensemble(field, FLAT, uncertainty, samples=2)
    middle = target.points.mean(axis=0)
    for index, draw in enumerate(draws(uncertainty, 2, 0, middle, list(target.points), 2)):
        moved = [
            at.sound_hard(one.surface.moved(own))
            for one, own in zip(scene.obstacles, draw.groups, strict=True)
        ]
        foci = np.stack(
            [own.apply(point) for own, point in zip(draw.groups, target.points, strict=True)]
        )
        there = at.Scene(MEDIUM, moved, frequency=40e3)
        exact = at.transfer_matrix(solver.radiate(there, at.Target(foci).beacons()), FLAT).matrix
        assert off(solved.matrices[index], exact) < 0.02
        assert off(quick.matrices[index], exact) < 0.3 < off(solved.matrix, exact)


def test_foci_along_the_skin_stay_as_far_from_it() -> None:
    uncertainty = at.Uncertainty(along_skin=1e-3)
    scene = beacons().scene
    solver = at.SphereSeries()
    quick = at.ensemble(beacons(), FLAT, uncertainty, samples=2)
    solved = at.ensemble(beacons(), FLAT, uncertainty, samples=2, solver=solver)
    assert off(solved.matrices, np.stack([solved.matrix] * 2)) > 0.1
    assert off(quick.matrices, solved.matrices) < 0.15
    assert scene.obstacles


# --- bad input ------------------------------------------------------------------------------------------------------


def test_samples_that_cannot_be_are_left_out_and_counted() -> None:
    near = at.autd3_board().moved(at.Pose.turn((1, 0, 0), np.pi, (0.0, 0.0, 0.012)))
    some = at.ensemble(beacons(), near, at.Uncertainty(position=3e-3), samples=32)
    assert 0 < some.left_out == 32 - len(some.geometry)
    assert repr(some).endswith(f"{some.left_out} left out)")
    away = at.Uncertainty(age=1.0, velocity=(0.0, 0.0, 20.0))
    assert at.ensemble(beacons(), FLAT, away, samples=8).left_out
    with raises_code("empty"):
        at.ensemble(beacons(), at.surrounding_box(), at.Uncertainty(position=0.1), samples=1)


@pytest.mark.parametrize(("samples", "seed"), [(0, 0), (100_000, 0), (4, -1)])
def test_wrong_numbers_of_samples_raise(samples, seed) -> None:
    with raises_code("out_of_range"):
        at.ensemble(in_open_air(), FLAT, at.Uncertainty(), samples=samples, seed=seed)


def test_doubts_about_what_there_is_not_raise() -> None:
    water = at.Scene(at.Medium(1481.0, 1000.0), [], frequency=40e3)
    in_water = at.FreeField().radiate(water, at.Target(FOCI).beacons())
    for field, doubt, code in (
        (in_water, at.Uncertainty(temperature=1.0), "does_not_match"),
        (in_open_air(), at.Uncertainty(along_skin=1e-3), "empty"),
    ):
        with raises_code(code):
            at.ensemble(field, FLAT, doubt)


def test_an_ensemble_is_a_transfer_matrix_with_samples_of_its_shape() -> None:
    samples = at.ensemble(in_open_air(), FLAT, at.Uncertainty(position=1e-3), samples=4)
    assert isinstance(samples, at.TransferMatrix)
    with raises_code("sizes_differ"):
        samples.pressures(at.focus_by_distance(at.autd3_board(), at.Target(FOCI), MEDIUM, 40e3))
    with raises_code("wrong_shape"):
        TransferEnsemble(matrix=samples.matrix, estimated_error=0.0, geometry=samples.geometry[:0])
