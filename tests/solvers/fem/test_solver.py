"""Finite elements against closed forms, and what they refuse."""

import re
from itertools import product

import numpy as np
import pytest

import airtact as at
from airtact.solvers.fem import factorisation, memory
from airtact.solvers.fem.factorisation import pardiso_library
from airtact.solvers.fem.field import FiniteField, rough_places
from airtact.solvers.fem.meshing import meshing
from airtact.solvers.fem.meshing.skin import skin_mesh
from airtact.solvers.fem.meshing.symmetry import mirrors_of
from benchmarks.accuracy import PAPER_AIR, directions, far_points, one_each, relative
from hand.hand_poses import example

WATER = at.Medium(1481.0, 999.7)
BALL = at.sphere(0.005, 0.0025)
QUICK = at.FiniteElement(order=4, symmetry=())


def ball_scene(obstacle: at.Obstacle, medium: at.Medium = PAPER_AIR) -> at.Scene:
    return at.Scene(medium, [obstacle])


def errors(solver: at.Solver, scene: at.Scene, sources: at.Monopoles, points: np.ndarray) -> float:
    found = solver.radiate(scene, sources).at(points)
    return float(relative(found, at.SphereSeries().radiate(scene, sources).at(points)).max())


BODIES = {
    "hard": at.sound_hard(BALL),
    "impedance": at.impedance(BALL, 1.5 + 0.5j),
    "water": at.filled(BALL, WATER),
    "light gas": at.filled(BALL, at.Medium(500.0, 2.0)),
}


@pytest.mark.parametrize("name", list(BODIES))
def test_spheres_at_default_settings(name):
    scene = ball_scene(BODIES[name])
    ready = at.FiniteElement(symmetry=()).factorised(scene)
    sources = one_each(np.concatenate([directions(2, 0) * (0.005 + gap) for gap in (0.0, 5e-4, 0.02)]))
    assert errors(ready, scene, sources, far_points(20)) < (0.01 if name == "impedance" else 5e-3)
    aloof = one_each(directions(2, 1) * 0.02)
    points = directions(30, 6) * np.linspace(0.0005, 0.0065, 30)[:, None]
    field, exact = ready.radiate(scene, aloof), at.SphereSeries().radiate(scene, aloof)
    valid = field.valid(points)
    assert np.array_equal(valid, exact.valid(points))
    assert np.array_equal(np.isfinite(field.at(points)), np.isfinite(exact.at(points)))
    assert relative(field.at(points)[valid], exact.at(points)[valid]).max() < 0.02


def test_one_octant_solves_the_whole_sphere():
    scene = ball_scene(BODIES["hard"])
    sources = one_each(directions(2, 0) * 0.0055)
    ready = at.FiniteElement(symmetry=("x", "y", "z")).factorised(scene)
    assert errors(ready, scene, sources, far_points(20)) < 0.01
    whole = at.FiniteElement(symmetry=()).factorised(scene)
    assert 4 * ready.report.nodes < whole.report.nodes
    skin = ready.radiate(scene, sources).on_surface
    assert skin.areas.sum() == pytest.approx(4 * np.pi * 0.005**2, rel=2e-3)
    assert np.allclose((skin.normals * skin.points).sum(axis=1), 0.005, atol=1e-5)
    places = 0.005 * skin.points / np.linalg.norm(skin.points, axis=1)[:, None]
    exact = at.SphereSeries().radiate(scene, sources).at(places)
    assert relative(skin.pressure, exact).max() < 0.03


def test_sounds_on_a_mirror_are_even_about_it():
    """And sounds that two mirrored monopoles make: no factorisation is spent on what is silent."""
    ready = at.FiniteElement(order=3).factorised(ball_scene(BODIES["hard"]))
    contact = at.Monopoles(np.array([[0.005, 0.0, 0.0], [-0.005, 0.0, 0.0]]), np.ones(2))
    ready.radiate(ready.scene, contact)
    assert list(ready.ready[0].factors) == [(0, 0, 0)]
    ready.radiate(ready.scene, at.Monopoles(np.array([[0.0, 0.0, 0.005], [0.0, 0.0, 0.02]]), np.ones(2)))
    assert list(ready.ready[0].factors) == [(0, 0, 0), (0, 0, 1)]


def test_absorption_is_solved_for():
    scene = ball_scene(BODIES["hard"], at.Medium(343.1, 1.293, absorption=20.0))
    assert errors(QUICK, scene, one_each(directions(3, 0) * 0.0055), far_points(20)) < 0.015


def test_next_sources_reuse_the_factorisation():
    scene = ball_scene(BODIES["hard"])
    ready = QUICK.factorised(scene)
    first = ready.radiate(scene, one_each(directions(2, 0) * 0.0055))
    factors = dict(ready.ready[0].factors)
    second = ready.radiate(scene, one_each(directions(2, 1) * 0.0055))
    assert isinstance(second, FiniteField)
    assert ready.ready[0].factors == factors
    assert first.from_afar is not second.from_afar
    with pytest.raises(at.InvalidInput, match="another scene of 1 body"):
        ready.radiate(ball_scene(BODIES["water"]), one_each(directions(2, 1) * 0.0055))


def test_the_estimate_tells_the_error():
    scene, points = ball_scene(BODIES["hard"]), far_points(20)
    sources = one_each(directions(2, 0) * 0.0055)
    field = at.FiniteElement(order=3, symmetry=(), estimate=True).radiate(scene, sources)
    true = float(relative(field.at(points), at.SphereSeries().radiate(scene, sources).at(points)).max())
    assert 0.3 < field.report.estimated_error / true < 3


def test_orders_that_follow_the_size_cost_less_than_one_order():
    scene, points = ball_scene(BODIES["hard"]), far_points(20)
    sources = one_each(directions(2, 0) * 0.02)
    graded, even = (at.FiniteElement(symmetry=("x", "y", "z"), graded=one).factorised(scene) for one in (True, False))
    assert graded.report.nodes < 0.7 * even.report.nodes
    assert errors(graded, scene, sources, points) < 0.005
    assert errors(even, scene, sources, points) < 0.005


def test_progress_is_told():
    steps: list[str] = []
    at.FiniteElement(order=2, symmetry=(), progress=steps.append).radiate(
        ball_scene(BODIES["hard"]), one_each(np.array([[0, 0, 0.02]]))
    )
    assert steps == ["meshing", "assembling", "factorising and solving"]


def test_a_meshed_workspace_is_read_off_the_mesh():
    scene, corner = ball_scene(at.sound_hard(at.sphere(0.003, 0.001))), 0.012
    box = ((-corner, -corner, -corner), (corner, corner, corner))
    solver = at.FiniteElement(order=5, domain="box", box=box)
    sources = one_each(np.array([[0.0, 0.0, 0.003]]))
    points = directions(20, 3) * 0.011
    field = solver.radiate(scene, sources)
    exact = at.SphereSeries().radiate(scene, sources).at(points)
    assert relative(field.at(points), exact).max() < 0.05
    assert not field.valid(np.array([[0.0, 0.0, 0.013]]))[0]
    with pytest.raises(
        at.InvalidInput, match=r"source 0 at .* stands 1 mm outside the workspace, in the matched layer"
    ):
        solver.radiate(scene, one_each(np.array([[0.0, 0.0, 0.013]])))


@pytest.mark.parametrize(("corner", "off"), [(0.003, "2.86"), (0.005, "0.858")])
def test_bodies_beyond_the_workspace_are_refused(corner, off):
    solver = at.FiniteElement(domain="box", box=((-corner, -corner, -corner), (corner, corner, corner)))
    with pytest.raises(at.InvalidInput, match=rf"body 0 reaches {off} mm too far at .* with 0\.86 mm to spare; take a"):
        solver.factorised(ball_scene(BODIES["hard"]))


@pytest.mark.parametrize(("order", "size"), [(4, 1.0), (3, 1.7)])
def test_coarse_meshes_and_low_orders_are_not_graded(order, size):
    """Two fingers were 65 % off where they were."""
    scene = ball_scene(BODIES["hard"])
    graded, even = (
        at.FiniteElement(order=order, elements_per_wavelength=size, symmetry=("x", "y", "z"), graded=one).factorised(
            scene
        )
        for one in (True, False)
    )
    assert graded.report.nodes == even.report.nodes
    assert graded.report.settings["graded"] is False


@pytest.mark.parametrize("symmetry", [(), ("x", "z")], ids=["whole", "quarter"])
def test_fronts_solve_what_netgens_own_factorisation_does(symmetry, monkeypatch):
    monkeypatch.setattr(factorisation, "ROUGH", 0)
    scene = ball_scene(BODIES["hard"], at.Medium(343.1, 1.293, absorption=20.0))
    sources = one_each(directions(2, 0) * 0.0055)
    one, other = (
        at.FiniteElement(order=3, symmetry=symmetry, factorisation=name).radiate(scene, sources).at(far_points(20))
        for name in ("multifrontal", "sparsecholesky")
    )
    assert relative(one, other).max() < 1e-6


def test_what_low_orders_leave_of_a_load_is_far_below_their_own_error():
    scene, sources = ball_scene(BODIES["hard"]), one_each(directions(2, 0) * 0.0055)
    one, other = (
        at.FiniteElement(factorisation=name).radiate(scene, sources).at(far_points(20))
        for name in ("multifrontal", "sparsecholesky")
    )
    assert relative(one, other).max() < 1e-3


def test_where_single_precision_does_not_suffice_double_takes_over(monkeypatch):
    monkeypatch.setattr(factorisation, "REFINEMENTS", 1)
    monkeypatch.setattr(factorisation, "ROUGH", 0)
    monkeypatch.setattr(factorisation, "ENOUGH", 1e-12)  # one solution in single precision leaves more
    ready = at.FiniteElement(order=2, symmetry=("x", "y", "z")).factorised(ball_scene(BODIES["hard"]))
    sources = one_each(np.array([[0.0, 0, 0.02]]))
    field = ready.radiate(ready.scene, sources)
    factor = next(iter(ready.ready[0].factors.values()))
    assert isinstance(factor, factorisation.Multifrontal)
    assert isinstance(factor._spare, factorisation.SparseCholesky)
    exact = at.FiniteElement(order=2, symmetry=("x", "y", "z"), factorisation="sparsecholesky")
    exact = exact.factorised(ready.scene).radiate(ready.scene, sources).at(far_points(20))
    assert relative(field.at(far_points(20)), exact).max() < 1e-9
    with pytest.raises(at.InvalidInput, match=r"single precision leaves 0\.5 of the load unsolved after 1 refinements"):
        factorisation.Refined._not_enough(factor, np.zeros((1, 1), dtype=np.complex128), 0.5)


@pytest.mark.skipif(pardiso_library() is None, reason="the package mkl is not installed")
def test_pardiso_agrees(monkeypatch):
    monkeypatch.setattr(factorisation, "ROUGH", 0)
    scene, sources = ball_scene(BODIES["hard"]), one_each(directions(2, 0) * 0.0055)
    one, other = (
        at.FiniteElement(order=3, symmetry=("x",), factorisation=name).radiate(scene, sources).at(far_points(20))
        for name in ("sparsecholesky", "pardiso")
    )
    assert relative(one, other).max() < 1e-6


# --- symmetry -------------------------------------------------------------------------------------------------------


def test_mirrors_are_found_where_they_are():
    fingers = at.pinch().surfaces
    scene = at.Scene(PAPER_AIR, [at.sound_hard(surface) for surface in fingers])
    assert [mirror.axis for mirror in mirrors_of(scene, None)] == [0, 1]
    mixed = at.Scene(PAPER_AIR, [at.sound_hard(fingers[0]), at.filled(fingers[1], WATER)])
    assert [mirror.axis for mirror in mirrors_of(mixed, None)] == [1]


def test_symmetry_that_is_not_there_is_refused_with_how_far_it_is_off():
    shapes = [at.sphere(0.004, 0.002, centre=(side * 0.007, 0.0, 0.0)) for side in (-1, 1)]
    lifted = at.sphere(0.004, 0.002, centre=(0.007, 0.0, 0.001))
    scene = at.Scene(PAPER_AIR, [at.sound_hard(shapes[0]), at.sound_hard(lifted)])
    with pytest.raises(at.InvalidInput, match=r"plane x = 0 mm was asked for, but the bodies are 1 mm off it"):
        at.FiniteElement(symmetry=("x",)).radiate(scene, one_each(np.array([[0.0, 0, 0.02]])))
    with pytest.raises(at.InvalidInput, match="bodies of 2 kinds face each other"):
        mirrors_of(at.Scene(PAPER_AIR, [at.sound_hard(shapes[0]), at.filled(shapes[1], WATER)]), ("x",))


# --- what is refused ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"order": 0}, "order is 0, but it must be a whole number from 1 to 10"),
        ({"elements_per_wavelength": 30.0}, "elements_per_wavelength is 30"),
        ({"symmetry": "x"}, r"symmetry is 'x', but it must be 'found' or axes such as \('x', 'y'\)"),
        ({"symmetry": ("w",)}, r"symmetry is \('w',\)"),
        ({"domain": "open"}, "domain is 'open'"),
        (
            {"box": ((0.01, 0, 0), (-0.01, 0.1, 0.1))},
            r"goes from \(10.00, 0.00, 0.00\) mm to \(-10.00, 100.00, 100.00\) mm",
        ),
        (
            {"box": ((0.0, 0.0, 0.0), (0.1, 0.1, 0.0))},
            r"to \(100.00, 100.00, 0.00\) mm, but its second corner must lie",
        ),
        ({"box": ((0.0, 0.0, np.nan), (0.1, 0.1, 0.1))}, r"from \(0.00, 0.00, nan\) mm"),
        ({"factorisation": "lu"}, "factorisation is 'lu'"),
    ],
)
def test_settings_out_of_range_are_refused(settings, sentence, monkeypatch):
    monkeypatch.setattr("jaxtyping.config.jaxtyping_disable", True)  # so that the guard itself answers
    with pytest.raises(at.InvalidInput, match=sentence):
        at.FiniteElement(**settings)


def test_scenes_that_cannot_be_solved_are_refused(monkeypatch):
    sources = one_each(np.array([[0.0, 0, 0.02]]))
    with pytest.raises(at.InvalidInput, match="the scene has 0 obstacles"):
        QUICK.radiate(at.Scene(PAPER_AIR, []), sources)
    with pytest.raises(at.InvalidInput, match=r"source 0 at .* is 5 mm deep"):
        QUICK.radiate(ball_scene(BODIES["hard"]), one_each(np.zeros((1, 3))))
    monkeypatch.setattr(memory, "available_memory", lambda: 1e6)
    with pytest.raises(
        at.InvalidInput, match=r"order 4 need some .* GiB for a box of 6 cubic wavelengths, but 0\.0 GiB"
    ):
        QUICK.radiate(ball_scene(BODIES["hard"]), sources)


def test_an_open_hand_is_refused_before_its_memory_is_taken(monkeypatch):
    monkeypatch.setattr(memory, "available_memory", lambda: 16 * 2.0**30)
    hand = at.hand_from_joints(*example("relaxed"))
    steps: list[str] = []
    with pytest.raises(
        at.InvalidInput,
        match=r"order 5 need some \S+e\+06 unknowns and \d+\.\d GiB for a box of \d{4} cubic .* 16\.0 GiB",
    ):
        at.FiniteElement(progress=steps.append).factorised(ball_scene(at.sound_hard(hand.surface)))
    assert steps == []


def test_bodies_that_netgen_cannot_mesh_are_refused_by_name():
    sound = [at.sound_hard(at.sphere(0.004, 0.002, centre=(side * 0.003, 0.0, 0.0))) for side in (-1, 1)]
    with pytest.raises(at.InvalidInput, match=r"bodies 0 and 1 overlap or touch: 2 mm deep near"):
        QUICK.factorised(at.Scene(PAPER_AIR, sound))
    corners = np.array(list(product((-0.004, 0.004), (-0.004, 0.004), (-5e-5, 5e-5))))
    faces = [[0, 2, 6, 4], [1, 5, 7, 3], [0, 4, 5, 1], [2, 3, 7, 6], [0, 1, 3, 2], [4, 6, 7, 5]]
    plate = np.array([[face[0], face[one], face[one + 1]] for face in faces for one in (1, 2)])
    with pytest.raises(at.InvalidInput, match=r"the body is 0\.1 mm thick near .*, less than 0\.5 mm"):
        QUICK.factorised(ball_scene(at.sound_hard(at.Surface(corners, plate))))
    with pytest.raises(at.InvalidInput, match=r"3 edges have a triangle on one side only, so the surface is open"):
        QUICK.factorised(ball_scene(at.sound_hard(at.Surface(BALL.vertices, BALL.triangles[1:]))))


def test_pardiso_without_its_package_is_refused(monkeypatch):
    monkeypatch.setattr("airtact.solvers.fem.factorisation.pardiso_library", lambda: None)
    with pytest.raises(at.InvalidInput, match=r"package mkl is not installed \(0 files found\)"):
        at.FiniteElement(order=2, symmetry=(), factorisation="pardiso").radiate(
            ball_scene(BODIES["hard"]), one_each(np.array([[0.0, 0, 0.02]]))
        )


# --- velocity -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", list(BODIES))
def test_velocity_is_that_of_the_series(name):
    scene = ball_scene(BODIES[name])
    sources = one_each(np.array([[0.02, 0.006, 0.01], [-0.004, 0.012, -0.03]]))
    field = at.FiniteElement(symmetry=("x", "z")).factorised(scene).radiate(scene, sources)
    exact = at.SphereSeries().radiate(scene, sources)
    ways = directions(20, 3)
    places = {"on": ways * 0.005000001, "beside": ways * 0.0062, "away": ways * 0.011}
    if name in ("water", "light gas"):
        places["inside"] = ways * 0.0035
        places["on"] = ways * 0.00502
    for where, points in places.items():
        found, true = field.velocity(points), exact.velocity(points)
        off = np.linalg.norm(found - true, axis=(0, 1)) / np.linalg.norm(true, axis=(0, 1))
        assert off.max() < {"on": 0.06, "beside": 0.03, "inside": 0.05, "away": 0.01}[where], (where, off)
    if name == "hard":
        sliding = np.einsum("pd,pds->ps", ways, field.velocity(ways * 0.005))
        assert np.abs(sliding).max() < 0.01 * np.abs(field.velocity(ways * 0.005)).max()
    if name != "water":
        assert np.isnan(field.velocity(np.array([[0.0, 0.0, 0.004]]))).all() == (name != "light gas")


# --- what is rough, crossed or folded ---------------------------------------------------------------------------------


def test_sources_that_touch_soft_bodies_are_warned_of():
    sources = one_each(np.array([[0, 0, 0.02], [0, 0, 0.005]]))
    for name in ("impedance", "water"):
        (sentence,) = rough_places(ball_scene(BODIES[name]), sources)
        assert "1 of 2 sources touch impedance or filled bodies, the first at (0.00, 0.00, 5.00) mm" in sentence
        assert "within 4.29 mm" in sentence
    assert rough_places(ball_scene(BODIES["hard"]), sources) == ()
    solver = at.FiniteElement(order=2, symmetry=("x", "y", "z"))
    field = solver.radiate(ball_scene(BODIES["water"]), sources)
    assert field.report.warnings == rough_places(field.scene, sources)


def test_skins_that_cross_are_named():
    shapes = [at.sphere(0.004, 0.002, centre=(side * 0.003, 0.0, 0.0)).shape for side in (-1, 1)]
    fault = meshing._crossing(skin_mesh(shapes, 0.004, ()), 0.004)
    assert re.match(r"bodies 0 and 1 cross at \(.*\) mm when meshed with triangles of 4 mm \(\d+ pairs", str(fault))


def test_tetrahedra_that_fold_name_their_body(monkeypatch):
    monkeypatch.setattr(meshing, "FOLDED", 2.0)  # so that what is bent at all counts as folded
    with pytest.raises(
        at.InvalidInput, match=r"body 0 bends too much for tetrahedra of [\d.]+ mm at .*: one is folded"
    ):
        QUICK.factorised(ball_scene(BODIES["hard"]))
