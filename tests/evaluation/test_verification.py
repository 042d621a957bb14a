"""Every figure of a verification, against closed forms in open air and beside a sphere."""

import numpy as np
import pytest

import airtact as at
from faults import raises_code

AIR = at.Medium(343.1, 1.293)
OPEN_AIR = at.Scene(AIR, [])
RING = np.linspace(0, 2 * np.pi, 24, endpoint=False)
ARRAY = at.PhasedArray(
    np.stack([0.08 * np.cos(RING), 0.08 * np.sin(RING), 0.02 * np.sin(3 * RING)], axis=1),
    np.stack([-np.cos(RING), -np.sin(RING), 0 * RING], axis=1),
    at.monopole(),
)
TWO = np.array([[0.004, 0.0, 0.0], [-0.006, 0.002, 0.0]])


def in_open_air(target: at.Target) -> at.TransferMatrix:
    return at.transfer_matrix(at.FreeField().radiate(OPEN_AIR, target.beacons()), ARRAY)


def verified(drive, target, **given) -> at.evaluation.Verification:
    return at.evaluation.verify(OPEN_AIR, ARRAY, drive, target, solver=at.FreeField(), **given)


def test_no_drive_gets_more_than_is_attainable() -> None:
    target = at.Target(TWO)
    transfer = in_open_air(target)
    drawn = np.random.default_rng(3)
    for _ in range(50):
        drive = drawn.uniform(size=24) * np.exp(2j * np.pi * drawn.uniform(size=24))
        got = np.abs(transfer.pressure(at.Drive(drive)))
        assert np.all(got <= at.evaluation.attainable(transfer) * (1 + 1e-12))
    alone = at.Target(TWO[:1])
    strongest = verified(at.drives.phase_conjugate(in_open_air(alone), alone), alone)
    assert strongest.attained[0] == pytest.approx(1.0, abs=1e-12)


def test_the_effect_of_rounding_is_that_of_the_rounded_drive() -> None:
    target = at.Target(TWO)
    transfer = in_open_air(target)
    drive = at.time_reversal(transfer, target)
    for levels in (at.transducers.levels.EIGHT_BITS, at.transducers.Levels.even(5, 8)):
        result = verified(drive, target, transfer=transfer, levels=levels)
        rounded = at.quantise(drive, levels).drive()
        exact, emitted = (np.abs(transfer.pressure(one)) for one in (drive, rounded))
        loss = np.max(np.abs(emitted - exact) / exact)
        assert result.quantisation_loss == pytest.approx(loss, rel=1e-9)
    assert "rounding to 5 amplitude levels and 8 phase levels changes the pressure" in str(result)


def test_the_side_lobe_of_one_element_is_where_the_box_comes_nearest_to_it() -> None:
    single = at.PhasedArray(
        np.array([[0.0, 0.0, 0.1]]), np.array([[0.0, 0.0, -1.0]]), at.monopole(sensitivity=2.0)
    )
    target = at.Target(np.array([[0.0, 0.0, 0.0]]), suppression_points=np.array([[0.0, 0.0, -0.1]]))
    result = at.evaluation.verify(
        OPEN_AIR,
        single,
        at.Drive(np.array([1.0 + 0j])),
        target,
        solver=at.FreeField(),
        head=(0.0, 0.3, 0.1),
    )
    top = 2 * OPEN_AIR.wavelength
    assert result.side_lobe.point[2] == pytest.approx(top)
    assert result.side_lobe.pressure == pytest.approx(
        2.0 / np.hypot(0.1 - top, result.side_lobe.point[0] * 1.5), 0.03
    )
    assert result.contrast == pytest.approx(20 * np.log10((2.0 / 0.1) / result.side_lobe.pressure))
    assert result.suppression_level == pytest.approx(20 * np.log10(0.1 / 0.2))
    assert result.head == pytest.approx([20 * np.log10(2.0 / 0.3 / np.sqrt(2) / 20e-6)])
    assert result.skin is None
    assert np.isnan(result.forces).all()


def test_the_side_lobe_of_a_wide_target_is_not_lost_between_the_points_of_the_box() -> None:
    # A focus that the target does not name, midway between the points of a box so wide that they
    # are 5 mm apart.
    hidden = at.Target(np.array([[0.005, -0.0099, 0.0001]]))
    drive = at.drives.phase_conjugate(in_open_air(hidden), hidden)
    wide = at.Target(np.array([[-0.05, -0.05, -0.04], [0.05, -0.05, 0.0], [0.0, 0.05, 0.06]]))
    result = at.evaluation.verify(OPEN_AIR, ARRAY, drive, wide, solver=at.FreeField())
    peak = np.abs(in_open_air(hidden).pressure(drive))[0]
    assert result.side_lobe.pressure > peak


@pytest.fixture(scope="module")
def beside_a_ball() -> tuple[at.evaluation.Verification, at.evaluation.Verification]:
    scene = at.Scene(AIR, [at.sound_hard(at.sphere(6e-3, edge=2e-3))])
    target = at.Target(np.array([[0.0065, 0.0, 0.0], [0.0, 0.012, 0.0]]))
    drive = at.drives.phase_conjugate(
        at.transfer_matrix(at.SphereSeries().radiate(scene, target.beacons()), ARRAY), target
    )
    exact, numeric = (
        at.evaluation.verify(scene, ARRAY, drive, target, solver=one)
        for one in (at.SphereSeries(), at.BoundaryElement(0.003))
    )
    return exact, numeric


def test_two_solvers_agree(beside_a_ball) -> None:
    exact, numeric = beside_a_ball
    np.testing.assert_allclose(numeric.attained, exact.attained, rtol=0.01)
    # The second focus is 6 mm from the skin.
    np.testing.assert_allclose(numeric.forces, exact.forces, rtol=0.02)
    assert np.isfinite(exact.forces).tolist() == [True, False]
    assert numeric.side_lobe.pressure == pytest.approx(exact.side_lobe.pressure, rel=0.01)
    np.testing.assert_allclose(numeric.side_lobe.point, exact.side_lobe.point, atol=1e-9)


def test_what_cannot_be_verified_raises() -> None:
    target = at.Target(TWO)
    drive = at.Drive(np.ones(24, dtype=complex))
    with raises_code("misplaced"):
        at.evaluation.verify(
            OPEN_AIR,
            ARRAY,
            drive,
            target,
            solver=at.FreeField(),
            head=np.stack([np.zeros(3), ARRAY.positions[3]]),
        )
    scene = at.Scene(AIR, [at.sound_hard(at.sphere(4e-3, edge=2e-3, centre=(0.03, 0.0, 0.0)))])
    inside = at.Target(TWO, suppression_points=np.array([[0.03, 0.0, 0.0]]))
    with raises_code("inside_body"):
        at.evaluation.verify(scene, ARRAY, drive, inside, solver=at.SphereSeries())
    other = in_open_air(at.Target(TWO[:1]))  # one focus would be broadcast over two
    with raises_code("sizes_differ"):
        at.evaluation.verify(OPEN_AIR, ARRAY, drive, target, solver=at.FreeField(), transfer=other)
