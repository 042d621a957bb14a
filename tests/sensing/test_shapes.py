"""Shape and pose together: derivatives against closed forms, what is found, how sure it is, and what is refused."""

import numpy as np
import pytest

import airtact as at
from airtact.acoustics.solvers.bem.quadrature import place_nodes
from airtact.geometry.panels import panels_of
from airtact.sensing import LocatedShape, UnknownShape, locate_shape
from airtact.sensing.shapes.derivative import solve_echoes
from airtact.sensing.shapes.smooth import SmoothSurface
from airtact.sensing.shapes.unknown import carried_by_capsules
from faults import raises_code
from sensing.sensed_scenes import AIR, BOX, TRUE, capsules, relative

RADIUS = 5e-3
CODES = at.sensing.random_codes(996, 8, seed=3)


def ball(numbers: np.ndarray) -> at.Scene:
    return at.Scene(AIR, [at.sound_hard(at.sphere(float(numbers[0]), 2e-3))], frequency=40e3)


def moved(by: tuple[float, float, float]) -> at.Pose:
    return TRUE @ at.Pose(np.eye(3), np.array(by))


def by_series(radius: float, pose: at.Pose, noise: float | None = None) -> at.Echoes:
    scene = ball(np.array([radius]))
    return at.simulate_echoes(
        at.SphereSeries(), scene, BOX.seen_from(pose), CODES, noise=noise, seed=4
    )


def test_derivatives_are_those_of_the_series_of_a_sphere() -> None:
    step, receivers = 2e-5, np.arange(0, 996, 31)
    made = solve_echoes(
        at.BoundaryElement(accuracy=0.003),
        ball(np.array([RADIUS])),
        BOX.seen_from(TRUE),
        CODES,
        receivers,
    )
    exact = np.asarray(by_series(RADIUS, TRUE).pressures)[receivers]
    assert relative(made.echoes, exact) < 0.005
    normals = made.surface.normals
    found = made.derivatives(np.concatenate([np.ones((len(normals), 1)), normals], axis=1))
    ends = [(by_series(RADIUS + step, TRUE), by_series(RADIUS - step, TRUE))]
    ends += [
        (by_series(RADIUS, moved(tuple(by))), by_series(RADIUS, moved(tuple(-by))))
        for by in step * np.eye(3)
    ]
    for derivative, (more, less) in zip(found, ends, strict=True):
        differences = (np.asarray(more.pressures) - np.asarray(less.pressures))[receivers] / (
            2 * step
        )
        assert relative(derivative, differences) < 0.02


def test_pressures_and_slopes_between_nodes_are_those_of_a_plane_wave() -> None:
    shape = at.capsule((0, 0, -6e-3), (0, 0, 6e-3), radius=6e-3, edge=2e-3).shape
    panels = panels_of([shape], 3e-3, np.empty((0, 3)), 1e-3, 0.7, 1e-4, None)
    smooth = SmoothSurface.of(
        place_nodes(panels.quadratic_triangles, panels.body, panels.deviation)
    )
    nodes = place_nodes(panels.quadratic_triangles, panels.body, panels.deviation).points
    along = 700.0 * np.array([0.6, 0.0, 0.8])
    value, *slopes = smooth.smoothed(np.exp(1j * nodes @ along).astype(np.complex64)[:, None])
    exact = np.exp(1j * smooth.points @ along)
    assert relative(value[:, 0], exact) < 0.01
    tangential = along - (smooth.normals @ along)[:, None] * smooth.normals
    steepness = np.sqrt(np.sum(np.abs(np.concatenate(slopes, axis=1)) ** 2, axis=1))
    assert relative(steepness, np.linalg.norm(tangential, axis=1)) < 0.05
    assert smooth.areas.sum() == pytest.approx(
        4 * np.pi * 6e-3**2 + 2 * np.pi * 6e-3 * 12e-3, rel=1e-3
    )


def found_ball(radius: float, noise: float) -> LocatedShape:
    unknown = UnknownShape(ball, np.array([RADIUS]), np.array([1e-3]))
    start = moved((1e-3, -0.8e-3, 0.6e-3))
    return locate_shape(
        by_series(radius, TRUE, noise), unknown, BOX, start, solver=at.BoundaryElement(0.01)
    )


@pytest.mark.parametrize("radius", [4.2e-3, 5.9e-3])
def test_radius_and_place_of_a_ball_are_found_and_its_turn_stays_in_doubt(radius: float) -> None:
    found = found_ball(radius, 30.0)
    assert found.converged
    assert found.misfit < 0.03
    assert abs(found.numbers[0] - radius) < 2e-5
    assert np.linalg.norm(found.pose.translation - TRUE.translation) < 2e-5
    deviations = np.sqrt(np.diag(found.covariance))
    assert (deviations[:3] < 2e-5).all()
    assert deviations[3:6] == pytest.approx(
        np.radians(9.0), rel=0.01
    )  # echoes say nothing of the turn of a ball
    assert abs(found.numbers[0] - radius) < 4 * max(deviations[6], 1e-6)
    assert 1e-7 < found.surface_deviation < 2e-5
    assert found.scene.obstacles[0].surface.extent == pytest.approx(2 * found.numbers[0], rel=0.01)
    assert "converged" in repr(found)


def test_doubt_grows_with_the_noise() -> None:
    loud, quiet = (found_ball(RADIUS, noise).surface_deviation for noise in (10.0, 30.0))
    assert loud > 2 * quiet


@pytest.mark.slow
def test_two_bodies_of_another_shape_are_found() -> None:
    true = at.Scene(
        AIR,
        [
            at.sound_hard(
                at.capsule((-13e-3, 0.5e-3, -5e-3), (-13.4e-3, 0, 8.5e-3), radius=5.4e-3, edge=2e-3)
            ),
            at.sound_hard(
                at.capsule((12e-3, 2e-3, -3.8e-3), (11e-3, -2.2e-3, 9e-3), radius=5.5e-3, edge=2e-3)
            ),
        ],
        frequency=40e3,
    )
    truth = at.BoundaryElement(accuracy=0.005, estimate=False)
    echoes = at.simulate_echoes(truth, true, BOX.seen_from(TRUE), CODES, noise=30.0, seed=5)
    said: list[str] = []
    unknown = UnknownShape.of_capsules(capsules(), ends=1e-3, radius=0.5e-3)
    found = locate_shape(
        echoes, unknown, BOX, moved((0.5e-3, -0.5e-3, 0.5e-3)), progress=said.append
    )
    assert found.converged
    assert said[0] == "fitting pose and shape to the echoes"
    vertices = np.concatenate([one.surface.vertices for one in true.obstacles])
    off = found.scene.depth(found.pose.inverse().apply(TRUE.apply(vertices)))
    assert np.sqrt(np.mean(off**2)) < 5e-5
    assert np.sqrt(np.mean(off**2)) < 5 * found.surface_deviation


def test_a_body_that_is_not_known_of_is_not_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "airtact.sensing.shapes.fit.FOLLOWED", 1
    )  # a second start is enough to fail by
    both = at.Scene(
        AIR, [*ball(np.array([RADIUS])).obstacles, *capsules().obstacles[1:]], frequency=40e3
    )
    truth = at.BoundaryElement(accuracy=0.03, estimate=False)
    echoes = at.simulate_echoes(truth, both, BOX.seen_from(TRUE), CODES, noise=30.0)
    found = locate_shape(
        echoes, UnknownShape(ball, np.array([RADIUS]), np.array([5e-4])), BOX, TRUE
    )
    assert not found.converged
    assert found.misfit > 0.2
    assert "NOT converged" in repr(found)


def test_points_before_capsules_are_carried_with_them() -> None:
    before = capsules()
    longer = at.capsule((-13e-3, 0, -5e-3), (-13e-3, 0, 21e-3), radius=4e-3, edge=2e-3)
    turned = at.capsule((12e-3, 0, 0), (12e-3, 14e-3, 0), radius=5e-3, edge=2e-3)
    after = at.Scene(AIR, [at.sound_hard(longer), at.sound_hard(turned)], frequency=40e3)
    points = np.array([[-6.5e-3, 0, 1.5e-3], [-13e-3, 0, 14.5e-3], [3e-3, 0, 3e-3]])
    carried = carried_by_capsules(points, before, after)
    assert carried[0] == pytest.approx(
        [-8.5e-3, 0, 8e-3], abs=1e-9
    )  # half a millimetre before the middle of the side
    assert carried[1] == pytest.approx([-13e-3, 0, 25.5e-3], abs=1e-9)  # and of the tip
    assert after.depth(carried) == pytest.approx(before.depth(points), abs=1e-9)


def test_bad_shapes_are_refused() -> None:
    with raises_code("wrong_shape"):
        UnknownShape(ball, np.array([RADIUS]), np.array([1e-3, 1e-3]))
    with raises_code("out_of_range", "number 0 is 0"):
        UnknownShape(ball, np.array([RADIUS]), np.array([0.0]))
    with raises_code("not_finite"):
        UnknownShape(ball, np.array([np.nan]), np.array([1e-3]))
    yielding = at.impedance(at.sphere(5e-3, 2e-3), 2.0)
    with raises_code("not_supported", "sound-hard"):
        UnknownShape(
            lambda _: at.Scene(AIR, [yielding], frequency=40e3),
            np.array([RADIUS]),
            np.array([1e-3]),
        )
    cube = at.Scene(AIR, [at.sound_hard(at.Surface(*_tetrahedron()))], frequency=40e3)
    with raises_code("wrong_kind", "no capsule"):
        UnknownShape.of_capsules(cube)


def _tetrahedron() -> tuple[np.ndarray, np.ndarray]:
    corners = 0.01 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    return corners, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def test_echoes_that_are_no_echoes_are_refused() -> None:
    unknown = UnknownShape(ball, np.array([RADIUS]), np.array([1e-3]))
    silent = at.Echoes(CODES, np.zeros((996, 8)))
    with raises_code("signal_unusable"):
        locate_shape(silent, unknown, BOX, TRUE)
    other = at.Echoes(CODES, np.asarray(by_series(RADIUS, TRUE).pressures), frequency=39e3)
    with raises_code("does_not_match"):
        locate_shape(other, unknown, BOX, TRUE)
