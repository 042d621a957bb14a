"""Pose and gap together: matrices between the solved gaps, their derivatives, and what echoes determine of both."""

from functools import cache

import numpy as np
import pytest

import airtact as at
from airtact.sensing.echo_model import EchoModel
from faults import raises_code
from sensing.sensed_scenes import (
    AIR,
    BOX,
    CODES,
    TRUE,
    capsules,
    errors,
    measured,
    off_by,
    relative,
)

COARSE = at.BoundaryElement(accuracy=0.03, estimate=False)


@cache
def family() -> at.sensing.ScatteringFamily:
    return at.sensing.scattering_family(COARSE, capsules, 12e-3, 14e-3, values=4)


def test_between_the_values_the_matrix_is_that_of_a_solve() -> None:
    made = family()
    value = 12.55e-3
    ball = made.matrices[0].centre, made.matrices[0].radius
    solved = at.scattering_matrix(COARSE, capsules(value), ball=ball)
    assert relative(made.at(value).matrix, solved.matrix) < 0.01
    nodes = [0.5 * (12e-3 + 14e-3) + 1e-3 * x for x in np.polynomial.chebyshev.chebpts1(4)]
    assert all(
        relative(made.at(x).matrix, one.matrix) < 1e-10
        for x, one in zip(nodes, made.matrices, strict=True)
    )
    assert 1e-4 < made.error < 0.02


def test_pose_and_gap_are_found_together() -> None:
    found = at.locate(measured(13.6e-3), family(), BOX, off_by(TRUE, 1e-3, np.radians(2), seed=0))
    position, angle = errors(found.pose)
    assert found.converged, found
    assert found.opening == pytest.approx(13.6e-3, abs=1e-5)
    assert position < 1e-5
    assert angle < np.radians(0.1)
    assert found.covariance.shape == found.bound.shape == (7, 7)
    assert 0.0 < found.opening_deviation < 1e-5
    assert "opening 0.0136" in repr(found)


def test_the_derivatives_by_the_gap_are_those_of_the_echoes() -> None:
    twist = np.array([9e-4, -4e-4, 7e-4, 0.02, 0.03, -0.01])
    some = np.arange(0, 996, 50)

    def echoes(scattering: at.sensing.ScatteringMatrix) -> np.ndarray:
        seen = BOX.seen_from(TRUE)
        return EchoModel.of(scattering, seen, CODES[:, :2], some, spare=9).echoes(twist)

    differences = (echoes(family().at(13.1e-3)) - echoes(family().at(12.9e-3))) / 2e-4
    assert relative(echoes(family().derivative(13e-3)), differences) < 5e-3


def test_a_gap_outside_the_range_is_not_believed() -> None:
    placed, receivers = BOX.seen_from(TRUE), np.arange(0, 996, 12)
    echoes = at.simulate_echoes(
        COARSE, capsules(15e-3), placed, CODES[:, :4], noise=30.0, seed=1, receivers=receivers
    )
    found = at.locate(echoes, family(), BOX, off_by(TRUE, 1e-3, np.radians(2), seed=0))
    assert not found.converged


def test_an_opening_that_is_a_motion_is_named() -> None:
    def lifted(height: float) -> at.Scene:
        balls = [
            at.sphere(3e-3, 2e-3, (x, y, height)) for x, y in ((-5e-3, 0), (5e-3, 2e-3), (0, 7e-3))
        ]
        return at.Scene(AIR, [at.sound_hard(one) for one in balls], frequency=40e3)

    made = at.sensing.scattering_family(
        at.BoundaryElement(accuracy=0.1, estimate=False), lifted, -5e-4, 5e-4
    )
    echoes = at.simulate_echoes(made.matrices[0], made.scene, BOX, CODES[:, :2])
    with raises_code("pose_not_found"):
        at.locate(echoes, made, BOX, at.Pose.identity())
    few = at.simulate_echoes(
        made.matrices[0], made.scene, BOX, CODES[:, :1], receivers=np.arange(3)
    )
    with raises_code("pose_not_found"):
        at.locate(few, made, BOX, at.Pose.identity())


@pytest.mark.parametrize(
    ("ends", "settings"),
    [((14e-3, 12e-3), {}), ((12e-3, 14e-3), {"start": 0.02}), ((12e-3, 14e-3), {"values": 2})],
)
def test_ranges_that_cannot_be_are_rejected(ends, settings) -> None:
    with raises_code("out_of_range"):
        at.sensing.scattering_family(COARSE, capsules, *ends, **settings)


def test_bad_families_are_rejected() -> None:
    def ball(height: float = 0.0) -> at.Scene:
        return at.Scene(AIR, [at.sound_hard(at.sphere(4e-3, 2e-3, (0, 0, height)))], frequency=40e3)

    with raises_code("all_zero"):
        at.sensing.scattering_family(at.SphereSeries(), lambda value: ball(), 0.0, 1.0)
    with raises_code("does_not_match"):
        at.sensing.scattering_family(
            COARSE, lambda value: ball() if value < 0.5 else capsules(), 0.0, 1.0
        )
    with raises_code("too_few"):
        at.sensing.scattering_family(at.SphereSeries(), ball, -5e-3, 5e-3, values=3)
    with raises_code("given_twice"):
        at.locate(measured(13.6e-3), family(), BOX, TRUE, scattering=family().matrices[0])
