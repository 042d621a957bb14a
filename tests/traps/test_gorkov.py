"""Force and stiffness against closed forms, the momentum flux and the levitator TinyLev."""

import numpy as np
import pytest
from scipy.integrate import lebedev_rule

import airtact as at
from faults import raises_code

AIR = at.Medium(sound_speed=343.1, density=1.2)
OPEN_AIR = at.Scene(AIR)
K = 2 * np.pi * 40e3 / 343.1


def tinylev(element: at.transducers.Element | None = None) -> at.PhasedArray:
    element = at.piston(4.5e-3, sensitivity=3.4) if element is None else element
    return at.transducers.known_array("tinylev", element)


# Point sources, for which the series of a sphere is fast
POINTS = tinylev(at.monopole(3.4))


def ones(count: int) -> at.Drive:
    return at.Drive(np.ones(count, dtype=np.complex128))


IN_PHASE = ones(72)


def heights(*y: float) -> np.ndarray:
    return np.array([[0.0, value, 0.0] for value in y])


def flux_force(scene: at.Scene, drive: at.Drive, centre: np.ndarray) -> np.ndarray:
    """Force on what is within 2.5 mm by the momentum that flows through the sphere around it."""
    sources = at.evaluation.drive_sources(POINTS, [drive], scene)
    field = at.SphereSeries().radiate(scene, sources)
    normals, weights = lebedev_rule(15)
    points = centre + 2.5e-3 * normals.T
    pressure = field.at(points)[:, 0]
    velocity = field.velocity(points)[:, :, 0]
    mean = at.evaluation.radiation_pressure(pressure, velocity, AIR)[:, None] * normals.T
    along = np.einsum("pi,ip->p", velocity, normals)[:, None]
    mean += 0.5 * AIR.density * (velocity.conj() * along).real
    return -(2.5e-3**2) * weights @ mean


def test_bead_in_a_plane_standing_wave() -> None:
    # Two elements 8 m apart: F = 4πΦka³E sin 2kz, E = P²/(4ρc²) (Bruus 2012, equation 6).
    pair = at.PhasedArray(heights(-4.0, 4.0), element=at.monopole(4e3))
    points = heights(0.3e-3, 1e-3, 2e-3, -3e-3)
    pull = at.traps.force(OPEN_AIR, pair, ones(2), points, radius=1e-3)
    matrix = at.traps.stiffness(OPEN_AIR, pair, ones(2), points, radius=1e-3)
    ratio = 29.36 / 1.2
    contrast = (1 - (343.1 / 900) ** 2 / ratio) / 3 + (ratio - 1) / (2 * ratio + 1)
    # The middle is an antinode of 2 kPa.
    scale = 4 * np.pi * contrast * K * 1e-3**3 * 2000**2 / (4 * 1.2 * 343.1**2)
    phase = 2 * K * points[:, 1]
    np.testing.assert_allclose(pull[:, 1], scale * np.sin(phase), atol=2e-3 * scale)
    expected = -2 * K * scale * np.cos(phase)
    np.testing.assert_allclose(matrix[:, 1, 1], expected, atol=4e-3 * K * scale)


def test_traps_of_tinylev() -> None:
    # A sum over far fields of pistons, differentiated numerically, for a bead of 1 mm.
    array = tinylev()
    opposed = at.traps.signature(array, IN_PHASE, "twin", (0, 1, 0))
    cases = (
        (IN_PHASE, 2.349e-3, (0.01290, 0.2366, 0.01290)),
        (IN_PHASE, -2.349e-3, (0.01290, 0.2366, 0.01290)),
        (opposed, 0.0, (0.01299, 0.2383, 0.01299)),
        (opposed, 4.699e-3, (0.01263, 0.2314, 0.01263)),
    )
    for drive, height, expected in cases:
        start = heights(height + 0.3e-3)
        place = at.traps.find(OPEN_AIR, array, drive, start, radius=1e-3)
        np.testing.assert_allclose(place, heights(height), atol=0.01e-3)
        matrix = at.traps.stiffness(OPEN_AIR, array, drive, place, radius=1e-3)[0]
        np.testing.assert_allclose(np.diag(matrix), expected, rtol=0.02)


def test_force_equals_the_momentum_flux_for_a_small_bead() -> None:
    point = np.array([1e-3, 1.5e-3, 0.5e-3])
    bead = at.filled(at.sphere(0.25e-3, 0.1e-3, centre=point), at.Medium(900.0, 29.36))
    exact = flux_force(at.Scene(AIR, [bead]), IN_PHASE, point)
    pull = at.traps.force(OPEN_AIR, POINTS, IN_PHASE, point[None], radius=0.25e-3)[0]
    assert np.linalg.norm(pull - exact) < 0.02 * np.linalg.norm(exact)


@pytest.fixture(scope="module")
def ball() -> tuple[at.Scene, at.PhasedArray, at.Drive, np.ndarray]:
    """A hard ball between the caps, and points 1 to 4 mm from it."""
    scene = at.Scene(AIR, [at.sound_hard(at.sphere(8e-3, 2e-3))])
    points = np.array([[9e-3, 2e-3, 0.0], [1e-3, 10e-3, 1e-3], [7e-3, 7e-3, 7e-3]])
    return scene, POINTS, IN_PHASE, points


def test_derivatives_of_the_potential_beside_a_ball(ball) -> None:
    scene, array, drive, points = ball
    solver = at.SphereSeries()
    step = 2e-5
    shifts = np.concatenate([step * np.eye(3), -step * np.eye(3)])
    around = (points[:, None] + shifts).reshape(-1, 3)
    arguments = {"solver": solver, "radius": 0.5e-3}
    # The potential uses the first derivatives, the force the second, the stiffness the third.
    values = at.traps.potential(scene, array, drive, around, **arguments).reshape(3, 2, 3)
    pull = at.traps.force(scene, array, drive, points, **arguments)
    slope = (values[:, 1] - values[:, 0]) / (2 * step)
    np.testing.assert_allclose(pull, slope, rtol=0, atol=1e-3 * np.abs(pull).max())
    forces = at.traps.force(scene, array, drive, around, **arguments).reshape(3, 2, 3, 3)
    matrix = at.traps.stiffness(scene, array, drive, points, **arguments)
    slope = (forces[:, 1] - forces[:, 0]) / (2 * step)
    np.testing.assert_allclose(matrix, slope, rtol=0, atol=2e-3 * np.abs(matrix).max())
    # The pressure and velocity of the solver itself
    field = solver.radiate(scene, at.evaluation.drive_sources(array, [drive], scene))
    volume = 4 / 3 * np.pi * 0.5e-3**3
    ratio = 29.36 / 1.2
    monopole = 1 - (343.1 / 900) ** 2 / ratio
    dipole = 2 * (ratio - 1) / (2 * ratio + 1)
    expected = volume * monopole * np.abs(field.at(points)[:, 0]) ** 2 / (4 * 1.2 * 343.1**2)
    speed = np.sum(np.abs(field.velocity(points)[:, :, 0]) ** 2, axis=1)
    expected -= volume * dipole * 3 / 8 * 1.2 * speed
    own = at.traps.potential(scene, array, drive, points, **arguments)
    np.testing.assert_allclose(own, expected, rtol=0, atol=1e-3 * np.abs(expected).max())


def test_boundary_elements_and_the_series_agree_beside_a_ball(ball) -> None:
    scene, array, drive, points = ball
    exact = at.traps.force(scene, array, drive, points, solver=at.SphereSeries())
    pull = at.traps.force(scene, array, drive, points)
    assert (np.linalg.norm(pull - exact, axis=1) < 0.01 * np.linalg.norm(exact, axis=1)).all()
    exact = at.traps.stiffness(scene, array, drive, points, solver=at.SphereSeries())
    matrix = at.traps.stiffness(scene, array, drive, points)
    largest = np.abs(exact).max(axis=(1, 2))
    assert (np.abs(matrix - exact).max(axis=(1, 2)) < 0.01 * largest).all()


@pytest.mark.slow
def test_boundary_and_finite_elements_agree_beside_two_fingers() -> None:
    fingers = [
        at.sound_hard(at.capsule((side * 0.012, 0, 0), (side * 0.032, 0, 0), 6e-3, 2e-3))
        for side in (-1, 1)
    ]
    scene = at.Scene(AIR, fingers)
    points = np.array([[0.0, 2.82e-3, 0.0], [2e-3, 3e-3, 1e-3]])
    alone = at.traps.force(OPEN_AIR, tinylev(), IN_PHASE, points)
    pull = at.traps.force(scene, tinylev(), IN_PHASE, points)
    finite = at.traps.force(scene, tinylev(), IN_PHASE, points, solver=at.FiniteElement())
    size = np.linalg.norm(finite, axis=1)
    assert (np.linalg.norm(pull - finite, axis=1) < 0.005 * size).all()
    # The fingers change it.
    assert (np.linalg.norm(pull - alone, axis=1) > 0.01 * size).all()


def test_a_plane_is_the_image_of_the_array() -> None:
    board = at.autd3_board(at.Pose.turn((1, 0, 0), np.pi, (0, 0, 0.15)))
    image = at.PhasedArray(board.positions * [1, 1, -1], board.normals * [1, 1, -1], board.element)
    both = at.PhasedArray(
        np.concatenate([board.positions, image.positions]),
        np.concatenate([board.normals, image.normals]),
        board.element,
    )
    points = np.array([[0.08, -0.06, 2e-3], [0.09, -0.05, 6e-3]])
    floor = at.Scene(AIR, planes=[at.plane((0, 0, 0), (0, 0, 1))])
    over_floor = at.traps.stiffness(floor, board, ones(249), points)
    mirrored = at.traps.stiffness(OPEN_AIR, both, ones(498), points)
    np.testing.assert_allclose(over_floor, mirrored, atol=5e-3 * np.abs(mirrored).max())


def test_impossible_beads_are_rejected(ball) -> None:
    scene, array, drive, points = ball
    with raises_code("out_of_range", "0.0012"):
        at.traps.force(scene, array, drive, points, radius=1.2e-3)
    for radius in (0.65e-3, 0.2e-3):
        with raises_code("bodies_overlap", "0.4"):
            at.traps.force(scene, array, drive, heights(8.4e-3), radius, solver=at.SphereSeries())
    with raises_code("inside_body"):
        at.traps.force(scene, array, drive, heights(0.0), solver=at.SphereSeries())
    with raises_code("behind_faces"):
        at.traps.force(OPEN_AIR, tinylev(), drive, heights(0.2))
