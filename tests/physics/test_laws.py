"""Laws that hold for every solver, whatever the scene."""

import numpy as np
import pytest

import airtact as at
from airtact import _kernels
from airtact.acoustics.solvers.bem.layer_potentials import NearRule, double_layer_pressure
from airtact.acoustics.solvers.bem.quadrature import (
    NODAL,
    Nodes,
    near_lists,
    near_quadrature,
    place_nodes,
)
from airtact.acoustics.solvers.bem.solutions import assemble, dual_surface
from airtact.acoustics.solvers.shared import gmres
from references import relative_columns
from worlds import (
    directions,
    far_points,
    finger_sources,
    hard,
    one_each,
    outer_points,
    sphere_rule,
    two_fingers,
)

BALL = at.sphere(0.007, 0.004)
SCENE = hard(BALL)


@pytest.fixture(
    scope="module",
    params=[
        "series",
        "boundary element",
        pytest.param("finite element", marks=pytest.mark.slow),
    ],
)
def solver(request) -> at.acoustics.Solver:
    if request.param == "finite element":
        return at.FiniteElement(order=4).factorised(SCENE)
    return at.SphereSeries() if request.param == "series" else at.BoundaryElement()


def test_the_field_of_a_at_b_is_that_of_b_at_a(solver):
    here, there = directions(4, 1) * 0.018, directions(5, 2) * 0.06
    forth = solver.radiate(SCENE, one_each(here)).at(there)
    back = solver.radiate(SCENE, one_each(there)).at(here).T
    assert np.abs(forth - back).max() < 3e-3 * np.abs(forth).mean()


def test_reciprocity_between_fingers_falls_with_refinement():
    scene = two_fingers(8e-3, 20, 12e-3, length=0.012)
    here, there = finger_sources(scene, 10e-3), outer_points(scene, 8)
    errors = []
    for accuracy in (0.01, 0.004):
        solver = at.BoundaryElement(accuracy=accuracy)
        forth = solver.radiate(scene, one_each(here)).at(there)
        back = solver.radiate(scene, one_each(there)).at(here).T
        errors.append(np.abs(forth - back).max() / np.abs(forth).mean())
    assert errors[0] < 3e-3
    assert errors[1] < errors[0]


@pytest.mark.parametrize(
    ("precision", "limit", "away", "length"),
    [
        ("float32", 1e-4, 1.0, 0.012),
        # Rounding chooses other terms of low-rank blocks, whose error is 0.4 %.
        ("float32", 1e-3, 0.0, 0.044),
        ("float64", 1e-9, 0.0, 0.012),
        pytest.param("float64", 1e-9, 0.0, 0.044, marks=pytest.mark.slow),
    ],
)
def test_moving_hand_and_array_together_changes_nothing(precision, limit, away, length):
    """The long fingers have points that are equally far from two panels."""
    scene = two_fingers(8e-3, 20, 12e-3, length)
    sources, points = finger_sources(scene, 0.5e-3), outer_points(scene)
    pose = at.Pose.turn((1, 2, -1), 0.7, translation=(away, -0.3 * away, 0.2 * away))
    moved = hard(*(obstacle.surface.moved(pose) for obstacle in scene.obstacles))
    solver = at.BoundaryElement(accuracy=0.03, precision=precision)
    rest = solver.radiate(scene, one_each(sources)).at(points)
    after = solver.radiate(moved, one_each(pose.apply(sources))).at(pose.apply(points))
    assert relative_columns(after, rest).max() < limit


def test_a_hard_body_neither_emits_nor_absorbs_power(solver):
    """No net power crosses a sphere round the body, with the source outside it."""
    field = solver.radiate(SCENE, one_each(np.array([[0.0, 0.004, 0.03]])))
    way, area = sphere_rule(24)
    step = 1e-5
    low, high = (field.at(way * (0.016 + side * step))[:, 0] for side in (-1, 1))
    crossing = np.imag(np.conj(0.5 * (low + high)) * (high - low) / (2 * step))
    assert abs(area @ crossing) < 5e-3 * (area @ np.abs(crossing))


def test_excitations_add_up_and_there_is_no_field_inside(solver):
    sources = directions(3, 4) * 0.012
    strengths = np.array([[1, 0.5], [2j, 0], [0, -1]])
    together = solver.radiate(SCENE, at.Monopoles(sources, strengths))
    apart = solver.radiate(SCENE, one_each(sources)).at(far_points(20))
    assert relative_columns(together.at(far_points(20)), apart @ strengths).max() < 2e-3
    points = directions(40, 6) * np.linspace(0.001, 0.013, 40)[:, None]
    outside = np.linalg.norm(points, axis=1) > 0.007
    assert np.array_equal(together.valid(points), outside)
    assert np.array_equal(np.isfinite(together.at(points)[:, 0]), outside)


@pytest.mark.parametrize("offset", [1.0, 0.0])
def test_beacons_solved_once_serve_every_pose_of_the_array(offset):
    """Moving the array in the hand's frame equals solving the moved hand."""
    pose = at.Pose.turn((0, 0, 1), 0.4, translation=(0.004, 0.002 * offset, -0.003))
    foci = np.array([[0, 0, 0.0075], [0.0075, 0, 0]])
    array = at.PhasedArray(far_points(12), -directions(12, 8))
    solver = at.BoundaryElement()
    once = at.transfer_matrix(solver.radiate(SCENE, one_each(foci)), array.seen_from(pose))
    moved = solver.radiate(hard(BALL.moved(pose)), one_each(pose.apply(foci)))
    assert relative_columns(once.matrix, at.transfer_matrix(moved, array).matrix).max() < 1e-4


def bent_ball() -> at.Surface:
    """A body without any symmetry: an ellipsoid, bent and curved from its own formula."""
    ball = at.sphere(0.006, 0.0028)

    def bent(points: np.ndarray) -> np.ndarray:
        x, y, z = np.moveaxis(points, -1, 0)
        return np.stack([1.3 * x + 30 * z**2, 0.8 * y, 1.6 * z + 10 * x * y], axis=-1)

    return at.Surface(bent(ball.vertices), ball.triangles, midpoints=bent(ball.midpoints))


def single_layer(
    nodes: Nodes, points: np.ndarray, density: np.ndarray, wavenumber: complex
) -> np.ndarray:
    """∫ e^{ikr}/(4πr) density dS at points on or off the surface."""
    distance = np.linalg.norm(points[:, None] - nodes.points, axis=2)
    distance[distance < 1e-9] = 1.0  # a node's own panel is near, so its entry is replaced
    rows = nodes.weights / (4 * np.pi * distance) * np.exp(1j * wavenumber * distance)
    first, panel = near_lists(nodes, points, 2.5 * nodes.radii)
    target = np.repeat(np.arange(len(points)), np.diff(first))
    moments, _, _ = _kernels.near_integrals(
        True, points, target, panel, nodes.panels, wavenumber, near_quadrature(8, 8)
    )
    rows[target[:, None], 6 * panel[:, None] + np.arange(6)] = moments @ NODAL
    return rows @ density


@pytest.mark.parametrize(
    "body",
    [
        at.sphere(0.006, 0.003),
        at.capsule((0.0, 0.0, -0.008), (0.001, 0.002, 0.009), 0.005, 0.003),
        bent_ball(),
    ],
    ids=["sphere", "capsule", "bent"],
)
def test_a_source_inside_the_body_has_its_field_outside(body):
    """A body that moves as an inner monopole would push it radiates that monopole: exact on any skin.

    With v = ∂u/∂n of the monopole u the dual-surface equation reads A p = −(S v)(x) + i (S v)(x').
    """
    wavenumber = 732.53 + 0j
    inner = np.array([0.0005, -0.0003, 0.001])
    panels = body.panelled(3.2e-3)
    nodes = place_nodes(panels.quadratic_triangles, panels.body, panels.deviation)
    rule = NearRule(2.5, (8, 8))
    surface = dual_surface(nodes, wavenumber, rule, "float64")
    offset = nodes.points - inner
    r = np.linalg.norm(offset, axis=1)
    slope = (offset * nodes.normals).sum(axis=1) / r
    push = np.exp(1j * wavenumber * r) / r * (1j * wavenumber - 1 / r) * slope
    right = -single_layer(nodes, nodes.points, push, wavenumber)
    right += 1j * np.repeat(single_layer(nodes, surface.shifted, push, wavenumber), 3)
    pressure = gmres(assemble(surface, "float64").times, right[None], 1e-8).solution.T
    points = far_points(20)
    values = double_layer_pressure(points, nodes, pressure, wavenumber, rule, "float64")[:, 0]
    values -= single_layer(nodes, points, push, wavenumber)
    distance = np.linalg.norm(points - inner, axis=1)
    exact = np.exp(1j * wavenumber * distance) / distance
    assert np.linalg.norm(values - exact) < 5e-3 * np.linalg.norm(exact)
