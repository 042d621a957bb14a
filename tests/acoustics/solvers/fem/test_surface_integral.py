"""The surface integral of finite elements: its compiled loops against NumPy, and that no other solver shares them."""

import re

import numpy as np
import pytest

from airtact import _kernels
from paths import ROOT

CHANCE = np.random.default_rng(3)
POINTS, POSITIONS = CHANCE.normal(size=(20, 3)), CHANCE.normal(size=(700, 3)) + [0.0, 0.0, 8.0]
NORMALS = CHANCE.normal(size=(700, 3))
WAVENUMBER = 6.3 + 0.2j


def strengths(excitations: int) -> np.ndarray:
    return CHANCE.normal(size=(700, excitations)) + 1j * CHANCE.normal(size=(700, excitations))


def green(points: np.ndarray, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """G = e^{ikr}/r for each point and position, and its gradient with the position."""
    apart = positions - points[:, None]
    distance = np.linalg.norm(apart, axis=2)
    value = np.exp(1j * WAVENUMBER * distance) / distance
    return value, ((1j * WAVENUMBER - 1 / distance) * value / distance)[:, :, None] * apart


@pytest.mark.parametrize("variant", _kernels.variants())
@pytest.mark.parametrize("excitations", [1, 3])
def test_the_loops_are_those_of_numpy(variant, excitations):
    before = _kernels.active_variant()
    _kernels.use_variant(variant)
    try:
        monopoles, dipoles = strengths(excitations), strengths(excitations)
        value, gradient = green(POINTS, POSITIONS)
        exact = value @ monopoles + np.einsum("pqd,qd->pq", gradient, NORMALS) @ dipoles
        found = _kernels.surface_integral(
            POINTS, POSITIONS, NORMALS, monopoles, dipoles, WAVENUMBER
        )
        assert np.abs(found - exact).max() < 1e-13 * np.abs(value).sum(axis=1).max()
        exact = np.einsum("pqd,pd->pq", -gradient, NORMALS[:20]) @ monopoles
        found = _kernels.normal_derivative(POINTS, NORMALS[:20], POSITIONS, monopoles, WAVENUMBER)
        assert np.abs(found - exact).max() < 1e-12 * np.abs(value).sum(axis=1).max()
    finally:
        _kernels.use_variant(before)


def loops(solver: str) -> set[str]:
    sources = (ROOT / "src/airtact/acoustics/solvers" / solver).rglob("*.py")
    called = r"_kernels\.([a-z]\w+)"
    return set().union(*[re.findall(called, path.read_text()) for path in sources])


def test_finite_elements_call_no_compiled_loop_of_boundary_elements():
    """Else neither could verify the other; what both call stands in `solvers`: the free field of monopoles."""
    finite, boundary = loops("fem"), loops("bem")
    assert finite == {"surface_integral", "normal_derivative"}
    assert boundary
    assert not any(
        one.startswith(other) or other.startswith(one) for one in finite for other in boundary
    )
