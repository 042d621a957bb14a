"""Laws that hold for every solver, whatever the scene."""

import numpy as np
import pytest
from scipy.special import roots_legendre

import airtact as at
from airtact.acoustics.solvers.bem.layer_potentials import NearRule, double_layer_pressure
from airtact.acoustics.solvers.bem.operator import assemble, dual_surface
from airtact.acoustics.solvers.bem.quadrature import Nodes, integrate_near, place_nodes
from airtact.acoustics.solvers.gmres import gmres
from airtact.acoustics.solvers.monopoles import monopole_pressure
from benchmarks.accuracy import (
    PAPER_AIR,
    directions,
    far_points,
    motion,
    one_each,
    reciprocity,
    relative,
)

SOLVERS = [at.SphereSeries(), at.BoundaryElement(), at.FiniteElement(order=4, symmetry=())]
NAMES = ["series", "boundary element", "finite element"]


def ball_scene(centre=(0.0, 0.0, 0.0)) -> at.Scene:
    return at.Scene(PAPER_AIR, [at.sound_hard(at.sphere(0.007, 0.004, centre=centre))])


@pytest.mark.parametrize("solver", SOLVERS, ids=NAMES)
def test_the_field_of_a_at_b_is_that_of_b_at_a(solver):
    here, there = directions(4, 1) * 0.018, directions(5, 2) * 0.06
    forth = solver.radiate(ball_scene(), one_each(here)).at(there)
    back = solver.radiate(ball_scene(), one_each(there)).at(here).T
    assert np.abs(forth - back).max() < 3e-3 * np.abs(forth).mean()


def test_reciprocity_between_fingers_falls_with_refinement():
    coarse, fine = reciprocity(length=0.012), reciprocity(0.004, length=0.012)
    assert coarse < 3e-3
    assert fine < coarse


@pytest.mark.parametrize(("precision", "allowed"), [("float32", 1e-4), ("float64", 1e-9)])
def test_moving_hand_and_array_together_changes_nothing(precision, allowed):
    assert motion(precision, away=0.0, length=0.012) < allowed
    assert motion(precision, away=1.0, length=0.012) < allowed
    assert (
        motion(precision, away=0.0) < allowed
    )  # with panels that two points of equal distance are nearest on


@pytest.mark.parametrize("solver", SOLVERS, ids=NAMES)
def test_a_hard_body_neither_emits_nor_absorbs_power(solver):
    """The power that crosses a sphere round the body, with the source outside it, is nothing."""
    source = np.array([[0.0, 0.004, 0.03]])
    field = solver.radiate(ball_scene(), one_each(source))
    cosine, weight = roots_legendre(24)
    azimuth = 2 * np.pi * np.arange(48) / 48
    sine = np.sqrt(1 - cosine**2)
    way = np.stack(
        [
            np.outer(sine, np.cos(azimuth)),
            np.outer(sine, np.sin(azimuth)),
            np.outer(cosine, np.ones(48)),
        ],
        -1,
    )
    way, area, radius, step = (
        way.reshape(-1, 3),
        np.repeat(weight, 48) * 2 * np.pi / 48,
        0.016,
        1e-5,
    )
    low, high = (field.at(way * (radius + side * step))[:, 0] for side in (-1, 1))
    crossing = np.imag(np.conj(0.5 * (low + high)) * (high - low) / (2 * step))
    assert abs(area @ crossing) < 5e-3 * (area @ np.abs(crossing))


@pytest.mark.parametrize("solver", SOLVERS, ids=NAMES)
def test_excitations_add_up(solver):
    sources = directions(3, 4) * 0.012
    strengths = np.array([[1, 0.5], [2j, 0], [0, -1]])
    together = solver.radiate(ball_scene(), at.Monopoles(sources, strengths)).at(far_points(20))
    apart = solver.radiate(ball_scene(), one_each(sources)).at(far_points(20))
    assert relative(together, apart @ strengths).max() < 2e-3


@pytest.mark.parametrize("solver", SOLVERS, ids=NAMES)
def test_inside_the_body_there_is_no_field(solver):
    field = solver.radiate(ball_scene(), one_each(np.array([[0, 0, 0.02]])))
    points = directions(40, 6) * np.linspace(0.001, 0.013, 40)[:, None]
    outside = np.linalg.norm(points, axis=1) > 0.007
    assert np.array_equal(field.valid(points), outside)
    assert np.array_equal(np.isfinite(field.at(points)[:, 0]), outside)


@pytest.mark.parametrize("offset", [1.0, 0.0])
def test_beacons_solved_once_serve_every_pose_of_the_array(offset):
    """Moving the array in the hand's frame equals solving the moved hand."""
    pose = at.Pose.turn(np.array([0.0, 0.0, 1.0]), 0.4, translation=(0.004, 0.002 * offset, -0.003))
    foci = np.array([[0, 0, 0.0075], [0.0075, 0, 0]])
    array = at.PhasedArray(far_points(12), -directions(12, 8))
    once = at.transfer_matrix(
        at.BoundaryElement().radiate(ball_scene(), one_each(foci)), array.seen_from(pose)
    )
    moved = at.Scene(PAPER_AIR, [at.sound_hard(at.sphere(0.007, 0.004).moved(pose))])
    again = at.transfer_matrix(
        at.BoundaryElement().radiate(moved, one_each(pose.apply(foci))), array
    )
    assert relative(once.matrix, again.matrix).max() < 1e-4


def hand_fingertip() -> at.Surface:
    """A body without any symmetry: an ellipsoid, bent and curved from its own formula."""
    ball = at.sphere(0.006, 0.0028)

    def bent(points: np.ndarray) -> np.ndarray:
        x, y, z = points[..., 0], points[..., 1], points[..., 2]
        return np.stack([1.3 * x + 30 * z**2, 0.8 * y, 1.6 * z + 10 * x * y], axis=-1)

    return at.Surface(bent(ball.vertices), ball.triangles, midpoints=bent(ball.midpoints))


BODIES = {
    "sphere": at.sphere(0.006, 0.003),
    "capsule": at.capsule((0.0, 0.0, -0.008), (0.001, 0.002, 0.009), 0.005, 0.003),
    "bent": hand_fingertip(),
}


def single_layer(
    nodes: Nodes, points: np.ndarray, density: np.ndarray, wavenumber: complex
) -> np.ndarray:
    """∫ e^{ikr}/(4πr) density dS at points on or off the skin: plain nodes far away, near integrals close by."""
    distance = np.linalg.norm(points[:, None] - nodes.points, axis=2)
    distance[distance < 1e-9] = np.inf  # a node's own panel is near, so its entry is replaced
    rows = (
        nodes.weights / (4 * np.pi * distance) * np.exp(1j * wavenumber * np.minimum(distance, 1.0))
    )
    near = integrate_near(nodes, points, 2.5, wavenumber, (8, 8), single_layer=True)
    rows[near.target[:, None], 6 * near.panel[:, None] + np.arange(6)] = near.values
    return rows @ density


@pytest.mark.parametrize("name", list(BODIES))
def test_a_source_inside_the_body_has_its_field_outside(name):
    """A body that moves as an inner monopole would push it radiates that monopole: exact on any skin.

    With v = ∂u/∂n of the monopole u the dual-surface equation reads A p = −(S v)(x) + i (S v)(x').
    """
    wavenumber, inner = 732.53 + 0j, np.array([[0.0005, -0.0003, 0.001]])
    panels = BODIES[name].panelled(3.2e-3)
    nodes = place_nodes(panels.quadratic_triangles, panels.body, panels.deviation)
    rule = NearRule(2.5, (8, 8))
    surface = dual_surface(nodes, wavenumber, rule, "float64")
    matrix = assemble(surface, "float64")
    offset = nodes.points - inner
    r = np.linalg.norm(offset, axis=1)
    push = (
        np.exp(1j * wavenumber * r)
        / r
        * (1j * wavenumber - 1 / r)
        * (offset * nodes.normals).sum(axis=1)
        / r
    )
    right = -single_layer(nodes, nodes.points, push, wavenumber)
    right += 1j * np.repeat(single_layer(nodes, surface.shifted, push, wavenumber), 3)
    pressure = gmres(matrix.times, right[None], 1e-8).solution.T
    points = far_points(20)
    found = double_layer_pressure(points, nodes, pressure, wavenumber, rule, "float64")[:, 0]
    found -= single_layer(nodes, points, push, wavenumber)
    true = monopole_pressure(points, inner, np.ones((1, 1), complex), wavenumber, "float64")[:, 0]
    assert np.linalg.norm(found - true) < 5e-3 * np.linalg.norm(true)
