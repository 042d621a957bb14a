"""The compiled loops against NumPy twins that share no code with them."""

import numpy as np
import pytest
from scipy.integrate import dblquad

from airtact import _kernels

PRECISIONS = [("float32", np.complex64, 2e-5), ("float64", np.complex128, 1e-13)]
WAVENUMBERS = [732.5 + 0j, 732.5 + 3.1j, 0j]


@pytest.fixture(params=_kernels.variants(), autouse=True)
def variant(request):
    """Run every test with every instruction set that this machine has."""
    best = _kernels.active_variant()
    _kernels.use_variant(request.param)
    yield request.param
    _kernels.use_variant(best)


def test_an_unknown_variant_is_refused():
    with pytest.raises(ValueError, match="does not run the variant abacus"):
        _kernels.use_variant("abacus")


def scattered_points(seed: int, count: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(count, 3)) * 0.03


def double_layer(points, sources, weighted_normals, wavenumber):
    offset = sources[None] - points[:, None]
    distance = np.linalg.norm(offset, axis=2)
    slope = (offset * weighted_normals).sum(axis=2) / distance
    return slope * (1j * wavenumber - 1 / distance) * np.exp(1j * wavenumber * distance) / (4 * np.pi * distance)


def relative(found, expected):
    return np.linalg.norm(found - expected) / np.linalg.norm(expected)


@pytest.mark.parametrize("wavenumber", WAVENUMBERS)
@pytest.mark.parametrize(("precision", "kind", "tolerance"), PRECISIONS)
def test_double_layer_loops_equal_numpy(precision, kind, tolerance, wavenumber):
    points, shifted, sources = (scattered_points(seed, count) for seed, count in ((1, 40), (2, 40), (3, 700)))
    normals = scattered_points(4, 700) * 1e-3
    first, second = (double_layer(p, sources, normals, wavenumber) for p in (points, shifted))
    dual, single = np.empty((40, 700), kind), np.empty((40, 700), kind)
    getattr(_kernels, f"dual_matrix_{precision}")(points, shifted, sources, normals, wavenumber, dual)
    getattr(_kernels, f"double_layer_matrix_{precision}")(points, sources, normals, wavenumber, single)
    density = np.random.default_rng(5).normal(size=(700, 3)) + 1j
    applied = np.empty((40, 3), np.complex128)
    getattr(_kernels, f"apply_double_layer_{precision}")(points, sources, normals, density, wavenumber, 0.0, applied)
    assert relative(single, first) < tolerance
    assert relative(dual, -first + 1j * second) < tolerance
    assert relative(applied, first @ density) < 3 * tolerance
    far = np.linalg.norm(points[:, None] - sources[None], axis=2) > 0.02
    getattr(_kernels, f"apply_double_layer_{precision}")(points, sources, normals, density, wavenumber, 0.02, applied)
    assert relative(applied, np.where(far, first, 0) @ density) < 3 * tolerance


@pytest.mark.parametrize("wavenumber", WAVENUMBERS)
def test_entries_of_single_panels_equal_numpy(wavenumber):
    points, sources, normals = scattered_points(1, 9), scattered_points(3, 30), scattered_points(4, 30) * 1e-3
    target, panel = np.array([0, 4, 8, 8]), np.array([3, 0, 2, 4])
    out, columns = np.empty((4, 6), complex), 6 * panel[:, None] + np.arange(6)
    expected = double_layer(points, sources, normals, wavenumber)[target[:, None], columns]
    _kernels.panel_entries(points, target, panel, sources, normals, wavenumber, 0.0, out)
    assert relative(out, expected) < 1e-13
    distance = np.linalg.norm(points[target, None] - sources[columns], axis=2)
    _kernels.panel_entries(points, target, panel, sources, normals, wavenumber, 0.03, out)
    assert relative(out, np.where(distance > 0.03, expected, 0)) < 1e-13


@pytest.mark.parametrize("wavenumber", WAVENUMBERS)
@pytest.mark.parametrize(("precision", "kind", "tolerance"), PRECISIONS)
def test_monopole_loop_equals_numpy(precision, kind, tolerance, wavenumber):
    points, sources = scattered_points(1, 40), scattered_points(3, 700)
    strength = np.random.default_rng(5).normal(size=(700, 2)) + 1j
    distance = np.linalg.norm(points[:, None] - sources[None], axis=2)
    out = np.empty((40, 2), np.complex128)
    getattr(_kernels, f"apply_monopoles_{precision}")(points, sources, strength, wavenumber, out)
    assert relative(out, np.exp(1j * wavenumber * distance) / distance @ strength) < 3 * tolerance


def test_a_long_way_from_the_origin_float32_keeps_its_digits():
    points, sources = scattered_points(1, 40), scattered_points(3, 300)
    near, far = np.empty((40, 1), np.complex128), np.empty((40, 1), np.complex128)
    strength, away = np.ones((300, 1), np.complex128), np.array([3.0, -2.0, 5.0])
    _kernels.apply_monopoles_float32(points, sources, strength, 732.5 + 0j, near)
    _kernels.apply_monopoles_float32(points + away, sources + away, strength, 732.5 + 0j, far)
    assert relative(far, near) < 2e-5


def test_arrays_of_different_lengths_are_refused():
    points = scattered_points(1, 4)
    with pytest.raises(ValueError, match="different lengths"):
        _kernels.apply_monopoles_float64(points, points, np.ones((3, 1), complex), 1 + 0j, np.empty((4, 1), complex))


FLAT = np.array([[[0, 0, 0], [4, 0, 0], [1, 3, 0], [2, 0, 0], [2.5, 1.5, 0], [0.5, 1.5, 0]]]) * 1e-3
CURVED = FLAT + np.array([[0, 0, 0], [0, 0, 0], [0, 0, 0], [0, 0, 4e-4], [0, 0, 5e-4], [0, 0, 3e-4]])


def near_moments(panel, target, wavenumber, points, single_layer=False, contact=0.0):
    rules = [np.polynomial.legendre.leggauss(n) for n in range(1, 41)]
    nodes = np.concatenate([0.5 * (x + 1) for x, _ in rules])
    weights = np.concatenate([0.5 * w for _, w in rules])
    out, distance, foot = np.empty((1, 6), complex), np.empty(1), np.empty((1, 2))
    zero = np.zeros(1, dtype=np.int64)
    _kernels.near_integrals(
        single_layer,
        target[None],
        zero,
        zero,
        panel,
        np.array([contact]),
        wavenumber,
        nodes,
        weights,
        40,
        *points,
        out,
        distance,
        foot,
    )
    return out[0], distance[0], foot[0]


def panel_at(panel, u, v):
    w = 1 - u - v
    shape = np.array([w * (2 * w - 1), u * (2 * u - 1), v * (2 * v - 1), 4 * w * u, 4 * u * v, 4 * v * w])
    along_u = np.array([1 - 4 * w, 4 * u - 1, 0, 4 * (w - u), 4 * v, -4 * v])
    along_v = np.array([1 - 4 * w, 0, 4 * v - 1, -4 * u, 4 * u, 4 * (w - v)])
    return shape @ panel[0], np.cross(along_u @ panel[0], along_v @ panel[0])


@pytest.mark.parametrize("panel", [FLAT, CURVED], ids=["flat", "curved"])
@pytest.mark.parametrize("single_layer", [False, True], ids=["double", "single"])
def test_near_integral_equals_adaptive_quadrature(panel, single_layer):
    target, wavenumber = np.array([1.2e-3, 0.8e-3, 1.5e-3]), 732.5 + 3j

    def integrand(v, u, part, power):
        point, normal = panel_at(panel, u, v)
        offset = point - target
        distance = np.linalg.norm(offset)
        green = np.exp(1j * wavenumber * distance) / (4 * np.pi * distance)
        kernel = green * np.linalg.norm(normal)
        if not single_layer:
            kernel = green * (1j * wavenumber - 1 / distance) * (offset @ normal) / distance
        return getattr(kernel * u**power, part)

    found, _, _ = near_moments(panel, target, wavenumber, (10, 10), single_layer)
    for index, power in ((0, 0), (1, 1), (3, 2)):
        expected = complex(
            *(dblquad(integrand, 0, 1, 0, lambda u: 1 - u, (part, power), 1e-12)[0] for part in ("real", "imag"))
        )
        assert abs(found[index] - expected) < 1e-7 * abs(expected)


@pytest.mark.parametrize("height", [0.0, 1e-7, 1e-5, 1e-3])
@pytest.mark.parametrize("single_layer", [False, True], ids=["double", "single"])
def test_few_points_suffice_at_any_height_over_a_panel(height, single_layer):
    foot = panel_at(CURVED, 0.2, 0.3)
    target = foot[0] + height * foot[1] / np.linalg.norm(foot[1])
    few, distance, place = near_moments(CURVED, target, 732.5 + 0j, (4, 4), single_layer)
    many, _, _ = near_moments(CURVED, target, 732.5 + 0j, (16, 16), single_layer)
    assert np.abs(few - many).max() < 2e-3 * np.abs(many).max()
    assert distance == pytest.approx(height, abs=1e-15)
    assert place == pytest.approx([0.2, 0.3], abs=1e-6)


@pytest.mark.parametrize("place", [(0.2, 0.3), (0.0, 0.0), (0.0, 1.0), (0.5, 0.0), (0.4, 0.6)])
def test_a_point_in_contact_is_heard_as_on_the_panel(place):
    foot, normal = panel_at(CURVED, *place)
    exact, _, _ = near_moments(CURVED, foot, 732.5 + 0j, (12, 12), contact=1e-12)
    for height in (-1e-6, -1e-9, 1e-12, 1e-8, 1e-6):
        target = foot + height * normal / np.linalg.norm(normal)
        found, distance, _ = near_moments(CURVED, target, 732.5 + 0j, (12, 12), contact=2e-6)
        assert np.abs(found - exact).max() < 1e-4 * np.abs(exact).max()
        assert distance == pytest.approx(abs(height), rel=1e-3)


def test_flat_panel_fills_its_solid_angle():
    """Van Oosterom & Strackee, IEEE Trans. Biomed. Eng. 30 (1983) 125, equation (8)."""
    target = np.array([1.0e-3, 0.5e-3, 2e-4])
    a, b, c = (FLAT[0, i] - target for i in range(3))
    na, nb, nc = (np.linalg.norm(x) for x in (a, b, c))
    angle = 2 * np.arctan2(a @ np.cross(b, c), na * nb * nc + (a @ b) * nc + (a @ c) * nb + (b @ c) * na)
    found, _, _ = near_moments(FLAT, target, 0j, (12, 12))
    assert found[0].real == pytest.approx(-angle / (4 * np.pi), rel=1e-7)


def test_near_pairs_are_those_within_reach():
    points, centres = scattered_points(1, 50), scattered_points(2, 80)
    reach = np.linspace(0.01, 0.05, 80)
    first = np.zeros(51, dtype=np.int64)
    _kernels.count_near(points, centres, reach, first)
    panel = np.empty(first[-1], dtype=np.int64)
    _kernels.list_near(points, centres, reach, first, panel)
    expected = np.nonzero(np.linalg.norm(points[:, None] - centres[None], axis=2) < reach)
    assert np.array_equal(np.repeat(np.arange(50), np.diff(first)), expected[0])
    assert np.array_equal(panel, expected[1])


def test_inscribed_diameter_of_a_sphere_and_a_slab():
    direction = scattered_points(1, 600)
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    grid = np.stack(np.meshgrid(np.arange(20.0), np.arange(20.0), [0.0, 1.5]), axis=-1).reshape(-1, 3) * 1e-3
    faces = np.where(grid[:, 2:] > 0, [[0.0, 0, 1]], [[0.0, 0, -1]])
    points = np.concatenate([5e-3 * direction, grid])
    body = np.repeat([0, 1], [600, 800])
    out = np.empty(1400)
    _kernels.inscribed_diameter(points, np.concatenate([direction, faces]), body, 8e-3, out)
    assert np.allclose(out[:600], 8e-3)  # capped
    assert np.allclose(out[600:], 1.5e-3)
    _kernels.inscribed_diameter(points, np.concatenate([direction, faces]), body, 1.0, out)
    assert np.allclose(out[:600], 1e-2)
