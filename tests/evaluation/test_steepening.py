"""Steepening in real air, against Fubini's plane wave and solutions of the Euler equations."""

import numpy as np
import pytest
from scipy.special import j1, jv

import airtact as at
from airtact.evaluation.steepening import Steepening, steepening

AIR = at.Medium(sound_speed=344.0, density=1.2)
STIFFNESS = 1.2 * 344.0**2


def focused(
    radius: float, distance: float, wall: bool = False
) -> tuple[Steepening, float, at.evaluation.Evaluation]:
    """A disc of pistons that focuses on its axis, in the air or on a rigid wall."""
    side = np.arange(-radius, radius, 5e-3) + 2.5e-3
    x, y = (values.ravel() for values in np.meshgrid(side, side))
    inside = np.hypot(x, y) < radius
    positions = np.stack([x, y, 0.0 * x], axis=1)[inside]
    array = at.PhasedArray(
        positions, np.tile([0.0, 0.0, 1.0], (len(positions), 1)), element=at.piston(4e-3, points=12)
    )
    focus = np.array([[0.0, 0.0, distance]])
    planes = [at.plane(focus[0], (0, 0, -1))] if wall else []
    scene = at.Scene(AIR, [], planes=planes)
    lengths = np.linalg.norm(positions - focus, axis=1)
    drive = at.Drive(np.exp(-1j * scene.wavenumber.real * lengths))
    result = at.evaluate(scene, array, drive, at.Target(focus), solver=at.FreeField())
    assert result.steepening is not None
    return result.steepening, float(result.magnitudes[0]), result


# Fundamental over linear pressure, and second harmonic over fundamental, of the Euler equations
# (python -m benchmarks.nonlinear). The first disc has the area of one AUTD3 board.
@pytest.mark.parametrize(
    ("radius", "distance", "wall", "linear", "kept", "second"),
    [
        (0.087, 0.2, False, 2.0e3, 0.949, 0.408),
        (0.087, 0.2, False, 4.5e3, 0.756, 0.735),
        (0.060, 0.06, False, 10e3, 0.904, 0.523),
        (0.096, 0.15, True, 12e3, 0.875, 0.611),
        (0.192, 0.2, True, 27e3, 0.753, 0.743),
    ],
)
def test_a_focus_keeps_as_much_as_in_the_euler_equations(
    radius: float, distance: float, wall: bool, linear: float, kept: float, second: float
) -> None:
    effect, pressure, _ = focused(radius, distance, wall)
    effect = effect.scaled(linear / pressure)
    within = 0.03 if linear <= 15e3 else 0.08
    assert effect.kept[0] == pytest.approx(kept, rel=within)
    assert effect.second_harmonic[0] == pytest.approx(second, rel=0.15)
    assert effect.error[0] >= 0.5 * abs(effect.kept[0] / kept - 1.0)


@pytest.mark.parametrize("shock", [0.2, 0.5, 1.0])
def test_a_single_wave_steepens_as_fubini_says(shock: float) -> None:
    # One source has one direction: a plane wave over its path r, with σ = β k r P/(ρc²).
    scene = at.Scene(AIR, [])
    sources = at.Monopoles(np.zeros((1, 3)), np.ones((1, 1)))
    path = 0.1
    pressure = shock * STIFFNESS / (1.2 * scene.wavenumber.real * path)
    effect = steepening(scene, sources, np.array([[path, 0.0, 0.0]]), np.array([1.0 / path]))
    effect = effect.scaled(pressure * path)
    kept = 2.0 * j1(shock) / shock
    assert effect.kept[0] == pytest.approx(kept, rel=0.01)
    assert effect.second_harmonic[0] == pytest.approx(jv(2, 2.0 * shock) / shock / kept, rel=0.15)


def test_the_box_of_the_paper_keeps_all_of_27_kilopascal() -> None:
    scene, target = at.Scene(AIR, []), at.Target(np.zeros((1, 3)))
    array = at.surrounding_box()
    drive = at.focus_by_distance(array, target, AIR, 40e3)
    result = at.evaluate(scene, array, drive, target, solver=at.FreeField())
    effect = result.steepening.scaled(27e3 / result.magnitudes[0])
    assert effect.kept[0] > 0.98
    assert 0.3 < effect.second_harmonic[0] < 0.55


def test_shocks_and_unknown_waves_leave_the_pressure_unknown() -> None:
    effect, pressure, result = focused(0.087, 0.2)
    np.testing.assert_allclose(result.expected, pressure * effect.kept)
    np.testing.assert_allclose(result.second_harmonic, effect.second_harmonic)
    strong = effect.scaled(10e3 / pressure)
    assert np.isnan(strong.kept[0])
    assert np.isnan(strong.second_harmonic[0])
    # the waves of the sources explain a tenth of this pressure
    field = result.field
    assert field is not None
    points = result.target.points
    scattered = steepening(field.scene, field.sources, points, 10.0 * result.pressures)
    assert np.isnan(scattered.scaled(3e3 / pressure).kept[0])
    assert np.isfinite(scattered.scaled(100.0 / pressure).kept[0])


def test_a_focus_on_a_body_is_a_focus_on_a_wall() -> None:
    _, _, result = focused(0.06, 0.06)
    field = result.field
    assert field is not None
    slab = at.sound_hard(at.sphere(0.2, 0.02, (0.0, 0.0, 0.26)))
    scene = at.Scene(AIR, [slab])
    effect = steepening(scene, field.sources, result.target.points, 2.0 * result.pressures)
    wall, _, _ = focused(0.06, 0.06, wall=True)
    np.testing.assert_allclose(effect.depletion, wall.depletion, rtol=0.1)


def test_skin_that_faces_away_leaves_the_pressure_unknown() -> None:
    ball = at.sphere(0.008, edge=2e-3, centre=(0.0, 0.0, 0.15))
    behind = at.focus(at.flat_boards(1, 1), (0.0, 0.0, 0.1585), ball)
    assert behind.pressures[0] > 1e3
    assert np.isnan(behind.steepening.kept[0])


def test_a_silent_point_does_not_steepen() -> None:
    sources = at.Monopoles(np.zeros((1, 3)), np.zeros((1, 1)))
    effect = steepening(at.Scene(AIR, []), sources, np.array([[0.1, 0.0, 0.0]]), np.zeros(1))
    assert effect.kept[0] == pytest.approx(1.0)
    assert effect.second_harmonic[0] == 0.0
