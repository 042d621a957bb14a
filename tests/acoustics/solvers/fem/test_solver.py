"""Finite elements against closed forms, and the input that they reject."""

from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest

import airtact as at
from airtact.acoustics.solvers.fem import factorisation, mesh, solver
from airtact.acoustics.solvers.fem.field import FiniteField, touching_warnings
from faults import raises_code
from references import relative_columns as relative
from references.hand_poses import example
from worlds import AIR as PAPER_AIR
from worlds import directions, far_points, one_each

WATER = at.Medium(1481.0, 999.7)
BALL = at.sphere(0.005, 0.0025)
SMALL = at.Scene(PAPER_AIR, [at.sound_hard(at.sphere(0.004, 0.002))])
QUICK = at.FiniteElement(order=4)
COARSE = at.FiniteElement(order=2)
"""Not accurate, for what is said and rejected."""


def ball_scene(obstacle: at.acoustics.Obstacle, medium: at.Medium = PAPER_AIR) -> at.Scene:
    return at.Scene(medium, [obstacle])


def errors(
    solved_by: at.acoustics.Solver, scene: at.Scene, sources: at.Monopoles, points: np.ndarray
) -> float:
    found = solved_by.radiate(scene, sources).at(points)
    return float(relative(found, at.SphereSeries().radiate(scene, sources).at(points)).max())


BODIES = {
    "hard": at.sound_hard(BALL),
    "impedance": at.impedance(BALL, 1.5 + 0.5j),
    "water": at.filled(BALL, WATER),
    "light gas": at.filled(BALL, at.Medium(500.0, 2.0)),
}


@cache
def factorised(name: str) -> solver.FactorisedScene:
    """Factorise one body at default settings, for all tests of this file."""
    return at.FiniteElement().factorised(ball_scene(BODIES[name]))


@pytest.mark.parametrize(
    "name",
    [
        "hard",
        "water",
        pytest.param("impedance", marks=pytest.mark.slow),
        pytest.param("light gas", marks=pytest.mark.slow),
    ],
)
def test_spheres_at_default_settings(name):
    ready = factorised(name)
    scene = ready.scene
    sources = one_each(
        np.concatenate([directions(2, 0) * (0.005 + gap) for gap in (0.0, 5e-4, 0.02)])
    )
    assert errors(ready, scene, sources, far_points(20)) < (0.01 if name == "impedance" else 5e-3)
    aloof = one_each(directions(2, 1) * 0.02)
    points = directions(30, 6) * np.linspace(0.0005, 0.0065, 30)[:, None]
    field, exact = ready.radiate(scene, aloof), at.SphereSeries().radiate(scene, aloof)
    valid = field.valid(points)
    assert np.array_equal(valid, exact.valid(points))
    assert np.array_equal(np.isfinite(field.at(points)), np.isfinite(exact.at(points)))
    assert relative(field.at(points)[valid], exact.at(points)[valid]).max() < 0.02


def test_the_pressure_on_the_surface_is_that_of_the_series():
    ready = factorised("hard")
    sources = one_each(directions(2, 0) * 0.0055)
    surface = ready.radiate(ready.scene, sources).on_surface
    assert surface.areas.sum() == pytest.approx(4 * np.pi * 0.005**2, rel=2e-3)
    assert np.allclose((surface.normals * surface.points).sum(axis=1), 0.005, atol=2e-5)
    points = 0.005 * surface.points / np.linalg.norm(surface.points, axis=1)[:, None]
    exact = at.SphereSeries().radiate(ready.scene, sources).at(points)
    assert relative(surface.pressure, exact).max() < 0.03


def test_next_sources_reuse_the_factorisation():
    scene = ball_scene(BODIES["hard"])
    ready = QUICK.factorised(scene)
    first = ready.radiate(scene, one_each(directions(2, 0) * 0.0055))
    factor = ready.system.factor
    second = ready.radiate(scene, one_each(directions(2, 1) * 0.0055))
    assert isinstance(second, FiniteField)
    assert ready.system.factor is factor
    assert first.from_afar is not second.from_afar
    with raises_code("not_supported"):
        ready.radiate(ball_scene(BODIES["water"]), one_each(directions(2, 1) * 0.0055))


@pytest.mark.parametrize(
    ("settings", "coarse", "limit"),
    [
        pytest.param({"order": 3}, 0, 1e-6, marks=pytest.mark.slow),
        ({}, factorisation.COARSE_ORDER, 1e-3),
    ],
    ids=["fine", "default"],
)
def test_pardiso_solves_what_ngsolves_own_factorisation_does(settings, coarse, limit, monkeypatch):
    """With absorption, which the error of the series shows to be solved for."""
    monkeypatch.setattr(factorisation, "COARSE_ORDER", coarse)
    scene = at.Scene(at.Medium(343.1, 1.293, absorption=20.0), SMALL.obstacles)
    sources = one_each(directions(2, 0) * 0.0045)
    one = at.FiniteElement(**settings).radiate(scene, sources)
    assert one.report.settings["factorisation"] == "pardiso"
    one = one.at(far_points(20))
    monkeypatch.setattr(solver, "pardiso_library", lambda: None)
    other = at.FiniteElement(**settings).radiate(scene, sources).at(far_points(20))
    assert relative(one, other).max() < limit
    exact = at.SphereSeries().radiate(scene, sources).at(far_points(20))
    assert relative(one, exact).max() < (0.1 if settings else 0.01)


def test_pardiso_is_recommended_where_it_is_missing(monkeypatch):
    scene, sources = SMALL, one_each(np.array([[0.0, 0, 0.02]]))
    monkeypatch.setattr(solver, "pardiso_library", lambda: None)
    steps: list[str] = []
    field = replace(COARSE, progress=steps.append).radiate(scene, sources)
    assert field.report.settings["factorisation"] == "sparsecholesky"
    assert len(steps[-1]) > len("factorising and solving")  # it says what to install
    assert list(field.report.seconds) == ["meshing", "assembling", "factorising and solving"]


@pytest.mark.parametrize(
    ("settings", "code"),
    [
        ({"order": 0}, "out_of_range"),
        ({"elements_per_wavelength": 30.0}, "out_of_range"),
    ],
)
@pytest.mark.usefixtures("as_outside_the_tests")
def test_settings_out_of_range_are_rejected(settings, code):
    with raises_code(code):
        at.FiniteElement(**settings)


def test_scenes_that_cannot_be_solved_are_rejected():
    with raises_code("empty"):
        QUICK.radiate(at.Scene(PAPER_AIR, []), one_each(np.array([[0.0, 0, 0.02]])))
    with raises_code("inside_body"):
        QUICK.radiate(ball_scene(BODIES["hard"]), one_each(np.zeros((1, 3))))


def test_an_open_hand_is_rejected_before_its_memory_is_taken(monkeypatch):
    monkeypatch.setattr(factorisation, "available_memory", lambda: 16 * 2.0**30)
    hand = at.hand_from_joints(*example("relaxed"))
    steps: list[str] = []
    with raises_code("too_little_memory"):
        at.FiniteElement(progress=steps.append).factorised(ball_scene(at.sound_hard(hand.surface)))
    assert steps == []


def test_bodies_that_netgen_cannot_mesh_are_rejected_by_name():
    hard = [
        at.sound_hard(at.sphere(0.004, 0.002, centre=(side * 0.003, 0.0, 0.0))) for side in (-1, 1)
    ]
    with raises_code("bodies_overlap"):
        QUICK.factorised(at.Scene(PAPER_AIR, hard))
    corners = np.array(list(product((-0.004, 0.004), (-0.004, 0.004), (-5e-5, 5e-5))))
    faces = [[0, 2, 6, 4], [1, 5, 7, 3], [0, 4, 5, 1], [2, 3, 7, 6], [0, 1, 3, 2], [4, 6, 7, 5]]
    plate = np.array([[face[0], face[one], face[one + 1]] for face in faces for one in (1, 2)])
    with raises_code("out_of_range"):
        QUICK.factorised(ball_scene(at.sound_hard(at.Surface(corners, plate))))
    with raises_code("mesh_open"):
        QUICK.factorised(ball_scene(at.sound_hard(at.Surface(BALL.vertices, BALL.triangles[1:]))))


@pytest.mark.parametrize(
    "name", ["hard", "impedance", "water", pytest.param("light gas", marks=pytest.mark.slow)]
)
def test_the_scattered_pressure_is_that_of_the_series(name):
    ready = factorised(name)
    scene = ready.scene
    sources = one_each(np.concatenate([directions(2, 0) * 0.0058, directions(2, 1) * 0.02]))
    points = np.concatenate(
        [directions(20, 3) * np.linspace(0.0053, 0.02, 20)[:, None], far_points(5)]
    )
    field, exact = ready.radiate(scene, sources), at.SphereSeries().radiate(scene, sources)
    free = at.FreeField().radiate(at.Scene(PAPER_AIR, []), sources)
    assert relative(field.scattered_at(points), exact.at(points) - free.at(points)).max() < 0.03
    assert np.isnan(field.scattered_at(sources.positions[:2])).any(axis=1).all()


def test_sources_that_touch_soft_bodies_are_warned_of():
    sources = one_each(np.array([[0, 0, 0.02], [0, 0, 0.005]]))
    for name in ("impedance", "water"):
        assert len(touching_warnings(ball_scene(BODIES[name]), sources)) == 1
    assert touching_warnings(ball_scene(BODIES["hard"]), sources) == ()
    field = COARSE.radiate(ball_scene(BODIES["water"]), sources)
    assert field.report.warnings == touching_warnings(field.scene, sources)


def test_tetrahedra_that_fold_name_their_body(monkeypatch):
    monkeypatch.setattr(mesh, "MIN_STRETCH", 2.0)  # so that what is bent at all counts as folded
    with raises_code("mesh_faulty"):
        COARSE.factorised(SMALL)


def test_what_pardiso_does_not_solve_is_said(monkeypatch):
    pardiso = factorisation.Pardiso
    monkeypatch.setattr(
        factorisation, "Pardiso", lambda form, free, _: pardiso(form, free, residual=1e-30)
    )
    with raises_code("not_converged"):
        COARSE.radiate(SMALL, one_each(np.array([[0.0, 0, 0.02]])))
