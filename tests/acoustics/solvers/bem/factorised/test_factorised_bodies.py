"""Bodies factorised one by one scatter as when solved as a whole, wherever they are moved."""

import re

import numpy as np
import pytest
import trimesh

import airtact as at
from faults import raises_code
from references import relative
from worlds import AIR, hard

BALLS = (
    at.sphere(radius=4e-3, edge=2e-3, centre=(-9e-3, 0, 0)),
    at.sphere(radius=3e-3, edge=2e-3, centre=(9e-3, 0, 0)),
)
FOCI = np.array([[-4.5e-3, 0, 0], [5.2e-3, 1e-3, 0]])
AROUND = 70e-3 * np.array(
    [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0.3], [0, 0.2, 1], [0.5, 0.5, -1]]
)


def beacons(foci=FOCI):
    return at.Target(foci).beacons()


def moved_balls():
    first = at.Pose.turn((1, 2, 3), 0.4, (-1e-3, 2e-3, 1e-3))
    second = at.Pose.turn((0, 1, 1), -0.7, (3e-3, 0, -4e-3))
    surfaces = BALLS[0].moved(first), BALLS[1].moved(second)
    return hard(*surfaces), np.concatenate([first.apply(FOCI[:1]), second.apply(FOCI[1:])])


@pytest.fixture(scope="module")
def factorised():
    return at.BoundaryElement(accuracy=0.01).factorised(hard(*BALLS), FOCI)


def test_one_sphere_agrees_with_the_series_to_the_accuracy_asked_for():
    ball, focus = at.sphere(radius=5e-3, edge=2e-3), np.array([[0, 0, 8e-3]])
    exact = at.SphereSeries().radiate(hard(ball), beacons(focus)).at(AROUND)
    solvers = [at.BoundaryElement(accuracy=accuracy) for accuracy in (0.05, 0.001)]
    errors = [
        relative(one.factorised(hard(ball)).radiate(hard(ball), beacons(focus)).at(AROUND), exact)
        for one in solvers
    ]
    assert errors[0] < 0.05
    assert errors[1] < min(0.001, 0.2 * errors[0])


def test_bodies_at_rest_and_moved_scatter_as_when_solved_as_a_whole(factorised):
    fine = at.BoundaryElement(accuracy=0.001)
    for scene, foci in ((hard(*BALLS), FOCI), moved_balls()):
        found = factorised.radiate(scene, beacons(foci)).at(AROUND)
        assert relative(found, fine.radiate(scene, beacons(foci)).at(AROUND)) < 0.01


def test_bodies_scatter_each_others_field(factorised):
    scene, foci = moved_balls()
    alone = (
        at.SphereSeries().radiate(hard(scene.obstacles[0].surface), beacons(foci[:1])).at(AROUND)
    )
    assert relative(factorised.radiate(scene, beacons(foci[:1])).at(AROUND), alone) > 0.1


def test_points_far_away_take_fewer_monopoles_for_the_same_field(factorised):
    field, beside = factorised.radiate(hard(*BALLS), beacons()), np.array([[0, 9e-3, 0]])
    far, near = field.at(AROUND), field.at(np.concatenate([AROUND, beside]))[:-1]
    assert 0 < relative(far, near) < factorised.report.settings["skeleton_error"]
    for body in factorised.bodies:
        assert len(body.far.positions) < 1.3 * len(body.rows)


def test_a_motion_of_all_together_moves_the_field(factorised):
    pose = at.Pose.turn((1, 0, 1), 1.1, (2e-3, -7e-3, 5e-3))
    still = factorised.radiate(hard(*BALLS), beacons()).at(AROUND)
    moved = hard(*[ball.moved(pose) for ball in BALLS])
    assert (
        relative(factorised.radiate(moved, beacons(pose.apply(FOCI))).at(pose.apply(AROUND)), still)
        < 1e-4
    )


def test_a_focus_on_the_surface_radiates_with_its_image(factorised):
    touching = np.array([[-5e-3, 0, 0]])
    exact = at.BoundaryElement(accuracy=0.001).radiate(hard(*BALLS), beacons(touching)).at(AROUND)
    assert relative(factorised.radiate(hard(*BALLS), beacons(touching)).at(AROUND), exact) < 0.01


def test_double_precision_agrees_too():
    solver = at.BoundaryElement(accuracy=0.01, precision="float64")
    found = solver.factorised(hard(*BALLS)).radiate(hard(*BALLS), beacons()).at(AROUND)
    assert relative(found, solver.radiate(hard(*BALLS), beacons()).at(AROUND)) < 0.01


def test_the_report_has_the_error_of_the_skeletons(factorised):
    report = factorised.radiate(hard(*BALLS), beacons()).report
    assert 0 < report.settings["skeleton_error"] < 0.01
    assert report.residual <= report.settings["gmres_tolerance"]
    assert report.nodes == sum(len(body.surface.nodes.points) for body in factorised.bodies)


def test_bodies_that_come_too_near_are_solved_as_a_whole(factorised):
    near = BALLS[1].moved(at.Pose(np.eye(3), np.array([-8e-3, 0, 0])))
    field = factorised.radiate(hard(BALLS[0], near), beacons(np.array([[0, 0, 9e-3]])))
    assert len(field.on_surface.points) > 0  # which factorised bodies do not know
    whole = at.BoundaryElement(accuracy=0.002).radiate(field.scene, field.sources).at(AROUND)
    assert relative(field.at(AROUND), whole) < 0.01


def test_the_field_is_unknown_near_the_surface_and_inside(factorised):
    field = factorised.radiate(hard(*BALLS), beacons())
    points = np.array([[-9e-3, 0, 0], [-9e-3, 0, 6e-3], [-9e-3, 0, 12e-3]])
    assert field.valid(points).tolist() == [False, False, True]
    assert np.isnan(field.at(points)[:, 0]).tolist() == [True, True, False]
    with raises_code("not_supported"):
        _ = field.on_surface


def test_the_transfer_matrix_is_that_of_the_whole_solve(factorised):
    scene, foci = moved_balls()
    array = at.surrounding_box()
    found = at.transfer_matrix(factorised.radiate(scene, beacons(foci)), array).matrix
    exact = at.transfer_matrix(
        at.BoundaryElement(accuracy=0.002).radiate(scene, beacons(foci)), array
    ).matrix
    assert relative(found, exact) < 0.01


def test_other_bodies_are_rejected(factorised):
    scene = hard(*BALLS)
    smaller = at.sphere(radius=2.9e-3, edge=2e-3, centre=(9e-3, 0, 0))
    for other, sentence in (
        (hard(BALLS[0]), "2 bodies were factorised, but the scene has 1"),
        (hard(BALLS[0], smaller), "body 1 is not the one that was factorised, moved rigidly: "),
        (
            hard(BALLS[0], at.capsule((9e-3, 0, 0), (9e-3, 0, 9e-3), 3e-3, 2e-3)),
            "it has other triangles",
        ),
        (at.Scene(AIR, scene.obstacles, frequency=41e3), "factorised for 40000 Hz"),
        (at.Scene(AIR, [scene.obstacles[0], at.impedance(BALLS[1], 3.0)]), "it is impedance"),
    ):
        with raises_code("not_supported", sentence):
            factorised.radiate(other, beacons())


def test_a_deformed_body_is_rejected_with_the_deviation_of_its_vertices():
    ball, stretched = (
        at.Surface(BALLS[1].vertices * [1, 1, z], BALLS[1].triangles) for z in (1, 1.05)
    )
    factorised = at.BoundaryElement(accuracy=0.05).factorised(hard(ball))
    with raises_code("not_supported", "body 0", "up to 0.1"):
        factorised.radiate(hard(stretched), beacons())


def grooved() -> at.Surface:
    """A block of 12 x 7 x 11 mm with a groove of 5 mm."""
    block = trimesh.creation.box((12e-3, 7e-3, 11e-3))
    groove = trimesh.creation.box((5e-3, 20e-3, 9e-3)).apply_translation((0, 0, 3e-3))
    body = trimesh.boolean.difference([block, groove]).subdivide_to_size(4e-3)
    return at.Surface(np.array(body.vertices), np.array(body.faces))


def plate() -> at.Surface:
    body = trimesh.creation.box((10e-3, 8e-3, 1e-3)).subdivide()
    return at.Surface(np.array(body.vertices), np.array(body.faces))


@pytest.mark.parametrize(
    ("surface", "focus"),
    [(grooved(), (0, 0, 0)), (plate(), (0, 0, 1e-3))],
    ids=["grooved block", "plate"],
)
def test_bodies_that_are_not_round_keep_the_accuracy(surface, focus):
    scene, source = hard(surface), beacons(np.array([focus], dtype=np.float64))
    exact = at.BoundaryElement(accuracy=0.012, estimate=False).radiate(scene, source).at(AROUND)
    solver = at.BoundaryElement(accuracy=0.05)
    field = solver.factorised(scene, source.positions).radiate(scene, source)
    assert relative(field.at(AROUND), exact) < 0.05
    assert field.report.warnings == ()
    assert field.report.settings["skeleton_error"] <= 0.025


def test_a_focus_beside_coarse_panels_gives_a_warning():
    ball, focus = at.sphere(radius=6e-3, edge=2e-3), np.array([[0, 0, 6.05e-3]])
    solver = at.BoundaryElement(accuracy=0.01)
    warned = solver.factorised(hard(ball)).radiate(hard(ball), beacons(focus)).report.warnings
    assert len(warned) == 1
    assert re.search(
        r"source 0 is 0\.\d+ mm from a node of body 0, where panels are \d\.\d+ mm long", warned[0]
    )
    assert (
        solver.factorised(hard(ball), focus).radiate(hard(ball), beacons(focus)).report.warnings
        == ()
    )


@pytest.mark.parametrize(
    "other",
    [
        at.Surface(BALLS[1].vertices, BALLS[1].triangles, BALLS[1].midpoints),
        at.Surface(BALLS[1].vertices, BALLS[1].triangles, sharp_degrees=0.0),
    ],
    ids=["a mesh for a closed form", "flat triangles"],
)
def test_the_same_triangles_curved_otherwise_are_another_body(factorised, other):
    with raises_code("not_supported", "body 1", "curved otherwise"):
        factorised.radiate(hard(BALLS[0], other), beacons())


def test_other_middles_of_edges_are_another_body():
    mesh = at.Surface(BALLS[1].vertices, BALLS[1].triangles, BALLS[1].midpoints)
    corners = mesh.corners
    flat = at.Surface(
        BALLS[1].vertices, BALLS[1].triangles, 0.5 * (corners + np.roll(corners, -1, axis=1))
    )
    factorised = at.BoundaryElement(accuracy=0.05).factorised(hard(mesh))
    with raises_code("not_supported", "up to 0."):
        factorised.radiate(hard(flat), beacons())


def test_refined_points_beside_no_body_are_rejected():
    solver, scene = at.BoundaryElement(accuracy=0.05), hard(*BALLS)
    with raises_code("out_of_range", "point 0", "5 m"):
        solver.factorised(scene, np.array([[5.012, 0, 0]]))
    with raises_code("inside_body", "4 mm"):
        solver.factorised(scene, np.array([[-9e-3, 0, 0]]))


def test_a_mirrored_body_is_no_rigid_motion(factorised):
    ball = BALLS[1]
    lump = (
        ball.vertices
        + np.where(ball.vertices > 11e-3, 1e-3, 0) * [0.5, 0, 0]
        + np.where(ball.vertices[:, 1:2] > 2e-3, 5e-4, 0) * [0, 1, 0]
    )
    body = at.Surface(lump, ball.triangles)
    mirrored = at.Surface(lump * [1, 1, -1], ball.triangles[:, ::-1].copy())
    solver = at.BoundaryElement(accuracy=0.05).factorised(hard(body))
    with raises_code("not_supported", "body 0"):
        solver.radiate(hard(mirrored), beacons())


def test_a_focus_inside_and_an_empty_scene_are_rejected(factorised):
    with raises_code("inside_body", "4 mm"):
        factorised.radiate(hard(*BALLS), beacons(np.array([[-9e-3, 0, 0]])))
    with raises_code("empty"):
        at.BoundaryElement().factorised(hard())
    with raises_code("not_finite"):
        at.BoundaryElement().factorised(hard(*BALLS), np.full((1, 3), np.nan))


@pytest.mark.parametrize("strength", [1e-30, 1e30])
@pytest.mark.parametrize("moved", [False, True])
def test_sources_of_any_strength_are_scattered_alike(factorised, moved, strength):
    scene, foci = moved_balls() if moved else (hard(*BALLS), FOCI)
    one, other = (
        factorised.radiate(scene, at.Monopoles(foci, size * np.eye(2))).scattered_at(AROUND) / size
        for size in (1.0, strength)
    )
    assert relative(other, one) < 1e-5
