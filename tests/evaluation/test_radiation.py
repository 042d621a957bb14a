"""Radiation pressure against the momentum that a sphere takes out of a plane wave, and before a wall."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import spherical_jn, spherical_yn

import airtact as at
from airtact.evaluation.verification import radiation_of, radiation_pressure
from faults import raises_code
from worlds import AIR, two_fingers

FAR = 50.0
PEAK = 1000.0


def radiation_force(radius: float, frequency: float) -> float:
    """Force of a plane wave of 1000 Pa peak on a hard sphere that stands still [N].

    F = π a² E Y with E = P²/(2ρc²) and Y = −(4/x²) Σ (n+1) [α_n + α_(n+1) + 2 (α_n α_(n+1) + β_n
    β_(n+1))], α_n + iβ_n being the sphere's scattering coefficients (T. Hasegawa, K. Yosioka, J.
    Acoust. Soc. Am. 46, 1139, 1969, for a sphere that does not yield; King 1934 without its
    motion).
    """
    x = 2 * np.pi * frequency * radius / AIR.sound_speed
    order = np.arange(int(x + 5 * np.cbrt(x) + 15))
    j, y = spherical_jn(order, x, derivative=True), spherical_yn(order, x, derivative=True)
    scattering = -j / (j + 1j * y)
    a, b = scattering.real, scattering.imag
    sums = a[:-1] + a[1:] + 2 * (a[:-1] * a[1:] + b[:-1] * b[1:])
    momentum = -4 / x**2 * np.sum((order[:-1] + 1) * sums)
    return float(np.pi * radius**2 * PEAK**2 / (2 * AIR.density * AIR.sound_speed**2) * momentum)


def in_plane_wave(
    radius: float, solver: at.acoustics.Solver, frequency: float = 40e3
) -> at.acoustics.RadiatedField:
    """Field of a hard sphere in the sound of a monopole 50 m away, as good as a plane wave along −x."""
    scene = at.Scene(AIR, [at.sound_hard(at.sphere(radius, edge=radius / 3))], frequency=frequency)
    source = at.Monopoles(
        np.array([[FAR, 0.0, 0.0]]), np.array([PEAK * FAR * np.exp(-1j * scene.wavenumber * FAR)])
    )
    return solver.radiate(scene, source)


@pytest.mark.parametrize(("radius", "error"), [(1e-3, 2e-3), (8e-3, 2e-3)])
def test_the_pressure_on_a_sphere_adds_up_to_the_momentum_it_takes_from_a_plane_wave(
    radius, error
) -> None:
    field = in_plane_wave(radius, at.SphereSeries())
    skin = radiation_of(field, 0)
    assert skin.areas.sum() == pytest.approx(4 * np.pi * radius**2, rel=1e-3)
    expected = radiation_force(radius, 40e3)
    # the sphere's own quadrature has no error of panels
    exact = field.on_surface
    pushing = radiation_pressure(exact.pressure[:, 0], field.velocity(exact.points)[:, :, 0], AIR)
    assert -(exact.areas * pushing) @ exact.normals[:, 0] == pytest.approx(-expected, rel=2e-4)
    np.testing.assert_allclose(skin.force(0), [-expected, 0, 0], atol=error * expected)


def test_boundary_elements_find_that_force() -> None:
    expected = radiation_force(8e-3, 40e3)
    computed = radiation_of(in_plane_wave(8e-3, at.BoundaryElement(0.01)), 0).force(0)
    np.testing.assert_allclose(computed, [-expected, 0, 0], atol=0.01 * expected)


def test_air_that_moves_along_the_skin_pulls() -> None:
    still = radiation_pressure(np.array([300.0 + 400j]), np.zeros((1, 3), dtype=complex), AIR)
    moving = radiation_pressure(np.array([300.0 + 400j]), np.array([[0.0, 3.0, 4j]]), AIR)
    assert still[0] == pytest.approx(500.0**2 / (4 * 1.293 * 343.1**2))
    assert still[0] - moving[0] == pytest.approx(1.293 * 25.0 / 4)


@pytest.fixture(scope="module")
def fingers():
    shape, array = at.pinch(), at.surrounding_box()
    scene = two_fingers(8e-3, 20, shape.gap, length=0.012)  # the tips of the pinch
    reach = np.linalg.norm(array.positions[:, None] - shape.foci(), axis=-1)
    phases = np.exp(-1j * scene.wavenumber * reach).sum(axis=1)
    sources = at.evaluation.drive_sources(array, [at.Drive(phases / np.abs(phases).max())])
    return shape, radiation_of(at.BoundaryElement(0.1).radiate(scene, sources), 0)


def test_both_fingers_are_pushed_alike_under_the_foci(fingers) -> None:
    shape, skin = fingers
    one, other = (skin.pad_force(focus) for focus in shape.foci())
    assert one == pytest.approx(other, rel=0.1)  # the boards are not quite symmetric
    assert one > 1e-4
    assert np.isnan(skin.pad_force(np.array([0.0, 0.0, 0.0])))  # 6 mm from either finger
    assert abs(skin.force(0)[0] + skin.force(1)[0]) < 0.2 * abs(skin.force(0)[0])
    even = replace(skin, radiation_pressure=np.ones(len(skin.points)))
    # A piece of sphere and cylinder of 5 mm radius is a little more than a disc, in whole points.
    assert 0.95 * np.pi * 25e-6 < even.pad_force(shape.foci()[0]) < 1.15 * np.pi * 25e-6


def test_what_has_no_surface_to_press_on_raises() -> None:
    source = at.Monopoles(np.array([[0.0, 0.0, 0.1]]), np.ones(1))
    with raises_code("empty"):
        radiation_of(at.FreeField().radiate(at.Scene(AIR, []), source), 0)
    soft = at.Scene(AIR, [at.impedance(at.sphere(5e-3, edge=2e-3), 3.0)])
    with raises_code("not_supported"):
        radiation_of(at.SphereSeries().radiate(soft, source), 0)


def test_a_field_that_does_not_know_the_surface_raises() -> None:
    field = in_plane_wave(4e-3, at.SphereSeries())

    class Unknowing(type(field)):
        def _at(self, points):
            return self.nowhere(points)

    unknowing = Unknowing(field.scene, field.sources, field.report, field.modes, field.centre)
    with raises_code("data_missing") as raised:
        radiation_of(unknowing, 0)
    lost, points = (int(number) for number in re.findall(r"\d+", str(raised.value))[:2])
    assert 0 < lost <= points
