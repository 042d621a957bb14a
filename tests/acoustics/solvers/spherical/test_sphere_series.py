"""The sphere series against published tables, limits, laws of physics and its own boundary condition."""

import numpy as np
import pytest

import airtact as at
from faults import raises_code
from worlds import AIR, directions

WATER = at.Medium(sound_speed=1481.0, density=999.7)
CENTRE = np.array([0.003, -0.002, 0.005])

# J. M. Jech et al., Comparisons among ten models of acoustic backscattering used in aquatic
# ecosystem research, J. Acoust. Soc. Am. 138, 3742 (2015): benchmark target strengths [dB re 1 m²],
# published at two decimals, of spheres of radius 10 mm in water (1477.3 m/s, 1026.8 kg/m³).
# Frequency [kHz]; rigid; pressure release; gas (345 m/s, 1.24 kg/m³); weakly scattering fluid
# (1480.3 m/s, 1028.9 kg/m³).
JECH = [
    (12, -54.44, -42.29, -42.34, -103.95),
    (20, -47.85, -44.39, -44.40, -96.79),
    (40, -49.80, -45.11, -44.31, -94.85),
    (68, -48.00, -45.61, -45.76, -94.28),
    (90, -45.86, -45.73, -45.75, -114.76),
    (150, -46.33, -45.91, -45.93, -94.00),
    (200, -45.58, -45.95, -46.45, -106.59),
    (330, -46.32, -45.99, -45.97, -93.95),
]


def ball(radius=0.01, centre=(0.0, 0.0, 0.0)):
    return at.sphere(radius, radius / 1.5, centre)


def radiate(obstacle, positions, medium=AIR, frequency=40e3, strengths=None):
    positions = np.atleast_2d(np.asarray(positions, dtype=float))
    return at.SphereSeries().radiate(
        at.Scene(medium, [obstacle], frequency),
        at.Monopoles(positions, np.eye(len(positions)) if strengths is None else strengths),
    )


def frequency_of(ka, radius=0.01, medium=AIR):
    return ka / radius * medium.sound_speed / (2.0 * np.pi)


def radial_slope(field, normals, radius, centre, step, outward=True):
    """Derivative along the normal on the skin by six points on one side of it, (P, S)."""
    side = 1.0 if outward else -1.0
    weights = np.array([-137 / 60, 5.0, -5.0, 10 / 3, -5 / 4, 1 / 5])
    values = [
        field.at(centre + (radius + side * (i * step + (0 if outward else 1e-8))) * normals)
        for i in range(6)
    ]
    return side * sum(w * v for w, v in zip(weights, values, strict=True)) / step


@pytest.mark.parametrize("row", JECH, ids=lambda row: f"{row[0]} kHz")
def test_target_strengths_of_the_published_benchmark(row):
    frequency, *published = row
    sea = at.Medium(sound_speed=1477.3, density=1026.8)
    obstacles = [
        at.sound_hard(ball()),
        at.impedance(ball(), 1e-7 + 0j),
        at.filled(ball(), at.Medium(345.0, 1.24)),
        at.filled(ball(), at.Medium(1480.3, 1028.9)),
    ]
    source, point = np.array([[0.0, 0.0, 400.0]]), np.array([[0.0, 0.0, 200.0]])
    for obstacle, strength in zip(obstacles, published, strict=True):
        field = radiate(obstacle, source, sea, 1e3 * frequency)
        scattered = field.scattered_at(point)
        assert 20.0 * np.log10(400.0 * 200.0 * abs(scattered[0, 0])) == pytest.approx(
            strength, abs=0.0101
        )


@pytest.mark.parametrize("ka", [0.2, 4.4934095, 60.0])
@pytest.mark.parametrize("off", [0.0, 1e-4, 0.02])
def test_sound_hard_skin_has_no_normal_slope(ka, off):
    normals = directions(6, seed=3)
    near = normals[0] + 0.3 * normals[1]  # off the receivers by a good millimetre
    source = CENTRE + (0.01 + off) * near / np.linalg.norm(near)
    field = radiate(at.sound_hard(ball(centre=CENTRE)), source, frequency=frequency_of(ka))
    slope = radial_slope(field, normals, 0.01, CENTRE, 4e-3 / (max(ka, 20.0) / 0.01))
    size = np.abs(field.at(CENTRE + 0.01 * normals)).max() * max(ka, 1.0) / 0.01
    assert np.abs(slope).max() < 1e-5 * size


@pytest.mark.parametrize("ratio", [1.0 + 0j, 3.0 - 2.0j, 0.05 + 0j, 200.0 + 0j])
def test_impedance_skin_obeys_its_law(ratio):
    normals = directions(6, seed=4)
    field = radiate(at.impedance(ball(centre=CENTRE), ratio), CENTRE + 0.0105 * normals[2])
    pressure, slope = (
        field.at(CENTRE + 0.01 * normals),
        radial_slope(field, normals, 0.01, CENTRE, 5e-6),
    )
    k = field.scene.wavenumber
    defect = slope + 1j * k / ratio * pressure
    assert np.abs(defect).max() < 2e-5 * np.abs(k / ratio * pressure).max() + 1e-4 * abs(k)


ABSORBING = at.Medium(400.0, 1.0, absorption=30.0)


# A source on the skin takes thousands of terms.
@pytest.mark.parametrize(
    ("inner", "off"),
    [(WATER, 0.05), (at.Medium(100.0, 2.0), 0.05), (ABSORBING, 0.05), (ABSORBING, 0.0)],
)
def test_fluid_sphere_joins_pressure_and_velocity(inner, off):
    normals = directions(3, seed=5)
    near = normals[0] + 0.3 * normals[1]
    source = CENTRE + (0.01 + off) * near / np.linalg.norm(near)
    field = radiate(at.filled(ball(centre=CENTRE), inner), source)
    outside = field.at(CENTRE + 0.01 * normals)
    inside = field.at(CENTRE + (0.01 - 1.1e-9) * normals)
    scale = np.abs(outside).max()
    np.testing.assert_allclose(inside, outside, atol=1e-5 * scale)
    outer_velocity = radial_slope(field, normals, 0.01, CENTRE, 2e-6) / AIR.density
    inner_velocity = radial_slope(field, normals, 0.01, CENTRE, 2e-6, outward=False) / inner.density
    np.testing.assert_allclose(
        inner_velocity, outer_velocity, atol=1e-3 * scale * 733.0 / AIR.density
    )


@pytest.mark.parametrize("boundary", ["sound_hard", "impedance", "filled"])
@pytest.mark.parametrize("ka", [0.3, 7.3, 45.0])
def test_source_and_receiver_change_places(boundary, ka):
    surface = ball(centre=CENTRE)
    obstacle = {
        "sound_hard": at.sound_hard(surface),
        "impedance": at.impedance(surface, 2.0 + 1.0j),
        "filled": at.filled(surface, WATER),
    }[boundary]
    heights = np.array([0.01, 0.01, 0.0101, 0.0105, 0.03, 0.1])
    points = CENTRE + heights[:, None] * directions(6, seed=6)
    matrix = np.zeros((6, 6), dtype=complex)
    for i in range(6):
        others = np.flatnonzero(np.arange(6) != i)
        matrix[others, i] = radiate(obstacle, points[i], frequency=frequency_of(ka)).at(
            points[others]
        )[:, 0]
    assert np.abs(matrix - matrix.T).max() < 1e-8 * np.abs(matrix).max()


def emitted_and_received_power(obstacle, ka, height):
    """Power of a unit monopole, times 2ρω: 4π Im p at itself, and k ∮|p|²r²dΩ far away."""
    field = radiate(obstacle, [[0.0, 0.0, height]], frequency=frequency_of(ka))
    near, far = field.at(np.array([[0.0, 1e-5, height], [0.0, 2e-5, height]]))[:, 0].imag
    emitted = 4.0 * np.pi * (4.0 * near - far) / 3.0  # Im p is smooth and even about the source
    cosine, weight = np.polynomial.legendre.leggauss(40 + int(8 * ka * height / 0.01))
    far = 1e4 * np.stack([np.sqrt(1.0 - cosine**2), 0.0 * cosine, cosine], axis=1)
    intensity = np.abs(field.at(far)[:, 0]) ** 2 * 1e8
    return emitted, field.scene.wavenumber.real * 2.0 * np.pi * np.sum(weight * intensity)


@pytest.mark.parametrize(
    ("ka", "height"), [(0.2, 0.012), (4.4934095, 0.0102), (9.0, 0.03), (30.0, 0.0105)]
)
def test_lossless_spheres_keep_the_power(ka, height):
    """The optical theorem for a point source: what is drawn from the source arrives far away."""
    for obstacle in (at.sound_hard(ball()), at.filled(ball(), WATER), at.impedance(ball(), 1.5j)):
        emitted, received = emitted_and_received_power(obstacle, ka, height)
        assert received == pytest.approx(emitted, rel=1e-6)


def test_a_lossy_sphere_swallows_power_and_a_stiff_one_is_sound_hard():
    emitted, received = emitted_and_received_power(at.impedance(ball(), 1.0 + 0j), 7.3, 0.012)
    assert 0.2 * emitted < received < 0.9 * emitted
    points = np.vstack([0.01 * directions(4, 0), 0.06 * directions(4, 1)])
    stiff, hard = (
        radiate(body, [0.0, 0.0, 0.0103]).at(points)
        for body in (at.impedance(ball(), 1e9 + 0j), at.sound_hard(ball()))
    )
    np.testing.assert_allclose(stiff, hard, rtol=1e-6)


@pytest.mark.parametrize("absorption", [0.0, 0.15])
def test_sphere_of_the_same_fluid_is_not_there(absorption):
    medium = at.Medium(343.1, 1.293, absorption)
    points = np.vstack(
        [
            np.zeros((1, 3)),
            0.007 * directions(3, 0),
            0.0099 * directions(3, 1),
            0.02 * directions(3, 2),
        ]
    )
    sources = np.array([[0.0, 0.0, 0.01], [0.0, 0.04, 0.0]])
    field = radiate(at.filled(ball(), medium), sources, medium)
    assert field.valid(points).all()
    open_air = at.FreeField().radiate(at.Scene(medium), at.Monopoles(sources, np.eye(2)))
    np.testing.assert_allclose(field.at(points), open_air.at(points), rtol=1e-9)


def test_the_surface_has_the_area_the_pressure_and_the_field_at_it():
    field = radiate(at.sound_hard(ball(centre=CENTRE)), CENTRE + [0.0, 0.0, 0.05])
    surface = field.on_surface
    assert surface.areas.sum() == pytest.approx(4.0 * np.pi * 0.01**2, rel=1e-12)
    np.testing.assert_allclose(surface.points, CENTRE + 0.01 * surface.normals, atol=1e-15)
    # Green's formula on the hard skin: the double layer over it gives the scattered field.
    point = CENTRE + np.array([[0.02, 0.03, -0.01]])
    offset = point - surface.points
    distance = np.linalg.norm(offset, axis=1)
    k = field.scene.wavenumber
    slope = (1.0 / distance - 1j * k) * np.exp(1j * k * distance) / (4.0 * np.pi * distance)
    layer = np.sum(
        surface.areas
        * slope
        * np.sum(offset * surface.normals, axis=1)
        / distance
        * surface.pressure[:, 0]
    )
    assert field.scattered_at(point)[0, 0] == pytest.approx(layer, rel=1e-7)


def test_points_inside_are_nan_unless_the_sphere_is_filled():
    points = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.01], [0.0, 0.0, 0.009]])
    field = radiate(at.sound_hard(ball()), [[0.0, 0.0, 0.05]])
    np.testing.assert_array_equal(field.valid(points), [False, True, False])
    np.testing.assert_array_equal(np.isnan(field.at(points))[:, 0], [True, False, True])
    assert radiate(at.filled(ball(), WATER), [[0.0, 0.0, 0.05]]).valid(points).all()


@pytest.mark.parametrize(
    ("obstacles", "source", "code"),
    [
        ([at.sound_hard(ball())], 0.009, "inside_body"),
        ([], 0.1, "not_supported"),
        (
            [at.sound_hard(at.capsule((0.0, 0.0, 0.0), (0.0, 0.0, 0.02), 0.005, 0.004))],
            0.1,
            "not_supported",
        ),
        ([at.sound_hard(at.Surface(ball().vertices, ball().triangles))], 0.1, "not_supported"),
    ],
    ids=["source inside", "no body", "capsule", "mesh"],
)
def test_scenes_other_than_a_sphere_and_a_source_outside_are_rejected(obstacles, source, code):
    sources = at.Monopoles(np.array([[0.0, 0.0, source]]), np.ones(1))
    with raises_code(code):
        at.SphereSeries().radiate(at.Scene(AIR, obstacles), sources)


@pytest.mark.parametrize(
    ("source", "point", "code"),
    [
        (0.02, [0.0, np.nan, 0.0], "not_finite"),
        (0.02, [0.0, 0.0, 0.02], "misplaced"),
        # micrometres from a source that touches the surface
        (0.01, 0.01 * np.array([2e-4, 0.0, np.sqrt(1.0 - 4e-8)]), "not_converged"),
    ],
)
def test_points_that_are_no_numbers_or_on_a_source_are_rejected(source, point, code):
    field = radiate(at.sound_hard(ball()), [[0.0, 0.0, source]])
    with raises_code(code):
        field.at(np.array([point]))
