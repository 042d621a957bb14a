"""Steepening in real air, against Fubini's plane wave and solutions of the Euler equations."""

import numpy as np
import pytest
from scipy.special import j1

import airtact as at
from airtact.evaluation.steepening import Steepening

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


def test_a_plane_wave_steepens_as_fubini_says() -> None:
    # A far source is a plane wave at σ = βkPr/(ρc²) if the path is cut off near it: here the
    # amplitude falls by 1/r, and the theory of spherical waves has ln(r) in place of it. So the
    # estimate is compared by its own third order, σ²/8.
    shocks = np.array([0.2, 0.5, 1.0])
    wave = Steepening(shocks / 2.0, shocks**2 / 8.0, np.zeros(3))
    np.testing.assert_allclose(wave.kept, 2.0 * j1(shocks) / shocks, rtol=1e-9)
