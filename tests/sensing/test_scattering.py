"""Scattering matrices against the closed form of a sphere, direct solves and pressures by another package."""

import json

import numpy as np
import pytest
from scipy.special import spherical_jn, spherical_yn

import airtact as at
from airtact.sensing.scattering import reaching_patterns
from airtact.sensing.waves import monopole_waves, motions, moved, wave_count
from faults import raises_code
from paths import ROOT
from sensing.sensed_scenes import AIR, BOX, TRUE, capsules, relative

SPHERES = json.loads((ROOT / "tests/references/acoustotreams.json").read_text())


def ball(radius: float = 8e-3) -> at.Scene:
    return at.Scene(AIR, [at.sound_hard(at.sphere(radius, 2e-3))], frequency=40e3)


def closed_form(scene: at.Scene, centre: np.ndarray, order: int, radius: float) -> np.ndarray:
    """T_n = −j_n'(ka)/h_n'(ka) about the middle of the ball, moved to another centre."""
    wide = order + 12
    wavenumber = scene.wavenumber.real
    n = np.repeat(np.arange(wide + 1), 2 * np.arange(wide + 1) + 1)
    size = wavenumber * radius
    regular = spherical_jn(n, size, True)
    other = spherical_yn(n, size, True)
    to_ball = moved(
        np.array([*-centre, 0, 0, 0]), np.eye(wave_count(wide), dtype=complex), wavenumber
    )
    return (to_ball.T * (-regular / (regular + 1j * other)) @ to_ball)[
        : wave_count(order), : wave_count(order)
    ]


@pytest.mark.parametrize(
    ("solver", "most"),
    [(at.SphereSeries(), 1e-5), (at.BoundaryElement(accuracy=0.003, estimate=False), 0.005)],
    ids=["projected from pressures", "projected from monopoles"],
)
def test_a_ball_has_the_matrix_of_the_closed_form(solver, most) -> None:
    found = at.scattering_matrix(solver, ball())
    assert relative(found.matrix, closed_form(ball(), found.centre, found.order, 8e-3)) < most
    assert np.array_equal(found.matrix, found.matrix.T)


@pytest.mark.parametrize("case", SPHERES["cases"], ids=lambda case: f"{len(case['radii'])} spheres")
def test_pressures_are_what_acoustotreams_says(case) -> None:
    bodies = [
        at.sphere(radius, radius / 2, np.array(centre))
        for radius, centre in zip(case["radii"], case["centres"], strict=True)
    ]
    scene = at.Scene(
        at.Medium(SPHERES["sound_speed"], 1.2),
        [at.sound_hard(one) for one in bodies],
        frequency=SPHERES["frequency"],
    )
    found = at.scattering_matrix(
        at.BoundaryElement(accuracy=0.003, estimate=False), scene, accuracy=1e-4
    )
    points = [np.array(SPHERES[name]) - found.centre for name in ("sources", "receivers")]
    outside = [np.linalg.norm(one, axis=1) > 1.15 * found.radius for one in points]
    assert min(one.sum() for one in outside) >= 2
    sources, receivers = (one[mask] for one, mask in zip(points, outside, strict=True))
    from_sources, to_receivers = (
        monopole_waves(found.order, one, scene.wavenumber) for one in (sources, receivers)
    )
    scattered = to_receivers.T @ found.matrix @ from_sources / (4j * np.pi * scene.wavenumber)
    distance = np.linalg.norm(receivers[:, None] - sources, axis=2)
    true = np.array(case["real"]) + 1j * np.array(case["imaginary"])
    incident = np.exp(1j * scene.wavenumber * distance) / distance
    assert relative(scattered, true[np.ix_(outside[1], outside[0])] - incident) < 0.01


def test_echoes_of_random_codes_are_those_of_direct_solves() -> None:
    codes = at.sensing.random_codes(996, 2, seed=3)
    array = BOX.seen_from(TRUE)
    solver = at.BoundaryElement(accuracy=0.005, estimate=False)
    exact = at.simulate_echoes(solver, capsules(), array, codes).pressures
    by_matrix = at.scattering_matrix(at.BoundaryElement(accuracy=0.01, estimate=False), capsules())
    found = at.simulate_echoes(by_matrix, capsules(), array, codes).pressures
    assert relative(found, exact) < 0.005


@pytest.mark.slow
def test_waves_that_hardly_reach_the_bodies_need_no_solve() -> None:
    rod = at.Scene(
        AIR,
        [at.sound_hard(at.capsule((-22e-3, 0, 0), (22e-3, 0, 0), radius=4e-3, edge=2e-3))],
        frequency=40e3,
    )
    solver = at.BoundaryElement(accuracy=0.02, estimate=False)
    found = at.scattering_matrix(solver, rod)
    patterns = reaching_patterns(rod, found.centre, found.order, 0.01)
    assert patterns is not None
    assert patterns.shape[1] < 0.5 * len(found.matrix)
    assert relative(patterns.T @ patterns, np.eye(patterns.shape[1])) < 1e-5
    assert (
        reaching_patterns(ball(), ball().obstacles[0].surface.vertices.mean(axis=0), 10, 0.01)
        is None
    )
    points = np.random.default_rng(0).normal(size=(30, 3))
    points *= 0.035 / np.linalg.norm(points, axis=1)[:, None]
    field = solver.radiate(rod, at.Monopoles(points[:15], np.eye(15)))
    waves = [
        monopole_waves(found.order, some - found.centre, rod.wavenumber)
        for some in (points[15:], points[:15])
    ]
    scattered = waves[0].T @ found.matrix @ waves[1] / (4j * np.pi * rod.wavenumber)
    assert relative(scattered, field.scattered_at(points[15:])) < 0.01


def test_waves_about_a_moved_centre_are_those_of_moved_sources() -> None:
    wavenumber = 732.0
    sources = np.array([[0.06, 0.02, -0.03], [-0.01, -0.05, 0.05]])
    twist = np.array([1e-3, -2e-3, 1.5e-3, 0.05, -0.1, 0.08])
    found = moved(twist, monopole_waves(34, sources, wavenumber), wavenumber)[: wave_count(24)]
    turn = at.Pose.turn(twist[3:], float(np.linalg.norm(twist[3:])))
    # the screw of a twist moves the centre by ∫ exp(sω) ds τ, here by many small steps
    centre = (
        sum(
            at.Pose.turn(twist[3:], s * np.linalg.norm(twist[3:])).apply(twist[:3])
            for s in (np.arange(2000) + 0.5) / 2000
        )
        / 2000
    )
    exact = monopole_waves(24, (sources - centre) @ turn.rotation, wavenumber)
    assert relative(found, exact) < 1e-5
    assert all(abs(one + one.T).max() < 1e-6 for one in motions(10))


def test_bodies_that_have_no_matrix_are_rejected() -> None:
    with raises_code("empty"):
        at.scattering_matrix(at.SphereSeries(), at.Scene(AIR, [], frequency=40e3))
    with raises_code("out_of_range"):
        at.scattering_matrix(at.SphereSeries(), ball(), accuracy=0.5)
    with raises_code("too_many"):
        at.scattering_matrix(
            at.SphereSeries(), at.Scene(AIR, [at.sound_hard(at.sphere(0.12, 0.03))], frequency=40e3)
        )
