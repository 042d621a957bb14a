"""Open air in closed form."""

import numpy as np

import airtact as at
from faults import raises_code

AIR = at.Medium(sound_speed=343.1, density=1.293, absorption=0.15)


def test_monopoles_add_up_and_decay():
    scene = at.Scene(AIR, [])
    positions = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]])
    strengths = np.array([[1.0, 2.0], [0.0, 1j]])
    field = at.FreeField().radiate(scene, at.Monopoles(positions, strengths))
    pressure = field.at(np.array([[0.3, 0.0, 0.0]]))
    k = 2.0 * np.pi * 40e3 / 343.1
    first = np.exp(1j * k * 0.3) * np.exp(-0.15 * 0.3) / 0.3
    second = np.exp(1j * k * 0.2) * np.exp(-0.15 * 0.2) / 0.2
    np.testing.assert_allclose(pressure, [[first, 2.0 * first + 1j * second]], rtol=1e-12)


def test_the_field_is_everywhere_but_on_sources_and_has_no_surface():
    source = at.Monopoles(np.ones((1, 3)), np.ones(1))
    field = at.FreeField().radiate(at.Scene(AIR, []), source)
    assert field.valid(np.zeros((4, 3))).all()
    assert field.on_surface.pressure.shape == (0, 1)
    assert field.report.residual == 0.0
    with raises_code("misplaced"):
        field.at(np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]))
    with raises_code("not_supported"):
        at.FreeField().radiate(at.Scene(AIR, [at.sound_hard(at.sphere(0.01, 0.005))]), source)
