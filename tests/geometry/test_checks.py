"""Bodies that cross themselves or one another, with depths from closed forms."""

import numpy as np
import pytest

from airtact.geometry.checks import check_apart, check_surface
from airtact.geometry.files import load_surface
from airtact.geometry.primitives import capsule, sphere
from airtact.geometry.surface import Pose, Surface
from faults import raises_code
from geometry.mesh.meshes import box_mesh, torus_mesh


def flat(surface: Surface) -> Surface:
    return Surface(surface.vertices, surface.triangles)


def test_a_surface_that_crosses_itself_is_rejected_with_number_and_place():
    crossing = Surface(*torus_mesh(0.015, 0.02))
    count = len(crossing.crossings)
    with raises_code("mesh_faulty", f" {count} pairs"):
        check_surface(crossing)


def test_sound_surfaces_pass(hand_file):
    for surface in (
        load_surface(hand_file),
        Surface(*torus_mesh(0.02, 0.01)),
        Surface(*box_mesh()),
        sphere(0.01, 0.01),
    ):
        check_surface(surface)


def test_one_body_and_none_are_apart():
    check_apart([])
    check_apart([sphere(0.01, 0.01)])


RODS = [
    (sphere(0.01, 0.005), sphere(0.008, 0.005, centre=(0.0, 0.0, 0.015)), 3.0),
    (
        capsule((0.0, 0.0, 0.0), (0.0, 0.0, 0.04), 0.008, 0.005),
        capsule((0.01, -0.02, 0.02), (0.01, 0.02, 0.02), 0.005, 0.005),
        3.0,
    ),
    (sphere(0.01, 0.005), sphere(0.002, 0.005, centre=(0.001, 0.0, 0.0)), 11.0),  # one in the other
]


@pytest.mark.parametrize(("one", "two", "millimetres"), RODS)
def test_primitives_that_overlap_are_rejected_with_the_exact_depth(one, two, millimetres):
    with raises_code("bodies_overlap", "bodies 0 and 1", f": {millimetres:g} mm deep near ("):
        check_apart([one, two])


@pytest.mark.parametrize(
    ("gap", "code", "number"),
    [
        (0.0, "bodies_overlap", "0 mm deep"),
        (-1e-6, "bodies_overlap", "0.001 mm deep"),
        (2.9e-4, "bodies_overlap", "0.29 mm apart"),
        (3e-4, None, ""),
        (4e-4, None, ""),
    ],
)
def test_primitives_that_touch_or_nearly_do_are_rejected(gap, code, number):
    bodies = [sphere(0.01, 0.01), sphere(0.01, 0.01, centre=(0.02 + gap, 0.0, 0.0))]
    if code is None:
        check_apart(bodies)
        return
    with raises_code(code, "bodies 0 and 1", number):
        check_apart(bodies)


@pytest.mark.parametrize("swap", [False, True])
def test_meshes_that_nearly_touch_are_rejected_with_their_distance(swap):
    slab = Surface(*box_mesh((-0.1, -0.1, -0.1), (0.1, 0.1, 0.0)))
    tip = Surface(*box_mesh((0.003, 0.004, 0.0002), (0.01, 0.01, 0.02)))
    ball = sphere(0.01, 0.005, centre=(-0.05, 0.004, 0.01025))
    for other, millimetres in ((tip, "0.2"), (ball, "0.25")):
        bodies = [other, slab] if swap else [slab, other]
        with raises_code("bodies_overlap", "bodies 0 and 1", f" {millimetres} mm apart near ("):
            check_apart(bodies)


@pytest.mark.parametrize(("thickness", "rejected"), [(0.0004, True), (0.0006, False)])
def test_thin_plates_are_rejected_with_their_thickness_and_place(thickness, rejected):
    plate = Surface(*box_mesh(high=(0.02, 0.02, thickness)))
    if not rejected:
        check_surface(plate)
        return
    with raises_code("out_of_range", " 0.4 mm thick near (", "than 0.5 mm"):
        check_surface(plate)


def test_a_bead_of_half_a_millimetre_and_a_wedge_are_not_too_thin():
    bead = sphere(0.00026, 0.0001)
    check_surface(Surface(bead.vertices, bead.triangles))
    wedge = np.array([[0, 0, 0], [3, 0, 0], [0, 2, 0], [3, 2, 0], [0, 0, 1], [3, 0, 1]]) * 0.01
    sides = [[0, 2, 1], [1, 2, 3], [0, 1, 4], [1, 5, 4], [0, 4, 2], [1, 3, 5], [2, 4, 5], [2, 5, 3]]
    check_surface(Surface(wedge, np.array(sides)))


def test_the_third_body_is_looked_at_too():
    far = [sphere(0.005, 0.005, centre=(0.02 * i, 0.0, 0.0)) for i in range(3)]
    check_apart(far)
    with raises_code("bodies_overlap", "bodies 1 and 3"):
        check_apart([*far, sphere(0.005, 0.005, centre=(0.02, 0.009, 0.0))])


@pytest.mark.parametrize("swap", [False, True])
@pytest.mark.parametrize(
    ("height", "said"), [(0.012, None), (0.008, "2 mm"), (-0.005, "15 mm"), (-0.02, "30 mm")]
)
def test_a_primitive_and_a_mesh(height, said, swap):
    # A ball of 10 mm over the face z = 0 of a large slab: the depth is 10 mm less its height.
    slab = Surface(*box_mesh((-0.1, -0.1, -0.1), (0.1, 0.1, 0.0)))
    bodies = [slab, sphere(0.01, 0.005, centre=(0.003, 0.004, height))]
    if said is None:
        check_apart(bodies[::-1] if swap else bodies)
        return
    with raises_code("bodies_overlap", "bodies 0 and 1", f": {said} deep"):
        check_apart(bodies[::-1] if swap else bodies)


def test_a_mesh_in_a_primitive():
    with raises_code("bodies_overlap", "bodies 0 and 1"):
        check_apart([sphere(0.02, 0.01), Surface(*box_mesh((-0.001,) * 3, (0.001,) * 3))])


def test_meshes_that_cross_are_rejected_with_number_and_place():
    one, two = (
        Surface(*box_mesh((0, 0, 0), (0.02,) * 3)),
        Surface(*box_mesh((0.01,) * 3, (0.03,) * 3)),
    )
    with raises_code("bodies_overlap", "bodies 0 and 1"):
        check_apart([one, two])


def test_meshes_that_share_a_face_are_rejected():
    one, two = (
        Surface(*box_mesh((0, 0, 0), (0.02,) * 3)),
        Surface(*box_mesh((0.02, 0, 0), (0.04, 0.02, 0.02))),
    )
    with raises_code("bodies_overlap"):
        check_apart([one, two])
    check_apart([one, two.moved(Pose(np.eye(3), np.array([0.31e-3, 0.0, 0.0])))])


@pytest.mark.parametrize("swap", [False, True])
def test_a_mesh_inside_a_mesh_is_rejected_with_its_depth(swap):
    outer, inner = (
        Surface(*box_mesh((0, 0, 0), (0.1,) * 3)),
        Surface(*box_mesh((0.05,) * 3, (0.06,) * 3)),
    )
    bodies = [inner, outer] if swap else [outer, inner]
    # Any of its corners may be named; the shallowest lies 40 mm deep, the deepest 50 mm.
    with raises_code("bodies_overlap", "bodies 0 and 1") as caught:
        check_apart(bodies)
    assert any(f"one lies {depth} mm inside the other" in str(caught.value) for depth in (40, 50))


def test_meshes_apart_pass_even_where_their_boxes_overlap():
    ring = Surface(*torus_mesh(0.03, 0.005))
    check_apart([ring, flat(sphere(0.02, 0.01))])
    with raises_code("bodies_overlap"):
        check_apart([ring, flat(sphere(0.026, 0.01))])


def test_a_hand_and_a_rod(hand_file):
    hand = load_surface(hand_file)
    palm = hand.vertices.mean(axis=0)
    check_apart([hand, sphere(0.01, 0.005, centre=tuple(palm + [0.2, 0.0, 0.0]))])
    with raises_code("bodies_overlap", "bodies 0 and 1"):
        check_apart(
            [hand, capsule(tuple(palm - [0.2, 0, 0]), tuple(palm + [0.2, 0, 0]), 0.003, 0.003)]
        )


def test_a_piece_inside_another_is_rejected():
    outer, inner = (
        box_mesh((0, 0, 0), (0.02, 0.03, 0.04)),
        box_mesh((0.01, 0.01, 0.01), (0.015, 0.02, 0.02)),
    )
    both = Surface(np.vstack([outer[0], inner[0]]), np.vstack([outer[1], inner[1] + 8]))
    with raises_code("mesh_faulty", "piece 1 of 2", "piece 0, 10 mm deep near ("):
        check_surface(both)


def test_pieces_side_by_side_pass():
    left, right = (
        box_mesh((0, 0, 0), (0.01, 0.01, 0.01)),
        box_mesh((0.02, 0, 0), (0.03, 0.01, 0.01)),
    )
    check_surface(Surface(np.vstack([left[0], right[0]]), np.vstack([left[1], right[1] + 8])))
