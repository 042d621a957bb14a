"""Rigid planes: what they are, what cannot be, and who does not take them."""

import numpy as np
import pytest

import airtact as at
from airtact.evaluation.metrics import NOT_MODELLED, not_modelled
from faults import raises_code
from geometry.mesh.meshes import box_mesh

AIR = at.Medium(sound_speed=343.1, density=1.293)
TABLE = at.plane((0, 0, 0), (0, 0, 2))
BLOCK = at.Surface(*box_mesh((0, 0, 0), (0.01, 0.01, 0.01)))
SOURCE = at.Monopoles(np.array([[0.0, 0.0, 0.03]]), np.ones(1))


def ball(height: float = 0.01) -> at.acoustics.Obstacle:
    return at.sound_hard(at.sphere(5e-3, 2e-3, centre=(0, 0, height)))


def scene(*obstacles: at.acoustics.Obstacle) -> at.Scene:
    return at.Scene(AIR, obstacles, planes=[TABLE])


def test_a_plane_mirrors_points():
    tilted = at.plane((0, 0, 0.1), (0, 3, 4))
    points = np.array([[0.3, 0.0, 0.1], [0.0, 0.06, 0.18]])
    assert np.allclose(tilted.height(points), [0.0, 0.1], rtol=0, atol=1e-15)
    assert np.allclose(
        tilted.image(points), [[0.3, 0.0, 0.1], [0.0, -0.06, 0.02]], rtol=0, atol=1e-15
    )
    assert "1 rigid plane" in repr(scene(ball()))


@pytest.mark.parametrize(
    ("code", "make"),
    [
        ("out_of_range", lambda: at.plane((0, 0, 0), (0, 0, 0))),
        ("wrong_shape", lambda: at.plane((0, 0), (0, 0, 1))),
        ("not_finite", lambda: at.plane((0, 0, np.nan), (0, 0, 1))),
        ("wrong_kind", lambda: at.Scene(AIR, [], planes=TABLE)),
        ("wrong_kind", lambda: at.Scene(AIR, [], planes=[3])),
        (
            "too_many",
            lambda: at.Scene(AIR, [], planes=[TABLE, at.plane((0, 0, 0), (1, 0, 1))]),
        ),
        (
            "too_many",
            lambda: at.Scene(AIR, [], planes=[TABLE, at.plane((0.1, 0, 0.4), (0, 0, -1))]),
        ),
        ("bodies_overlap", lambda: scene(ball(0.0051))),
        ("bodies_overlap", lambda: scene(ball(0.0))),
        ("bodies_overlap", lambda: scene(ball(), ball(-0.01))),
        ("bodies_overlap", lambda: scene(at.sound_hard(BLOCK))),
    ],
)
@pytest.mark.usefixtures("as_outside_the_tests")
def test_planes_that_cannot_be_are_rejected(code, make):
    with raises_code(code):
        make()


@pytest.mark.parametrize("solver", [at.FreeField(), at.BoundaryElement(accuracy=0.1)])
def test_what_lies_behind_is_rejected(solver):
    bodies = [] if isinstance(solver, at.FreeField) else [ball()]
    with raises_code("behind_plane", "2 mm"):
        solver.radiate(
            scene(*bodies), at.Monopoles(np.array([[0, 0, 0.03], [0.02, 0, -0.002]]), np.ones(2))
        )
    with raises_code("behind_plane"):
        solver.radiate(scene(*bodies), at.Target(np.array([[0.02, 0, -0.002]])).beacons())


BEFORE = at.Scene(AIR, [ball()], planes=[TABLE])
QUICK = at.BoundaryElement(accuracy=0.1)


@pytest.mark.parametrize(
    "use",
    [
        lambda: at.FiniteElement(order=2).radiate(BEFORE, SOURCE),
        lambda: at.FiniteElement(order=2).factorised(BEFORE),
        lambda: at.SphereSeries().radiate(BEFORE, SOURCE),
        lambda: at.SampledField(BEFORE, SOURCE, 0.1 * np.eye(5, 3), np.ones((5, 1), complex)),
        lambda: QUICK.factorised(BEFORE),
        lambda: QUICK.factorised(at.Scene(AIR, [ball()])).radiate(BEFORE, SOURCE),
        lambda: at.scattering_matrix(QUICK, BEFORE),
        lambda: at.simulate_echoes(
            QUICK, BEFORE, at.flat_boards(1, 1), at.sensing.random_codes(249, 1)
        ),
    ],
)
def test_who_does_not_take_planes_says_so(use):
    with raises_code("not_supported"):
        use()


def test_a_plane_is_kept_by_motions_along_it_and_turns_about_its_normal():
    tilted = at.plane((0.01, -0.02, 0.005), (1, 2, 2))
    along = np.cross(tilted.normal, (0.0, 0.0, 0.03))
    turn = at.Pose.turn((1, 2, 2), 0.7)
    kept = at.Pose(turn.rotation, tilted.point + along - turn.rotate(tilted.point))
    assert tilted.kept_by(at.Pose.identity())
    assert tilted.kept_by(kept)
    assert not tilted.kept_by(at.Pose(np.eye(3), 1e-6 * tilted.normal))
    assert not tilted.kept_by(at.Pose.turn((1, 0, 0), np.pi))
    assert not tilted.kept_by(at.Pose.turn((0, 0, 1), 1e-3))


def test_open_air_before_a_plane_has_images():
    away, on = np.array([[0.03, 0.01, 0.02]]), np.array([[0.02, -0.01, 0.0]])
    sources = at.Monopoles(np.concatenate([away, on]), np.eye(2))
    field = at.FreeField().radiate(scene(), sources)
    points = np.array([[0.1, 0.0, 0.05], [0.05, 0.05, 0.0], [0.0, 0.0, -0.01]])
    far = at.FreeField().radiate(at.Scene(AIR, []), sources).at(points)
    assert field.valid(points).tolist() == [True, True, False]
    pressure = field.at(points)
    assert np.allclose(pressure[:2, 1], 2 * far[:2, 1], rtol=1e-12)  # a source on the plane
    assert np.isclose(pressure[1, 0], 2 * far[1, 0], rtol=1e-12)  # a point on it
    assert np.isnan(pressure[2]).all()
    assert np.isnan(field.velocity(points)[2]).all()
    assert np.allclose(field.scattered_at(points)[:2], pressure[:2] - far[:2], rtol=1e-12)
    assert np.abs(field.velocity(points)[1, 2]).max() < 1e-15
    there = at.FreeField().radiate(scene(), at.Monopoles(points[:1], np.ones(1))).at(away)
    assert np.isclose(there[0, 0], pressure[0, 0], rtol=1e-12)
    assert "rigid plane" in not_modelled(field.report)
    assert not_modelled(at.FreeField().radiate(at.Scene(AIR, []), sources).report) == NOT_MODELLED
