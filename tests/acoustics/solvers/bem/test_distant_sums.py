"""Sums between distant clusters, against plain sums in double precision."""

from functools import cache

import numpy as np
import pytest

import airtact as at
from airtact import _kernels
from airtact.acoustics.solvers import shared
from airtact.acoustics.solvers.bem import layer_potentials
from airtact.evaluation.metrics import radiate_drives
from references import relative_columns
from worlds import AIR, directions

HARD = np.zeros(0, complex)
K = 732.5


def board(distance: float, width: float = 0.15) -> np.ndarray:
    """2040 points on a square board in front of the origin, twelve on each face."""
    angle = 2 * np.pi * np.arange(12) / 12
    radius = np.tile([4e-3, 2e-3], 6)
    face = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0 * angle], axis=1)
    along = np.linspace(-width / 2, width / 2, 14)
    x, y = np.meshgrid(along, along[:13])
    centres = np.stack([x.ravel(), y.ravel(), np.full(x.size, distance)], axis=1)[:170]
    return (centres[:, None] + face).reshape(-1, 3)


def body(radius: float, count: int = 2600) -> np.ndarray:
    return radius * directions(count, 1) * [1, 1.5, 0.4]


def cloud(radius: float, count: int) -> np.ndarray:
    return radius * np.random.default_rng(2).normal(size=(count, 3))


PLACES = {
    "board close by": (body(0.04), board(0.045)),
    "board": (body(0.06), board(0.15)),
    "board far off": (body(0.06), board(0.6)),
    "board of a metre": (body(0.06), board(0.3, width=1.0)),
    "two boards": (body(0.06), np.concatenate([board(0.15), board(-0.1)[:, [2, 0, 1]]])),
    "small body": (body(6e-3), board(0.15)),
    "elements as receivers": (board(0.12), body(0.05)),
    "two clouds in each other": (cloud(0.05, 2100), cloud(0.051, 2200) + 1e-3),
    "few receivers": (body(0.06, 3), board(0.15)),
    "few sources": (body(0.06), board(0.15)[:5]),
    "one of each": (body(0.06, 1), board(0.15)[:1]),
    "all receivers in one place": (np.full((1500, 3), 0.01), board(0.15)),
    "a line": (body(0.06) * [1, 0, 0], board(0.15)),
}


def strengths_of(count: int, excitations: int) -> np.ndarray:
    pick = np.random.default_rng(3)
    return pick.normal(size=(count, excitations)) + 1j * pick.normal(size=(count, excitations))


@cache
def sums(place: str, kind: str) -> tuple[_kernels.Layer, np.ndarray, np.ndarray]:
    """Receivers, strengths of the sources, and the plain sum, which every test of a place shares."""
    receivers, sources = PLACES[place]
    wavenumber = K + (0.5j if "air" in kind else 0j)
    strengths = strengths_of(len(sources), 2)
    normals = None
    single = HARD
    if "nodes" in kind:
        normals = 1e-6 * directions(len(receivers), 4)
        if "yielding" in kind:
            single = 1e-6 * wavenumber * strengths_of(len(receivers), 1)[:, 0]
    layer = _kernels.Layer(receivers, normals, single, wavenumber)
    if normals is None:
        exact = _kernels.apply_monopoles(receivers, sources, strengths, wavenumber, "float64")
    else:
        exact = _kernels.apply_transposed(sources, layer, strengths, "float64")
    return layer, strengths, exact


@pytest.mark.usefixtures("variant")
@pytest.mark.parametrize("error", [1e-3, 2e-4])
@pytest.mark.parametrize(
    "kind", ["monopoles", "monopoles in air", "nodes", "yielding nodes in air"]
)
@pytest.mark.parametrize("place", PLACES)
def test_sums_between_clusters_have_about_the_error_asked_for(place, kind, error):
    layer, strengths, exact = sums(place, kind)
    found = _kernels.apply_distant(layer, PLACES[place][1], strengths, error)
    assert relative_columns(found, exact).max() < 2 * error


@pytest.fixture(scope="module")
def each_alone() -> tuple[np.ndarray, np.ndarray]:
    """130 excitations of one place, and the sums of each by itself."""
    receivers, sources = PLACES["board"]
    layer = _kernels.Layer(receivers, None, HARD, complex(K))
    strengths = strengths_of(len(sources), 130)
    columns = np.split(strengths, 130, axis=1)
    alone = [_kernels.apply_distant(layer, sources, column.copy(), 1e-3) for column in columns]
    return strengths, np.concatenate(alone, axis=1)


@pytest.mark.parametrize("excitations", [0, 1, 64, 65, 130])
def test_each_excitation_is_summed_by_itself(excitations, each_alone):
    receivers, sources = PLACES["board"]
    layer = _kernels.Layer(receivers, None, HARD, complex(K))
    strengths, alone = each_alone[0][:, :excitations].copy(), each_alone[1][:, :excitations]
    found = _kernels.apply_distant(layer, sources, strengths, 1e-3)
    assert found.shape == (len(receivers), excitations)
    assert (np.abs(found - alone) <= 2e-3 * np.abs(alone).max(axis=0)).all()


def test_none_at_none_is_nothing():
    nowhere = np.zeros((0, 3))
    layer = _kernels.Layer(nowhere, None, HARD, complex(K))
    assert _kernels.apply_distant(layer, np.ones((5, 3)), np.ones((5, 2), complex), 1e-3).size == 0
    layer = _kernels.Layer(np.ones((5, 3)), None, HARD, complex(K))
    assert not _kernels.apply_distant(layer, nowhere, np.ones((0, 2), complex), 1e-3).any()


def test_threads_do_not_change_the_sums():
    receivers, sources = PLACES["board"]
    layer = _kernels.Layer(receivers, None, HARD, complex(K))
    strengths = strengths_of(len(sources), 2)
    first = _kernels.apply_distant(layer, sources, strengths, 1e-3)
    assert np.array_equal(first, _kernels.apply_distant(layer, sources, strengths, 1e-3))


@pytest.mark.parametrize("planes", [(), (at.plane((0, 0, 0.2), (0, 0, -1)),)], ids=["air", "plane"])
def test_drives_and_fields_around_a_body_are_those_of_plain_sums(planes, monkeypatch):
    ball = at.capsule((-0.02, 0, 0.12), (0.02, 0, 0.12), 0.012, edge=4e-3)
    scene = at.Scene(AIR, [at.sound_hard(ball)], planes=planes)
    array = at.flat_boards(1, 1)
    target = at.Target(np.array([[0.0, 0.0, 0.106], [0.025, 0.0, 0.107]]))
    picture = board(0.08, 0.04)

    def solved(least: int) -> tuple[np.ndarray, ...]:
        for module in (shared, layer_potentials):
            monkeypatch.setattr(module, "MIN_CLUSTERED", least)
        solver = at.BoundaryElement(accuracy=0.03)
        beacons = solver.radiate(scene, target.beacons())
        transfer = at.transfer_matrix(beacons, array)
        drive = at.Drive(transfer.matrix[0].conj() / np.abs(transfer.matrix[0]).max())
        field = radiate_drives(scene, array, [drive], solver)
        return transfer.matrix, field.at(target.points), field.at(picture)

    for found, exact in zip(solved(256), solved(10**9), strict=True):
        assert 0 < np.linalg.norm(found - exact) < 1e-3 * np.linalg.norm(exact)
