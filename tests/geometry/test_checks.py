"""Bodies that cross themselves or one another, with depths from closed forms."""

import numpy as np
import pytest

import airtact as at
from airtact.geometry.checks import check_apart, check_surface
from faults import raises_code
from geometry.mesh.meshes import box_mesh, torus_mesh

SLAB = at.Surface(*box_mesh((-0.1, -0.1, -0.1), (0.1, 0.1, 0.0)))
BALL = at.sphere(0.01, 0.005)
LARGE_BOX = at.Surface(*box_mesh((0, 0, 0), (0.02,) * 3))
RING = at.Surface(*torus_mesh(0.03, 0.005))


def flat(surface: at.Surface) -> at.Surface:
    return at.Surface(surface.vertices, surface.triangles)


def ball(x: float, y: float, z: float, radius: float = 0.01) -> at.Surface:
    return at.sphere(radius, 0.005, centre=(x, y, z))


def box(low, high) -> at.Surface:
    return at.Surface(*box_mesh(low, high))


def two_boxes(low, high) -> at.Surface:
    outer, triangles = box_mesh((0, 0, 0), (0.02, 0.03, 0.04))
    inner, _ = box_mesh(low, high)
    return at.Surface(np.vstack([outer, inner]), np.vstack([triangles, triangles + 8]))


# --- one body -------------------------------------------------------------------------------------


def test_a_surface_that_crosses_itself_is_rejected_with_number_and_place():
    crossing = at.Surface(*torus_mesh(0.015, 0.02))
    with raises_code("mesh_faulty", f" {len(crossing.crossings)} pairs") as caught:
        check_surface(crossing)
    assert np.linalg.norm(caught.value.position) < 0.035


def test_pieces_inside_others_and_thin_plates_are_rejected_with_their_size():
    with raises_code("mesh_faulty", "piece 1 of 2", "10 mm"):
        check_surface(two_boxes((0.01, 0.01, 0.01), (0.015, 0.02, 0.02)))
    with raises_code("out_of_range", " 0.4 mm", "0.5 mm"):
        check_surface(box((0, 0, 0), (0.02, 0.02, 0.0004)))


def test_sound_surfaces_pass(hand_file):
    bead = at.sphere(0.00026, 0.0001)
    corners = [[0, 0, 0], [3, 0, 0], [0, 2, 0], [3, 2, 0], [0, 0, 1], [3, 0, 1]]
    sides = [[0, 2, 1], [1, 2, 3], [0, 1, 4], [1, 5, 4], [0, 4, 2], [1, 3, 5], [2, 4, 5], [2, 5, 3]]
    for surface in (
        at.load_surface(hand_file),
        at.Surface(*torus_mesh(0.02, 0.01)),
        at.Surface(*box_mesh()),
        BALL,
        box((0, 0, 0), (0.02, 0.02, 0.0006)),
        flat(bead),
        at.Surface(0.01 * np.array(corners), np.array(sides)),  # a wedge ends in nothing
        two_boxes((0.03, 0, 0), (0.04, 0.01, 0.01)),
    ):
        check_surface(surface)


# --- several bodies -------------------------------------------------------------------------------

ROD = at.capsule((0.0, 0.0, 0.0), (0.0, 0.0, 0.04), 0.008, 0.005)
CROSSING_ROD = at.capsule((0.01, -0.02, 0.02), (0.01, 0.02, 0.02), 0.005, 0.005)


@pytest.mark.parametrize("swap", [False, True])
@pytest.mark.parametrize(
    ("one", "two", "values"),
    [
        (BALL, ball(0.0, 0.0, 0.015, 0.008), [" 3 mm deep"]),
        (ROD, CROSSING_ROD, [" 3 mm deep"]),
        (BALL, ball(0.001, 0.0, 0.0, 0.002), [" 11 mm deep"]),  # one in the other
        (BALL, ball(0.02, 0.0, 0.0), ["0 mm deep"]),
        (BALL, ball(0.02 - 1e-6, 0.0, 0.0), ["0.001 mm deep"]),
        (BALL, ball(0.02 + 2.9e-4, 0.0, 0.0), ["0.29 mm"]),
        # A ball of 10 mm over the face z = 0 of a large slab.
        (SLAB, ball(0.003, 0.004, 0.008), [" 2 mm deep"]),
        (SLAB, ball(0.003, 0.004, -0.005), [" 5 mm deep"]),
        (SLAB, ball(0.003, 0.004, -0.02), [" 30 mm deep"]),
        (SLAB, ball(-0.05, 0.004, 0.01025), [" 0.25 mm"]),
        (SLAB, box((0.003, 0.004, 0.0002), (0.01, 0.01, 0.02)), [" 0.2 mm"]),
        (ball(0.0, 0.0, 0.0, 0.02), box((-0.001,) * 3, (0.001,) * 3), [" mm deep"]),
        (LARGE_BOX, box((0.01,) * 3, (0.03,) * 3), []),
        (LARGE_BOX, box((0.02, 0, 0), (0.04, 0.02, 0.02)), []),  # a common face
        (RING, flat(at.sphere(0.026, 0.01)), []),
    ],
)
def test_bodies_that_overlap_touch_or_nearly_do_are_rejected(one, two, values, swap):
    with raises_code("bodies_overlap", "bodies 0 and 1", *values):
        check_apart([two, one] if swap else [one, two])


@pytest.mark.parametrize("swap", [False, True])
def test_a_mesh_inside_a_mesh_is_rejected_with_its_depth(swap):
    bodies = [box((0, 0, 0), (0.1,) * 3), box((0.05,) * 3, (0.06,) * 3)]
    with raises_code("bodies_overlap") as caught:
        check_apart(bodies[::-1] if swap else bodies)
    # Any of its corners may be named; the shallowest lies 40 mm deep, the deepest 50 mm.
    assert any(f" {depth} mm deep" in str(caught.value) for depth in (40, 50))


@pytest.mark.parametrize(
    "bodies",
    [
        [],
        [BALL],
        [BALL, ball(0.02 + 3e-4, 0.0, 0.0)],
        [BALL, ball(0.02 + 4e-4, 0.0, 0.0)],
        [SLAB, ball(0.003, 0.004, 0.012)],
        [ball(0.003, 0.004, 0.012), SLAB],
        [LARGE_BOX, box((0.02031, 0, 0), (0.04, 0.02, 0.02))],
        [RING, flat(at.sphere(0.02, 0.01))],  # their boxes overlap
    ],
)
def test_bodies_apart_pass(bodies):
    check_apart(bodies)


def test_a_hand_and_a_rod(hand_file):
    hand = at.load_surface(hand_file)
    palm = hand.vertices.mean(axis=0)
    aside = np.array([0.2, 0.0, 0.0])
    check_apart([hand, at.sphere(0.01, 0.005, centre=palm + aside)])
    with raises_code("bodies_overlap", "bodies 0 and 1"):
        check_apart([hand, at.capsule(palm - aside, palm + aside, 0.003, 0.003)])
