"""The particle velocity is the slope of the pressure over iωρ, in every solver's field."""

import numpy as np
import pytest

import airtact as at
from faults import raises_code
from references import relative
from worlds import directions

AIR = at.Medium(343.1, 1.293, absorption=0.1)
BALL = at.sphere(0.01, edge=4e-3, centre=(1e-3, 2e-3, -1e-3))
CENTRE = np.array([1e-3, 2e-3, -1e-3])
SOURCES = at.Monopoles(
    np.array([[0.05, 0.0, 0.01], [-0.03, 0.04, 0.0]]), np.array([[1.0, 1j], [0.5, -0.2]])
)
OUTSIDE = CENTRE + 0.014 * np.array(
    [[1.0, 0.0, 0.0], [0.0, -0.6, 0.8], [-0.8, 0.0, 0.6], [0.0, 0.0, -1.0]]
)
BOUNDARIES = {
    "hard": at.sound_hard(BALL),
    "impedance": at.impedance(BALL, 2.0 - 1.0j),
    "filled": at.filled(BALL, at.Medium(500.0, 3.0)),
}


def field_of(kind: str) -> at.acoustics.RadiatedField:
    if kind == "open air":
        return at.FreeField().radiate(at.Scene(AIR, []), SOURCES)
    return at.SphereSeries().radiate(at.Scene(AIR, [BOUNDARIES[kind]]), SOURCES)


def differenced(
    field: at.acoustics.RadiatedField, points: np.ndarray, step: float, density: float = AIR.density
) -> np.ndarray:
    """Velocity by plain central differences of the pressure, which err as the square of the step."""
    slopes = [
        (field.at(points + step * axis) - field.at(points - step * axis)) / (2 * step)
        for axis in np.eye(3)
    ]
    return np.stack(slopes, axis=1) / (2j * np.pi * field.scene.frequency * density)


@pytest.mark.parametrize("kind", ["open air", *BOUNDARIES])
def test_differences_approach_it_as_the_square_of_their_step(kind) -> None:
    field = field_of(kind)
    exact = field.velocity(OUTSIDE)
    assert exact.shape == (4, 3, 2)
    errors = [
        np.linalg.norm(differenced(field, OUTSIDE, step) - exact) for step in (4e-4, 2e-4, 1e-4)
    ]
    np.testing.assert_allclose(np.log2(np.divide(errors[:-1], errors[1:])), 2.0, atol=0.03)
    assert errors[-1] < 2e-3 * np.linalg.norm(exact)


def test_a_far_monopole_moves_air_along_its_sound_in_phase_with_it() -> None:
    # Far away v = p/(ρc) outwards: with the other sign of the phasor it would point inwards.
    medium = at.Medium(343.1, 1.293)
    field = at.FreeField().radiate(at.Scene(medium, []), at.Monopoles(np.zeros((1, 3)), np.ones(1)))
    points = np.array([[10.0, 0.0, 0.0], [0.0, -6.0, 8.0]])
    velocity, pressure = field.velocity(points)[:, :, 0], field.at(points)
    np.testing.assert_allclose(
        velocity, pressure * points / 10.0 / (343.1 * 1.293), rtol=2e-4, atol=1e-9
    )


def test_air_slides_along_a_hard_surface_and_enters_a_soft_one() -> None:
    outward = np.array([[1.0, 0.0, 0.0], [0.0, -0.6, 0.8], [-0.8, 0.0, 0.6]])
    skin = CENTRE + 0.01 * outward
    sliding = field_of("hard").velocity(skin)
    assert np.isnan(field_of("hard").velocity(CENTRE[None])).all()
    normal = np.einsum("pd,pds->ps", outward, sliding)
    assert np.abs(normal).max() < 1e-4 * np.abs(sliding).max()
    soft = field_of("impedance")
    entering = -np.einsum("pd,pds->ps", outward, soft.velocity(skin))
    # ∂p/∂n + (ik/ratio) p = 0 makes the velocity inwards k p/(ω ρ ratio), k with absorption.
    factor = soft.scene.wavenumber / (2 * np.pi * 40e3 * AIR.density * (2.0 - 1.0j))
    np.testing.assert_allclose(entering, factor * soft.at(skin), rtol=1e-3)


def test_inside_a_fluid_sphere_it_is_that_of_the_fluid() -> None:
    field = field_of("filled")
    for points in ((CENTRE + np.array([[2e-3, 1e-3, 0.0], [0.0, 0.0, -7e-3]])), CENTRE[None]):
        assert relative(differenced(field, points, 1e-4, 3.0), field.velocity(points)) < 2e-3


def test_it_is_unknown_on_a_fluid_surface_and_at_a_source() -> None:
    on_surface = CENTRE + np.array([[0.01, 0.0, 0.0]])
    assert np.isnan(field_of("filled").velocity(on_surface)).all()
    for kind in ("open air", "hard"):
        with raises_code("misplaced"):
            field_of(kind).velocity(SOURCES.positions[1:])


ROOM_SOURCES = at.Monopoles(
    np.array([[0.07, 0.01, 0.02], [-0.05, 0.06, 0.0], [0.0, -0.07, 0.03]]),
    np.array([[1.0, 1j], [0.5, 0.0], [0.7, -1]]),
)


@pytest.fixture(scope="module")
def solved():
    scene = at.Scene(at.Medium(343.1, 1.293), [BOUNDARIES["hard"]])
    truth = at.SphereSeries().radiate(scene, ROOM_SOURCES)
    return truth, [at.BoundaryElement(a).radiate(scene, ROOM_SOURCES) for a in (0.03, 0.003)]


@pytest.mark.parametrize(
    ("off", "limit"), [(0.0, 0.01), (0.02e-3, 0.01), (0.1e-3, 0.012), (2e-3, 0.002), (0.02, 0.001)]
)
def test_boundary_elements_come_closer_to_it_with_more_nodes(solved, off, limit) -> None:
    truth, fields = solved
    points = CENTRE + (0.01 + off) * directions(30, 7)
    exact = truth.velocity(points)
    errors = [relative(field.velocity(points), exact) for field in fields]
    assert errors[1] < limit
    refinement = np.sqrt(fields[1].report.nodes / fields[0].report.nodes)
    assert off in (0.02e-3, 0.1e-3) or errors[0] / errors[1] > refinement**2
