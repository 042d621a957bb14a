"""Sums at many points in cells, against plain sums in NumPy and the closed form of a ball."""

import numpy as np
import pytest

import airtact as at
from airtact import _kernels
from airtact.acoustics.solvers.bem.layer_potentials import GRIDS, cells_of, monopole_layer
from references import relative, relative_columns
from worlds import WAVELENGTH, hard

ERRORS = [error for error, _, _ in GRIDS]
TURNED = at.Pose.turn((1, 2, 3), 0.7, (0.3, -0.2, 0.1))


def grid(*sides: int, step: float = 0.4e-3) -> np.ndarray:
    """Points of a line, a square or a cube that stands askew."""
    along = [step * (np.arange(side) - side / 2) for side in sides]
    flat = np.stack(np.meshgrid(*along, indexing="ij"), axis=-1).reshape(-1, len(sides))
    return TURNED.apply(np.pad(flat, ((0, 0), (0, 3 - len(sides)))))


def sources_beside(points: np.ndarray, count: int = 150) -> np.ndarray:
    """Among the points, a tenth of a millimetre off them, and up to 50 mm away."""
    random = np.random.default_rng(3)
    spread = np.geomspace(1e-4, 50e-3, count)[:, None] * random.normal(size=(count, 3))
    return points[random.integers(0, len(points), count)] + spread


def layer(sources, normals, wavenumber):
    if normals is None:
        return monopole_layer(sources, wavenumber)
    return _kernels.Layer(sources, normals, np.zeros(0, complex), complex(wavenumber))


def plain(points, sources, normals, strengths, wavenumber):
    offset = sources - points[:, None]
    distance = np.linalg.norm(offset, axis=2)
    kernel = np.exp(1j * wavenumber * distance) / distance
    if normals is not None:
        slope = (offset * normals).sum(axis=2) / distance
        kernel = kernel * slope * (1j * wavenumber - 1 / distance) / (4 * np.pi)
    return kernel @ strengths


@pytest.mark.parametrize("error", ERRORS)
@pytest.mark.parametrize("sides", [(600,), (45, 50), (22, 23, 24)])
@pytest.mark.parametrize("kind", ["monopoles", "layer in air"])
def test_sums_in_cells_equal_plain_ones(kind, sides, error):
    points = grid(*sides)
    wavenumber = 2 * np.pi / WAVELENGTH + (0.2j if kind == "layer in air" else 0j)
    sources, random = sources_beside(points), np.random.default_rng(5)
    normals = None if kind == "monopoles" else 1e-6 * random.normal(size=sources.shape)
    strengths = random.normal(size=(len(sources), 2)) + 1j * random.normal(size=(len(sources), 2))
    cells = cells_of(points, WAVELENGTH, error)
    if cells is None:
        # grids of 1000 points in a cubic wavelength do not pay here
        assert (error, len(sides)) == (min(ERRORS), 3)
        return
    assert len(cells.grids) < len(points)
    found = cells.sums(layer(sources, normals, wavenumber), strengths)
    exact = plain(points, sources, normals, strengths, wavenumber)
    away = np.abs(exact) < 10 * np.median(
        np.abs(exact), axis=0
    )  # or one point beside a source would be all that counts
    assert relative(found[away], exact[away]) < error
    np.testing.assert_allclose(found[~away], exact[~away], rtol=1e-2)


@pytest.mark.parametrize("points", [np.zeros((0, 3)), grid(5, 5), grid(40, 40, step=20e-3)])
def test_few_points_or_points_far_apart_have_no_cells(points):
    assert cells_of(points, WAVELENGTH, 1e-3) is None
    assert cells_of(grid(60, 60), WAVELENGTH, 1e-9) is None


@pytest.fixture(scope="module")
def pictured() -> tuple[at.acoustics.RadiatedField, at.acoustics.RadiatedField, np.ndarray]:
    """A beacon beside a ball and one far from it, in closed form and by boundary elements, and points of a picture."""
    scene = hard(at.sphere(6e-3, edge=2e-3, centre=(1e-3, 2e-3, -1e-3)))
    sources = at.Monopoles(np.array([[1e-3, 2e-3, 5.5e-3], [0.06, 0.05, 0.08]]), np.eye(2))
    along = np.linspace(-20e-3, 20e-3, 80)
    across, up = np.meshgrid(along, along)
    points = np.stack([across.ravel(), np.full(6400, 1.9e-3), up.ravel()], axis=1)
    points[3] = [1e-3 + 6e-3, 2e-3, -1e-3]  # on the skin, and by a hair out of the plane
    return (
        at.SphereSeries().radiate(scene, sources),
        at.BoundaryElement(accuracy=0.03).radiate(scene, sources),
        points,
    )


def test_a_picture_beside_a_ball_is_its_closed_form(pictured):
    series, field, points = pictured
    height = np.linalg.norm(points - [1e-3, 2e-3, -1e-3], axis=1) - 6e-3
    found, exact, outside = field.at(points), series.at(points), height > 0
    clear = np.abs(height) > 0.1e-3  # nearer, points may touch a panel
    assert np.array_equal(np.isnan(found).any(axis=1)[clear], ~outside[clear])
    assert np.array_equal(field.valid(points)[clear], outside[clear])
    assert relative_columns(found[outside], exact[outside]).max() < 0.03


def test_a_point_of_a_picture_beside_a_source_is_as_by_itself():
    ball = at.sphere(radius=4e-3, edge=2e-3)
    side = np.linspace(-12e-3, 12e-3, 60)
    picture = np.stack(np.meshgrid(side, [0.0], side + 1e-5, indexing="ij"), axis=-1).reshape(-1, 3)
    beside = int(np.argmin(np.linalg.norm(picture - [0, 0, 8e-3], axis=1)))
    for off in (2e-9, 1e-6):
        source = at.Monopoles(picture[beside] + np.array([[0, off, 0]]), np.ones(1))
        field = at.BoundaryElement(accuracy=0.05).radiate(hard(ball), source)
        alone = field.at(picture[beside : beside + 1])[0, 0]
        assert abs(field.at(picture)[beside, 0] - alone) < 1e-5 * abs(alone)
        assert abs(alone) > 0.9 / off
